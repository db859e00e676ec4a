"""The engine: loading, events, queries, outputs, callbacks, and errors."""

import logging
import threading
from pathlib import Path
from typing import Any, List, Optional

import pytest
from asserting_accessors import compound, place_of, stream_clock
from recorded_calls import recording
from recording_engine import RecordingEngine
from recording_reports import RecordingReports

from retalis import (
    Definitions,
    Engine,
    Limits,
    ProgramErrors,
    PrologError,
    Reports,
    Settings,
    StreamClock,
    UsageError,
    Var,
    atom,
    deref,
    foreign,
    functor,
    make_list,
)
from retalis.prolog.terms import timestamps
from retalis.prolog.terms.timestamps import SECOND


def test_output_of_rule_is_delivered_to_subscriber() -> None:
    engine = RecordingEngine(
        "alarm(X) <- smoke(X) seq heat(X).", "subscribe(alarm(X), [], warn(X), alarms, a)"
    )
    engine.event("smoke(kitchen)", 1)
    engine.event("heat(cellar)", 2)
    engine.event("heat(kitchen)", 3)
    assert engine.outputs == [("warn(kitchen)", "alarms", "a")]
    assert engine.events[-1] == ("alarm(kitchen)", SECOND, 3 * SECOND)


def test_invalid_date_is_no_number() -> None:
    with pytest.raises(PrologError, match="datime"):
        Engine().query("X is datime(2020,13,1,0,0,0,0)")
    assert Engine().query("X is datime(1970,1,1,0,1,0,5) - datime(1970,1,1,0,0,0), X =:= 60 + 5.0e-9")


def test_query_returns_values_by_name() -> None:
    engine = RecordingEngine("p(1). p(2). p(3).")
    assert [deref(answer["X"]) for answer in engine.query("p(X), X > 1")] == [2, 3]
    assert len(engine.query("p(_)", most=1)) == 1
    assert engine.query("p(9)") == []
    assert engine.query("p(1)") == [{}]


def test_query_returns_no_solution_beyond_limit() -> None:
    engine = Engine()
    assert engine.query("X = 1, assertz(called)", most=0) == []
    assert engine.query("catch(called, _, fail)") == []
    # The second solution, which is not wanted, would raise an error.
    assert engine.query("X = 1 ; throw(oops)", most=1) == [{"X": 1}]
    with pytest.raises(UsageError, match="^most: -1 is no number of solutions: expected 0 or more$"):
        engine.query("true", most=-1)


def test_failed_goal_does_not_stop_later_goals() -> None:
    engine = RecordingEngine()
    with pytest.raises(ProgramErrors) as caught_errors:
        engine.call_goals("assertz(a(1))\nfail\nno_such_goal(1)\nb(\nassertz(a(2))\n", "goals.txt")
    errors = caught_errors.value.errors
    assert [(place_of(error).source, place_of(error).line) for error in errors] == [
        ("goals.txt", 2),
        ("goals.txt", 3),
        ("goals.txt", 4),
    ]
    assert [deref(answer["X"]) for answer in engine.query("a(X)")] == [1, 2]


def test_program_of_folder_with_error_is_incomplete(tmp_path: Path) -> None:
    """Undefined predicates are not reported: a clause may be missing because of the error."""
    for name, rules in (("a", "alarm <- fire.\nb <- a seq.\n"), ("b", "p :- undefined_here.\n")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "goalPredicates.txt").write_text("compile_event_file('rules.txt')\n")
        (tmp_path / name / "rules.txt").write_text(rules)
    engine = Engine()

    def is_reported() -> bool:
        return any("undefined_here" in str(warning) for warning in engine.warnings(tmp_path, Definitions()))

    with pytest.raises(ProgramErrors):
        engine.load_program(tmp_path / "a")
    engine.load_program(tmp_path / "b")
    assert not is_reported()
    (tmp_path / "a" / "rules.txt").write_text("alarm <- fire.\n")
    engine.reload(f"{tmp_path}/b/../a")
    assert is_reported()


def test_events_of_goals_are_processed_first() -> None:
    engine = RecordingEngine("null do new_event(b, 5, 7) <- a.\nc <- b.\nd <- a.")
    engine.event("a", 1)
    assert [event for event, _, _ in engine.events] == ["a", "b", "c", "null", "d"]
    assert engine.events[1][1:] == (5 * SECOND + 7,) * 2


def test_long_chain_overflows_no_stack() -> None:
    engine = RecordingEngine("a(Y) <- a(X) where (X < 20000, Y is X + 1).", max_depth=100_000)
    engine.event("a(0)", 1)
    assert engine.events[-1][0] == "a(20000)"


