"""Serialization of partial matches and events as an object graph.

Matches, events, shared buffers and nodes refer to each other in cycles. Each object therefore has a number, by which
other objects refer to it. `GraphWriter` assigns the numbers in the order in which objects are reached, and encodes
the attributes of all objects of a kind in columns, one for each attribute. `GraphReader` first creates all objects
without attributes, so that references can be resolved in any order, then checks and assigns the attributes, and
finally checks relations between attributes and derives those that are not stored.

A state file is not trusted: every column has a check, references are only accepted to objects of the right kind, and
the graph of what objects were made of must be acyclic, because the engine traverses it recursively.
"""

from collections import defaultdict, deque
from copy import copy
from enum import Enum
from operator import attrgetter, is_
from typing import Any, Callable, DefaultDict, Dict, List, Sequence, Tuple

from ..events.matches.match_types import (
    NO_REPETITIONS,
    ComputedValues,
    EventMatch,
    IdentifiedEventMatch,
    OrderedEventMatch,
    PartialMatch,
    RepetitionChain,
)
from ..events.matches.shared_run_buffer import BufferSlice, Run, RunCursor, RunGroup, SharedLog
from ..events.network.event_rule import EventRule
from ..events.network.kleene_node import KleeneNode
from ..events.network.pattern_nodes import NetworkNode
from ..events.network.repeat_node import RepeatNode
from ..events.network.stream_node import StreamNode
from ..events.provenance.occurrences import Occurrence, Suppressed
from ..events.streams.stream_operators import StreamElement
from ..foundation.errors import UsageError
from ..prolog.terms.types import Functor
from .codec import Ref
from .columns import decode_instants, encode_instants
from .decoded_value_checks import (
    Decoded,
    ValueCheck,
    any_value,
    boolean,
    count,
    dict_of,
    integer,
    integers,
    invalid_value,
    items,
    key,
    match_orders,
    one_of,
    optional,
    sequence_of,
    term,
    tuple_of,
    value_of_match,
    variable,
)


class _ColumnEncoding(Enum):
    """Encoding of a column with the values of an attribute."""

    DATA = "data"
    """Values that contain no objects."""
    INSTANTS = "instants"
    """Instants, see `encode_instants`."""
    OBJECT = "object"
    """Objects, as their numbers, or None."""
    PARTS = "parts"
    """Parts of matches: objects as their numbers, numbers of branches and `ComputedValues` as sequences of one
    item.
    """
    MIXED = "mixed"
    """Any data, with objects as `Ref`."""


_DATA, _INSTANTS, _OBJECT, _PARTS, _MIXED = _ColumnEncoding
_INTERVAL = {"start": _INSTANTS, "end": _INSTANTS}
_MATCH = {
    "values": _DATA,
    **_INTERVAL,
    "event": _MIXED,
    "term": _DATA,
    "parts": _PARTS,
    "consumed_by": _OBJECT,
}
_TRACKED = {
    "derived": _MIXED,
    "dependents": _MIXED,
    "retracted": _DATA,
    "reported": _DATA,
    "suppressed": _MIXED,
}

