"""A run as lanes over time: events, waits of queries, memories, outputs; as much of it as somebody can look at."""

import json
import re
from typing import Any, Callable, Dict, Iterable, List, NamedTuple, Optional, Tuple

from ...foundation import UsageError, beginning
from ...prolog.terms import SECOND, timestamps

MOST_LANES = 60
"""Lanes of one kind; what belongs to further ones is counted."""

MOST_MARKS = 20_000
"""Marks of a lane; where more come, every second one is left out, then three of four, and so on."""

LONGEST = 200
"""Characters of the text of a mark."""

KINDS = ("event", "wait", "memory", "output")
"""The kinds of lanes, from the top of a picture to its bottom."""

TRACKS = 3
"""Rows of a lane: marks that last and overlap stand one below the other."""

_NOTHING = "null_event"
"""The head of rules that are there for what they do."""

_NAME = re.compile(r"'(?:[^'\\]|\\.|'')*'|[^(]*")

Mark = Tuple[float, float, str]
"""Something in a lane: start and end in seconds after the run's beginning, and what it is."""


class TimelineLane(NamedTuple):
    """All of one name.

    Attributes:
        kind: one of `KINDS`.
        name: the name of an event or topic, or the id of a memory.
        marks: in the order of their coming.
        number: how many there were, with those that are left out.
    """

    kind: str
    name: str
    marks: List[Mark]
    number: int


class Timeline(NamedTuple):
    """A run.

    Attributes:
        begin: the instant that its seconds are counted from, in nanoseconds since the epoch.
        length: its seconds.
        lanes: in the order of their kinds, and of their first marks; outputs by name.
        left_out: how many lanes there were besides.
    """

    begin: int
    length: float
    lanes: List[TimelineLane]
    left_out: int


class _Filling:
    """A lane that is being filled: its instants are nanoseconds still."""

    def __init__(self) -> None:
        self.marks: List[Tuple[int, int, str]] = []
        self.number = 0
        self._step = 1

    def add(self, start: int, end: int, text: str) -> None:
        if self.number % self._step == 0:
            self.marks.append((start, end, beginning(text, LONGEST)))
            if len(self.marks) > MOST_MARKS:
                self.marks = self.marks[::2]
                self._step *= 2
        self.number += 1


class TimelineBuilder:
    """Makes a timeline of the records of a run, as `RunLook` gives them and ``bag --events --json`` prints them."""

    def __init__(self) -> None:
        self._lanes: Dict[Tuple[str, str], _Filling] = {}
        self._left_out: Dict[Tuple[str, str], None] = {}
        self._of_kind = dict.fromkeys(KINDS, 0)

    def take(self, line: Dict[str, Any]) -> None:
        """Take a record; one of another kind is let pass.

        Raises:
            UsageError: where a field is missing or has no such value.
        """
        kind = next(iter(line), "")
        told = _TELL.get(kind)
        if told is None:
            return
        name, start, end, text = told(line)
        if start is None or end is None or name == _NOTHING:
            return
        lane = self._lane(kind, name)
        if lane is not None:
            lane.add(start, end, text)
            if kind == "memory":  # one mark for all that it took
                taken = line.get("taken")
                lane.number = taken if isinstance(taken, int) else lane.number

    def _lane(self, kind: str, name: str) -> Optional[_Filling]:
        key = (kind, beginning(name))
        found = self._lanes.get(key)
        if found is None:
            if self._of_kind[kind] >= MOST_LANES:
                if len(self._left_out) < MOST_MARKS:
                    self._left_out[key] = None
                return None
            self._of_kind[kind] += 1
            found = self._lanes[key] = _Filling()
        return found

    def timeline(self) -> Timeline:
        """Return what there is so far."""
        begin = min((mark[0] for lane in self._lanes.values() for mark in lane.marks), default=0)
        end = max((mark[1] for lane in self._lanes.values() for mark in lane.marks), default=0)
        lanes = [
            TimelineLane(
                kind,
                name,
                [
                    ((first - begin) / SECOND, (last - begin) / SECOND, text)
                    for first, last, text in lane.marks
                ],
                lane.number,
            )
            for (kind, name), lane in self._lanes.items()
        ]
        lanes.sort(key=lambda lane: (KINDS.index(lane.kind), lane.name if lane.kind == "output" else ""))
        return Timeline(begin, (end - begin) / SECOND, lanes, len(self._left_out))


