"""Checks of ROS messages and topics: wrong types and slots, wrong outputs, and errors in ``pub_sub.xml``.

Messages are terms whose functor is derived from their type, so the number of slots and the values of a pattern can be
compared with the message definition. A pattern with a value that its slot never has can never match.
"""

from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Set, Tuple
from xml.parsers import expat

from ...foundation.displayed_text import format_count, printable, shorten
from ...foundation.errors import RuleError, UsageError
from ...foundation.ros_name_checks import ros1_type_name, strip_slashes, topic_fault
from ...foundation.similar_names import closest_name, did_you_mean
from ...foundation.source_places import Place, place_at_column
from ...messages.action_events import STATUS, STATUSES, find_action_event
from ...messages.encoder import find_fault
from ...messages.type_definition import Definition, Field, type_name
from ...prolog.syntax.literals import atom_text
from ...prolog.terms.list_terms import list_items
from ...prolog.terms.types import (
    FALSE,
    NIL,
    TRUE,
    Atom,
    CompoundTerm,
    Functor,
    String,
    Term,
    Var,
    deref,
    functor,
)
from ..language.pattern_parser import no_place
from ..language.rule_heads import NEW_EVENT, event_raised_by
from ..program.topic_configuration import (
    ATTRIBUTES,
    OBSERVE_ACTION,
    OBSERVE_SERVICE,
    PUBLISH,
    ROOT_ATTRIBUTES,
    ROOT_ELEMENT,
    SUBSCRIBE,
    TOPICS,
    read_xml,
)
from .event_flow_checks import SUBSCRIBE_TO
from .program_model import (
    MIN_SIMILARITY,
    EventConsumer,
    ProgramModel,
    Subterm,
    constant_place_lookup,
    is_variable,
    subterms,
    wrap_term,
)
from .value_kinds import is_numeral

_SPECIAL_NUMBERS = frozenset(("nan", "inf", "infinite"))
_TIMES = frozenset(("time", "duration"))
_COLON_PAIR = functor(":", 2)


def find_message_mismatches(program: ProgramModel) -> Iterator[RuleError]:
    """Yield terms that have the name of a message type but do not fit it."""
    definitions = [program.definition(type_name) for type_name in _types_of_topics(program)]
    names = sorted(
        {
            name
            for definition in definitions
            if definition
            for name in (definition.name, *[nested.name for nested in definition.dependencies()])
        }
    )
    packages_without_types = {
        type_name.partition("/")[0]
        for type_name in _types_of_topics(program)
        if _is_defined_later(program, type_name)
    }
    reported: Set[Functor] = set()
    for subterm, prefix in _subterms_named_as_messages(program):
        key = subterm.key
        type_name = None if key is None or key in reported else program.type_of(key.name)
        if key is None or type_name is None:
            continue
        # One error per functor: all events of that name have the same fault.
        reported.add(key)
        fault = _find_type_fault(program, key, type_name, names, packages_without_types)
        if fault:
            yield RuleError(f"{prefix}{fault}", subterm.place)


def _types_of_topics(program: ProgramModel) -> List[str]:
    topics = program.topics
    return [
        type_name for _, type_name in (*topics.subscribed, *topics.published, *program.directly_subscribed)
    ]


def _is_defined_later(program: ProgramModel, type_name: str) -> bool:
    """Return whether a type may be received from its publishers later: it is unknown and not a mistake."""
    definitions = program.definitions
    return (
        program.definition(type_name) is None
        and not definitions.misspelt(type_name)
        and not definitions.is_missing_in_package(type_name)
    )


def _subterms_named_as_messages(program: ProgramModel) -> Iterator[Tuple[Subterm, str]]:
    """Yield all terms named after a message type, and all events named after a topic."""
    for subterm, prefix in _all_subterms(program):
        if subterm.key is not None and type_name(subterm.key.name) is not None:
            yield subterm, prefix
    for subterm, prefix in _event_subterms(program):
        if subterm.key is not None and type_name(subterm.key.name) is None:
            yield subterm, prefix


