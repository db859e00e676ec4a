"""Configuration of topics: pub_sub.xml, encodings, errors, and direct topics."""

from pathlib import Path
from typing import Any

import pytest
from asserting_accessors import place_of

from retalis import Engine, ProgramErrors, PrologError, Settings, TopicType, UsageError
from retalis.events.program.topic_configuration import (
    ANY_QUALITY,
    DEFAULT_DIRECT_TOPICS,
    QualityOfService,
    TopicQuality,
    Topics,
    direct_topics,
    find_program_folder,
    quality_of,
    read_direct,
    read_text,
    read_topics,
)

APPLICATION = Path(__file__).parents[3] / "application_source"


def read_configuration(tmp_path: Path, text: str) -> Any:
    path = tmp_path / "pub_sub.xml"
    path.write_text(text, encoding="utf-8")
    return read_topics(path)


def test_configuration_of_application_is_read() -> None:
    topics = read_topics(APPLICATION / "pub_sub.xml")
    assert topics.subscribed[0] == TopicType("tf", "tf/tfMessage")
    assert TopicType("marker8", "geometry_msgs/PoseStamped") in topics.published


def test_elements_may_be_nested(tmp_path: Path) -> None:
    topics = read_configuration(
        tmp_path,
        '<publish_subscribe><group><!-- <subscribe_to name="no" msg_type="a/B"/> -->'
        '<subscribe_to name="/a/b" msg_type="std_msgs/String"/></group></publish_subscribe>',
    )
    assert topics.subscribed == (TopicType("/a/b", "std_msgs/String"),)
    assert topics.published == ()


def test_type_names_of_ros_2_are_accepted(tmp_path: Path) -> None:
    topics = read_configuration(
        tmp_path,
        '<publish_subscribe><subscribe_to name="a" msg_type="geometry_msgs/msg/Point"/>'
        '<publish_to name="b" msg_type=" geometry_msgs/msg/Pose "/></publish_subscribe>',
    )
    assert topics.subscribed == (TopicType("a", "geometry_msgs/Point"),)
    assert topics.published == (TopicType("b", "geometry_msgs/Pose"),)


def test_quality_of_service_is_read(tmp_path: Path) -> None:
    topics = read_configuration(
        tmp_path,
        '<publish_subscribe><subscribe_to name="scan" msg_type="a/B" reliability="best_effort" depth="5"/>'
        '<subscribe_to name="odom" msg_type="a/B" reliability="auto"/>'
        '<publish_to name="map" msg_type="a/B" reliability="reliable" durability="transient_local"/>'
        "</publish_subscribe>",
    )
    assert topics.subscribed_quality == (TopicQuality("scan", QualityOfService(False, None, 5)),)
    assert topics.published_quality == (TopicQuality("map", QualityOfService(True, True, None)),)
    assert quality_of(topics.subscribed_quality, "/scan", lambda topic: topic.strip("/")).depth == 5
    assert quality_of(topics.subscribed_quality, "odom") == ANY_QUALITY


@pytest.mark.parametrize(
    ("attribute", "error"),
    [
        ('reliability="strict"', 'reliability is reliable, best_effort, auto, found "strict"'),
        ('durability="latched"', 'durability is transient_local, volatile, auto, found "latched"'),
        ('depth="0"', 'depth is auto or a number from 1 to 1000000, found "0"'),
        ('depth="1000000000000"', 'depth is auto or a number from 1 to 1000000, found "1000000000000"'),
        ('depth="-1"', 'depth is auto or a number from 1 to 1000000, found "-1"'),
    ],
)
def test_invalid_quality_of_service_is_refused(tmp_path: Path, attribute: str, error: str) -> None:
    line = f'<subscribe_to name="scan" msg_type="a/B" {attribute}/>'
    with pytest.raises(ProgramErrors) as caught:
        read_configuration(tmp_path, f"<publish_subscribe>{line}</publish_subscribe>")
    assert [problem.message for problem in caught.value.errors] == [f"<subscribe_to>: {error}"]


def test_latched_topics_are_read(tmp_path: Path) -> None:
    line = '<publish_to name="{}" msg_type="std_msgs/String" latch="{}"/>'
    lines = [line.format("plain", "false"), line.format("kept", "true"), line.format("also", " true ")]
    topics = read_configuration(tmp_path, f"<publish_subscribe>{''.join(lines)}</publish_subscribe>")
    assert [topic.topic for topic in topics.published] == ["plain", "kept", "also"]
    assert topics.latched == {"kept", "also"}


