"""Messages that do not fit their types: wrong names, wrong numbers of slots, values that no slot has.

What goes out: formats of subscriptions against the types of their topics, and topics that nobody publishes.

What ``pub_sub.xml`` says that nobody reads: unknown tags and attributes, types that are nowhere, a topic twice.
"""

from pathlib import Path
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Set, Tuple
from xml.parsers import expat

from ...foundation.errors import Place, RuleError, UsageError, beginning, counted, place_in, printable
from ...messages.term_validation import fault_of
from ...messages.type_definition import Definition, Field, type_name
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
from ..language.rule_parser import NEW_EVENT, made_by
from ..program.event_file_checker import nowhere
from ..program.program_folder import ATTRIBUTES, TOPICS, read_text
from .producer_checks import SUBSCRIBE_TO
from .program_model import Inner, Kept, ProgramModel, everywhere, held, inners, is_open, meant, near

_NUMBERS = frozenset(("nan", "inf", "infinite"))
_TIMES = frozenset(("time", "duration"))
_NAMED = functor(":", 2)


def wrong_messages(program: ProgramModel) -> Iterator[RuleError]:
    """Yield the terms that are no messages of a type that is known."""
    known = [program.definition(kind) for kind in _types(program)]
    names = sorted({name for one in known if one for name in (one.name, *_nested(one))})
    later = {kind.partition("/")[0] for kind in _types(program) if _comes_later(program, kind)}
    seen: Set[Functor] = set()
    for inner, who in _messages(program):
        key = inner.key
        kind = None if key is None or key in seen else program.type_of(key.name)
        if key is None or kind is None:
            continue
        seen.add(key)
        wrong = _wrong(program, key, kind, names, later)
        if wrong:
            yield RuleError(f"{who}{wrong}", inner.place)


def _types(program: ProgramModel) -> List[str]:
    topics = program.topics
    return [kind for _, kind in (*topics.subscribed, *topics.published, *program.direct)]


def _comes_later(program: ProgramModel, kind: str) -> bool:
    """Tell whether a type may be learned from its publishers: it is not known, and not a misspelt one that is."""
    return program.definition(kind) is None and not program.definitions.misspelt(kind)


def _nested(definition: Definition) -> List[str]:
    return [nested.name for nested in definition.dependencies()]


def _messages(program: ProgramModel) -> Iterator[Tuple[Inner, str]]:
    """Yield all terms that are called as a type is, and the events that are called as a topic's."""
    for inner, who in _all(program):
        if inner.key is not None and type_name(inner.key.name) is not None:
            yield inner, who
    for inner, who in _events(program):
        if inner.key is not None and type_name(inner.key.name) is None:
            yield inner, who


def _events(program: ProgramModel) -> Iterator[Tuple[Inner, str]]:
    """Yield what stands where only events do; elsewhere the name of a topic's events may be any other thing's."""
    yield from program.patterns()
    for rule in program.rules:
        head = made_by(rule.definition.head)
        if head is not None:
            place = rule.definition.place if head.__class__ is Atom else rule.spot(head)
            yield Inner(head, held(head), 1, everywhere(place)), ""
    for inner in program.calls():
        if inner.term.__class__ is tuple and inner.term[0] in NEW_EVENT:
            yield Inner(deref(inner.term[1]), inner.term, 1, inner.spot), ""


def _all(program: ProgramModel) -> Iterator[Tuple[Inner, str]]:
    for rule in program.rules:
        for inner in inners(held(rule.definition.term), 1, rule.spot):
            yield inner, ""
    for kept in (*program.memories, *program.subscriptions):
        for number in (1, 3):
            for inner in inners(kept.term, number, kept.spot):
                yield inner, kept.who
    for clause in program.clauses:
        for inner in inners(clause.parent, clause.number, clause.spot):
            yield inner, ""


def _wrong(program: ProgramModel, key: Functor, kind: str, names: List[str], later: Set[str]) -> str:
    definition = program.definition(kind)
    if definition is None:
        if kind.partition("/")[0] in later:
            return ""
        found = near(kind, names, 0.8) or program.definitions.misspelt(kind)
        return f"there is no message type {kind} here; did you mean {found}?" if found else ""
    slots = [slot.name for slot in definition.fields]
    if len(slots) == key.arity:
        return ""
    wrong = f"{key} does not match its type: {kind} has {counted(len(slots), 'slot')}"
    if not slots:
        return wrong
    advice = "write" if key.arity == 0 else "write all of them, or some by name:"
    return f"{wrong}: {', '.join(slots)}; {advice} {key.name}{{{slots[0]}: ...}}"