def _event_subterms(program: ProgramModel) -> Iterator[Tuple[Subterm, str]]:
    """Yield terms in positions that only events have; elsewhere, the name of a topic may denote other things."""
    yield from program.patterns()
    for rule in program.rules:
        head = event_raised_by(rule.definition.head)
        if head is not None:
            place = rule.definition.place if head.__class__ is Atom else rule.place_of(head)
            yield Subterm(head, wrap_term(head), 1, constant_place_lookup(place)), ""
    for subterm in program.all_subterms():
        if subterm.term.__class__ is tuple and subterm.term[0] in NEW_EVENT:
            yield Subterm(deref(subterm.term[1]), subterm.term, 1, subterm.place_of), ""


def _all_subterms(program: ProgramModel) -> Iterator[Tuple[Subterm, str]]:
    for rule in program.rules:
        for subterm in subterms(wrap_term(rule.definition.term), 1, rule.place_of):
            yield subterm, ""
    for consumer in (*program.memories, *program.subscriptions):
        for position in (1, 3):
            for subterm in subterms(consumer.term, position, consumer.place_of):
                yield subterm, consumer.prefix
    for clause in program.clauses:
        for subterm in subterms(clause.parent, clause.position, clause.place_of):
            yield subterm, ""


def _find_type_fault(
    program: ProgramModel, key: Functor, type_name: str, names: List[str], packages_without_types: Set[str]
) -> str:
    definition = program.definition(type_name)
    if definition is None:
        # If another type of the package is unknown here, its definitions come from the publishers later. This one may
        # then be defined as well, so it is not reported.
        if type_name.partition("/")[0] in packages_without_types:
            return ""
        closest = closest_name(type_name, names, 0.8) or program.definitions.misspelt(type_name)
        return f"there is no message type {type_name} here; did you mean {closest}?" if closest else ""
    slots = [slot.name for slot in definition.fields]
    if len(slots) == key.arity:
        return ""
    fault = f"{key} does not match its type: {type_name} has {format_count(len(slots), 'slot')}"
    if not slots:
        return fault
    advice = "write" if key.arity == 0 else "write all of them, or some by name:"
    return f"{fault}: {', '.join(slots)}; {advice} {key.name}{{{slots[0]}: ...}}"


def find_impossible_values(program: ProgramModel) -> Iterator[RuleError]:
    """Yield values in patterns that no message has in that slot."""
    for event, prefix in program.patterns():
        for subterm in subterms(event.parent, event.position, event.place_of):
            definition = program.message_of(subterm.term)
            if definition is None:
                continue
            for position, slot in enumerate(definition.fields, 1):
                value = deref(subterm.term[position])
                fault = (
                    _find_slot_named_in_parentheses(definition, subterm.term, value)
                    or _find_value_fault(slot, value)
                    or _find_status_fault(definition, slot, value)
                )
                if fault:
                    message = f"{slot.name} of {definition.name} {fault}"
                    yield RuleError(f"{prefix}{message}", subterm.place_of(subterm.term, position))


def _find_slot_named_in_parentheses(definition: Definition, message: CompoundTerm, value: Any) -> str:
    """Return the error for a slot that is named as in ``button(data: true)``, or ""."""
    name = deref(value[1]) if value.__class__ is tuple and value[0] is _COLON_PAIR else None
    if not isinstance(name, Atom) or name.name not in [slot.name for slot in definition.fields]:
        return ""
    return f"is not named in parentheses: write {message[0].name}{{{name.name}: ...}}"


def _find_status_fault(definition: Definition, slot: Field, value: Any) -> str:
    """Return the error for a status that no goal of an action has, or ""."""
    is_status = slot.name == STATUS and find_action_event(definition.name) is not None
    if not is_status or not isinstance(value, Atom):
        return ""
    name = value.name.strip('"')
    return "" if name in STATUSES else f"is {' or '.join(STATUSES)}{did_you_mean(name, STATUSES)}"


def _find_value_fault(slot: Field, value: Any) -> str:
    """Return the reason why a slot never has a value, or ""."""
    if value.__class__ is Var:
        return ""
    if slot.length is not None and not slot.is_bytes:
        is_list = value is NIL or list_items(value) is not None or _is_open_list(value)
        # An open list may have any length.
        return "" if is_list else "is a list in events: write [...]"
    if slot.is_plain:
        return _find_plain_text_fault(value)
    if slot.type == "string" or slot.is_bytes:
        return _find_text_fault(value)
    if slot.definition is not None:
        return _find_message_fault(slot.definition, value)
    if slot.type in _TIMES:
        items = list_items(value)
        return "" if items is not None and len(items) == 2 else "is a stamp in events: write [Sec,NSec]"
    if slot.type == "bool":
        return "" if value is TRUE or value is FALSE else "is true or false in events"
    return _find_number_fault(value)


