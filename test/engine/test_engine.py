"""The façade: loading, events, queries, outputs, errors."""

import logging
import threading

import pytest
from recording_engine import RecordingEngine

from retalis import (
    Clock,
    Engine,
    Limits,
    ProgramErrors,
    PrologError,
    Reports,
    RetalisError,
    Settings,
    StreamClock,
    SyntaxFault,
    UsageError,
    atom,
    deref,
    foreign,
    functor,
    make_list,
)
from retalis.prolog.terms import timestamps
from retalis.prolog.terms.timestamps import SECOND


def test_a_rule_fires_and_a_subscriber_gets_it():
    engine = RecordingEngine(
        "alarm(X) <- smoke(X) seq heat(X).", "subscribe(alarm(X), [], warn(X), alarms, a)"
    )
    engine.event("smoke(kitchen)", 1)
    engine.event("heat(cellar)", 2)
    engine.event("heat(kitchen)", 3)
    assert engine.outputs == [("warn(kitchen)", "alarms", "a")]
    assert engine.events[-1] == ("alarm(kitchen)", 10**9, 3 * 10**9)


def test_an_event_without_stamp_gets_the_clock_and_never_the_same_twice():
    engine = RecordingEngine()
    engine.clock.move_to(5)
    engine.event("a")
    engine.event("b")
    assert engine.events == [("a", 5, 5), ("b", 6, 6)]


def test_stamped_events_move_the_clock_and_late_ones_do_not_move_it_back():
    engine = RecordingEngine("out(X) <- (a(X) seq b(X)) within 60.\nexceptionAlarm(ring(X), 5) <- a(X).")
    for second in range(200):
        engine.event(f"a({second})", second)
    assert engine.clock.now() == 199 * 10**9
    assert engine.rules.rules[0].stored_match_count == 60
    assert [event for event, _, _ in engine.events].count("ring(194)") == 1
    assert ("ring(195)", 195 * 10**9, 200 * 10**9) not in engine.events
    engine.event("late", 3)
    assert engine.clock.now() == 199 * 10**9
    engine.event("b(199)", 201)
    assert ("out(199)", 199 * 10**9, 201 * 10**9) in engine.events


def test_a_clock_of_ones_own_is_moved_by_nobody_else():
    engine = RecordingEngine(clock=StreamClock(7))
    engine.event("a", 100)
    assert engine.clock.now() == 7


STAMPED = "late(D) <- (s seq e) check (t1(S), t2(E), E - S >= 9.5, E > S, D is E - S)."


@pytest.mark.parametrize("way", ["event", "post", "text", "datime", "now"])
def test_arithmetic_on_stamps_is_the_same_by_every_way_in(way):
    engine = RecordingEngine(STAMPED)
    for name, seconds in (("s", 5), ("e", 15.25)):
        instant = int(seconds * 10**9)
        if way == "event":
            engine.event(name, seconds)
        elif way == "post":
            engine.post(atom(name), instant)
        elif way == "text":
            engine.post_text(f"event({name},[{seconds},{seconds}])")
        elif way == "datime":
            engine.event(name, timestamps.datime(instant), timestamps.datime(instant))
        else:
            engine.clock.move_to(instant)
            engine.event(name)
    assert [event for event, _, _ in engine.events] == ["s", "e", "late(10.25)"]


def test_what_is_no_date_is_no_number():
    with pytest.raises(PrologError, match="datime"):
        Engine().query("X is datime(2020,13,1,0,0,0,0)")
    assert Engine().query("X is datime(1970,1,1,0,1,0,5) - datime(1970,1,1,0,0,0), X =:= 60 + 5.0e-9")


def test_a_text_that_is_too_long_to_read_is_refused(caplog, monkeypatch):
    engine = RecordingEngine(clock=StreamClock(7))
    monkeypatch.setattr("retalis.engine.event_input.MAX_EVENT_TEXT_CHARACTERS", 20)
    with caplog.at_level(logging.WARNING, "retalis"):
        engine.post_text("event(a(1234567890))")
        engine.post_text("event(a(12345678901))")
    assert engine.events == [("a(1234567890)", engine.events[0][1], engine.events[0][2])]
    (record,) = caplog.records
    assert "21 characters, at most 20 are allowed" in record.getMessage()


