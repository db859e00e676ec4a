"""Memory and time of rules with drifting keys: each key occurs in two successive events only.

Each rule runs in a process of its own. Events are 10 ms apart, so a time to live of 10 s holds 1,000 events. With
``--capped`` the rules have no time to live, and the flag ``max_keys`` bounds them. The resident memory after each
fifth of the events is compared with that after the first fifth, when the memory has warmed up.

    PYTHONPATH=src python3 bench/drifting_keys.py --events 2000000
"""

import argparse
import subprocess
import sys
import time
from typing import List

from retalis import Engine, functor
from retalis.prolog.machine.resource_limits import resident_bytes

RULES = {
    "steps": "aggregate(count, q(K, V), X, steps([up where V == 0, later(down) where V == 2]))",
    "last": "aggregate(avg(V), q(K, V), X, last(3, events))",
    "every": "aggregate(avg(V), q(K, V), X, every(3, events))",
    "change": "q(K, X) with change(X, K)",
    "sliding": "aggregate(avg(V), q(K, V), X, last(10))",
    "tumbling": "aggregate(avg(V), q(K, V), X, every(10))",
    "first": "aggregate(avg(V), q(K, V), X, every(10, first))",
    "throttle": "q(K, X) with throttle(10, K)",
    "sequence": "q(K, 0) seq q(K, X) where X == 2",
    "group": "q(K, 0) seq aggregate(sum(V), q(K, V), X)",
}
EVENT = functor("q", 2)
PARTS = 5


def run(kind: str, events: int, capped: bool) -> List[str]:
    """Feed the events to a rule; return its table row."""
    engine = Engine()
    label = "r" if capped else "r([property(ttl, 10)])"
    engine.load(rules=f"{label} : found(K, X) <- {RULES[kind]}.")
    if capped:
        engine.call(f"set_etalis_flag(max_keys, {max(1, events // 40)})")
    resident = []
    begin = time.process_time()
    for part in range(PARTS):
        for at in range(part * events // PARTS, (part + 1) * events // PARTS):
            engine.event(EVENT(at // 2, at % 2), at / 100, at / 100)
        resident.append(resident_bytes() / 1e6)
    seconds = time.process_time() - begin
    (rule,) = engine.status().rules
    growth = 100 * (max(resident[1:]) / resident[0] - 1)
    return [
        kind,
        " ".join(f"{one:.1f}" for one in resident),
        f"{growth:+.1f} %",
        f"{seconds / events * 1e6:.2f}",
        f"{rule.waiting}",
        f"{rule.keys}",
        f"{rule.bytes / 1e6:.2f}",
    ]


def main() -> None:
    """Run each rule in its own process, and print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--events", type=int, default=2_000_000, help="events for each rule")
    parser.add_argument("--capped", action="store_true", help="bound the keys by number, not by time")
    parser.add_argument("--only", choices=RULES, help=argparse.SUPPRESS)
    parser.add_argument("kinds", nargs="*", help=f"rules, of {', '.join(RULES)}; all by default")
    options = parser.parse_args()
    if options.only:
        print("| " + " | ".join(run(options.only, options.events, options.capped)) + " |")
        return
    print("| rule | resident MB after each fifth | growth | µs an event | items | keys | estimated MB |")
    print("| --- | --- | --- | --- | --- | --- | --- |", flush=True)
    for kind in options.kinds or RULES:
        command = [sys.executable, __file__, "--only", kind, "--events", str(options.events)]
        subprocess.run([*command, *(["--capped"] if options.capped else [])], check=True)


if __name__ == "__main__":
    main()
