"""States that hold from one event until another."""

import logging
import math
from typing import Any, List, Tuple

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from retalis import Engine, ProgramErrors, PrologError, StreamClock, explain, record_origins
from retalis.prolog.terms.timestamps import SECOND

DOCKED = ":- state(docked(R), from(dock(R)), until(undock(R))).\n"
ALARM = "alarm(R) <- bump(R) where holds(docked(R)).\n"


class StateEngine(Engine):
    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.events: List[Any] = []
        self.on_event(
            lambda term, start, end: self.events.append((self.show(term), start / SECOND, end / SECOND))
        )

    def feed(self, *events: Any) -> List[Any]:
        """Process events ``(text, end)`` or ``(text, start, end)``; return the derived events."""
        self.events.clear()
        for text, *interval in events:
            self.event(text, interval[0], interval[-1])
        inputs = [(text, interval[0], interval[-1]) for text, *interval in events]
        return [event for event in self.events if event not in inputs]

    def values_of_x(self, goal: str) -> List[Any]:
        return [self.show(answer["X"]) for answer in self.query(goal)]


def load_engine(rules: Any = DOCKED + ALARM, clock: Any = None) -> StateEngine:
    engine = StateEngine(clock)
    engine.load(rules=rules)
    return engine


# ---- intervals of states -----------------------------------------------------------------------------


def test_ended_state_is_event() -> None:
    engine = load_engine(DOCKED + "hit(R) <- bump(R) during docked(R).")
    assert engine.feed(("dock(a)", 1, 2), ("bump(a)", 3), ("bump(b)", 3), ("undock(a)", 5, 6)) == [
        ("docked(a)", 2, 5),
        ("hit(a)", 2, 5),
    ]


def test_open_state_holds_immediately() -> None:
    engine = load_engine()
    assert engine.feed(("bump(a)", 1), ("dock(a)", 2), ("bump(b)", 3), ("bump(a)", 3)) == [("alarm(a)", 3, 3)]
    assert engine.feed(("undock(a)", 4), ("bump(a)", 5)) == [("docked(a)", 2, 4)]


@pytest.mark.parametrize(
    ("events", "expected"),
    [
        ([("undock(a)", 1)], []),
        ([("dock(a)", 1), ("dock(a)", 2), ("undock(a)", 3), ("undock(a)", 4)], [("docked(a)", 1, 3)]),
        ([("dock(a)", 3), ("undock(a)", 2), ("undock(a)", 4)], [("docked(a)", 3, 4)]),
        ([("dock(a)", 1, 3), ("undock(a)", 2, 4), ("undock(a)", 3, 3)], [("docked(a)", 3, 3)]),
        ([("dock(a)", 1), ("dock(b)", 2), ("undock(a)", 3)], [("docked(a)", 1, 3)]),
    ],
)
def test_events_begin_and_end_state(
    events: List[Tuple[Any, ...]], expected: List[Tuple[str, int, int]]
) -> None:
    assert load_engine().feed(*events) == expected


def test_event_ends_states_and_begins_next() -> None:
    engine = load_engine(
        ":- state(at(P), from(arrive(P)), until(arrive(_))).\n:- state(up(X, Y), from(up(X, Y, _)), until(down(X)))."
    )
    assert engine.feed(("arrive(hall)", 1), ("arrive(attic)", 4), ("arrive(attic)", 6)) == [
        ("at(hall)", 1, 4),
        ("at(attic)", 4, 6),
    ]
    engine.feed(("up(a, 1, 0)", 1), ("up(b, 1, 0)", 1), ("up(a, 2, 0)", 2), ("up(a, 1, 7)", 3))
    assert engine.feed(("down(a)", 5)) == [("up(a,1)", 1, 5), ("up(a,2)", 2, 5)]
    assert engine.values_of_x("holds(X)") == ["at(attic)", "up(b,1)"]


