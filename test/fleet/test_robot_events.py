"""Lines of events: accepted keys, and the reason for each refused line."""

import pytest

from retalis.fleet.robot_events import MAX_LINE_CHARACTERS, RobotEvent, read_robot_event
from retalis.foundation.errors import UsageError

SECOND = 1_000_000_000


def test_line_with_event_is_read() -> None:
    line = '{"robot": "r07", "time": 12.5, "start": 12, "event": "carry(p)", "id": 4, "session": "a", "topic": "t"}'
    expected = RobotEvent("r07", 12_500_000_000, "carry(p)", 12 * SECOND, "t", id=4, session="a")
    assert read_robot_event(line) == expected


def test_line_with_message_is_read() -> None:
    line = '{"robot": "r07", "time": 1, "topic": "/odom", "message": {"x": 1.0}}'
    assert read_robot_event(line) == RobotEvent("r07", SECOND, topic="/odom", message={"x": 1.0})


def test_line_without_event_has_time_only() -> None:
    assert read_robot_event('{"robot": "r07", "time": 1}') == RobotEvent("r07", SECOND)


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("not json", "column 1: no JSON: Expecting value"),
        ("", "column 1: no JSON: Expecting value"),
        ("[1]", "'[1]': expected an object of JSON"),
        ("[" * 100_000, "no JSON: maximum recursion depth exceeded"),
        ('{"time": 1}', "key 'robot': it is missing"),
        ('{"robot": "a"}', "key 'time': it is missing"),
        ('{"robot": 7, "time": 1}', "key 'robot': expected a text, found '7'"),
        ('{"robot": "", "time": 1}', "key 'robot': expected 1 to 200 printable characters, found ''"),
        ('{"robot": "a\\n", "time": 1}', "key 'robot': expected 1 to 200 printable characters, found 'a\\n'"),
        ('{"robot": "a", "time": "1"}', "key 'time': expected a number of seconds, found '\"1\"'"),
        ('{"robot": "a", "time": true}', "key 'time': expected a number of seconds, found 'true'"),
        ('{"robot": "a", "time": NaN}', "no JSON: NaN is not a number of JSON"),
        ('{"robot": "a", "time": 1e999}', "key 'time': expected 0 to 1e+12 seconds, found 'inf'"),
        ('{"robot": "a", "time": -1}', "key 'time': expected 0 to 1e+12 seconds, found '-1'"),
        ('{"robot": "a", "time": 1, "evnt": "b"}', "key 'evnt': there is no such key; did you mean event?"),
        ('{"robot": "a", "time": 1, "event": 2}', "key 'event': expected a text, found '2'"),
        ('{"robot": "a", "time": 1, "start": 2, "event": "b"}', "key 'start': expected a time up to 'time'"),
        ('{"robot": "a", "time": 1, "topic": "b"}', "keys 'topic' and 'message': expected both or neither"),
        (
            '{"robot": "a", "time": 1, "event": "b", "message": {}}',
            "keys 'event' and 'message': expected only one",
        ),
        ('{"robot": "a", "time": 1, "id": 1.5}', "key 'id': expected a whole number from 0 to"),
        ('{"refused": "wrong topic", "payload": "x"}', "wrong topic"),
        (" " * (MAX_LINE_CHARACTERS + 1), "the line has 1000001 characters: expected 1000000 at most"),
    ],
)
def test_invalid_line_is_refused_with_reason(line: str, reason: str) -> None:
    with pytest.raises(UsageError) as error:
        read_robot_event(line)
    assert str(error.value).startswith(reason)


def test_time_after_latest_is_refused() -> None:
    line = '{"robot": "a", "time": 30}'
    assert read_robot_event(line, 30 * SECOND).instant == 30 * SECOND
    with pytest.raises(UsageError, match="key 'time': 30 is 10 s after the latest time that is accepted"):
        read_robot_event(line, 20 * SECOND)
