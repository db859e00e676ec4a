"""Checks of value types: uses of a variable that its message slot or declared argument does not allow.

A variable has the type of the slots and declared arguments where it occurs. `find_type_conflicts` reports occurrences
with types that exclude each other, and goals that treat a value as something else: arithmetic on texts, or
comparisons with constants that the value never equals.

`find_number_type_mismatches` reports integers where a slot has floats and vice versa: the terms ``1`` and ``1.0`` are
different, so such a pattern never matches, and ``==`` never holds.
"""

import struct
from decimal import Decimal
from typing import Any, Dict, Iterator, List, Mapping, NamedTuple, Optional, Set, Tuple

from ...foundation.errors import Place, RuleError
from ...messages.message_templates import SENSOR_PREDICATES
from ...messages.type_definition import FLOATS, PRIMITIVES, Definition, Field, functor_name
from ...prolog.terms.types import Atom, CompoundTerm, Functor, String, Term, Var, deref, functor
from ..language.event_declarations import ValueType, slot_value_type
from ..language.event_operators import OperatorKind, names_of_kind
from ..language.pattern_parser import EventTerm, PlaceLookup, no_place
from ..language.pattern_tree import EventPattern, walk
from ..language.rule_heads import NEW_EVENT, event_raised_by, makes_event
from ..streams.aggregates import AGGREGATES
from .condition_checks import NUMERIC_COMPARISONS
from .event_flow_checks import event_of_consumer, events_of_goals, events_of_rule
from .program_model import NECK, ProgramModel, Subterm, key_of, subterms, wrap_term

_IS = functor("is", 2)
_EQUALITIES = frozenset(functor(name, 2) for name in ("==", "\\==", "=", "\\="))
_BINARY_FUNCTIONS = frozenset(
    functor(name, 2) for name in ("+", "-", "*", "/", "//", "mod", "min", "max", "**")
)
_UNARY_FUNCTIONS = frozenset(
    functor(name, 1) for name in ("-", "+", "abs", "sqrt", "round", "truncate", "float", "integer")
)
_ARRAY_PREDICATES = frozenset(
    f"array_{name}"
    for name in (
        "argmax",
        "argmin",
        "count",
        "get",
        "max",
        "mean",
        "median",
        "min",
        "percentile",
        "slice",
        "std",
        "sum",
        "where",
    )
)
"""Names of the predicates whose first argument is an array."""

_MESSAGE_PREDICATES = {
    predicate: message for message, predicates in SENSOR_PREDICATES.items() for predicate in predicates
}
"""Predicates whose first argument is a message, with its type."""

_AGGREGATE, *_ = names_of_kind(OperatorKind.AGGREGATE)
_WINDOW = functor(_AGGREGATE, 4)


class SlotOccurrence(NamedTuple):
    """Occurrence of a variable in a typed slot.

    Attributes:
        value_type: the type.
        slot: slot and message type, or declared argument and event.
        is_created: whether the program creates the term with the slot. Then the value comes from elsewhere and is put
            into the slot; otherwise the value comes from the slot.
    """

    value_type: ValueType
    slot: str
    is_created: bool

    @property
    def description(self) -> str:
        """A value of the type in words."""
        return self.value_type.description


def _accepts_other_types(slot: Field) -> bool:
    """Return whether a slot accepts more than it delivers: 0 and 1 for truth values, lists for bytes."""
    return slot.is_bytes or (slot.type == "bool" and slot.length is None)


def find_type_conflicts(program: ProgramModel) -> Iterator[RuleError]:
    """Yield uses of values that contradict their types."""
    for rule in program.rules:
        parent = wrap_term(rule.definition.term)
        names = program.names_in(rule)
        events = events_of_rule(rule) if program.declarations else []
        yield from _check_clause(
            program, parent, rule.place_of, names, events, event_raised_by(rule.definition.head)
        )
    for clause in program.clauses:
        # A fact has no parent with head and body, so it is wrapped.
        clause_term = clause.parent if clause.parent[0] is NECK else wrap_term(clause.head or clause.parent)
        events = events_of_goals(clause) if program.declarations else []
        yield from _check_clause(program, wrap_term(clause_term), clause.place_of, program.names, events)
    for consumer in (*program.memories, *program.subscriptions):
        events = [event_of_consumer(consumer)]
        for error in _check_clause(
            program, wrap_term(consumer.term), consumer.place_of, program.names, events, consumer.template
        ):
            yield RuleError(f"{consumer.prefix}{error.message}", error.place)


