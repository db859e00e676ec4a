"""Kinds of values as far as message slots tell them: numbers, texts, stamps, truth values, lists.

Integers where floats come, and the other way round: the two are never the same term.
"""

from typing import Any, Dict, Iterator, List, Mapping, NamedTuple, Optional, Set, Tuple

from ...foundation.errors import RuleError
from ...messages.type_definition import Definition, Field
from ...prolog.syntax.event_operators import OperatorKind
from ...prolog.terms.types import Atom, CompoundTerm, Functor, String, Term, Var, deref, functor
from ..language.aggregate_functions import AGGREGATES
from ..language.event_declarations import ValueType, slot_kind
from ..language.pattern_operators import names_of_kind
from ..language.pattern_parser import EventTerm, Spot
from ..language.pattern_tree import Occurs, walk
from ..language.rule_parser import NEW_EVENT, made_by, makes_event
from ..program.event_file_checker import nowhere
from .producer_checks import event_of_kept, events_of_goals, events_of_rule
from .program_model import NECK, Inner, ProgramModel, held, inners, key_of

_COMPARED = frozenset(functor(name, 2) for name in ("<", ">", "=<", ">=", "=:=", "=\\="))
_IS = functor("is", 2)
_EQUALITIES = frozenset(functor(name, 2) for name in ("==", "\\==", "=", "\\="))
_ARITHMETIC = frozenset(functor(name, 2) for name in ("+", "-", "*", "/", "//", "mod", "min", "max", "**"))
_SIGNS = frozenset(
    functor(name, 1) for name in ("-", "+", "abs", "sqrt", "round", "truncate", "float", "integer")
)
_ONE_OF = frozenset((functor("or", 2), functor("\\/", 2), functor(";", 2), functor("->", 2)))


_COLLECTED = frozenset(functor(kind.name, 1) for kind in AGGREGATES.values() if kind.numeric)
_AGGREGATE, *_ = names_of_kind(OperatorKind.AGGREGATE)


class SlotKind(NamedTuple):
    """What a variable is, by the slot in which it stands.

    Attributes:
        kind: its kind.
        slot: the slot, and the type of its message; or the argument, and the event that is declared.
        is_made: whether the program makes that: there the value goes in, and comes from elsewhere.
    """

    kind: ValueType
    slot: str
    is_made: bool

    @property
    def what(self) -> str:
        """What a value of its kind is called."""
        return self.kind.what


def _takes_more(slot: Field) -> bool:
    """Tell whether more goes into a slot than comes out of it: 0 and 1 for truth values, lists for bytes."""
    return slot.is_bytes or (slot.type == "bool" and slot.length is None)


def kinds(program: ProgramModel) -> Iterator[RuleError]:
    """Yield where a value is used as what it is not."""
    for rule in program.rules:
        parent = held(rule.definition.term)
        names = {**program.names, **rule.definition.names}
        events = events_of_rule(rule) if program.declared else []
        yield from _in_clause(program, parent, rule.spot, names, events, made_by(rule.definition.head))
    for clause in program.clauses:
        whole = clause.parent if clause.parent[0] is NECK else held(clause.head or clause.parent)
        events = events_of_goals(clause) if program.declared else []
        yield from _in_clause(program, held(whole), clause.spot, program.names, events)
    for kept in (*program.memories, *program.subscriptions):
        events = [event_of_kept(kept)]
        for error in _in_clause(program, held(kept.term), kept.spot, program.names, events, kept.form):
            yield RuleError(f"{kept.who}{error.message}", error.place)


def _in_clause(
    program: ProgramModel,
    parent: CompoundTerm,
    spot: Spot,
    names: Any,
    events: List[EventTerm],
    out: Optional[Term] = None,
) -> Iterator[RuleError]:
    """Yield what is wrong in one rule or clause, whose variables are its own; one of its terms is what it makes."""
    found = list(inners(parent, 1, spot))
    known: Dict[Var, SlotKind] = {}
    branches = any(inner.key in _ONE_OF for inner in found)
    made = _made(found, out)
    declared = {id(deref(event.term)) for event in events}
    for inner in found:
        is_made = id(inner.term) in made
        for at, kind, slot in _values(program, inner.term, is_made, declared):
            value = deref(inner.term[at])
            if value.__class__ is not Var:
                continue
            now = SlotKind(kind, slot, is_made)
            before = known.setdefault(value, now)
            if before.kind.excludes(kind) and not branches:
                yield RuleError(_clash(_name(value, names), before, now), spot(inner.term, at))
                known.pop(value)
            elif (before.is_made and not is_made) or kind.forms < before.kind.forms:
                known[value] = now
    if known:
        yield from _in_goals(found, known, names)


