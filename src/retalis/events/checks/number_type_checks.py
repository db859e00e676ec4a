"""Checks of numbers: integers where a slot of a message has floats and vice versa, and inexact decimals.

The terms ``1`` and ``1.0`` are different, so a pattern with a number of the other type never matches, and ``==``
never holds. A decimal such as ``0.1`` has no exact binary value: a slot of 32 bits never equals it, and a measured
value of 64 bits hardly ever does.
"""

import struct
from decimal import Decimal
from typing import Any, Dict, Iterator, List, Mapping, NamedTuple, Optional, Set, Tuple

from ...foundation.errors import RuleError
from ...foundation.source_places import Place
from ...messages.type_definition import FLOATS, PRIMITIVES, Definition, Field
from ...prolog.terms.types import Functor, Term, Var, deref, functor, functor_of
from ..language.pattern_tree import EventPattern, walk
from ..language.rule_heads import NEW_EVENT, event_raised_by
from .condition_checks import ALTERNATIVES
from .program_model import ProgramModel, Subterm, subterms, wrap_term

_NUMERIC_EQUIVALENTS = {
    functor(name, 2): numeric
    for name, numeric in zip(("==", "=", "\\==", "\\="), ("=:=", "=:=", "=\\=", "=\\="))
}
"""Comparisons of terms, with the corresponding comparisons of numbers."""

_NUMERIC_EQUALITIES = frozenset((functor("=:=", 2), functor("=\\=", 2)))
_NUMBER_TYPES = {name: float if name in FLOATS else int for name in PRIMITIVES if name != "bool"}
_MAX_EXACT_INTEGER = 10**15
"""Limit up to which each integer is represented exactly by a float that is written with its digits."""


class _NumberSlot(NamedTuple):
    """Numeric slot in which a variable occurs."""

    number_type: type
    slot: str
    is_single: bool


class _SlotValue(NamedTuple):
    """A value in a slot of a message in a pattern.

    Attributes:
        name: names of the slot and of its type.
        position: position of the slot in the message, from 1.
        prefix: beginning of errors about the pattern.
    """

    slot: Field
    name: str
    message: Subterm
    position: int
    prefix: str

    @property
    def value(self) -> Term:
        return deref(self.message.term[self.position])

    def make_error(self, fault: str) -> RuleError:
        """Return an error at the place of the value."""
        return RuleError(f"{self.prefix}{fault}", self.message.place_of(self.message.term, self.position))


def _find_slot_values(program: ProgramModel, created_keys: Set[Optional[Functor]]) -> Iterator[_SlotValue]:
    """Yield the values in slots of messages in the patterns of a program, if topics are their only source."""
    for event, prefix in program.patterns():
        for message, definition in _find_input_messages(program, event, created_keys):
            for position, slot in enumerate(definition.fields, 1):
                yield _SlotValue(slot, f"{slot.name} of {definition.name}", message, position, prefix)


def find_number_type_mismatches(program: ProgramModel) -> Iterator[RuleError]:
    """Yield numbers that no message has in that slot, and comparisons with such slots that never hold."""
    created_keys = _functors_of_created_events(program)
    for slot_value in _find_slot_values(program, created_keys):
        slot, name, value = slot_value.slot, slot_value.name, slot_value.value
        number_type = _number_type(slot)
        if _has_other_type(value, number_type):
            yield slot_value.make_error(
                f"{name} is {_describe_number_type(number_type)} in events: "
                f"write {_advise_number(number_type, value)}"
            )
        elif slot.type == "float32" and slot.length is None and _is_no_single(value):
            yield slot_value.make_error(
                f"{name} is a float32, which is never exactly {value}: "
                f"write a variable V, and where abs(V - {value}) < 0.001"
            )
    for comparison in _find_number_comparisons(program, created_keys):
        fault = _explain_number_comparison(comparison)
        if fault:
            yield RuleError(f"{comparison.prefix}{fault}", comparison.place)


def find_inexact_decimals(program: ProgramModel) -> Iterator[RuleError]:
    """Yield decimals that are compared for equality with a float of 64 bits, but have no exact binary value."""
    created_keys = _functors_of_created_events(program)
    for slot_value in _find_slot_values(program, created_keys):
        slot, value = slot_value.slot, slot_value.value
        if slot.type == "float64" and slot.length is None and _is_inexact(value):
            yield slot_value.make_error(
                f"{slot_value.name} is matched only if it is exactly {value}: for a measured "
                f"value write a variable V, and where abs(V - {value}) < 0.001"
            )
    for comparison in _find_number_comparisons(program, created_keys):
        name, value, numeric_slot = comparison.name, comparison.value, comparison.slot
        if numeric_slot.number_type is float and not numeric_slot.is_single and _is_inexact(value):
            fault = (
                f"{name} is a float ({numeric_slot.slot}), which a measured value rarely equals exactly: "
                f"write abs({name} - {value}) < 0.001"
            )
            yield RuleError(f"{comparison.prefix}{fault}", comparison.place)


def _is_inexact(value: Any) -> bool:
    """Return whether a float differs from the decimal that denotes it, as 0.1 and 11.6 do."""
    if value.__class__ is not float or value - value != 0:
        return False
    return Decimal(repr(value)) != Decimal(value)


class _NumberComparison(NamedTuple):
    """Comparison for equality of a variable that is a slot of a message with a number.

    Attributes:
        numeric: for a comparison of terms, the one that compares numbers; "" otherwise.
        prefix: beginning of findings without a place.
    """

    name: str
    slot: _NumberSlot
    value: Any
    numeric: str
    place: Optional[Place]
    prefix: str