def test_event_names_of_topics_are_read(tmp_path: Path) -> None:
    line = '<subscribe_to name="{}" msg_type="std_msgs/Bool" {}/>'
    lines = [
        line.format("left", 'event="bumper_left"'),
        line.format("/right", 'event=" bumper_right "'),
        line.format("other", ""),
        line.format("other", 'event="second"'),  # refused at the subscription, because the topic has one
    ]
    topics = read_configuration(tmp_path, f"<publish_subscribe>{''.join(lines)}</publish_subscribe>")
    assert [topics.event_name_of(topic) for topic in ("left", "/right", "right", "other", "nowhere")] == [
        "bumper_left",
        "bumper_right",
        "",
        "",
        "",
    ]
    assert topics.event_name_of("right", lambda topic: topic.lstrip("/")) == "bumper_right"


@pytest.mark.parametrize(
    ("event", "message"),
    [
        ("", "expected a name of ASCII letters"),
        ("Bumper", "the name of an event begins with a small letter, found Bumper"),
        ("bumper left", "expected a name of ASCII letters"),
        ("std_msgs__0__Bool", "choose a name without __0__"),
        ("seq", "seq has a fixed meaning in rules"),
        ("rev", "rev has a fixed meaning in rules"),
    ],
)
def test_invalid_event_name_is_refused(tmp_path: Path, event: str, message: str) -> None:
    line = f'<subscribe_to name="left" msg_type="std_msgs/Bool" event="{event}"/>'
    with pytest.raises(ProgramErrors) as caught:
        read_configuration(tmp_path, f"<publish_subscribe>{line}</publish_subscribe>")
    (error,) = caught.value.errors
    assert message in error.message
    assert place_of(error).line == 1


@pytest.mark.parametrize(
    ("text", "message", "line", "column"),
    [
        (
            '<publish_subscribe><publish_to name="x" msg_type="a/B" latch="on"/></publish_subscribe>',
            '<publish_to>: latch is "true" or "false", found "on"',
            1,
            20,
        ),
        (
            "<publish_subscribe>\n  <group>\n",
            "not XML: no element found; <group> of line 2 is not closed",
            3,
            1,
        ),
        ("<publish_subscribe>\n  <group>\n</publish_subscribe>", "<group> of line 2 is not closed", 3, 3),
        ("<root/>", "the root must be <publish_subscribe>, found <root>", 1, 1),
        ('<publish_subscribe>\n <publish_to name="x"/>\n</publish_subscribe>', 'needs msg_type="..."', 2, 2),
        (
            '<publish_subscribe><publish_to name="x" msg_type="String"/></publish_subscribe>',
            'expected a message type "package/Type"',
            1,
            20,
        ),
        (
            '<publish_subscribe><observe_action name="x" msg_type="a/B"/></publish_subscribe>',
            '<observe_action> needs action_type="..."',
            1,
            20,
        ),
        (
            '<publish_subscribe><observe_actions name="x" action_type="a/B"/></publish_subscribe>',
            "found <observe_actions>; did you mean observe_action?",
            1,
            20,
        ),
        (
            '<publish_subscribe>\n<observe_action name="x y" action_type="a/B"/></publish_subscribe>',
            "<observe_action>: expected a topic name",
            2,
            1,
        ),
        (
            '<publish_subscribe><observe_service name="x" srv_type="B"/></publish_subscribe>',
            "<observe_service>: expected a message type",
            1,
            20,
        ),
        (
            '<publish_subscribe><observe_action name="x" action_type="a/B" event="X"/></publish_subscribe>',
            "<observe_action>: the name of an event begins with a small letter, found X",
            1,
            20,
        ),
        (
            '<publish_subscribe><subscibe_to name="x" msg_type="a/B"/></publish_subscribe>',
            "found <subscibe_to>; did you mean subscribe_to?",
            1,
            20,
        ),
    ],
)
def test_error_has_position(tmp_path: Path, text: str, message: str, line: int, column: int) -> None:
    with pytest.raises(ProgramErrors) as caught:
        read_configuration(tmp_path, text)
    (error,) = caught.value.errors
    assert message in error.message
    assert (place_of(error).line, place_of(error).column) == (line, column)


