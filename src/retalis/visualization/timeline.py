"""Timeline of a playback: events, waits, memories, outputs and what is open in lanes over time, and its rendering.

`TimelineBuilder` collects the records of `RunRecorder`, or of a file that ``bag --events --json`` has written. The
number of lanes and of marks per lane is limited: when a lane is full, every second mark is dropped, and from then on
only every second new one is added, so that the remaining marks are spread evenly over the playback.

`timeline_page` returns an HTML page that can be zoomed in any browser; `draw_timeline` draws a picture with
matplotlib.
"""

import json
import logging
import re
import warnings
from contextlib import suppress
from pathlib import Path
from typing import (
    Any,
    Callable,
    Dict,
    Iterable,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Set,
    Tuple,
    cast,
)

from ..engine.run_records import (
    LATER_FIELDS,
    RECORD_TYPES,
    EventRecord,
    MemoryStateRecord,
    OpenStateRecord,
    OpenWindowRecord,
    OutputRecord,
    WaitRecord,
)
from ..foundation.displayed_text import format_count, printable, printable_json, shorten
from ..foundation.errors import UsageError, install_hint
from ..foundation.output_files import replace_file
from ..prolog.syntax.literals import unquote
from ..prolog.terms import timestamps
from ..prolog.terms.timestamps import SECOND

MAX_LANES = 60
"""Maximum number of lanes of a kind; further lanes are counted."""

MAX_MARKS = 20_000
"""Maximum number of marks in a lane; beyond it, every second one is omitted, then three of four, and so on."""

MAX_MARK_CHARACTERS = 200
"""Maximum length of the text of a mark."""

_OPEN = "open"
"""Kind of the lanes of states and windows that are open at the end: their marks end with the playback."""

LANE_KINDS = ("event", "wait", "memory", "output", _OPEN)
"""Kinds of lanes, from top to bottom of the picture."""

MAX_ROWS_PER_LANE = 3
"""Maximum number of rows in a lane; marks that overlap in time are drawn in different rows."""

_NULL_EVENT = "null_event"
"""Head of rules without an event, which exist for their actions."""

_FUNCTOR_NAME = re.compile(r"'(?:[^'\\]|\\.|'')*'|[^(]*")

Mark = Tuple[float, float, str]
"""An item in a lane: start and end in seconds since the beginning of the playback, and its text."""


class TimelineLane(NamedTuple):
    """All marks of one name.

    Attributes:
        kind: one of `LANE_KINDS`.
        name: name of an event or topic, or id of a memory.
        marks: the marks in order of arrival.
        total: number of events, waits or outputs including those without a mark; for a memory, number of records
            ever stored.
    """

    kind: str
    name: str
    marks: List[Mark]
    total: int


class Timeline(NamedTuple):
    """Timeline of a playback.

    Attributes:
        begin: time of second 0, in nanoseconds since the epoch.
        length: duration in seconds.
        lanes: lanes in the order of their kinds and first marks; outputs by name.
        omitted_lane_count: number of further lanes.
    """

    begin: int
    length: float
    lanes: List[TimelineLane]
    omitted_lane_count: int


class _LaneBuilder:
    """A lane under construction, with times in nanoseconds."""

    def __init__(self) -> None:
        self.marks: List[Tuple[int, int, str]] = []
        self.total = 0
        self._step = 1

    def add(self, start: int, end: int, text: str) -> None:
        if self.total % self._step == 0:
            self.marks.append((start, end, shorten(text, MAX_MARK_CHARACTERS)))
            # Dropping every second mark keeps the density even, in constant memory and without knowing the number in
            # advance.
            if len(self.marks) > MAX_MARKS:
                self.marks = self.marks[::2]
                self._step *= 2
        self.total += 1


