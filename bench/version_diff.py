#!/usr/bin/env python3
"""Comparison of two versions of a program over the NAO's bag, beside one run of the program.

    bench/version_diff.py [--seconds N] [--runs N]

The program splits transforms and markers into events, and has 25 rules on joints and 25 on markers. Prints the median
CPU time of `retalis bag` and of `retalis diff` for several differences, in alternating runs. The last rows are for
the NAO's own program, which has memories, so that it is run whole.
"""

import argparse
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Callable, Dict, List, Optional

HERE = Path(__file__).resolve().parent
SOURCE = HERE.parent / "src"
NAO = HERE.parent / "application_source"
sys.path[:0] = [str(HERE), str(SOURCE), str(HERE.parent / "examples" / "nao")]

from arguments import above_zero, positive  # noqa: E402

RULES_PER_TOPIC = 25


def write_program(folder: Path) -> None:
    """Write the program of independent rules."""
    shutil.copytree(NAO, folder, ignore=shutil.ignore_patterns("tests"))
    clauses, _, rest = (folder / "eventRules.txt").read_text().partition("% ---- Pose of a marker")
    assert rest, "the rules of the NAO have another form"
    rules = [clauses]
    goals = [
        "set_etalis_flag(event_consumption_policy, unrestricted)",
        "compile_event_file('eventRules.txt')",
    ]
    for number in range(RULES_PER_TOPIC):
        rules.append(
            f"turned(P, {number}) <- tf(P, '\"Neck\"', _, [_, _, _, W]) where W < {0.5 - number / 100}."
        )
        rules.append(
            f"close(N, {number}) <- ar_marker(_, N, [[X, _, _], _], _, _) where X < {0.5 - number / 100}."
        )
    goals += ["subscribe(turned(_, _), [], _, turns, a)", "subscribe(close(_, _), [], _, markers, b)"]
    (folder / "eventRules.txt").write_text("\n".join(rules) + "\n")
    (folder / "goalPredicates.txt").write_text("\n".join(goals) + "\n")


CHANGES: Dict[str, Callable[[str], str]] = {
    "comment": lambda rules: "% A comment.\n" + rules,
    "rule on markers": lambda rules: rules.replace("X < 0.5", "X < 0.4999"),
    "rule on joints": lambda rules: rules.replace("W < 0.5", "W < 0.4999"),
}
"""Changes of the rules, by their names."""


def cpu_seconds(*arguments: object) -> float:
    """Run the command; return its CPU time.

    Raises:
        SystemExit: if it fails.
    """
    # Packages such as rosbags may be in a folder that only PYTHONPATH names.
    search_path = os.pathsep.join(filter(None, (str(SOURCE), os.environ.get("PYTHONPATH"))))
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    run = subprocess.run(
        [sys.executable, "-m", "retalis", *map(str, arguments)],
        env={**os.environ, "PYTHONPATH": search_path},
        capture_output=True,
        text=True,
    )
    if run.returncode > 1 or "error" in run.stderr:
        raise SystemExit(run.stderr)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main(given: Optional[List[str]] = None) -> int:
    """Run the benchmark that the command line selects."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=above_zero, default=60.0, help="length of the bag")
    parser.add_argument("--runs", type=positive, default=5)
    options = parser.parse_args(given)
    from make_bag import make_bag

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bag = folder / "nao.bag"
        make_bag(str(bag), options.seconds, 1)
        old = folder / "old"
        write_program(old)
        commands: Dict[str, List[object]] = {"retalis bag": ["bag", bag, "--program", old]}
        for number, (title, change) in enumerate(CHANGES.items()):
            new = folder / f"new{number}"
            shutil.copytree(old, new)
            (new / "eventRules.txt").write_text(change((old / "eventRules.txt").read_text()))
            commands[f"retalis diff: {title}"] = ["diff", old, new, bag]
        commands["retalis diff --full"] = ["diff", old, new, bag, "--full"]
        changed_nao = folder / "nao"
        shutil.copytree(NAO, changed_nao)
        with (changed_nao / "eventRules.txt").open("a") as rules:
            rules.write("near(N) <- ar_marker(_, N, [[X, _, _], _], _, _) where X < 0.\n")
        commands["retalis bag: the NAO's program"] = ["bag", bag, "--program", NAO]
        commands["retalis diff: the NAO's program"] = ["diff", NAO, changed_nao, bag]
        seconds: Dict[str, List[float]] = {title: [] for title in commands}
        for _ in range(options.runs):
            for title, arguments in commands.items():
                seconds[title].append(cpu_seconds(*arguments))
        for title, figures in seconds.items():
            print(f"{title:<40}{statistics.median(figures):.2f} s")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
