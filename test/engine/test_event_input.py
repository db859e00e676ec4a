"""Event input: topics that goals subscribe to, events, event texts, and their times."""

import logging
from pathlib import Path
from typing import Any, Callable, List, Tuple

import pytest
from asserting_accessors import stream_clock
from recording_engine import RecordingEngine

from retalis import (
    Clock,
    Definitions,
    Engine,
    PrologError,
    Reports,
    RetalisError,
    Settings,
    StreamClock,
    SyntaxFault,
    UsageError,
    atom,
)
from retalis.engine.program_check import check_program
from retalis.events.program.topic_configuration import TopicEvent, Topics, topic_type
from retalis.prolog.terms import timestamps
from retalis.prolog.terms.timestamps import SECOND

TOPICS = Topics(
    (topic_type("/left", "std_msgs/Bool"), topic_type("speech", "std_msgs/String")),
    events=(TopicEvent("/left", "bump"),),
)


@pytest.fixture
def engine_with_topics() -> Tuple[Any, ...]:
    """Return an engine with topics, and the subscriptions that its goals request."""
    engine, subscriptions = Engine(), []
    engine.input_topics.set_subscriber(lambda request: subscriptions.append(tuple(request)), TOPICS)
    return engine, subscriptions


def test_goal_subscribes_to_topic_once(engine_with_topics: Tuple[Any, ...]) -> None:
    engine, subscriptions = engine_with_topics
    engine.load(goals="subscribe_to(right, 'std_msgs/Bool', bumper_right)\nsubscribe_to(scan, 'a/msg/B')")
    assert engine.call("""subscribe_to("/right", "std_msgs/Bool", bumper_right)""")
    assert engine.call("subscribe_to(right, 'std_msgs/msg/Bool', bumper_right)")
    assert engine.call("subscribe_to(speech, 'std_msgs/String'), subscribe_to(left, 'std_msgs/Bool', bump)")
    assert subscriptions == [("right", "std_msgs/Bool", "bumper_right"), ("scan", "a/B", "")]
    joined = engine.input_topics.merge_with(TOPICS)
    assert joined.subscribed == (
        *TOPICS.subscribed,
        topic_type("right", "std_msgs/Bool"),
        topic_type("scan", "a/B"),
    )
    assert joined.event_name_of("right") == "bumper_right"


@pytest.mark.parametrize(
    ("goal", "message"),
    [
        ("subscribe_to(speech, 'std_msgs/Int32')", "it is subscribed already as std_msgs/String"),
        ("subscribe_to(speech, 'std_msgs/String', x)", "it is subscribed already as std_msgs/String"),
        ("subscribe_to(left, 'std_msgs/Bool')", "as std_msgs/Bool, with events called bump"),
        ("subscribe_to('a b', 'std_msgs/Int32')", "a b"),
        ("subscribe_to(a, 'Int32')", "package/Type"),
        ("subscribe_to(a, std_msgs/int32)", "names with a slash need quotes"),
        ("subscribe_to(a, std_msgs/Int32)", "names with a slash need quotes"),
        ("subscribe_to(_, 'std_msgs/Int32')", "not sufficiently instantiated"),
        ("subscribe_to(a, 'std_msgs/Int32', 'A')", "begins with a small letter"),
        ("subscribe_to(a, 'std_msgs/Int32', seq)", "seq has a fixed meaning in rules"),
        ("subscribe_to(a, 'std_msgs/Int32', '')", "event_name"),
        ("subscribe_to(a, 'std_msgs/Int32', 3)", "names with a slash need quotes"),
    ],
)
def test_invalid_subscription_is_an_error_of_goal(
    engine_with_topics: Tuple[Any, ...], goal: str, message: str
) -> None:
    engine, subscriptions = engine_with_topics
    with pytest.raises(RetalisError) as error:
        engine.call(goal)
    assert message in str(error.value)
    assert engine.call(f"catch({goal}, _, true)")
    assert subscriptions == []


def test_number_of_subscribed_topics_is_limited(engine_with_topics: Tuple[Any, ...]) -> None:
    engine, subscriptions = engine_with_topics
    with pytest.raises(RetalisError, match="goals subscribe to at most 1000 topics"):
        engine.call("between(0, 2000, N), atom_concat(t, N, T), subscribe_to(T, 'std_msgs/Bool'), fail")
    assert len(subscriptions) == 1000


def test_subscription_without_topics_gives_warning(caplog: pytest.LogCaptureFixture) -> None:
    engine = Engine()
    with caplog.at_level(logging.WARNING, "retalis"):
        engine.load(goals="subscribe_to(left, 'std_msgs/Bool', bump)", rules="hit <- bump(true).")
    (record,) = caplog.records
    assert "topic left is not subscribed: there are no topics here" in record.getMessage()


