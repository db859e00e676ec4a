"""Messages as dictionaries."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retalis import Definitions, MessageError
from retalis.messages.message_dictionaries import make_message_term, read_message_term

DEFINITIONS = Definitions()
DEFINITIONS.add("lab/Point", "float64 x\nint8 y")
SAMPLE = DEFINITIONS.add(
    "lab/Sample",
    "time stamp\nduration length\nbool ok\nstring name\nuint8[] data\n"
    "uint32[2] pair\nlab/Point[] path\nlab/Point first\n",
)
TEXT = st.text(st.characters(blacklist_characters="\0", blacklist_categories=["Cs"]), max_size=2000)
POINTS = st.fixed_dictionaries(
    {"x": st.floats(allow_nan=False, allow_infinity=False), "y": st.integers(-128, 127)}
)
SAMPLES = st.fixed_dictionaries(
    {
        "stamp": st.integers(0, (1 << 32) * 10**9 - 1),
        "length": st.integers(-(1 << 31) * 10**9, (1 << 31) * 10**9 - 1),
        "ok": st.booleans(),
        "name": TEXT,
        "data": st.binary(max_size=2000),
        "pair": st.lists(st.integers(0, (1 << 32) - 1), min_size=2, max_size=2),
        "path": st.lists(POINTS, max_size=3),
        "first": POINTS,
    }
)


@given(SAMPLES)
def test_values_of_encoded_message_are_the_same(values: Any) -> None:
    data = DEFINITIONS.encoder(SAMPLE).encode(make_message_term(SAMPLE, values))
    assert read_message_term(SAMPLE, DEFINITIONS.decoder(SAMPLE).decode(data)) == values


def test_missing_values_are_zero() -> None:
    point = {"x": 0.0, "y": 0}
    assert read_message_term(SAMPLE, make_message_term(SAMPLE, {})) == {
        "stamp": 0,
        "length": 0,
        "ok": False,
        "name": "",
        "data": b"",
        "pair": [0, 0],
        "path": [],
        "first": point,
    }


def test_unknown_slot_is_refused() -> None:
    with pytest.raises(MessageError, match="lab/Point has no slot z"):
        make_message_term(SAMPLE, {"first": {"z": 1}})
