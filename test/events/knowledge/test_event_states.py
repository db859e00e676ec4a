"""States that hold from one event until another."""

import logging
import math

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from retalis import Engine, ProgramErrors, PrologError, StreamClock, explain, record_origins
from retalis.prolog.terms.timestamps import SECOND

DOCKED = ":- state(docked(R), from(dock(R)), until(undock(R))).\n"
ALARM = "alarm(R) <- bump(R) where holds(docked(R)).\n"


class StateEngine(Engine):
    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.events = []
        self.on_event(
            lambda term, start, end: self.events.append((self.show(term), start / SECOND, end / SECOND))
        )

    def feed(self, *events):
        """Process events ``(text, end)`` or ``(text, start, end)``; return the derived events."""
        self.events.clear()
        for text, *interval in events:
            self.event(text, interval[0], interval[-1])
        inputs = [(text, interval[0], interval[-1]) for text, *interval in events]
        return [event for event in self.events if event not in inputs]

    def values_of_x(self, goal):
        return [self.show(answer["X"]) for answer in self.query(goal)]


def load_engine(rules=DOCKED + ALARM, clock=None):
    engine = StateEngine(clock)
    engine.load(rules=rules)
    return engine


# ---- intervals of states -----------------------------------------------------------------------------


def test_ended_state_is_event():
    engine = load_engine(DOCKED + "hit(R) <- bump(R) during docked(R).")
    assert engine.feed(("dock(a)", 1, 2), ("bump(a)", 3), ("bump(b)", 3), ("undock(a)", 5, 6)) == [
        ("docked(a)", 2, 5),
        ("hit(a)", 2, 5),
    ]


def test_open_state_holds_immediately():
    engine = load_engine()
    assert engine.feed(("bump(a)", 1), ("dock(a)", 2), ("bump(b)", 3), ("bump(a)", 3)) == [("alarm(a)", 3, 3)]
    assert engine.feed(("undock(a)", 4), ("bump(a)", 5)) == [("docked(a)", 2, 4)]


@pytest.mark.parametrize(
    "events, expected",
    [
        ([("undock(a)", 1)], []),
        ([("dock(a)", 1), ("dock(a)", 2), ("undock(a)", 3), ("undock(a)", 4)], [("docked(a)", 1, 3)]),
        ([("dock(a)", 3), ("undock(a)", 2), ("undock(a)", 4)], [("docked(a)", 3, 4)]),
        ([("dock(a)", 1, 3), ("undock(a)", 2, 4), ("undock(a)", 3, 3)], [("docked(a)", 3, 3)]),
        ([("dock(a)", 1), ("dock(b)", 2), ("undock(a)", 3)], [("docked(a)", 1, 3)]),
    ],
)
def test_events_begin_and_end_state(events, expected):
    assert load_engine().feed(*events) == expected


def test_event_ends_states_and_begins_next():
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


def test_state_ends_after_its_time_limit():
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


def test_states_are_queried_at_present_and_past():
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
    assert engine.query("holds(docked(a))") == [] and engine.query("holds(docked(a), _)") == []
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
def test_query_of_unknown_state_is_refused(goal):
    with pytest.raises(PrologError):
        load_engine().call(goal)


# ---- declarations ------------------------------------------------------------------------------------


def test_goal_declares_state_once():
    engine = load_engine()
    engine.feed(("dock(a)", 1))
    assert engine.call("state(docked(X), from(dock(X)), until(undock(X)))")
    assert engine.values_of_x("holds(docked(X))") == ["a"]
    with pytest.raises(PrologError, match="declared otherwise"):
        engine.call("state(docked(X), from(dock(X)), until(out))")
    assert engine.call("delete_state(docked(_))") and not engine.call("delete_state(docked(_))")
    assert engine.feed(("undock(a)", 2)) == []
    assert engine.call("state(docked(X), from(dock(X)), until(out))")
    assert engine.feed(("dock(a)", 3), ("undock(a)", 4), ("out", 5)) == [("docked(a)", 3, 5)]


def test_invalid_declaration_is_error_of_file():
    with pytest.raises(ProgramErrors, match="each variable of the state"):
        load_engine(":- state(s(X), from(a), until(b(X))).")


@pytest.mark.parametrize("invalid_term", ["docked(R, 1)", "dock(R, 1)", "undock(1)"])
def test_events_of_state_are_checked_against_declarations(invalid_term):
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


def test_program_may_have_facts_named_state():
    engine = load_engine(
        "state(robot, idle, 3).\nholds(hand, cup).\nout(X) <- e where (state(X, _, 3), holds(hand, _))."
    )
    assert engine.feed(("e", 1)) == [("out(robot)", 1, 1)]
    with pytest.raises(ProgramErrors, match="write :- before a goal"):
        load_engine("state(s, from(a), until(b)).")


# ---- bounds ------------------------------------------------------------------------------------------