FIELDS: Dict[str, Tuple[Any, Dict[str, _ColumnEncoding]]] = {
    "event match": (EventMatch, {**_INTERVAL, "term": _DATA}),
    "match": (PartialMatch, _MATCH),
    "run": (
        Run,
        {
            **_MATCH,
            "first": _OBJECT,
            "last": _INSTANTS,
            "fixed_values": _DATA,
            "state": _DATA,
            "items": _DATA,
            "repetitions": _MIXED,
            "tracked": _OBJECT,
            "step_values": _DATA,
            "free_vars": _DATA,
        },
    ),
    "run cursor": (
        RunCursor,
        {
            **_MATCH,
            "first": _OBJECT,
            "prefix_length": _DATA,
            "log": _OBJECT,
            "log_position": _DATA,
            "first_number": _DATA,
            "buffer": _OBJECT,
        },
    ),
    "run group": (
        RunGroup,
        {
            "node": _OBJECT,
            "key": _DATA,
            "cursors": _MIXED,
            "end": _INSTANTS,
            "order": _DATA,
            "log": _OBJECT,
            "repetition_count": _DATA,
        },
    ),
    "log": (SharedLog, {"items": _MIXED}),
    "buffer slice": (BufferSlice, {"pieces": _MIXED}),
    "repetition chain": (
        RepetitionChain,
        {"match": _OBJECT, "earlier": _OBJECT, "number": _DATA, "linked": _DATA, **_TRACKED},
    ),
    "event": (
        Occurrence,
        {
            "number": _DATA,
            "term": _DATA,
            **_INTERVAL,
            "rule": _OBJECT,
            "match": _OBJECT,
            "forgotten": _DATA,
            "retracts": _MIXED,
            **_TRACKED,
        },
    ),
    "element": (
        StreamElement,
        {"match": _MIXED, **_INTERVAL, "key_values": _DATA, "values": _DATA, "order": _DATA},
    ),
    "suppressed": (
        Suppressed,
        {"node": _OBJECT, "match_or_pair": _MIXED, "number": _DATA, "is_released": _DATA},
    ),
}
"""Classes of objects by kind, with the encodings of their stored attributes. Other attributes are derived."""

_ENCODINGS = {kind: encodings for kind, (_, encodings) in FIELDS.items()}
"""Encodings of the stored attributes, by kind."""

_KINDS = [*FIELDS, "no repetitions", "rule", "node"]
"""All kinds in the order of their codes. `NO_REPETITIONS`, rules and nodes exist before objects are read."""

_CODES = {kind: code for code, kind in enumerate(_KINDS)}
_KIND_BY_CLASS = {
    EventRule: "rule",
    OrderedEventMatch: "event match",
    IdentifiedEventMatch: "event match",
    **{object_class: kind for kind, (object_class, _) in FIELDS.items()},
}
MATCH_KINDS = ("event match", "match", "run", "run cursor")
"""Kinds of matches."""


