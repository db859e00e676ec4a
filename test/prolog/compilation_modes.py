"""Comparison of the answers of the suites' goals: interpreted, compiled at once, and by default.

Usage: PYTHONPATH=src:test python -m prolog.compilation_modes [PYTEST_ARGUMENT...]

Runs the tests (by default those of Prolog and of the rules) once in each mode and prints differences: of answers,
their order, errors or events. It is a plugin of pytest in the processes that it starts; ``compare`` does the same for
one program and its goals, for tests.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, Dict, Iterator, List, Tuple

import pytest
from parsing import read_clauses

from retalis import Engine, PrologError, functor
from retalis.foundation.errors import TermTooLarge
from retalis.prolog.database.predicate import COMPILE_AFTER, NEVER_COMPILE
from retalis.prolog.database.predicate_database import Database
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.syntax.term_writer import write_term
from retalis.prolog.system.prolog_system import PrologSystem
from retalis.prolog.terms.term_traversal import copy, variables

MODES = {"never": NEVER_COMPILE, "at once": 0, "default": COMPILE_AFTER}
SUITES = (
    "test/prolog",
    "test/events",
    "test/events/knowledge",
    "test/engine/test_engine.py",
    "test/events/program/test_topic_configuration.py",
)
_ERROR = functor("error", 2)


def shown(term: Any) -> str:
    """Return a term as text with its variables named in order."""
    try:
        numbered = copy(term)
    except TermTooLarge:
        return "cyclic"
    for number, var in enumerate(variables(numbered)):
        var.ref = (functor("$VAR", 1), number)
    return write_term(numbered, quoted=True, ignore_ops=True, numbervars=True)


def fault(error: PrologError) -> str:
    """Return the text of an error without its context, which names possible callers."""
    term = error.term
    return "error " + shown(term[1] if term.__class__ is tuple and term[0] is _ERROR else term)


def answers(
    program: str, goal: str, compile_after: int, limit: int = 30, counts_uses: bool = False
) -> List[str]:
    """Return the answers of two calls of a goal that is the body of a clause."""
    logic = PrologSystem(compile_after=compile_after, counts_uses=counts_uses)
    logic.output = logic.error_output = lambda text: None
    for clause in read_clauses(program, logic.operators, "program"):
        logic.load([(clause.term, clause.place)], lambda message, place: None)
    read = read_term(goal, logic.operators)
    head = (functor("goal of the test", 1), (functor("v", len(read.names)), *read.names.values()))
    results: List[str] = []
    try:
        logic.add_clause((functor(":-", 2), head, read.term))
        call = copy(head)
        for _ in range(2):
            for index, _ in enumerate(logic.solutions(call)):
                results.append(shown(call))
                if index == limit:
                    break
    except PrologError as error:
        results.append(fault(error))
    return results


def compare(program: str, goals: List[str]) -> Dict[str, Dict[str, List[str]]]:
    """Return the goals whose answers differ, with the answers in each mode."""
    differing: Dict[Any, Any] = {}
    for goal in goals:
        results = {mode: answers(program, goal, compile_after) for mode, compile_after in MODES.items()}
        # The clauses of the program count their uses, as for the coverage by tests.
        results["counted"] = answers(program, goal, COMPILE_AFTER, counts_uses=True)
        if len({tuple(texts) for texts in results.values()}) > 1:
            differing[goal] = results
    return differing


class Recorder:
    """Plugin of pytest that sets the mode of compilation, and records the answers and events of each test."""

    def __init__(self, mode: str) -> None:
        self.results: Dict[str, List[str]] = {}
        self._lines: List[Any] = []
        self._patch(MODES[mode])

    def _patch(self, compile_after: int) -> None:
        init, solutions, init_engine = Database.__init__, PrologSystem.solutions, Engine.__init__
        recorder = self

        def database(self: Any, machine: Any, _: int, *functions: Any) -> None:
            init(self, machine, compile_after, *functions)

        def record_solutions(self: Any, goal: Any) -> Iterator[None]:
            line: List[str] = [shown(goal)]
            recorder._lines.append(line)
            inner = solutions(self, goal)
            try:
                for _ in inner:
                    line.append(shown(goal))
                    yield None
            except PrologError as error:
                line.append(fault(error))
                raise
            finally:
                inner.close()

        def engine(self: Any, *args: Any, **names: Any) -> None:
            init_engine(self, *args, **names)
            self.on_event(lambda term, start, end: recorder._lines.append(f"{shown(term)} {start} {end}"))

        # For the rest of the process: the plugin is loaded before the tests.
        for owner, name, replacement in (
            (Database, "__init__", database),
            (PrologSystem, "solutions", record_solutions),
            (Engine, "__init__", engine),
        ):
            setattr(owner, name, replacement)

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_call(self, item: Any) -> Iterator[None]:
        """Record the result, answers and events of a test."""
        self._lines = []
        outcome = yield
        result = "failed" if outcome.excinfo else "passed"  # type: ignore[attr-defined]
        self.results[item.nodeid] = [result, *map(str, self._lines)]


def record(mode: str, path: str, arguments: List[str]) -> None:
    """Run tests in one mode and write the recorded results to a file."""
    recorder = Recorder(mode)
    pytest.main(["-q", "-p", "no:cacheprovider", "--no-header", "--tb=no", *arguments], plugins=[recorder])
    Path(path).write_text(json.dumps(recorder.results))


def differences(arguments: List[str]) -> Tuple[int, List[str]]:
    """Run tests in all modes; return their number and the differences."""
    results: Dict[str, Dict[str, List[str]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for mode in MODES:
            path = os.path.join(folder, "results.json")
            command = [sys.executable, "-m", "prolog.compilation_modes", "--record", mode, path, *arguments]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            results[mode] = json.loads(Path(path).read_text())
    report: List[Any] = []
    for test, first in results["default"].items():
        for mode in ("never", "at once"):
            others = results[mode].get(test, ["missing"])
            # A test of the compilation itself may fail in another mode: its answers are compared up to there.
            end = ["nothing"] if first[0] == others[0] else []
            for expected, result in zip([*first[1:], *end], [*others[1:], *end]):
                if expected != result:
                    report.append(f"{test}\n  default  {expected[:300]}\n  {mode:8} {result[:300]}")
                    break
    return len(results["default"]), report


def main() -> None:
    """Compare the modes and print the differences."""
    if sys.argv[1:2] == ["--record"]:
        record(sys.argv[2], sys.argv[3], sys.argv[4:])
        return
    count, report = differences(sys.argv[1:] or list(SUITES))
    print("\n".join(report))
    print(f"{count} tests, {len(report)} differences")
    sys.exit(bool(report))


if __name__ == "__main__":
    main()