class TimelineBuilder:
    """Builder of a timeline from the records of `RunRecorder`, or of ``bag --events --json``."""

    def __init__(self) -> None:
        self._lanes: Dict[Tuple[str, str], _LaneBuilder] = {}
        self._omitted_lanes: Dict[Tuple[str, str], None] = {}
        self._lane_counts = dict.fromkeys(LANE_KINDS, 0)

    def add_record(self, record: Mapping[str, Any]) -> None:
        """Add a record; records of unknown kinds are ignored.

        Raises:
            UsageError: if a field is missing or has an invalid value.
        """
        kind = next(iter(record), "")
        read_mark = _MARK_READERS.get(kind)
        if read_mark is None:
            return
        for field in RECORD_TYPES[kind].__annotations__:
            if field not in record and field not in LATER_FIELDS:
                raise UsageError(f'expected a field "{field}"')
        name, start, end, text = read_mark(record)
        # An empty memory has no time range.
        if start is None or end is None or name == _NULL_EVENT:
            return
        lane = self._get_lane(_OPEN if kind == "open_window" else kind, name)
        if lane is not None:
            lane.add(start, end, text)
            # A memory has one mark for all its records.
            if kind == "memory":
                total = cast("MemoryStateRecord", record)["taken"]
                lane.total = total if isinstance(total, int) else lane.total

    def _get_lane(self, kind: str, name: str) -> Optional[_LaneBuilder]:
        key = (kind, shorten(name))
        lane = self._lanes.get(key)
        if lane is None:
            # Names can contain values, such as ids of objects, so their number is not bounded by the program.
            if self._lane_counts[kind] >= MAX_LANES:
                # Names are stored to count each lane once, so their number is bounded as well.
                if len(self._omitted_lanes) < MAX_MARKS:
                    self._omitted_lanes[key] = None
                return None
            self._lane_counts[kind] += 1
            lane = self._lanes[key] = _LaneBuilder()
        return lane

    def build(self) -> Timeline:
        """Return the timeline of the records so far."""
        begin = min((mark[0] for lane in self._lanes.values() for mark in lane.marks), default=0)
        end = max((mark[1] for lane in self._lanes.values() for mark in lane.marks), default=0)
        lanes = [
            TimelineLane(
                kind,
                name,
                [
                    ((first - begin) / SECOND, ((end if kind == _OPEN else last) - begin) / SECOND, text)
                    for first, last, text in lane.marks
                ],
                lane.total,
            )
            for (kind, name), lane in self._lanes.items()
        ]
        lanes.sort(key=lambda lane: (LANE_KINDS.index(lane.kind), lane.name if lane.kind == "output" else ""))
        return Timeline(begin, (end - begin) / SECOND, lanes, len(self._omitted_lanes))


def assign_rows(marks: Iterable[Mark]) -> List[Optional[int]]:
    """Return the row of each mark, counted from 0; None for marks without duration.

    >>> assign_rows([(0, 2, "a"), (1, 1, "b"), (1, 3, "c"), (2, 3, "d")])
    [0, None, 1, 0]
    """
    row_ends = [float("-inf")] * MAX_ROWS_PER_LANE
    rows: List[Optional[int]] = []
    for start, end, _ in marks:
        if start == end:
            rows.append(None)
            continue
        # The first free row. If more marks overlap than there are rows, the one that becomes free next is used, where
        # the marks are drawn over each other.
        row = next(
            (index for index, end_of_row in enumerate(row_ends) if end_of_row <= start),
            row_ends.index(min(row_ends)),
        )
        row_ends[row] = max(row_ends[row], end)
        rows.append(row)
    return rows


def read_run(lines: Iterable[str], source: str) -> Timeline:
    """Return the timeline of a playback that was written as JSON, one record per line.

    Raises:
        UsageError: if a line is not a valid record, with its line number.
    """
    builder = TimelineBuilder()
    for number, line in enumerate(lines, 1):
        try:
            record = json.loads(line)
            if not isinstance(record, dict):
                raise UsageError("this is not a JSON object")
            builder.add_record(record)
        except (ValueError, RecursionError) as error:
            raise UsageError(f"{source}:{number}: this is not JSON: {error}") from None
        except UsageError as error:
            raise UsageError(f"{source}:{number}: {error.message}") from None
    return builder.build()


_MarkData = Tuple[str, Optional[int], Optional[int], str]
"""Name of a lane, and start, end and text of a mark in it. The times are None if the mark is omitted."""


def _read_event_mark(record: EventRecord) -> _MarkData:
    text = _check_text(record["event"], "event")
    return (
        _get_functor_name(text),
        _check_instant(record["start"], "start"),
        _check_instant(record["end"], "end"),
        text,
    )


