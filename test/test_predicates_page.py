"""Page of predicates, compared with the code: it has exactly the defined ones, with the answers of their examples."""

import re
from pathlib import Path
from typing import Any, Callable, Iterator, List

import pytest

from retalis import Engine, Limits, PrologError, Term, Var, functor
from retalis.cli.toplevel_io import format_bindings
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.syntax.term_writer import write_term
from retalis.prolog.system.prolog_system import PrologSystem

pytestmark = pytest.mark.docs

PAGE = Path(__file__).resolve().parent.parent / "docs" / "reference" / "predicates.md"
CODE = re.compile(r"`` (.+?) ``")
MAX_ANSWERS = 3


def rows() -> Iterator[Any]:
    for line in PAGE.read_text(encoding="utf-8").split("\n"):
        if line.startswith("| ``"):
            keys, _, _, errors, example, answer = re.split(r"(?<!\\) (?<!\\)\| ", line[2:-2])
            yield (
                [key.replace("\\|", "|") for key in CODE.findall(keys)],
                re.findall(r"`(\w+)(?:\(([^`]*)\))?`", errors),
                *[CODE.findall(cell)[0].replace("\\|", "|") for cell in (example, answer)],
            )


ROWS = list(rows())
PROLOG_PREDICATES = {str(key) for key in PrologSystem().names()}
ENGINE_PREDICATES = {
    str(key) for key in Engine().logic.names() if key.name.startswith(("tf_", "ros_"))
} - PROLOG_PREDICATES
"""Predicates of an engine on this page; the others are on other pages."""


def system_for(keys: Any) -> PrologSystem:
    """Return a new system that defines the predicates of a row."""
    return Engine().logic if ENGINE_PREDICATES.issuperset(keys) else PrologSystem()


def test_page_has_exactly_the_defined_predicates() -> None:
    defined = {key for key in PROLOG_PREDICATES if not key.startswith("$")} | ENGINE_PREDICATES
    assert len(ENGINE_PREDICATES) == 8
    names = [key for keys, *_ in ROWS for key in keys]
    assert sorted(defined - set(names)) == []
    assert sorted(set(names) - defined) == []
    assert len(names) == len(set(names))


@pytest.mark.slow
@pytest.mark.parametrize(("keys", "errors", "example", "answer"), ROWS, ids=[row[0][0] for row in ROWS])
def test_example_has_answer_of_page(keys: Any, errors: Any, example: Any, answer: Any) -> None:
    assert keys[0].rpartition("/")[0] in example or keys[0][:2] in (",/", ">>"), (
        "the example shows another predicate"
    )
    logic = system_for(keys)
    outputs: List[Any] = []
    logic.limits = Limits(inferences=500_000)
    logic.output = logic.error_output = outputs.append
    parsed = read_term(example, logic.operators)
    answers: List[Any] = []
    for _ in logic.solutions(parsed.term):
        answers.append(format_bindings(parsed.names, logic.operators).replace(",\n", ", ") or "true")
        if len(answers) == MAX_ANSWERS:
            break
    answer_text = " ; ".join(answers) or "false"
    text = "".join(outputs)
    assert (f"writes {text!r}; " if text else "") + answer_text == answer


INVALID_ARGUMENTS: List[Callable[[], Term]] = [Var, lambda: (functor("foo", 1), 1), lambda: 1]


@pytest.mark.slow
def test_errors_of_invalid_arguments_are_listed() -> None:
    systems = PrologSystem(), Engine().logic
    for logic in systems:
        logic.limits = Limits(inferences=20_000)
        logic.output = logic.error_output = lambda text: None
    for keys, errors, _, _ in ROWS:
        logic = systems[ENGINE_PREDICATES.issuperset(keys)]
        name, _, arity = keys[0].rpartition("/")
        listed = {f"{error_name}({first})" if first else error_name for error_name, first in errors}
        for make_argument in INVALID_ARGUMENTS if int(arity) else []:
            try:
                logic.once((functor(name, int(arity)), *[make_argument() for _ in range(int(arity))]))
            except PrologError as error:
                error_name = _error_name(error.term)
                if error_name and not error_name.startswith(("existence", "resource", "syntax")):
                    assert error_name in listed, keys


def _error_name(ball: Any) -> Any:
    """Return the name of an error term, with its first argument unless that is compound."""
    formal = ball[1] if ball.__class__ is tuple and ball[0] is functor("error", 2) else functor("", 0)
    if formal.__class__ is not tuple:
        return formal.name
    return formal[0].name if formal[1].__class__ is tuple else f"{formal[0].name}({write_term(formal[1])})"