def test_state_ends_after_its_time_limit() -> None:
    clock = StreamClock()
    engine = load_engine(
        ":- state(docked(R), from(dock(R)), until(undock(R)), [within(5)]).\n" + ALARM, clock
    )
    engine.feed(("dock(a)", 1), ("dock(b)", 2), ("dock(a)", 3))
    engine.events.clear()
    clock.move_to(20 * SECOND)
    engine.advance()
    assert engine.events == [("docked(a)", 1, 6), ("docked(b)", 2, 7)]
    assert engine.feed(("bump(a)", 20), ("dock(a)", 21), ("undock(a)", 22), ("e", 40)) == [
        ("docked(a)", 21, 22)
    ]


# ---- queries -----------------------------------------------------------------------------------------


def test_states_are_queried_at_present_and_past() -> None:
    engine = load_engine(":- state(docked(R), from(dock(R)), until(undock(R)), [past(2)]).")
    engine.feed(
        *(
            (f"{event}({robot})", instant)
            for instant, (event, robot) in enumerate(
                [
                    ("dock", "a"),
                    ("undock", "a"),
                    ("dock", "a"),
                    ("dock", "b"),
                    ("undock", "a"),
                    ("dock", "c"),
                    ("undock", "c"),
                ]
            )
        )
    )
    assert engine.values_of_x("holds(docked(X))") == ["b"]
    assert engine.values_of_x("holds(docked(b), X)") == ["3"]
    assert engine.query("holds(docked(a))") == []
    assert engine.query("holds(docked(a), _)") == []
    assert [
        engine.query(f"holds_at(docked(a), {instant})") != [] for instant in (0.5, 1.5, 2, 3, 4, 4.5)
    ] == [
        False,
        False,
        True,
        True,
        True,
        False,
    ], "the first interval is forgotten"
    assert sorted(engine.values_of_x("holds_at(docked(X), 5.5)")) == ["b", "c"]
    assert engine.values_of_x("holds_at(X, 100)") == ["docked(b)"]


@pytest.mark.parametrize(
    "goal", ["holds(dokced(a))", "holds(dokced)", "holds(3)", "holds_at(docked(a), noon)"]
)
def test_query_of_unknown_state_is_refused(goal: str) -> None:
    with pytest.raises(PrologError):
        load_engine().call(goal)


# ---- declarations ------------------------------------------------------------------------------------


def test_goal_declares_state_once() -> None:
    engine = load_engine()
    engine.feed(("dock(a)", 1))
    assert engine.call("state(docked(X), from(dock(X)), until(undock(X)))")
    assert engine.values_of_x("holds(docked(X))") == ["a"]
    with pytest.raises(PrologError, match="declared otherwise"):
        engine.call("state(docked(X), from(dock(X)), until(out))")
    assert engine.call("delete_state(docked(_))")
    assert not engine.call("delete_state(docked(_))")
    assert engine.feed(("undock(a)", 2)) == []
    assert engine.call("state(docked(X), from(dock(X)), until(out))")
    assert engine.feed(("dock(a)", 3), ("undock(a)", 4), ("out", 5)) == [("docked(a)", 3, 5)]


def test_invalid_declaration_is_error_of_file() -> None:
    with pytest.raises(ProgramErrors, match="each variable of the state"):
        load_engine(":- state(s(X), from(a), until(b(X))).")


@pytest.mark.parametrize("invalid_term", ["docked(R, 1)", "dock(R, 1)", "undock(1)"])
def test_events_of_state_match_declarations(invalid_term: str) -> None:
    declarations = ":- event docked(r:atom).\n:- event dock(r:atom).\n:- event undock(r:atom).\n"
    valid_goal = "state(docked(R), from(dock(R)), until(undock(R)))"
    invalid_goal = valid_goal.replace(
        "undock(R)" if "undock" in invalid_term else invalid_term.replace(", 1", ""), invalid_term, 1
    )
    engine = load_engine(f"{declarations}:- {valid_goal}.")
    with pytest.raises(ProgramErrors, match="dock"):
        load_engine(f"{declarations}:- {invalid_goal}.")
    engine.call("delete_state(docked(_))")
    with pytest.raises(PrologError, match="declared"):
        engine.call(invalid_goal)