class GraphWriter:
    """Writer that assigns numbers to objects and encodes their attributes.

    Args:
        rules: rules with known numbers. Deleted rules that are still referred to are added after them.
        first_event_number: number of the first event whose lineage is written. Older events that partial matches use
            are written without what they were derived from and without what was derived from them.
    """

    def __init__(self, rules: Sequence[EventRule], first_event_number: int = 0):
        self.rules = list(rules)
        self._first_event_number = first_event_number
        self._numbers: Dict[int, int] = {}
        self._refs: Dict[int, Ref] = {}
        self._unexplored: List[Any] = []
        self._kinds = bytearray()
        self._objects: DefaultDict[str, List[Any]] = defaultdict(list)
        self._columns: DefaultDict[Tuple[str, str], List[Any]] = defaultdict(list)
        self._rule_numbers: Dict[int, int] = {}
        self._nodes: Dict[int, Tuple[int, int]] = {}
        for number, rule in enumerate(self.rules):
            self._add_rule(rule, number)

    def _add_rule(self, rule: EventRule, number: int) -> None:
        self._rule_numbers[id(rule)] = number
        for node_number, (node, _, _) in enumerate(rule.nodes):
            self._nodes[id(node)] = (number, node_number)

    def write(self, data: Any) -> Any:
        """Return data in which objects are replaced by `Ref`."""
        return _map_objects(data, self._to_ref)

    def number_of(self, item: Any) -> int:
        """Return the number of an object."""
        number = self._numbers.get(id(item))
        if number is None:
            number = self._numbers[id(item)] = len(self._numbers)
            self._unexplored.append(item)
        return number

    def encode(self) -> Any:
        """Return the encoding of all objects that were reached: codes of their kinds, and columns by kind."""
        # Objects are reached in a loop instead of recursively, because chains of objects can be very long.
        while self._unexplored:
            self._collect_unexplored()
        return bytes(self._kinds), [
            [kind, self._encode_columns(kind)] for kind in _KINDS if self._objects[kind]
        ]

    def _collect_unexplored(self) -> None:
        """Collect the objects that were numbered last, and assign numbers to the objects that they refer to."""
        # Without this cut, the links would lead from one event to all that are remembered.
        reached, self._unexplored = list(map(self._cut_lineage, self._unexplored)), []
        kinds = [self._register_kind(item) for item in reached]
        self._kinds += bytes(map(_CODES.__getitem__, kinds))
        by_kind: DefaultDict[str, List[Any]] = defaultdict(list)
        for kind, item in zip(kinds, reached):
            by_kind[kind].append(item)
        for kind, objects in by_kind.items():
            self._objects[kind] += objects
            for field, encoding in _ENCODINGS.get(kind, {}).items():
                values = map(attrgetter(field), objects)
                column = self._columns[kind, field]
                if encoding is _OBJECT:
                    column += [None if value is None else self.number_of(value) for value in values]
                elif encoding is _PARTS:
                    column += map(self._to_parts, values)
                elif encoding is _MIXED:
                    column += map(self.write, values)

    def _is_old(self, item: Any) -> bool:
        """Return whether an object is an event that is too old for its lineage to be written."""
        # The number of an event that was not dispatched, such as a pending alarm, is 0.
        return item.__class__ is Occurrence and 0 < item.number < self._first_event_number

    def _cut_lineage(self, item: Any) -> Any:
        """Return an object, or its copy without links to events that are too old."""
        if not self._first_event_number:
            return item
        if item.__class__ is RepetitionChain and any(map(self._is_old, item.derived)):
            chain = copy(item)
            chain.derived = [derived for derived in item.derived if not self._is_old(derived)]
            return chain
        if not self._is_old(item):
            return item
        event = Occurrence(item.term, item.start, item.end, item.rule, None)
        event.number, event.retracted, event.reported = item.number, item.retracted, item.reported
        event.forgotten = True
        return event

    def _register_kind(self, item: Any) -> str:
        """Return the kind of an object, and assign a number to its rule."""
        if item is NO_REPETITIONS:
            return "no repetitions"
        kind = _KIND_BY_CLASS.get(item.__class__, "node")
        # Numbers of rules and nodes are assigned here, because those of deleted rules are not known before.
        if kind == "rule":
            self._number_of_rule(item)
        elif kind == "node" and id(item) not in self._nodes:
            self._number_of_rule(item.rule)
        return kind

    def _encode_columns(self, kind: str) -> List[Any]:
        """Return the columns of all objects of a kind."""
        objects = self._objects[kind]
        if kind == "no repetitions":
            return []
        if kind == "rule":
            return [[self._number_of_rule(rule) for rule in objects]]
        if kind == "node":
            return list(zip(*[self._nodes[id(node)] for node in objects]))
        columns: List[Any] = []
        fields = _ENCODINGS[kind]
        for field, encoding in fields.items():
            column: Any = self._columns.get((kind, field)) or list(map(attrgetter(field), objects))
            if field == "end" and "start" in fields and _are_starts(objects, column):
                column = None
            elif encoding is _INSTANTS:
                column = encode_instants(column)
            # An attribute that is not used by any object takes no space.
            columns.append(
                None if column.__class__ is list and all(value is None for value in column) else column
            )
        return columns

    def _number_of_rule(self, rule: EventRule) -> int:
        number = self._rule_numbers.get(id(rule))
        if number is None:
            number = len(self.rules)
            self.rules.append(rule)
            self._add_rule(rule, number)
        return number

    def _to_ref(self, data: Any) -> Any:
        if not (data.__class__ in _KIND_BY_CLASS or isinstance(data, NetworkNode)):
            return data
        number = self.number_of(data)
        return self._refs.get(number) or self._refs.setdefault(number, Ref(number))

    def _to_parts(self, parts: Any) -> Any:
        if parts is None:
            return None
        return [self._to_part(part) for part in parts]

    def _to_part(self, part: Any) -> Any:
        """Return the encoding of a part of a match, see `_ColumnEncoding.PARTS`."""
        if part.__class__ in _KIND_BY_CLASS:
            return self.number_of(part)
        # `ComputedValues` is a sequence of one item already. A branch becomes one: its number is no number of an
        # object.
        return part if part.__class__ is ComputedValues else [part]