def test_stamps_are_terms_numbers_or_ros_times():
    engine = RecordingEngine()
    stamp = timestamps.datime(7 * 10**9 + 1)
    engine.event("a", stamp, stamp)
    engine.event("b", 1.5, 2)
    assert engine.events == [("a", 7 * 10**9 + 1, 7 * 10**9 + 1), ("b", 1_500_000_000, 2_000_000_000)]


def test_an_end_before_the_start_is_refused():
    engine = RecordingEngine()
    with pytest.raises(RetalisError):
        engine.event("a", 2, 1)
    with pytest.raises(UsageError):
        engine.event("a", "soon")
    assert engine.events == []


def test_text_that_is_no_term_is_refused():
    with pytest.raises(SyntaxFault):
        RecordingEngine().event("a(", 1)


def test_queries_give_values_by_name():
    engine = RecordingEngine("p(1). p(2). p(3).")
    assert [deref(answer["X"]) for answer in engine.query("p(X), X > 1")] == [2, 3]
    assert len(engine.query("p(_)", most=1)) == 1
    assert engine.query("p(9)") == []
    assert engine.query("p(1)") == [{}]


def test_a_failing_or_wrong_goal_is_reported_with_its_place_and_the_others_are_called():
    engine = RecordingEngine()
    with pytest.raises(ProgramErrors) as caught:
        engine.call_goals("assertz(a(1))\nfail\nno_such_goal(1)\nb(\nassertz(a(2))\n", "goals.txt")
    errors = caught.value.errors
    assert [(error.place.source, error.place.line) for error in errors] == [
        ("goals.txt", 2),
        ("goals.txt", 3),
        ("goals.txt", 4),
    ]
    assert [deref(answer["X"]) for answer in engine.query("a(X)")] == [1, 2]


def test_a_rule_file_is_found_beside_the_goal_file(tmp_path):
    (tmp_path / "goalPredicates.txt").write_text("compile_event_file('more/rules.txt')\n")
    (tmp_path / "more").mkdir()
    (tmp_path / "more" / "rules.txt").write_text("b(X) <- a(X).\n")
    engine = RecordingEngine()
    engine.load_program(tmp_path)
    engine.event("a(1)", 1)
    assert [event for event, _, _ in engine.events] == ["a(1)", "b(1)"]


def test_errors_of_a_rule_file_come_at_once_and_nothing_of_it_is_active(tmp_path):
    (tmp_path / "goalPredicates.txt").write_text("compile_event_file('rules.txt')\n")
    (tmp_path / "rules.txt").write_text("ok <- a.\nb <- a seq.\nc <- (a.\nfact(1).\n")
    engine = RecordingEngine()
    with pytest.raises(ProgramErrors) as caught:
        engine.load_program(tmp_path)
    assert [error.place.line for error in caught.value.errors] == [2, 3]
    engine.event("a", 1)
    assert [event for event, _, _ in engine.events] == ["a"]


def test_a_goal_that_raises_stops_its_firing_only(caplog):
    engine = RecordingEngine("null do no_such_goal(X) <- a(X).\nok(X) <- a(X).")
    with caplog.at_level(logging.WARNING, "retalis"):
        engine.event("a(1)", 1)
    assert [event for event, _, _ in engine.events] == ["a(1)", "ok(1)"]
    assert "no_such_goal" in caplog.text


def test_events_made_by_goals_are_finished_first():
    engine = RecordingEngine("null do new_event(b, 5, 7) <- a.\nc <- b.\nd <- a.")
    engine.event("a", 1)
    assert [event for event, _, _ in engine.events] == ["a", "b", "c", "null", "d"]
    assert engine.events[1][1:] == (5 * 10**9 + 7,) * 2


