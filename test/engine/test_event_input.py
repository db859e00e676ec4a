"""Event input: goals that subscribe to topics, and timestamps that are far ahead of the clock."""

import logging
from collections import Counter

import pytest

from retalis import Definitions, Engine, RetalisError, StreamClock
from retalis.engine.program_check import check_program
from retalis.events.program.topic_configuration import TopicEvent, Topics, topic_type
from retalis.prolog.terms.timestamps import SECOND

TOPICS = Topics(
    (topic_type("/left", "std_msgs/Bool"), topic_type("said", "std_msgs/String")),
    events=(TopicEvent("/left", "bump"),),
)


@pytest.fixture
def asked():
    """Return an engine with topics, and what its goals ask for."""
    engine, found = Engine(), []
    engine.input_topics.set_subscriber(lambda one: found.append(tuple(one)), TOPICS)
    return engine, found


def test_a_goal_subscribes_a_topic_once(asked):
    engine, found = asked
    engine.load(goals="subscribe_to(right, 'std_msgs/Bool', bumper_right)\nsubscribe_to(scan, 'a/msg/B')")
    assert engine.call("""subscribe_to("/right", "std_msgs/Bool", bumper_right)""")
    assert engine.call("subscribe_to(right, 'std_msgs/msg/Bool', bumper_right)")
    assert engine.call("subscribe_to(said, 'std_msgs/String'), subscribe_to(left, 'std_msgs/Bool', bump)")
    assert found == [("right", "std_msgs/Bool", "bumper_right"), ("scan", "a/B", "")]
    joined = engine.input_topics.merge_with(TOPICS)
    assert joined.subscribed == (
        *TOPICS.subscribed,
        topic_type("right", "std_msgs/Bool"),
        topic_type("scan", "a/B"),
    )
    assert joined.event_name_of("right") == "bumper_right"


@pytest.mark.parametrize(
    ("goal", "said"),
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
def test_what_cannot_be_subscribed_is_an_error_of_the_goal(asked, goal, said):
    engine, found = asked
    with pytest.raises(RetalisError) as error:
        engine.call(goal)
    assert said in str(error.value)
    assert engine.call(f"catch({goal}, _, true)")
    assert found == []


def test_goals_subscribe_no_more_than_so_many(asked):
    engine, found = asked
    with pytest.raises(RetalisError, match="goals subscribe to at most 1000 topics"):
        engine.call("between(0, 2000, N), atom_concat(t, N, T), subscribe_to(T, 'std_msgs/Bool'), fail")
    assert len(found) == 1000


def test_an_engine_without_topics_says_so(caplog):
    engine = Engine()
    with caplog.at_level(logging.WARNING, "retalis"):
        engine.load(goals="subscribe_to(left, 'std_msgs/Bool', bump)", rules="hit <- bump(true).")
    (record,) = caplog.records
    assert "topic left is not subscribed: there are no topics here" in record.getMessage()


def test_slots_by_name_of_events_that_a_goal_names(asked):
    engine, _ = asked
    engine.load(goals="subscribe_to(right, 'std_msgs/Bool', right)", rules="hit(X) <- right{data: X}.")
    happened = []
    engine.on_event(lambda term, start, end: happened.append(str(term[1])))
    engine.event("right(true)", 1)
    assert len(happened) == 2


def test_reloading_subscribes_what_is_new_and_refuses_another_type(tmp_path, asked):
    engine, found = asked
    goals = tmp_path / "goalPredicates.txt"
    goals.write_text("subscribe_to(a, 'std_msgs/Bool', x)\n")
    engine.load_program(tmp_path)
    goals.write_text("subscribe_to(a, 'std_msgs/Bool', x)\nsubscribe_to(b, 'std_msgs/Bool')\n")
    engine.reload(tmp_path)
    goals.write_text("subscribe_to(a, 'std_msgs/Int8', x)\nsubscribe_to(c, 'std_msgs/Bool')\n")
    with pytest.raises(RetalisError, match="it is subscribed already as std_msgs/Bool, with events called x"):
        engine.reload(tmp_path)
    assert found == [("a", "std_msgs/Bool", "x"), ("b", "std_msgs/Bool", "")]


def test_events_of_such_topics_are_made(tmp_path):
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
    found = [
        str(one.problem).split("\n")[0].partition(" [RT")[0] for one in check_program(tmp_path, Definitions())
    ]
    assert [one.partition(f"{tmp_path}/")[2] for one in found] == [
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
    """An engine with its default clock, and what it has derived and reported."""

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
    assert warning.startswith("event tick: its time is 365 days ahead of the clock")
    assert run.engine.event_input.far_ahead_count == 1


def test_first_stamp_far_ahead_is_given_up():
    expected = FarStamps().run(range(100))
    counts = FarStamps().run(range(100), {0: YEAR})
    assert counts["last_10"] >= 99
    for name in ("pair", "silent", "beat"):
        assert counts[name] >= expected[name] - 1, name


@pytest.mark.parametrize("offset", [3600, 40 * 86_400, 20 * YEAR])
def test_stream_with_another_date_is_processed_as_any(offset):
    run = FarStamps()
    shifted = FarStamps()
    shifted_engine = shifted.engine
    for second in range(50):
        for event, fraction in (("tick", 0), ("left", 0.1), ("right", 0.2)):
            run.engine.event(event, START + second + fraction)
            shifted_engine.event(event, START + offset + second + fraction)
    assert {**shifted.counts, "beat": 0} == {**run.counts, "beat": 0}
    assert shifted.warnings == []


def test_second_event_far_ahead_confirms_first_one():
    run = FarStamps("late <- left seq absent(right, 5).")
    run.engine.event("tick", START)
    run.engine.event("left", START + 1)
    run.engine.event("tick", START + YEAR)
    assert run.counts["late"] == 0
    run.engine.event("tick", START + YEAR + 1)
    assert run.counts["late"] == 1
    assert run.engine.clock.now() == (START + YEAR + 1) * SECOND


def test_source_with_another_date_moves_clock_after_three_events():
    run = FarStamps("late(X) <- in(X) seq absent(never, 1).")
    for second in range(10):
        run.engine.event("tick", START + second)
        run.engine.event("in(1)", START + YEAR + second)
    assert run.counts["late"] >= 6
    assert run.engine.event_input.far_ahead_count == 2


def test_window_on_receipt_clock_reports_stamp_ahead():
    clock = StreamClock(START * SECOND)
    engine = Engine(clock)
    warnings = []
    engine.rules.on_warning = lambda warning: warnings.append(warning.message)
    engine.load(rules="n(N) <- aggregate(count, tick, N, every(5, first)).")
    engine.event("tick", START)
    engine.event("tick", START + 60)
    assert len(warnings) == 1
    assert "an event is too far ahead of the clock" in warnings[0]
