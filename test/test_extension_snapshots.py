"""An aggregate, a stream operator and a node type, each added in one place, are saved in the middle of a match."""

from types import ModuleType
from typing import Any, List, Set

import pytest
from contributing_snippets import SNIPPETS

from retalis import Engine, UsageError
from retalis.events.matches.match_types import MATCH_REFERENCE
from retalis.events.network.pattern_nodes import FilterNode
from retalis.events.streams import aggregates, rate_operators
from retalis.serialization.codec import from_bytes, to_bytes
from retalis.serialization.state_fields import StateFields, constraint, field
from retalis.serialization.state_file_format import pack_sections, unpack_sections
from retalis.serialization.stored_field_types import optional


def add_entries(section: str, module: ModuleType, opening: str, closing: str) -> Any:
    """Return the entries that a section of ``CONTRIBUTING.md`` adds to a table, between brackets.

    Args:
        section: heading of the section.
        module: module of the table.
        opening: opening bracket of the table.
        closing: closing bracket of the table.
    """
    definitions, entries = [snippet for snippet in SNIPPETS[section] if snippet.path.startswith("src/")]
    # The classes are those of this module: others list the classes of the package.
    names = {**vars(module), "__name__": __name__}
    exec(definitions.text, names)
    return eval(f"{opening}{entries.text}{closing}", names)


(RANGE,) = add_entries("An aggregate (`avg`)", aggregates, "(", ")")
EVERY_THIRD = add_entries("A rate operator (`burst`)", rate_operators, "{", "}")


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
    monkeypatch.setitem(aggregates.AGGREGATES, RANGE.name, RANGE)
    for name, operator in EVERY_THIRD.items():
        monkeypatch.setitem(rate_operators.RATE_OPERATORS, name, operator)
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


def emitted_events(engine: Engine, events: Any, first_second: int) -> Any:
    """Return the events that rules emit when an engine gets one event per second."""
    emitted: List[Any] = []
    engine.on_event(lambda term, start, end: emitted.append((engine.show(term), int(start), int(end))))
    for second, event in enumerate(events, first_second):
        engine.event(event, second)
    return emitted


@pytest.mark.usefixtures("extensions")
@pytest.mark.parametrize("name", RULES)
def test_extension_is_restored_in_middle_of_match(name: str) -> None:
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
