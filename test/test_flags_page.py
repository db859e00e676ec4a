"""Table of ``docs/reference/flags.md``, compared with the flags of the code: names, values and defaults."""

import re
from typing import Any, Iterator

import pytest
from parsed_sources import ROOT

from retalis import Engine, PrologError
from retalis.events.rules.language_flags import FLAGS

pytestmark = pytest.mark.docs

PAGE = (ROOT / "docs" / "reference" / "flags.md").read_text(encoding="utf-8")
QUOTED = re.compile(r"`([^`]+)`")
NUMBERS = {"seconds": (False, 0), "a number": (True, 1)}
"""Words for the values of numeric flags: whether they must be integers, and their minimum."""


def rows() -> Iterator[Any]:
    """Yield each flag of the table with the cell of its values."""
    for line in PAGE.splitlines():
        if line.startswith("| `"):
            names, values, _ = re.split(r"(?<!\\) \| ", line.strip("| "), maxsplit=2)
            for name in QUOTED.findall(names):
                yield name, values


ROWS = list(rows())


def test_table_has_each_flag_once() -> None:
    assert sorted(name for name, _ in ROWS) == sorted(FLAGS)


@pytest.mark.parametrize(("name", "cell"), ROWS)
def test_values_and_default_equal_those_of_code(name: Any, cell: Any) -> None:
    flag, values = FLAGS[name], QUOTED.findall(cell)
    (answer,) = Engine().query(f"get_etalis_flag({name}, Value)")
    assert Engine().show(answer["Value"]) == values[0]
    if flag.values:
        assert sorted(values) == sorted(flag.values)
    else:
        assert NUMBERS[cell.partition(", ")[2]] == (flag.is_integer, flag.minimum)


def test_limit_of_0_seconds_is_valid() -> None:
    # The page says that -1 and 0 mean no limit.
    seconds = [name for name, cell in ROWS if cell == "`-1`, seconds"]
    assert len(seconds) == 4
    for name in seconds:
        assert Engine().call(f"set_etalis_flag({name}, 0)")
        with pytest.raises(PrologError):
            Engine().call(f"set_etalis_flag({name}, -2)")