def test_time_going_back_clears_matches_and_memories(caplog: pytest.LogCaptureFixture) -> None:
    engine = RecordingEngine("c <- a seq b.", "memorize(a, [], _, m, 5)")
    stream_clock(engine).move_to(100 * SECOND)
    engine.event("a", 100)
    assert len(engine.query("access_mem(m, _, _)")) == 1
    stream_clock(engine).move_to(10 * SECOND, back=True)
    with caplog.at_level(logging.WARNING, "retalis"):
        engine.event("b", 101)
    assert [event for event, _, _ in engine.events if not event.startswith("memory_")] == ["a", "b"]
    assert engine.query("access_mem(m, _, _)") == []
    assert sum("time went back" in record.message for record in caplog.records) == 1


def test_moved_clock_separates_waiting_events() -> None:
    clock = StreamClock(5 * SECOND)
    engine = Engine(clock)
    engine.load(rules="ab(X, Y) <- a(X) seq b(Y).", goals="memorize(a(X), [], X, seen, 10)")
    events: List[Any] = []
    engine.on_event(lambda term, start, end: events.append(engine.show(term)))

    def post_while_busy(term: Any, topic: Any, name: Any) -> None:
        """Post events that wait, and move the clock back between them."""
        engine.post(functor("a", 1)(1), 6 * SECOND)
        engine.advance(lambda: clock.move_to(SECOND, back=True))
        engine.post(functor("a", 1)(2), 2 * SECOND)
        engine.post(functor("b", 1)(2), 3 * SECOND)

    engine.load(goals="subscribe(go, [], _, out, o)")
    engine.on_output(post_while_busy)
    engine.event("go", 5)
    assert [event for event in events if "memory" not in event] == ["go", "a(1)", "a(2)", "b(2)", "ab(2,2)"]
    assert engine.query("findall(X, access_mem(seen, X, _), Xs)")[0]["Xs"] == make_list([2])


def test_alarm_in_callback_keeps_current_event() -> None:
    engine = RecordingEngine(
        "exceptionAlarm(late, 1) <- a. c <- b do true.",
        "subscribe(b, [], _, out, s)\nmemorize(b, [], b, m, 3)",
        clock=StreamClock(),
    )

    def advance(term: Any, topic: Any, name: Any) -> None:
        stream_clock(engine).move_to(5 * SECOND)
        engine.event("d", 5)

    engine.on_output(advance)
    engine.event("a", 1)
    engine.event("b", 4)
    events = [event for event in engine.events if not event[0].startswith("memory_")]
    assert events == [
        ("a", SECOND, SECOND),
        ("b", 4 * SECOND, 4 * SECOND),
        ("late", SECOND, 2 * SECOND),
        ("d", 5 * SECOND, 5 * SECOND),
        ("c", 4 * SECOND, 4 * SECOND),
    ]
    (record,) = engine.query("access_mem(m, b, [Start, End])")
    assert [timestamps.from_term(record[name]) for name in ("Start", "End")] == [4 * SECOND] * 2
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
def test_interrupt_drops_pending_events(work: Any) -> None:
    engine = RecordingEngine("b <- a. c <- b. c <- a.", "subscribe(b, [], _, out, s)")

    def stop(term: Any, topic: Any, name: Any) -> None:
        if not engine.events or engine.events[-1][0] == "b":
            raise KeyboardInterrupt

    engine.on_output(stop)
    with pytest.raises(KeyboardInterrupt):
        work(engine)
    assert engine.dispatcher.current is None
    del engine.events[:]
    engine.event("d", 2)
    assert [event for event, _, _ in engine.events] == ["d"]  # events of the interrupted call are dropped


def test_events_of_callback_count_as_derived(caplog: pytest.LogCaptureFixture) -> None:
    engine = Engine(settings=Settings(max_depth=10))
    engine.load(goals="subscribe(n(_), [], _, out, s)")
    outputs: List[Any] = []

    def send_next(term: Any, topic: Any, name: Any) -> None:
        outputs.append(engine.show(term))
        engine.event(f"n({len(outputs)})", 1)

    engine.on_output(send_next)
    engine.event("n(0)", 1)
    assert outputs == [f"n({number})" for number in range(11)]
    assert "more than 10 events were derived one from another" in caplog.text
    assert engine.dispatcher.current is None


def test_threads_send_events_during_queries() -> None:
    engine = RecordingEngine("n(X) <- e(X).", "memorize(n(X), [], _, m, 10000)")

    def send(value: int) -> None:
        for instant in range(50):
            engine.event(f"e({value})", instant)

    threads = [threading.Thread(target=send, args=(value,)) for value in range(4)]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        engine.query("findall(X, access_mem(m, n(X), _), L)")
        for thread in threads:
            thread.join(0.001)
    assert len(engine.query("access_mem(m, _, _)")) == 200


