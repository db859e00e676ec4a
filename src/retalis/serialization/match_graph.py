"""Serialization of partial matches and events as an object graph.

Matches, events, shared buffers and nodes refer to each other in cycles. Each object therefore becomes a row of its
attributes, in which other objects are represented by their numbers (`Ref`). `GraphWriter` assigns the numbers in the
order in which objects are reached. `GraphReader` first creates all objects without attributes, so that references can
be resolved in any order, then checks and assigns the attributes, and finally checks relations between attributes and
derives those that are not stored.

A state file is not trusted: every attribute has a check, references are only accepted to objects of the right kind,
and the graph of what objects were made of must be acyclic, because the engine traverses it recursively.
"""

from typing import Any, Callable, Dict, List, Sequence, Tuple

from ..events.matches.partial_matches import (
    NOTHING_HELD,
    EventMatch,
    Found,
    OrderedEventMatch,
    PartialMatch,
    TrackedMatch,
)
from ..events.matches.shared_run_buffer import BufferSlice, Run, RunCursor, RunGroup, SharedLog
from ..events.network.event_rule import EventRule
from ..events.network.kleene_node import KleeneNode
from ..events.network.pattern_nodes import NetworkNode
from ..events.network.repeat_node import RepeatNode
from ..events.network.stream_node import StreamNode
from ..events.provenance.event_log import Occurrence, Suppressed
from ..events.streams.stream_operator import StreamElement
from ..foundation.errors import UsageError
from ..prolog.terms.types import Functor
from .codec import Ref
from .schema import (
    Decoded,
    ValueCheck,
    boolean,
    count,
    each,
    fixed,
    instant,
    integer,
    items,
    key,
    match_order,
    optional,
    term,
    value_of_match,
    variable,
    wrong,
)

_MATCH = ("values", "start", "end", "event", "term", "parts", "used")
_TRACKED = ("derived", "held", "gone", "reported", "suppressed")

FIELDS: Dict[str, Tuple[Any, Tuple[str, ...]]] = {
    "match": (PartialMatch, _MATCH),
    "run": (
        Run,
        (*_MATCH, "first", "last", "fixed", "state", "items", "taken", "held", "steps", "sound", "open"),
    ),
    "token": (RunCursor, (*_MATCH, "first", "apart", "log", "at", "since", "buffer")),
    "train": (RunGroup, ("node", "key", "tokens", "end", "order", "log", "taken", "alive")),
    "log": (SharedLog, ("items",)),
    "chain": (BufferSlice, ("pieces", "length")),
    "held": (TrackedMatch, ("match", "earlier", "number", "linked", *_TRACKED)),
    "event": (
        Occurrence,
        ("number", "term", "start", "end", "rule", "match", "forgotten", "takes_back", *_TRACKED),
    ),
    "item": (StreamElement, ("match", "start", "end", "by", "values", "order")),
    "suppressed": (Suppressed, ("node", "what", "number", "freed")),
}
"""Kinds of objects: their class, and the attributes that are stored. Other attributes are derived when read."""

_KIND_BY_CLASS = {
    EventMatch: "match",
    OrderedEventMatch: "match",
    **{kind: name for name, (kind, _) in FIELDS.items()},
}

_SCALARS = frozenset((int, bool, type(None)))

ObjectRow = List[Any]


