"""Helpers of the Prolog tests."""

from typing import Any, Dict, List

from retalis import PrologError, Term, functor
from retalis.prolog.syntax.term_reader import read_program, read_term
from retalis.prolog.syntax.term_writer import write_term
from retalis.prolog.system.prolog_system import PrologSystem
from retalis.prolog.terms.term_traversal import copy, variables

NEVER = 1 << 60


def prolog(program: str = "", compile_after: int = 0) -> PrologSystem:
    """Return a Prolog with a program; by default all of it is compiled at its first call."""
    logic = PrologSystem(compile_after=compile_after)
    problems: List[str] = []
    for read in read_program(program, logic.operators, "program.pl"):
        if isinstance(read, Exception):
            raise read
        logic.load([(read.term, read.place)], lambda message, place: problems.append(message))
    assert not problems, problems
    return logic


def answers(logic: PrologSystem, text: str, most: int = 20) -> List[Any]:
    """Return for each solution the texts of the goal's variables; an error is the text of its term, at the end."""
    read = read_term(text, logic.operators)
    found: List[Any] = []
    solutions = logic.solutions(read.term)
    try:
        for _ in solutions:
            values: Dict[str, str] = {
                name: show(value) for name, value in read.names.items() if name[0] != "_"
            }
            found.append(values)
            if len(found) == most:
                break
    except PrologError as error:
        term = error.term
        found.append(show(term[1] if term.__class__ is tuple and term[0] is functor("error", 2) else term))
    finally:
        solutions.close()
    return found


def show(term: Term) -> str:
    """Return a term as text, its variables named A, B, ... in order."""
    numbered = copy(term)
    for number, var in enumerate(variables(numbered)):
        var.ref = (functor("$VAR", 1), number)
    return write_term(numbered, numbervars=True)


def first(logic: PrologSystem, text: str) -> Any:
    """Return the first solution's values: the only one if there is one variable, None for failure."""
    found = answers(logic, text, 1)
    if not found:
        return None
    if isinstance(found[0], dict) and len(found[0]) == 1:
        return next(iter(found[0].values()))
    return found[0]
