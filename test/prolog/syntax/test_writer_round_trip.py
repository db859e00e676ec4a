"""Round trip of terms: a written term is read as the same term."""

from typing import Any, List

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sample_terms import names, shape, terms

from retalis import Functor, Operators, atom, functor
from retalis.events.language.event_operators import EVENT_OPERATORS
from retalis.prolog.syntax.event_text import to_text
from retalis.prolog.syntax.term_reader import read_program, read_term
from retalis.prolog.syntax.term_writer import write_term
from retalis.prolog.syntax.tokenizer import ReadFlags
from retalis.prolog.system.prolog_system import PrologSystem

EVENT = ReadFlags(event_text=True)


def operator_tables() -> Any:
    kinds = st.sampled_from(["xfx", "xfy", "yfx", "fy", "fx", "xf", "yf"])
    priorities = st.sampled_from([1, 100, 200, 200, 400, 500, 500, 700, 900, 999, 1000, 1001, 1150, 1200])
    usable = names.filter(lambda name: name not in (",", "|", "[]", "{}"))
    return st.lists(st.tuples(priorities, kinds, usable), max_size=12).map(_table)


def _table(entries: Any) -> Operators:
    operators = Operators.prolog()
    for priority, kind, name in entries:
        if not (name in operators.infix and kind in ("xf", "yf")):  # ISO 13211-1, 8.14.3.3 forbids both
            operators.add(priority, kind, name)
        if kind in ("xfx", "xfy", "yfx"):
            operators.postfix.pop(name, None)
    return operators


@pytest.mark.slow
@settings(max_examples=500, deadline=None)
@given(terms, operator_tables())
def test_written_term_is_read_as_same_term(term: Any, operators: Any) -> None:
    for text in (
        write_term(term, operators),
        write_term(term, operators, spacing=True),
        write_term(term, operators, wide=True),
        write_term(term, operators, ignore_ops=True),
        write_term(term, operators, priority=999),
    ):
        assert shape(read_term(text, operators).term) == shape(term), text


@pytest.mark.slow
@settings(max_examples=500, deadline=None)
@given(terms)
def test_event_text_is_read_as_same_term(term: Any) -> None:
    """Strings excepted: in event text, ``"a"`` is the atom with the quotes inside."""
    read = read_term(to_text(term), Operators.prolog(), flags=EVENT).term
    expected = [_as_atom(item) for item in shape(term)]
    assert list(shape(read)) == expected


def _as_atom(item: Any) -> Any:
    is_string = not isinstance(item, Functor) and item[0] == "String"
    return ("Atom", atom(f'"{item[1].text}"')) if is_string else item


SYMBOLS = (
    "@",
    "-",
    "*",
    ":-",
    "-->",
    "\\+",
    "->",
    ";",
    "|",
    "?-",
    "=",
    "!",
    "[]",
    "{}",
    ",",
    "is",
    "a",
    ".",
    "+",
    "\\",
    ":",
    "$",
    "#",
    "dynamic",
    "table",
)
RULES = frozenset(
    spelling
    for operator in EVENT_OPERATORS
    for spelling in operator.spellings
    if operator.name in ("<-", "do", "iff", "rule:")
)
"""Operators of rules: their arguments are read as patterns, where `*` denotes another term than in Prolog."""


def _applied(children: Any) -> Any:
    prefix = st.sampled_from([":-", "?-", "\\+", "-", "@", "dynamic", "{}", "a", ":", "$", "+"])
    infix = st.sampled_from([":-", "-->", ",", ";", "->", "*->", "|", "=", "@", "-", "is", ":", "=>"])
    return st.one_of(
        st.tuples(prefix.map(lambda name: functor(name, 1)), children),
        st.tuples(infix.map(lambda name: functor(name, 2)), children, children),
    )


clauses = st.recursive(st.one_of(terms, st.sampled_from(SYMBOLS).map(atom)), _applied, max_leaves=8)


def _is_written_differently(item: Any) -> bool:
    """Return whether a functor is written as a variable or read as a rule."""
    return item.__class__ is Functor and (item.name == "$VAR" or item.name in RULES)


def check_written(logic: Any, term: Any) -> None:
    """Check that the text of each writing predicate is read as the same term."""
    for name in ("portray_clause", "writeq", "print", "write_canonical"):
        written: List[Any] = []
        logic.output = written.append
        assert logic.once((functor(name, 1), term))
        text = "".join(written) + ("" if name == "portray_clause" else " .")
        (read,) = read_program(text, logic.operators, name)
        assert not isinstance(read, Exception), text
        assert shape(read.term) == shape(term), text


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(clauses.filter(lambda term: not any(map(_is_written_differently, shape(term)))), operator_tables())
def test_written_clause_is_read_as_same_term(term: Any, operators: Any) -> None:
    logic = PrologSystem()
    logic.operators.become(operators)
    check_written(logic, term)


FORMS = (
    "{0}",
    "f({0})",
    "[{0}]",
    "[a|{0}]",
    "- {0}",
    "{0} = {0}",
    "({0}, {0})",
    "{{{0}}}",
    "{0} --> b",
    "a --> {0}",
    ":- {0}",
    "a :- {0}",
    "{0} :- a",
    "{0} :- {0}",
    "a :- b, {0}",
    "a :- \\+ {0}",
    "a :- ({0} -> {0} ; {0})",
)


@pytest.mark.parametrize("name", SYMBOLS)
def test_operator_as_atom_is_read_as_same_term(name: str) -> None:
    """Alone, as argument, operand, item, head and goal."""
    logic = PrologSystem()
    text = f"({write_term(atom(name))})" if name != "," else "','"
    for form in FORMS:
        check_written(logic, read_term(form.format(text), logic.operators).term)


def test_redefined_operator_is_written_without_layout() -> None:
    logic = PrologSystem()
    assert logic.once(read_term("op(500, xfy, :-)", logic.operators).term)
    check_written(logic, read_term("':-'(:(a:b), \\+ a)", logic.operators).term)
