"""Partial matches and events with all that they are made of, as rows of numbers and terms.

These objects know one another in circles, so each is a row, in which others stand by their numbers (`Ref`).
"""

from typing import Any, Callable, Dict, List, Sequence, Tuple

from ...events.history import Occurrence, Suppressed
from ...events.matches import NOTHING_HELD, Chain, Held, Log, Match, Run, Token, Train
from ...events.network import NetworkNode, Rule
from ...events.streams import StreamItem
from ...foundation import UsageError
from ...prolog.terms import Functor
from .coding import Ref

_MATCH = ("values", "start", "end", "event", "term", "parts", "used")
_TRACKED = ("derived", "held", "gone", "reported", "suppressed")

FIELDS: Dict[str, Tuple[Any, Tuple[str, ...]]] = {
    "match": (Match, _MATCH),
    "run": (
        Run,
        (*_MATCH, "first", "last", "fixed", "state", "items", "taken", "held", "steps", "sound", "open"),
    ),
    "token": (Token, (*_MATCH, "first", "apart", "log", "at", "since", "buffer")),
    "train": (Train, ("node", "key", "tokens", "end", "order", "log", "taken", "alive")),
    "log": (Log, ("items",)),
    "chain": (Chain, ("pieces", "length")),
    "held": (Held, ("match", "earlier", "number", "linked", *_TRACKED)),
    "event": (
        Occurrence,
        ("number", "term", "start", "end", "rule", "match", "forgotten", "takes_back", *_TRACKED),
    ),
    "item": (StreamItem, ("match", "start", "end", "by", "values", "order")),
    "suppressed": (Suppressed, ("node", "what", "number", "freed")),
}
"""The kinds of objects: their class, and which attributes are kept. The others are made anew."""

_KINDS = {kind: name for name, (kind, _) in FIELDS.items()}

ObjectRow = List[Any]


class GraphWriter:
    """Gives objects numbers, and their rows.

    Args:
        rules: those whose places are known; others that are met, of which something is left, come after them.
    """

    def __init__(self, rules: Sequence[Rule]):
        self.rules = list(rules)
        self.rows: List[ObjectRow] = []
        self._numbers: Dict[int, int] = {}
        self._objects: List[Any] = []
        self._places: Dict[int, int] = {}
        self._nodes: Dict[int, Tuple[int, int]] = {}
        for number, rule in enumerate(self.rules):
            self._note_rule(rule, number)

    def _note_rule(self, rule: Rule, number: int) -> None:
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
        if kind in _KINDS or kind is Rule or id(data) in self._nodes:
            return self._ref(data)
        if isinstance(data, NetworkNode):  # of a rule that is not there any more
            self._rule(data.rule)  # type: ignore[attr-defined]  # those of which something is left have one
            return self._ref(data)
        return data

    def _ref(self, data: Any) -> Ref:
        number = self._numbers.get(id(data))
        if number is None:
            number = self._numbers[id(data)] = len(self._objects)
            self._objects.append(data)
        return Ref(number)

    def _rule(self, rule: Rule) -> int:
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
        if kind is Rule:
            return ["rule", self._rule(one)]
        if id(one) in self._nodes:
            return ["node", *self._nodes[id(one)]]
        name = _KINDS[kind]
        found = [self._attribute(one, field) for field in FIELDS[name][1]]
        return [name, *found]

    def _attribute(self, one: Any, field: str) -> Any:
        value = getattr(one, field)
        if field == "tokens":
            value = list(value)
        return _changed(value, self._plain)


class GraphReader:
    """Makes objects of rows.

    Args:
        rows: theirs.
        rules: in the order in which the rows name them.
    """

    def __init__(self, rows: Sequence[ObjectRow], rules: Sequence[Rule]):
        self._rules = rules
        self._objects = [self._empty(*row) for row in rows]
        for one, row in zip(self._objects, rows):
            if row[0] in FIELDS:
                self._fill(one, row)

    def _empty(self, name: str, *rest: Any) -> Any:
        if name == "nothing":
            return NOTHING_HELD
        if name == "rule":
            return self._rules[rest[0]]
        if name == "node":
            return self._rules[rest[0]].nodes[rest[1]][0]
        kind = FIELDS[name][0]
        return kind.__new__(kind)

    def _fill(self, one: Any, row: ObjectRow) -> None:
        kind, fields = FIELDS[row[0]]
        if len(row) != len(fields) + 1:
            raise UsageError(f"a {row[0]} has {len(row) - 1} parts")
        if isinstance(one, Match):
            one.buffer = None
        for field, value in zip(fields, row[1:]):
            setattr(one, field, self.read(value))
        if kind in (Train, Log, Run):
            one.begin_again()

    def read(self, data: Any) -> Any:
        """Return data with the objects in the place of `Ref`."""
        return _changed(data, self._object)

    def _object(self, data: Any) -> Any:
        return self._objects[data.number] if data.__class__ is Ref else data


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