def test_oldest_open_states_are_dropped(caplog):
    engine = load_engine(":- state(docked(R), from(dock(R)), until(undock(R)), [open(3)]).")
    engine.feed(*((f"dock({number})", number) for number in range(10)))
    assert engine.values_of_x("holds(docked(X))") == ["7", "8", "9"]
    assert engine.feed(("undock(2)", 11), ("undock(8)", 11)) == [("docked(8)", 8, 11)]
    assert (
        len(caplog.records) == 3 and "7 of the oldest" not in caplog.text and "4 of the oldest" in caplog.text
    )


def test_events_with_variables_begin_no_state(caplog):
    engine = load_engine()
    derived = engine.feed(("dock(_)", 1), ("dock(a)", 2), ("undock(_)", 3))
    assert not any(event.startswith("docked") for event, _, _ in derived)
    assert engine.values_of_x("holds(docked(X))") == ["a"]
    assert "state docked(_): dock(_" in caplog.text and "has variables: it begins no state" in caplog.text


# ---- clock that goes back, restored engines, interrupts ------------------------------------------


def test_clock_that_goes_back_clears_states():
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
def test_states_are_restored(revision):
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


def test_repair_rebuilds_index_of_open_states():
    engine = load_engine()
    engine.feed(("dock(a)", 1))
    (state,) = engine.knowledge.states
    state._open_by_shared_key.clear()  # noqa: SLF001  (as if an interrupt had occurred between two steps)
    engine.knowledge.repair()
    assert engine.feed(("undock(a)", 2)) == [("docked(a)", 1, 2)]


# ---- revision ----------------------------------------------------------------------------------------

REVISION = ":- set_etalis_flag(revision_flag, on).\n" + DOCKED + ALARM


def test_retraction_of_begin_or_end_retracts_state():
    for retracted in ("dock(a)", "undock(a)"):
        engine = load_engine(REVISION + "was(R) <- docked(R).")
        engine.feed(("dock(a)", 1), ("undock(a)", 3))
        assert [event for event, _, _ in engine.feed((f"rev({retracted})", 4))] == [
            "rev(docked(a))",
            "rev(was(a))",
        ]
        assert engine.values_of_x("holds_at(X, 2)") == [] == engine.values_of_x("holds(X)")


def test_retracted_begin_leaves_no_state():
    engine = load_engine(REVISION)
    engine.feed(("dock(a)", 1), ("rev(dock(a))", 2))
    assert engine.feed(("bump(a)", 3), ("undock(a)", 4)) == []
    engine.feed(("dock(a)", 5), ("dock(a, again)", 5))
    assert engine.feed(("bump(a)", 6), ("undock(a)", 7)) == [("alarm(a)", 6, 6), ("docked(a)", 5, 7)]


@pytest.mark.parametrize("is_restored", [False, True])
def test_retracted_states_do_not_count_as_open(is_restored, caplog):
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


def test_the_next_that_might_have_begun_it_does_so_in_place_of_one_that_was_taken_back():
    engine = load_engine(REVISION.replace("dock(R)", "dock(R, _)", 1))
    engine.feed(("dock(a, 1)", 1), ("dock(a, 2)", 2), ("rev(dock(a, 1))", 3))
    assert engine.feed(("bump(a)", 4), ("undock(a)", 5)) == [("alarm(a)", 4, 4), ("docked(a)", 2, 5)]


def test_an_explanation_says_what_it_held_from_and_until():
    engine = load_engine()
    record_origins(engine)
    engine.feed(("dock(a)", 1), ("undock(a)", 3))
    lines = [line for one in explain(engine, "docked(a)").lines for line in one.indented()]
    assert lines == [
        "docked(a) [1,3] is over: it held from",
        "  dock(a) at 1 came from outside",
        "  undock(a) at 3 came from outside",
    ]


# ---- beside a definition that looks through all events again and again --------------------------------


class Definition:
    """What a list of events means, each ``(kind, key, start, end)``, in the order in which they came."""

    def __init__(self, events, within):
        self.events = events
        self.within = within

    def over(self, at):
        """Return when an opening is over: the place of the event before or at which that is seen, and its end."""
        _, key, _, begin = self.events[at]
        for place in range(at + 1, len(self.events)):
            kind, other, start, _ = self.events[place]
            if self.within is not None and self.reached(place) >= begin + self.within:
                return place, begin + self.within, True
            if kind == "undock" and other == key and start >= begin:
                return place, start, False
        return len(self.events), None, False

    def reached(self, place):
        return max(end for _, _, _, end in self.events[: place + 1])

    def openings(self):
        """Return the events that begin a state: those while none of their key is open."""
        found = []
        for at, (kind, key, _, _) in enumerate(self.events):
            if kind == "dock" and not any(
                self.events[one][1] == key and (self.over(one)[0] > at) for one in found
            ):
                found.append(at)
        return found

    def happens(self):
        openings = self.openings()
        found = []
        for place, (kind, key, start, end) in enumerate(self.events):
            over = [(at, *self.over(at)[1:]) for at in openings if self.over(at)[0] == place]
            by_itself = sorted((until, at) for at, until, alone in over if alone)
            found += [(f"docked({self.events[at][1]})", self.events[at][3], until) for until, at in by_itself]
            found.append((f"{kind}({key})", start, end))
            found += [(f"docked({key})", self.events[at][3], until) for at, until, alone in over if not alone]
            if kind == "bump" and any(
                at < place < self.over(at)[0] and self.events[at][1] == key for at in openings
            ):
                found.append((f"alarm({key})", start, end))
        return found

    def held_at(self, key, instant):
        intervals = [
            (self.events[at][3], self.over(at)[1]) for at in self.openings() if self.events[at][1] == key
        ]
        # An open state is known to end by itself, also beyond the present time.
        return any(
            begin <= instant <= (self.last_end(begin) if end is None else end) for begin, end in intervals
        )

    def last_end(self, begin):
        return math.inf if self.within is None else begin + self.within