def _find_text_fault(value: Any) -> str:
    if isinstance(value, (Atom, String)):
        content = value.name if isinstance(value, Atom) else value.text
        # Strings of messages are atoms that include the quotes, which distinguishes them from other atoms.
        if not content.startswith('"'):
            text = f"is a string, which keeps its quotes in events: write '\"{content}\"'"
            return f"{text}{_advise_variable(value)}"
        return ""
    return (
        f"is a string in events: write '\"{value}\"'"
        if isinstance(value, (int, float))
        else "is a string in events"
    )


def _find_plain_text_fault(value: Any) -> str:
    if isinstance(value, Atom):
        name = value.name
        is_quoted = len(name) > 1 and name[0] == name[-1] == '"'
        return f"is a text without quotes inside: write {atom_text(name[1:-1])}" if is_quoted else ""
    if isinstance(value, String):
        return f"is an atom in events: write {atom_text(value.text)}"
    if isinstance(value, (int, float)):
        return f"is a text in events: write '{value}'"
    return "is a text in events"


def _find_number_fault(value: Any) -> str:
    if isinstance(value, (int, float)) or (isinstance(value, Atom) and value.name in _SPECIAL_NUMBERS):
        return ""
    if value.__class__ is tuple and value[0].name == "-":
        return ""
    numeral = getattr(value, "name", getattr(value, "text", "")).strip('"')
    if is_numeral(numeral):
        return f"is a number in events: write {numeral}"
    advice = _advise_variable(value)
    return f"is a number in events: write a number{advice}" if advice else "is a number in events"


def _advise_variable(value: Any) -> str:
    """Return advice on a name of one letter that is written as a constant, or ""."""
    is_letter = isinstance(value, Atom) and len(value.name) == 1 and value.name.islower()
    return f", or the variable {value.name.upper()}" if is_letter else ""


def _find_message_fault(definition: Definition, value: Any) -> str:
    name = value[0].name if value.__class__ is tuple else getattr(value, "name", "")
    if name == definition.functor_name:
        return ""
    slots = ", ".join(slot.name for slot in definition.fields)
    return f"is a message in events: write {definition.functor_name}({slots})" if slots else ""


def _is_open_list(value: Term) -> bool:
    return value.__class__ is tuple and value[0].name in ("[|]", ".")


def find_output_mismatches(program: ProgramModel) -> Iterator[RuleError]:
    """Yield outputs of subscriptions that do not fit the message types of their topics."""
    published = {strip_slashes(topic): type_name for topic, type_name in program.topics.published}
    for subscription, topic in _subscriptions_with_topic(program):
        type_name = published.get(strip_slashes(topic))
        definition = None if type_name is None else program.definition(type_name)
        fault = None if definition is None else find_output_fault(definition, subscription.term, topic)
        if fault is not None:
            yield RuleError(
                f"{subscription.prefix}{fault}",
                subscription.place_of(subscription.term, 1 if subscription.stores_whole_event else 3),
            )


_ROS_SERVICE = frozenset((functor("ros_service", 4), functor("ros_service", 5)))


def find_request_mismatches(program: ProgramModel) -> Iterator[RuleError]:
    """Yield requests of services that do not fit their types."""
    for subterm in _service_goals(program):
        name = _constant_text(subterm.term[1])
        request: Any = deref(subterm.term[3])
        definition = program.definition(f"{ros1_type_name(_constant_text(subterm.term[2]))}_Request")
        # Other checks report a message with a wrong number of slots.
        has_other_arity = (
            request.__class__ is tuple
            and definition is not None
            and request[0].name == definition.functor_name
            and len(request) - 1 != len(definition.fields)
        )
        if definition is None or has_other_arity:
            continue
        fault = find_fault(definition, request)
        if fault:
            yield RuleError(f"request of service {shorten(name)}: {fault}", subterm.place_of(subterm.term, 3))


def find_refused_services(program: ProgramModel) -> Iterator[RuleError]:
    """Yield services that goals may not call."""
    for subterm in _service_goals(program):
        name = _constant_text(subterm.term[1])
        refusal = program.find_refusal(name) if name else ""
        if refusal:
            yield RuleError(refusal, subterm.place)