def _explain_number_comparison(comparison: _NumberComparison) -> str:
    """Return the reason why a comparison never holds, or ""."""
    name, value, slot = comparison.name, comparison.value, comparison.slot
    if slot.is_single and _is_no_single(value):
        return (
            f"{name} is a float32 ({slot.slot}), which is never exactly {value}: "
            f"write abs({name} - {value}) < 0.001"
        )
    if comparison.numeric and _has_other_type(value, slot.number_type):
        return (
            f"{name} is {_describe_number_type(slot.number_type)} ({slot.slot}), "
            f"never {_describe_number_type(type(value))}: write {comparison.numeric}"
        )
    return ""


def _find_number_comparisons(
    program: ProgramModel, created_keys: Set[Optional[Functor]]
) -> Iterator[_NumberComparison]:
    """Yield the comparisons for equality with numbers in rules, memories and subscriptions."""
    for rule in program.rules:
        events = [node.term for node in walk(rule.definition.pattern, True) if isinstance(node, EventPattern)]
        event_subterms = [Subterm(deref(term), wrap_term(term), 1, rule.place_of) for term in events]
        rule_subterm = Subterm(None, wrap_term(rule.definition.term), 1, rule.place_of)
        names = program.names_in(rule)
        yield from _compare_numbers(program, event_subterms, rule_subterm, names, created_keys, "")
    for consumer in (*program.memories, *program.subscriptions):
        goal = Subterm(None, consumer.term, 2, consumer.place_of)
        yield from _compare_numbers(
            program, [consumer.event], goal, program.names, created_keys, consumer.prefix
        )


def _functors_of_created_events(program: ProgramModel) -> Set[Optional[Functor]]:
    """Return the functors of the events that the program creates; None is included if some are unknown."""
    created_keys: Set[Optional[Functor]] = set()
    for rule in program.rules:
        head = event_raised_by(rule.definition.head)
        if head is not None:
            created_keys.add(functor_of(head))
    for call in program.all_subterms():
        if call.term.__class__ is tuple and call.term[0] in NEW_EVENT:
            created_keys.add(functor_of(call.term[1]))
    return created_keys


def _find_input_messages(
    program: ProgramModel, event: Subterm, created_keys: Set[Optional[Functor]]
) -> Iterator[Tuple[Subterm, Definition]]:
    """Yield the messages in an event pattern if topics are the only source of such events.

    The program may raise other events with numbers that no message has.
    """
    if event.key in created_keys or None in created_keys or program.message_of(event.term) is None:
        return
    for subterm in subterms(event.parent, event.position, event.place_of):
        definition = program.message_of(subterm.term)
        if definition is not None:
            yield subterm, definition


def _compare_numbers(
    program: ProgramModel,
    events: List[Subterm],
    source: Subterm,
    names: Mapping[Var, str],
    created_keys: Set[Optional[Functor]],
    prefix: str,
) -> Iterator[_NumberComparison]:
    """Yield comparisons for equality with numbers, given the events that contain their variables."""
    all_subterms = list(subterms(source.parent, source.position, source.place_of))
    # With alternatives, the variable may be bound in another branch.
    if any(subterm.key in ALTERNATIVES for subterm in all_subterms):
        return
    slots = _find_numeric_variables(program, events, created_keys)
    for subterm in all_subterms:
        numeric = _NUMERIC_EQUIVALENTS.get(subterm.key, "") if subterm.key is not None else ""
        if not numeric and subterm.key not in _NUMERIC_EQUALITIES:
            continue
        for position, other_position in ((1, 2), (2, 1)):
            variable: Any = deref(subterm.term[position])
            slot = slots.get(variable) if variable.__class__ is Var else None
            if slot is not None:
                yield _NumberComparison(
                    names.get(variable, "this variable"),
                    slot,
                    deref(subterm.term[other_position]),
                    numeric,
                    subterm.place_of(subterm.term, other_position),
                    prefix,
                )


def _find_numeric_variables(
    program: ProgramModel, events: List[Subterm], created_keys: Set[Optional[Functor]]
) -> Dict[Var, _NumberSlot]:
    slots: Dict[Var, _NumberSlot] = {}
    for event in events:
        for subterm, definition in _find_input_messages(program, event, created_keys):
            for position, slot in enumerate(definition.fields, 1):
                value: Any = deref(subterm.term[position])
                number_type = _number_type(slot)
                if value.__class__ is Var and number_type is not None:
                    source = f"{slot.name} of {definition.name}"
                    slots.setdefault(value, _NumberSlot(number_type, source, slot.type == "float32"))
    return slots


def _is_no_single(value: Any) -> bool:
    """Return whether a value is a float that no number of 32 bits equals."""
    if value.__class__ is not float or abs(value) > _MAX_SINGLE:
        return False
    return bool(struct.unpack("f", struct.pack("f", value))[0] != value)


_MAX_SINGLE = 3.4e38


def _number_type(slot: Field) -> Optional[type]:
    """Return float or int for a slot with one such number, or None."""
    return None if slot.length is not None else _NUMBER_TYPES.get(slot.type)


def _has_other_type(value: Any, number_type: Optional[type]) -> bool:
    """Return whether a value is an integer where the slot has floats, or a float where it has integers."""
    return number_type is not None and value.__class__ in (int, float) and value.__class__ is not number_type


def _describe_number_type(number_type: Optional[type]) -> str:
    return "a float" if number_type is float else "an integer"


def _advise_number(number_type: Optional[type], value: Any) -> str:
    """Return what to write instead of a number in a slot of another type: the converted number, or words."""
    if number_type is float:
        return f"{value}.0" if abs(value) < _MAX_EXACT_INTEGER else "it with a point"
    return (
        str(int(value))
        if value == value and abs(value) < _MAX_EXACT_INTEGER and value == int(value)
        else "one"
    )