@st.composite
def streams(draw):
    events, now = [], 1
    for _ in range(draw(st.integers(1, 25))):
        now += draw(st.integers(0, 3))
        end = max(1, now - draw(st.sampled_from([0, 0, 0, 2, 6])))
        start = max(1, end - draw(st.integers(0, 2)))
        events.append(
            (draw(st.sampled_from(["dock", "undock", "bump"])), draw(st.sampled_from("abc")), start, end)
        )
    return events


def compare(events, within):
    options = "" if within is None else f", [within({within})]"
    engine = load_engine(f":- state(docked(R), from(dock(R)), until(undock(R)){options}).\n" + ALARM)
    for kind, key, start, end in events:
        engine.event(f"{kind}({key})", start, end)
    expected = Definition(events, within)
    assert engine.events == expected.happens()
    for instant in range(1, 30, 5):
        held = engine.values_of_x(f"holds_at(docked(X), {instant})")
        assert sorted(held) == [key for key in "abc" if expected.held_at(key, instant)]


@settings(max_examples=10, deadline=None)
@given(streams(), st.sampled_from([None, 1, 4]))
@example([("dock", "a", 1, 1)], 1)
def test_states_are_what_the_definition_says(events, within):
    compare(events, within)


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(streams(), st.sampled_from([None, 1, 4]))
def test_many_states_are_what_the_definition_says(events, within):
    compare(events, within)


def test_nothing_is_said_of_a_program_that_is_right(caplog):
    with caplog.at_level(logging.WARNING):
        load_engine()
    assert caplog.records == []


@pytest.mark.parametrize(
    ("goal", "known"),
    [("reset_db", True), ("call_gc", True), ("reset_etalis_state", False), ("reset_etalis", False)],
)
def test_a_program_that_resets_has_nothing_hold(goal, known):
    engine = Engine()
    engine.load(rules=":- state(on(X), from(a(X)), until(b(X)), [within(5)]).")
    seen = []
    engine.on_event(lambda term, start, end: seen.append(engine.show(term)))
    for text, at in (("a(1)", 1), ("b(1)", 2), ("a(2)", 3)):
        engine.event(text, at)
    assert engine.call("holds(on(2)), holds_at(on(1), datime(1970,1,1,0,0,2,0))")
    assert engine.call(goal)
    assert not engine.call("holds(_)")
    assert engine.call("holds_at(on(1), datime(1970,1,1,0,0,2,0))") is known
    for text, at in (("b(2)", 4), ("a(3)", 5), ("tick", 20)):
        engine.event(text, at)
    assert seen == ["a(1)", "b(1)", "on(1)", "a(2)", "b(2)", "a(3)", "on(3)", "tick"]


def test_a_state_whose_deletion_is_interrupted_is_deleted():
    engine = load_engine()
    dispatcher = engine.dispatcher
    on_change = dispatcher.on_change

    def interrupt():
        dispatcher.on_change = on_change
        raise KeyboardInterrupt

    engine.feed(("dock(1)", 1))
    dispatcher.on_change = interrupt
    with pytest.raises(KeyboardInterrupt):
        engine.call("delete_state(docked(_))")
    with pytest.raises(PrologError, match="docked/1"):
        engine.query("holds(docked(X))")
    assert engine.call("state(docked(R), from(dock(R)), until(undock(R)))")
    engine.feed(("dock(2)", 2))
    assert engine.values_of_x("holds(docked(X))") == ["2"]


def test_a_state_that_is_deleted_or_set_aside_is_not_known():
    for declared_again in (False, True):
        engine = load_engine(DOCKED)
        states = engine.knowledge.states
        engine.feed(("dock(1)", 1))
        standing = states.all_by_key()
        if declared_again:
            states.detach(list(standing))
        else:
            assert engine.call("delete_state(docked(_))") and not engine.call("delete_state(docked(_))")
        with pytest.raises(PrologError, match="docked/1"):
            engine.query("holds(docked(X))")
        states.restore_all(standing)
        assert engine.values_of_x("holds(docked(X))") == (["1"] if declared_again else [])