def test_changed_limit_stops_goal() -> None:
    engine = Engine(settings=Settings(limits=Limits(inferences=1_000_000)))
    engine.change_settings(engine.settings._replace(limits=Limits(inferences=1000)))
    with pytest.raises(PrologError, match="inferences"):
        engine.query("between(1, inf, X), X > 100000")


class WarningReports(Reports):
    """Reports that record whether there was a warning."""

    def __init__(self) -> None:
        super().__init__()
        self.is_warned = threading.Event()

    def warning(self, problem: object, kind: object = None, texts: int = 1, once: bool = False) -> None:
        self.is_warned.set()


def test_changed_warning_time_starts_watchdog() -> None:
    reports = WarningReports()
    engine = Engine(reports=reports)
    engine.change_settings(engine.settings._replace(watchdog=0.001))
    assert engine.do(lambda: reports.is_warned.wait(60))


def test_fixed_setting_cannot_be_changed() -> None:
    engine = Engine()
    with pytest.raises(UsageError, match="change_settings: queue is fixed: "):
        engine.change_settings(engine.settings._replace(queue=7))
    with pytest.raises(UsageError, match="change_settings: the engine was created without limits: "):
        engine.change_settings(engine.settings._replace(limits=Limits(seconds=1)))


def test_values_of_answer_share_variables() -> None:
    (answer,) = Engine().query("X = f(A), Y = g(A)")
    assert compound(answer["X"])[1] is compound(answer["Y"])[1] is answer["A"]


def test_alarms_beyond_limit_are_dropped() -> None:
    reports = RecordingReports()
    engine = Engine(reports=reports)
    engine.rules.network.limit_stored(3)
    engine.load(rules="exceptionAlarm(late(X), 10) <- e(X).")
    events: List[Any] = []
    engine.on_event(lambda term, start, end: events.append(engine.show(term)))
    for number in range(5):
        engine.event(f"e({number})", 1)
    assert len(engine.clock.alarms) == 3
    assert "1 have been dropped" in reports.texts[0]
    assert "2 have been dropped" in reports.texts[1]
    stream_clock(engine).move_to(20 * SECOND)
    engine.advance()
    assert [text for text in events if text.startswith("late")] == ["late(0)", "late(1)", "late(2)"]


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
def test_undefined_condition_gives_warning(
    goal: str, warning: Optional[str], caplog: pytest.LogCaptureFixture
) -> None:
    engine = Engine()
    engine.load(rules="hot(1).")
    assert engine.call(goal)
    assert [record.getMessage() for record in caplog.records] == ([] if warning is None else [warning])


def test_condition_may_call_later_clauses_of_file(caplog: pytest.LogCaptureFixture) -> None:
    engine = Engine()
    engine.load(rules=":- memorize(t(X), [hot(X), cold(X)], _, m, 5).\nhot(1).")
    assert [record.getMessage() for record in caplog.records] == [
        "memory m: there is no predicate cold/1 yet; define it, or write :- dynamic cold/1."
    ]


def test_condition_of_goal_may_call_rules_of_program(caplog: pytest.LogCaptureFixture) -> None:
    engine = Engine()
    with caplog.at_level(logging.WARNING, "retalis"):
        engine.load(rules="hot(X) :- X > 40.", goals="memorize(t(X), [hot(X), cold(X)], X, m, 5)")
    assert [record.getMessage() for record in caplog.records] == [
        "memory m: there is no predicate cold/1 yet; define it, or write :- dynamic cold/1."
    ]
    with caplog.at_level(logging.WARNING, "retalis"), pytest.raises(ProgramErrors):
        engine.load(rules="wet(X) <-", goals="memorize(t(X), [wet(X)], X, n, 5)")
    assert (
        caplog.records[-1]
        .getMessage()
        .startswith("memory n: there is no predicate wet/1 yet; define it, or write :- dynamic wet/1.")
    )


def test_error_of_rule_has_place_and_variable_names(caplog: pytest.LogCaptureFixture) -> None:
    engine = Engine()
    engine.load(rules="hot(Who, T) <- temp(Who, T) where T > 38.", source="r.txt")
    engine.event("temp(bob, x)", 1)
    assert caplog.records[0].getMessage().split("\n")[0] == (
        "r.txt:1:1: rule hot(Who,T), at event temp(bob,x): goal T>38: Type error: `evaluable' expected, found `x/0'"
    )


