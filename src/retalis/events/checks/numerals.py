"""Integers where floats come, and the other way round: the two are never the same term."""

from typing import Any, Dict, Iterator, List, Mapping, NamedTuple, Optional, Set, Tuple

from ...foundation import RuleError
from ...messages import Definition, Field
from ...prolog.terms import Functor, Var, deref, functor
from ..language import NEW_EVENT, Occurs, made_by, walk
from .overview import Overview
from .written import Inner, held, inners, key_of

_SAME = {
    functor(name, 2): numeric
    for name, numeric in zip(("==", "=", "\\==", "\\="), ("=:=", "=:=", "=\\=", "=\\="))
}
"""What compares terms, with what compares numbers."""

_BRANCHES = frozenset((functor("or", 2), functor("\\/", 2), functor(";", 2), functor("->", 2)))
_KINDS = {
    **dict.fromkeys(("float32", "float64"), float),
    **dict.fromkeys(
        ("int8", "uint8", "byte", "char", "int16", "uint16", "int32", "uint32", "int64", "uint64"), int
    ),
}
_EXACT = 10**15
"""Up to here each integer is a float that is written with its digits."""


class _NumberSlot(NamedTuple):
    """Where a variable gets its number from."""

    kind: type
    slot: str


def numerals(program: Overview) -> Iterator[RuleError]:
    """Yield numbers that no message has in their slots, and comparisons of such slots that never hold."""
    own = _own(program)
    for event, who in program.patterns():
        for inner, definition in _messages(program, event, own):
            for at, slot in enumerate(definition.fields, 1):
                value, kind = deref(inner.term[at]), _kind(slot)
                if _is_other(value, kind):
                    wrong = f"{slot.name} of {definition.name} is {_name(kind)} in events: write {_as(kind, value)}"
                    yield RuleError(f"{who}{wrong}", inner.spot(inner.term, at))
    for rule in program.rules:
        events = [node.term for node in walk(rule.definition.pattern, True) if isinstance(node, Occurs)]
        parts = [Inner(deref(term), held(term), 1, rule.spot) for term in events]
        whole = Inner(None, held(rule.definition.term), 1, rule.spot)
        yield from _compared(program, parts, whole, {**program.names, **rule.definition.names}, own)
    for kept in (*program.memories, *program.subscriptions):
        for error in _compared(
            program, [kept.event], Inner(None, kept.term, 2, kept.spot), program.names, own
        ):
            yield RuleError(f"{kept.who}{error.message}", error.place)


def _own(program: Overview) -> Set[Optional[Functor]]:
    """Return the functors of all that the program makes events of, None where that is not seen."""
    found: Set[Optional[Functor]] = set()
    for rule in program.rules:
        head = made_by(rule.definition.head)
        if head is not None:
            found.add(key_of(head))
    for call in program.calls():
        if call.term.__class__ is tuple and call.term[0] in NEW_EVENT:
            found.add(key_of(call.term[1]))
    return found


def _messages(
    program: Overview, event: Inner, own: Set[Optional[Functor]]
) -> Iterator[Tuple[Inner, Definition]]:
    """Yield the messages in an event that comes from outside: what the program makes may have other numbers."""
    if event.key in own or None in own or program.message_of(event.term) is None:
        return
    for inner in inners(event.parent, event.number, event.spot):
        definition = program.message_of(inner.term)
        if definition is not None:
            yield inner, definition


def _compared(
    program: Overview,
    events: List[Inner],
    whole: Inner,
    names: Mapping[Var, str],
    own: Set[Optional[Functor]],
) -> Iterator[RuleError]:
    """Yield the comparisons in a term that never hold, by the events that its variables stand in."""
    found = list(inners(whole.parent, whole.number, whole.spot))
    if any(inner.key in _BRANCHES for inner in found):  # a variable may get its value elsewhere
        return
    known = _known(program, events, own)
    for inner in found:
        numeric = _SAME.get(inner.key) if inner.key is not None else None
        if numeric is None:
            continue
        for at, other in ((1, 2), (2, 1)):
            variable: Any = deref(inner.term[at])
            value = deref(inner.term[other])
            slot = known.get(variable) if variable.__class__ is Var else None
            if slot is not None and _is_other(value, slot.kind):
                text = f"{names.get(variable, 'this variable')} is {_name(slot.kind)} ({slot.slot})"
                yield RuleError(
                    f"{text}, never {_name(type(value))}: write {numeric}", inner.spot(inner.term, other)
                )


def _known(program: Overview, events: List[Inner], own: Set[Optional[Functor]]) -> Dict[Var, _NumberSlot]:
    """Return which variables of events are numbers in slots."""
    known: Dict[Var, _NumberSlot] = {}
    for event in events:
        for inner, definition in _messages(program, event, own):
            for at, slot in enumerate(definition.fields, 1):
                value: Any = deref(inner.term[at])
                kind = _kind(slot)
                if value.__class__ is Var and kind is not None:
                    known.setdefault(value, _NumberSlot(kind, f"{slot.name} of {definition.name}"))
    return known


def _kind(slot: Field) -> Optional[type]:
    """Return float or int for a slot that has one such number."""
    return None if slot.length is not None else _KINDS.get(slot.type)


def _is_other(value: Any, kind: Optional[type]) -> bool:
    """Tell whether a number is of the other kind."""
    return kind is not None and value.__class__ in (int, float) and value.__class__ is not kind


def _name(kind: Optional[type]) -> str:
    return "a float" if kind is float else "an integer"


def _as(kind: Optional[type], value: Any) -> str:
    """Return how a number is written that is to be of a kind."""
    if kind is float:
        return f"{value}.0" if abs(value) < _EXACT else "it with a point"
    return str(int(value)) if value == value and abs(value) < _EXACT and value == int(value) else "one"