def _read_wait_mark(record: WaitRecord) -> _MarkData:
    """Return the mark of a query that waits; its lane has the name of the event that the query triggers."""
    text, memories = _check_text(record["wait"], "wait"), record["memories"]
    names = ", ".join(map(str, memories)) if isinstance(memories, list) else ""
    start, end = _check_instant(record["start"], "start"), _check_instant(record["end"], "end")
    return f"{_get_functor_name(text)} waits", start, end, f"for {names}: {text}"


def _read_memory_mark(record: MemoryStateRecord) -> _MarkData:
    """Return the mark of a memory; its times are None if the memory is empty."""
    start = None if record["start"] is None else _check_instant(record["start"], "start")
    end = None if record["end"] is None else _check_instant(record["end"], "end")
    counts = f"{record['records']} of {record['size']} records, {record['taken']} taken"
    return _check_text(record["memory"], "memory"), start, end, f"{counts}: {record['pattern']}"


def _read_output_mark(record: OutputRecord) -> _MarkData:
    instant = _check_instant(record["time"], "time")
    return _check_text(record["topic"], "topic"), instant, instant, _check_text(record["output"], "output")


def _read_open_state_mark(record: OpenStateRecord) -> _MarkData:
    start, text = _check_instant(record["start"], "start"), _check_text(record["open"], "open")
    return _get_functor_name(text), start, start, f"{text} is open"


def _read_open_window_mark(record: OpenWindowRecord) -> _MarkData:
    start, rule = _check_instant(record["start"], "start"), _check_text(record["rule"], "rule")
    values = record["key"].items() if isinstance(record["key"], dict) else ()
    key = "".join(f", {name} = {value}" for name, value in values)
    text = f"{record['open_window']} is open, with {record['elements']} elements{key}"
    return f"{_get_functor_name(rule)} {record['open_window']}", start, start, text


_MARK_READERS: Dict[str, Callable[[Any], _MarkData]] = {
    "event": _read_event_mark,
    "wait": _read_wait_mark,
    "memory": _read_memory_mark,
    "output": _read_output_mark,
    _OPEN: _read_open_state_mark,
    "open_window": _read_open_window_mark,
}


def _check_text(value: object, name: str) -> str:
    """Return the value of a field that has to be a text; lines of a file can contain any JSON."""
    if not isinstance(value, str):
        raise UsageError(f'expected a text as "{name}"')
    return value


def _check_instant(value: object, name: str) -> int:
    """Return the value of a field that has to be a time."""
    # In Python, booleans are integers.
    if not isinstance(value, int) or isinstance(value, bool):
        raise UsageError(f'expected whole nanoseconds as "{name}"')
    if not timestamps.has_datime(value):
        raise UsageError(f'expected nanoseconds since the epoch, in the years 1 to 9999, as "{name}"')
    return value


def _get_functor_name(term: str) -> str:
    """Return the functor name in the text of a term, without quotes, escapes, and the package of a message."""
    match = _FUNCTOR_NAME.match(term)
    name = "" if match is None else match.group()
    if len(name) > 1 and name[0] == name[-1] == "'":
        # Lines of a file can contain invalid escapes, which are shown as they are.
        with suppress(ValueError):
            name = unquote(name[1:-1], "'")
    return name.rpartition("__0__")[2]


PICTURE_FORMATS = ("png", "svg", "pdf")
"""Formats that matplotlib can render."""

_PAGE = Path(__file__).resolve().parent / "page" / "timeline.html"
_DATA_PLACEHOLDER = ">RUN<"
"""Text in the page that is replaced by the timeline as JSON."""

_COLOURS = {"event": "#1f6f94", "wait": "#b06a00", "memory": "#2d8047", "output": "#7b4fb5", _OPEN: "#b3261e"}
_LEGEND_TEXTS = {
    "event": "events",
    "wait": "waits of queries",
    "memory": "memories",
    "output": "outputs",
    _OPEN: "open at the end",
}

_LANE_HEIGHT_INCHES, _PICTURE_WIDTH_INCHES = 0.24, 12.0