def test_program_may_have_facts_named_state() -> None:
    engine = load_engine(
        "state(robot, idle, 3).\nholds(hand, cup).\nout(X) <- e where (state(X, _, 3), holds(hand, _))."
    )
    assert engine.feed(("e", 1)) == [("out(robot)", 1, 1)]
    with pytest.raises(ProgramErrors, match="write :- before a goal"):
        load_engine("state(s, from(a), until(b)).")


# ---- bounds ------------------------------------------------------------------------------------------


def test_oldest_open_states_are_dropped(caplog: pytest.LogCaptureFixture) -> None:
    engine = load_engine(":- state(docked(R), from(dock(R)), until(undock(R)), [open(3)]).")
    engine.feed(*((f"dock({number})", number) for number in range(10)))
    assert engine.values_of_x("holds(docked(X))") == ["7", "8", "9"]
    assert engine.feed(("undock(2)", 11), ("undock(8)", 11)) == [("docked(8)", 8, 11)]
    assert len(caplog.records) == 3
    assert "7 of the oldest" not in caplog.text
    assert "4 of the oldest" in caplog.text


def test_events_with_variables_begin_no_state(caplog: pytest.LogCaptureFixture) -> None:
    engine = load_engine()
    derived = engine.feed(("dock(_)", 1), ("dock(a)", 2), ("undock(_)", 3))
    assert not any(event.startswith("docked") for event, _, _ in derived)
    assert engine.values_of_x("holds(docked(X))") == ["a"]
    assert "state docked(_): dock(_" in caplog.text
    assert "has variables: it begins no state" in caplog.text


# ---- clock that goes back, restored engines ------------------------------------------------------


def test_clock_moved_back_clears_states() -> None:
    clock = StreamClock()
    engine = load_engine(":- state(docked(R), from(dock(R)), until(undock(R)), [within(50)]).", clock)
    clock.move_to(10 * SECOND)
    engine.feed(("dock(a)", 9), ("dock(b)", 9.5), ("undock(b)", 10))
    clock.move_to(SECOND, back=True)
    engine.advance()
    assert engine.values_of_x("holds(X)") == [] == engine.values_of_x("holds_at(X, 9.7)")
    assert engine.feed(("dock(a)", 1)) == []
    clock.move_to(60 * SECOND)
    engine.events.clear()
    engine.advance()
    assert engine.events == [("docked(a)", 1, 51)]


@pytest.mark.parametrize("revision", [False, True])
def test_states_are_restored(revision: bool) -> None:
    rules = ":- state(docked(R), from(dock(R, _)), until(undock(R)), [within(50)]).\n" + ALARM
    engine = load_engine((":- set_etalis_flag(revision_flag, on).\n" if revision else "") + rules)
    engine.feed(("dock(a, 0.5)", 1), ("dock('B', x)", 2), ("undock(a)", 3), ("dock(f(1.5), c)", 4))
    other = StateEngine.restore(engine.snapshot())
    assert (
        other.values_of_x("holds(X)") == ["docked('B')", "docked(f(1.5))"] == engine.values_of_x("holds(X)")
    )
    events = [("bump(f(1.5))", 5), ("undock('B')", 6), ("rev(dock('B', x))", 7), ("e", 100)]
    assert engine.feed(*events) == other.feed(*events) != []
    assert engine.values_of_x("holds_at(X, 2)") == other.values_of_x("holds_at(X, 2)")


# ---- revision ----------------------------------------------------------------------------------------

REVISION = ":- set_etalis_flag(revision_flag, on).\n" + DOCKED + ALARM


def test_retraction_of_begin_or_end_retracts_state() -> None:
    for retracted in ("dock(a)", "undock(a)"):
        engine = load_engine(REVISION + "was(R) <- docked(R).")
        engine.feed(("dock(a)", 1), ("undock(a)", 3))
        assert [event for event, _, _ in engine.feed((f"rev({retracted})", 4))] == [
            "rev(docked(a))",
            "rev(was(a))",
        ]
        assert engine.values_of_x("holds_at(X, 2)") == [] == engine.values_of_x("holds(X)")