def find_called_services(program: ProgramModel) -> Iterator[RuleError]:
    """Yield once the permission that the goals of the program need, with the services that are known."""
    goals = list(_service_goals(program))
    names = sorted({_constant_text(goal.term[1]) for goal in goals} - {""})
    if goals:
        yield RuleError(
            "goals call services: a node needs the parameter ~allow_services, as in "
            f"allow_services:=[{','.join(names) if names else '/name/*'}]",
            goals[0].place,
        )


def _service_goals(program: ProgramModel) -> Iterator[Subterm]:
    """Yield the terms that call a service."""
    return (subterm for subterm in program.all_subterms() if subterm.key in _ROS_SERVICE)


def _constant_text(term: Term) -> str:
    """Return the text of an atom or string; "" for other terms."""
    value: Any = deref(term)
    if value.__class__ is String:
        return str(value.text)
    return str(value.name) if value.__class__ is Atom else ""


def find_untyped_topics(program: ProgramModel) -> Iterator[RuleError]:
    """Yield topics that have no message type, each once, and each subscription to a topic with an invalid name."""
    published = [strip_slashes(topic) for topic, _ in program.topics.published]
    forwarded = [strip_slashes(topic) for topic in program.topics.forwarded]
    reported: Set[str] = set()
    for subscription, topic in _subscriptions_with_topic(program):
        name = strip_slashes(topic)
        if (
            topic in reported
            or any(_may_be_same_topic(name, published_topic) for published_topic in published)
            or any(fnmatchcase(name, pattern) for pattern in forwarded)
        ):
            continue
        # An element of `pub_sub.xml` cannot help a name that ROS does not allow: each subscription has to be changed.
        fault = topic_fault(topic)
        if fault is None:
            reported.add(topic)
        yield RuleError(
            f"topic {shorten(topic)} has no type: its events are published only as text on retalisOutputEvents"
            + (f"; {fault}" if fault else _advise_topic(program, subscription, topic, published)),
            subscription.place_of(subscription.term, 4),
        )


def _advise_topic(
    program: ProgramModel, subscription: EventConsumer, topic: str, published: List[str]
) -> str:
    """Return what to write for a topic of a subscription that has no type."""
    subscription_id = program.logic.show(subscription.term[5], quoted=False)
    if strip_slashes(subscription_id) in published:
        return (
            f"; {shorten(subscription_id)} is the id here: write "
            "subscribe(Pattern, Conditions, Template, Topic, Id)"
        )
    return did_you_mean(strip_slashes(topic), published, MIN_SIMILARITY) or (
        f'; <publish_to name="{shorten(topic)}" msg_type="package/Type"/> in {TOPICS} would give it one'
    )


def _subscriptions_with_topic(program: ProgramModel) -> Iterator[Tuple[EventConsumer, str]]:
    """Yield the subscriptions whose topic is no variable, each with its topic."""
    for subscription in program.subscriptions:
        if not is_variable(subscription.term[4]):
            yield subscription, program.topic_of(subscription.term[4])


def _may_be_same_topic(first: str, second: str) -> bool:
    """Return whether two topic names can denote the same topic in some namespace."""
    return first == second or first.endswith(f"/{second}") or second.endswith(f"/{first}")


def find_output_fault(definition: Definition, subscription: CompoundTerm, topic: str) -> Optional[str]:
    """Return the reason why the output of a subscription is not a message of a type, or None.

    The answer is None as well if it depends on the values of variables.
    """
    output = deref(EventConsumer(subscription, "", no_place).output_term)
    # The event itself is sent if the form is a variable, and events may be anything.
    return None if is_variable(output) else find_fault(definition, output, topic)


class Element(NamedTuple):
    """Element of ``pub_sub.xml``, with its place."""

    tag: str
    attributes: Dict[str, str]
    place: Place


def read_elements(path: Path) -> List[Element]:
    """Return the elements of ``pub_sub.xml``; none if it cannot be read or is not well-formed."""
    result: List[Element] = []
    try:
        text = read_xml(path)
    except UsageError:
        return result
    lines = text.splitlines()
    parser = expat.ParserCreate()

    def add_element(tag: str, attributes: Dict[str, str]) -> None:
        line_number = parser.CurrentLineNumber
        line = lines[line_number - 1] if line_number <= len(lines) else ""
        result.append(
            Element(
                tag, attributes, place_at_column(str(path), line_number, parser.CurrentColumnNumber + 1, line)
            )
        )

    # expat reports positions, which the standard tree parsers do not.
    parser.StartElementHandler = add_element
    try:
        parser.Parse(text, True)
    except expat.ExpatError:
        # Reported when the file was loaded.
        return []
    return result


