#!/usr/bin/env python3
"""Memory of a process with partial matches that are never completed, with and without bounds.

bench/event_memory.py CASE N     JSON: a list of [events so far, bytes, partial matches]
"""

import json
import resource
import subprocess
import sys
from pathlib import Path
from typing import Any, Dict, Iterator, List

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
            samples.append([at, resident(), engine.rules.waiting])
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


if __name__ == "__main__":
    json.dump(feed(sys.argv[1], int(sys.argv[2])), sys.stdout)
