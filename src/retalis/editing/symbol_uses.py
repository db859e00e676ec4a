"""Uses of names in the files of a program: events and predicates, memories, labels and topics.

`uses_in_clause` and `uses_in_topics` find the uses in a clause and in a ``pub_sub.xml``. They need no loaded program,
and clauses with syntax errors are skipped, so that a file can be searched while it is edited.

A name is an event or predicate unless its position makes it another symbol: argument 4 of ``memorize`` and argument 1
of ``prev`` are memories, the name before the colon of a rule is a label, argument 4 of ``subscribe`` is a topic.
Events and predicates are not distinguished, because a goal may call a predicate with the name of an event.
"""

import re
from enum import Enum
from typing import Dict, Iterator, List, NamedTuple, Optional, Tuple

from ..events.checks.memory_and_state_checks import MEMORY_READS
from ..events.language.rule_heads import ALARMS, SYNCHRONIZED
from ..events.program.topic_configuration import ATTRIBUTES, ELEMENT_SUFFIXES, PUBLISH
from ..foundation.ros_name_checks import ros1_type_name
from ..messages.type_definition import functor_name
from ..prolog.syntax.operators import EVENT_SYNTAX
from ..prolog.syntax.tokenizer import NAME, NUMBER, OPEN_CT, QUOTED
from .clause_reader import ClauseReader, ParsedClause, read_goal_clauses

ANY_ARITY = -1
"""Arity of a use that names a functor with any number of arguments: a message type, or a message with named slots."""


class SymbolKind(Enum):
    """Kind of a symbol."""

    FUNCTOR = "event or predicate"
    MEMORY = "memory"
    LABEL = "label"
    TOPIC = "topic"


class ProgramSymbol(NamedTuple):
    """A name that a program uses in several places; the arity is 0 for all but functors."""

    kind: SymbolKind
    name: str
    arity: int = 0

    def matches(self, other: "ProgramSymbol") -> bool:
        """Return whether both are the same symbol."""
        return (
            self.kind is other.kind
            and self.name == other.name
            and (self.arity == other.arity or ANY_ARITY in (self.arity, other.arity))
        )

    def __str__(self) -> str:
        if self.kind is SymbolKind.FUNCTOR and self.arity != ANY_ARITY:
            return f"{self.name}/{self.arity}"
        return self.name


class SymbolUse(NamedTuple):
    """A place in a text where a symbol is used.

    Attributes:
        start: offset of the name.
        end: offset after the name.
        is_definition: whether it is defined there: the head of a rule or clause, a goal that creates an event or a
            memory, or a topic of ``pub_sub.xml``.
        clause_start: offset of the clause or goal.
        clause_end: offset after the clause or goal.
        suffix: end of the symbol's name that the text does not contain, but the kind of its element implies.
    """

    symbol: ProgramSymbol
    start: int
    end: int
    is_definition: bool
    clause_start: int
    clause_end: int
    suffix: str = ""


_MEMORY_READ_KEYS = frozenset((key.name, key.arity) for key in MEMORY_READS)
_MEMORY_DEFINITIONS = frozenset((("memorize", 5), ("memorize", 6), ("memorize_diactive", 5)))
_SYNCHRONIZED = frozenset((key.name, key.arity) for key in SYNCHRONIZED)
_HEAD_WRAPPERS = _SYNCHRONIZED | {(key.name, key.arity) for key in ALARMS}
_DEFINING_GOALS = frozenset(
    (name, arity)
    for name, arities in (("new_event", (1, 2, 3)), ("event", (1, 2)), ("timer", (2, 3)), ("state", (3, 4)))
    for arity in arities
)
"""Goals whose first argument is an event that they create, or a state that they declare."""
_LABEL_GOALS = frozenset((("del_event_rule", 1), ("event_rule_property", 3)))
_ADDED_ARGUMENTS = {"maplist": 1, "foldl": 1, "call": 1, "include": 2, "exclude": 2, "partition": 3}
"""Predicates that call their first argument with their further arguments, after this number of arguments."""


