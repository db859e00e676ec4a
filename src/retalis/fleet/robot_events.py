"""Events of robots as lines of JSON: reading and checking.

A line is an object with these keys; a line without ``event`` and ``message`` only advances the time of the robot:

* ``robot``: name of the robot, a text
* ``time``: seconds since the epoch, a number
* ``event``: the event as a term, a text
* ``start``: start of an event with a duration, in seconds; by default ``time``
* ``topic`` and ``message``: name of a topic that the program subscribes to, and the slots of a message. With an
  event, the topic is the one on which the robot published it, and is ignored.
* ``id`` and ``session``: number of the event, which grows by one from event to event of a session of the robot

A bridge writes ``refused`` with a reason into lines that it has refused itself.
"""

import json
from typing import Any, Callable, Dict, Mapping, NamedTuple, Optional, Tuple

from ..foundation.displayed_text import quote_shortened
from ..foundation.errors import UsageError
from ..foundation.similar_names import did_you_mean
from ..prolog.terms import timestamps

MAX_LINE_CHARACTERS = 1_000_000
"""Maximum length of a line."""

MAX_NAME_CHARACTERS = 200
"""Maximum length of the name of a robot, of a topic and of a session."""

MAX_SECONDS = 1e12
"""Latest time in seconds since the epoch."""

MAX_ID = (1 << 63) - 1
"""Largest number of an event."""


class RobotEvent(NamedTuple):
    """An event of a robot, or only the time if it has neither a text nor a message.

    Attributes:
        robot: name of the robot.
        instant: time in nanoseconds since the epoch.
        text: the event as a term; None if there is none.
        start: start of the event in nanoseconds; None if it has no duration.
        topic: topic of the message or of the event; None if there is none.
        message: slots of the message.
        id: number of the event in its session; None if events are not numbered.
        session: name of the queue that numbers the events.
    """

    robot: str
    instant: int
    text: Optional[str] = None
    start: Optional[int] = None
    topic: Optional[str] = None
    message: Optional[Dict[str, Any]] = None
    id: Optional[int] = None
    session: str = ""


def read_robot_event(line: str, latest: Optional[int] = None) -> RobotEvent:
    """Return the event of a line.

    >>> read_robot_event('{"robot": "r07", "time": 12.5, "event": "picked(parcel)"}').instant
    12500000000

    Args:
        line: the line.
        latest: latest time in nanoseconds that is accepted; None for no limit.

    Raises:
        UsageError: the reason why the line is refused.
    """
    fields = _read_object(line)
    if "refused" in fields:
        raise UsageError(str(fields["refused"]))
    for key in fields:
        if key not in _READERS:
            raise UsageError(f"key {quote_shortened(key)}: there is no such key{did_you_mean(key, _READERS)}")
    for key in ("robot", "time"):
        if key not in fields:
            raise UsageError(f"key '{key}': it is missing")
    values = {}
    for key, value in fields.items():
        name, read = _READERS[key]
        values[name] = read(key, value)
    event = RobotEvent(**values)
    _check_combination(event)
    if latest is not None and event.instant > latest:
        ahead = (event.instant - latest) / timestamps.SECOND
        raise UsageError(
            f"key 'time': {fields['time']} is {ahead:.0f} s after the latest time that is accepted"
        )
    return event


def _check_combination(event: RobotEvent) -> None:
    if event.text is not None and event.message is not None:
        raise UsageError("keys 'event' and 'message': expected only one")
    if event.text is None and (event.topic is None) != (event.message is None):
        raise UsageError("keys 'topic' and 'message': expected both or neither")
    if event.start is not None and (event.text is None or event.start > event.instant):
        raise UsageError("key 'start': expected a time up to 'time', and an event")


def _read_object(line: str) -> Mapping[str, Any]:
    if len(line) > MAX_LINE_CHARACTERS:
        raise UsageError(f"the line has {len(line)} characters: expected {MAX_LINE_CHARACTERS} at most")
    try:
        fields = json.loads(line, parse_constant=_refuse_constant)
    except json.JSONDecodeError as error:
        raise UsageError(f"column {error.colno}: no JSON: {error.msg}") from error
    except (RecursionError, ValueError) as error:
        # Python reads no integers of thousands of digits.
        raise UsageError(f"no JSON: {error}") from error
    if not isinstance(fields, dict):
        raise UsageError(f"{quote_shortened(line)}: expected an object of JSON")
    return fields


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is not a number of JSON")


def _read_text(key: str, value: object) -> str:
    if not isinstance(value, str):
        raise UsageError(f"key '{key}': expected a text, found {quote_shortened(json.dumps(value))}")
    return value


def _read_name(key: str, value: object) -> str:
    name = _read_text(key, value)
    if not 0 < len(name) <= MAX_NAME_CHARACTERS or not name.isprintable():
        raise UsageError(
            f"key '{key}': expected 1 to {MAX_NAME_CHARACTERS} printable characters, found {quote_shortened(name)}"
        )
    return name


def _read_seconds(key: str, value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise UsageError(
            f"key '{key}': expected a number of seconds, found {quote_shortened(json.dumps(value))}"
        )
    # Flink stores milliseconds in 64 bits; the comparison also refuses the infinity that `1e999` is read as.
    if not 0 <= value <= MAX_SECONDS:
        raise UsageError(
            f"key '{key}': expected 0 to {MAX_SECONDS:.0e} seconds, found {quote_shortened(str(value))}"
        )
    return timestamps.from_seconds(value)


def _read_id(key: str, value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= MAX_ID:
        raise UsageError(
            f"key '{key}': expected a whole number from 0 to {MAX_ID}, found {quote_shortened(json.dumps(value))}"
        )
    return value


def _read_slots(key: str, value: object) -> Dict[str, Any]:
    if not isinstance(value, dict):
        raise UsageError(
            f"key '{key}': expected an object of JSON, found {quote_shortened(json.dumps(value))}"
        )
    return value


_READERS: Dict[str, Tuple[str, Callable[[str, object], Any]]] = {
    "robot": ("robot", _read_name),
    "time": ("instant", _read_seconds),
    "event": ("text", _read_text),
    "start": ("start", _read_seconds),
    "topic": ("topic", _read_name),
    "message": ("message", _read_slots),
    "id": ("id", _read_id),
    "session": ("session", _read_name),
}
"""Keys of a line, with the attributes of `RobotEvent` and the functions that check the values."""