def _values(
    program: ProgramModel, term: Any, is_made: bool, declared: Set[int]
) -> Iterator[Tuple[int, ValueType, str]]:
    """Yield the arguments of a message or declared event: which, their kinds, and what they are called."""
    definition = program.message_of(term)
    if definition is not None:
        for at, slot in enumerate(definition.fields, 1):
            kind = slot_kind(slot)
            if kind is not None and not (is_made and _takes_more(slot)):
                yield at, kind, f"{slot.name} of {definition.name}"
    elif term.__class__ is tuple and id(term) in declared:
        one = program.declared.get(term[0].name)
        if one is not None and one.key is term[0]:
            for at, argument in enumerate(one.arguments, 1):
                yield at, argument.kind, f"{argument.name} of {one.key}"


def _made(found: List[Inner], out: Optional[Term]) -> Set[int]:
    """Return which terms are made: the head of a rule, the form of a subscription, events of goals."""
    makers = [] if out is None else [held(deref(out))]
    makers += [inner.term for inner in found if makes_event(inner.term)]
    return {id(inner.term) for maker in makers for inner in inners(maker, 1, nowhere)}


def _clash(name: str, one: SlotKind, other: SlotKind) -> str:
    """Return what is wrong where a variable is of two kinds."""
    if one.is_made and not other.is_made:
        one, other = other, one
    if other.is_made and not one.is_made and other.what == "a text":
        return f"{name} is {one.what} ({one.slot}) and goes into a text ({other.slot}): {_to_text(name)}"
    return (
        f"{name} is {one.what} ({one.slot}) and, here, {other.what} ({other.slot}): these are never the same"
    )


def _in_goals(found: List[Inner], known: Dict[Var, SlotKind], names: Any) -> Iterator[RuleError]:
    said: Set[Var] = set()
    for inner in found:
        key = inner.key
        if key in _COMPARED:
            operands = [(inner.term, 1), (inner.term, 2)]
        elif key is _IS:
            operands = [(inner.term, 2)]
        else:
            if key in _EQUALITIES:
                yield from _compared(inner, known, names)
            elif key in _COLLECTED:
                yield from _collected(inner, known, names)
            continue
        while operands:
            parent, at = operands.pop(0)
            term: Any = deref(parent[at])
            if term.__class__ is tuple and (term[0] in _ARITHMETIC or term[0] in _SIGNS):
                operands += [(term, number) for number in range(1, len(term))]
            kind = known.get(term) if term.__class__ is Var else None
            if kind is not None and kind.what in _ADVICE and term not in said:
                said.add(term)
                yield RuleError(_no_number(_name(term, names), kind), inner.spot(parent, at))


_ADVICE = {
    "a text": "compare texts with == or \\==",
    "true or false": "write == true or == false",
    "a string": "compare strings with == or \\==",
    "an atom": "compare atoms with == or \\==",
    "a list": "take it apart, as with nth0/3 or sum_list/2",
}
"""What to do with a value that is no number; a stamp is one."""


def _no_number(name: str, kind: SlotKind) -> str:
    """Return what is wrong with a variable that is a number somewhere, and of another kind as a slot."""
    if not kind.is_made:
        return f"{name} is {kind.what} ({kind.slot}), not a number: {_ADVICE[kind.what]}"
    advice = _to_text(name) if kind.what == "a text" else "send another variable"
    return f"{name} is a number here and goes into {kind.what} ({kind.slot}): {advice}"


def _to_text(name: str) -> str:
    return f"make a text of it, as with format(atom(Text), '\"~w\"', [{name if name[:1].isupper() else 'X'}])"


def _collected(inner: Inner, known: Dict[Var, SlotKind], names: Any) -> Iterator[RuleError]:
    """Yield that an aggregate of numbers collects something else."""
    if inner.parent[0].name != _AGGREGATE or inner.number != 1:
        return
    value: Any = deref(inner.term[1])
    kind = known.get(value) if value.__class__ is Var else None
    if kind is not None and kind.what in _ADVICE and not kind.is_made:
        text = f"{_name(value, names)} is {kind.what} ({kind.slot}): {inner.term[0].name} collects numbers"
        yield RuleError(text, inner.spot(inner.term, 1))


def _compared(inner: Inner, known: Dict[Var, SlotKind], names: Any) -> Iterator[RuleError]:
    """Yield why two terms that are compared as they are will never be the same."""
    for at, other in ((1, 2), (2, 1)):
        value: Any = deref(inner.term[at])
        constant = deref(inner.term[other])
        kind = known.get(value) if value.__class__ is Var else None
        wrong = None if kind is None or kind.is_made else _never(kind.what, constant)
        if kind is not None and wrong is not None:
            yield RuleError(
                f"{_name(value, names)} is {kind.what} ({kind.slot}): {wrong}", inner.spot(inner.term, other)
            )