class NameUse:
    """A name in a clause that is no operator.

    Attributes:
        start: offset in the text of the clause.
        end: offset after the name.
        arity: number of arguments; `ANY_ARITY` for a message with named slots.
        parent: the compound term whose argument it is in; None outside of all.
        argument: number of that argument.
        list_position: if it is an element of a list, its position from 1, otherwise 0.
        list_depth: number of lists between it and the parent.
        position: index of its token.
    """

    def __init__(self, name: str, start: int, end: int, position: int, frame: "_NameFrame"):
        self.name = name
        self.start = start
        self.end = end
        self.position = position
        self.arity = 0
        self.parent = frame.name_use
        self.argument = frame.argument
        self.list_position = frame.list_position
        self.list_depth = frame.list_depth

    @property
    def key(self) -> Tuple[str, int]:
        """Name and arity."""
        return self.name, self.arity


class _NameFrame:
    """An open bracket, with the compound term that it belongs to."""

    def __init__(self, name_use: Optional[NameUse], argument: int, list_depth: int, list_position: int):
        self.name_use = name_use
        self.argument = argument
        self.list_depth = list_depth
        self.list_position = list_position
        self.is_arguments = False
        self.is_list = False
        self.is_message = False
        self.commas = 0


class LocatedClause(NamedTuple):
    """A clause of a rule file or a goal of a goal file, with the offset of its text in the file."""

    clause: ParsedClause
    offset: int
    is_goal: bool


def find_names(clause: ParsedClause) -> List[NameUse]:
    """Return the names of a clause that are no operators and no names of slots, in their order."""
    names: List[NameUse] = []
    frames = [_NameFrame(None, 0, 0, 0)]
    tokens = clause.tokens
    for position, (kind, value, start, end) in enumerate(tokens):
        following = tokens[position + 1] if position + 1 < len(tokens) else ("eof", None, end, end)
        if kind in (NAME, QUOTED) and start not in clause.uses:
            is_slot = frames[-1].is_message and following[:2] == (NAME, ":")
            if not is_slot and not (kind == NAME and value in "!;-+:"):
                names.append(NameUse(value, start, end, position, frames[-1]))
        elif kind in ("(", OPEN_CT, "[", "{"):
            is_functor = bool(names) and names[-1].position == position - 1 and names[-1].end == start
            frames.append(_open_frame(kind, frames[-1], names[-1] if is_functor else None))
        elif kind in (")", "]", "}") and len(frames) > 1:
            frame = frames.pop()
            if frame.is_arguments and frame.name_use is not None:
                frame.name_use.arity = frame.commas + 1
        elif kind == ",":
            frames[-1].commas += 1
            if frames[-1].is_arguments:
                frames[-1].argument += 1
            if frames[-1].is_list:
                frames[-1].list_position += 1
    return names


def _open_frame(kind: str, outer: _NameFrame, functor: Optional[NameUse]) -> _NameFrame:
    if kind == OPEN_CT and functor is not None:
        frame = _NameFrame(functor, 1, 0, 0)
        frame.is_arguments = True
    elif kind == "{":
        frame = _NameFrame(functor or outer.name_use, 0, 0, 0)
        frame.is_message = functor is not None or outer.is_message
        if functor is not None:
            functor.arity = ANY_ARITY
    elif kind == "[":
        frame = _NameFrame(outer.name_use, outer.argument, outer.list_depth + 1, 1)
        frame.is_list = True
        frame.is_message = outer.is_message
    else:
        frame = _NameFrame(outer.name_use, outer.argument, outer.list_depth, outer.list_position)
    return frame


def clauses_of_rules(text: str, source: str) -> Iterator[LocatedClause]:
    """Yield the clauses of a rule file that have no syntax error."""
    for clause in ClauseReader(text, source):
        if isinstance(clause, ParsedClause):
            yield LocatedClause(clause, 0, False)


