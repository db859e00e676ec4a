"""What a program that reads well was probably not meant to say: wrong messages, memories that are not there."""

from difflib import get_close_matches
from pathlib import Path
from typing import Collection, Iterable, Iterator, List, Mapping, NamedTuple, Optional, Set, Tuple, Union

from ...foundation import Place, RuleError, UsageError
from ...messages import Definitions, type_name
from ...prolog.terms import Atom, CompoundTerm, Functor, Term, deref, functor, list_items
from ..language import Occurs, walk
from .files import Files
from .folder import GOALS, RULES, read_text
from .owners import Loaded

_READS = frozenset(
    functor(name, arity)
    for name, arity in (
        ("prev", 5),
        ("prev_binary", 5),
        ("next", 6),
        ("next_binary", 6),
        ("next_inf", 5),
        ("access_mem", 3),
        ("memory_size", 2),
        ("memory_counter", 2),
        ("memory_gap", 3),
    )
)
_WAITS = frozenset(functor(name, arity) for name in ("synchronized", "syncronized") for arity in (3, 4))
_MAKES = frozenset((functor("memorize", 5), functor("memorize", 6), functor("memorize_diactive", 5)))


NO_EVENTS: Mapping[str, str] = {}


class _NamedTerm(NamedTuple):
    """A term of the program, what to call it, and its place."""

    term: Term
    who: str
    place: Optional[Place]


def wrong_messages(
    rules: Loaded,
    patterns: Iterable[Tuple[Term, str]],
    definitions: Definitions,
    types: Collection[str],
    events: Mapping[str, str] = NO_EVENTS,
) -> Iterator[RuleError]:
    """Yield a warning for each kind of term in rules and patterns that is not a message of a type that is known.

    Args:
        rules: of the program.
        patterns: of its memories and subscriptions, each with what to call it.
        definitions: the message types that are known.
        types: those that the program's topics have.
        events: the types of events that have names of their own.
    """
    known = [definitions.find(kind) for kind in types if kind in definitions]
    near = sorted(
        {name for one in known for name in (one.name, *(nested.name for nested in one.dependencies()))}
    )
    later = {
        kind.partition("/")[0] for kind in types if kind not in definitions
    }  # learned from their publishers
    seen: Set[Functor] = set()
    outside = [_NamedTerm(pattern, f"{who}: ", None) for pattern, who in patterns]
    yield from _bare_texts([*_events(rules), *outside], definitions, events)
    for text in [*_rules(rules), *outside]:
        for part in _parts(text.term):
            key: Functor = part.functor if isinstance(part, Atom) else part[0]
            kind = None if key in seen else events.get(key.name) or type_name(key.name)
            seen.add(key)
            if kind is None or kind.partition("/")[0] in later:
                continue
            wrong = _wrong(key, kind, definitions, near)
            if wrong:
                yield RuleError(f"{text.who}{wrong}", text.place)


def unknown_memories(rules: Loaded, names: Iterable[Term]) -> Iterator[RuleError]:
    """Yield a warning for each memory that rules and clauses read and that is not there, nor made by a goal.

    Args:
        rules: of the program.
        names: the ids of the memories that are there.
    """
    made: Set[Term] = {name for name in names if isinstance(name, Atom)}
    asked: List[Tuple[Atom, Optional[Place]]] = []
    bodies = [_NamedTerm(term, "", None) for term in rules.terms()]
    for text in [*_rules(rules), *bodies]:
        for part in _parts(text.term):
            if isinstance(part, tuple) and part[0] in _MAKES:
                made.add(deref(part[4]))
            asked += [(name, text.place) for name in _memories_in(part)]
    there = {name for name in made if isinstance(name, Atom)}
    if len(there) < len(made):  # which ones are made is known only then
        return
    for name, place in asked:
        if name not in there:
            meant = get_close_matches(name.name, [known.name for known in there], 1)
            there.add(name)
            hint = f"; did you mean {meant[0]}?" if meant else ""
            yield RuleError(f"there is no memory {name.name} yet{hint}", place)


def unread_rules(files: Files, folder: Path) -> Iterator[RuleError]:
    """Yield a warning where a program's folder has rules that no goal has read."""
    path, goals = folder / RULES, folder / GOALS
    if path.is_file() and not files.has_loaded(path) and RULES not in _text(goals):
        yield RuleError(f"{path} is not read: no goal in {GOALS} calls compile_event_file('{RULES}')")


def _text(path: Path) -> str:
    """Return the text of a file, nothing where it cannot be read, which is said elsewhere."""
    try:
        return read_text(path)
    except UsageError:
        return ""


def _rules(rules: Loaded) -> List[_NamedTerm]:
    return [_NamedTerm(rule.definition.term, "", rule.place) for rule in rules.rules]


def _events(rules: Loaded) -> Iterator[_NamedTerm]:
    """Yield the events in the patterns of rules."""
    for rule in rules.rules:
        for node in walk(rule.definition.pattern, negated=True):
            if isinstance(node, Occurs):
                yield _NamedTerm(node.term, "", rule.place)


def _bare_texts(
    texts: Iterable[_NamedTerm], definitions: Definitions, events: Mapping[str, str]
) -> Iterator[RuleError]:
    """Yield a warning for each text in a pattern that stands there without its quotes."""
    for text in texts:
        for part in _parts(text.term):
            if isinstance(part, Atom):
                continue
            kind = events.get(part[0].name) or type_name(part[0].name)
            if kind is None or kind not in definitions:
                continue
            for slot, value in zip(definitions.find(kind).fields, map(deref, part[1:])):
                bare = getattr(value, "name" if isinstance(value, Atom) else "text", None)
                if slot.describe() == "string" and bare is not None and not bare.startswith('"'):
                    wrong = f"{slot.name} of {kind} is a string, which keeps its quotes in events"
                    yield RuleError(f"{text.who}{wrong}: write '\"{bare}\"'", text.place)


def _parts(term: Term) -> Iterator[Union[Atom, CompoundTerm]]:
    """Yield the atoms and compound terms in a term."""
    stack = [term]
    while stack:
        item = deref(stack.pop())
        if item.__class__ is tuple:
            yield item
            stack.extend(item[:0:-1])
        elif item.__class__ is Atom:
            yield item


def _memories_in(part: Union[Atom, CompoundTerm]) -> Iterator[Atom]:
    """Yield the memories that a goal reads or a query waits for, where they are named."""
    if isinstance(part, Atom):
        return
    names = [part[1]] if part[0] in _READS else []
    if part[0] in _WAITS:
        names = [pair[0] for pair in map(list_items, list_items(part[3]) or ()) if pair]
    for name in map(deref, names):
        if isinstance(name, Atom):
            yield name


def _wrong(key: Functor, kind: str, definitions: Definitions, near: Collection[str]) -> str:
    """Return what is wrong with a term that is meant as a message, "" where it is right or cannot be told."""
    if kind not in definitions:
        meant = get_close_matches(kind, near, 1, 0.8)
        return f"there is no message type {kind} here; did you mean {meant[0]}?" if meant else ""
    slots = [slot.name for slot in definitions.find(kind).fields]
    if len(slots) == key.arity:
        return ""
    named = f": {', '.join(slots)}" if slots else ""
    return f"{key} does not match its type: {kind} has {len(slots)} slots{named}"