def test_action_has_topic_for_each_event(tmp_path: Path) -> None:
    topics = read_configuration(
        tmp_path,
        '<publish_subscribe><observe_action name="dock" action_type="lab/action/Dock"/>'
        '<observe_action name="undock" action_type="lab/Dock" event="undock"/></publish_subscribe>',
    )
    assert topics.subscribed[:5] == (
        TopicType("dock/goal", "lab/Dock__goal"),
        TopicType("dock/cancel", "lab/Dock__cancel"),
        TopicType("dock/feedback", "lab/Dock__feedback"),
        TopicType("dock/status", "lab/Dock__status"),
        TopicType("dock/result", "lab/Dock__result"),
    )
    assert topics.event_name_of("dock/status") == ""
    assert topics.event_name_of("undock/status") == "undock__status"


def test_service_has_topic_of_its_events(tmp_path: Path) -> None:
    topics = read_configuration(
        tmp_path,
        '<publish_subscribe><observe_service name="/go" srv_type="lab/srv/Go" event="go"/></publish_subscribe>',
    )
    assert topics.subscribed == (TopicType("/go/_service_event", "lab/Go_Event"),)
    assert topics.event_name_of("/go/_service_event") == "go"


def test_all_errors_are_reported(tmp_path: Path) -> None:
    with pytest.raises(ProgramErrors) as caught:
        read_configuration(tmp_path, "<publish_subscribe><publish_to/><subscribe_to/></publish_subscribe>")
    assert len(caught.value.errors) == 2


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="nothing.xml"):
        read_topics(tmp_path / "nothing.xml")


def test_invalid_utf_8_is_reported_with_line(tmp_path: Path) -> None:
    path = tmp_path / "latin.txt"
    path.write_bytes("a.\nb. % gr\u00fcn\n".encode("latin-1"))
    with pytest.raises(UsageError, match=r"latin.txt: not UTF-8 text \(line 2: invalid start byte 0xfc\)"):
        read_text(path)
    engine = Engine(settings=Settings(folders=(str(tmp_path),)))
    with pytest.raises(PrologError, match=r"not UTF-8 text \(line 2: invalid start byte 0xfc\)"):
        engine.call(f"compile_event_file('{path}')")


@pytest.mark.parametrize("encoding", ["ISO-8859-1", "iso-8859-15", "windows-1252", "US-ASCII", "UTF-8"])
def test_declared_encoding_is_used(tmp_path: Path, encoding: str) -> None:
    comment = "" if encoding == "US-ASCII" else "gr\u00fcn"
    path = tmp_path / "pub_sub.xml"
    text = (
        f"<?xml version='1.0' encoding='{encoding}'?>\n<publish_subscribe><!-- {comment} -->"
        '<subscribe_to name="a" msg_type="std_msgs/String"/></publish_subscribe>'
    )
    path.write_text(text, encoding=encoding)
    assert read_topics(path).subscribed == (TopicType("a", "std_msgs/String"),)


def test_unknown_or_wrong_encoding_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "pub_sub.xml"
    path.write_bytes(b'<?xml version="1.0" encoding="utf-7"?><publish_subscribe/>')
    with pytest.raises(UsageError, match="its encoding 'utf-7' is unknown: expected utf-8 or us-ascii or"):
        read_topics(path)
    path.write_bytes(b'<?xml version="1.0" encoding="us-ascii"?>\n<!-- \xfc --><publish_subscribe/>')
    with pytest.raises(UsageError, match="not ASCII text .line 2: ordinal not in range"):
        read_topics(path)


@pytest.mark.parametrize("name", ["a\0b", f"{chr(0xD800)}.txt", "x" * 10_000])
def test_invalid_file_name_is_reported(tmp_path: Path, name: str) -> None:
    with pytest.raises(UsageError, match="cannot read "):
        read_text(tmp_path / name)
    with pytest.raises(UsageError, match="cannot read "):
        Engine().load_program(tmp_path / name)


def xml_errors(tmp_path: Path, text: str) -> Any:
    file = tmp_path / "pub_sub.xml"
    file.write_text(text)
    with pytest.raises(ProgramErrors) as caught:
        read_topics(file)
    return caught.value.errors