def test_a_chain_without_end_is_stopped_and_the_engine_goes_on(caplog):
    engine = RecordingEngine("a(Y) <- a(X) where Y is X + 1.\nb(1) <- b.", max_depth=50)
    with caplog.at_level(logging.WARNING, "retalis"):
        engine.event("a(0)", 1)
    assert len(engine.events) == 51
    assert "50" in caplog.text
    engine.event("b", 2)
    assert engine.events[-1][0] == "b(1)"


def test_a_long_chain_needs_no_stack():
    engine = RecordingEngine("a(Y) <- a(X) where (X < 20000, Y is X + 1).", max_depth=100_000)
    engine.event("a(0)", 1)
    assert engine.events[-1][0] == "a(20000)"


@pytest.mark.parametrize(
    "text",
    [
        "event(a(1),[datime(1970,1,1,0,0,1,0),datime(1970,1,1,0,0,1,0)])",
        "new_event(a(1),1,0)",
        "new_event(a(1),1,0,1,0)",
        "new_event(a(1), [datime(1970,1,1,0,0,1.0,0), datime(1970,1,1,0,0,1,0)]).",
    ],
)
def test_events_as_text(text):
    engine = RecordingEngine()
    engine.post_text(text)
    assert engine.events == [("a(1)", 10**9, 10**9)]


@pytest.mark.parametrize(
    "text", ["assertz(x)", "event(", "event(X)", "event(1)", "event(a,[2,1])", "new_event(a,x,1)"]
)
def test_other_text_is_refused_with_a_warning(text, caplog):
    engine = RecordingEngine()
    with caplog.at_level(logging.WARNING, "retalis"):
        engine.post_text(text)
    assert len(caplog.records) == 1
    assert engine.events == []
    assert engine.query("catch(x, _, fail)") == []


def test_any_goal_is_taken_where_that_is_allowed():
    engine = RecordingEngine(allow_goals=True)
    engine.post_text("assertz(x(1))")
    assert engine.query("x(1)") == [{}]


def test_time_that_goes_back_clears_what_was_remembered(caplog):
    engine = RecordingEngine("c <- a seq b.", "memorize(a, [], _, m, 5)")
    engine.clock.move_to(100 * 10**9)
    engine.event("a", 100)
    assert len(engine.query("access_mem(m, _, _)")) == 1
    engine.clock.move_to(10 * 10**9, back=True)
    with caplog.at_level(logging.WARNING, "retalis"):
        engine.event("b", 101)
    assert [event for event, _, _ in engine.events if not event.startswith("memory_")] == ["a", "b"]
    assert engine.query("access_mem(m, _, _)") == []
    assert sum("time went back" in record.message for record in caplog.records) == 1


def test_a_clock_that_is_moved_between_events_that_wait_parts_them():
    clock = StreamClock(5 * SECOND)
    engine = Engine(clock)
    engine.load(rules="ab(X, Y) <- a(X) seq b(Y).", goals="memorize(a(X), [], X, seen, 10)")
    happened = []
    engine.on_event(lambda term, start, end: happened.append(engine.show(term)))

    def busy(term, topic, name):
        """Have events wait, and the clock go back between them."""
        engine.post(functor("a", 1)(1), 6 * SECOND)
        engine.advance(lambda: clock.move_to(SECOND, back=True))
        engine.post(functor("a", 1)(2), 2 * SECOND)
        engine.post(functor("b", 1)(2), 3 * SECOND)

    engine.load(goals="subscribe(go, [], _, out, o)")
    engine.on_output(busy)
    engine.event("go", 5)
    assert [one for one in happened if "memory" not in one] == ["go", "a(1)", "a(2)", "b(2)", "ab(2,2)"]
    assert engine.query("findall(X, access_mem(seen, X, _), Xs)")[0]["Xs"] == make_list([2])


def test_an_alarm_rings_when_its_time_has_come():
    engine = RecordingEngine("exceptionAlarm(late, 5) <- a.")
    engine.event("a", 1)
    engine.clock.move_to(5 * 10**9)
    engine.advance()
    assert [event for event, _, _ in engine.events] == ["a"]
    engine.clock.move_to(6 * 10**9)
    engine.advance()
    assert engine.events[-1] == ("late", 10**9, 6 * 10**9)


