"""Checks of value types: uses of a variable that its message slot or declared argument does not allow.

A variable has the type of the slots and declared arguments where it occurs. `find_type_conflicts` reports occurrences
with types that exclude each other, and goals that treat a value as something else: arithmetic on texts, or
comparisons with constants that the value never equals.
"""

from typing import Any, Dict, Iterator, List, Mapping, NamedTuple, Optional, Set, Tuple

from ...foundation.errors import RuleError
from ...messages.message_templates import SENSOR_PREDICATES
from ...messages.type_definition import Field, functor_name
from ...prolog.machine.arithmetic import EVALUABLE
from ...prolog.syntax.literals import atom_text
from ...prolog.terms.types import Atom, CompoundTerm, Functor, String, Term, Var, deref, functor
from ..language.event_declarations import ValueType, slot_value_type
from ..language.event_operators import OperatorKind, names_of_kind
from ..language.pattern_parser import EventTerm, PlaceLookup, no_place
from ..language.rule_heads import event_raised_by, makes_event
from ..streams.aggregates import AGGREGATES
from .condition_checks import ALTERNATIVES, NUMERIC_COMPARISONS
from .event_flow_checks import event_of_consumer, events_of_goals, events_of_rule
from .program_model import NECK, ProgramModel, Subterm, subterms, wrap_term
from .value_kinds import conversion_to_text

_IS = functor("is", 2)
_EQUALITIES = frozenset(functor(name, 2) for name in ("==", "\\==", "=", "\\="))
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
    names: Mapping[Var, str],
    events: List[EventTerm],
    output: Optional[Term] = None,
) -> Iterator[RuleError]:
    """Yield the problems of one rule or clause; ``output`` is the event, record or output that it creates."""
    all_subterms = list(subterms(parent, 1, place_of))
    slots: Dict[Var, SlotOccurrence] = {}
    has_alternatives = any(subterm.key in ALTERNATIVES for subterm in all_subterms)
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
    if second.is_created and not first.is_created and second.value_type.name in _TEXTS:
        advice = conversion_to_text(name, second.value_type.name == "text")
        return f"{name} is {first.description} ({first.slot}) and goes into a text ({second.slot}): {advice}"
    second_text = f"{second.description} ({second.slot})"
    return f"{name} is {first.description} ({first.slot}) and, here, {second_text}: these are never equal"