def _never(what: str, constant: Term) -> Optional[str]:
    """Return why a value of a kind is never the same as a constant; None where it may be."""
    if what == "a text":
        if isinstance(constant, Atom) and constant.name[:1] != '"' and constant.name != "[]":
            return f"it keeps its quotes in events, write '\"{constant.name}\"'"
        if isinstance(constant, String):
            return f"it keeps its quotes in events, write '\"{constant.text}\"'"
        if isinstance(constant, (int, float)):
            return f"it is never the number {constant}"
    elif what == "a number":
        if isinstance(constant, String) or (isinstance(constant, Atom) and constant.name not in _NUMBERS):
            text = constant.text if isinstance(constant, String) else constant.name
            return f"it is never {text}"
    elif what == "true or false" and not _may_be_true_or_false(constant):
        return "compare it with true or false"
    return None


def _may_be_true_or_false(constant: Term) -> bool:
    if isinstance(constant, Atom):
        return constant.name in ("true", "false")
    return not isinstance(constant, (int, float, String))


_NUMBERS = frozenset(("nan", "inf", "infinite"))


def _name(var: Var, names: Any) -> str:
    return str(names.get(var, "this variable"))


_COMPARISONS = {
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


def numerals(program: ProgramModel) -> Iterator[RuleError]:
    """Yield numbers that no message has in their slots, and comparisons of such slots that never hold."""
    own = _own(program)
    for event, who in program.patterns():
        for inner, definition in _messages(program, event, own):
            for at, slot in enumerate(definition.fields, 1):
                value, kind = deref(inner.term[at]), _kind(slot)
                if _is_other(value, kind):
                    wrong = (
                        f"{slot.name} of {definition.name} is {_numeric_type_name(kind)} in events: "
                        f"write {_as(kind, value)}"
                    )
                    yield RuleError(f"{who}{wrong}", inner.spot(inner.term, at))
    for rule in program.rules:
        events = [node.term for node in walk(rule.definition.pattern, True) if isinstance(node, Occurs)]
        parts = [Inner(deref(term), held(term), 1, rule.spot) for term in events]
        whole = Inner(None, held(rule.definition.term), 1, rule.spot)
        yield from _compared_numbers(program, parts, whole, {**program.names, **rule.definition.names}, own)
    for kept in (*program.memories, *program.subscriptions):
        for error in _compared_numbers(
            program, [kept.event], Inner(None, kept.term, 2, kept.spot), program.names, own
        ):
            yield RuleError(f"{kept.who}{error.message}", error.place)


def _own(program: ProgramModel) -> Set[Optional[Functor]]:
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
    program: ProgramModel, event: Inner, own: Set[Optional[Functor]]
) -> Iterator[Tuple[Inner, Definition]]:
    """Yield the messages in an event that comes from outside: what the program makes may have other numbers."""
    if event.key in own or None in own or program.message_of(event.term) is None:
        return
    for inner in inners(event.parent, event.number, event.spot):
        definition = program.message_of(inner.term)
        if definition is not None:
            yield inner, definition


def _compared_numbers(
    program: ProgramModel,
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
        numeric = _COMPARISONS.get(inner.key) if inner.key is not None else None
        if numeric is None:
            continue
        for at, other in ((1, 2), (2, 1)):
            variable: Any = deref(inner.term[at])
            value = deref(inner.term[other])
            slot = known.get(variable) if variable.__class__ is Var else None
            if slot is not None and _is_other(value, slot.kind):
                text = (
                    f"{names.get(variable, 'this variable')} is {_numeric_type_name(slot.kind)} ({slot.slot})"
                )
                yield RuleError(
                    f"{text}, never {_numeric_type_name(type(value))}: write {numeric}",
                    inner.spot(inner.term, other),
                )


def _known(program: ProgramModel, events: List[Inner], own: Set[Optional[Functor]]) -> Dict[Var, _NumberSlot]:
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


def _numeric_type_name(kind: Optional[type]) -> str:
    return "a float" if kind is float else "an integer"


def _as(kind: Optional[type], value: Any) -> str:
    """Return how a number is written that is to be of a kind."""
    if kind is float:
        return f"{value}.0" if abs(value) < _EXACT else "it with a point"
    return str(int(value)) if value == value and abs(value) < _EXACT and value == int(value) else "one"