def test_an_alarm_that_rings_inside_a_subscriber_leaves_the_event_as_it_was():
    engine = RecordingEngine(
        "exceptionAlarm(late, 1) <- a. c <- b do true.",
        "subscribe(b, [], _, out, s)\nmemorize(b, [], b, m, 3)",
        clock=StreamClock(),
    )

    def later(term, topic, name):
        engine.clock.move_to(5 * 10**9)
        engine.event("d", 5)

    engine.on_output(later)
    engine.event("a", 1)
    engine.event("b", 4)
    found = [event for event in engine.events if not event[0].startswith("memory_")]
    second = 10**9
    assert found == [
        ("a", second, second),
        ("b", 4 * second, 4 * second),
        ("late", second, 2 * second),
        ("d", 5 * second, 5 * second),
        ("c", 4 * second, 4 * second),
    ]
    (kept,) = engine.query("access_mem(m, b, [Start, End])")
    assert [timestamps.from_term(kept[name]) for name in ("Start", "End")] == [4 * second] * 2
    assert engine.dispatcher.current is None


@pytest.mark.parametrize(
    "work",
    [
        lambda engine: engine.event("a", 1),
        lambda engine: engine.call("new_event(a, 1, 1)"),
        lambda engine: engine.load(goals="new_event(a, 1, 1)"),
    ],
    ids=["event", "goal", "goal file"],
)
def test_an_interrupt_leaves_no_event_behind(work):
    engine = RecordingEngine("b <- a. c <- b. c <- a.", "subscribe(b, [], _, out, s)")

    def stop(term, topic, name):
        if not engine.events or engine.events[-1][0] == "b":
            raise KeyboardInterrupt

    engine.on_output(stop)
    with pytest.raises(KeyboardInterrupt):
        work(engine)
    assert engine.dispatcher.current is None
    del engine.events[:]
    engine.event("d", 2)
    assert [event for event, _, _ in engine.events] == ["d"]  # nothing of what was interrupted comes after


def test_events_that_a_subscriber_makes_of_its_own_follow_from_what_it_was_sent(caplog):
    engine = Engine(settings=Settings(max_depth=10))
    engine.load(goals="subscribe(n(_), [], _, out, s)")
    seen = []

    def next_one(term, topic, name):
        seen.append(engine.show(term))
        engine.event(f"n({len(seen)})", 1)

    engine.on_output(next_one)
    engine.event("n(0)", 1)
    assert seen == [f"n({number})" for number in range(11)]
    assert "more than 10 events were derived one from another" in caplog.text
    assert engine.dispatcher.current is None


def test_a_query_and_events_from_many_threads():
    engine = RecordingEngine("n(X) <- e(X).", "memorize(n(X), [], _, m, 10000)")
    threads = [
        threading.Thread(target=lambda k=k: [engine.event(f"e({k})", i) for i in range(50)]) for k in range(4)
    ]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        engine.query("findall(X, access_mem(m, n(X), _), L)")
        for thread in threads:
            thread.join(0.001)
    assert len(engine.query("access_mem(m, _, _)")) == 200


def test_a_goal_that_runs_for_ever_is_stopped():
    engine = RecordingEngine("loop :- loop.\nnull do loop <- a.\nok <- a.", limits=Limits(inferences=100_000))
    engine.event("a", 1)
    assert [event for event, _, _ in engine.events] == ["a", "ok"]
    with pytest.raises(RetalisError, match="inferences"):
        engine.query("loop")


def test_the_default_clock_stands_still():
    assert isinstance(Engine().clock, StreamClock)


@pytest.mark.parametrize(
    "text", ["new_event(a,99999999999999,0)", "event(a,[1.0e20,1.0e20])", "new_event(a,1,0,99999999999999,0)"]
)
def test_an_instant_that_has_no_date_is_refused(text, caplog):
    engine = Engine()
    engine.load(goals="memorize(a, [], _, m, 5)")
    engine.post_text(text)
    assert "refused" in caplog.text
    assert not engine.call("access_mem(m, _, _)")
    if text.startswith("new_event"):
        with pytest.raises(PrologError):
            engine.call(text)


