"""Timers: events at instants that the clock reaches."""

import logging

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from retalis import Engine, ProgramErrors, PrologError, RetalisError, StreamClock
from retalis.events.rules import timer_service
from retalis.prolog.terms.timestamps import SECOND


class Rung(Engine):
    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.seen = []
        self.on_event(self._note)

    def _note(self, term, start, end):
        assert start == end or self.show(term) not in ("tick", "a", "b")
        self.seen.append((self.show(term), end / SECOND))

    def at(self, *instants):
        """Have an event at each instant; return what happened."""
        self.seen.clear()
        for instant in instants:
            self.event("e", instant)
        return list(self.seen)

    def timers(self):
        (found,) = self.query("timers(L)")
        return self.show(found["L"])


def run(goals="", rules="", clock=None):
    engine = Rung(clock)
    engine.load(rules=rules, goals=goals)
    return engine


@pytest.mark.parametrize(
    "when, rings",
    [
        ("every(2)", [2, 4, 6]),
        ("every(2, from_now)", [3, 5]),
        ("after(2.5)", [3.5]),
        ("at(4)", [4]),
        ("at(datime(1970,1,1,0,0,4,0))", [4]),
        ("at(0, 0, 3)", [3]),
        ("at(0, 0, 1)", []),
    ],
)
def test_a_timer_rings_at_its_instants_counted_from_the_first_that_there_is(when, rings):
    engine = run(f"timer(tick, {when})")
    assert ", waits)" in engine.timers().replace(",waits", ", waits")
    assert engine.at(1, 6.5) == [("e", 1), *(("tick", at) for at in rings), ("e", 6.5)]


def test_a_timer_rings_before_an_event_of_the_same_instant():
    engine = run("timer(tick, every(5))", "exceptionAlarm(late, 5) <- a.\nboth <- tick equals e.")
    engine.at(1)
    engine.event("a", 5)
    assert engine.seen[1:] == [("tick", 5), ("a", 5)]
    assert engine.at(10) == [("tick", 10), ("late", 10), ("e", 10), ("both", 10)]


def test_patterns_take_the_events_of_timers():
    engine = run("timer(tick, every(10))", "quiet <- (tick seq tick) cnot e.")
    assert engine.at(1, 29) == [
        ("e", 1),
        ("tick", 10),
        ("tick", 20),
        ("quiet", 20),
        ("e", 29),
    ]


def test_rules_and_directives_set_timers_and_rules_take_them_away():
    rules = """
    :- timer(tick, every(4)).
    null do timer(gone(X), after(3)) <- seen(X).
    null do cancel_timer(tick, N), event(cancelled(N)) <- gone(b).
    """
    engine = run(rules=rules)
    engine.event("seen(a)", 1)
    engine.event("seen(b)", 2)
    engine.event("seen(a)", 3)
    rung = [one for one in engine.at(20) if not one[0].startswith(("null", "seen"))]
    assert rung == [("tick", 4), ("gone(b)", 5), ("cancelled(1)", rung[2][1]), ("gone(a)", 6), ("e", 20)]


def test_cancelling_takes_all_whose_events_unify():
    engine = run("timer(a(1), every(2))\ntimer(a(2), every(2))\ntimer(a(2), every(3))\ntimer(b, every(5))")
    assert engine.query("cancel_timer(a(2), N)") == [{"N": 2}]
    assert engine.call("cancel_timer(nothing)")
    assert engine.query("cancel_timer(a(_), N)") == [{"N": 1}]
    assert engine.timers() == "[timer(b,every(5),waits)]"
    assert engine.at(1, 9) == [("e", 1), ("b", 5), ("e", 9)]
    assert engine.timers() == "[timer(b,every(5),datime(1970,1,1,0,0,10,0))]"
    engine.call("reset_etalis")
    assert engine.timers() == "[]" and engine.at(30) == [("e", 30)]


def test_cancelling_looks_at_those_alone_that_may_unify(monkeypatch):
    looked = []
    unifies = timer_service.may_unify
    monkeypatch.setattr(timer_service, "may_unify", lambda one, two: looked.append(one) or unifies(one, two))
    engine = run("\n".join(f"timer(a({number}, b), after(9))" for number in range(50)))
    engine.load(goals="timer(a(_, c), after(9))\ntimer(a(_, b), after(9))")
    assert engine.query("cancel_timer(a(7, b), N)") == [{"N": 2}]
    assert len(looked) == 2, "those with variables"
    assert engine.query("cancel_timer(a(7, b), N)") == [{"N": 0}]
    assert engine.query("cancel_timer(a(8, X), N)")[0]["N"] == 2
    assert engine.query("cancel_timer(_, N)")[0]["N"] == 48