def test_errors_of_callbacks_are_reported(caplog: pytest.LogCaptureFixture) -> None:
    engine = Engine()
    engine.load(rules="b <- a.\nc <- b.", goals="subscribe(b, [], _, out, s)")
    events: List[Any] = []
    for error in (ValueError("of the callback"), BrokenPipeError("of the callback")):

        def fail(*arguments: Any, error: Any = error) -> None:
            raise error

        engine.on_event(fail)
        engine.on_output(fail)
    engine.on_event(lambda term, start, end: events.append(engine.show(term)))
    engine.event("a", 1)
    engine.post(atom("a"))
    assert events == ["a", "b", "c"] * 2
    assert caplog.text.count("ValueError: of the callback") >= 1
    assert caplog.text.count("BrokenPipeError: of the callback") >= 1
    assert engine.reports.errors == 2 * 2 * 3 + 2 * 2


@pytest.mark.parametrize("kind", ["on_output", "on_event", "foreign"])
def test_query_of_other_thread_in_callback_is_refused(kind: str) -> None:
    engine = Engine(settings=Settings(patience=0.01))
    engine.load(rules="b <- a.\nc <- b where wait.\nd <- b.", goals="subscribe(b, [], _, out, s)")
    refused, events = [], []

    def query() -> None:
        with pytest.raises(UsageError) as error:
            engine.query("X = 1")
        refused.append(str(error.value))

    def wait(*arguments: Any) -> None:
        if kind == "on_event" and engine.show(arguments[0]) != "b":
            return
        thread = threading.Thread(target=query)
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
    engine.on_event(lambda term, start, end: events.append(engine.show(term)))
    engine.event("a", 1)
    callback = "the foreign predicate wait/0" if kind == "foreign" else f"a callback of {kind}"
    assert [callback in text for text in refused] == [True]
    assert events == ["a", "b", "c", "d"]
    assert engine.call("X = 1")


def test_callback_may_query_and_threads_may_post() -> None:
    engine = Engine(settings=Settings(patience=0.01))
    engine.load(goals="subscribe(a(_), [], _, out, s)\nmemorize(b(_), [], _, m, 10)")
    answers: List[Any] = []

    def callback(term: Any, topic: Any, name: Any) -> None:
        thread = threading.Thread(target=engine.post, args=(functor("b", 1)(1),))
        thread.start()
        thread.join(10)
        answers.append(engine.query("X = 1"))

    engine.on_output(callback)
    engine.event("a(1)", 1)
    assert answers == [[{"X": 1}]]
    assert engine.call("memory_counter(m, 1)")


def test_number_of_searched_similar_names_is_bounded(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = Engine()
    searches: List[Any] = []
    procedures = engine.logic.undefined_procedures
    monkeypatch.setattr(procedures, "suggest", recording(searches, procedures.suggest))
    engine.load(rules="".join(f"h <- a(X) where (unknown{number}(X)).\n" for number in range(200)))
    assert len(caplog.records) == 200
    assert 0 < len(searches) < 60


def test_memories_are_added_and_deleted() -> None:
    engine = Engine()
    events: List[Any] = []
    engine.on_event(lambda term, start, end: events.append(engine.show(term)))
    value, name = Var(), atom("warm")
    engine.add_memory((functor("t", 1), value), [(functor(">", 2), value, 20)], Var(), name, 2)
    for degrees in (19, 21, 22):
        engine.event(f"t({degrees})", degrees)
    assert [str(solution["X"]) for solution in engine.query("access_mem(warm, t(X), _)")] == ["22", "21"]
    with pytest.raises(PrologError, match="one already exists"):
        engine.add_memory(atom("a"), [], Var(), name, 2)
    with pytest.raises(PrologError, match="integer"):
        engine.add_memory(atom("a"), [], Var(), atom("other"), atom("two"))
    assert engine.delete_memory(name)
    assert not engine.delete_memory(name)
    assert not engine.has_memory(name)
    assert events[0].startswith("memory_created(t(")
    assert events[-1] == "memory_deleted(warm)"


def test_subscriptions_are_added_and_deleted() -> None:
    engine = Engine()
    sent: List[Any] = []
    engine.on_output(lambda term, topic, name: sent.append((engine.show(term), topic, engine.show(name))))
    value, topic, name = Var(), atom("out"), atom("s")
    engine.add_subscription((functor("t", 1), value), [], (functor("got", 1), value), topic, name)
    engine.event("t(1)", 1)
    assert sent == [("got(1)", "out", "s")]
    with pytest.raises(PrologError, match="one already exists"):
        engine.add_subscription(atom("a"), [], Var(), topic, name)
    assert engine.delete_subscription(topic, name)
    assert not engine.delete_subscription(topic, name)
    engine.event("t(2)", 2)
    assert len(sent) == 1