def values(program: ProgramModel) -> Iterator[RuleError]:
    """Yield the values in patterns that no message has in their slots."""
    for event, who in program.patterns():
        for inner in inners(event.parent, event.number, event.spot):
            definition = program.message_of(inner.term)
            if definition is None:
                continue
            for at, slot in enumerate(definition.fields, 1):
                value = deref(inner.term[at])
                wrong = _in_braces(definition, inner.term, value) or _misfit(slot, value)
                if wrong:
                    message = f"{slot.name} of {definition.name} {wrong}"
                    yield RuleError(f"{who}{message}", inner.spot(inner.term, at))


def _in_braces(definition: Definition, message: CompoundTerm, value: Any) -> str:
    """Return how a slot is named that is named as in ``button(data: true)``, "" for another value."""
    name = deref(value[1]) if value.__class__ is tuple and value[0] is _NAMED else None
    if not isinstance(name, Atom) or name.name not in [slot.name for slot in definition.fields]:
        return ""
    return f"is not named in parentheses: write {message[0].name}{{{name.name}: ...}}"


def _misfit(slot: Field, value: Any) -> str:
    """Return why a value in a pattern is never in a slot, "" where it may be."""
    if value.__class__ is Var:
        return ""
    if slot.length is not None and not slot.is_bytes:
        is_list = value is NIL or list_items(value) is not None or _is_open_list(value)
        return "" if is_list else "is a list in events: write [...]"
    if slot.type == "string" or slot.is_bytes:
        return _no_text(value)
    if slot.definition is not None:
        return _no_message(slot.definition, value)
    if slot.type in _TIMES:
        items = list_items(value)
        return "" if items is not None and len(items) == 2 else "is a stamp in events: write [Sec,NSec]"
    if slot.type == "bool":
        return "" if value is TRUE or value is FALSE else "is true or false in events"
    return _no_number(value)


def _no_text(value: Any) -> str:
    if isinstance(value, (Atom, String)):
        text = value.name if isinstance(value, Atom) else value.text
        if not text.startswith('"'):
            return f"is a string, which keeps its quotes in events: write '\"{text}\"'"
        return ""
    return (
        f"is a string in events: write '\"{value}\"'"
        if isinstance(value, (int, float))
        else "is a string in events"
    )


def _no_number(value: Any) -> str:
    if isinstance(value, (int, float)) or (isinstance(value, Atom) and value.name in _NUMBERS):
        return ""
    if value.__class__ is tuple and value[0].name == "-":
        return ""
    plain = getattr(value, "name", getattr(value, "text", "")).strip('"')
    return f"is a number in events: write {plain}" if _reads(plain) else "is a number in events"