def test_events_named_by_goal_have_named_slots(engine_with_topics: Tuple[Any, ...]) -> None:
    engine, _ = engine_with_topics
    engine.load(goals="subscribe_to(right, 'std_msgs/Bool', right)", rules="hit(X) <- right{data: X}.")
    events: List[Any] = []
    engine.on_event(lambda term, start, end: events.append(engine.show(term)))
    engine.event("right(true)", 1)
    assert events == ["right{data: true}", "hit(true)"]


def test_reload_subscribes_to_new_topics_only(tmp_path: Path, engine_with_topics: Tuple[Any, ...]) -> None:
    engine, subscriptions = engine_with_topics
    goals = tmp_path / "goalPredicates.txt"
    goals.write_text("subscribe_to(a, 'std_msgs/Bool', x)\n")
    engine.load_program(tmp_path)
    goals.write_text("subscribe_to(a, 'std_msgs/Bool', x)\nsubscribe_to(b, 'std_msgs/Bool')\n")
    engine.reload(tmp_path)
    goals.write_text("subscribe_to(a, 'std_msgs/Int8', x)\nsubscribe_to(c, 'std_msgs/Bool')\n")
    with pytest.raises(RetalisError, match="it is subscribed already as std_msgs/Bool, with events called x"):
        engine.reload(tmp_path)
    assert subscriptions == [("a", "std_msgs/Bool", "x"), ("b", "std_msgs/Bool", "")]


def test_check_knows_events_of_subscribed_topics(tmp_path: Path) -> None:
    (tmp_path / "pub_sub.xml").write_text("<publish_subscribe/>")
    (tmp_path / "goalPredicates.txt").write_text(
        "compile_event_file('rules.txt')\nsubscribe_to(left, 'std_msgs/Bool', bump)\n"
        "subscribe_to(c, 'std_msgs/Strng')\nmemorize(hit(_), [], _, hits, 5)\n"
    )
    (tmp_path / "rules.txt").write_text(
        "hit(1) <- bump(true).\nhit(2) <- later(_).\nhit(3) <- std_msgs__0__Int8(_).\nhit(4) <- bumb(true).\n"
        "more <- bump(false) do subscribe_to(right, 'std_msgs/Bool', later).\n"
        "hit(5) <- more do subscribe_to(n, 'std_msgs/Int8').\n"
    )
    problems = [
        str(problem.problem).split("\n")[0].partition(" [RT")[0]
        for problem in check_program(tmp_path, Definitions())
    ]
    assert [problem.partition(f"{tmp_path}/")[2] for problem in problems] == [
        "goalPredicates.txt:3:1: there is no message type std_msgs/Strng; did you mean std_msgs/String?",
        "rules.txt:4:11: no producer of bumb/1: no topic, rule or goal; did you mean bump/1?",
    ]


# ---- events and event texts


def test_events_without_time_have_distinct_times() -> None:
    engine = RecordingEngine()
    stream_clock(engine).move_to(5)
    engine.event("a")
    engine.event("b")
    assert engine.events == [("a", 5, 5), ("b", 6, 6)]


def test_late_event_does_not_move_clock_back() -> None:
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


def test_given_clock_is_not_moved_by_events() -> None:
    engine = RecordingEngine(clock=StreamClock(7))
    engine.event("a", 100)
    assert engine.clock.now() == 7


STAMPED = "late(D) <- (s seq e) check (t1(S), t2(E), E - S >= 9.5, E > S, D is E - S)."


@pytest.mark.parametrize("input_kind", ["event", "post", "text", "datime", "now"])
def test_stamp_arithmetic_is_equal_for_all_inputs(input_kind: str) -> None:
    engine = RecordingEngine(STAMPED)
    for name, seconds in (("s", 5), ("e", 15.25)):
        instant = int(seconds * 10**9)
        if input_kind == "event":
            engine.event(name, seconds)
        elif input_kind == "post":
            engine.post(atom(name), instant)
        elif input_kind == "text":
            engine.post_text(f"event({name},[{seconds},{seconds}])")
        elif input_kind == "datime":
            engine.event(name, timestamps.datime(instant), timestamps.datime(instant))
        else:
            stream_clock(engine).move_to(instant)
            engine.event(name)
    assert [event for event, _, _ in engine.events] == ["s", "e", "late(10.25)"]