def test_a_variable_in_two_values_of_an_answer_stays_one_variable():
    (answer,) = Engine().query("X = f(A), Y = g(A)")
    assert answer["X"][1] is answer["Y"][1] is answer["A"]


def test_a_message_and_its_text_have_the_same_stamp():
    shown = []
    for post in (
        lambda engine: engine.post(atom("a"), 10**9 + 5),
        lambda engine: engine.post_text("event(a,[datime(1970,1,1,0,0,1,5),datime(1970,1,1,0,0,1,5)])"),
    ):
        engine = Engine()
        engine.load(goals="memorize(a, [], _, m, 5)")
        post(engine)
        shown.append(engine.show(engine.query("access_mem(m, _, I)")[0]["I"]))
    assert shown[0] == shown[1]


def test_a_subscriber_that_fails_cuts_nothing_off(caplog):
    engine = RecordingEngine("b <- a.", "subscribe(a, [], _, t, 1)")
    engine.on_output(lambda term, topic, name: 1 / 0)
    with caplog.at_level(logging.ERROR, "retalis"):
        engine.event("a", 1)
    assert [event for event, _, _ in engine.events] == ["a", "b"]
    assert "ZeroDivisionError" in caplog.text


def test_alarms_past_the_bound_are_dropped_and_reported():
    engine = Engine()
    engine.rules.max_stored = 3
    warnings = []
    engine.rules.on_warning = lambda warning: warnings.append(str(warning))
    engine.load(rules="exceptionAlarm(late(X), 10) <- e(X).")
    rung = []
    engine.on_event(lambda term, start, end: rung.append(engine.show(term)))
    for number in range(5):
        engine.event(f"e({number})", 1)
    assert len(engine.clock.alarms) == 3
    assert ["1 have been dropped" in warnings[0], "2 have been dropped" in warnings[1]] == [True, True]
    engine.clock.move_to(20 * 10**9)
    engine.advance()
    assert [text for text in rung if text.startswith("late")] == ["late(0)", "late(1)", "late(2)"]


@pytest.mark.parametrize(
    ("goal", "warning"),
    [
        (
            "memorize(t(X), [hott(X)], t(X), m, 5)",
            "memory m: there is no predicate hott/1 yet; did you mean hot/1?",
        ),
        (
            "memorize_diactive(t(X), [(X > 1, \\+ unsafe(X))], _, m, 5)",
            "memory m: there is no predicate unsafe/1 yet; define it, or write :- dynamic unsafe/1.",
        ),
        (
            "subscribe(t(X), [here], _, out, s)",
            "subscription s: there is no predicate here/0 yet; define it, or write :- dynamic here/0.",
        ),
        ("memorize(t(X), [hot(X), X > 1], _, m, 5)", None),
    ],
)
def test_conditions_that_call_what_is_not_there_are_warned_of(goal, warning, caplog):
    engine = Engine()
    engine.load(rules="hot(1).")
    assert engine.call(goal)
    assert [record.getMessage() for record in caplog.records] == ([] if warning is None else [warning])


def test_conditions_in_a_file_may_call_what_the_rest_of_the_file_has(caplog):
    engine = Engine()
    engine.load(rules=":- memorize(t(X), [hot(X), cold(X)], _, m, 5).\nhot(1).")
    assert [record.getMessage() for record in caplog.records] == [
        "memory m: there is no predicate cold/1 yet; define it, or write :- dynamic cold/1."
    ]


def test_what_the_rules_of_the_same_program_define_is_there_for_its_goals(caplog):
    engine = Engine()
    with caplog.at_level(logging.WARNING, "retalis"):
        engine.load(rules="hot(X) :- X > 40.", goals="memorize(t(X), [hot(X), cold(X)], X, m, 5)")
    assert [one.getMessage() for one in caplog.records] == [
        "memory m: there is no predicate cold/1 yet; define it, or write :- dynamic cold/1."
    ]
    with caplog.at_level(logging.WARNING, "retalis"), pytest.raises(ProgramErrors):
        engine.load(rules="wet(X) <-", goals="memorize(t(X), [wet(X)], X, n, 5)")
    assert (
        caplog.records[-1]
        .getMessage()
        .startswith("memory n: there is no predicate wet/1 yet; define it, or write :- dynamic wet/1.")
    )


