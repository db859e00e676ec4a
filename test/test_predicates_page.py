"""The page of predicates against the code: all are there, no other is, and the examples answer as shown."""

import re
from pathlib import Path

import pytest

from retalis import Engine, Limits, PrologError, Var, functor
from retalis.cli.toplevel_io import format_bindings
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.syntax.term_writer import write_term
from retalis.prolog.system.prolog_system import PrologSystem

pytestmark = pytest.mark.docs

PAGE = Path(__file__).resolve().parent.parent / "docs" / "reference" / "predicates.md"
CODE = re.compile(r"`` (.+?) ``")
MOST = 3


def rows():
    for line in PAGE.read_text(encoding="utf-8").split("\n"):
        if line.startswith("| ``"):
            keys, _, _, errors, example, answer = re.split(r"(?<!\\) (?<!\\)\| ", line[2:-2])
            yield (
                [key.replace("\\|", "|") for key in CODE.findall(keys)],
                re.findall(r"`(\w+)(?:\(([^`]*)\))?`", errors),
                *[CODE.findall(cell)[0].replace("\\|", "|") for cell in (example, answer)],
            )


ROWS = list(rows())
OF_SYSTEM = {str(key) for key in PrologSystem().names()}
TRANSFORMS = {str(key) for key in Engine().logic.names() if key.name.startswith("tf_")} - OF_SYSTEM
"""Predicates of an engine that are on this page. The others have pages of their own."""


def system_for(keys):
    """Return a new system that defines the predicates of a row."""
    return Engine().logic if TRANSFORMS.issuperset(keys) else PrologSystem()


def test_every_predicate_is_on_the_page_and_no_other():
    defined = {key for key in OF_SYSTEM if not key.startswith("$")} | TRANSFORMS
    assert len(TRANSFORMS) == 5
    named = [key for keys, *_ in ROWS for key in keys]
    assert sorted(defined - set(named)) == []
    assert sorted(set(named) - defined) == []
    assert len(named) == len(set(named))


@pytest.mark.slow
@pytest.mark.parametrize(("keys", "errors", "example", "answer"), ROWS, ids=[row[0][0] for row in ROWS])
def test_example(keys, errors, example, answer):
    assert keys[0].rpartition("/")[0] in example or keys[0][:2] in (",/", ">>"), (
        "the example shows another predicate"
    )
    logic, written = system_for(keys), []
    logic.limits = Limits(inferences=500_000)
    logic.output = logic.error_output = written.append
    read = read_term(example, logic.operators)
    answers = []
    for _ in logic.solutions(read.term):
        answers.append(format_bindings(read.names, logic.operators).replace(",\n", ", ") or "true")
        if len(answers) == MOST:
            break
    shown = " ; ".join(answers) or "false"
    text = "".join(written)
    assert (f"writes {text!r}; " if text else "") + shown == answer


WRONG = [Var, lambda: (functor("foo", 1), 1), lambda: 1]


@pytest.mark.slow
def test_errors_of_wrong_arguments_are_listed():
    systems = PrologSystem(), Engine().logic
    for logic in systems:
        logic.limits = Limits(inferences=20_000)
        logic.output = logic.error_output = lambda text: None
    for keys, errors, _, _ in ROWS:
        logic = systems[TRANSFORMS.issuperset(keys)]
        name, _, arity = keys[0].rpartition("/")
        listed = {f"{kind}({first})" if first else kind for kind, first in errors}
        for wrong in WRONG if int(arity) else []:
            try:
                logic.once((functor(name, int(arity)), *[wrong() for _ in range(int(arity))]))
            except PrologError as error:
                kind = _kind(error.term)
                if kind and not kind.startswith(("existence", "resource", "syntax")):
                    assert kind in listed, keys


def _kind(ball):
    formal = ball[1] if ball.__class__ is tuple and ball[0] is functor("error", 2) else functor("", 0)
    if formal.__class__ is not tuple:
        return formal.name
    return formal[0].name if formal[1].__class__ is tuple else f"{formal[0].name}({write_term(formal[1])})"
