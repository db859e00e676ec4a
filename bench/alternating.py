#!/usr/bin/env python3
"""Comparison of two checkouts: the cases of ``bench/engine.py`` in alternating order.

    bench/alternating.py BEFORE [--case NAME ...] [--runs N] [--most PERCENT] [--python PATH]

BEFORE is a revision of this repository, or the folder of another checkout. Each checkout runs
the cases of its own ``bench/engine.py`` in alternating order. The best CPU time of each counts, because other load on
the machine can only increase it. A case that seems slower is run up to four times as often.

Prints a line for each case: microseconds per event before and now, and the change. The exit status is 1 if a case has
become slower by more than ``--most`` percent (3).
"""

import argparse
import subprocess
import sys
import tempfile
from contextlib import contextmanager
from pathlib import Path
from typing import Iterator, List, NamedTuple, Optional, Sequence

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

from arguments import above_zero, interpreter, positive  # noqa: E402
from engine import CASES, MORE, measure  # noqa: E402

ROOT = HERE.parent
TRIES = 4


class Change(NamedTuple):
    """Microseconds per event of a case in both checkouts."""

    name: str
    before: float
    now: float

    @property
    def percent(self) -> float:
        """Increase in percent."""
        return 100 * (self.now / self.before - 1)

    def line(self) -> str:
        """Return a table row as text."""
        return f"{self.name:<26} before {self.before:8.3f}  now {self.now:8.3f} us  {self.percent:+6.1f} %"


@contextmanager
def checkout(before: str, root: Path) -> Iterator[Path]:
    """Provide the folder of a checkout, which is temporary if a revision was given."""
    if Path(before).is_dir():
        yield Path(before).resolve()
        return
    packed = subprocess.run(["git", "-C", str(root), "archive", "--format=tar", before], capture_output=True)
    if packed.returncode:
        raise SystemExit(f"{before} is neither a folder nor a revision: {packed.stderr.decode().strip()}")
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(["tar", "-x", "-C", folder], input=packed.stdout, check=True)
        yield Path(folder)


def known_to(folder: Path, names: Sequence[str]) -> List[str]:
    """Return the cases that a checkout has."""
    script = folder / "bench" / "engine.py"
    if not script.is_file():
        raise SystemExit(f"there is no {script}")
    text = script.read_text(encoding="utf-8")
    return [name for name in names if f'"{name}"' in text]


def compare(python: str, folders: Sequence[Path], name: str, runs: int, most: float) -> Change:
    """Run a case in two checkouts alternately; the best run of each counts.

    Args:
        python: the interpreter.
        folders: the former checkout and the present one.
        name: name of the case.
        runs: number of runs of each; repeated up to `TRIES` times if the case seems slower.
        most: percentage above which a case counts as slower.
    """
    found: List[List[float]] = [[], []]
    for _ in range(TRIES):
        for _ in range(runs):
            for figures, folder in zip(found, folders):
                figures.append(measure([python, str(folder / "bench" / "engine.py"), name]))
        change = Change(name, min(found[0]), min(found[1]))
        if change.percent <= most:
            break
    return change


def main(arguments: Optional[Sequence[str]] = None, root: Path = ROOT) -> int:
    """Run the comparison that the command line selects, in the checkout at ``root``."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("before", metavar="BEFORE")
    parser.add_argument("--case", nargs="+", choices=[*CASES, *MORE], default=[*CASES, *MORE])
    parser.add_argument("--runs", type=positive, default=5)
    parser.add_argument(
        "--most", type=above_zero, default=3.0, help="percent that a case may become slower by"
    )
    parser.add_argument("--python", type=interpreter, default=sys.executable)
    options = parser.parse_args(arguments)
    slower = []
    with checkout(options.before, root) as folder:
        known = known_to(folder, options.case)
        for name in options.case:
            if name not in known:
                print(f"{name:<26} is not there before")
                continue
            change = compare(options.python, (folder, root), name, options.runs, options.most)
            print(change.line(), flush=True)
            if change.percent > options.most:
                slower.append(name)
    if slower:
        print(f"slower by more than {options.most:g} %: {', '.join(slower)}")
    return 1 if slower else 0


if __name__ == "__main__":
    raise SystemExit(main())
