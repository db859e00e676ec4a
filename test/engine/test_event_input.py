"""Event input: goals that subscribe to topics, and timestamps that are far ahead of the clock."""

import logging
from collections import Counter
from random import Random

import pytest

from retalis import Definitions, Engine, RetalisError, StreamClock
from retalis.engine.program_check import check_program
from retalis.events.program.topic_configuration import TopicEvent, Topics, topic_type
from retalis.prolog.terms.timestamps import SECOND, from_seconds

TOPICS = Topics(
    (topic_type("/left", "std_msgs/Bool"), topic_type("said", "std_msgs/String")),
    events=(TopicEvent("/left", "bump"),),
)


@pytest.fixture
def engine_with_topics():
    """Return an engine with topics, and the subscriptions that its goals request."""
    engine, subscriptions = Engine(), []
    engine.input_topics.set_subscriber(lambda request: subscriptions.append(tuple(request)), TOPICS)
    return engine, subscriptions


def test_goal_subscribes_to_topic_once(engine_with_topics):
    engine, subscriptions = engine_with_topics
    engine.load(goals="subscribe_to(right, 'std_msgs/Bool', bumper_right)\nsubscribe_to(scan, 'a/msg/B')")
    assert engine.call("""subscribe_to("/right", "std_msgs/Bool", bumper_right)""")
    assert engine.call("subscribe_to(right, 'std_msgs/msg/Bool', bumper_right)")
    assert engine.call("subscribe_to(said, 'std_msgs/String'), subscribe_to(left, 'std_msgs/Bool', bump)")
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
        ("subscribe_to(said, 'std_msgs/Int32')", "it is subscribed already as std_msgs/String"),
        ("subscribe_to(said, 'std_msgs/String', x)", "it is subscribed already as std_msgs/String"),
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
def test_invalid_subscription_is_an_error_of_goal(engine_with_topics, goal, message):
    engine, subscriptions = engine_with_topics
    with pytest.raises(RetalisError) as error:
        engine.call(goal)
    assert message in str(error.value)
    assert engine.call(f"catch({goal}, _, true)")
    assert subscriptions == []


def test_number_of_subscribed_topics_is_limited(engine_with_topics):
    engine, subscriptions = engine_with_topics
    with pytest.raises(RetalisError, match="goals subscribe to at most 1000 topics"):
        engine.call("between(0, 2000, N), atom_concat(t, N, T), subscribe_to(T, 'std_msgs/Bool'), fail")
    assert len(subscriptions) == 1000


def test_subscription_without_topics_gives_warning(caplog):
    engine = Engine()
    with caplog.at_level(logging.WARNING, "retalis"):
        engine.load(goals="subscribe_to(left, 'std_msgs/Bool', bump)", rules="hit <- bump(true).")
    (record,) = caplog.records
    assert "topic left is not subscribed: there are no topics here" in record.getMessage()


def test_events_named_by_goal_have_named_slots(engine_with_topics):
    engine, _ = engine_with_topics
    engine.load(goals="subscribe_to(right, 'std_msgs/Bool', right)", rules="hit(X) <- right{data: X}.")
    events = []
    engine.on_event(lambda term, start, end: events.append(str(term[1])))
    engine.event("right(true)", 1)
    assert len(events) == 2


def test_reload_subscribes_to_new_topics_and_refuses_other_types(tmp_path, engine_with_topics):
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


def test_check_knows_events_of_topics_subscribed_by_goals(tmp_path):
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


# ---- timestamps far ahead ------------------------------------------------------------------------------

YEAR = 365 * 86_400
START = 1_700_000_000

TIMED_RULES = """
last_10(N) <- aggregate(count, tick, N, last(10)).
hopping(N) <- aggregate(count, tick, N, every(5)).
from_first(N) <- aggregate(count, tick, N, every(5, first)).
running(N) <- aggregate(count, tick, N, running(every(5))).
pair <- (left seq right) within 3.
silent <- left seq absent(never, 0.5).
"""


class FarStamps:
    """An engine with its default clock, its warnings, and counts of its events."""

    def __init__(self, rules=TIMED_RULES):
        self.engine = Engine()
        self.warnings = []
        self.engine.rules.on_warning = lambda warning: self.warnings.append(warning.message)
        self.engine.load(rules=rules, goals="timer(beat, every(10)).")
        self.counts = Counter()
        self.engine.on_event(lambda term, start, end: self.counts.update([functor_name(self.engine, term)]))

    def run(self, seconds, wrong=()):
        """Feed three events for each second; ``wrong`` maps seconds to the distance of the first one's time."""
        for second in seconds:
            self.engine.event("tick", START + second + dict(wrong).get(second, 0))
            self.engine.event("left", START + second + 0.1)
            self.engine.event("right", START + second + 0.2)
        return self.counts