@pytest.mark.parametrize(
    "goal", ["timer(3, every(1))", "timer(a, evry(1))", "timer(_, every(1))", "timer(a, _)"]
)
def test_what_is_no_timer_is_an_error(goal):
    with pytest.raises(PrologError):
        run().call(goal)
    with pytest.raises(ProgramErrors):
        run(goal)


@settings(max_examples=15, deadline=None)
@given(
    st.lists(st.integers(1, 40), min_size=1, max_size=10),
    st.sampled_from(["every(3)", "every(7, from_now)", "after(4)", "at(0, 0, 20)"]),
)
def test_the_instants_do_not_depend_on_the_steps_of_time(steps, when):
    instants = [sum(steps[: at + 1]) for at in range(len(steps))]
    first, last = instants[0], instants[-1]
    wanted = {
        "every(3)": [at for at in range(first + 1, last + 1) if at % 3 == 0],
        "every(7, from_now)": list(range(first + 7, last + 1, 7)),
        "after(4)": [first + 4] if first + 4 <= last else [],
        "at(0, 0, 20)": [20] if first < 20 <= last else [],
    }
    seen = run(f"timer(tick, {when})").at(*instants)
    assert [at for event, at in seen if event == "tick"] == wanted[when]
    assert [at for _, at in seen] == sorted(at for _, at in seen), "each in its place"


@pytest.mark.parametrize(
    ("rings", "at"),
    [
        ("exceptionAlarm(rung, 5) <- a.", 6),
        ("rung <- aggregate(count, a, _, every(10)).", 10),
        ("rung <- a with debounce(7).", 8),
        (":- timer(rung, after(6)).", 7),
        (":- state(rung, from(a), until(b), [within(9)]).", 10),
    ],
)
def test_what_the_clock_rings_counts_from_that_instant_however_far_time_jumps(rings, at):
    rules = (
        rings + "\nnull do timer(later, after(3)) <- rung.\nnull do timer(tick, every(4, from_now)) <- rung."
    )
    engine = run(rules=rules)
    engine.event("a", 1)
    found = [one for one in engine.at(at + 10) if one[0] in ("later", "tick")]
    assert found == [("later", at + 3), ("tick", at + 4), ("tick", at + 8)]


def test_one_that_sets_itself_again_makes_up_for_a_jump_up_to_a_bound(monkeypatch):
    monkeypatch.setattr(timer_service, "MAX_FIRINGS_PER_JUMP", 100)
    engine = run(rules=":- timer(t, after(1)).\nnull do timer(t, after(1)) <- t.")
    engine.at(0.5)
    assert [at for term, at in engine.at(50) if term == "t"] == [number + 0.5 for number in range(1, 50)]
    rung = [at for term, at in engine.at(1000, 1001.5) if term == "t"]
    assert len(rung) < 110
    assert rung[-1] == 1001


def test_an_instant_that_is_over_is_said_and_rings_never(caplog):
    engine = run("timer(a, at(2))")
    engine.at(5)
    assert engine.call("timer(b, at(3))")
    assert engine.timers() == "[]"
    said = [record.getMessage() for record in caplog.records]
    assert said == ["timer a, at(2): that instant has passed", "timer b, at(3): that instant has passed"]


def test_a_jump_of_time_is_made_up_for_up_to_a_bound(caplog, monkeypatch):
    monkeypatch.setattr(timer_service, "MAX_FIRINGS_PER_JUMP", 100)
    engine = run("timer(t, every(1))")
    engine.at(0.5)
    assert len(engine.at(100.5)) == 101 and not caplog.records
    assert engine.at(1000) == [("t", 1000), ("e", 1000)]
    (record,) = caplog.records
    assert "899 events of timer t, every(1) left out; 899 of all timers so far" in record.getMessage()
    assert engine.at(1001.5) == [("t", 1001), ("e", 1001.5)]


