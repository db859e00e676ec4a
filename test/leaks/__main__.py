"""Print the number of objects that rounds of each case leave behind, as JSON.

    PYTHONPATH=src:test python3 -m leaks [CASE ...] [--rounds N]

Needs a process of its own: other tests leave threads and objects that end at any time.
"""

import argparse
import gc
import importlib
import json
import logging
from typing import Any

from retalis.foundation.bounded_caches import Cache
from retalis.prolog.database.predicate_database import Database

from .cases import CASES

WARM_UP_ROUNDS = 60

SWEEP_LIMITS = (
    ("events.dispatch.dispatcher", "_MIN_FILTERS_TO_SWEEP"),
    ("events.fused.fused_join", "STALE_ARRIVALS_TOLERANCE"),
    ("events.matches.match_limit", "STALE_ARRIVALS_TOLERANCE"),
    ("events.matches.expiration", "_STALE_TOLERANCE"),
    ("events.matches.negation", "_STALE_TOLERANCE"),
    ("engine.runtime.problem_reports", "_MAX_PROBLEMS"),
)
"""Numbers of unused entries above which a table is swept, with their modules."""

SWEEP_LIMIT = 10
"""Smaller than the number of warm-up rounds, so that each table has been swept before the objects are counted."""


def count_objects() -> int:
    """Return the number of objects after all caches are emptied and unused predicates deleted."""
    for candidate in gc.get_objects():
        if isinstance(candidate, Cache):
            candidate.clear()
        elif isinstance(candidate, Database):
            candidate.demote_unused()
    gc.collect()
    gc.collect()
    return len(gc.get_objects())


def count_remaining(name: Any, rounds: Any) -> int:
    """Return how many objects more there are after a number of rounds of a case."""
    run_round = CASES[name]()
    for number in range(WARM_UP_ROUNDS):
        run_round(number)
    before = count_objects()
    for number in range(WARM_UP_ROUNDS, WARM_UP_ROUNDS + rounds):
        run_round(number)
    return count_objects() - before


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("cases", nargs="*", metavar="CASE", help=", ".join(CASES))
    parser.add_argument("--rounds", type=int, default=400)
    options = parser.parse_args()
    unknown = sorted(set(options.cases) - set(CASES))
    if unknown:
        parser.error(f"there is no case {', '.join(unknown)}")
    logging.getLogger("retalis").setLevel(logging.CRITICAL)
    for module_name, limit_name in SWEEP_LIMITS:
        module = importlib.import_module(f"retalis.{module_name}")
        getattr(module, limit_name)  # a limit that does not exist is an error
        setattr(module, limit_name, SWEEP_LIMIT)
    print(json.dumps({name: count_remaining(name, options.rounds) for name in options.cases or CASES}))


if __name__ == "__main__":
    main()