def functor_name(engine, term):
    return engine.show(term).partition("(")[0]


def test_single_stamp_far_ahead_does_not_move_time():
    expected = FarStamps().run(range(100))
    run = FarStamps()
    counts = run.run(range(100), {25: YEAR})
    assert (counts["last_10"], counts["running"]) == (99, 99)
    for name in ("pair", "silent", "hopping", "from_first", "beat"):
        assert counts[name] == expected[name], name
    (warning,) = run.warnings
    assert warning.startswith(
        "event tick: its time is 365.0 days ahead of the clock, which does not follow it"
    )
    assert run.engine.status().ahead == 1


@pytest.mark.parametrize("distance", [60, 3600, 86_400, 29 * 86_400])
def test_clock_returns_from_single_stamp_ahead(distance):
    expected = FarStamps().run(range(1000))
    run = FarStamps()
    counts = run.run(range(1000), {250: distance})
    # Three events show the error; what they belong to is lost, and alarms between the two times ring once more.
    for name in ("last_10", "running", "pair", "silent"):
        assert expected[name] - 3 <= counts[name] <= expected[name], name
    assert counts["hopping"] >= expected["hopping"] - 1
    assert counts["beat"] >= expected["beat"]
    assert run.engine.clock.now() == from_seconds(START + 999.2)
    # One line names the event; the other one is that of a rule with a late event.
    (warning,) = [text for text in run.warnings if text.startswith("event ")]
    assert "event tick/0: its time was " in warning
    assert "ahead of the other events" in warning
    assert run.engine.status().ahead == 1


def test_values_of_windows_are_right_after_clock_has_returned():
    values = []
    run = FarStamps("last_10(N) <- aggregate(count, tick, N, last(10)).")
    run.engine.on_event(lambda term, start, end: values.append((end, run.engine.show(term))))
    run.run(range(100), {50: 3600})
    later = [text for end, text in values if 62 <= end / SECOND - START < 100 and "last" in text]
    assert later == ["last_10(10)"] * 38


@pytest.mark.parametrize("wrong", [{25: 3600, 26: 3601}, {25: 3600, 26: 86_400}, {25: YEAR, 26: YEAR}])
def test_several_wrong_stamps_of_one_event_are_one_source(wrong):
    expected = FarStamps().run(range(100))
    run = FarStamps()
    counts = run.run(range(100), wrong)
    assert run.engine.clock.now() == from_seconds(START + 99.2)
    for name in ("last_10", "running", "pair", "silent"):
        assert expected[name] - 4 <= counts[name] <= expected[name], name


def test_burst_of_wrong_stamps_before_other_events():
    run = FarStamps()
    run.run(range(20))
    for hundredth in range(30):
        run.engine.event("tick", START + 3600 + 20 + hundredth / 100)
    run.run(range(21, 60))
    assert run.engine.clock.now() == from_seconds(START + 59.2)
    assert run.counts["pair"] >= 57


@pytest.mark.parametrize("offset", [3600, YEAR])
def test_source_with_another_date_does_not_move_clock_beside_others(offset):
    expected = FarStamps().run(range(100))
    run = FarStamps()
    counts = run.run(range(100), dict.fromkeys(range(10, 100), offset))
    assert run.engine.clock.now() == from_seconds(START + 99.2)
    assert expected["pair"] - 3 <= counts["pair"] <= expected["pair"]
    assert run.engine.status().ahead >= 88
    assert len(run.warnings) < 30, "reports are throttled"


@pytest.mark.parametrize("distance", [3600, YEAR])
def test_clock_returns_from_first_stamp_ahead(distance):
    expected = FarStamps().run(range(100))
    counts = FarStamps().run(range(100), {0: distance})
    assert counts["last_10"] >= 99
    for name in ("pair", "silent", "beat"):
        assert counts[name] >= expected[name] - 1, name