class GraphWriter:
    """Writer that assigns numbers to objects and creates their rows.

    Args:
        rules: rules with known numbers. Deleted rules that are still referred to are added after them.
    """

    def __init__(self, rules: Sequence[EventRule]):
        self.rules = list(rules)
        self.rows: List[ObjectRow] = []
        self._refs: Dict[int, Ref] = {}
        self._objects: List[Any] = []
        self._places: Dict[int, int] = {}
        self._nodes: Dict[int, Tuple[int, int]] = {}
        for number, rule in enumerate(self.rules):
            self._add_rule(rule, number)

    def _add_rule(self, rule: EventRule, number: int) -> None:
        self._places[id(rule)] = number
        for node_number, (node, _, _) in enumerate(rule.nodes):
            self._nodes[id(node)] = (number, node_number)

    def write(self, data: Any) -> Any:
        """Return data in which objects are replaced by `Ref`; rows are added for new objects."""
        result = _map_objects(data, self._to_ref)
        # Rows are created in a loop instead of recursively: chains of objects can be very long.
        while len(self.rows) < len(self._objects):
            self.rows.append(self._row(self._objects[len(self.rows)]))
        return result

    def _to_ref(self, data: Any) -> Any:
        data_class = data.__class__
        if data_class in _KIND_BY_CLASS or data_class is EventRule or id(data) in self._nodes:
            return self._ref(data)
        if isinstance(data, NetworkNode):  # a node of a deleted rule
            self._rule(data.rule)  # type: ignore[attr-defined]  # nodes that hold state have a rule
            return self._ref(data)
        return data

    def _ref(self, data: Any) -> Ref:
        ref = self._refs.get(id(data))
        if ref is None:
            ref = self._refs[id(data)] = Ref(len(self._objects))
            self._objects.append(data)
        return ref

    def _rule(self, rule: EventRule) -> int:
        number = self._places.get(id(rule))
        if number is None:
            number = len(self.rules)
            self.rules.append(rule)
            self._add_rule(rule, number)
        return number

    def _row(self, item: Any) -> ObjectRow:
        if item is NOTHING_HELD:
            return ["nothing"]
        item_class = item.__class__
        if item_class is EventRule:
            return ["rule", self._rule(item)]
        if id(item) in self._nodes:
            return ["node", *self._nodes[id(item)]]
        name = _KIND_BY_CLASS[item_class]
        row: ObjectRow = [name]
        for field in FIELDS[name][1]:
            value = getattr(item, field)
            if value.__class__ not in _SCALARS:
                value = _map_objects(list(value) if field == "tokens" else value, self._to_ref)
            row.append(value)
        return row


_MATCHES = ("match", "run", "token")

_NUMBER = optional(count)