def _check_goals(
    all_subterms: List[Subterm], slots: Dict[Var, SlotOccurrence], names: Mapping[Var, str]
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
            if term.__class__ is tuple and term[0] in EVALUABLE:
                # The arguments of arithmetic functions are numbers as well.
                operands += [(term, argument_position) for argument_position in range(1, len(term))]
            occurrence = slots.get(term) if term.__class__ is Var else None
            if (
                occurrence is not None
                and occurrence.value_type.name in _NUMBER_ADVICE
                and term not in reported
            ):
                reported.add(term)
                yield RuleError(
                    _explain_not_a_number(_name_variable(term, names), occurrence),
                    subterm.place_of(parent, position),
                )


def _check_predicate_arguments(
    program: ProgramModel,
    all_subterms: List[Subterm],
    slots: Dict[Var, SlotOccurrence],
    names: Mapping[Var, str],
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
            if expected is None and occurrence.value_type.name in _SCALAR_TYPES:
                text = f"{value}, not an array: {subterm.key} takes a list of numbers"
            elif expected is not None and occurrence.value_type.message_name != functor_name(expected):
                text = f"{value}, not a whole message: {subterm.key} takes a {expected}"
        elif expected is not None:
            definition = program.message_of(argument)
            if definition is not None and definition.name != expected:
                text = f"{subterm.key} takes a {expected}, not a {definition.name}"
        if text:
            yield RuleError(text, subterm.place_of(subterm.term, 1))


_SCALAR_TYPES = ("number", "integer", "float", "bool", "atom")
"""Names of types whose values are no arrays."""

_TEXTS = ("text", "plain_text")
"""Names of the types of strings of messages."""

_NUMBER_ADVICE = {
    "text": "compare texts with == or \\==",
    "plain_text": "compare texts with == or \\==",
    "bool": "write == true or == false",
    "string": "compare strings with == or \\==",
    "atom": "compare atoms with == or \\==",
    "list": "take a number of it, as with nth0/3 or array_min/2",
}
"""Advice for values that are not numbers, by `ValueType.name`; timestamps count as numbers."""


def _explain_not_a_number(name: str, occurrence: SlotOccurrence) -> str:
    """Return the warning for a variable that is used as a number but has another type."""
    if not occurrence.is_created:
        advice = _NUMBER_ADVICE[occurrence.value_type.name]
        return f"{name} is {occurrence.description} ({occurrence.slot}), not a number: {advice}"
    type_name = occurrence.value_type.name
    advice = conversion_to_text(name, type_name == "text") if type_name in _TEXTS else "send another variable"
    return f"{name} is a number here and goes into {occurrence.description} ({occurrence.slot}): {advice}"


def _check_aggregated_terms(
    subterm: Subterm, slots: Dict[Var, SlotOccurrence], names: Mapping[Var, str]
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
        and occurrence.value_type.name == "list"
        and subterm.parent[0] is _WINDOW
        and subterm.term[0].name in AGGREGATES
        and AGGREGATES[subterm.term[0].name].accepts_arrays
    ):
        return
    if occurrence is not None and occurrence.value_type.name in _NUMBER_ADVICE and not occurrence.is_created:
        source = f"{occurrence.description} ({occurrence.slot})"
        text = f"{_name_variable(value, names)} is {source}: {subterm.term[0].name} collects numbers"
        yield RuleError(text, subterm.place_of(subterm.term, position))


def _is_numeric_aggregate(key: Optional[Functor]) -> bool:
    function = None if key is None else AGGREGATES.get(key.name)
    return key is not None and function is not None and function.is_numeric and function.arity == key.arity


def _check_compared_terms(
    subterm: Subterm, slots: Dict[Var, SlotOccurrence], names: Mapping[Var, str]
) -> Iterator[RuleError]:
    """Yield comparisons of a variable with a constant that it never equals."""
    for position, other_position in ((1, 2), (2, 1)):
        value: Any = deref(subterm.term[position])
        constant = deref(subterm.term[other_position])
        occurrence = slots.get(value) if value.__class__ is Var else None
        reason = (
            None
            if occurrence is None or occurrence.is_created
            else _explain_inequality(occurrence.value_type.name, constant)
        )
        if occurrence is not None and reason is not None:
            yield RuleError(
                f"{_name_variable(value, names)} is {occurrence.description} ({occurrence.slot}): {reason}",
                subterm.place_of(subterm.term, other_position),
            )


def _explain_inequality(type_name: str, constant: Term) -> Optional[str]:
    """Return the reason why a value of a type never equals a constant, or None."""
    if type_name == "text":
        if isinstance(constant, Atom) and constant.name[:1] != '"' and constant.name != "[]":
            return f"it keeps its quotes in events, write '\"{constant.name}\"'"
        if isinstance(constant, String):
            return f"it keeps its quotes in events, write '\"{constant.text}\"'"
        if isinstance(constant, (int, float)):
            return f"it is never the number {constant}"
    elif type_name == "plain_text":
        return _explain_inequality_of_plain_text(constant)
    elif type_name == "number":
        if isinstance(constant, String) or (
            isinstance(constant, Atom) and constant.name not in _SPECIAL_NUMBERS
        ):
            constant_text = constant.text if isinstance(constant, String) else constant.name
            return f"it is never {constant_text}"
    elif type_name == "bool" and not _may_be_true_or_false(constant):
        return "compare it with true or false"
    return None


def _explain_inequality_of_plain_text(constant: Term) -> Optional[str]:
    """Return the reason why a text without quotes never equals a constant, or None."""
    if isinstance(constant, Atom) and len(constant.name) > 1 and constant.name[0] == constant.name[-1] == '"':
        return f"it has no quotes inside, write {atom_text(constant.name[1:-1])}"
    if isinstance(constant, String):
        return f"it is an atom in events, write {atom_text(constant.text)}"
    return f"it is never the number {constant}" if isinstance(constant, (int, float)) else None


def _may_be_true_or_false(constant: Term) -> bool:
    if isinstance(constant, Atom):
        return constant.name in ("true", "false")
    return not isinstance(constant, (int, float, String))


_SPECIAL_NUMBERS = frozenset(("nan", "inf", "infinite"))


def _name_variable(var: Var, names: Mapping[Var, str]) -> str:
    return str(names.get(var, "this variable"))