def test_first_errors_are_shown_and_others_counted(tmp_path: Path) -> None:
    text = "<publish_subscribe>" + "<publish_to/>\n" * 30_000 + "</publish_subscribe>"
    errors = xml_errors(tmp_path, text)
    assert [error.place.line for error in errors[:-1]] == list(range(1, 101))
    assert str(errors[-1]) == "there are 29900 more"


@pytest.mark.parametrize(
    ("text", "message", "line"),
    [
        ('<!DOCTYPE a [<!ENTITY b "bb"><!ENTITY c "&b;&b;">]>\n<a>&c;</a>', "a document type", 1),
        ('\n<!DOCTYPE a SYSTEM "file:///etc/passwd"><publish_subscribe/>', "a document type", 2),
        ("<publish_subscribe>\n" + "<a>" * 100_000, "more than 100 deep", 2),
        ("<publish_subscribe>\n<" + "a" * 100_000 + " msg_type='a/B'/></publish_subscribe>", "found <aaa", 2),
        ("<publish_subscribe>\n<publish_to name='" + "a" * 100_000 + "' msg_type='a/B'/></publish_subscribe>",
         "longer than 255 characters", 2),
        ("<publish_subscribe>\n<" + "a" * 100_000 + ">", "is not closed", 2),
    ],
)  # fmt: skip
def test_large_input_is_refused_with_short_error(tmp_path: Path, text: str, message: str, line: int) -> None:
    (error,) = xml_errors(tmp_path, text)
    assert message in error.message
    assert error.place.line == line
    assert len(str(error)) < 1000


def test_too_large_file_is_refused(tmp_path: Path) -> None:
    (error,) = xml_errors(tmp_path, "<publish_subscribe>" + " " * (4 << 20) + "</publish_subscribe>")
    assert "has 4194343 characters: at most 4000000 are allowed" in error.message


def test_auto_adds_topics_that_are_not_configured() -> None:
    markers = DEFAULT_DIRECT_TOPICS[1]
    named = Topics(subscribed=(TopicType("/tf", "tf/tfMessage"),))
    assert direct_topics("auto", Topics()) == DEFAULT_DIRECT_TOPICS
    assert direct_topics("auto", named, lambda topic: topic.lstrip("/")) == (markers,)
    assert direct_topics(True, named) == DEFAULT_DIRECT_TOPICS
    assert direct_topics(False, Topics()) == ()
    assert direct_topics((markers,), named) == (markers,)


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ("auto", "auto"),
        (True, True),
        ("true", True),
        ("False", False),
        (["scan", "my_msgs/Scan"], (TopicType("scan", "my_msgs/Scan"),)),
        ([["scan", "my_msgs/Scan"]], (TopicType("scan", "my_msgs/Scan"),)),
        (
            "[scan, my_msgs/Scan, '/tf', tf/tfMessage]",
            (TopicType("scan", "my_msgs/Scan"), TopicType("/tf", "tf/tfMessage")),
        ),
        (
            "[[scan, my_msgs/Scan], [tf, tf/tfMessage]]",
            (TopicType("scan", "my_msgs/Scan"), DEFAULT_DIRECT_TOPICS[0]),
        ),
        ("[]", ()),
    ],
)
def test_direct_topics_are_word_or_list(value: Any, expected: Any) -> None:
    assert read_direct(value) == expected


@pytest.mark.parametrize("value", ["some", 1, None, ["scan"], "[scan]", "[scan, my_msgs/Scan", [1, 2]])
def test_other_direct_topics_are_refused(value: Any) -> None:
    with pytest.raises(UsageError) as caught:
        read_direct(value)
    assert caught.value.message == (
        f"expected auto, true, false, or a list of topics and types [topic, package/Type, ...], found {value!r}"
    )


def test_invalid_name_of_direct_topic_is_refused() -> None:
    with pytest.raises(UsageError, match="expected a topic name .*, found 'a b'"):
        read_direct(["a b", "my_msgs/Scan"])


def test_program_folder_is_nearest_above(tmp_path: Path) -> None:
    program = tmp_path / "robot"
    (program / "tests").mkdir(parents=True)
    (program / "goalPredicates.txt").write_text("")
    assert find_program_folder(program / "tests" / "a.yaml") == program
    assert find_program_folder(program / "a_test.yaml") == program
    assert find_program_folder(tmp_path / "other" / "a.yaml") is None