def tracks(marks: Iterable[Mark]) -> List[Optional[int]]:
    """Return for each mark the row in which it stands, the first one being 0; None for what takes no time.

    >>> tracks([(0, 2, "a"), (1, 1, "b"), (1, 3, "c"), (2, 3, "d")])
    [0, None, 1, 0]
    """
    free = [float("-inf")] * TRACKS
    found: List[Optional[int]] = []
    for start, end, _ in marks:
        if start == end:
            found.append(None)
            continue
        row = next((at for at, until in enumerate(free) if until <= start), free.index(min(free)))
        free[row] = max(free[row], end)
        found.append(row)
    return found


def read_run(lines: Iterable[str], source: str) -> Timeline:
    """Return the timeline of a run that was written as JSON, one record a line.

    Raises:
        UsageError: for a line that is no such record, with its number.
    """
    builder = TimelineBuilder()
    for number, line in enumerate(lines, 1):
        try:
            found = json.loads(line)
            if not isinstance(found, dict):
                raise UsageError("this is no JSON object")
            builder.take(found)
        except (ValueError, RecursionError) as error:
            raise UsageError(f"{source}:{number}: this is no JSON: {error}") from None
        except UsageError as error:
            raise UsageError(f"{source}:{number}: {error.message}") from None
    return builder.timeline()


_Told = Tuple[str, Optional[int], Optional[int], str]


def _interval(kind: str) -> Callable[[Dict[str, Any]], _Told]:
    def told(line: Dict[str, Any]) -> _Told:
        text = _text(line, kind)
        start, end = _instant(line, "start"), _instant(line, "end")
        if kind == "wait":
            waited = line.get("memories")
            names = ", ".join(map(str, waited)) if isinstance(waited, list) else ""
            return f"{_name(text)} waits", start, end, f"for {names}: {text}"
        return _name(text), start, end, text

    return told


def _memory(line: Dict[str, Any]) -> _Told:
    """Tell what a memory holds; nothing where it is empty."""
    ends = [None if line.get(name) is None else _instant(line, name) for name in ("start", "end")]
    told = f"{line.get('records')} of {line.get('size')} records, {line.get('taken')} taken: {line.get('pattern')}"
    return _text(line, "memory"), ends[0], ends[1], told


def _output(line: Dict[str, Any]) -> _Told:
    instant = _instant(line, "time")
    return _text(line, "topic"), instant, instant, _text(line, "output")


_TELL: Dict[str, Callable[[Dict[str, Any]], _Told]] = {
    "event": _interval("event"),
    "wait": _interval("wait"),
    "memory": _memory,
    "output": _output,
}


def _text(line: Dict[str, Any], name: str) -> str:
    found = line.get(name)
    if not isinstance(found, str):
        raise UsageError(f'expected a text as "{name}"')
    return found


def _instant(line: Dict[str, Any], name: str) -> int:
    found = line.get(name)
    if not isinstance(found, int) or isinstance(found, bool):
        raise UsageError(f'expected whole nanoseconds as "{name}"')
    if not timestamps.in_range(found):
        raise UsageError(f'expected nanoseconds since the epoch, in the years 1 to 9999, as "{name}"')
    return found


def _name(term: str) -> str:
    """Return the name of a term that is a text, without the package of a message."""
    found = _NAME.match(term)
    return "" if found is None else found.group().rpartition("__0__")[2].strip("'")
