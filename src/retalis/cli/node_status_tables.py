"""Answers of a node's service ``~list`` as text in columns, for ``retalis list`` and ``retalis status``.

`format_list` prints all fields of an answer: a summary, then a table for each list of records. `format_status`
compares two answers, and shows what is useful on a terminal: rates instead of counters, and ages instead of instants.
"""

import os
from textwrap import wrap
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple

from ..foundation.displayed_text import format_count
from ..foundation.source_places import line_of

MAX_COLUMN_WIDTH = 60
"""Limit for the width of a column in characters."""

_MIN_COLUMN_WIDTH = 8
"""Width in characters below which no column is shortened."""

PlainRecord = Mapping[str, Any]
"""A message of a node as a dictionary: an answer of ``~list``, or a record in one of its lists."""


def format_list(record: PlainRecord, has_engine: bool = True) -> List[str]:
    """Return the lines of an answer of service ``~list``: a summary, then the tables, topics last.

    >>> counters = {"taken": 3, "queued": 0, "dropped": 0, "fired": 1, "errors": 0, "warnings": 2, "alarms": 0}
    >>> for line in format_list({"node": "/a", "now": 7.5, "work": "", **counters, "inputs": [{"topic": "/tf"}]}):
    ...     print(line)
    node      /a
    time      7.5
    work      idle
    events    3 received, 0 queued, 0 dropped
    firings   1
    problems  0 errors, 2 warnings
    alarms    0
    <BLANKLINE>
    subscribed topics
      topic
      /tf
    """
    summary = [["node", str(record["node"])], ["time", _format_value(record.get("now"))]]
    if has_engine:
        events = f"{record['taken']} received, {record['queued']} queued, {record['dropped']} dropped"
        problems = (format_count(record["errors"], "error"), format_count(record["warnings"], "warning"))
        summary += [
            ["work", _format_work(record)],
            ["events", events],
            ["firings", str(record["fired"])],
            ["problems", ", ".join(problems)],
            ["alarms", str(record["alarms"])],
        ]
    if record.get("forwarding"):
        summary.append(["forwarding", record["forwarding"]])
    lines = _align_columns(summary)
    for name, title in _LIST_TITLES.items():
        rows, omitted_count = record.get(name), record.get(f"more_{name}")
        if rows:
            lines += ["", title, *(f"  {line}" for line in format_table(list(map(_name_first, rows))))]
        if omitted_count:
            lines += [f"  and {omitted_count} more" if rows else f"{title}: {omitted_count}"]
    return lines


def _name_first(row: PlainRecord) -> PlainRecord:
    """Return a record that begins with its name, if it has one: a rule."""
    return {"name": row["name"], **row} if "name" in row else row


_LIST_TITLES = {
    "rules": "rules",
    "memories": "memories",
    "waiting": "waiting queries",
    "subscriptions": "published topics",
    "inputs": "subscribed topics",
}
"""Titles of the tables of `format_list`, by the names of the lists of records."""


def format_status(
    before: PlainRecord, current: PlainRecord, seconds: float, terminal_width: int, has_engine: bool = True
) -> List[str]:
    """Return the status of a node as lines that fit a terminal, with rates and ages, without empty columns.

    >>> before = {"node": "/a", "now": 10.0, "taken": 3, "fired": 0, "inputs": []}
    >>> row = {"topic": "/tf", "type": "tf/tfMessage", "messages": 4, "publishers": 1, "age": 0.5}
    >>> for line in format_status(before, {**before, "taken": 5, "inputs": [row]}, 2.0, 80):
    ...     print(line)
    /a  active  1.0 events/s  0.0 firings/s
    <BLANKLINE>
    inputs
      topic  type          messages/s  last  lag  publishers
      /tf    tf/tfMessage  -           0.5s  -    1

    Args:
        before: former answer of service ``~list``, as a dictionary; instants are in seconds, or None.
        current: present answer.
        seconds: time between the two.
        terminal_width: width of the terminal in characters.
        has_engine: whether the node has an engine.
    """
    time = _StatusTime(current.get("now"), seconds)
    summary = [str(current["node"])]
    if has_engine:
        rates = (
            f"{_format_rate(before, current, name, time)} {heading}/s" for name, heading in _RATES.items()
        )
        # An engine that has processed events since the former answer is not idle, also if it waits at this moment.
        idle_text = "active" if current["taken"] != before["taken"] else "idle"
        summary += [_format_work(current, idle_text), *rates]
    summary += [f"{name} {current[name]}" for name in _COUNTS if current.get(name)]
    omitted_counts = [name for name in current if name.startswith("more_") and current[name]]
    summary += [f"{current[name]} more {name[len('more_') :]}" for name in omitted_counts]
    # Non-breaking spaces keep each part in one line while the text is wrapped.
    lines = wrap("  ".join(part.replace(" ", "\xa0") for part in summary), terminal_width)
    lines = [line.replace("\xa0", " ") for line in lines]
    if current.get("forwarding"):
        lines += wrap(f"forwarding  {current['forwarding']}", terminal_width)
    for name, table_form in _TABLE_FORMS.items():
        if current.get(name):
            rows = _format_rows(table_form, before.get(name, ()), current[name], time, terminal_width - 2)
            lines += ["", name, *(f"  {line}" for line in _align_columns(rows))]
    return [line[:terminal_width] for line in lines]


