"""Times the Prolog: classic programs, and the same text in SWI-Prolog where it is installed.

Usage: python bench/logic.py [--swi] [--json FILE] [CASE...]
"""

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "src"))

from retalis.logic import Logic  # noqa: E402
from retalis.syntax import read_program, read_term  # noqa: E402

PROGRAMS = Path(__file__).resolve().parent / "logic"

# Case -> goal and the repetitions that make about a second here, and in SWI-Prolog.
CASES = {
    "nrev": ("bench_nrev({n})", 2000, 40000),
    "tak": ("bench_tak({n})", 4, 60),
    "queens": ("bench_queens({n})", 4, 100),
    "zebra": ("bench_zebra({n})", 4, 100),
    "deriv": ("bench_deriv({n})", 20000, 800000),
    "primes": ("bench_primes({n})", 40, 1500),
    "crypt": ("bench_crypt({n})", 60, 2500),
    "join": ("bench_join({n})", 8, 200),
    "assert": ("bench_assert({n})", 60000, 600000),
    "findall": ("bench_findall({n})", 60, 2000),
    "split": ("bench_split({n})", 20000, 1000000),
    "count": ("bench_count({n})", 4000000, 20000000),
}


def load() -> Logic:
    """Return a Prolog with the programs of all cases."""
    logic = Logic()
    path = PROGRAMS / "programs.pl"
    for read in read_program(path.read_text(), logic.operators, str(path)):
        logic.load([(read.term, read.place)], lambda message, place: sys.exit(f"{place}: {message}"))
    return logic


def ours(logic: Logic, case: str) -> float:
    """Return seconds of one repetition here."""
    goal, count, _ = CASES[case]
    logic.once(read_term(goal.format(n=max(1, count // 20)), logic.operators).term)
    before = time.process_time()
    if not logic.once(read_term(goal.format(n=count), logic.operators).term):
        raise SystemExit(f"{case} failed")
    return (time.process_time() - before) / count


def theirs(case: str) -> float:
    """Return seconds of one repetition in SWI-Prolog."""
    goal, _, count = CASES[case]
    program = (
        f"statistics(cputime,A),{goal.format(n=count)},statistics(cputime,B),T is (B-A)/{count},print(T),nl"
    )
    text = (PROGRAMS / "programs.pl").read_text()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "programs.pl"
        path.write_text(text)
        command = ["swipl", "-O", "-q", "-l", str(path), "-g", program, "-t", "halt"]
        return float(subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout)


def main() -> None:
    """Print a row for each case."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", nargs="*", metavar="CASE")
    parser.add_argument("--swi", action="store_true", help="run SWI-Prolog as well")
    parser.add_argument("--json", metavar="FILE", help="write the figures to a file")
    options = parser.parse_args()
    if options.swi and shutil.which("swipl") is None:
        parser.error("swipl is not installed")
    logic = load()
    rows = {}
    for case in options.cases or CASES:
        row = rows[case] = {"us": ours(logic, case) * 1e6}
        note = f"  {496 / row['us']:6.2f} million inferences/s" if case == "nrev" else ""
        if options.swi:
            row["swi_us"] = theirs(case) * 1e6
            note = f"  swi {row['swi_us']:10.3f}  ratio {row['us'] / row['swi_us']:6.1f}{note}"
        print(f"{case:8} {row['us']:12.3f} us{note}", flush=True)
    if options.json:
        Path(options.json).write_text(json.dumps({"python": sys.version.split()[0], "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
