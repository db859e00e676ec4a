"""Terms of a program that are meant as messages and fit none: wrong names of types, wrong numbers of slots."""

from difflib import get_close_matches
from typing import Any, Collection, Iterator, Set, Tuple

from .errors import RuleError
from .messages import Definitions, type_name
from .terms import Atom, Functor, Term, deref


def misfits(engine: Any, definitions: Definitions, types: Collection[str]) -> Iterator[RuleError]:
    """Yield a warning for each kind of term in rules and patterns that is no message of a type that is known.

    Args:
        engine: whose program it is.
        definitions: the message types that are known.
        types: those that the program's topics have.
    """
    known = [definitions.find(kind) for kind in types if kind in definitions]
    near = sorted({*types, *(nested.name for one in known for nested in one.dependencies())})
    seen: Set[Functor] = set()
    for term, who, place in _terms(engine):
        for key in _functors(term):
            kind = None if key in seen else type_name(key.name)
            seen.add(key)
            if kind is not None:
                wrong = _wrong(key, kind, definitions, near)
                if wrong:
                    yield RuleError(f"{who}{wrong}", place)


def _terms(engine: Any) -> Iterator[Tuple[Term, str, Any]]:
    """Yield rules and patterns, each with what to call it and its place."""
    for rule in engine.rules.rules:
        yield rule.definition.term, "", rule.place
    for pattern, who in engine.knowledge.patterns():
        yield pattern, f"{who}: ", None


def _functors(term: Term) -> Iterator[Functor]:
    stack = [term]
    while stack:
        item = deref(stack.pop())
        if item.__class__ is tuple:
            yield item[0]
            stack.extend(item[:0:-1])
        elif item.__class__ is Atom:
            yield item.functor


def _wrong(key: Functor, kind: str, definitions: Definitions, near: Collection[str]) -> str:
    """Return what is wrong with a term that is meant as a message, "" where it is right or cannot be told."""
    if kind not in definitions:
        meant = get_close_matches(kind, near, 1, 0.8)
        return f"there is no message type {kind} here; did you mean {meant[0]}?" if meant else ""
    slots = [slot.name for slot in definitions.find(kind).fields]
    if len(slots) == key.arity:
        return ""
    return f"{key} is no message: {kind} has {len(slots)} slots{': ' if slots else ''}{', '.join(slots)}"
