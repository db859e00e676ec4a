"""Partial matches and events with all that they are made of, as rows of numbers and terms.

These objects know one another in circles, so each is a row, in which others stand by their numbers (`Ref`).
"""

from typing import Any, Callable, Dict, List, Sequence, Tuple

from ..events.matches.partial_matches import NOTHING_HELD, EventMatch, Found, PartialMatch, TrackedMatch
from ..events.matches.run_groups import BufferSlice, Run, RunCursor, RunGroup, SharedLog
from ..events.network.event_rule import EventRule
from ..events.network.kleene_node import KleeneNode
from ..events.network.pattern_nodes import NetworkNode
from ..events.network.repeat_node import RepeatNode
from ..events.network.stream_node import StreamNode
from ..events.provenance.event_log import Occurrence, Suppressed
from ..events.streams.stream_elements import StreamElement
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
"""The kinds of objects: their class, and which attributes are kept. The others are made anew."""

_KINDS = {EventMatch: "match", **{kind: name for name, (kind, _) in FIELDS.items()}}

_AS_IT_IS = frozenset((int, bool, type(None)))

ObjectRow = List[Any]


class GraphWriter:
    """Gives objects numbers, and their rows.

    Args:
        rules: those whose places are known; others that are met, of which something is left, come after them.
    """

    def __init__(self, rules: Sequence[EventRule]):
        self.rules = list(rules)
        self.rows: List[ObjectRow] = []
        self._refs: Dict[int, Ref] = {}
        self._objects: List[Any] = []
        self._places: Dict[int, int] = {}
        self._nodes: Dict[int, Tuple[int, int]] = {}
        for number, rule in enumerate(self.rules):
            self._note_rule(rule, number)

    def _note_rule(self, rule: EventRule, number: int) -> None:
        self._places[id(rule)] = number
        for at, (node, _, _) in enumerate(rule.nodes):
            self._nodes[id(node)] = (number, at)

    def write(self, data: Any) -> Any:
        """Return data with `Ref` in the place of objects, which get rows."""
        made = _changed(data, self._plain)
        while len(self.rows) < len(self._objects):
            self.rows.append(self._row(self._objects[len(self.rows)]))
        return made

    def _plain(self, data: Any) -> Any:
        kind = data.__class__
        if kind in _KINDS or kind is EventRule or id(data) in self._nodes:
            return self._ref(data)
        if isinstance(data, NetworkNode):  # of a rule that is not there any more
            self._rule(data.rule)  # type: ignore[attr-defined]  # those of which something is left have one
            return self._ref(data)
        return data

    def _ref(self, data: Any) -> Ref:
        found = self._refs.get(id(data))
        if found is None:
            found = self._refs[id(data)] = Ref(len(self._objects))
            self._objects.append(data)
        return found

    def _rule(self, rule: EventRule) -> int:
        number = self._places.get(id(rule))
        if number is None:
            number = len(self.rules)
            self.rules.append(rule)
            self._note_rule(rule, number)
        return number

    def _row(self, one: Any) -> ObjectRow:
        if one is NOTHING_HELD:
            return ["nothing"]
        kind = one.__class__
        if kind is EventRule:
            return ["rule", self._rule(one)]
        if id(one) in self._nodes:
            return ["node", *self._nodes[id(one)]]
        name = _KINDS[kind]
        row: ObjectRow = [name]
        for field in FIELDS[name][1]:
            value = getattr(one, field)
            if value.__class__ not in _AS_IT_IS:
                value = _changed(list(value) if field == "tokens" else value, self._plain)
            row.append(value)
        return row


_MATCHES = ("match", "run", "token")

_NUMBER = optional(count)