_NUMBER = optional(count)

_ColumnCheck = Callable[[Decoded, Sequence[int]], Sequence[Any]]
"""Check of a column of the objects with the given numbers; returns the values of an attribute."""


class GraphReader:
    """Reader that creates objects from columns and checks each attribute.

    Attributes refer to other objects by their numbers; checks restrict the kinds of these objects. No object may
    directly or indirectly consist of itself (`_sources`), otherwise traversals would not terminate.

    Args:
        value: result of `GraphWriter.encode`.
        rules: the rules in the order of their numbers.

    Raises:
        UsageError: if the value cannot have been created by `GraphWriter`.
    """

    def __init__(self, value: Decoded, rules: Sequence[EventRule]):
        self._rules = rules
        self._kinds, columns_by_kind = tuple_of(_check_kind_codes, dict_of(one_of(*_KINDS), items))(value)
        self._objects: List[Any] = []
        self._sources: DefaultDict[int, List[int]] = defaultdict(list)
        self._current_sources: List[int] = []
        self.check_match = self.reference_to(*MATCH_KINDS)
        """Check of a reference to a match of any kind."""
        self._read_event = self.reference_to("event")
        # Objects exist before their attributes are set, since references form cycles.
        objects_by_kind = {kind: self._create(kind, columns) for kind, columns in columns_by_kind.items()}
        numbers_by_kind = self._order_objects(objects_by_kind)
        # Most states have no partial matches.
        checks = self._make_column_checks() if columns_by_kind else {}
        for kind, objects in objects_by_kind.items():
            if kind in FIELDS:
                self._set_attributes(
                    kind, objects, numbers_by_kind[kind], columns_by_kind[kind], checks[kind]
                )
        self._check_acyclic()
        for kind, objects in objects_by_kind.items():
            if kind in _COMPLETIONS:
                for item in objects:
                    _COMPLETIONS[kind](item)

    def objects_of(self, *object_classes: type) -> List[Any]:
        """Return all objects of some classes."""
        return [item for item in self._objects if item.__class__ in object_classes]

    def _create(self, kind: str, columns: Sequence[Decoded]) -> List[Any]:
        """Return the objects of a kind, without attributes."""
        size = self._kinds.count(_CODES[kind])
        if kind in FIELDS:
            # An `EventMatch` has one slot for its interval and its order, which is assigned later.
            stored_class, _ = FIELDS[kind]
            object_class = PartialMatch if kind == "event match" else stored_class
            return [object_class.__new__(object_class) for _ in range(size)]
        if kind == "no repetitions":
            tuple_of()(columns)
            return [NO_REPETITIONS] * size
        rule_numbers = integers(0, len(self._rules) - 1)
        if kind == "rule":
            (numbers,) = tuple_of(rule_numbers)(columns)
            return [self._rules[number] for number in numbers]
        rules_of_nodes, node_numbers = tuple_of(rule_numbers, integers())(columns)
        nodes = []
        for rule_number, node_number in zip(rules_of_nodes, node_numbers):
            nodes_of_rule = self._rules[rule_number].nodes
            nodes.append(nodes_of_rule[integer(0, len(nodes_of_rule) - 1)(node_number)][0])
        return nodes

    def _order_objects(self, objects_by_kind: Dict[str, List[Any]]) -> Dict[str, List[int]]:
        """Store the objects in the order of their numbers, and return the numbers by kind."""
        for code in set(self._kinds):
            if _KINDS[code] not in objects_by_kind:
                raise invalid_value(_KINDS[code], "a kind with columns")
        numbers_by_kind: Dict[str, List[int]] = {kind: [] for kind in objects_by_kind}
        by_code = [(iter(objects_by_kind.get(kind, ())), numbers_by_kind.get(kind, [])) for kind in _KINDS]
        for number, code in enumerate(self._kinds):
            objects, numbers = by_code[code]
            self._objects.append(next(objects))
            numbers.append(number)
        return numbers_by_kind

    def _set_attributes(
        self,
        kind: str,
        objects: Sequence[Any],
        numbers: Sequence[int],
        columns: Sequence[Decoded],
        checks: Sequence[_ColumnCheck],
    ) -> None:
        """Check the columns of a kind and set the attributes of its objects."""
        if len(columns) != len(checks):
            raise invalid_value(len(columns), f"{len(checks)} columns of kind {kind}")
        if kind in MATCH_KINDS:
            for match in objects:
                match.buffer = match.identity = None
        fields = _ENCODINGS[kind]
        values: Sequence[Any] = ()
        for field, check, column in zip(fields, checks, columns):
            try:
                # If the ends are the starts, which are the values of the previous column, there is no column.
                if column is not None or field != "end" or "start" not in fields:
                    values = check(column, numbers)
                if len(values) != len(objects):
                    raise invalid_value(len(values), f"{len(objects)} values")
            except UsageError as error:
                raise UsageError(f"kind {kind}: {field}: {error.message}") from None
            for item, value in zip(objects, values):
                setattr(item, field, value)
        if kind == "event match":
            _complete_event_matches(objects)

    def reference_to(self, *kinds: str) -> ValueCheck:
        """Return a check of a reference to an object of one of the given kinds; the result is the object."""
        codes = frozenset(map(_CODES.__getitem__, kinds))

        def check(value: Decoded) -> Decoded:
            if (
                value.__class__ is not Ref
                or value.number >= len(self._kinds)
                or self._kinds[value.number] not in codes
            ):
                raise invalid_value(value, f"a reference to {' or '.join(kinds)}")
            return self._objects[value.number]

        return check

    def objects_by_number(self, *kinds: str) -> ValueCheck:
        """Return a check of a sequence of numbers of objects of the given kinds; the result is the objects."""
        codes = frozenset(map(_CODES.__getitem__, kinds))

        def check(value: Decoded) -> Decoded:
            numbers = integers()(value)
            is_in_range = max(numbers, default=-1) < len(self._kinds)
            if not is_in_range or not codes.issuperset(map(self._kinds.__getitem__, numbers)):
                raise invalid_value(numbers, f"references to {' or '.join(kinds)}")
            return list(map(self._objects.__getitem__, numbers))

        return check

    def _object_column(self, *kinds: str, is_source: bool = False, is_optional: bool = False) -> _ColumnCheck:
        """Return a check of a column of numbers of objects.

        Args:
            kinds: kinds of the objects.
            is_source: if the objects with the column consist of these objects.
            is_optional: if a number can be None.
        """
        check_numbers = self.objects_by_number(*kinds)

        def check(column: Decoded, numbers: Sequence[int]) -> Sequence[Any]:
            if column is None and is_optional:
                return [None] * len(numbers)
            present = [number for number in items(column) if number is not None]
            objects = iter(check_numbers(present))
            if is_source:
                for number, source in zip(numbers, column):
                    if source is not None:
                        self._sources[number].append(source)
            if len(present) == len(column):
                return list(objects)
            if not is_optional:
                raise invalid_value(None, f"a reference to {' or '.join(kinds)}")
            return [None if number is None else next(objects) for number in column]

        return check

    def _mixed_column(self, check_value: ValueCheck) -> _ColumnCheck:
        """Return a check of a column of data with references."""

        def check(column: Decoded, numbers: Sequence[int]) -> Sequence[Any]:
            if column is None:
                return [check_value(None)] * len(numbers)
            values = []
            for number, value in zip(numbers, items(column)):
                # `_check_event`, `_check_part` and `_source_reference` add references to what the object consists of.
                self._current_sources = self._sources[number]
                values.append(check_value(value))
            return values

        return check

    def _source_reference(self, *kinds: str) -> ValueCheck:
        """Return a check of a reference to an object that the current object consists of."""
        read_reference = self.reference_to(*kinds)

        def check(value: Decoded) -> Decoded:
            item = read_reference(value)
            self._current_sources.append(value.number)
            return item

        return check

    def check_token(self, value: Decoded) -> Decoded:
        """Check the identity of an event: a number, or the event itself if lineage is recorded."""
        return self._check_event(value) if value.__class__ is Ref else _NUMBER(value)

    def check_token_key(self, value: Decoded) -> Decoded:
        """Check a key that consists of terms, or of identities of events."""
        if value.__class__ is Ref:
            return self._check_event(value)
        if value.__class__ is list and any(item.__class__ is Ref for item in value):
            return tuple([self.check_token_key(item) for item in value])
        return key(value)

    def _check_event(self, value: Decoded) -> Decoded:
        event = self._read_event(value)
        self._current_sources.append(value.number)
        return event

    def _check_origin(self, value: Decoded) -> Decoded:
        """Check the origin of a stream element: a match, the event of a subscription, or None."""
        return self.check_match(value) if value.__class__ is Ref else optional(term)(value)

    def _check_part(self, value: Decoded) -> Decoded:
        """Check a part of a match, see `_ColumnEncoding.PARTS`."""
        if value.__class__ is int:
            part = self._read_parts([value])[0]
            self._current_sources.append(value)
            return part
        (content,) = tuple_of(any_value)(value)
        return count(content) if content.__class__ is int else ComputedValues(_check_match_values(content))

    def _make_column_checks(self) -> Dict[str, List[_ColumnCheck]]:
        """Return the checks of the attributes of each kind of object, in the order of `FIELDS`."""
        self._read_parts = self.objects_by_number(
            *MATCH_KINDS, "repetition chain", "no repetitions", "buffer slice"
        )
        check_match = self.check_match
        node_entry = tuple_of(
            self.reference_to("node"),
            self.reference_to("run", "node", "run group"),
            lambda value: check_match(value) if value.__class__ is Ref else count(value),
        )

        def check_dependent(value: Decoded) -> Decoded:
            """Check what depends on an event: a match, or an entry of a buffer as node, owner and entry."""
            if value.__class__ is Ref:
                return check_match(value)
            node, owner, entry = node_entry(value)
            # A buffer entry is identified by a number in repeat nodes, and by the match itself elsewhere.
            by_number = (
                isinstance(node, RepeatNode) and owner.__class__ is RunGroup and entry.__class__ is int
            )
            by_match = (owner is node and isinstance(node, StreamNode)) or (
                isinstance(node, KleeneNode) and owner.__class__ is Run
            )
            if not by_number and not (by_match and isinstance(entry, EventMatch)):
                raise invalid_value(value, "a buffer entry of a node")
            return node, owner, entry

        match_pair = tuple_of(check_match, check_match)
        numbers, booleans, terms = (
            _column(integers()),
            _column(sequence_of(boolean)),
            _column(sequence_of(term)),
        )
        first = self._object_column(*MATCH_KINDS, is_source=True)
        optional_match = self._object_column(*MATCH_KINDS, is_optional=True)
        log, node = self._object_column("log"), self._object_column("node")
        # The order of the checks is that of the attributes in `FIELDS`. The groups `*(...)` only save lines.
        interval: List[_ColumnCheck] = [_instant_column, _instant_column]
        match = [
            *(_column(sequence_of(_check_match_values)), *interval, self._mixed_column(self.check_token)),
            *(
                _optional_column(sequence_of(optional(term))),
                self._mixed_column(optional(sequence_of(self._check_part, tuple))),
            ),
            optional_match,
        ]
        tracked = [
            self._mixed_column(sequence_of(self.reference_to("event", "repetition chain"))),
            *(self._mixed_column(sequence_of(check_dependent)), booleans, booleans),
            self._mixed_column(sequence_of(self.reference_to("suppressed"))),
        ]
        pieces = sequence_of(tuple_of(self._source_reference("log"), count, count), tuple)
        return {
            "event match": [*interval, _column(sequence_of(_check_compound))],
            "match": match,
            "run": [
                *(
                    *match,
                    first,
                    _instant_column,
                    _optional_column(sequence_of(optional(_check_match_values))),
                ),
                *(
                    _optional_column(sequence_of(_check_aggregate_state)),
                    terms,
                    self._mixed_column(sequence_of(check_match)),
                ),
                self._object_column("repetition chain", "no repetitions", is_source=True),
                _column(sequence_of(sequence_of(tuple_of(_check_match_values, _check_match_values)))),
                _column(sequence_of(sequence_of(variable, tuple))),
            ],
            "run cursor": [
                *(*match, first, numbers, log, numbers, numbers),
                self._object_column("run group", is_optional=True),
            ],
            "run group": [
                *(
                    node,
                    _column(sequence_of(key)),
                    self._mixed_column(sequence_of(optional(self.reference_to("run cursor")))),
                ),
                *(_instant_column, _column(match_orders), log, numbers),
            ],
            "log": [self._mixed_column(sequence_of(self._source_reference(*MATCH_KINDS)))],
            "buffer slice": [self._mixed_column(pieces)],
            "repetition chain": [
                self._object_column(*MATCH_KINDS, is_source=True, is_optional=True),
                self._object_column("repetition chain", "no repetitions", is_source=True, is_optional=True),
                *(numbers, booleans, *tracked),
            ],
            "event": [
                *(numbers, terms, *interval, self._object_column("rule", is_optional=True)),
                *(self._object_column(*MATCH_KINDS, is_source=True, is_optional=True), booleans),
                *(self._mixed_column(optional(sequence_of(self.reference_to("event")))), *tracked),
            ],
            "element": [
                *(
                    self._mixed_column(self._check_origin),
                    *interval,
                    _column(sequence_of(_check_match_values)),
                ),
                *(_column(sequence_of(sequence_of(optional(term), tuple))), numbers),
            ],
            "suppressed": [
                node,
                self._mixed_column(
                    lambda value: self.check_match(value) if value.__class__ is Ref else match_pair(value)
                ),
                *(numbers, booleans),
            ],
        }

    def _check_acyclic(self) -> None:
        """Check that no object consists of itself, by a depth-first search with an explicit stack."""
        # By object: 0 before the visit, 1 while the objects that it consists of are being visited, then 2.
        progress = bytearray(len(self._objects))
        for number in list(self._sources):
            stack = [number]
            while stack:
                current = stack[-1]
                if progress[current]:
                    progress[current] = 2
                    stack.pop()
                    continue
                progress[current] = 1
                for source in self._sources.get(current, ()):
                    if progress[source] == 1:
                        kind = _KINDS[self._kinds[source]]
                        raise UsageError(f"object {source}, of kind {kind}, contains itself")
                    if not progress[source]:
                        stack.append(source)


