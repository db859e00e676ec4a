"""Playback of bags: topics, types, times, outputs, and reported problems."""

import logging
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Dict, Iterator, List, Optional, Tuple

import pytest
from asserting_accessors import fail
from logging_handlers import RecordingHandler
from parsing import parse_term

from retalis import (
    BagError,
    BagReader,
    BagWriter,
    Definitions,
    Engine,
    Playback,
    Settings,
    TopicType,
    atom,
    deref,
)
from retalis.events.program.topic_configuration import ANY_QUALITY
from retalis.events.rules import program_timers
from retalis.messages.cdr_encoder import CdrEncoder
from retalis.messages.type_definition import HEADER, SEPARATOR
from retalis.playback.bag_locations import open_bag
from retalis.playback.mcap_writer import McapWriter
from retalis.playback.playback import MAX_RECORDED_QUERIES, RunRecorder
from retalis.prolog.syntax.event_text import to_text

SECOND = 10**9
POINT = "float64 x\n"
STAMPED = (
    "Header header\nfloat64 x\n"
    + "=" * 80
    + "\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
)


@pytest.fixture
def definitions() -> Definitions:
    definitions = Definitions()
    definitions.add("my_msgs/Point", POINT)
    definitions.add("my_msgs/Stamped", STAMPED)
    definitions.add("my_msgs/Empty", "")
    return definitions


@pytest.fixture
def program(tmp_path: Path) -> Any:
    folder = tmp_path / "program"
    folder.mkdir()

    def write(rules: Any, goals: str = "", topics: str = "") -> Any:
        (folder / "eventRules.txt").write_text(rules)
        (folder / "goalPredicates.txt").write_text("compile_event_file('eventRules.txt')\n" + goals)
        (folder / "pub_sub.xml").write_text(f"<publish_subscribe>{topics}</publish_subscribe>")
        return folder

    return write


@pytest.fixture
def bag(tmp_path: Path, definitions: Definitions) -> Any:
    def write(*messages: Any) -> Any:
        path = tmp_path / "some.bag"
        with BagWriter(path) as writer:
            connections: Dict[Any, Any] = {}
            for time, topic, type_name, text in messages:
                if topic not in connections:
                    connections[topic] = writer.add(topic, definitions.find(type_name))
                writer.write(
                    connections[topic], time, definitions.encoder(type_name).encode(parse_term(text))
                )
        return path

    return write


def run(program: Any, path: Any, **options: Any) -> Any:
    problems: List[Any] = []
    handler = RecordingHandler(problems)
    logging.getLogger("retalis").addHandler(handler)
    try:
        return play(program, path, problems, **options)
    finally:
        logging.getLogger("retalis").removeHandler(handler)


def play(program: Any, path: Any, problems: Any, **options: Any) -> Tuple[Any, ...]:
    playback = Playback(program, problems.append, **options)
    events: List[Any] = []
    playback.engine.on_event(lambda event, start, end: events.append((to_text(event), start, end)))
    with BagReader(path) as reader:
        outputs = list(playback.run(reader))
    return outputs, events, [str(problem) for problem in problems]


def points(*seconds: Any, topic: str = "/in") -> List[Tuple[Any, ...]]:
    """Return a message ``my_msgs/Point`` for each second, which is also its value."""
    return [(second * SECOND, topic, "my_msgs/Point", f"my_msgs__0__Point({second}.0)") for second in seconds]


IN = '<subscribe_to name="in" msg_type="my_msgs/Point"/>'
OUT = '<publish_to name="out" msg_type="my_msgs/Point"/>'