@pytest.mark.parametrize("offset", [3600, 40 * 86_400, 20 * YEAR])
def test_stream_with_other_date_is_processed(offset):
    run = FarStamps()
    shifted = FarStamps()
    shifted_engine = shifted.engine
    for second in range(50):
        for event, fraction in (("tick", 0), ("left", 0.1), ("right", 0.2)):
            run.engine.event(event, START + second + fraction)
            shifted_engine.event(event, START + offset + second + fraction)
    assert {**shifted.counts, "beat": 0} == {**run.counts, "beat": 0}
    assert shifted.warnings == []


@pytest.mark.parametrize("pause", [11, 3600, 20 * 86_400])
def test_pause_is_no_error(pause):
    expected, run = FarStamps(), FarStamps()
    expected.run(range(50))
    run.run(range(50))
    expected.run(range(60, 110))
    # Nothing is refused, and alarms before the first event after the pause ring before it.
    for second in range(50):
        for event, fraction in (("tick", 0), ("left", 0.1), ("right", 0.2)):
            run.engine.event(event, START + 50 + pause // 10 * 10 + second + fraction)
    for name in ("last_10", "running", "pair", "silent", "hopping", "from_first"):
        assert run.counts[name] == expected.counts[name], name
    assert [text for text in run.warnings if not text.startswith("time has jumped")] == []
    assert run.engine.status().ahead == 0


def test_stream_with_rare_events_moves_clock_at_each():
    run = FarStamps("late(X) <- in(X) seq absent(never, 5).")
    for hour in range(30):
        run.engine.event(f"in({hour})", START + 3600 * hour)
    assert run.counts["late"] == 29
    assert run.warnings == []


def test_other_date_of_all_events_moves_clock_after_ten_seconds():
    run = FarStamps("late <- left seq absent(never, 1).")
    run.run(range(5))
    run.run(range(YEAR + 5, YEAR + 15))
    assert run.engine.clock.now() < (START + 6) * SECOND
    run.run(range(YEAR + 15, YEAR + 20))
    assert run.engine.clock.now() == from_seconds(START + YEAR + 19.2)
    assert run.counts["late"] == 19


def test_late_events_after_pause_move_clock_back_only_until_next_event():
    run = FarStamps()
    run.run(range(20))
    run.engine.event("tick", START + 3600)
    for _ in range(3):
        run.engine.event("slow", START + 19)
    run.run(range(3601, 3620))
    assert run.engine.clock.now() == from_seconds(START + 3619.2)
    assert run.counts["pair"] == 39


@pytest.mark.parametrize(
    "rule",
    [
        "out(N) <- aggregate(count, tick, N, last(10)).",
        "out(N) <- aggregate(count, left, N, last(3)).",
        "out(N) <- aggregate(count, tick, N, every(5)).",
        "out(N) <- aggregate(count, tick, N, running(every(5))).",
        "out(N) <- aggregate(count, tick, N, last(10, every(5))).",
        "out <- tick with debounce(0.5).",
        "out <- left seq absent(never, 0.5).",
        "out <- (tick seq right) within 3.",
        "out <- (tick and right) within 0.5.",
        "out <- (left seq right seq left) within 5.",
    ],
)
def test_rule_is_right_after_clock_has_returned(rule):
    results = []
    for wrong in ({}, {50: 3600}):
        run, outputs = FarStamps(rule), []
        # The longest window, of 10 s, has only events after the return.
        run.run(range(63), wrong)
        run.engine.on_event(
            lambda term, start, end, run=run, outputs=outputs: outputs.append(
                (run.engine.show(term), start, end)
            )
        )
        run.run(range(63, 120))
        results.append(outputs)
    assert results[0] == results[1]
    assert any(text.startswith("out") for text, _, _ in results[0])


@pytest.mark.parametrize(
    "rule",
    [
        "out(N) <- aggregate(count, tick, N, every(5, first)).",
        "out(N) <- aggregate(count, tick, N, running(every(5, first))).",
        "out <- tick with throttle(5).",
        "out <- tick with burst(0.5).",
    ],
)
def test_operator_that_begins_with_event_continues_after_clock_has_returned(rule):
    """The wrong event may have begun another window, so only the numbers of outputs agree."""
    counts = []
    for wrong in ({}, {50: 3600}):
        run = FarStamps(rule)
        run.run(range(56), wrong)
        run.counts.clear()
        counts.append(run.run(range(56, 120))["out"])
    assert counts[0] > 10
    assert abs(counts[0] - counts[1]) <= 1


def test_subscription_continues_after_clock_has_returned():
    counts = []
    for wrong in ({}, {50: 3600}):
        run, sent = FarStamps("pair <- left seq right."), []
        run.engine.load(goals="subscribe(tick with throttle(5), [], tick, ticks, a)")
        run.run(range(56), wrong)
        run.engine.on_output(lambda term, topic, name, sent=sent: sent.append(term))
        run.run(range(56, 120))
        counts.append(len(sent))
    assert counts == [12, 13]


def test_memory_and_state_do_not_stay_in_future():
    engine = Engine()
    engine.load(goals="memorize(at(_), [], _, place, 1)")
    for second, ahead in ((0, 0), (1, 3600), (2, 0), (3, 0), (4, 0), (5, 0)):
        engine.event(f"at({second})", START + second + ahead)
    assert engine.query("prev(place, at(Place), _, _, 1700000005)") == [{"Place": 5}]


def test_state_that_begins_ahead_is_removed():
    engine, states = Engine(), []
    engine.load(rules=":- state(open, from(opened), until(closed)).")
    engine.on_event(lambda term, start, end: states.append((engine.show(term), start, end)))
    for second in range(20):
        engine.event("tick", START + second)
    engine.event("opened", START + 3600)
    for second in range(21, 25):
        engine.event("tick", START + second)
    assert not engine.call("holds(open)")
    engine.event("opened", START + 26)
    engine.event("closed", START + 28)
    assert states[-1] == ("open", (START + 26) * SECOND, (START + 28) * SECOND)


def random_stream(random):
    """Return events of four names with times in order, some of which are wrong by a minute to a year."""
    time, events = START, []
    for _ in range(150):
        time += random.choice((0.1, 0.5, 1, 1, 3, 15))
        name = random.choice(("tick", "left", "right", "never"))
        wrong = random.choice((60, 3600, 86_400, YEAR)) if random.random() < 0.05 else 0
        events.append((name, time + wrong + random.choice((0, 0, -0.3))))
    return events


def outputs_of(engine):
    outputs = []
    engine.on_event(lambda term, start, end: outputs.append((engine.show(term), start, end)))
    return outputs


OTHER_RULES = """
slow <- tick with throttle(5).
settled <- tick with debounce(2).
of_five(N) <- aggregate(count, left, N, last(5)).
changed(N) <- aggregate(count, tick, N, every(3)) with throttle(2).
"""


@pytest.mark.parametrize("has_receipt_clock", [False, True])
@pytest.mark.parametrize("seed", range(20))
def test_restored_engine_has_same_outputs(seed, has_receipt_clock):
    random = Random(seed)
    clock, restored_clock = (StreamClock(1), StreamClock(1)) if has_receipt_clock else (None, None)
    engine, restored = Engine(clock), Engine(restored_clock)
    for program in (engine, restored):
        program.load(
            rules=TIMED_RULES + OTHER_RULES,
            goals="timer(beat, every(10)).\nsubscribe(tick with debounce(2), [], tick, ticks, a).",
        )
    outputs, restored_outputs = outputs_of(engine), outputs_of(restored)
    receipt = 0
    for name, time in random_stream(random):
        # The receipt clock has the time of the stream without its errors.
        receipt = max(receipt, from_seconds(min(time, receipt / SECOND + 3 if receipt else time)))
        for program in (engine, restored):
            if has_receipt_clock:
                program.clock.move_to(receipt)
            program.event(name, time)
        if random.random() < 0.3:
            restored = Engine.restore(restored.snapshot())
            outputs_before, restored_outputs = restored_outputs, outputs_of(restored)
            restored_outputs += outputs_before
    assert restored_outputs == outputs
    assert restored.clock.now() == engine.clock.now()
    status, restored_status = engine.status(), restored.status()
    assert restored_status.ahead == status.ahead
    assert [rule.ahead for rule in restored_status.rules] == [rule.ahead for rule in status.rules]
    assert restored_status.subscriptions[0].ahead == status.subscriptions[0].ahead


def test_window_on_receipt_clock_reports_stamp_ahead():
    clock = StreamClock(START * SECOND)
    engine = Engine(clock)
    warnings = []
    engine.rules.on_warning = lambda warning: warnings.append(warning.message)
    engine.load(rules="n(N) <- aggregate(count, tick, N, every(5, first)).")
    engine.event("tick", START)
    engine.event("tick", START + 60)
    assert len(warnings) == 1
    assert "event tick is 60.0 s ahead of the clock" in warnings[0]