class GraphReader:
    """Reader that creates objects from rows, with a check of each attribute.

    Attributes refer to other objects by their numbers; checks restrict the kinds of these objects. No object may
    directly or indirectly consist of itself (`_sources`), otherwise traversals would not terminate.

    Args:
        rows: the rows of all objects.
        rules: the rules in the order of their numbers.

    Raises:
        UsageError: if a row cannot have been created by `GraphWriter`.
    """

    def __init__(self, rows: Any, rules: Sequence[EventRule]):
        self._rules = rules
        self._kinds: List[str] = []
        self._objects: List[Any] = []
        self._sources: List[List[int]] = []
        self._current: List[int] = []
        self.match = self.ref(*_MATCHES)
        """Check of a reference to a match of any kind."""
        self._refer_to_event = self.ref("event")
        checks = self._checks()
        rows = [items(row) for row in items(rows)]
        for row in rows:
            self._kinds.append(row[0] if row and row[0].__class__ is str else "")
            # Objects exist before their attributes are set, since references form cycles.
            self._objects.append(self._empty(row))
        for number, (item, row) in enumerate(zip(self._objects, rows)):
            self._current = []
            self._sources.append(self._current)
            if row[0] in FIELDS:
                try:
                    self._fill(item, row, checks[row[0]])
                except UsageError as error:
                    raise UsageError(f"object {number}, a {row[0]}: {error.message}") from None
        self._check_order()
        for item in self._objects:
            self._finish(item)

    def objects(self, *object_classes: type) -> List[Any]:
        """Return all objects of some classes."""
        return [item for item in self._objects if item.__class__ in object_classes]

    def _empty(self, row: Sequence[Any]) -> Any:
        name = row[0] if row else None
        if name == "nothing" and len(row) == 1:
            return NOTHING_HELD
        if name == "rule" and len(row) == 2:
            return self._rules[integer(0, len(self._rules) - 1)(row[1])]
        if name == "node" and len(row) == 3:
            nodes = self._rules[integer(0, len(self._rules) - 1)(row[1])].nodes
            return nodes[integer(0, len(nodes) - 1)(row[2])][0]
        if name.__class__ is not str or name not in FIELDS or len(row) != len(FIELDS[name][1]) + 1:
            raise wrong(row, "the row of an object")
        object_class = FIELDS[name][0]
        return object_class.__new__(object_class)

    def _fill(self, item: Any, row: Sequence[Any], checks: Sequence[ValueCheck]) -> None:
        if isinstance(item, PartialMatch):
            item.buffer = None
        for field, check, value in zip(FIELDS[row[0]][1], checks, row[1:]):
            setattr(item, field, check(value))

    def ref(self, *kinds: str) -> ValueCheck:
        """Return a check of a reference to an object of one of the given kinds; the result is the object."""
        # The lists are filled later, so kinds are compared when the check is called.
        allowed = frozenset(kinds)
        object_kinds, objects = self._kinds, self._objects

        def check(value: Decoded) -> Decoded:
            if (
                value.__class__ is not Ref
                or value.number >= len(object_kinds)
                or object_kinds[value.number] not in allowed
            ):
                raise wrong(value, f"a reference to {' or '.join(kinds)}")
            return objects[value.number]

        return check

    def _source(self, *kinds: str) -> ValueCheck:
        """Return a check of a reference to an object that the current object consists of."""
        refer = self.ref(*kinds)

        def check(value: Decoded) -> Decoded:
            item = refer(value)
            self._current.append(value.number)
            return item

        return check

    def token(self, value: Decoded) -> Decoded:
        """Check the identity of an event: a number, or the event itself if lineage is recorded."""
        return self._event(value) if value.__class__ is Ref else _NUMBER(value)

    def token_key(self, value: Decoded) -> Decoded:
        """Check a key that consists of terms, or of identities of events."""
        if value.__class__ is Ref:
            return self._event(value)
        if value.__class__ is list and any(item.__class__ is Ref for item in value):
            return tuple([self.token_key(item) for item in value])
        return key(value)

    def _event(self, value: Decoded) -> Decoded:
        event = self._refer_to_event(value)
        self._current.append(value.number)
        return event

    def _origin(self, value: Decoded) -> Decoded:
        """Check the origin of a stream element: a match, the event of a subscription, or None."""
        return self.match(value) if value.__class__ is Ref else optional(term)(value)

    def _checks(self) -> Dict[str, List[ValueCheck]]:
        """Return the checks of the attributes of each kind of object, in the order of `FIELDS`."""
        source_match = self._source(*_MATCHES)
        source_tracked = self._source("held", "nothing")
        source_part = self._source(*_MATCHES, "held", "nothing", "chain")
        values = each(value_of_match, tuple)
        found_values = fixed(values)

        def part(value: Decoded) -> Decoded:
            if value.__class__ is Ref:
                return source_part(value)
            return count(value) if value.__class__ is int else Found(*found_values(value))

        match_ref = self.match
        node_entry = fixed(
            self.ref("node"),
            self.ref("run", "node", "train"),
            lambda value: match_ref(value) if value.__class__ is Ref else count(value),
        )

        def holder(value: Decoded) -> Decoded:
            if value.__class__ is Ref:
                return match_ref(value)
            node, owner, entry = node_entry(value)
            # A buffer entry is identified by a number in repeat nodes, and by the match itself elsewhere.
            by_number = (
                isinstance(node, RepeatNode) and owner.__class__ is RunGroup and entry.__class__ is int
            )
            by_match = (owner is node and isinstance(node, StreamNode)) or (
                isinstance(node, KleeneNode) and owner.__class__ is Run
            )
            if not by_number and not (by_match and isinstance(entry, PartialMatch)):
                raise wrong(value, "a buffer entry of a node")
            return node, owner, entry

        tried = fixed(match_ref, match_ref)
        # The order of the checks is that of the attributes in `FIELDS`.
        match = [
            *(values, instant, instant, self.token, optional(term), optional(each(part, tuple))),
            optional(match_ref),
        ]
        tracked = [
            *(each(self.ref("event", "held")), each(holder), boolean, boolean),
            each(self.ref("suppressed")),
        ]
        slice_piece = fixed(self._source("log"), count, count)
        return {
            "match": match,
            "run": [
                *match,
                *(source_match, instant, optional(values), _state, term, each(match_ref), source_tracked),
                *(each(fixed(values, values)), count, each(variable, tuple)),
            ],
            "token": [
                *match,
                *(source_match, count, self.ref("log"), count, count, optional(self.ref("train"))),
            ],
            "train": [
                *(self.ref("node"), key, each(optional(self.ref("token")))),
                *(instant, match_order, self.ref("log"), count, count),
            ],
            "log": [each(source_match)],
            "chain": [each(slice_piece, tuple), count],
            "held": [optional(source_match), optional(source_tracked), count, boolean, *tracked],
            "event": [
                *(count, term, instant, instant, optional(self.ref("rule")), optional(source_match), boolean),
                *(optional(each(self.ref("event"))), *tracked),
            ],
            "item": [
                *(self._origin, instant, instant, values),
                *(each(optional(term), tuple), count),
            ],
            "suppressed": [
                self.ref("node"),
                lambda value: self.match(value) if value.__class__ is Ref else tried(value),
                count,
                boolean,
            ],
        }

    def _check_order(self) -> None:
        """Check that no object consists of itself, by a depth-first search with an explicit stack."""
        # 1 while the objects that an object consists of are being visited, then 2.
        progress = bytearray(len(self._objects))
        for number in range(len(progress)):
            stack = [number]
            while stack:
                current = stack[-1]
                if progress[current]:
                    progress[current] = 2
                    stack.pop()
                    continue
                progress[current] = 1
                for source in self._sources[current]:
                    if progress[source] == 1:
                        raise UsageError(f"object {source}, a {self._kinds[source]}, contains itself")
                    if not progress[source]:
                        stack.append(source)

    def _finish(self, item: Any) -> None:
        """Check relations between the attributes of an object, and derive those that are not stored."""
        item_class = item.__class__
        if isinstance(item, PartialMatch) and item.parts is None and item.term is None:
            raise UsageError("a match has neither an event nor parts")
        if item_class is RunGroup:
            if not isinstance(item.node, RepeatNode):
                raise UsageError("a group of runs belongs to a node of another type")
            item.alive = sum(token is not None and token.buffer is item for token in item.tokens)
        elif item_class is BufferSlice:
            if not all(start <= end <= len(log.items) for log, start, end in item.pieces):
                raise UsageError("a slice of repetitions exceeds their buffer")
            item.length = sum(end - start for _, start, end in item.pieces)
        elif item_class is RunCursor and item.at > len(item.log.items):
            raise UsageError("a run has more repetitions than its buffer")
        elif item_class is TrackedMatch and (item.earlier is None) != (item.match is None):
            raise UsageError("a tracked match of repetitions has no beginning")
        # Fields that depend on others are computed last, when all attributes are set.
        if item_class in (RunGroup, SharedLog, Run):
            item.begin_again()


def _state(value: Decoded) -> Decoded:
    """Check the state of an aggregate: a number, None, or nested pairs of an earlier state and a term."""
    pairs = []
    while value.__class__ is list and len(value) == 2:
        pairs.append(term(value[1]))
        value = value[0]
    if value.__class__ is list:
        if value:
            raise wrong(value, "the state of an aggregate")
        value = ()
    elif value is not None:
        term(value)
    for collected in reversed(pairs):
        value = (value, collected)
    return value


def _map_objects(data: Any, change: Callable[[Any], Any]) -> Any:
    """Return data with a function applied to everything but lists, tuples and terms."""
    data_class = data.__class__
    if data_class is tuple:
        if data and data[0].__class__ is Functor:
            return data
        return tuple([_map_objects(item, change) for item in data])
    if data_class is list:
        return [_map_objects(item, change) for item in data]
    return change(data)