def test_each_refused_event_is_shown_with_what_is_wrong(caplog):
    engine = Engine()
    for text in ("event(X)", "event(a,[2,1])", "foo", "event(a", "halt(" + "x" * 1000 + ")"):
        engine.post_text(text)
    shown = [record.getMessage() for record in caplog.records]
    assert shown[0] == "event refused: event(X): Arguments are not sufficiently instantiated"
    assert shown[1] == "event refused: event(a,[2,1]): Type error: `interval' expected, found `[2,1]'"
    assert shown[2] == "event refused: foo: only event/1,2 and new_event/2,3,5 are accepted"
    assert shown[3].startswith("event refused: event text:1:8: expected")
    assert len(shown[4]) < 300


def test_a_goal_that_is_taken_as_input_and_goes_wrong_is_named(caplog):
    engine = Engine(settings=Settings(allow_goals=True))
    for text in ("fail", "nosuch(1)"):
        engine.post_text(text)
    assert [record.getMessage() for record in caplog.records] == [
        "the goal fail fails",
        "the goal nosuch(1) ends with an error: Unknown procedure: nosuch/1",
    ]


def test_an_error_of_a_rule_has_the_names_of_its_variables_and_its_place_once(caplog):
    engine = Engine()
    engine.load(rules="hot(Who, T) <- temp(Who, T) where T > 38.", source="r.txt")
    engine.event("temp(bob, x)", 1)
    assert caplog.records[0].getMessage().split("\n")[0] == (
        "r.txt:1:1: rule hot(Who,T), at event temp(bob,x): goal T>38: Type error: `evaluable' expected, found `x/0'"
    )


@pytest.mark.parametrize("goal", ["memorize(a, [], _, m, 5)", "subscribe(a, [], _, t, m)"])
def test_an_id_that_is_taken_is_said_to_be(goal):
    engine = Engine()
    assert engine.call(goal)
    with pytest.raises(PrologError, match="one already exists"):
        engine.call(goal)


def test_an_error_of_a_callback_is_reported_and_what_follows_of_the_event_is_done(caplog):
    engine = Engine()
    engine.load(rules="b <- a.\nc <- b.", goals="subscribe(b, [], _, out, s)")
    seen = []
    for error in (ValueError("of the callback"), BrokenPipeError("of the callback")):

        def fails(*arguments, error=error):
            raise error

        engine.on_event(fails)
        engine.on_output(fails)
    engine.on_event(lambda term, start, end: seen.append(engine.show(term)))
    engine.event("a", 1)
    engine.post(atom("a"))
    assert seen == ["a", "b", "c"] * 2
    assert caplog.text.count("ValueError: of the callback") >= 1
    assert caplog.text.count("BrokenPipeError: of the callback") >= 1
    assert engine.reports.errors == 2 * 2 * 3 + 2 * 2


@pytest.mark.parametrize("kind", ["on_output", "on_event", "foreign"])
def test_a_callback_that_waits_for_a_query_of_another_thread_goes_on(kind):
    engine = Engine(settings=Settings(patience=0.01))
    engine.load(rules="b <- a.\nc <- b where wait.\nd <- b.", goals="subscribe(b, [], _, out, s)")
    refused, seen = [], []

    def ask():
        with pytest.raises(UsageError) as caught:
            engine.query("X = 1")
        refused.append(str(caught.value))

    def wait(*arguments):
        if kind == "on_event" and engine.show(arguments[0]) != "b":
            return
        thread = threading.Thread(target=ask)
        thread.start()
        thread.join(10)

    @foreign(name="wait")
    def waiting() -> bool:
        wait()
        return True

    @foreign(name="wait")
    def not_waiting() -> bool:
        return True

    engine.add_foreign(waiting if kind == "foreign" else not_waiting)
    if kind != "foreign":
        getattr(engine, kind)(wait)
    engine.on_event(lambda term, start, end: seen.append(engine.show(term)))
    engine.event("a", 1)
    what = "the foreign predicate wait/0" if kind == "foreign" else f"a callback of {kind}"
    assert [what in text for text in refused] == [True]
    assert seen == ["a", "b", "c", "d"]
    assert engine.call("X = 1")