def _check_clause(
    program: ProgramModel,
    parent: CompoundTerm,
    place_of: PlaceLookup,
    names: Any,
    events: List[EventTerm],
    output: Optional[Term] = None,
) -> Iterator[RuleError]:
    """Yield the problems of one rule or clause; ``output`` is the event, record or output that it creates."""
    all_subterms = list(subterms(parent, 1, place_of))
    slots: Dict[Var, SlotOccurrence] = {}
    has_alternatives = any(subterm.key in _ALTERNATIVES for subterm in all_subterms)
    created_ids = _ids_of_created_terms(all_subterms, output)
    event_ids = {id(deref(event.term)) for event in events}
    for subterm in all_subterms:
        is_created = id(subterm.term) in created_ids
        for position, value_type, slot in _find_typed_arguments(program, subterm.term, is_created, event_ids):
            value = deref(subterm.term[position])
            if value.__class__ is not Var:
                continue
            occurrence = SlotOccurrence(value_type, slot, is_created)
            first_occurrence = slots.setdefault(value, occurrence)
            # In a term with alternatives, the two occurrences may belong to different branches.
            if first_occurrence.value_type.excludes(value_type) and not has_alternatives:
                yield RuleError(
                    _explain_type_clash(_name_variable(value, names), first_occurrence, occurrence),
                    place_of(subterm.term, position),
                )
                slots.pop(value)
            # The source of a value says more about its type than the slot it goes into; of two sources, the narrower
            # type is kept.
            elif (
                first_occurrence.is_created and not is_created
            ) or value_type.forms < first_occurrence.value_type.forms:
                slots[value] = occurrence
    if slots:
        yield from _check_goals(all_subterms, slots, names)
    yield from _check_predicate_arguments(program, all_subterms, slots, names)


def _find_typed_arguments(
    program: ProgramModel, term: Any, is_created: bool, event_ids: Set[int]
) -> Iterator[Tuple[int, ValueType, str]]:
    """Yield the arguments of a message or declared event: position, type, name of the slot for error texts."""
    definition = program.message_of(term)
    if definition is not None:
        for position, slot in enumerate(definition.fields, 1):
            value_type = slot_value_type(slot)
            if value_type is not None and not (is_created and _accepts_other_types(slot)):
                yield position, value_type, f"{slot.name} of {definition.name}"
    elif term.__class__ is tuple and id(term) in event_ids:
        declaration = program.declarations.get(term[0].name)
        if declaration is not None and declaration.key is term[0]:
            for position, argument in enumerate(declaration.arguments, 1):
                yield position, argument.value_type, f"{argument.name} of {declaration.key}"


def _ids_of_created_terms(all_subterms: List[Subterm], output: Optional[Term]) -> Set[int]:
    """Return the ids of the terms that are created.

    These are the head of a rule, the template of a memory or subscription, and events of goals, with their subterms.
    """
    parents = [] if output is None else [wrap_term(deref(output))]
    parents += [subterm.term for subterm in all_subterms if makes_event(subterm.term)]
    # By identity: an equal term may occur as a pattern as well. The ids stay unique, because the terms are alive.
    return {id(subterm.term) for parent in parents for subterm in subterms(parent, 1, no_place)}


def _explain_type_clash(name: str, first: SlotOccurrence, second: SlotOccurrence) -> str:
    """Return the warning for a variable with two types."""
    # The warning names the source of the value first.
    if first.is_created and not second.is_created:
        first, second = second, first
    if second.is_created and not first.is_created and second.description == "a text":
        advice = _advise_conversion_to_text(name)
        return f"{name} is {first.description} ({first.slot}) and goes into a text ({second.slot}): {advice}"
    second_text = f"{second.description} ({second.slot})"
    return f"{name} is {first.description} ({first.slot}) and, here, {second_text}: these are never equal"


