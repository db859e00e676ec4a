"""Comparison table of all cases of ``bench/engine.py``: terms, messages, other interpreters, the reference engine."""

import argparse
import json
import re
import statistics
import subprocess
import sys
from pathlib import Path
from typing import Any, Dict, List, Sequence

from processes import machine

HERE = Path(__file__).resolve().parent


def compare(
    shared: Sequence[str], more: Sequence[str], from_bytes: Sequence[str], options: argparse.Namespace
) -> int:
    """Run all cases alternately and print a table of medians.

    Args:
        shared: cases that the reference has, too.
        more: the other cases.
        from_bytes: cases that accept serialized messages.
        options: options of the command line.
    """
    rows = {}
    for name in [*shared, *more]:
        commands = _commands(name, options, name in shared, name in from_bytes)
        found: Dict[str, List[float]] = {column: [] for column in commands}
        for _ in range(options.runs):
            for column, command in commands.items():
                found[column].append(measure(command))
        rows[name] = {column: statistics.median(values) for column, values in found.items()}
        print(line(name, rows[name]), flush=True)
    result = {"machine": machine(), "runs": options.runs, "cases": rows}
    if options.json:
        Path(options.json).write_text(json.dumps(result, indent=1) + "\n")
    if options.plot:
        from performance_plots import draw_engine

        draw_engine(result, options.plot)
    return 0


def _commands(name: str, options: argparse.Namespace, shared: bool, from_bytes: bool) -> Dict[str, List[str]]:
    """Return the commands of a case, by table column."""
    ours = [sys.executable, str(HERE / "engine.py"), name]
    commands = {"terms": ours}
    if options.against and shared:
        script = Path(options.against) / "bench.pl"
        commands["reference"] = ["swipl", "-g", f"case({name}),halt", str(script)]
    if from_bytes:
        commands["messages"] = [*ours, "--messages"]
    for python in options.python:
        commands[_version(python)] = [python, *ours[1:]]
    return commands


def _version(python: str) -> str:
    shown = subprocess.run([python, "--version"], capture_output=True, text=True, check=True)
    return shown.stdout.strip().lower()


def measure(command: List[str]) -> float:
    """Run one case in its own process; return microseconds per event."""
    result = subprocess.run(command, capture_output=True, text=True, cwd=HERE)
    found = re.search(r"us_per_event ([\d.]+)", result.stdout)
    if found is None:
        raise SystemExit(f"{' '.join(command)} gave no figure:\n{result.stdout}{result.stderr}")
    return float(found.group(1))


def line(name: str, row: Dict[str, Any]) -> str:
    """Return a table row as text."""
    figures = "  ".join(f"{column} {value:8.2f}" for column, value in row.items())
    ratio = f"  1/{row['reference'] / row['terms']:.1f} of the reference" if "reference" in row else ""
    return f"{name:<26} {figures} us{ratio}"
