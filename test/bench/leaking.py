"""Prints how many objects each case of the benchmark of leaks has left behind, as JSON: in a process of its own, as
other tests leave threads and objects that come and go.
"""

import gc
import importlib
import json
import logging
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "bench"), str(ROOT / "src")]

import leaks  # noqa: E402

from retalis.foundation.bounded_caches import Cache  # noqa: E402
from retalis.prolog.database.predicate_table import Database  # noqa: E402

FIRST, LAST = 60, 460

SEEN_TO_AT = (
    ("events.dispatch.dispatcher", "_MIN_FILTERS_TO_SWEEP"),
    ("events.fused.fused_join", "STALE_ARRIVALS_TOLERANCE"),
    ("events.network.event_rule", "STALE_ARRIVALS_TOLERANCE"),
    ("events.matches.expiration", "_STALE_TOLERANCE"),
    ("events.matches.negation", "_STALE_TOLERANCE"),
    ("engine.runtime.problem_reports", "_MAX_PROBLEMS"),
)
"""Numbers from which on it is looked what is of no use any more."""


def held():
    """Return how many objects there are when no cache holds anything, and no predicate that is none."""
    for one in gc.get_objects():
        if isinstance(one, Cache):
            one.clear()
        elif isinstance(one, Database):
            one.demote_unused()
    gc.collect()
    gc.collect()
    return len(gc.get_objects())


def left(name):
    """Return how many objects more there are after hundreds of rounds of a case."""
    do = leaks.CASES[name]()
    for number in range(FIRST):
        do(number)
    before = held()
    for number in range(FIRST, LAST):
        do(number)
    return held() - before


if __name__ == "__main__":
    logging.getLogger("retalis").setLevel(logging.CRITICAL)
    for module, number in SEEN_TO_AT:
        place = importlib.import_module(f"retalis.{module}")
        getattr(place, number)  # one that is not there any more is an error
        setattr(place, number, 10)
    print(json.dumps({name: left(name) for name in sys.argv[1:]}))