def _check_goals(
    all_subterms: List[Subterm], slots: Dict[Var, SlotOccurrence], names: Any
) -> Iterator[RuleError]:
    reported: Set[Var] = set()
    for subterm in all_subterms:
        key = subterm.key
        if key in NUMERIC_COMPARISONS:
            operands = [(subterm.term, 1), (subterm.term, 2)]
        elif key is _IS:
            operands = [(subterm.term, 2)]
        else:
            if key in _EQUALITIES:
                yield from _check_compared_terms(subterm, slots, names)
            elif _is_numeric_aggregate(key):
                yield from _check_aggregated_terms(subterm, slots, names)
            continue
        while operands:
            parent, position = operands.pop(0)
            term: Any = deref(parent[position])
            if term.__class__ is tuple and (term[0] in _BINARY_FUNCTIONS or term[0] in _UNARY_FUNCTIONS):
                # The arguments of arithmetic functions are numbers as well.
                operands += [(term, argument_position) for argument_position in range(1, len(term))]
            occurrence = slots.get(term) if term.__class__ is Var else None
            if occurrence is not None and occurrence.description in _NUMBER_ADVICE and term not in reported:
                reported.add(term)
                yield RuleError(
                    _explain_not_a_number(_name_variable(term, names), occurrence),
                    subterm.place_of(parent, position),
                )


def _check_predicate_arguments(
    program: ProgramModel, all_subterms: List[Subterm], slots: Dict[Var, SlotOccurrence], names: Any
) -> Iterator[RuleError]:
    """Yield arguments that are not the array or the message that a predicate takes."""
    for subterm in all_subterms:
        if subterm.key is None or not subterm.key.arity:
            continue
        expected = _MESSAGE_PREDICATES.get(str(subterm.key))
        if expected is None and subterm.key.name not in _ARRAY_PREDICATES:
            continue
        argument: Any = deref(subterm.term[1])
        occurrence = slots.get(argument) if argument.__class__ is Var else None
        text = ""
        if occurrence is not None and not occurrence.is_created:
            value = f"{_name_variable(argument, names)} is {occurrence.description} ({occurrence.slot})"
            if expected is None and occurrence.description in _SCALAR_DESCRIPTIONS:
                text = f"{value}, not an array: {subterm.key} takes a list of numbers"
            elif expected is not None and occurrence.value_type.message_name != functor_name(expected):
                text = f"{value}, not a whole message: {subterm.key} takes a {expected}"
        elif expected is not None:
            definition = program.message_of(argument)
            if definition is not None and definition.name != expected:
                text = f"{subterm.key} takes a {expected}, not a {definition.name}"
        if text:
            yield RuleError(text, subterm.place_of(subterm.term, 1))


_SCALAR_DESCRIPTIONS = ("a number", "true or false", "an atom")

_NUMBER_ADVICE = {
    "a text": "compare texts with == or \\==",
    "true or false": "write == true or == false",
    "a string": "compare strings with == or \\==",
    "an atom": "compare atoms with == or \\==",
    "a list": "take a number of it, as with nth0/3 or array_min/2",
}
"""Advice for values that are not numbers, by `ValueType.description`; timestamps count as numbers."""


def _explain_not_a_number(name: str, occurrence: SlotOccurrence) -> str:
    """Return the warning for a variable that is used as a number but has another type."""
    if not occurrence.is_created:
        advice = _NUMBER_ADVICE[occurrence.description]
        return f"{name} is {occurrence.description} ({occurrence.slot}), not a number: {advice}"
    advice = (
        _advise_conversion_to_text(name) if occurrence.description == "a text" else "send another variable"
    )
    return f"{name} is a number here and goes into {occurrence.description} ({occurrence.slot}): {advice}"


def _advise_conversion_to_text(name: str) -> str:
    return f"make a text of it, as with format(atom(Text), '\"~w\"', [{name if name[:1].isupper() else 'X'}])"