def test_event_text_beyond_limit_is_refused(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = RecordingEngine(clock=StreamClock(7))
    monkeypatch.setattr("retalis.engine.event_input.MAX_EVENT_TEXT_CHARACTERS", 20)
    with caplog.at_level(logging.WARNING, "retalis"):
        engine.post_text("event(a(1234567890))")
        engine.post_text("event(a(12345678901))")
    assert engine.events == [("a(1234567890)", 7, 7)]
    (record,) = caplog.records
    assert "21 characters, at most 20 are allowed" in record.getMessage()


def test_times_may_be_terms_or_numbers() -> None:
    engine = RecordingEngine()
    stamp = timestamps.datime(7 * 10**9 + 1)
    engine.event("a", stamp, stamp)
    engine.event("b", 1.5, 2)
    assert engine.events == [("a", 7 * 10**9 + 1, 7 * 10**9 + 1), ("b", 1_500_000_000, 2_000_000_000)]


def test_end_before_start_is_refused() -> None:
    engine = RecordingEngine()
    with pytest.raises(UsageError, match="^a ends before it starts$"):
        engine.event("a", 2, 1)
    with pytest.raises(UsageError, match="^expected datime"):
        engine.event("a", "soon")  # type: ignore[arg-type]
    assert engine.events == []


@pytest.mark.parametrize("clock", [StreamClock(7), None])
def test_end_without_start_is_refused(clock: Any) -> None:
    engine = RecordingEngine(clock=clock)
    with pytest.raises(
        UsageError, match="^event 'a': it has an end and no start: give both times, or neither$"
    ):
        engine.event("a", end=5)
    with pytest.raises(UsageError, match="no start"):
        engine.event_at(atom("a"), None, 5)
    assert engine.events == []


def test_end_is_start_by_default() -> None:
    engine = RecordingEngine(clock=StreamClock(9 * SECOND))
    engine.event("a", 5)
    engine.event_at(atom("b"), 5 * SECOND, None)
    assert engine.events == [("a", 5 * SECOND, 5 * SECOND), ("b", 5 * SECOND, 5 * SECOND)]


def test_refused_event_has_no_lag() -> None:
    engine = RecordingEngine("lost <- a seq absent(b, 2).", clock=StreamClock(100 * SECOND))
    with pytest.raises(UsageError, match="ends before it starts"):
        engine.event("b", 99.9, 99.5)
    assert engine.status().lags == ()
    engine.event("b", 99.4, 99.5)
    assert [(lag.event, lag.lag) for lag in engine.status().lags] == [("b/0", SECOND // 2)]


def test_event_with_syntax_error_is_refused() -> None:
    with pytest.raises(SyntaxFault):
        RecordingEngine().event("a(", 1)


@pytest.mark.parametrize(
    "text",
    [
        "event(a(1),[datime(1970,1,1,0,0,1,0),datime(1970,1,1,0,0,1,0)])",
        "new_event(a(1),1,0)",
        "new_event(a(1),1,0,1,0)",
        "new_event(a(1), [datime(1970,1,1,0,0,1.0,0), datime(1970,1,1,0,0,1,0)]).",
    ],
)
def test_event_text_is_processed(text: str) -> None:
    engine = RecordingEngine()
    engine.post_text(text)
    assert engine.events == [("a(1)", 10**9, 10**9)]


@pytest.mark.parametrize(
    "text", ["assertz(x)", "event(", "event(X)", "event(1)", "event(a,[2,1])", "new_event(a,x,1)"]
)
def test_other_text_is_refused_with_warning(text: str, caplog: pytest.LogCaptureFixture) -> None:
    engine = RecordingEngine()
    with caplog.at_level(logging.WARNING, "retalis"):
        engine.post_text(text)
    assert len(caplog.records) == 1
    assert engine.events == []
    assert engine.query("catch(x, _, fail)") == []


def test_goal_text_is_called_if_allowed() -> None:
    engine = RecordingEngine(allow_goals=True)
    engine.post_text("assertz(x(1))")
    assert engine.query("x(1)") == [{}]


def test_default_clock_is_stream_clock() -> None:
    assert isinstance(Engine().clock, StreamClock)


@pytest.mark.parametrize(
    "text", ["new_event(a,99999999999999,0)", "event(a,[1.0e20,1.0e20])", "new_event(a,1,0,99999999999999,0)"]
)
def test_instant_without_date_is_refused(text: str, caplog: pytest.LogCaptureFixture) -> None:
    engine = Engine()
    engine.load(goals="memorize(a, [], _, m, 5)")
    engine.post_text(text)
    assert "refused" in caplog.text
    assert not engine.call("access_mem(m, _, _)")
    if text.startswith("new_event"):
        with pytest.raises(PrologError):
            engine.call(text)


def test_posted_term_and_text_have_same_stamp() -> None:
    shown: List[Any] = []
    posts: List[Callable[[Engine], None]] = [
        lambda engine: engine.post(atom("a"), 10**9 + 5),
        lambda engine: engine.post_text("event(a,[datime(1970,1,1,0,0,1,5),datime(1970,1,1,0,0,1,5)])"),
    ]
    for post in posts:
        engine = Engine()
        engine.load(goals="memorize(a, [], _, m, 5)")
        post(engine)
        shown.append(engine.show(engine.query("access_mem(m, _, I)")[0]["I"]))
    assert shown == ["[datime(1970,1,1,0,0,1,5),datime(1970,1,1,0,0,1,5)]"] * 2


def test_refused_event_text_is_logged_with_reason(caplog: pytest.LogCaptureFixture) -> None:
    engine = Engine()
    for text in ("event(X)", "event(a,[2,1])", "foo", "event(a", "halt(" + "x" * 1000 + ")"):
        engine.post_text(text)
    shown = [record.getMessage() for record in caplog.records]
    assert shown[0] == "event refused: event(X): Arguments are not sufficiently instantiated"
    assert shown[1] == "event refused: event(a,[2,1]): Type error: `interval' expected, found `[2,1]'"
    assert shown[2] == "event refused: foo: only event/1,2 and new_event/2,3,5 are accepted"
    assert shown[3].startswith("event refused: event text:1:8: expected")
    assert len(shown[4]) < 300


def test_failed_goal_text_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    engine = Engine(settings=Settings(allow_goals=True))
    for text in ("fail", "nosuch(1)"):
        engine.post_text(text)
    assert [record.getMessage() for record in caplog.records] == [
        "the goal fail fails",
        "the goal nosuch(1) ends with an error: Unknown procedure: nosuch/1",
    ]


def test_invalid_instant_of_post_is_refused() -> None:
    engine = Engine()
    with pytest.raises(ValueError, match="soon"):
        engine.post(atom("a"), "soon")  # type: ignore[arg-type]


def moved(instant: int) -> Any:
    def clock() -> Any:
        moved_clock = StreamClock()
        moved_clock.move_to(instant)
        return moved_clock

    return clock


def pinned(instant: int) -> Any:
    def clock() -> Any:
        pinned_clock = StreamClock()
        pinned_clock.pin(instant)
        return pinned_clock

    return clock


def test_event_without_time_on_unset_clock_is_refused() -> None:
    """With stamps of 0 s and 1 ns, absences would not end and alarms would not be emitted."""
    own = Engine()
    for engine in (own, Engine(StreamClock())):
        starts: List[Any] = []
        engine.on_event(lambda term, start, end, starts=starts: starts.append(start))
        with pytest.raises(UsageError) as error:
            engine.event("beat")
        assert str(error.value) == (
            "event 'beat': it has no time, and the clock of the engine was never set: "
            "give the event a time, or the engine the computer's clock with Engine(clock=Clock())"
        )
        assert starts == []
        if engine is own:
            engine.event("first", 5)  # moves the default clock
        else:
            stream_clock(engine).move_to(5 * SECOND)
        engine.event("beat")
        assert starts[-1] == 5 * SECOND


@pytest.mark.parametrize("post", ["post", "post_each", "post_text"])
def test_posted_event_on_unset_clock_is_reported(post: str, monkeypatch: pytest.MonkeyPatch) -> None:
    errors_and_events: List[str] = []
    reports = Reports()
    monkeypatch.setattr(reports, "error", lambda error, *_: errors_and_events.append(str(error)[:30]))
    engine = Engine(None, None, reports)
    engine.on_event(lambda term, start, end: errors_and_events.append(engine.show(term)))
    if post == "post":
        engine.post(atom("beat"))
    elif post == "post_each":
        engine.post_each([(atom("beat"), None)])
    else:
        engine.post_text("event(beat)")
    assert errors_and_events == ["event 'beat': it has no time, "]


@pytest.mark.parametrize(
    "clock",
    [lambda: StreamClock(0), lambda: StreamClock(7), moved(0), pinned(0), lambda: Clock(lambda: 5 * SECOND)],
)
def test_set_clock_stamps_events(clock: Any) -> None:
    engine = Engine(clock())
    starts: List[Any] = []
    engine.on_event(lambda term, start, end: starts.append(start))
    engine.event("beat")
    engine.event("beat")
    assert starts[1] > starts[0]


def test_restored_clock_is_unset_or_set() -> None:
    engine = Engine()
    with pytest.raises(UsageError, match="has no time"):
        Engine.restore(engine.snapshot()).event("beat")
    engine.event("beat", 0)
    restored = Engine.restore(engine.snapshot())
    restored.event("beat")
    assert restored.status().taken == 2