def _complete_event_matches(matches: Sequence[Any]) -> None:
    """Set the attributes of matches of single events that follow from the event or are not used."""
    for match in matches:
        match.values = match.term[1:]
        match.event = match.parts = match.consumed_by = None


def _are_starts(objects: Sequence[Any], ends: Sequence[Any]) -> bool:
    """Return whether the ends are the starts of the objects, compared by identity as in `encode_records`."""
    return all(map(is_, map(attrgetter("start"), objects), ends))


def _complete_match(match: Any) -> None:
    if match.parts is None and match.term is None:
        raise UsageError("a match has neither an event nor parts")


def _complete_run(run: Any) -> None:
    _complete_match(run)
    run.after_restore()


def _complete_cursor(cursor: Any) -> None:
    _complete_match(cursor)
    if cursor.log_position > len(cursor.log.items):
        raise UsageError("a run has more repetitions than its buffer")


def _complete_group(group: Any) -> None:
    if not isinstance(group.node, RepeatNode):
        raise UsageError("a group of runs belongs to a node of another type")
    group.cursor_count = sum(cursor is not None and cursor.buffer is group for cursor in group.cursors)
    group.after_restore()


def _complete_slice(buffer_slice: Any) -> None:
    if not all(start <= end <= len(log.items) for log, start, end in buffer_slice.pieces):
        raise UsageError("a slice of repetitions exceeds their buffer")
    buffer_slice.length = sum(end - start for _, start, end in buffer_slice.pieces)


