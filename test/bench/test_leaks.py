"""What comes and goes again leaves nothing behind: of each case of the benchmark some hundred rounds."""

import importlib
import json
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
_path = list(sys.path)
sys.path.insert(0, str(HERE.parents[1] / "bench"))
leaks = importlib.import_module("leaks")
sys.path[:] = _path  # the benchmark adds to it as well, and its modules' names are those of test packages

SPARE = 300
"""Objects that may come and stay for other reasons than the rounds."""

PREDICATE = "a predicate whose clauses were all retracted is there, and fails"
KEPT = {
    "clauses_of_new_predicates": PREDICATE,
    "clauses_that_are_called": PREDICATE,
    "rule_files": PREDICATE,
}
"""Cases where something stays: why."""

NAMES = [name for name in leaks.CASES if name not in KEPT]


@pytest.fixture(scope="module")
def left():
    """The objects that each case has left behind."""
    command = [sys.executable, str(HERE / "leaking.py"), *NAMES]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_nothing_is_left_behind(name, left):
    assert left[name] < SPARE
