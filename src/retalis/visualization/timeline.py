"""A run as lanes over time: events, waits of queries, memories, outputs; as much of it as somebody can look at.

Pictures of a timeline: a page that zooms and needs nothing but a browser, and a picture by matplotlib.
"""

import json
import re
from pathlib import Path
from typing import Any, Callable, Dict, Iterable, List, NamedTuple, Optional, Tuple

from ..foundation.errors import UsageError, beginning, printable, printable_json
from ..prolog.terms import timestamps
from ..prolog.terms.timestamps import SECOND

MAX_LANES = 60
"""Lanes of one kind; what belongs to further ones is counted."""

MAX_MARKS = 20_000
"""Marks of a lane; where more come, every second one is left out, then three of four, and so on."""

MAX_MARK_CHARACTERS = 200
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
            self.marks.append((start, end, beginning(text, MAX_MARK_CHARACTERS)))
            if len(self.marks) > MAX_MARKS:
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
            if self._of_kind[kind] >= MAX_LANES:
                if len(self._left_out) < MAX_MARKS:
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


PICTURES = ("png", "svg", "pdf")
"""What matplotlib draws."""

_PAGE = Path(__file__).resolve().parent / "page" / "timeline.html"
_PLACE = ">RUN<"

_COLOURS = {"event": "#1f6f94", "wait": "#b06a00", "memory": "#2d8047", "output": "#7b4fb5"}
_NAMES = {"event": "events", "wait": "waits of queries", "memory": "memories", "output": "outputs"}

_LANE, _WIDE = 0.24, 12.0
"""Inches: the height of a lane, and the width of all."""


def page(timeline: Timeline, title: str) -> str:
    """Return a run as an HTML page, with all of it inside."""
    told: Dict[str, Any] = {
        "title": title,
        "about": _about(timeline),
        "length": timeline.length,
        "lanes": [{**lane._asdict(), "marks": _marks(lane), "rows": _rows(lane)} for lane in timeline.lanes],
    }
    held = printable_json(told).replace("<", "\\u003c")  # no text ends the element that it is in
    return _PAGE.read_text(encoding="utf-8").replace(_PLACE, f">{held}<", 1)


def _marks(lane: TimelineLane) -> List[Any]:
    """Return the marks of a lane with their rows, to the microsecond."""
    rows = tracks(lane.marks)
    return [
        [round(start, 6), round(end, 6), text, row or 0] for (start, end, text), row in zip(lane.marks, rows)
    ]


def _rows(lane: TimelineLane) -> int:
    """Return how many rows the marks of a lane take."""
    return 1 + max((row for row in tracks(lane.marks) if row is not None), default=0)


def draw_timeline(timeline: Timeline, title: str, path: Path) -> None:
    """Draw a run into a file, in the format of its ending.

    Raises:
        UsageError: where matplotlib is not there, or the file cannot be written.
    """
    try:
        from matplotlib.figure import Figure  # noqa: PLC0415 - an optional package
        from matplotlib.patches import Patch  # noqa: PLC0415
    except ImportError:
        raise UsageError(
            f"drawing {path.name} needs the Python package matplotlib (pip install matplotlib); "
            f"{path.with_suffix('.html').name}, a page to zoom in, needs nothing"
        ) from None
    lanes = timeline.lanes
    high = _LANE * max(4, len(lanes))
    figure = Figure(figsize=(_WIDE, high + 1.0))
    axes = figure.subplots()
    for row, lane in enumerate(lanes):
        _draw_lane(axes, row, lane)
    axes.set_xlim(-0.01 * timeline.length, 1.01 * timeline.length or 1.0)
    axes.set_xlabel("seconds")
    axes.set_title(f"{_literal(title)}\n{_about(timeline)}", fontsize=10, loc="left")
    axes.grid(axis="x", color="#e1e5ea")
    axes.set_axisbelow(True)
    _name_rows(axes, [_literal(lane.name) for lane in lanes], fontsize=9)
    _name_rows(axes.twinx(), [f"{lane.number:,}" for lane in lanes], fontsize=8, color="#5b6675")
    kinds = [kind for kind in KINDS if any(lane.kind == kind for lane in lanes)]
    patches = [Patch(color=_COLOURS[kind], label=_NAMES[kind]) for kind in kinds]
    below = (1.0, -0.3 / high)
    axes.legend(
        handles=patches, loc="upper right", bbox_to_anchor=below, ncol=len(KINDS), fontsize=8, frameon=False
    )
    try:
        figure.savefig(path, dpi=110, bbox_inches="tight")
    except OSError as error:
        raise UsageError(f"cannot write {path}: {error.strerror}") from error


def _literal(text: str) -> str:
    """Return a text from outside as matplotlib shows it as it is: between two ``$`` it would read a formula."""
    return printable(text).replace("$", "\\$")


def _name_rows(axes: Any, names: List[str], **look: Any) -> None:
    """Write a name beside each row."""
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.set_yticks(range(len(names)))
    axes.set_yticklabels(names, **look)
    axes.tick_params(axis="y", length=0)
    for side in ("top", "left", "right"):
        axes.spines[side].set_visible(False)


def _draw_lane(axes: Any, row: int, lane: TimelineLane) -> None:
    """Draw a lane: bars for what lasts, lines for what does not."""
    colour = _COLOURS[lane.kind]
    rows, wide = tracks(lane.marks), 0.64 / _rows(lane)
    points = [start for start, end, _ in lane.marks if start == end]
    for at in range(_rows(lane)):
        top = row - 0.32 + at * wide
        bars = [(start, end - start) for (start, end, _), track in zip(lane.marks, rows) if track == at]
        if bars:
            axes.broken_barh(bars, (top, 0.9 * wide), facecolor=colour, alpha=0.45, linewidth=0)
            edges = [edge for start, size in bars for edge in (start, start + size)]
            axes.vlines(edges, top, top + 0.9 * wide, color=colour, linewidth=0.6)
    if points:
        axes.vlines(points, row - 0.32, row + 0.32, color=colour, linewidth=0.8)


def _about(timeline: Timeline) -> str:
    """Return what a run is, in a line."""
    year, month, day, hour, minute, second, _ = timestamps.fields(timeline.begin)
    lanes = f"; {timeline.left_out} further lanes are left out" if timeline.left_out else ""
    thinned = sum(lane.kind != "memory" and lane.number > len(lane.marks) for lane in timeline.lanes)
    thin = f"; of {thinned} lanes not all marks are shown" if thinned else ""
    return (
        f"{timeline.length:.3f} s from {year}-{month:02}-{day:02} {hour:02}:{minute:02}:{second:02} UTC; "
        f"numbers are how many of each there were{lanes}{thin}"
    )