def test_a_callback_may_ask_the_engine_itself_and_other_threads_may_post():
    engine = Engine(settings=Settings(patience=0.01))
    engine.load(goals="subscribe(a(_), [], _, out, s)\nmemorize(b(_), [], _, m, 10)")
    found = []

    def callback(term, topic, name):
        thread = threading.Thread(target=engine.post, args=(functor("b", 1)(1),))
        thread.start()
        thread.join(10)
        found.append(engine.query("X = 1"))

    engine.on_output(callback)
    engine.event("a(1)", 1)
    assert found == [[{"X": 1}]]
    assert engine.call("memory_counter(m, 1)")


def test_names_alike_are_looked_for_a_few_times_only(caplog, monkeypatch):
    engine = Engine()
    looked = []
    procedures = engine.logic.undefined_procedures
    suggest = procedures.suggest
    monkeypatch.setattr(procedures, "suggest", lambda key: looked.append(key) or suggest(key))
    engine.load(rules="".join(f"h <- a(X) where (unknown{at}(X)).\n" for at in range(200)))
    assert len(caplog.records) == 200 and len(looked) < 60


def test_who_posts_with_what_is_no_instant_is_told_at_once():
    engine = Engine()
    with pytest.raises(ValueError, match="soon"):
        engine.post(atom("a"), "soon")


def moved(instant):
    def clock():
        made = StreamClock()
        made.move_to(instant)
        return made

    return clock


def pinned(instant):
    def clock():
        made = StreamClock()
        made.pin(instant)
        return made

    return clock


def test_an_event_without_a_time_on_a_clock_that_was_never_set_is_refused():
    """It was stamped 0, and the next one 1e-9, so that no absence ended and no alarm rang."""
    own = Engine()
    for engine in (own, Engine(StreamClock())):
        seen = []
        engine.on_event(lambda term, start, end, seen=seen: seen.append(start))
        with pytest.raises(UsageError) as raised:
            engine.event("beat")
        assert str(raised.value) == (
            "event 'beat': it has no time, and the clock of the engine was never set: "
            "give the event a time, or the engine the computer's clock with Engine(clock=Clock())"
        )
        assert seen == []
        if engine is own:
            engine.event("first", 5)  # moves the clock, which nobody else does
        else:
            engine.clock.move_to(5 * SECOND)
        engine.event("beat")
        assert seen[-1] == 5 * SECOND


@pytest.mark.parametrize("post", ["post", "post_each", "post_text"])
def test_a_posted_event_without_a_time_on_a_clock_that_was_never_set_is_reported(post):
    reports, seen = Reports(), []
    reports.error = lambda error, *_: seen.append(str(error)[:30])
    engine = Engine(None, None, reports)
    engine.on_event(lambda term, start, end: seen.append(engine.show(term)))
    if post == "post":
        engine.post(atom("beat"))
    elif post == "post_each":
        engine.post_each([(atom("beat"), None)])
    else:
        engine.post_text("event(beat)")
    assert seen == ["event 'beat': it has no time, "]


@pytest.mark.parametrize(
    "clock",
    [lambda: StreamClock(0), lambda: StreamClock(7), moved(0), pinned(0), lambda: Clock(lambda: 5 * SECOND)],
)
def test_a_clock_that_was_set_stamps_events(clock):
    engine = Engine(clock())
    seen = []
    engine.on_event(lambda term, start, end: seen.append(start))
    engine.event("beat")
    engine.event("beat")
    assert seen[1] > seen[0]


def test_a_state_says_whether_the_clock_was_set():
    engine = Engine()
    with pytest.raises(UsageError, match="has no time"):
        Engine.restore(engine.snapshot()).event("beat")
    engine.event("beat", 0)
    Engine.restore(engine.snapshot()).event("beat")
