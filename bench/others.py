"""Benchmark programs in other Python engines: ProbLog's and kanren's.

Each case does the same as that of ``bench/logic.py`` with the same name, as far as possible. ProbLog has no cut and
tables every call, so it has its own programs (``logic/problog.pl``), and no ``tak`` beside the
tabled one; kanren has no arithmetic.
"""

import sys
import time
from pathlib import Path
from typing import Any, Callable

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "src"))

from retalis import limit_gc_pauses  # noqa: E402

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
EDGES = [(n % 1000, n * 7 % 1009) for n in range(10_000, 0, -1)]
TURNS = {"count": 1000}
"""Repetitions per run of a case, if not one."""


def seconds(engine: str, case: str, at_least: float = 1.0) -> float:
    """Return CPU seconds of one repetition of a case."""
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

    text = (Path(__file__).resolve().parent / "logic" / "problog.pl").read_text()
    facts = "\n".join(f"edge({left},{right})." for left, right in EDGES) if case == "join" else ""
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
    facts(edge, *EDGES)
    x, y, z = var(), var(), var()
    return lambda: run(0, z, (edge, 3, x), (edge, x, y), (edge, y, z))
