"""The benchmark of drifting keys, with few events."""

import importlib
import sys
from pathlib import Path

import pytest

_path = list(sys.path)
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "bench"))
drifting_keys = importlib.import_module("drifting_keys")
sys.path[:] = _path

HELD = {"sequence", "group", "steps", "last", "every", "change", "sliding", "first", "throttle"}


@pytest.mark.parametrize("kind", drifting_keys.RULES)
def test_time_bounds_the_keys(kind):
    row = drifting_keys.run(kind, 4000, False)
    assert row[0] == kind
    assert 0 < int(row[4]) <= 1010
    assert (400 < int(row[5]) < 510) == (kind in HELD)


@pytest.mark.parametrize("kind", ["steps", "last", "every", "change"])
def test_their_number_is_bounded(kind):
    assert int(drifting_keys.run(kind, 4000, True)[5]) == 100