_MAX_LABEL_CHARACTERS = 60
"""Maximum length of a name in a picture, which is widened by longer ones. The page has the whole names."""

_MISSING_GLYPH = "Glyph "
"""Start of matplotlib's warning of a character that no font has."""

_logger = logging.getLogger("retalis")


class PageLane(NamedTuple):
    """A lane as the page reads it; the names of the fields are those in the script of the page.

    Attributes:
        kind: one of `LANE_KINDS`; the colour of the lane is the CSS variable of this name.
        name: name of an event or topic, or id of a memory.
        total: number that is shown beside the name; see `TimelineLane`.
        row_count: number of rows that the marks need.
        marks: start and end in seconds, text, and row of each mark. Lists, because a lane can have 20,000 of them.
    """

    kind: str
    name: str
    total: int
    row_count: int
    marks: List[List[Any]]


class PageTimeline(NamedTuple):
    """A timeline as the page reads it; the names of the fields are those in the script of the page.

    Attributes:
        title: heading of the page.
        about: summary in one line.
        length: duration in seconds.
        legend: kind and description of each kind of lanes that occurs.
        lanes: the lanes as dictionaries with the fields of `PageLane`.
    """

    title: str
    about: str
    length: float
    legend: List[Tuple[str, str]]
    lanes: List[Dict[str, Any]]


def timeline_page(timeline: Timeline, title: str) -> str:
    """Return a timeline as a self-contained HTML page."""
    data = PageTimeline(
        title=title,
        about=_describe_timeline(timeline),
        length=timeline.length,
        legend=_list_legend(timeline.lanes),
        lanes=[_make_page_lane(lane)._asdict() for lane in timeline.lanes],
    )
    # "<" is escaped, so that no text of the program can close the script element.
    json_text = printable_json(data._asdict()).replace("<", "\\u003c")
    return _PAGE.read_text(encoding="utf-8").replace(_DATA_PLACEHOLDER, f">{json_text}<", 1)


def _make_page_lane(lane: TimelineLane) -> PageLane:
    # Microseconds are finer than a pixel, and keep the page small.
    marks = [
        [round(start, 6), round(end, 6), text, row or 0]
        for (start, end, text), row in zip(lane.marks, assign_rows(lane.marks))
    ]
    return PageLane(lane.kind, lane.name, lane.total, _count_rows(lane), marks)


def _list_legend(lanes: Sequence[TimelineLane]) -> List[Tuple[str, str]]:
    """Return kind and description of each kind of lanes that occurs, from top to bottom."""
    kinds = {lane.kind for lane in lanes}
    return [(kind, _LEGEND_TEXTS[kind]) for kind in LANE_KINDS if kind in kinds]


def _count_rows(lane: TimelineLane) -> int:
    """Return the number of rows that the marks of a lane need."""
    return 1 + max((row for row in assign_rows(lane.marks) if row is not None), default=0)


def draw_timeline(timeline: Timeline, title: str, path: Path) -> None:
    """Draw a timeline to a file, in the format of the file's suffix.

    Raises:
        UsageError: if matplotlib is not installed, or the file cannot be written.
    """
    try:
        from matplotlib.figure import Figure  # noqa: PLC0415 - an optional package
        from matplotlib.patches import Patch  # noqa: PLC0415
    except ImportError:
        raise UsageError(
            f"drawing {path.name} needs the Python package matplotlib "
            f"({install_hint('matplotlib', 'python3-matplotlib')}); "
            f"{path.with_suffix('.html').name}, a page to zoom in, needs nothing"
        ) from None
    lanes = timeline.lanes
    height = _LANE_HEIGHT_INCHES * max(4, len(lanes))
    figure = Figure(figsize=(_PICTURE_WIDTH_INCHES, height + 1.0))
    axes = figure.subplots()
    draw_lanes(axes, lanes)
    # A run of a single instant is shown within one second.
    length = timeline.length or 1.0
    axes.set_xlim(-0.01 * length, 1.01 * length)
    axes.set_title(f"{_escape_formulas(title)}\n{_describe_timeline(timeline)}", fontsize=10, loc="left")
    _label_rows(axes.twinx(), [f"{lane.total:,}" for lane in lanes], fontsize=8, color="#5b6675")
    patches = [Patch(color=_COLOURS[kind], label=text) for kind, text in _list_legend(lanes)]
    legend_position = (1.0, -0.3 / height)
    axes.legend(
        handles=patches,
        loc="upper right",
        bbox_to_anchor=legend_position,
        ncol=len(LANE_KINDS),
        fontsize=8,
        frameon=False,
    )
    try:
        with replace_file(path) as new_path, warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            figure.savefig(new_path, dpi=110, bbox_inches="tight")
    except OSError as error:
        raise UsageError(f"cannot write {path}: {error.strerror}") from error
    _report_warnings(path, {str(warning.message) for warning in caught})