def test_retracted_begin_leaves_no_state() -> None:
    engine = load_engine(REVISION)
    engine.feed(("dock(a)", 1), ("rev(dock(a))", 2))
    assert engine.feed(("bump(a)", 3), ("undock(a)", 4)) == []
    engine.feed(("dock(a)", 5), ("dock(a, again)", 5))
    assert engine.feed(("bump(a)", 6), ("undock(a)", 7)) == [("alarm(a)", 6, 6), ("docked(a)", 5, 7)]


@pytest.mark.parametrize("is_restored", [False, True])
def test_retracted_states_do_not_count_as_open(is_restored: bool, caplog: pytest.LogCaptureFixture) -> None:
    rules = REVISION.replace("undock(R)))", "undock(R)), [open(2)])", 1)
    engine = load_engine(rules)
    engine.feed(("dock(a)", 1), ("dock(b)", 2), ("rev(dock(b))", 3))
    if is_restored:
        engine = StateEngine.restore(engine.snapshot())
    engine.feed(("dock(c)", 4))
    assert engine.values_of_x("holds(docked(X))") == ["a", "c"]
    assert caplog.text == ""
    engine.feed(("rev(dock(a))", 5), ("dock(d)", 6), ("dock(e)", 7))
    assert engine.values_of_x("holds(docked(X))") == ["d", "e"]
    assert "more than 2 are open; 1 of the oldest" in caplog.text
    assert engine.feed(("undock(c)", 8), ("undock(d)", 8)) == [("docked(d)", 6, 8)]


def test_state_begins_at_next_event_after_retraction() -> None:
    engine = load_engine(REVISION.replace("dock(R)", "dock(R, _)", 1))
    engine.feed(("dock(a, 1)", 1), ("dock(a, 2)", 2), ("rev(dock(a, 1))", 3))
    assert engine.feed(("bump(a)", 4), ("undock(a)", 5)) == [("alarm(a)", 4, 4), ("docked(a)", 2, 5)]


def test_explanation_names_begin_and_end_of_state() -> None:
    engine = load_engine()
    record_origins(engine)
    engine.feed(("dock(a)", 1), ("undock(a)", 3))
    lines = [line for entry in explain(engine, "docked(a)").lines for line in entry.indented()]
    assert lines == [
        "docked(a) [1,3] has ended; it began and ended with",
        "  dock(a) at 1 came from outside",
        "  undock(a) at 3 came from outside",
    ]


# ---- comparison with a definition over all events ------------------------------------------------------


class ExpectedStates:
    """The states and alarms of a list of events ``(name, key, start, end)`` in order of arrival."""

    def __init__(self, events: Any, within: Any) -> None:
        self.events = events
        self.within = within

    def end_of_state(self, first: Any) -> Tuple[Any, ...]:
        """Return position of the event that ends a state, instant, and whether the time limit ends it."""
        _, key, _, begin = self.events[first]
        for position in range(first + 1, len(self.events)):
            name, other, start, _ = self.events[position]
            if self.within is not None and self.time_at(position) >= begin + self.within:
                return position, begin + self.within, True
            if name == "undock" and other == key and start >= begin:
                return position, start, False
        return len(self.events), None, False

    def time_at(self, position: Any) -> Any:
        return max(end for _, _, _, end in self.events[: position + 1])

    def openings(self) -> Any:
        """Return the positions of the events that begin a state: no state of their key is open."""
        positions: List[Any] = []
        for first, (name, key, _, _) in enumerate(self.events):
            if name == "dock" and not any(
                self.events[opening][1] == key and (self.end_of_state(opening)[0] > first)
                for opening in positions
            ):
                positions.append(first)
        return positions

    def expected_outputs(self) -> Any:
        openings = self.openings()
        outputs: List[Any] = []
        for position, (name, key, start, end) in enumerate(self.events):
            ended = [
                (first, *self.end_of_state(first)[1:])
                for first in openings
                if self.end_of_state(first)[0] == position
            ]
            by_itself = sorted((until, first) for first, until, by_time_limit in ended if by_time_limit)
            outputs += [
                (f"docked({self.events[first][1]})", self.events[first][3], until)
                for until, first in by_itself
            ]
            outputs.append((f"{name}({key})", start, end))
            outputs += [
                (f"docked({key})", self.events[first][3], until)
                for first, until, by_time_limit in ended
                if not by_time_limit
            ]
            if name == "bump" and any(
                first < position < self.end_of_state(first)[0] and self.events[first][1] == key
                for first in openings
            ):
                outputs.append((f"alarm({key})", start, end))
        return outputs

    def held_at(self, key: Any, instant: Any) -> bool:
        intervals = [
            (self.events[first][3], self.end_of_state(first)[1])
            for first in self.openings()
            if self.events[first][1] == key
        ]
        # An open state is known to end by itself, also beyond the present time.
        return any(
            begin <= instant <= (self.last_end(begin) if end is None else end) for begin, end in intervals
        )

    def last_end(self, begin: Any) -> Any:
        return math.inf if self.within is None else begin + self.within