def find_topic_mistakes(program: ProgramModel) -> Iterator[RuleError]:
    """Yield likely mistakes in ``pub_sub.xml``, and misspelt types in goals."""
    yield from _find_misspelt_types_in_goals(program)
    if program.folder is None:
        return
    elements_by_topic: Dict[Tuple[str, str], Element] = {}
    for element in read_elements(program.folder / TOPICS):
        if element.tag == ROOT_ELEMENT:
            yield from _find_unknown_attributes(element, tuple(ROOT_ATTRIBUTES))
            continue
        attributes = ATTRIBUTES.get(element.tag)
        if attributes is None:
            if element.attributes:
                tag = printable(shorten(element.tag))
                yield RuleError(
                    f"<{tag}> is not known: it is ignored{did_you_mean(element.tag, ATTRIBUTES, 0.5)}",
                    element.place,
                )
            continue
        yield from _find_unknown_attributes(element, attributes)
        topic, type_name = (element.attributes.get(name, "").strip() for name in attributes[:2])
        # Names with and without a leading slash denote the same topic at the top level.
        first = elements_by_topic.setdefault((element.tag, strip_slashes(topic)), element)
        if first is not element:
            yield RuleError(_explain_duplicate_topic(element, first, topic, type_name), element.place)
        if element.tag in _INTERFACE_FOLDERS:
            yield from _find_interface_mistakes(program, element, topic, ros1_type_name(type_name))
            continue
        yield from _find_misspelt_type(program, type_name, element.place)
        if element.tag == SUBSCRIBE:
            yield from _find_unrecorded_topic(program, topic, type_name, element.place)


def _find_unknown_attributes(element: Element, attributes: Tuple[str, ...]) -> Iterator[RuleError]:
    for name in element.attributes:
        if name not in attributes:
            attribute = printable(shorten(name))
            hint = did_you_mean(name, attributes, MIN_SIMILARITY) or f"; it has {', '.join(attributes)}"
            yield RuleError(f"<{element.tag}> has no attribute {attribute}{hint}", element.place)


_INTERFACE_FOLDERS = {OBSERVE_ACTION: "action", OBSERVE_SERVICE: "srv"}


def _find_interface_mistakes(
    program: ProgramModel, element: Element, name: str, type_name: str
) -> Iterator[RuleError]:
    """Yield a misspelt type of an action or service, and one that the bags do not have."""
    folder_name = _INTERFACE_FOLDERS[element.tag]
    description = "action" if element.tag == OBSERVE_ACTION else "service"
    closest = program.definitions.misspelt_interface(type_name, folder_name)
    if closest:
        yield RuleError(f"there is no {description} type {type_name}; did you mean {closest}?", element.place)
    # The names of topics of an action begin with that of the action.
    prefix = f"{strip_slashes(name)}/"
    recorded_names = [strip_slashes(recorded.topic) for recorded in program.recorded_topics]
    if not recorded_names or any(recorded.startswith(prefix) for recorded in recorded_names):
        return
    hint = did_you_mean(strip_slashes(name), map(_interface_topic, recorded_names), MIN_SIMILARITY)
    if hint:
        yield RuleError(f"the bag has no {description} {name}{hint}", element.place)


def _interface_topic(topic: str) -> str:
    """Return the name of the action or service that a topic may belong to."""
    name, mark, _ = topic.partition("/_")
    return name if mark else topic.rpartition("/")[0]


def _find_unrecorded_topic(
    program: ProgramModel, topic: str, type_name: str, place: Place
) -> Iterator[RuleError]:
    """Yield a subscribed topic that the bags have with another type, or under a similar name only."""
    name = strip_slashes(topic)
    types = {
        recorded.type
        for recorded in program.recorded_topics
        if _may_be_same_topic(strip_slashes(recorded.topic), name)
    }
    if types:
        if type_name not in types:
            yield RuleError(
                f"topic {topic} is {' or '.join(sorted(types))} in the bag, not {type_name}", place
            )
        return
    subscribed = {strip_slashes(other) for other, _ in program.topics.subscribed}
    others = [
        recorded for recorded in program.recorded_topics if strip_slashes(recorded.topic) not in subscribed
    ]
    closest = closest_name(name, [strip_slashes(other.topic) for other in others], MIN_SIMILARITY)
    suggestions = [closest] if closest else [other.topic for other in others if other.type == type_name]
    if suggestions:
        yield RuleError(f"the bag has no topic {topic}; did you mean {suggestions[0]}?", place)