def _report_warnings(path: Path, messages: Set[str]) -> None:
    """Log the warnings of matplotlib about a picture; those of missing characters in one line."""
    missing = [message for message in messages if message.startswith(_MISSING_GLYPH)]
    if missing:
        _logger.warning(
            "%s: the fonts of matplotlib do not have %s, which a box stands for; "
            "%s, a page, uses those of the browser",
            path.name,
            format_count(len(missing), "character"),
            path.with_suffix(".html").name,
        )
    for message in sorted(messages.difference(missing)):
        _logger.warning("%s: %s", path.name, printable(message))


def draw_lanes(axes: Any, lanes: Sequence[TimelineLane]) -> None:
    """Draw lanes with their names and a time axis on the axes of a matplotlib figure."""
    for row, lane in enumerate(lanes):
        _draw_lane(axes, row, lane)
    axes.set_xlabel("seconds")
    axes.grid(axis="x", color="#e1e5ea")
    axes.set_axisbelow(True)
    names = [_escape_formulas(shorten(lane.name, _MAX_LABEL_CHARACTERS)) for lane in lanes]
    _label_rows(axes, names, fontsize=9)


def _escape_formulas(text: str) -> str:
    """Return a text that matplotlib displays literally: text between two ``$`` would be parsed as a formula."""
    return printable(text).replace("$", "\\$")


def _label_rows(axes: Any, names: List[str], **style: Any) -> None:
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.set_yticks(range(len(names)))
    axes.set_yticklabels(names, **style)
    axes.tick_params(axis="y", length=0)
    for side in ("top", "left", "right"):
        axes.spines[side].set_visible(False)


def _draw_lane(axes: Any, row: int, lane: TimelineLane) -> None:
    """Draw a lane: bars for marks with duration, lines for others."""
    colour = _COLOURS[lane.kind]
    rows, row_height = assign_rows(lane.marks), 0.64 / _count_rows(lane)
    points = [start for start, end, _ in lane.marks if start == end]
    for index in range(_count_rows(lane)):
        top = row - 0.32 + index * row_height
        bars = [
            (start, end - start) for (start, end, _), row_index in zip(lane.marks, rows) if row_index == index
        ]
        if bars:
            axes.broken_barh(bars, (top, 0.9 * row_height), facecolor=colour, alpha=0.45, linewidth=0)
            edges = [edge for start, size in bars for edge in (start, start + size)]
            axes.vlines(edges, top, top + 0.9 * row_height, color=colour, linewidth=0.6)
    if points:
        axes.vlines(points, row - 0.32, row + 0.32, color=colour, linewidth=0.8)


def _describe_timeline(timeline: Timeline) -> str:
    """Return a summary of the timeline in one line."""
    if not timeline.lanes:
        return "the run has no events, waits, memories or outputs"
    year, month, day, hour, minute, second, _ = timestamps.datime_fields(timeline.begin)
    omitted_lanes = (
        f"; {timeline.omitted_lane_count} further lanes are left out" if timeline.omitted_lane_count else ""
    )
    incomplete_lanes = sum(lane.kind != "memory" and lane.total > len(lane.marks) for lane in timeline.lanes)
    omitted_marks = f"; of {incomplete_lanes} lanes not all marks are shown" if incomplete_lanes else ""
    return (
        f"{timeline.length:.3f} s from {year}-{month:02}-{day:02} {hour:02}:{minute:02}:{second:02} UTC; "
        f"numbers are counts per lane{omitted_lanes}{omitted_marks}"
    )
