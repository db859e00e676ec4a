"""Answers of the suites' goals with nothing compiled, with all of it, and as always: they have to be the same.

Usage: PYTHONPATH=src:test python -m prolog.compilation_modes [PYTEST_ARGUMENT...]

Runs the tests (by default those of the Prolog and of the rules) once in each way and prints where the answers of a
goal, their order, an error or what rules fired are not the same. It is a plugin of pytest in the processes that it
starts; ``compare`` does the same for one program and its goals, for tests.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, Dict, Iterator, List, Tuple

import pytest

from retalis import Engine, PrologError, functor
from retalis.foundation.errors import TermTooLarge
from retalis.prolog.database.predicate import COMPILE_AFTER, NEVER_COMPILE
from retalis.prolog.database.predicate_table import Database
from retalis.prolog.syntax.term_reader import read_program, read_term
from retalis.prolog.syntax.term_writer import write_term
from retalis.prolog.system.prolog_system import PrologSystem
from retalis.prolog.terms.term_traversal import copy, variables

WAYS = {"never": NEVER_COMPILE, "at once": 0, "default": COMPILE_AFTER}
SUITES = (
    "test/prolog",
    "test/events",
    "test/events/knowledge",
    "test/engine/test_engine.py",
    "test/events/program/test_topic_configuration.py",
)
_ERROR = functor("error", 2)


def shown(term: Any) -> str:
    """Return a term as text: variables are named in the order in which they stand, errors have no context."""
    try:
        numbered = copy(term)
    except TermTooLarge:
        return "cyclic"
    for number, var in enumerate(variables(numbered)):
        var.ref = (functor("$VAR", 1), number)
    return write_term(numbered, quoted=True, ignore_ops=True, numbervars=True)


def fault(error: PrologError) -> str:
    """Return what an error says, without the context: it names those that may have made the call."""
    term = error.term
    return "error " + shown(term[1] if term.__class__ is tuple and term[0] is _ERROR else term)


def answers(program: str, goal: str, compile_after: int, most: int = 30) -> List[str]:
    """Return the answers to a goal that is the body of a clause, and those when it is called again."""
    logic = PrologSystem(compile_after=compile_after)
    logic.output = logic.error_output = lambda text: None
    for read in read_program(program, logic.operators, "program"):
        logic.load([(read.term, read.place)], lambda message, place: None)
    read = read_term(goal, logic.operators)
    head = (functor("goal of the test", 1), (functor("v", len(read.names)), *read.names.values()))
    found: List[str] = []
    try:
        logic.add_clause((functor(":-", 2), head, read.term))
        call = copy(head)
        for _ in range(2):
            for at, _ in enumerate(logic.solutions(call)):
                found.append(shown(call))
                if at == most:
                    break
    except PrologError as error:
        found.append(fault(error))
    return found


def compare(program: str, goals: List[str]) -> Dict[str, Dict[str, List[str]]]:
    """Return the goals that are answered differently, with the answers in each way."""
    wrong = {}
    for goal in goals:
        found = {way: answers(program, goal, after) for way, after in WAYS.items()}
        if len({tuple(texts) for texts in found.values()}) > 1:
            wrong[goal] = found
    return wrong


class Recorder:
    """Has everything compiled in one way, and notes for each test what its goals answered and its rules fired."""

    def __init__(self, way: str):
        self.found: Dict[str, List[str]] = {}
        self._lines: List[str] = []
        self._patch(WAYS[way])

    def _patch(self, compile_after: int) -> None:
        init, solutions, made = Database.__init__, PrologSystem.solutions, Engine.__init__
        recorder = self

        def database(self: Any, machine: Any, _: int = 0) -> None:
            init(self, machine, compile_after)

        def noted(self: Any, goal: Any) -> Iterator[None]:
            line: List[str] = [shown(goal)]
            recorder._lines.append(line)  # type: ignore[arg-type]
            inner = solutions(self, goal)
            try:
                for _ in inner:
                    line.append(shown(goal))
                    yield None
            except PrologError as error:
                line.append(fault(error))
                raise
            finally:
                inner.close()  # type: ignore[attr-defined]

        def engine(self: Any, *args: Any, **names: Any) -> None:
            made(self, *args, **names)
            self.on_event(lambda term, start, end: recorder._lines.append(f"{shown(term)} {start} {end}"))

        Database.__init__ = database  # type: ignore[method-assign]
        PrologSystem.solutions = noted  # type: ignore[method-assign]
        Engine.__init__ = engine  # type: ignore[method-assign]

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_call(self, item: Any) -> Iterator[None]:
        """Note what a test does."""
        self._lines = []
        outcome = yield
        result = "failed" if outcome.excinfo else "passed"  # type: ignore[attr-defined]
        self.found[item.nodeid] = [result, *map(str, self._lines)]


def record(way: str, path: str, arguments: List[str]) -> None:
    """Run tests in one way and write what was found to a file."""
    recorder = Recorder(way)
    pytest.main(["-q", "-p", "no:cacheprovider", "--no-header", "--tb=no", *arguments], plugins=[recorder])
    Path(path).write_text(json.dumps(recorder.found))


def differences(arguments: List[str]) -> Tuple[int, List[str]]:
    """Run tests in all ways; return how many, and what differs."""
    found: Dict[str, Dict[str, List[str]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for way in WAYS:
            path = os.path.join(folder, "found.json")
            command = [sys.executable, "-m", "prolog.compilation_modes", "--record", way, path, *arguments]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            found[way] = json.loads(Path(path).read_text())
    report = []
    for test, first in found["default"].items():
        for way in ("never", "at once"):
            other = found[way].get(test, ["missing"])
            # A test of how something is done may fail in another way: its answers count until there.
            end = ["nothing"] if first[0] == other[0] else []
            for one, two in zip([*first[1:], *end], [*other[1:], *end]):
                if one != two:
                    report.append(f"{test}\n  default  {one[:300]}\n  {way:8} {two[:300]}")
                    break
    return len(found["default"]), report


def main() -> None:
    """Compare."""
    if sys.argv[1:2] == ["--record"]:
        record(sys.argv[2], sys.argv[3], sys.argv[4:])
        return
    count, report = differences(sys.argv[1:] or list(SUITES))
    print("\n".join(report))
    print(f"{count} tests, {len(report)} differences")
    sys.exit(bool(report))


if __name__ == "__main__":
    main()