def clauses_of_goals(text: str, source: str) -> Iterator[LocatedClause]:
    """Yield the goals of a goal file that have no syntax error."""
    line_starts = [0]
    for line in text.split("\n"):
        line_starts.append(line_starts[-1] + len(line) + 1)
    for goal_lines in read_goal_clauses(text, source):
        if isinstance(goal_lines.goal, ParsedClause):
            yield LocatedClause(goal_lines.goal, line_starts[goal_lines.start], True)


class _ClauseMarks(NamedTuple):
    """Indexes of the tokens that divide a clause: colon of the label, neck or arrow, and ``do`` in the head."""

    label: int
    neck: int
    action: int
    is_directive: bool


def _divide(clause: ParsedClause) -> _ClauseMarks:
    label, neck, action, depth = -1, -1, -1, 0
    for position, (kind, value, start, _) in enumerate(clause.tokens):
        if kind in ("(", OPEN_CT, "[", "{"):
            depth += 1
        elif kind in (")", "]", "}"):
            depth -= 1
        operator = clause.uses.get(start) if depth == 0 and kind in (NAME, QUOTED) else None
        if operator is None:
            continue
        if neck < 0 and (value in EVENT_SYNTAX.arrows or value in (":-", "-->", "=>")):
            neck = position
        elif neck < 0 and operator.priority == 1200:
            label = position
        elif neck < 0 and EVENT_SYNTAX.canonical.get(value) == "do":
            action = position
    first = clause.tokens[0]
    return _ClauseMarks(label, neck, action, first[1] in (":-", "?-") and first[2] in clause.uses)


def uses_in_clause(located_clause: LocatedClause) -> Iterator[SymbolUse]:
    """Yield the uses of symbols in a clause or goal."""
    clause, offset, is_goal = located_clause
    marks = _divide(clause)
    span = (offset + clause.tokens[0][2], offset + clause.tokens[-1][3])
    for name_use in find_names(clause):
        symbol = _symbol_of(name_use, clause, marks)
        if symbol is not None:
            is_definition = _defines(name_use, symbol, marks, is_goal)
            yield SymbolUse(symbol, offset + name_use.start, offset + name_use.end, is_definition, *span)


def _symbol_of(use: NameUse, clause: ParsedClause, marks: _ClauseMarks) -> Optional[ProgramSymbol]:
    parent = None if use.parent is None else use.parent.key
    if use.position < marks.label and (use.parent is None or use.parent.position < marks.label):
        return ProgramSymbol(SymbolKind.LABEL, use.name) if use.parent is None else None
    if parent is not None and use.arity == 0:
        kind = _kind_in_argument(use, parent)
        if kind is not None:
            return ProgramSymbol(kind, use.name)
    arity = use.arity
    following = clause.tokens[use.position + 1 : use.position + 3]
    if arity == 0 and len(following) == 2 and following[0][1] == "/" and following[1][0] == NUMBER:
        # An indicator such as fever/2.
        arity = following[1][1]
    elif parent is not None and parent[0] in _ADDED_ARGUMENTS and use.argument == 1 and not use.list_depth:
        arity += max(0, parent[1] - _ADDED_ARGUMENTS[parent[0]])
    return ProgramSymbol(SymbolKind.FUNCTOR, use.name, arity)


def _kind_in_argument(use: NameUse, parent: Tuple[str, int]) -> Optional[SymbolKind]:
    """Return the kind of an atom in an argument of a goal, or None for an event, predicate or value."""
    if parent in _SYNCHRONIZED:
        is_memory = use.argument == 3 and use.list_depth == 2 and use.list_position == 1
        return SymbolKind.MEMORY if is_memory else None
    if use.list_depth:
        return None
    if (parent in _MEMORY_DEFINITIONS and use.argument == 4) or (
        (parent in _MEMORY_READ_KEYS or parent == ("delete_memory", 1)) and use.argument == 1
    ):
        return SymbolKind.MEMORY
    if (parent == ("subscribe", 5) and use.argument == 4) or (
        parent[0] == "subscribe_to" and use.argument == 1
    ):
        return SymbolKind.TOPIC
    return SymbolKind.LABEL if parent in _LABEL_GOALS and use.argument == 1 else None


