#!/usr/bin/env python3
"""Five workloads in three systems: the engine, a handwritten loop, and ROS message_filters.

    bench/other_systems.py [--work NAME ...] [--events N] [--runs N] [--ros PYTHON] [--json FILE] [--markdown]

    keyed    for each key, b less than a minute after a; ten thousand keys wait
    absence  the same without a c in between
    sliding  for each of a hundred keys, count and mean of the last ten seconds, at each reading; the loop
             keeps a running total of floats, in which rounding errors add up
    exact    the same with an exact mean in both systems: the loop sums the whole window with math.fsum
    pairs    l and r less than 50 ms apart, each used once

All systems get the same streams, which are created before the measurement. Each run is its own process; the systems
alternate. The figures are medians of CPU time. The number of results has to be that of the loop, except for
message_filters, which has its own definition of the nearest pair. A system that is not installed is omitted with a
message.
"""

import argparse
import json
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "src")]

from arguments import interpreter, positive, target  # noqa: E402
from other_systems_sides import SIDES, STREAMS  # noqa: E402

from retalis import limit_gc_pauses  # noqa: E402

MISSING = 3
"""Exit status of a run whose system is not available."""

OWN_IDEA = ("message_filters",)
"""Systems that may have another number of results."""

Figures = Dict[str, Dict[str, Any]]


def measure(side: str, work: str, events: int) -> Dict[str, Any]:
    """Run one system in this process; return microseconds per event and the number of results."""
    count = [0]

    def emit(*_: Any) -> None:
        count[0] += 1

    run = SIDES[side](work, STREAMS[work](events), emit)
    limit_gc_pauses()
    began = time.process_time()
    run()
    return {"us": (time.process_time() - began) / events * 1e6, "results": count[0]}


def compare(work: str, pythons: Dict[str, str], events: int, runs: int) -> Figures:
    """Run all systems on a workload alternately; return their medians, and the reasons for omitted ones."""
    found: Dict[str, List[Dict[str, Any]]] = {side: [] for side in pythons}
    missing: Figures = {}
    for _ in range(runs):
        for side, python in pythons.items():
            if side in missing:
                continue
            command = [
                python,
                str(HERE / "other_systems.py"),
                "--work",
                work,
                "--side",
                side,
                "--events",
                str(events),
            ]
            ran = subprocess.run(command, capture_output=True, text=True)
            if ran.returncode == MISSING:
                missing[side] = {"missing": ran.stdout.strip()}
            elif ran.returncode:
                raise SystemExit(f"{' '.join(command)} failed:\n{ran.stderr}")
            else:
                found[side].append(json.loads(ran.stdout))
    figures = {side: _median(side, work, each) for side, each in found.items() if each}
    wanted = figures["loop"]["results"]
    for side, one in figures.items():
        if side not in OWN_IDEA and one["results"] != wanted:
            raise SystemExit(f"{work}: {side} gives {one['results']} results, the loop {wanted}")
    return {**figures, **missing}


def _median(side: str, work: str, each: List[Dict[str, Any]]) -> Dict[str, Any]:
    numbers = {one["results"] for one in each}
    if len(numbers) != 1:
        raise SystemExit(f"{work}: {side} gives another number of results in each run: {sorted(numbers)}")
    return {"us": statistics.median(one["us"] for one in each), "results": numbers.pop()}


def rows(found: Dict[str, Figures], markdown: bool) -> List[str]:
    """Return the lines of the table."""
    lines = []
    for work, figures in found.items():
        loop = figures["loop"]["us"]
        cells = [cell(figures.get(side, {}), loop) for side in SIDES]
        shown = [work, *cells, f"{figures['loop']['results']:,}"]
        lines.append(
            f"| `{shown[0]}` | {' | '.join(shown[1:])} |"
            if markdown
            else "  ".join(f"{one:>24}" for one in shown)
        )
    head = ["work", *SIDES, "results"]
    if markdown:
        return [f"| {' | '.join(head)} |", "| --- |" + " ---: |" * (len(head) - 1), *lines]
    return ["  ".join(f"{one:>24}" for one in head), *lines]


def cell(figures: Dict[str, Any], loop: float) -> str:
    """Return microseconds and their ratio to those of the loop."""
    if "us" not in figures:
        return "–"
    return f"{figures['us']:.2f} ({figures['us'] / loop:.1f})"


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the benchmark that the command line selects."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--work", nargs="+", choices=STREAMS, default=list(STREAMS))
    parser.add_argument("--events", type=positive, default=200_000)
    parser.add_argument("--runs", type=positive, default=5)
    parser.add_argument("--ros", type=interpreter, default="/usr/bin/python3", help="a Python that has rospy")
    parser.add_argument("--json", type=target)
    parser.add_argument("--markdown", action="store_true", help="write the table as the pages have it")
    parser.add_argument("--side", choices=SIDES, help="run only that one, once, in this process")
    options = parser.parse_args(arguments)
    if options.side:
        try:
            print(json.dumps(measure(options.side, options.work[0], options.events)))
        except ImportError as error:
            print(error)
            return MISSING
        return 0
    pythons = dict.fromkeys(SIDES, sys.executable)
    pythons["message_filters"] = options.ros
    found = {work: compare(work, pythons, options.events, options.runs) for work in options.work}
    print("\n".join(rows(found, options.markdown)))
    for work, figures in found.items():
        for side, one in figures.items():
            if "missing" in one:
                print(f"{work}: without {side}: {one['missing']}")
            elif one["results"] != figures["loop"]["results"]:
                print(f"{work}: {side} gives {one['results']:,} results")
    if options.json:
        options.json.write_text(
            json.dumps({"events": options.events, "runs": options.runs, "work": found}, indent=1)
        )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
