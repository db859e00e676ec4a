"""Parts of results that a test expects to be there, each after an assertion: terms, places of errors, clocks."""

import re
from typing import Any, List, Match, NoReturn, Optional, Tuple, TypeVar, Union

import pytest

from retalis import Atom, Engine, RetalisError, StreamClock, Term, deref, list_items
from retalis.foundation.source_places import Place
from retalis.prolog.terms.types import Lazy

Value = TypeVar("Value")


def required(value: Optional[Value]) -> Value:
    """Return a value that is not None."""
    assert value is not None
    return value


def compound(term: Term) -> Tuple[Any, ...]:
    """Return a compound term: its functor and its arguments."""
    value = deref(term)
    assert isinstance(value, tuple), value
    return value


def items(term: Term) -> List[Term]:
    """Return the items of a proper list."""
    return required(list_items(term))


def name_of(term: Term) -> str:
    """Return the name of an atom."""
    value = deref(term)
    assert isinstance(value, Atom), value
    return value.name


def number(term: Term) -> Union[int, float]:
    """Return the value of a number."""
    value = deref(term)
    assert isinstance(value, (int, float)), value
    return value


def place_of(error: RetalisError) -> Place:
    """Return the position of an error in a source text."""
    return required(error.place)


def stream_clock(engine: Engine) -> StreamClock:
    """Return the clock of an engine that was created without one."""
    assert isinstance(engine.clock, StreamClock), engine.clock
    return engine.clock


def search(pattern: str, text: str, flags: int = 0) -> Match[str]:
    """Return the first match of a regular expression in a text that has one."""
    match = re.search(pattern, text, flags)
    assert match is not None, (pattern, text)
    return match


def fail(problem: object) -> NoReturn:
    """Fail the test; for a callback that must not be called."""
    pytest.fail(str(problem))


def lazy(term: object) -> Lazy:
    """Return a term whose value is decoded when it is needed."""
    assert isinstance(term, Lazy), term
    return term