class _StatusTime(NamedTuple):
    """The time of a status by the node's clock, None before it has started, and the seconds since the former one."""

    now: Optional[float]
    seconds: float


class _Column(NamedTuple):
    """A column of a status table.

    Attributes:
        heading: text above the cells.
        format_cell: returns the cell of a record, given the record, its former version (None if it is new), and the
            time.
        can_shrink: whether long cells may be shortened to fit the terminal.
        hidden_if_empty: whether the column is omitted if all its cells are zero or empty.
    """

    heading: str
    format_cell: Callable[[PlainRecord, Optional[PlainRecord], _StatusTime], str]
    can_shrink: bool = False
    hidden_if_empty: bool = False


class _TableForm(NamedTuple):
    """Form of a table: the names of the fields that identify a record in both answers, and the columns."""

    keys: Tuple[str, ...]
    columns: Tuple[_Column, ...]


def _record_key(row: PlainRecord, form: _TableForm) -> Tuple[Any, ...]:
    return tuple(row.get(name) for name in form.keys)


def _format_work(record: PlainRecord, idle_text: str = "idle") -> str:
    if not record.get("work"):
        return idle_text
    place = f" at {record['work_place']}" if record.get("work_place") else ""
    goal = f": {record['work_goal']}" if record.get("work_goal") else ""
    return f"busy for {_format_duration(record.get('work_time'))} with {record['work']}{goal}{place}"


def _format_rate(before: Optional[PlainRecord], row: PlainRecord, name: str, time: _StatusTime) -> str:
    """Return the rate of a counter; 0 if it has decreased, because a restarted node counts from 0."""
    if before is None or time.seconds <= 0:
        return "-"
    return f"{max(0, row[name] - before[name]) / time.seconds:.1f}"


def _format_duration(seconds: Optional[float]) -> str:
    """Return a time span in at most seven characters."""
    if seconds is None:
        return "-"
    sign, seconds = "-" * (seconds < 0), abs(seconds)
    if seconds < 9.95:
        return f"{sign}{seconds:.1f}s"
    whole = round(seconds)
    if whole < 60:
        return f"{sign}{whole}s"
    if whole < 3600:
        return f"{sign}{whole // 60}m{whole % 60:02d}s"
    if whole < 86_400:
        return f"{sign}{whole // 3600}h{whole % 3600 // 60:02d}m"
    return f"{sign}{whole // 86_400}d{whole % 86_400 // 3600:02d}h"


def _format_age(instant: Optional[float], time: _StatusTime) -> str:
    return "-" if instant is None or time.now is None else _format_duration(time.now - instant)


def _format_lag(seconds: Optional[float]) -> str:
    if not seconds:
        # Messages without stamps.
        return "-"
    return f"{seconds * 1000:.0f}ms" if abs(seconds) < 1 else _format_duration(seconds)


def _plain_column(name: str, can_shrink: bool = False, hidden_if_empty: bool = False) -> _Column:
    return _Column(
        name,
        lambda row, before, time: _format_value(row.get(name, 0)),
        can_shrink,
        hidden_if_empty,
    )


def _rate_column(name: str, heading: str) -> _Column:
    return _Column(heading, lambda row, before, time: _format_rate(before, row, name, time))


def _age_column(name: str, heading: str) -> _Column:
    return _Column(heading, lambda row, before, time: _format_age(row.get(name), time))


def _format_awaited(row: PlainRecord, before: Optional[PlainRecord], time: _StatusTime) -> str:
    memories = [
        f"{memory['id']} {_format_duration(memory.get('behind'))} behind"
        for memory in row.get("memories", ())
    ]
    return ", ".join(memories) + (f", {row['left_out']} more" if row.get("left_out") else "")


def _format_megabytes(size: int) -> str:
    return f"{size / 1e6:.1f}" if size >= 50_000 else "0"


_RATES = {"taken": "events", "fired": "firings"}
"""Counters of a node whose rates are shown, with the names of what they count."""

_COUNTS = ("queued", "dropped", "errors", "warnings", "alarms")
"""Counters of a node that are shown if they are not 0."""

_EMPTY_CELLS = ("", "-", "0")