def _check_aggregated_terms(
    subterm: Subterm, slots: Dict[Var, SlotOccurrence], names: Any
) -> Iterator[RuleError]:
    """Yield values of a numeric aggregate that are not numbers."""
    if subterm.parent[0].name != _AGGREGATE or subterm.position != 1:
        return
    position = len(subterm.term) - 1
    value: Any = deref(subterm.term[position])
    occurrence = slots.get(value) if value.__class__ is Var else None
    # Windows aggregate arrays element by element.
    if (
        occurrence is not None
        and occurrence.description == "a list"
        and subterm.parent[0] is _WINDOW
        and subterm.term[0].name in AGGREGATES
        and AGGREGATES[subterm.term[0].name].accepts_arrays
    ):
        return
    if occurrence is not None and occurrence.description in _NUMBER_ADVICE and not occurrence.is_created:
        source = f"{occurrence.description} ({occurrence.slot})"
        text = f"{_name_variable(value, names)} is {source}: {subterm.term[0].name} collects numbers"
        yield RuleError(text, subterm.place_of(subterm.term, position))


def _is_numeric_aggregate(key: Optional[Functor]) -> bool:
    function = None if key is None else AGGREGATES.get(key.name)
    return key is not None and function is not None and function.is_numeric and function.arity == key.arity


def _check_compared_terms(
    subterm: Subterm, slots: Dict[Var, SlotOccurrence], names: Any
) -> Iterator[RuleError]:
    """Yield comparisons of a variable with a constant that it never equals."""
    for position, other_position in ((1, 2), (2, 1)):
        value: Any = deref(subterm.term[position])
        constant = deref(subterm.term[other_position])
        occurrence = slots.get(value) if value.__class__ is Var else None
        reason = (
            None
            if occurrence is None or occurrence.is_created
            else _explain_inequality(occurrence.description, constant)
        )
        if occurrence is not None and reason is not None:
            yield RuleError(
                f"{_name_variable(value, names)} is {occurrence.description} ({occurrence.slot}): {reason}",
                subterm.place_of(subterm.term, other_position),
            )


def _explain_inequality(type_description: str, constant: Term) -> Optional[str]:
    """Return the reason why a value of a type never equals a constant, or None."""
    if type_description == "a text":
        if isinstance(constant, Atom) and constant.name[:1] != '"' and constant.name != "[]":
            return f"it keeps its quotes in events, write '\"{constant.name}\"'"
        if isinstance(constant, String):
            return f"it keeps its quotes in events, write '\"{constant.text}\"'"
        if isinstance(constant, (int, float)):
            return f"it is never the number {constant}"
    elif type_description == "a number":
        if isinstance(constant, String) or (
            isinstance(constant, Atom) and constant.name not in _SPECIAL_NUMBERS
        ):
            constant_text = constant.text if isinstance(constant, String) else constant.name
            return f"it is never {constant_text}"
    elif type_description == "true or false" and not _may_be_true_or_false(constant):
        return "compare it with true or false"
    return None


def _may_be_true_or_false(constant: Term) -> bool:
    if isinstance(constant, Atom):
        return constant.name in ("true", "false")
    return not isinstance(constant, (int, float, String))


_SPECIAL_NUMBERS = frozenset(("nan", "inf", "infinite"))


def _name_variable(var: Var, names: Any) -> str:
    return str(names.get(var, "this variable"))


_NUMERIC_EQUIVALENTS = {
    functor(name, 2): numeric
    for name, numeric in zip(("==", "=", "\\==", "\\="), ("=:=", "=:=", "=\\=", "=\\="))
}
"""Comparisons of terms, with the corresponding comparisons of numbers."""

_NUMERIC_EQUALITIES = frozenset((functor("=:=", 2), functor("=\\=", 2)))
_ALTERNATIVES = frozenset((functor("or", 2), functor("\\/", 2), functor(";", 2), functor("->", 2)))
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
        slot: the slot.
        name: names of the slot and of its type.
        message: the message.
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
        name: name of the variable.
        slot: the slot.
        value: the number.
        numeric: for a comparison of terms, the one that compares numbers; "" otherwise.
        place: place of the number.
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
            created_keys.add(key_of(head))
    for call in program.all_subterms():
        if call.term.__class__ is tuple and call.term[0] in NEW_EVENT:
            created_keys.add(key_of(call.term[1]))
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
    if any(subterm.key in _ALTERNATIVES for subterm in all_subterms):
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
    """Return the variables of events that are numeric slots."""
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
