"""An aggregate, a stream operator and a node type, each added in one place, are saved in the middle of a match."""

from typing import Any, Dict, List, Set

import pytest

from retalis import Engine, UsageError
from retalis.events.matches.match_types import MATCH_REFERENCE
from retalis.events.network.pattern_nodes import FilterNode
from retalis.events.streams.aggregates import (
    AGGREGATES,
    COMPARABLE_NUMBER,
    Accumulator,
    AggregateFunction,
    Fold,
    present_elements,
)
from retalis.events.streams.rate_operators import RATE_OPERATORS, RateOperator
from retalis.events.streams.stream_operators import StreamOperator, StreamOutput
from retalis.serialization.codec import from_bytes, to_bytes
from retalis.serialization.field_types import COUNT, KEY, ORDERED, mapping_of, optional, tuple_of
from retalis.serialization.state_fields import StateFields, constraint, field
from retalis.serialization.state_file_format import pack_sections, unpack_sections


class RangeAccumulator(Accumulator):
    """Difference of the largest and the smallest value of a window."""

    value_rule = COMPARABLE_NUMBER
    scans_window = True

    def result(self, elements: Any, count: Any) -> Any:
        values = [element.values[self.index] for element in present_elements(elements)]
        return max(values) - min(values)


def extended(extremes: Any, value: Any) -> Any:
    """Return the smallest and the largest value with one more."""
    return (value, value) if extremes is None else (min(extremes[0], value), max(extremes[1], value))


RANGE = AggregateFunction(
    "range",
    "range(X)",
    RangeAccumulator,
    Fold(
        initial_state=None,
        state_type=optional(tuple_of(ORDERED, ORDERED)),
        empty_result=None,
        add=extended,
        result=lambda extremes: extremes[1] - extremes[0],
    ),
)


class EveryThird(StreamOperator):
    """Passes each third element of a key."""

    STATE = StateFields(
        field("counts", mapping_of(KEY, COUNT)),
        constraint("counts below 3", lambda operator, state: max(state["counts"].values(), default=0) < 3),
    )

    emits_stored_elements = False

    def __init__(self) -> None:
        super().__init__()
        self.counts: Dict[Any, Any] = {}

    def process(self, element: Any, now: Any, channel: Any) -> Any:
        count = self.counts.get(element.key, 0) + 1
        self.counts[element.key] = count % 3
        return [] if count < 3 else [StreamOutput((element,), element.start, element.end)]


EVERY_THIRD = RateOperator(
    notation="every_third(Seconds) or every_third(Seconds, Key)",
    takes_seconds=True,
    create=lambda span: EveryThird(),
    is_delayed=False,
    block_reason="it is not the third one",
)


class SecondMatchNode(FilterNode):
    """Passes on each second match that satisfies its tests, together with the one before."""

    STATE = StateFields(
        field("waiting_match", optional(MATCH_REFERENCE)),
        constraint(
            "a match of its pattern",
            lambda node, state: state["waiting_match"] is None or node.child.accepts(state["waiting_match"]),
        ),
    )

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.waiting_match = None

    def bind(self, emit: Any, options: Any) -> None:
        def on_match(match: Any, frame: Any) -> Any:
            if self.waiting_match is None:
                self.waiting_match = match
                return frame
            first, self.waiting_match = self.waiting_match, None
            return emit(first, emit(match, frame))

        super().bind(on_match, options)


@pytest.fixture
def extensions(monkeypatch: pytest.MonkeyPatch) -> None:
    """Add the three extensions."""
    monkeypatch.setitem(AGGREGATES, "range", RANGE)
    monkeypatch.setitem(RATE_OPERATORS, "every_third", EVERY_THIRD)
    monkeypatch.setattr("retalis.events.network.rule_compiler.FilterNode", SecondMatchNode)


EVENTS = ("a(1)", "b(7)", "a(4)", "b(2)", "a(2)", "b(5)", "a(9)", "b(1)", "a(3)", "b(4)", "a(5)", "b(9)")

RULES = {
    "aggregate in window": "p(R) <- aggregate(range(X), a(X), R, last(5)).",
    "aggregate in counted window": "p(R) <- aggregate(range(X), a(X), R, every(3, events)).",
    "aggregate in steps": "p(R) <- aggregate(range(X), a(X), R, steps([up(2) where X > 1])).",
    "aggregate of repetitions": "p(R) <- a(_) seq aggregate(range(X), b(X), R).",
    "aggregate in sequence": "p(R) <- aggregate(range(X), a(X), R, last(5)) seq b(_).",
    "stream operator": "p(X) <- (a(X) with every_third(1)).",
    "stream operator in sequence": "p(X, Y) <- (a(X) with every_third(1)) seq b(Y).",
    "node": "p(X, Y) <- (a(X) where X > 1) seq b(Y).",
}


def emitted_events(engine: Any, events: Any, first_second: int) -> Any:
    """Return the events that rules emit when an engine gets one event per second."""
    emitted: List[Any] = []
    engine.on_event(lambda term, start, end: emitted.append((engine.show(term), int(start), int(end))))
    for second, event in enumerate(events, first_second):
        engine.event(event, second)
    return emitted


@pytest.mark.usefixtures("extensions")
@pytest.mark.parametrize("name", RULES)
def test_extension_is_restored_in_middle_of_match(name: Any) -> None:
    outputs: Set[Any] = set()
    for position in range(len(EVENTS)):
        original = Engine()
        original.load(RULES[name])
        emitted_events(original, EVENTS[:position], 0)
        restored = Engine.restore(original.snapshot())
        expected = emitted_events(original, EVENTS[position:], position)
        assert emitted_events(restored, EVENTS[position:], position) == expected
        assert restored.status().rules == original.status().rules
        outputs.update(expected)
    assert any(text.startswith("p(") for text, _, _ in outputs)


def with_replaced(data: Any, name: Any, value: Any) -> Any:
    """Return data in which the fields of a name have another value."""
    if not isinstance(data, list):
        return data
    items = [with_replaced(item, name, value) for item in data]
    # Names and values alternate.
    for position in range(0, len(data) - 1, 2):
        if data[position] == name:
            items[position + 1] = value
    return items


@pytest.mark.usefixtures("extensions")
@pytest.mark.parametrize(
    ("rule", "name", "value", "message"),
    [
        ("aggregate of repetitions", "state", [[1], None], "run: state: item 0: '.*': expected 2 items"),
        ("aggregate of repetitions", "state", [[1, "x"], None], "run: state: item 0: 'x': expected a number"),
        (
            "stream operator",
            "counts",
            [[1, -1]],
            "StreamNode: stream: counts: item 0: '-1': expected an integer",
        ),
        ("stream operator", "counts", [[1, 3]], "StreamNode: stream: EveryThird: expected counts below 3"),
        (
            "node",
            "waiting_match",
            7,
            "SecondMatchNode: waiting_match: '7': expected a reference to event match",
        ),
    ],
)
def test_damaged_state_of_extension_is_refused(rule: str, name: str, value: Any, message: str) -> None:
    engine = Engine()
    engine.load(RULES[rule])
    emitted_events(engine, EVENTS[:3], 0)
    sections = unpack_sections(engine.snapshot()).sections
    damaged = with_replaced(from_bytes(sections["matches"]), name, value)
    assert damaged != from_bytes(sections["matches"])
    with pytest.raises(UsageError, match=message):
        Engine.restore(pack_sections({**sections, "matches": to_bytes(damaged)}))