def _defines(use: NameUse, symbol: ProgramSymbol, marks: _ClauseMarks, is_goal: bool) -> bool:
    parent = use.parent
    if symbol.kind is SymbolKind.LABEL:
        return use.position < marks.label
    if symbol.kind is SymbolKind.MEMORY:
        return parent is not None and parent.key in _MEMORY_DEFINITIONS
    if symbol.kind is SymbolKind.TOPIC:
        return parent is not None and parent.name == "subscribe_to"
    if parent is not None and parent.key in _DEFINING_GOALS and use.argument == 1 and not use.list_depth:
        return True
    if is_goal or marks.is_directive:
        return False
    is_in_head = use.position < marks.neck if marks.neck >= 0 else marks.action < 0
    if not is_in_head or (0 <= marks.action < use.position):
        return False
    if parent is None:
        return True
    return parent.parent is None and parent.key in _HEAD_WRAPPERS and use.argument == 1 and not use.list_depth


_XML_ELEMENT = re.compile(r"<!--[\s\S]*?(?:-->|\Z)|<(\w+)\b([^<>]*)>?")
_XML_ATTRIBUTE = re.compile(r"""\b(\w+)\s*=\s*(?:"([^"]*)"|'([^']*)')""")


class _TopicElement(NamedTuple):
    """An element of ``pub_sub.xml`` for topics, with the values of its attributes and the offsets of the values."""

    tag: str
    attributes: Dict[str, Tuple[str, int]]
    start: int
    end: int


def event_types_in_topics(text: str) -> Dict[str, str]:
    """Return the message types by the names of events that a ``pub_sub.xml`` gives them."""
    types = {}
    for element in _elements(text):
        type_attribute = ATTRIBUTES[element.tag][1]
        if element.tag != PUBLISH and "event" in element.attributes and type_attribute in element.attributes:
            event, message_type = element.attributes["event"][0], element.attributes[type_attribute][0]
            for suffixes in ELEMENT_SUFFIXES[element.tag]:
                types[f"{event}{suffixes.event}"] = f"{ros1_type_name(message_type)}{suffixes.type}"
    return types


def uses_in_topics(text: str) -> List[SymbolUse]:
    """Return the uses of symbols in a ``pub_sub.xml``.

    An action has several topics, whose names and events begin with those of its element: each has a use there.
    """
    return [use for element in _elements(text) for use in _uses_in_element(element)]


def _uses_in_element(element: _TopicElement) -> Iterator[SymbolUse]:
    is_published = element.tag == PUBLISH
    for attribute in ("name", ATTRIBUTES[element.tag][1], "event"):
        if attribute not in element.attributes:
            continue
        value, start = element.attributes[attribute]
        # A type defines the events of the topic unless these have a name of their own.
        is_definition = attribute == "name" or (
            not is_published and (attribute == "event" or "event" not in element.attributes)
        )
        for suffixes in ELEMENT_SUFFIXES[element.tag]:
            symbol = ProgramSymbol(SymbolKind.FUNCTOR, f"{value}{suffixes.event}", ANY_ARITY)
            suffix = suffixes.event
            if attribute == "name":
                symbol, suffix = ProgramSymbol(SymbolKind.TOPIC, f"{value}{suffixes.topic}"), suffixes.topic
            elif attribute != "event":
                message_type, suffix = ros1_type_name(value), suffixes.type
                name = functor_name(message_type) if message_type.count("/") == 1 else message_type
                symbol = symbol._replace(name=f"{name}{suffix}")
            yield SymbolUse(
                symbol, start, start + len(value), is_definition, element.start, element.end, suffix
            )


def _elements(text: str) -> Iterator[_TopicElement]:
    for element in _XML_ELEMENT.finditer(text):
        if element[1] not in ATTRIBUTES:
            continue
        attributes = {}
        for attribute in _XML_ATTRIBUTE.finditer(element[2]):
            group = 2 if attribute[2] is not None else 3
            attributes[attribute[1]] = (attribute[group], element.start(2) + attribute.start(group))
        yield _TopicElement(element[1], attributes, element.start(), element.end())
