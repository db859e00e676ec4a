"""Helpers of the Prolog tests."""

from typing import Any, Dict, List

from retalis import PrologError, Term, functor
from retalis.prolog.syntax.term_reader import read_program, read_term
from retalis.prolog.syntax.term_writer import write_term
from retalis.prolog.system.prolog_system import PrologSystem
from retalis.prolog.terms.term_traversal import copy, variables

NEVER = 1 << 60


def prolog(program: str = "", compile_after: int = 0) -> PrologSystem:
    """Return a Prolog system with a program, whose predicates are compiled at the first call by default."""
    logic = PrologSystem(compile_after=compile_after)
    problems: List[str] = []
    for read in read_program(program, logic.operators, "program.pl"):
        if isinstance(read, Exception):
            raise read
        logic.load([(read.term, read.place)], lambda message, place: problems.append(message))
    assert not problems, problems
    return logic


def answers(logic: PrologSystem, text: str, limit: int = 20) -> List[Any]:
    """Return the texts of a goal's variables for each solution, followed by the text of an error if one is raised."""
    read = read_term(text, logic.operators)
    results: List[Any] = []
    solutions = logic.solutions(read.term)
    try:
        for _ in solutions:
            values: Dict[str, str] = {
                name: show(value) for name, value in read.names.items() if name[0] != "_"
            }
            results.append(values)
            if len(results) == limit:
                break
    except PrologError as error:
        term = error.term
        results.append(show(term[1] if term.__class__ is tuple and term[0] is functor("error", 2) else term))
    finally:
        solutions.close()
    return results


def show(term: Term) -> str:
    """Return a term as text with its variables named A, B, ... in order."""
    numbered = copy(term)
    for number, var in enumerate(variables(numbered)):
        var.ref = (functor("$VAR", 1), number)
    return write_term(numbered, numbervars=True)


def first(logic: PrologSystem, text: str) -> Any:
    """Return the values of the first solution: a single value if there is one variable, None for failure."""
    results = answers(logic, text, 1)
    if not results:
        return None
    if isinstance(results[0], dict) and len(results[0]) == 1:
        return next(iter(results[0].values()))
    return results[0]


def nested_goal(step: str, innermost: str) -> str:
    """Return a goal that binds G to a term that nests ``step`` 3000 times around ``innermost``."""
    return f"numlist(1, 3000, _L), foldl([_, A, {step}]>>true, _L, {innermost}, G)"