class GraphReader:
    """Makes objects of rows, each attribute checked.

    An attribute names other objects by their numbers; what it may name is checked by the kinds of these. No object is
    made of itself (`_sources`): else what walks over it would not end.

    Args:
        rows: theirs.
        rules: in the order in which the rows name them.

    Raises:
        UsageError: for a row that no `GraphWriter` writes.
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
            self._objects.append(self._empty(row))
        for number, (one, row) in enumerate(zip(self._objects, rows)):
            self._current = []
            self._sources.append(self._current)
            if row[0] in FIELDS:
                try:
                    self._fill(one, row, checks[row[0]])
                except UsageError as error:
                    raise UsageError(f"object {number}, a {row[0]}: {error.message}") from None
        self._check_order()
        for one in self._objects:
            self._finish(one)

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
        kind = FIELDS[name][0]
        return kind.__new__(kind)

    def _fill(self, one: Any, row: Sequence[Any], checks: Sequence[ValueCheck]) -> None:
        if isinstance(one, PartialMatch):
            one.buffer = None
        for field, check, value in zip(FIELDS[row[0]][1], checks, row[1:]):
            setattr(one, field, check(value))

    def ref(self, *kinds: str) -> ValueCheck:
        """Return a check of a reference to an object of some kinds; the result is the object."""
        wanted = frozenset(kinds)
        every, objects = self._kinds, self._objects

        def check(value: Decoded) -> Decoded:
            if value.__class__ is not Ref or value.number >= len(every) or every[value.number] not in wanted:
                raise wrong(value, f"a reference to {' or '.join(kinds)}")
            return objects[value.number]

        return check

    def _source(self, *kinds: str) -> ValueCheck:
        """Return the same of what an object was made of."""
        refer = self.ref(*kinds)

        def check(value: Decoded) -> Decoded:
            found = refer(value)
            self._current.append(value.number)
            return found

        return check

    def token(self, value: Decoded) -> Decoded:
        """Check what tells an event from others: a number, or where events are tracked the event."""
        return self._event(value) if value.__class__ is Ref else _NUMBER(value)

    def token_key(self, value: Decoded) -> Decoded:
        """Check a key that is made of terms, or of what tells events from others."""
        if value.__class__ is Ref:
            return self._event(value)
        if value.__class__ is list and any(item.__class__ is Ref for item in value):
            return tuple([self.token_key(item) for item in value])
        return key(value)

    def _event(self, value: Decoded) -> Decoded:
        found = self._refer_to_event(value)
        self._current.append(value.number)
        return found

    def _of_item(self, value: Decoded) -> Decoded:
        """Check what an item of a stream was made of: a match, the event that a subscription sends, or nothing."""
        return self.match(value) if value.__class__ is Ref else optional(term)(value)

    def _checks(self) -> Dict[str, List[ValueCheck]]:
        """Return the checks of the attributes of each kind, in the order of `FIELDS`."""
        below = self._source(*_MATCHES)
        held = self._source("held", "nothing")
        of_parts = self._source(*_MATCHES, "held", "nothing", "chain")
        values = each(value_of_match, tuple)
        found = fixed(values)

        def part(value: Decoded) -> Decoded:
            if value.__class__ is Ref:
                return of_parts(value)
            return count(value) if value.__class__ is int else Found(*found(value))

        match_ref = self.match
        of_node = fixed(
            self.ref("node"),
            self.ref("run", "node", "train"),
            lambda value: match_ref(value) if value.__class__ is Ref else count(value),
        )

        def holder(value: Decoded) -> Decoded:
            if value.__class__ is Ref:
                return match_ref(value)
            node, of, what = of_node(value)
            by_number = isinstance(node, RepeatNode) and of.__class__ is RunGroup and what.__class__ is int
            by_match = (of is node and isinstance(node, StreamNode)) or (
                isinstance(node, KleeneNode) and of.__class__ is Run
            )
            if not by_number and not (by_match and isinstance(what, PartialMatch)):
                raise wrong(value, "what a node is to forget")
            return node, of, what

        tried = fixed(match_ref, match_ref)
        match = [
            *(values, instant, instant, self.token, optional(term), optional(each(part, tuple))),
            optional(match_ref),
        ]
        tracked = [
            *(each(self.ref("event", "held")), each(holder), boolean, boolean),
            each(self.ref("suppressed")),
        ]
        piece = fixed(self._source("log"), count, count)
        return {
            "match": match,
            "run": [
                *match,
                *(below, instant, optional(values), _state, term, each(match_ref), held),
                *(each(fixed(values, values)), count, each(variable, tuple)),
            ],
            "token": [
                *match,
                *(below, count, self.ref("log"), count, count, optional(self.ref("train"))),
            ],
            "train": [
                *(self.ref("node"), key, each(optional(self.ref("token")))),
                *(instant, count, self.ref("log"), count, count),
            ],
            "log": [each(below)],
            "chain": [each(piece, tuple), count],
            "held": [optional(below), optional(held), count, boolean, *tracked],
            "event": [
                *(count, term, instant, instant, optional(self.ref("rule")), optional(below), boolean),
                *(optional(each(self.ref("event"))), *tracked),
            ],
            "item": [
                *(self._of_item, instant, instant, values),
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
        """Check that nothing was made of itself."""
        done = bytearray(len(self._objects))  # 1 while what it was made of is looked at, then 2
        for number in range(len(done)):
            stack = [number]
            while stack:
                one = stack[-1]
                if done[one]:
                    done[one] = 2
                    stack.pop()
                    continue
                done[one] = 1
                for other in self._sources[one]:
                    if done[other] == 1:
                        raise UsageError(f"object {other}, a {self._kinds[other]}, was made of itself")
                    if not done[other]:
                        stack.append(other)

    def _finish(self, one: Any) -> None:
        """Check what attributes of several objects have to do with one another, and make those that are not kept."""
        kind = one.__class__
        if isinstance(one, PartialMatch) and one.parts is None and one.term is None:
            raise UsageError("a match is neither of an event nor of others")
        if kind is RunGroup:
            if not isinstance(one.node, RepeatNode):
                raise UsageError("sequences go on in a node of other kind")
            one.alive = sum(token is not None and token.buffer is one for token in one.tokens)
        elif kind is BufferSlice:
            if not all(begin <= end <= len(log.items) for log, begin, end in one.pieces):
                raise UsageError("a piece of repetitions is longer than they are")
            one.length = sum(end - begin for _, begin, end in one.pieces)
        elif kind is RunCursor and one.at > len(one.log.items):
            raise UsageError("a sequence has more repetitions than there are")
        elif kind is TrackedMatch and (one.earlier is None) != (one.match is None):
            raise UsageError("what is held of repetitions has no beginning")
        elif kind is Suppressed and not hasattr(one.node, "retry"):
            raise UsageError("a node of other kind cannot try a match again")
        if kind in (RunGroup, SharedLog, Run):
            one.begin_again()


def _state(value: Decoded) -> Decoded:
    """Check what an aggregate has collected: a number, nothing, or pairs of what was collected before and a term."""
    pairs = []
    while value.__class__ is list and len(value) == 2:
        pairs.append(term(value[1]))
        value = value[0]
    if value.__class__ is list:
        if value:
            raise wrong(value, "what an aggregate has collected")
        value = ()
    elif value is not None:
        term(value)
    for one in reversed(pairs):
        value = (value, one)
    return value


def _changed(data: Any, change: Callable[[Any], Any]) -> Any:
    """Return data in which all that is neither a list nor a tuple is changed; terms stay as they are."""
    kind = data.__class__
    if kind is tuple:
        if data and data[0].__class__ is Functor:
            return data
        return tuple([_changed(item, change) for item in data])
    if kind is list:
        return [_changed(item, change) for item in data]
    return change(data)