def _reads(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _no_message(definition: Definition, value: Any) -> str:
    name = value[0].name if value.__class__ is tuple else getattr(value, "name", "")
    if name == definition.functor_name:
        return ""
    slots = ", ".join(slot.name for slot in definition.fields)
    return f"is a message in events: write {definition.functor_name}({slots})" if slots else ""


def _is_open_list(value: Term) -> bool:
    return value.__class__ is tuple and value[0].name in ("[|]", ".")


def outputs(program: ProgramModel) -> Iterator[RuleError]:
    """Yield the outputs that are no messages of the types of their topics."""
    published = {plain(topic): kind for topic, kind in program.topics.published}
    for kept, topic in _named(program):
        kind = published.get(plain(topic))
        definition = None if kind is None else program.definition(kind)
        wrong = None if definition is None else output_fault(definition, kept.term, topic)
        if wrong is not None:
            yield RuleError(f"{kept.who}{wrong}", kept.spot(kept.term, 1 if kept.stands_for_event else 3))


def unpublished(program: ProgramModel) -> Iterator[RuleError]:
    """Yield the topics to which events go that have no type."""
    published = [plain(topic) for topic, _ in program.topics.published]
    said: Set[str] = set()
    for kept, topic in _named(program):
        if topic in said or any(_may_be(plain(topic), other) for other in published):
            continue
        said.add(topic)
        name = beginning(topic)
        advice = f'; <publish_to name="{name}" msg_type="package/Type"/> in {TOPICS} would give it one'
        yield RuleError(
            f"topic {name} has no type: its events are published only as text on retalisOutputEvents"
            f"{meant(plain(topic), published) or advice}",
            kept.spot(kept.term, 4),
        )


def _named(program: ProgramModel) -> Iterator[Tuple[Kept, str]]:
    """Yield the subscriptions whose topics are known, with these."""
    for kept in program.subscriptions:
        if not is_open(kept.term[4]):
            yield kept, program.topic(kept.term[4])


def _may_be(one: str, other: str) -> bool:
    """Tell whether two topics may be the same in some namespace."""
    return one == other or one.endswith(f"/{other}") or other.endswith(f"/{one}")


def plain(topic: str) -> str:
    """Return a topic's name by which two are compared."""
    return topic.lstrip("/")


def output_fault(definition: Definition, subscription: CompoundTerm, topic: str) -> Optional[str]:
    """Return why the term that a subscription sends is no message of a type, whatever the values of its variables.

    Return None if it may be one.

    Args:
        definition: the type.
        subscription: the goal ``subscribe/5``.
        topic: is named in the answer.
    """
    sent = deref(Kept(subscription, "", nowhere).made)
    return None if is_open(sent) else fault_of(definition, sent, topic)


_ROOT = "publish_subscribe"


class Element(NamedTuple):
    """An element of the file, and where it stands."""

    tag: str
    attributes: Dict[str, str]
    place: Place


def elements(path: Path) -> List[Element]:
    """Return the elements of a file that has been read without errors; none where it cannot be read."""
    found: List[Element] = []
    try:
        text = read_text(path)
    except UsageError:
        return found
    lines = text.splitlines()
    parser = expat.ParserCreate()

    def element(tag: str, attributes: Dict[str, str]) -> None:
        number = parser.CurrentLineNumber
        line = lines[number - 1] if number <= len(lines) else ""
        found.append(
            Element(tag, attributes, place_in(str(path), number, parser.CurrentColumnNumber + 1, line))
        )

    parser.StartElementHandler = element
    try:
        parser.Parse(text, True)
    except expat.ExpatError:  # said when it was read
        return []
    return found


def topics(program: ProgramModel) -> Iterator[RuleError]:
    """Yield what is hardly meant in the file, and which types goals misspell."""
    yield from _asked(program)
    if program.folder is None:
        return
    seen: Dict[Tuple[str, str], Element] = {}
    for one in elements(program.folder / TOPICS):
        known = ATTRIBUTES.get(one.tag)
        if known is None:
            if one.attributes and one.tag != _ROOT:
                tag = printable(beginning(one.tag))
                yield RuleError(
                    f"<{tag}> is not known: what it says is not read{meant(one.tag, ATTRIBUTES, 0.5)}",
                    one.place,
                )
            continue
        for name in one.attributes:
            if name not in known:
                text = printable(beginning(name))
                hint = meant(name, known) or f"; it has {', '.join(known)}"
                yield RuleError(f"<{one.tag}> has no attribute {text}{hint}", one.place)
        topic, kind = (one.attributes.get(name, "").strip() for name in ("name", "msg_type"))
        before = seen.setdefault((one.tag, plain(topic)), one)
        if before is not one:
            yield RuleError(_twice(one, before, topic, kind), one.place)
        yield from _misspelt(program, kind, one.place)


def _asked(program: ProgramModel) -> Iterator[RuleError]:
    for inner in program.calls():
        if inner.key in SUBSCRIBE_TO:
            yield from _misspelt(program, getattr(deref(inner.term[2]), "name", ""), inner.place)


def _misspelt(program: ProgramModel, kind: str, place: Optional[Place]) -> Iterator[RuleError]:
    found = program.definitions.misspelt(kind)
    if found:
        yield RuleError(f"there is no message type {kind}; did you mean {found}?", place)


def _twice(one: Element, before: Element, topic: str, kind: str) -> str:
    done = "subscribed" if one.tag == "subscribe_to" else "published"
    other = before.attributes.get("msg_type", "").strip()
    types = "" if other == kind else f", as {other}"
    return f"topic {topic} is {done} already in line {before.place.line}{types}: take one of them out"
