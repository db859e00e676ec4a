"""Speed of the Prolog on classic programs, beside SWI-Prolog and the engines of ProbLog and kanren.

Usage: bench/logic.py [--python PYTHON]... [--runs N] [--json FILE] [CASE...]

Each figure is measured in its own process, engines alternately, with the garbage collector set as in a node; the
table shows medians of the runs. An engine that is not installed, or cannot run a case, leaves its column
empty. ``--one ENGINE CASE`` prints a single figure.
"""

import argparse
import json
import platform
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Callable, Dict, List, Optional

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "src")]

from arguments import interpreter, positive, target  # noqa: E402

from retalis import limit_gc_pauses  # noqa: E402
from retalis.prolog.syntax.term_reader import read_program, read_term  # noqa: E402
from retalis.prolog.system.prolog_system import PrologSystem  # noqa: E402

PROGRAMS = HERE / "logic" / "programs.pl"
OURS = "retalis"
COLUMNS = "swipl", "problog", "kanren"
LONGEST = 600
"""Seconds after which a run is aborted."""

INFERENCES = 496
"""Inferences of one naive reverse of 30 elements."""

# Case -> goal and the repetitions that make about half a second here, and in SWI-Prolog.
CASES = {
    "nrev": ("bench_nrev({n})", 2000, 40000),
    "tak": ("bench_tak({n})", 8, 60),
    "tabled": ("bench_tabled({n})", 80, 200),
    "queens": ("bench_queens({n})", 200, 4000),
    "zebra": ("bench_zebra({n})", 20, 500),
    "deriv": ("bench_deriv({n})", 20000, 400000),
    "primes": ("bench_primes({n})", 1500, 15000),
    "crypt": ("bench_crypt({n})", 400, 5000),
    "join": ("bench_join({n})", 400, 10000),
    "assert": ("bench_assert({n})", 40000, 400000),
    "findall": ("bench_findall({n})", 400, 5000),
    "split": ("bench_split({n})", 200000, 1500000),
    "count": ("bench_count({n})", 1000000, 10000000),
    "findall_numbers": ("bench_findall_numbers({n})", 20, 80),
    "findall_pairs": ("bench_findall_pairs({n})", 10, 40),
    "findall_member": ("bench_findall_member({n})", 10, 40),
    "findall_test": ("bench_findall_test({n})", 10, 40),
    "bagof": ("bench_bagof({n})", 10, 40),
    "sort_numbers": ("bench_sort_numbers({n})", 10, 20),
    "sort_atoms": ("bench_sort_atoms({n})", 5, 10),
    "sort_pairs": ("bench_sort_pairs({n})", 6, 10),
    "sort_mixed": ("bench_sort_mixed({n})", 6, 10),
    "keysort": ("bench_keysort({n})", 5, 20),
    "predsort": ("bench_predsort({n})", 4, 20),
    "list_to_assoc": ("bench_list_to_assoc({n})", 8, 10),
    "put_assoc": ("bench_put_assoc({n})", 8, 20),
    "get_assoc": ("bench_get_assoc({n})", 20, 50),
    "assoc_to_list": ("bench_assoc_to_list({n})", 20, 80),
}


# These cases do the same as those above with the same names, as far as possible. ProbLog has no cut and tables every
# call, so it has its own programs (`logic/problog.pl`), and no `tak` beside the tabled one; kanren has no arithmetic.
PROBLOG_CASES = [
    "nrev",
    "queens",
    "zebra",
    "deriv",
    "primes",
    "crypt",
    "join",
    "findall",
    "split",
    "count",
    "tabled",
]
KANREN_CASES = ["nrev", "join"]
_EDGES = [(n % 1000, n * 7 % 1009) for n in range(10_000, 0, -1)]
TURNS = {"count": 1000}
"""Repetitions per run of a case, if not one."""


def load() -> PrologSystem:
    """Return a Prolog with the programs of all cases."""
    logic = PrologSystem()
    for read in read_program(PROGRAMS.read_text(), logic.operators, str(PROGRAMS)):
        logic.load([(read.term, read.place)], lambda message, place: sys.exit(f"{place}: {message}"))
    return logic