def test_an_event_of_a_timer_has_variables_of_its_own_each_time():
    engine = run("timer(a(X, X), every(1))", "pair(Y, Z) <- a(1, Y) seq a(2, Z).")
    engine.at(0.5, 3)
    assert [event for event, _ in engine.seen if event.startswith("pair")] == ["pair(1,2)"] * 2


def test_where_time_goes_back_what_repeats_goes_on_from_there():
    clock = StreamClock()
    engine = run(
        "timer(a, every(3))\ntimer(b, every(3, from_now))\ntimer(c, after(50))\ntimer(d, at(33))", clock=clock
    )

    def move(second):
        engine.seen.clear()
        clock.move_to(second * SECOND, back=True)
        engine.advance()
        return engine.seen

    assert move(20) == []
    assert move(25) == [("a", 21), ("b", 23), ("a", 24)]
    assert move(2) == []
    assert move(8) == [("a", 3), ("b", 5), ("a", 6), ("b", 8)]
    assert [one for one in move(80) if one[0] in "cd"] == [("d", 33)]


def test_what_is_cancelled_does_not_stay_in_the_clock():
    engine = run("timer(keep, every(1000))")
    engine.at(1)
    for number in range(500):
        engine.call(f"timer(a({number}), after(5000))")
        engine.call(f"cancel_timer(a({number}))")
        engine.call("timer(b, after(2000))")
    assert len(engine.clock.alarms) < 50
    assert engine.at(2500)[:2] == [("keep", 1000), ("keep", 2000)]
    assert engine.seen[2] == ("b", 2001)


def test_there_are_not_more_than_a_bound(monkeypatch):
    monkeypatch.setattr(timer_service, "MAX_TIMERS", 100)
    engine = run()
    assert engine.call("forall(between(1, 100, N), timer(a(N), after(N)))")
    with pytest.raises(RetalisError, match="timers"):
        engine.call("timer(b, after(1))")
    assert engine.call("timer(a(1), after(1))"), "it is there already"


def test_timers_go_on_in_a_state_that_is_taken_up():
    engine = run("timer(a, every(2))\ntimer(b, after(7))\ntimer(c, every(3, from_now))")
    waiting = Rung.restore(engine.snapshot())
    assert engine.at(1, 5) == waiting.at(1, 5)
    other = Rung.restore(engine.snapshot())
    assert other.status().alarms == 3
    rung = engine.at(9, 30)
    assert [event for event, _ in rung].count("b") == 1
    assert other.at(9, 30) == rung


def test_an_interrupt_may_lose_an_alarm_and_no_timer():
    engine = run("timer(a, every(2))")
    engine.at(1)
    engine.clock.alarms.clear()
    engine.rules.repair()
    assert engine.at(3) == [("a", 2), ("e", 3)]


def test_status_counts_timers_with_alarms():
    engine = run("timer(a, every(2))")
    assert (engine.status().alarms, engine.status().next_alarm) == (1, None)
    engine.at(1)
    assert (engine.status().alarms, engine.status().next_alarm) == (1, 2 * SECOND)


@pytest.mark.parametrize("timer", ["timer(tick(left), every(1))", "timer(tick, every(1))"])
def test_an_event_of_a_timer_is_as_it_is_declared(timer):
    declared = ":- event tick(count:number).\n"
    for load in ({"rules": f"{declared}:- {timer}."}, {"rules": declared, "goals": timer}):
        engine = Rung()
        with pytest.raises(ProgramErrors, match="tick"):
            engine.load(rules=load["rules"])
            engine.load(goals=load["goals"])
        assert engine.timers() == "[]"


class TestNames:
    """What programs have called by these names before."""

    def test_facts_of_a_program_take_the_place_of_the_goal(self):
        engine = run(rules="timer(kitchen, 5).\ntimers(many).\nout(X) <- e where timer(kitchen, X).")
        assert engine.at(1) == [("e", 1), ("out(5)", 1)]

    def test_a_goal_without_its_arrow_is_no_fact(self):
        with pytest.raises(ProgramErrors, match="write :- before a goal"):
            run(rules="timer(tick, every(5)).")

    def test_an_event_may_have_the_name(self, caplog):
        with caplog.at_level(logging.WARNING):
            engine = run(rules="out(X) <- timer(X, 5).")
        engine.event("timer(a, 5)", 1)
        assert engine.seen[1] == ("out(a)", 1) and not caplog.records
