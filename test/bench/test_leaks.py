"""What comes and goes again leaves nothing behind: of each case of the benchmark some hundred rounds."""

import gc
import importlib
import logging
import sys
from pathlib import Path

import pytest

from retalis.foundation import Cache
from retalis.prolog.database import Database

BENCH = Path(__file__).resolve().parents[2] / "bench"
_path = list(sys.path)
sys.path.insert(0, str(BENCH))
leaks = importlib.import_module("leaks")
sys.path[:] = _path  # the benchmark adds to it as well, and its modules' names are those of test packages

FIRST, LAST = 60, 460
SPARE = 300
"""Objects that may come and stay for other reasons than the rounds."""

PREDICATE = "a predicate whose clauses were all retracted is there, and fails"
KEPT = {
    "clauses_of_new_predicates": PREDICATE,
    "clauses_that_are_called": PREDICATE,
    "rule_files": PREDICATE,
}
"""Cases where something stays: why."""

SEEN_TO_AT = {
    "retalis.events.dispatch.audience._GATES": 10,
    "retalis.events.network.rule._SPARE": 10,
    "retalis.engine.runtime.reports._KINDS": 10,
}
"""Numbers from which on it is looked what is of no use any more."""


def held():
    """Return how many objects there are when no cache holds anything, and no predicate that is none."""
    for one in gc.get_objects():
        if isinstance(one, Cache):
            one.clear()
        elif isinstance(one, Database):
            one.put_aside()
    gc.collect()
    gc.collect()
    return len(gc.get_objects())


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in leaks.CASES if name not in KEPT])
def test_nothing_is_left_behind(name, monkeypatch):
    for place, number in SEEN_TO_AT.items():
        monkeypatch.setattr(place, number)
    logging.getLogger("retalis").setLevel(logging.CRITICAL)
    do = leaks.CASES[name]()
    try:
        for number in range(FIRST):
            do(number)
        before = held()
        for number in range(FIRST, LAST):
            do(number)
        assert held() - before < SPARE
    finally:
        logging.getLogger("retalis").setLevel(logging.NOTSET)
