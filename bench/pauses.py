#!/usr/bin/env python3
"""Pauses of single events: the longest CPU time of an event while many partial matches wait.

    bench/pauses.py [--matches N] [--default-gc]

Feeds a sequence N first sides that all wait, then as many pairs of an absent event and a first side. Prints the
longest events of each phase and, for each generation of Python's garbage collector, the longest collection:
``phase NAME events N cpu_s S worst_ms MS,MS,MS`` and ``collections generation G number N worst_ms MS garbage N``.
"""

import argparse
import gc
import heapq
import sys
import time
from collections import defaultdict
from pathlib import Path
from typing import Any, Callable, DefaultDict, Dict, List, Tuple

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "bench"), str(ROOT / "src")]

from arguments import positive  # noqa: E402

from retalis import Engine, Term, functor, limit_gc_pauses  # noqa: E402

RULES = "o(X) <- (a(X) seq b(X)) cnot c(X).\n"
STEP_NS = 1_000_000


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument(
        "--matches", type=positive, default=600_000, help="partial matches that wait (600000)"
    )
    parser.add_argument("--default-gc", action="store_true", help="leave Python's garbage collector as it is")
    options = parser.parse_args()
    engine = Engine()
    engine.load(rules=RULES)
    if not options.default_gc:
        limit_gc_pauses()
    number = options.matches
    a, c = functor("a", 1), functor("c", 1)
    collections = Collections()
    measure("waiting", engine, number, 0, a, collections)
    measure("ruled_out", engine, 2 * number, number, lambda place: (c, a)[place % 2](place // 2), collections)


class Collections:
    """Durations of garbage collections."""

    def __init__(self) -> None:
        self.seconds: DefaultDict[int, List[float]] = defaultdict(list)
        self.garbage: DefaultDict[int, int] = defaultdict(int)
        self._began = 0.0
        gc.callbacks.insert(0, self._note)

    def _note(self, phase: str, info: Dict[str, int]) -> None:
        if phase == "start":
            self._began = time.process_time()
        else:
            self.seconds[info["generation"]].append(time.process_time() - self._began)
            self.garbage[info["generation"]] += info["collected"]

    def report(self) -> None:
        """Print the collections since the last report."""
        for generation, seconds in sorted(self.seconds.items()):
            worst = f"worst_ms {1000 * max(seconds):.1f} garbage {self.garbage[generation]}"
            print(f"collections generation {generation} number {len(seconds)} {worst}")
        self.seconds.clear()
        self.garbage.clear()


def measure(
    name: str,
    engine: Engine,
    events: int,
    first: int,
    make: Callable[[int], Term],
    collections: Collections,
) -> None:
    worst: List[Tuple[float, int]] = []
    total = 0.0
    clock: Any = time.process_time
    for place in range(events):
        event, instant = make(place), (first + place) * STEP_NS
        began = clock()
        engine.event_at(event, instant, instant)
        seconds = clock() - began
        total += seconds
        if len(worst) < 3:
            heapq.heappush(worst, (seconds, place))
        elif seconds > worst[0][0]:
            heapq.heapreplace(worst, (seconds, place))
    slowest = ",".join(f"{1000 * seconds:.1f}" for seconds, _ in sorted(worst, reverse=True))
    print(f"phase {name} events {events} cpu_s {total:.2f} worst_ms {slowest}")
    collections.report()


if __name__ == "__main__":
    main()