@st.composite
def streams(draw: Any) -> Any:
    events, now = [], 1
    for _ in range(draw(st.integers(1, 25))):
        now += draw(st.integers(0, 3))
        end = max(1, now - draw(st.sampled_from([0, 0, 0, 2, 6])))
        start = max(1, end - draw(st.integers(0, 2)))
        events.append(
            (draw(st.sampled_from(["dock", "undock", "bump"])), draw(st.sampled_from("abc")), start, end)
        )
    return events


def compare(events: Any, within: Any) -> None:
    options = "" if within is None else f", [within({within})]"
    engine = load_engine(f":- state(docked(R), from(dock(R)), until(undock(R)){options}).\n" + ALARM)
    for name, key, start, end in events:
        engine.event(f"{name}({key})", start, end)
    expected = ExpectedStates(events, within)
    assert engine.events == expected.expected_outputs()
    for instant in range(1, 30, 5):
        keys = engine.values_of_x(f"holds_at(docked(X), {instant})")
        assert sorted(keys) == [key for key in "abc" if expected.held_at(key, instant)]


@settings(max_examples=10, deadline=None)
@given(streams(), st.sampled_from([None, 1, 4]))
@example([("dock", "a", 1, 1)], 1)
def test_states_equal_definition(events: Any, within: Any) -> None:
    compare(events, within)


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(streams(), st.sampled_from([None, 1, 4]))
def test_states_equal_definition_on_many_streams(events: Any, within: Any) -> None:
    compare(events, within)


def test_valid_program_has_no_warnings(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        load_engine()
    assert caplog.records == []


@pytest.mark.parametrize(
    ("goal", "keeps_past"),
    [("reset_db", True), ("call_gc", True), ("reset_etalis_state", False), ("reset_etalis", False)],
)
def test_reset_clears_states(goal: str, keeps_past: bool) -> None:
    engine = Engine()
    engine.load(rules=":- state(on(X), from(a(X)), until(b(X)), [within(5)]).")
    events: List[Any] = []
    engine.on_event(lambda term, start, end: events.append(engine.show(term)))
    for text, second in (("a(1)", 1), ("b(1)", 2), ("a(2)", 3)):
        engine.event(text, second)
    assert engine.call("holds(on(2)), holds_at(on(1), datime(1970,1,1,0,0,2,0))")
    assert engine.call(goal)
    assert not engine.call("holds(_)")
    assert engine.call("holds_at(on(1), datime(1970,1,1,0,0,2,0))") is keeps_past
    for text, second in (("b(2)", 4), ("a(3)", 5), ("tick", 20)):
        engine.event(text, second)
    assert events == ["a(1)", "b(1)", "on(1)", "a(2)", "b(2)", "a(3)", "on(3)", "tick"]


def test_deleted_or_detached_state_is_unknown() -> None:
    for declared_again in (False, True):
        engine = load_engine(DOCKED)
        states = engine.knowledge.states
        engine.feed(("dock(1)", 1))
        states_by_key = states.all_by_key()
        if declared_again:
            states.detach(list(states_by_key))
        else:
            assert engine.call("delete_state(docked(_))")
            assert not engine.call("delete_state(docked(_))")
        with pytest.raises(PrologError, match="docked/1"):
            engine.query("holds(docked(X))")
        states.restore_all(states_by_key)
        assert engine.values_of_x("holds(docked(X))") == (["1"] if declared_again else [])