def find_awaited_constants(program: ProgramModel) -> Iterator[RuleError]:
    """Yield constants of types whose definitions are not known yet."""
    for message_type, place in program.awaited_constants.items():
        yield RuleError(
            f"the constants of {message_type} are not known: rules with them match nothing until the program is "
            "loaded again, after a publisher has defined the type",
            place,
        )


def find_shared_events(program: ProgramModel) -> Iterator[RuleError]:
    """Yield topics of one type whose messages are the same event, if a rule does not tell them apart."""
    if program.folder is None:
        return
    first_elements: Dict[str, Element] = {}
    shared: Dict[str, Element] = {}
    for element in read_elements(program.folder / TOPICS):
        type_name = element.attributes.get("msg_type", "").strip()
        if element.tag == SUBSCRIBE and not element.attributes.get("event"):
            first = first_elements.setdefault(type_name, element)
            if first is not element:
                shared.setdefault(type_name, element)
    for type_name, element in shared.items():
        definition = program.definition(type_name)
        if definition is None:
            continue
        for event, _ in program.patterns():
            if program.message_of(event.term) is definition and not _tells_source(program, event.term):
                topics = [one.attributes["name"].strip() for one in (first_elements[type_name], element)]
                yield RuleError(
                    f"{event.key} is the event of both {topics[0]} and {topics[1]}, and a rule or memory does not "
                    f'tell them apart: unless this is intended, add event="..." to each element',
                    element.place,
                )
                break


def _tells_source(program: ProgramModel, message: CompoundTerm) -> bool:
    """Return whether the pattern of a message uses a text or an array, which may name the source of the message."""
    for subterm in subterms(wrap_term(message), 1, no_place):
        definition = program.message_of(subterm.term)
        for position, slot in enumerate(() if definition is None else definition.fields, 1):
            value = deref(subterm.term[position])
            is_unused = value.__class__ is Var and program.names.get(value, "_").startswith("_")
            may_name = slot.type == "string" or slot.length is not None or slot.definition is not None
            # The fields of a nested message are examined on their own.
            if may_name and not is_unused and program.message_of(value) is None:
                return True
    return False


def _find_misspelt_types_in_goals(program: ProgramModel) -> Iterator[RuleError]:
    for subterm in program.all_subterms():
        if subterm.key in SUBSCRIBE_TO:
            yield from _find_misspelt_type(
                program, getattr(deref(subterm.term[2]), "name", ""), subterm.place
            )
        elif subterm.key in _ROS_SERVICE:
            type_name = ros1_type_name(_constant_text(subterm.term[2]))
            closest = program.definitions.misspelt_interface(type_name, "srv")
            if closest:
                yield RuleError(
                    f"there is no service type {type_name}; did you mean {closest}?", subterm.place
                )


def _find_misspelt_type(program: ProgramModel, type_name: str, place: Optional[Place]) -> Iterator[RuleError]:
    closest = program.definitions.misspelt(type_name)
    if closest:
        yield RuleError(f"there is no message type {type_name}; did you mean {closest}?", place)
    elif program.definitions.is_missing_in_package(type_name):
        package = ros1_type_name(type_name).partition("/")[0]
        yield RuleError(
            f"there is no message type {type_name}: the installed package {package} does not have it", place
        )


def _explain_duplicate_topic(element: Element, first: Element, topic: str, type_name: str) -> str:
    subject, action = _DUPLICATES[element.tag]
    other_type = first.attributes.get(ATTRIBUTES[element.tag][1], "").strip()
    types = "" if other_type == type_name else f", as {other_type}"
    return f"{subject} {topic} is {action} already in line {first.place.line}{types}: remove one of the two"


_DUPLICATES = {
    SUBSCRIBE: ("topic", "subscribed"),
    PUBLISH: ("topic", "published"),
    OBSERVE_ACTION: ("action", "observed"),
    OBSERVE_SERVICE: ("service", "observed"),
}
"""Subject of an element and the verb for it, in reports of repeated elements."""