def _check_repetition_chain(tracked: Any) -> None:
    if (tracked.earlier is None) != (tracked.match is None):
        raise UsageError("a tracked match of repetitions has no beginning")


_COMPLETIONS: Dict[str, Callable[[Any], None]] = {
    "match": _complete_match,
    "run": _complete_run,
    "run cursor": _complete_cursor,
    "run group": _complete_group,
    "log": SharedLog.after_restore,
    "buffer slice": _complete_slice,
    "repetition chain": _check_repetition_chain,
}
"""By kind: checks of relations between the attributes of an object, and derivation of those that are not stored."""


def _check_kind_codes(value: Decoded) -> bytes:
    """Check the codes of the kinds of all objects."""
    if value.__class__ is not bytes or (value and max(value) >= len(_KINDS)):
        raise invalid_value(value, "codes of kinds")
    return value


def _column(check: ValueCheck) -> _ColumnCheck:
    """Return a check of a column by the check of all its values."""
    return lambda column, numbers: check(column)


def _optional_column(check: ValueCheck) -> _ColumnCheck:
    """Return a check of a column that is None if all its values are."""
    return lambda column, numbers: [None] * len(numbers) if column is None else check(column)


def _instant_column(column: Decoded, numbers: Sequence[int]) -> Sequence[Any]:
    return decode_instants(column, len(numbers))


_check_match_values = sequence_of(value_of_match, tuple)
"""Check of the values of the variables of a match."""


def _check_compound(value: Decoded) -> Decoded:
    """Check the term of an event whose arguments are the values of a match."""
    if value.__class__ is not tuple:
        raise invalid_value(value, "a compound term")
    return value


def _check_aggregate_state(value: Decoded) -> Decoded:
    """Check the state of an aggregate: a number, None, or nested pairs of an earlier state and a term."""
    pairs = []
    while value.__class__ is list and len(value) == 2:
        pairs.append(term(value[1]))
        value = value[0]
    if value.__class__ is list:
        if value:
            raise invalid_value(value, "the state of an aggregate")
        value = ()
    elif value is not None:
        term(value)
    for collected in reversed(pairs):
        value = (value, collected)
    return value


def _map_objects(data: Any, convert: Callable[[Any], Any]) -> Any:
    """Return data with a function applied to everything but sequences and terms; deques become lists."""
    data_class = data.__class__
    if data_class is tuple:
        if data and data[0].__class__ is Functor:
            return data
        return tuple([_map_objects(item, convert) for item in data])
    if data_class is list or data_class is deque:
        return [_map_objects(item, convert) for item in data]
    return convert(data)