_TABLE_FORMS = {
    "rules": _TableForm(
        ("label", "place", "text"),
        (
            _Column("rule", lambda row, before, time: _format_value(row["name"]), can_shrink=True),
            _Column(
                "place",
                lambda row, before, time: _format_value(os.path.basename(line_of(row["place"]))),
                can_shrink=True,
                hidden_if_empty=True,
            ),
            _rate_column("fired", "firings/s"),
            _age_column("last_fired", "last"),
            _plain_column("waiting", hidden_if_empty=True),
            _plain_column("keys", hidden_if_empty=True),
            _Column(
                "MB", lambda row, before, time: _format_megabytes(row.get("bytes", 0)), hidden_if_empty=True
            ),
            _Column(
                "delay",
                lambda row, before, time: _format_lag(row.get("delay", 0) / 1e9),
                hidden_if_empty=True,
            ),
            _plain_column("errors", hidden_if_empty=True),
            _plain_column("late", hidden_if_empty=True),
            _plain_column("ahead", hidden_if_empty=True),
            _plain_column("dropped", hidden_if_empty=True),
        ),
    ),
    "memories": _TableForm(
        ("id",),
        (
            _plain_column("id", can_shrink=True),
            _plain_column("event", can_shrink=True),
            _Column("records", lambda row, before, time: f"{row['records']} of {row['size']}"),
            _rate_column("added", "added/s"),
            _age_column("newest", "newest"),
            _age_column("oldest", "oldest"),
        ),
    ),
    "subscriptions": _TableForm(
        ("topic", "id"),
        (
            _plain_column("topic", can_shrink=True),
            _plain_column("id", can_shrink=True),
            _plain_column("event", can_shrink=True),
            _rate_column("sent", "sent/s"),
            _plain_column("late", hidden_if_empty=True),
            _plain_column("ahead", hidden_if_empty=True),
            _plain_column("dropped", hidden_if_empty=True),
        ),
    ),
    "waiting": _TableForm(
        ("event", "since"),
        (
            _plain_column("event", can_shrink=True),
            _age_column("since", "since"),
            _Column("waits for", _format_awaited, can_shrink=True),
        ),
    ),
    "inputs": _TableForm(
        # The ROS interface of a node can subscribe to the same topics.
        ("node", "topic"),
        (
            _plain_column("topic", can_shrink=True),
            _plain_column("type", can_shrink=True),
            _rate_column("messages", "messages/s"),
            _Column("last", lambda row, before, time: _format_duration(row.get("age"))),
            _Column("lag", lambda row, before, time: _format_lag(row.get("lag"))),
            _plain_column("publishers"),
            _Column(
                "lost",
                lambda row, before, time: str(
                    row.get("dropped", 0) + row.get("refused", 0) + row.get("missing", 0)
                ),
                hidden_if_empty=True,
            ),
        ),
    ),
}


def _format_rows(
    form: _TableForm,
    before: Sequence[PlainRecord],
    records: Sequence[PlainRecord],
    time: _StatusTime,
    width: int,
) -> List[List[str]]:
    """Return the headings and the rows of a table that fits a width, without empty columns that may be hidden."""
    # Rows are identified by key, not by position: rules and topics may have been added or removed meanwhile.
    former_rows = {_record_key(row, form): row for row in before}
    visible_columns: List[_Column] = []
    cells: List[List[str]] = []
    for column in form.columns:
        values = [column.format_cell(row, former_rows.get(_record_key(row, form)), time) for row in records]
        if not column.hidden_if_empty or any(cell not in _EMPTY_CELLS for cell in values):
            visible_columns.append(column)
            cells.append([column.heading, *values])
    widths = [max(map(len, column)) for column in cells]
    shrinkable = [index for index, column in enumerate(visible_columns) if column.can_shrink]
    excess_width = sum(widths) + 2 * (len(widths) - 1) - width
    # The widest column is shortened character by character, so that short columns remain complete.
    while excess_width > 0:
        widest = max(shrinkable, key=lambda index: widths[index])
        # All shortened columns have reached the minimum; the lines are cut at the terminal's width afterwards.
        if widths[widest] <= _MIN_COLUMN_WIDTH:
            break
        widths[widest] -= 1
        excess_width -= 1
    return [[_truncate(cell, widths[index]) for index, cell in enumerate(row)] for row in zip(*cells)]


def format_table(rows: Sequence[PlainRecord]) -> List[str]:
    """Return the lines of a table: headings, then rows."""
    names: Dict[str, None] = {}
    for row in rows:
        names.update(dict.fromkeys(row))
    return _align_columns(
        [list(names), *([_format_value(row.get(name, "")) for name in names] for row in rows)]
    )


def _format_value(value: Any) -> str:
    """Return a value as one line of at most `MAX_COLUMN_WIDTH` characters."""
    if value is None or value == []:
        text = "-"
    elif isinstance(value, Mapping):
        text = ", ".join(f"{name} {_format_value(part)}" for name, part in value.items())
    elif isinstance(value, list):
        text = "; ".join(map(_format_value, value))
    elif isinstance(value, float):
        text = f"{value:.6f}".rstrip("0").rstrip(".")
    else:
        text = str(value)
    return _truncate(" ".join(text.split()), MAX_COLUMN_WIDTH)


def _truncate(text: str, width: int) -> str:
    """Return a text cut to a width: its beginning, or the end of a path, which distinguishes it from others."""
    if len(text) <= width:
        return text
    return "..." + text[3 - width :] if text.startswith("/") else text[: width - 3] + "..."


def _align_columns(rows: Sequence[Sequence[str]]) -> List[str]:
    widths = [max(map(len, column)) for column in zip(*rows)]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip() for row in rows]