def test_growth_of_heap_is_checked_for_each_message(
    program: Any, bag: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    checks: List[bool] = []
    monkeypatch.setattr("retalis.playback.playback.collect_if_grown", lambda: checks.append(True))
    run(program("", topics=IN), bag(*points(1, 2, 3)))
    assert len(checks) == 3


def test_outputs_for_messages_are_messages(program: Any, bag: Any, definitions: Definitions) -> None:
    path = bag((7 * SECOND, "/in", "my_msgs/Point", "my_msgs__0__Point(6.5)"))
    goals = "subscribe(my_msgs__0__Point(X), [Y is X * 2], my_msgs__0__Point(Y), out, 1)"
    outputs, events, problems = run(program("", goals, IN + OUT), path)
    assert problems == []
    assert events == [("my_msgs__0__Point(6.5)", 7 * SECOND, 7 * SECOND)]
    (output,) = outputs
    assert (output.topic, output.time, output.definition.name) == ("out", 7 * SECOND, "my_msgs/Point")
    decoded = deref(definitions.decoder("my_msgs/Point").decode(output.data))
    assert decoded == parse_term("my_msgs__0__Point(13.0)")


def test_trailing_slash_of_topic_is_ignored(program: Any, bag: Any, definitions: Definitions) -> None:
    path = bag((7 * SECOND, "/in", "my_msgs/Point", "my_msgs__0__Point(6.5)"))
    goals = "subscribe(my_msgs__0__Point(X), [], my_msgs__0__Point(X), '/out', 1)"
    topics = IN.replace('"in"', '"/in/"') + OUT.replace('"out"', '"/out/"')
    outputs, events, problems = run(program("", goals, topics), path)
    assert (problems, len(events), len(outputs)) == ([], 1, 1)
    assert outputs[0].definition.name == "my_msgs/Point"


def test_nonzero_header_stamp_is_event_time(program: Any, bag: Any) -> None:
    text = "my_msgs__0__Stamped(std_msgs__0__Header(1,[{},{}],'\"f\"'),1.0)"
    path = bag(
        (7 * SECOND, "/in", "my_msgs/Stamped", text.format(3, 4)),
        (8 * SECOND, "/in", "my_msgs/Stamped", text.format(0, 0)),
    )
    topics = '<subscribe_to name="/in" msg_type="my_msgs/Stamped"/>'
    _, events, problems = run(program("", "", topics), path)
    assert problems == []
    assert [(start, end) for _, start, end in events] == [(3 * SECOND + 4,) * 2, (8 * SECOND,) * 2]


def test_unnamed_topic_is_played_only_on_request(program: Any, bag: Any) -> None:
    path = bag((SECOND, "/other", "my_msgs/Point", "my_msgs__0__Point(1.0)"))
    folder = program("", "", IN)
    assert run(folder, path)[1] == []
    assert len(run(folder, path, topics=[TopicType("other", "my_msgs/msg/Point")])[1]) == 1


@pytest.fixture
def tf_bag(bag: Any, definitions: Definitions) -> Any:
    definitions.add("tf/tfMessage", "float64[] transforms\n")
    return bag(
        (SECOND, "/tf", "tf/tfMessage", "tf__0__tfMessage([1.0])"),
        (2 * SECOND, "/in", "my_msgs/Point", "my_msgs__0__Point(1.0)"),
    )


@pytest.mark.parametrize(
    ("options", "event_count"),
    [
        ({}, 2),
        ({"direct": "auto"}, 2),
        ({"direct": True}, 2),
        ({"direct": False}, 1),
        ({"direct": (TopicType("tf", "tf/tfMessage"),)}, 2),
        ({"direct": ()}, 1),
    ],
)
def test_direct_topics_are_played(program: Any, tf_bag: Any, options: Any, event_count: int) -> None:
    _, events, problems = run(program("", "", IN), tf_bag, **options)
    assert len(events) == event_count
    assert problems == []  # the default topic ar_pose_marker may be missing


def test_named_direct_topic_has_no_second_event(program: Any, tf_bag: Any) -> None:
    named = IN + '<subscribe_to name="/tf" msg_type="tf/tfMessage" event="moved"/>'
    for direct in ("auto", True, False):
        _, events, _ = run(program("", "", named), tf_bag, direct=direct)
        assert [event for event, _, _ in events] == ["moved([1.0])", "my_msgs__0__Point(1.0)"]


def test_missing_direct_topic_is_reported(program: Any, tf_bag: Any) -> None:
    _, _, problems = run(program("", "", IN), tf_bag, direct=(TopicType("scan", "my_msgs/Point"),))
    (problem,) = problems
    assert "has no messages on scan" in problem


def test_goal_cannot_change_type_of_direct_topic(program: Any, tf_bag: Any) -> None:
    goal = "subscribe_to(tf, 'my_msgs/Point')"
    _, _, (problem, *_) = run(program("", goal, IN), tf_bag)
    assert "subscribed already as tf/tfMessage" in problem
    assert run(program("", goal, IN), tf_bag, direct=False)[2] != []


def test_other_type_of_default_topic_is_a_warning(program: Any, bag: Any) -> None:
    path = bag(
        (SECOND, "/tf", "my_msgs/Point", "my_msgs__0__Point(1.0)"),
        (2 * SECOND, "/in", "my_msgs/Point", "my_msgs__0__Point(1.0)"),
    )
    reported: List[Any] = []
    with BagReader(path) as reader:
        list(Playback(program("", "", IN), reported.append).run(reader))
    assert reported == []
    _, _, problems = run(program("", "", IN), path)
    assert "1 message dropped" in problems[0]


def test_type_has_name_of_program(program: Any, bag: Any) -> None:
    path = bag((SECOND, "/in", "my_msgs/Point", "my_msgs__0__Point(1.0)"))
    _, events, problems = run(program("", "", IN.replace("my_msgs/Point", "other_msgs/Dot")), path)
    assert problems == [
        "topic /in is requested as other_msgs/Dot, which is unknown here; the bag has my_msgs/Point, "
        "which is used instead"
    ]
    assert [event for event, _, _ in events] == ["other_msgs__0__Dot(1.0)"]


def test_type_without_slots_has_events(program: Any, bag: Any) -> None:
    path = bag((SECOND, "/in", "my_msgs/Empty", "my_msgs__0__Empty"))
    _, events, problems = run(program("", "", IN.replace("Point", "Empty")), path)
    assert problems == []
    assert [event for event, _, _ in events] == ["my_msgs__0__Empty"]


def test_other_type_than_subscribed_is_reported(program: Any, bag: Any) -> None:
    path = bag(*points(1, 2))
    _, events, problems = run(program("", "", IN.replace("my_msgs/Point", "std_msgs/Float32")), path)
    assert events == []
    assert problems == ["topic /in: expected std_msgs/Float32, found my_msgs/Point; 2 messages dropped"]


def test_missing_topics_are_reported_once(program: Any, bag: Any) -> None:
    path = bag((SECOND, "/in", "my_msgs/Point", "my_msgs__0__Point(1.0)"))
    topics = IN + IN.replace('"in"', '"/ni"')
    _, events, problems = run(program("", "", topics), path, topics=[TopicType("no", "my_msgs/Point")])
    assert len(events) == 1
    assert problems == [f"{path} has no messages on /ni, no; it has /in (my_msgs/Point)"]


def test_invalid_outputs_are_counted(program: Any, bag: Any) -> None:
    path = bag(*points(*range(1, 8)))
    goals = "subscribe(my_msgs__0__Point(X), [Y = a(X)], my_msgs__0__Point(Y), out, 1)"
    outputs, _, problems = run(program("", goals, IN + OUT), path)
    assert [output.data for output in outputs] == [None] * 7
    first = "topic out, my_msgs/Point, slot x: expected float64, got a/1"
    at_load, *at_run = problems
    assert "RT1106" in at_load
    assert at_run == [first, f"7 times in all: {first}"]


def test_invalid_goals_do_not_stop_others(program: Any, bag: Any) -> None:
    path = bag(*points(1, 2))
    goals = (
        "subscribe(my_msgs__0__Point(X), [], my_msgs__0__Point(no), out, 1)\n"
        "subscribe(my_msgs__0__Point(X), [], _, nowhere, 2)\n"
        "subscribe(my_msgs__0__Point(X), [], _, out, 3)\n"
        "fail\n"
    )
    outputs, events, problems = run(program("", goals, IN + OUT), path)
    assert len(events) == 2
    assert sum(output.data is not None for output in outputs) == 2
    assert "goalPredicates.txt:5:1" in problems[0]
    assert any("topic out" in problem and "x" in problem for problem in problems)
    assert any("nowhere" in problem for problem in problems)


def test_alarms_follow_time_of_bag(program: Any, bag: Any) -> None:
    path = bag(*points(1, 2, 9))
    _, events, problems = run(program("exceptionAlarm(late(X), 3) <- my_msgs__0__Point(X).", "", IN), path)
    assert problems == []
    assert [event for event, _, _ in events] == [
        "my_msgs__0__Point(1.0)",
        "my_msgs__0__Point(2.0)",
        "late(1.0)",
        "late(2.0)",
        "my_msgs__0__Point(9.0)",
    ]


def test_alarm_fires_at_its_own_time(program: Any, bag: Any) -> None:
    path = bag(*points(1, 9))
    rules = (
        "exceptionAlarm(late(X), 3) <- my_msgs__0__Point(X).\n"
        "null do event(seen(X)) <- late(X).\n"
        "exceptionAlarm(later(X), 2) <- seen(X).\n"
        "null do event(my_msgs__0__Point(X)) <- later(X) where X < 5."
    )
    goals = "subscribe(seen(X), [], my_msgs__0__Point(X), out, 1)"
    outputs, events, problems = run(program(rules, goals, IN + OUT), path)
    assert problems == []
    assert [output.time for output in outputs] == [4 * SECOND, 9 * SECOND]
    assert ("seen(1.0)", 4 * SECOND, 4 * SECOND) in events
    assert ("my_msgs__0__Point(1.0)", 6 * SECOND, 6 * SECOND) in events


def test_output_precedes_next_message(program: Any, bag: Any) -> None:
    path = bag(*points(1, 2, 3))
    goals = "subscribe(my_msgs__0__Point(X), [X < 3], _, out, 1)"
    message_counts: List[Any] = []
    outputs: List[Any] = []
    playback = Playback(program("", goals, IN + OUT), report=fail)
    with BagReader(path) as reader:
        for output in playback.run(reader, message_counts.append):
            outputs.append((output.time // SECOND, playback.clock.now() // SECOND, message_counts[-1]))
    assert outputs == [(1, 1, 1), (2, 2, 2)]
    assert message_counts == [1, 2, 3]


def test_damage_is_reported_after_earlier_messages(
    program: Any, bag: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = bag(*points(1, 2, 3))
    playback = Playback(program("", "", IN), report=fail)
    starts: List[Any] = []
    playback.engine.on_event(lambda event, start, end: starts.append(start))
    with BagReader(path) as reader:
        undamaged_records = reader.records

        def records(topics: Any, **options: Any) -> Iterator[Any]:
            yield from list(undamaged_records(topics, **options))[:2]
            raise BagError("the rest cannot be read")

        monkeypatch.setattr(reader, "records", records)
        with pytest.raises(BagError, match="the rest cannot be read"):
            list(playback.run(reader))
    assert starts == [SECOND, 2 * SECOND]
    assert playback.engine.query("true") == [{}]


TIMERS = """
timer(tick, every(2))
timer(once, after(3))
timer(noon, at(datime(1970,1,1,0,0,7,0)))
"""


def test_timers_fire_as_for_event_stream(program: Any, bag: Any) -> None:
    rules = "next(X) <- tick seq my_msgs__0__Point(X)."
    seconds = (1.5, 2, 5, 9)
    path = bag(
        *(
            (int(second * SECOND), "/in", "my_msgs/Point", f"my_msgs__0__Point({second:.1f})")
            for second in seconds
        ),
    )
    _, events, problems = run(program(rules, TIMERS, IN), path)
    assert problems == []
    engine, stream_events = Engine(), []
    engine.load(rules=rules, goals=TIMERS)
    engine.on_event(lambda *event: stream_events.append((engine.show(event[0]), *event[1:])))
    for second in seconds:
        engine.event(f"my_msgs__0__Point({second:.1f})", second)
    assert len(stream_events) == 12
    assert events == stream_events


def test_timer_events_in_gap_are_limited(program: Any, bag: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(program_timers, "MAX_FIRINGS_PER_JUMP", 100)
    path = bag(*points(10, 20, 5000, 5003))
    _, events, (problem,) = run(program("null <- tick.", "timer(tick, every(1))", IN), path)
    assert "4979 events of timer tick, every(1) left out" in problem
    assert [start // SECOND for event, start, _ in events if event == "tick"] == [
        *range(11, 21),
        *range(5000, 5004),
    ]


@pytest.mark.parametrize(("limit", "event_count"), [(None, 5), (100.0, 4)])
def test_stamp_far_ahead_is_reported_and_dropped(
    program: Any, bag: Any, limit: Optional[float], event_count: int
) -> None:
    folder = program("", topics='<subscribe_to name="/s" msg_type="my_msgs/Stamped"/>')
    stamps = [10, 11, 3612, 13, 14]
    messages = [
        (
            (second + 1) * SECOND,
            "/s",
            "my_msgs/Stamped",
            f"my_msgs__0__Stamped(std_msgs__0__Header(0,[{stamp},1],'\"map\"'),1.0)",
        )
        for second, stamp in enumerate(stamps)
    ]
    _, events, problems = run(folder, bag(*messages), max_skew=limit)
    assert len(events) == event_count
    assert [problem for problem in problems if "no goal" not in problem] == [
        "topic /s, frame map: a stamp is 3600 s ahead of the stamps before it"
        + ("; such messages are dropped" if limit else "")
    ]


def test_events_have_event_name_of_topic(program: Any, bag: Any) -> None:
    line = '<subscribe_to name="{}" msg_type="my_msgs/Point" {}/>'
    topics = line.format("left", 'event="bumper_left"') + line.format("/right", 'event=" bumper_right "')
    folder = program(
        "hit(X) <- bumper_left(X) seq bumper_right(X).\n"
        "both(X) <- bumper_left(X) where access_mem(rights, bumper_right(X), _).",
        "memorize(bumper_right(_), [], _, rights, 5)",
        topics + line.format("middle", ""),
    )
    messages = [("/left", 1.0), ("right", 1.0), ("middle", 1.0), ("left", 1.0)]
    path = bag(
        *(
            (second * SECOND, topic, "my_msgs/Point", f"my_msgs__0__Point({x})")
            for second, (topic, x) in enumerate(messages, 1)
        )
    )
    _, events, problems = run(folder, path)
    assert [text for text, _, _ in events if not text.startswith("memory_")] == [
        "bumper_left(1.0)",
        "bumper_right(1.0)",
        "hit(1.0)",
        "my_msgs__0__Point(1.0)",
        "bumper_left(1.0)",
        "both(1.0)",
    ]
    assert problems == []


def test_slots_of_types_in_bag_can_be_named(program: Any, bag: Any) -> None:
    path = bag(
        (SECOND, "/in", "my_msgs/Stamped", "my_msgs__0__Stamped(std_msgs__0__Header(1,[3,4],'\"f\"'),1.0)")
    )
    topics = '<subscribe_to name="in" msg_type="my_msgs/Stamped" event="fix"/>'
    folder = program("at(F, X) <- fix{x: X, header: {frame_id: F}}.", "", topics + OUT)
    problems: List[Any] = []
    outputs: List[Any] = []
    with BagReader(path) as reader:
        playback = Playback(folder, problems.append, bag=reader)
        playback.engine.on_event(lambda event, start, end: outputs.append(to_text(event)))
        assert list(playback.run(reader)) == []
    assert problems == []
    assert outputs[1:] == ["at('\"f\"',1.0)"]
    Playback(folder, problems.append)
    assert "the slots of my_msgs/Stamped are not known when this is read" in str(problems)


def test_goals_subscribe_at_start_and_later(program: Any, bag: Any) -> None:
    path = bag(
        *points(1, topic="a"),
        *points(2, 4, topic="b"),
        *points(3, 6, topic="in"),
        *points(5, 8, topic="c"),
        *points(9, topic="d"),
    )
    folder = program(
        "now <- my_msgs__0__Point(3.0) do subscribe_to(b, 'my_msgs/Point', at_b).\n"
        "exceptionAlarm(rung, 1) <- my_msgs__0__Point(6.0).\n"
        "more <- rung do (subscribe_to('/c', 'my_msgs/Point'), subscribe_to(none, 'my_msgs/Point')).",
        "subscribe_to('/a', 'my_msgs/Point', at_a)",
        IN,
    )
    _, events, problems = run(folder, path)
    assert [(text, end // SECOND) for text, _, end in events] == [
        ("at_a(1.0)", 1),
        ("my_msgs__0__Point(3.0)", 3),
        ("now", 3),
        ("at_b(4.0)", 4),
        ("my_msgs__0__Point(6.0)", 6),
        ("rung", 7),
        ("more", 7),
        ("my_msgs__0__Point(8.0)", 8),
    ]
    (problem,) = problems
    assert "has no messages on none; it has a (my_msgs/Point)" in problem


def test_restored_program_keeps_subscribed_topics(program: Any, bag: Any) -> None:
    path = bag((SECOND, "/a", "my_msgs/Point", "my_msgs__0__Point(1.0)"))
    folder = program("", "subscribe_to('/a', 'my_msgs/Point', at_a)")
    problems: List[Any] = []
    events: List[Any] = []
    with BagReader(path) as reader:
        state = Playback(folder, problems.append, bag=reader).engine.snapshot()
        playback = Playback(folder, problems.append, bag=reader, state=state)
        playback.engine.on_event(lambda event, start, end: events.append(to_text(event)))
        list(playback.run(reader))
    assert (problems, events) == ([], ["at_a(1.0)"])


def test_interrupted_call_fails_when_restored_program_plays(program: Any, bag: Any) -> None:
    path = bag((SECOND, "/in", "my_msgs/Point", "my_msgs__0__Point(1.0)"))
    goals = "ros_service('/dock', 'std_srvs/Trigger', std_srvs__0__Trigger_Request, a)"
    folder = program("", goals, IN)
    events: List[Any] = []
    with BagReader(path) as reader:
        first = Playback(folder, fail, prepare=lambda engine: engine.on_service_call(lambda call: None))
        playback = Playback(folder, fail, bag=reader, state=first.engine.snapshot())
        playback.engine.on_event(lambda event, start, end: events.append(to_text(event)))
        list(playback.run(reader))
    assert events == [
        "service_failed('/dock',a,'the program ended before the reply')",
        "my_msgs__0__Point(1.0)",
    ]


def test_output_type_is_found_in_bag(program: Any, bag: Any) -> None:
    path = bag((SECOND, "/in", "my_msgs/Point", "my_msgs__0__Point(1.0)"))
    goals = "subscribe(my_msgs__0__Point(X), [], my_msgs__0__Point(X), out, 1)"
    folder = program("", goals, IN + OUT)
    problems: List[Any] = []
    # Without argument `bag`, the types of the bag are known when it is played.
    outputs, _, _ = play(folder, path, problems)
    assert [output.definition.name for output in outputs] == ["my_msgs/Point"]
    assert [output.data is not None for output in outputs] == [True]


def test_output_has_slots_of_ros2_bag(tmp_path: Path) -> None:
    pytest.importorskip("mcap")
    text = "Header header\nuint8 kind\nfloat32 a\nfloat32 b\nfloat32 c\nfloat32 range\nfloat32 variance\n"
    definition = Definitions().add(
        "sensor_msgs/Range", f"{text}{SEPARATOR}\nMSG: {HEADER}\nuint32 seq\ntime stamp\nstring frame_id\n"
    )
    term = parse_term("sensor_msgs__0__Range(std_msgs__0__Header(0,[1,0],'\"a\"'),0,0.5,0.5,0.5,0.5,0.25)")
    with McapWriter(tmp_path / "in.mcap") as writer:
        topic = writer.add("/sonar", definition, ANY_QUALITY)
        writer.write(topic, 1, CdrEncoder(definition).encode(term))
    folder = tmp_path / "republish"
    folder.mkdir()
    (folder / "pub_sub.xml").write_text(
        '<publish_subscribe><subscribe_to name="sonar" msg_type="sensor_msgs/Range"/>'
        '<publish_to name="again" msg_type="sensor_msgs/Range"/></publish_subscribe>'
    )
    goal = "subscribe(sensor_msgs__0__Range(_,_,_,_,_,_,_), [], _, again, a)\n"
    (folder / "goalPredicates.txt").write_text(goal)
    with open_bag(tmp_path / "in.mcap") as bag:
        (output,) = Playback(folder, fail, bag=bag).run(bag)
    assert output.data is not None


def test_output_of_unknown_type_is_an_error(program: Any, bag: Any) -> None:
    path = bag((SECOND, "/in", "my_msgs/Point", "my_msgs__0__Point(1.0)"))
    goals = "subscribe(my_msgs__0__Point(X), [], my_msgs__0__Point(X), out, 1)"
    outputs, _, problems = run(program("", goals, IN + OUT.replace("Point", "Unknown")), path)
    assert [(output.definition, output.data) for output in outputs] == [(None, None)]
    assert problems[-1].startswith("topic out: ")
    assert "my_msgs/Unknown" in problems[-1]


def test_added_topic_changes_type_not_event_name(program: Any, bag: Any) -> None:
    path = bag((SECOND, "/in", "my_msgs/Point", "my_msgs__0__Point(1.0)"))
    folder = program("", "", '<subscribe_to name="in" msg_type="std_msgs/Float32" event="spot"/>')
    _, events, problems = run(folder, path, topics=[TopicType("/in", "my_msgs/Point")])
    assert problems == []
    assert [event for event, _, _ in events] == ["spot(1.0)"]


def test_first_entry_of_topic_has_precedence(program: Any, bag: Any) -> None:
    path = bag((SECOND, "/in", "my_msgs/Point", "my_msgs__0__Point(1.0)"))
    second = '<subscribe_to name="/in" msg_type="std_msgs/Float32"/>'
    _, events, problems = run(program("", "", IN + second), path)
    assert [event for event, _, _ in events] == ["my_msgs__0__Point(1.0)"]
    (problem,) = problems
    assert "topic /in is subscribed already in line 1, as my_msgs/Point" in problem


class PendingQueries:
    """100,000 pending queries that count how many of them are read."""

    def __init__(self) -> None:
        self.read_count = 0

    def __len__(self) -> int:
        return 100_000

    def __iter__(self) -> Iterator[Any]:
        query = SimpleNamespace(create_event=lambda values: atom("answer"))
        for order in range(len(self)):
            self.read_count += 1
            yield order, query, (), None, None, []


def test_number_of_recorded_queries_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    engine = Engine()
    records: List[Any] = []
    pending_queries = PendingQueries()
    playback: Any = SimpleNamespace(engine=engine, clock=SimpleNamespace(now=lambda: 5))
    recorder = RunRecorder(playback, records.append)
    monkeypatch.setattr(engine.knowledge, "pending_queries", pending_queries)
    recorder.update_waits()
    assert pending_queries.read_count == MAX_RECORDED_QUERIES


def make_lagging_bag(bag: Any, readings: Any) -> Any:
    """Write a bag of readings (receipt in ms, stamp in ms, value)."""
    return bag(
        *(
            (
                receipt * 1_000_000,
                "readings",
                "my_msgs/Stamped",
                "my_msgs__0__Stamped(std_msgs__0__Header"
                f"(0,[{stamp // 1000},{stamp % 1000 * 1_000_000}],'\"\"'),{value})",
            )
            for receipt, stamp, value in readings
        )
    )


LAGGING_RULES = "turn(V) <- my_msgs__0__Stamped(_, V).\nalarm <- turn(1.0) seq absent(turn(2.0), 0.5)."
LAGGING_GOALS = "subscribe(alarm, [], _, alarms, a)\n"


@pytest.mark.parametrize(
    ("delay", "alarm_count"), [(None, 0), (0, 1)], ids=["by the lag of the topic", "without delay"]
)
def test_alarm_waits_for_late_messages(
    program: Any, bag: Any, delay: Optional[int], alarm_count: int
) -> None:
    folder = program(LAGGING_RULES, LAGGING_GOALS)
    readings = [(1_000_015, 1_000_000, 1.0), (1_000_505, 1_000_490, 2.0), (1_002_000, 1_001_980, 3.0)]
    with BagReader(make_lagging_bag(bag, readings)) as reader:
        playback = Playback(
            folder,
            report=print,
            topics=[TopicType("readings", "my_msgs/Stamped")],
            settings=Settings(watermark_delay=delay),
        )
        assert len(list(playback.run(reader))) == alarm_count


@pytest.mark.parametrize(("is_last", "alarm_count"), [(True, 1), (False, 0)])
def test_alarm_does_not_wait_at_end_of_last_bag(
    program: Any, bag: Any, is_last: bool, alarm_count: int
) -> None:
    folder = program(LAGGING_RULES, LAGGING_GOALS)
    readings = [(1_000_300, 1_000_000, 1.0), (1_000_600, 1_000_300, 3.0)]
    with BagReader(make_lagging_bag(bag, readings)) as reader:
        playback = Playback(folder, report=print, topics=[TopicType("readings", "my_msgs/Stamped")])
        assert len(list(playback.run(reader, is_last=is_last))) == alarm_count