def ours(case: str) -> float:
    """Return CPU seconds of one repetition in this package."""
    logic = load()
    goal, count, _ = CASES[case]
    limit_gc_pauses()
    logic.once(read_term(goal.format(n=max(1, count // 20)), logic.operators).term)
    before = time.process_time()
    if not logic.once(read_term(goal.format(n=count), logic.operators).term):
        raise SystemExit(f"{case} failed")
    return (time.process_time() - before) / count


def swipl(case: str) -> float:
    """Return CPU seconds of one repetition in SWI-Prolog."""
    goal, _, count = CASES[case]
    program = (
        f"statistics(cputime,A),{goal.format(n=count)},statistics(cputime,B),T is (B-A)/{count},print(T),nl"
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "programs.pl"
        path.write_text(PROGRAMS.read_text())
        command = ["swipl", "-O", "-q", "-l", str(path), "-g", program, "-t", "halt"]
        return float(subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout)


def theirs(engine: str, case: str, at_least: float = 1.0) -> float:
    """Return CPU seconds of one repetition of a case in ProbLog's or kanren's engine."""
    run = {"problog": problog, "kanren": kanren}[engine](case)
    limit_gc_pauses()
    began = time.process_time()
    count = 0
    while time.process_time() - began < at_least:
        if not run():
            raise SystemExit(f"{case} failed")
        count += 1
    return (time.process_time() - began) / count / TURNS.get(case, 1)


def problog(case: str) -> Callable[[], Any]:
    """Return a function that runs a case once in ProbLog's engine."""
    from problog.engine import DefaultEngine
    from problog.logic import Term
    from problog.program import PrologString

    text = (HERE / "logic" / "problog.pl").read_text()
    facts = "\n".join(f"edge({left},{right})." for left, right in _EDGES) if case == "join" else ""
    engine = DefaultEngine()
    program = engine.prepare(PrologString(text + facts))
    return lambda: engine.query(program, Term(f"case_{case}"))


def kanren(case: str) -> Callable[[], Any]:
    """Return a function that runs a case once in kanren's engine."""
    from kanren import Relation, conde, eq, facts, run, var
    from kanren.goals import conso

    def append(left: Any, right: Any, both: Any) -> Any:
        head, tail, rest = var(), var(), var()
        step = [(conso, head, tail, left), (conso, head, rest, both), (append, tail, right, rest)]
        return (conde, [(eq, left, ()), (eq, right, both)], step)

    def reverse(items: Any, result: Any) -> Any:
        head, tail, rest = var(), var(), var()
        step = [(conso, head, tail, items), (reverse, tail, rest), (append, rest, (head,), result)]
        return (conde, [(eq, items, ()), (eq, result, ())], step)

    if case == "nrev":
        result = var()
        return lambda: run(1, result, (reverse, tuple(range(1, 31)), result))
    edge = Relation()
    facts(edge, *_EDGES)
    x, y, z = var(), var(), var()
    return lambda: run(0, z, (edge, 3, x), (edge, x, y), (edge, y, z))


def one(engine: str, case: str) -> float:
    """Return CPU seconds of one repetition of a case in an engine."""
    if engine == OURS:
        return ours(case)
    return swipl(case) if engine == "swipl" else theirs(engine, case)


def can_run(engine: str, case: str) -> bool:
    """Return whether an engine is installed and has the case."""
    if engine == "swipl":
        return shutil.which("swipl") is not None
    cases = {"problog": PROBLOG_CASES, "kanren": KANREN_CASES}[engine]
    return case in cases and find_spec(engine) is not None


def in_process(python: str, engine: str, case: str) -> float:
    """Return microseconds of one repetition, measured in its own process."""
    command = [python, str(Path(__file__).resolve()), "--one", engine, case]
    result = subprocess.run(command, stdout=subprocess.PIPE, check=True, timeout=LONGEST)
    return float(result.stdout) * 1e6


def version(python: str) -> str:
    """Return the column name of an interpreter."""
    command = [python, "-c", "import sys; print('%d.%d' % sys.version_info[:2])"]
    return f"{OURS} {subprocess.run(command, stdout=subprocess.PIPE, check=True, text=True).stdout.strip()}"


def measure(case: str, pythons: Dict[str, str], runs: int) -> Dict[str, Dict[str, float]]:
    """Return median and best microseconds of a case by column."""
    times: Dict[str, List[float]] = {}
    for number in range(runs):
        for name, python in pythons.items():
            times.setdefault(name, []).append(in_process(python, OURS, case))
        for engine in COLUMNS:
            # What takes a thousand times as long needs no second run.
            if can_run(engine, case) and (engine == "swipl" or not number):
                times.setdefault(engine, []).append(in_process(sys.executable, engine, case))
    return {
        name: {"median": statistics.median(found), "best": min(found), "runs": len(found)}
        for name, found in times.items()
    }


def table_row(case: str, found: Dict[str, Dict[str, float]], columns: List[str]) -> str:
    """Return a row: microseconds by column, and the ratio to this package."""
    cells = [figure(found.get(name)) for name in columns]
    mine = found[columns[0]]["median"]
    cells.append(f"{mine / found['swipl']['median']:.1f}" if "swipl" in found else "")
    cells += [f"{found[name]['median'] / mine:.0f}" if name in found else "" for name in COLUMNS[1:]]
    return f"| `{case}` | " + " | ".join(cells) + " |"


def figure(found: Optional[Dict[str, float]]) -> str:
    """Return microseconds with three digits."""
    if found is None:
        return ""
    value = found["median"]
    return f"{value:.3g}" if value < 100 else f"{value:,.0f}"


def compare(options: argparse.Namespace) -> None:
    """Print a row for each case."""
    pythons = {version(python): python for python in [sys.executable, *options.python]}
    columns = [*pythons, *COLUMNS]
    ratios = ["of swipl", "problog of ours", "kanren of ours"]
    print("| case | " + " | ".join([*columns, *ratios]) + " |")
    print("| --- |" + " ---: |" * (len(columns) + len(ratios)), flush=True)
    rows: Dict[str, Any] = {}
    for case in options.cases or CASES:
        rows[case] = measure(case, pythons, options.runs)
        print(table_row(case, rows[case], columns), flush=True)
    if "nrev" in rows:
        speeds = {
            name: (INFERENCES / found["median"], INFERENCES / found["best"])
            for name, found in rows["nrev"].items()
        }
        print("\nmillion inferences a second of nrev, median and best:")
        for name, (median, best) in speeds.items():
            print(f"{name}: {median:.3g}, {best:.3g}")
    if options.json:
        system = {"machine": platform.processor() or platform.machine(), "runs": options.runs}
        Path(options.json).write_text(json.dumps({**system, "us": rows}, indent=1) + "\n")


def main() -> None:
    """Run the benchmark that the command line selects."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("cases", nargs="*", metavar="CASE", help=", ".join(CASES))
    parser.add_argument(
        "--python", type=interpreter, action="append", default=[], help="another interpreter for ours"
    )
    parser.add_argument("--runs", type=positive, default=5, help="runs of each cell")
    parser.add_argument("--json", type=target, metavar="FILE", help="write the figures to a file")
    parser.add_argument("--one", nargs=2, metavar=("ENGINE", "CASE"), help="print seconds of a repetition")
    options = parser.parse_args()
    engine, *named = options.one or [OURS]
    unknown = [case for case in (*options.cases, *named) if case not in CASES]
    if unknown:
        parser.error(f"there is no case {unknown[0]}")
    if engine != OURS and not (engine in COLUMNS and can_run(engine, named[0])):
        parser.error(f"there is no engine {engine}, or not for this case")
    if options.one:
        print(one(*options.one))
    else:
        compare(options)


if __name__ == "__main__":
    main()
