"""Comparison of the answers to goals with those of the ISO standard.

Usage: python iso_conformity.py       print the differences
"""

import functools
from pathlib import Path
from typing import Any, Iterator, List, NamedTuple, Tuple

from retalis import Limits, PrologError, SyntaxFault, Term, atom, deref, functor, list_items, make_list
from retalis.prolog.syntax.term_reader import ReadTerm, read_program, read_term
from retalis.prolog.syntax.term_writer import write_term
from retalis.prolog.syntax.tokenizer import ReadFlags
from retalis.prolog.system.prolog_system import PrologSystem
from retalis.prolog.terms.list_terms import conjuncts
from retalis.prolog.terms.term_traversal import copy, rebuild, variables

DATA = Path(__file__).resolve().parents[1] / "data" / "conformity"
ISO = ReadFlags(double_quotes="codes", iso=True)
_OR = functor(";", 2)
_ERROR = functor("error", 2)
_EQUAL = functor("=", 2)
_MAX_SOLUTIONS = 20


class Case(NamedTuple):
    """A goal (or a text that is read and executed) and the answer of the standard."""

    file: str
    number: int
    section: str
    goal: str
    answer: str

    def __str__(self) -> str:
        return f"{self.file}:{self.number}"


def cases(file: str) -> Iterator[Case]:
    """Yield the cases of a file."""
    section = held = ""
    for number, line in enumerate((DATA / file).read_text(encoding="utf-8").split("\n"), 1):
        if line.endswith("\\") and "==>" not in line:  # a continuation inside quotes
            held += line + "\n"
            continue
        line, held = held + line, ""
        if line.startswith("% "):
            section = line[2:]
        elif "==>" in line and not line.startswith(("%", "|")):
            goal, _, answer = line.rpartition(" ==>")
            yield Case(file, number, section, goal, answer.strip())


def clauses(file: str) -> str:
    """Return the program of the goals of a file."""
    lines = (DATA / file).read_text(encoding="utf-8").split("\n")
    return "\n".join(line[2:] for line in lines if line.startswith("| "))


def prepared(program: str) -> Tuple[PrologSystem, List[str]]:
    """Return a Prolog system in ISO mode with a program, and the list of its output."""
    logic = PrologSystem()
    logic.limits = Limits(inferences=2_000_000)
    written: List[str] = []
    logic.output = logic.error_output = written.append
    clauses = list(read_program(program, logic.operators, "program", ISO))
    terms = [(read.term, read.place) for read in clauses if isinstance(read, ReadTerm)]
    assert len(terms) == len(clauses)
    logic.load(terms, lambda message, place: written.append(f"{place}: {message}"))
    assert not written, written
    logic.flags["iso"] = atom("true")
    logic.flags["double_quotes"] = atom("codes")
    return logic, written


def agrees(case: Case, program: str = "") -> Tuple[bool, str]:
    """Run a case; return whether the answer agrees with the standard, and the answer."""
    logic, written = prepared(program)
    try:
        goal = read_term(case.goal, logic.operators, flags=ISO)
    except SyntaxFault:
        return case.answer == "! syntax", "! syntax"
    kind, _, rest = case.answer.partition(" ")
    if kind in ("!", "throws"):
        return _raises(logic, goal.term, kind, rest)
    if kind == "prints":
        return _prints(logic, goal.term, written, rest)
    if case.answer in ("true", "false"):
        try:
            result = "true" if logic.once(goal.term) else "false"
        except PrologError as error:
            result = _text(error.term)
        return result == case.answer, result
    return _binds(logic, goal, case.answer)


def _raises(logic: PrologSystem, goal: Term, kind: str, rest: str) -> Tuple[bool, str]:
    try:
        return False, "true" if logic.once(goal) else "false"
    except PrologError as error:
        ball = error.term
    if kind == "!":
        if ball.__class__ is not tuple or ball[0] is not _ERROR:
            return False, _text(ball)
        ball = deref(ball[1])
    expected = read_term(rest, logic.operators, flags=ISO).term
    return logic.machine.unify(copy(ball), expected) if "_)" in rest else _same(ball, expected), _text(ball)


def _prints(logic: PrologSystem, goal: Term, written: List[str], rest: str) -> Tuple[bool, str]:
    try:
        succeeded = logic.once(goal)
    except PrologError as error:
        return False, _text(error.term)
    text = "".join(written)
    return succeeded and text.strip() == rest.strip(), text if succeeded else "false"


def _binds(logic: PrologSystem, goal: Any, answer: str) -> Tuple[bool, str]:
    expected = read_term(answer, logic.operators, flags=ISO)
    names = list(dict.fromkeys(name for name in goal.names if name in expected.names))
    solutions = _alternatives(expected.term)
    results: List[Any] = []
    requested = [goal.names[name] for name in names]
    others = [goal.names[name] for name in goal.names]
    try:
        for _ in logic.solutions(goal.term):
            results.append(copy(make_list([make_list(requested), make_list(others)])))
            if len(results) == _MAX_SOLUTIONS:
                break
    except PrologError as error:
        return False, _text(error.term)
    shown = " ; ".join(_text(result[1]) for result in results) or "false"
    if len(results) != len(solutions):
        return False, shown
    for result, solution in zip(results, solutions):
        values_of_result: Any = deref(result[2])
        values = dict(zip(goal.names, list_items(values_of_result[1]) or []))
        known = {var: values[name] for name, var in expected.names.items() if name in values}
        equations: List[Any] = [deref(equation) for equation in conjuncts(solution)]
        ours = make_list([known[equation[1]] for equation in equations])
        renamed = functools.partial(_renamed, known)
        theirs = make_list([rebuild(equation[2], renamed) for equation in equations])
        if not _same(ours, theirs):
            return False, shown
    return True, shown


def _renamed(known: Any, var: Any) -> Term:
    return known.get(var, var)


def _alternatives(term: Term) -> List[Term]:
    alternatives: List[Any] = []
    while term.__class__ is tuple and term[0] is _OR:
        alternatives.append(term[1])
        term = deref(term[2])
    return [*alternatives, term]


def _same(left: Term, right: Term) -> bool:
    """Return whether terms differ in the names of variables only."""
    return _text(left) == _text(right)


def _text(term: Term) -> str:
    term = copy(term)
    names = {var: f"_{number}" for number, var in enumerate(variables(term))}
    return write_term(term, quoted=True, ignore_ops=True, variable_names=names)


def main() -> None:
    """Print the cases that differ from the standard."""
    for file in sorted(path.name for path in DATA.glob("*.txt")):
        program = clauses(file)
        results = [(case, *agrees(case, program)) for case in cases(file)]
        wrong = [(case, answer) for case, agrees_with_standard, answer in results if not agrees_with_standard]
        for case, answer in wrong:
            print(f"{case.goal}\n    standard  {case.answer}\n    here      {answer}")
        print(f"{file}: {len(results) - len(wrong)} of {len(results)} agree")


if __name__ == "__main__":
    main()
