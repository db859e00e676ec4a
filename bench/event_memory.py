#!/usr/bin/env python3
"""Memory of a process with partial matches that are never completed, with and without bounds.

bench/event_memory.py CASE N     JSON: a list of [events so far, bytes, partial matches]
bench/event_memory.py --parts N  table: bytes of a partial match by what they are for, among N that wait
"""

import gc
import json
import resource
import subprocess
import sys
import tracemalloc
from pathlib import Path
from typing import Any, Dict, Iterator, List, Tuple

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "src"))

from retalis import Engine, StreamClock, functor  # noqa: E402
from retalis.prolog.terms.timestamps import SECOND  # noqa: E402

SECONDS = 10_000
"""Length of the windows in seconds; one partial match is added per second."""

_PATTERN = "out <- p(X, K) seq q(X, L).\n"
_GENERAL = (
    f"set_etalis_flag(garbage_control, general), set_etalis_flag(garbage_window, {SECONDS}), "
    "set_etalis_flag(garbage_window_step, 100)"
)
CASES = {
    "no bound": ("", _PATTERN),
    "window": ("", f"w([property(event_rule_window, {SECONDS})]) : {_PATTERN}"),
    "within": ("", f"out <- (p(X, K) seq q(X, L)) within {SECONDS}.\n"),
    "garbage control general": (_GENERAL, _PATTERN),
    "garbage control pattern": (
        "set_etalis_flag(garbage_control, pattern)",
        f"w([property(window, {SECONDS}), property(window_step, 100)]) : {_PATTERN}",
    ),
}
CASES.update(
    (
        f"window, {policy}",
        (f"set_etalis_flag(event_consumption_policy, {policy})", CASES["window"][1]),
    )
    for policy in ("recent_2", "chronological", "chronological_2", "unrestricted")
)


def feed(name: str, number: int) -> List[List[int]]:
    """Feed first halves of matches; return samples of events, bytes and partial matches."""
    goals, rules = CASES[name]
    clock = StreamClock(10**9 * SECOND)
    engine = Engine(clock)
    engine.load(goals=goals, rules=rules)
    kind = functor("p", 2)
    samples = [[0, resident(), 0]]
    step = max(1, number // 50)
    for at in range(1, number + 1):
        instant = clock.now() + SECOND
        clock.move_to(instant)
        engine.post((kind, at, at), instant)
        if at % step == 0:
            samples.append([at, resident(), engine.rules.match_count])
    return samples


def resident() -> int:
    """Return the resident bytes of the process."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:  # no Linux: the most it has held so far
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return pages * resource.getpagesize()


def measure_all(number: int) -> Dict[str, Any]:
    """Run each case in its own process."""
    found = {}
    for name in CASES:
        command = [sys.executable, __file__, name, str(number)]
        result = subprocess.run(command, stdout=subprocess.PIPE, check=True)
        found[name] = json.loads(result.stdout)
    return found


def lines(figures: Dict[str, Any]) -> Iterator[str]:
    """Yield the lines of a table."""
    if figures:
        yield f"{'bound':<24} {'events':>9} {'waiting':>9} {'MB more':>9}"
    for name, samples in figures.items():
        events, size, waiting = samples[-1]
        yield f"{name:<24} {events:9} {waiting:9} {(size - samples[0][1]) / 1e6:9.1f}"


PATTERNS = {
    "no key": "out(X, Y) <- p(X) seq q(Y).",
    "key": "out(X) <- p(X) seq q(X).",
    "key, within": f"out(X) <- (p(X) seq q(X)) within {SECONDS * 1000}.",
    "three steps": "out(X) <- p(X) seq q(X) seq r(X).",
}
"""Patterns by name; partial matches of their first steps wait under the policy ``unrestricted``."""


def measure_parts(pattern: str, number: int) -> Tuple[float, Dict[str, float]]:
    """Feed events that complete no match; return the traced bytes per partial match, in total and by purpose."""
    instant = 10**9 * SECOND
    engine = Engine(StreamClock(instant))
    engine.load(goals="set_etalis_flag(event_consumption_policy, unrestricted)", rules=PATTERNS[pattern])
    steps = [functor(name, 1) for name in ("p", "q")[: PATTERNS[pattern].count(" seq ")]]
    gc.collect()
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    for value in range(1000, 1000 + number):
        for step in steps:
            instant += SECOND
            engine.post((step, value), instant)
    gc.collect()
    total = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    rule = engine.rules.rules[0]
    matches = list(rule.arrivals)
    sizes: Dict[str, float] = dict.fromkeys(
        ("match", "parts", "event", "argument", "time", "order", "key"), 0
    )
    counted = set()

    def count(purpose: str, item: Any) -> None:
        # An object with several references counts for the first of them.
        if item is not None and id(item) not in counted:
            counted.add(id(item))
            sizes[purpose] += sys.getsizeof(item)

    while matches:
        match = matches.pop()
        count("match" if match.buffer is not None else "parts", match)
        if match.term is not None:
            count("event", match.term)
            count("argument", match.term[1])
        else:
            count("parts", match.values)
            count("parts", match.parts)
            matches += [part for part in match.parts if id(part) not in counted]
        count("time", match.start)
        count("time", match.end)
        if match.buffer is not None:
            count("order", match.order)
            count("key", match.key)
    tables = [buffer.newest for node, _, _ in rule.nodes for buffer in node.buffers()]
    sizes["table of keys"] = sum(map(sys.getsizeof, tables))
    sizes["arrivals"] = sys.getsizeof(rule.arrivals)
    sizes["expiration"] = sys.getsizeof(rule.expiration_queue.queue)
    sizes["rest"] = total - sum(sizes.values())
    return total / rule.stored_match_count, {
        purpose: size / rule.stored_match_count for purpose, size in sizes.items()
    }


def print_parts(number: int) -> None:
    """Print a table of the bytes of partial matches."""
    measured = {pattern: measure_parts(pattern, number) for pattern in PATTERNS}
    print(" " * 16, *(f"{pattern:>12}" for pattern in PATTERNS))
    for purpose in measured["key"][1]:
        print(f"{purpose:<16}", *(f"{parts[purpose]:12.1f}" for _, parts in measured.values()))
    print(f"{'total':<16}", *(f"{total:12.1f}" for total, _ in measured.values()))


if __name__ == "__main__" and sys.argv[1] == "--parts":
    print_parts(int(sys.argv[2]))
elif __name__ == "__main__":
    json.dump(feed(sys.argv[1], int(sys.argv[2])), sys.stdout)
