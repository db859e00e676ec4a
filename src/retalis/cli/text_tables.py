"""Records and tables of records as text in columns, and the page of ``retalis status``."""

from textwrap import wrap
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple

MAX_COLUMN_WIDTH = 60
"""Limit for the width of a column in characters."""

_MIN_COLUMN_WIDTH = 8
"""Width in characters below which no column is shortened."""

PlainRecord = Mapping[str, Any]
"""A message of a node, as a dictionary."""


def report(record: PlainRecord) -> List[str]:
    """Return the lines of a record: its simple values, then a table for each list of records.

    >>> for line in report({"events": 3, "memories": [{"id": "odom", "size": 10}]}):
    ...     print(line)
    events  3
    <BLANKLINE>
    memories
      id    size
      odom  10
    """
    plain = [(name, value) for name, value in record.items() if not _is_table(value)]
    lines = _aligned([[name, _shown(value)] for name, value in plain])
    for name, rows in record.items():
        if _is_table(rows):
            lines += ["", name, *(f"  {line}" for line in table(rows))]
    return lines


def status_page(
    before: PlainRecord, found: PlainRecord, seconds: float, columns: int, has_engine: bool = True
) -> List[str]:
    """Return the status of a node as lines that fit a terminal, with rates and ages, without empty columns.

    >>> before = {"node": "/a", "now": 10.0, "taken": 3, "fired": 0, "inputs": []}
    >>> row = {"topic": "/tf", "type": "tf/tfMessage", "messages": 4, "publishers": 1, "age": 0.5}
    >>> for line in status_page(before, {**before, "taken": 5, "inputs": [row]}, 2.0, 80):
    ...     print(line)
    /a  idle  1.0 events/s  0.0 firings/s
    <BLANKLINE>
    inputs
      topic  type          messages/s  last  lag  publishers
      /tf    tf/tfMessage  -           0.5s  -    1

    Args:
        before: former answer of service ``~list``, as a dictionary; instants are in seconds, or None.
        found: present answer.
        seconds: time between the two.
        columns: width of the terminal in characters.
        has_engine: whether the node has an engine.
    """
    time = _StatusTime(found.get("now"), seconds)
    head = [str(found["node"])]
    if has_engine:
        rates = (f"{_rate(before, found, name, time)} {shown}/s" for name, shown in _RATES.items())
        head += [_work(found), *rates]
    head += [f"{name} {found[name]}" for name in _COUNTS if found.get(name)]
    more = [name for name in found if name.startswith("more_") and found[name]]
    head += [f"{found[name]} more {name[len('more_') :]}" for name in more]
    # Non-breaking spaces keep each part in one line while the text is wrapped.
    lines = wrap("  ".join(part.replace(" ", "\xa0") for part in head), columns)
    lines = [line.replace("\xa0", " ") for line in lines]
    for name, form in _TABLES.items():
        if found.get(name):
            rows = _rows(form, before.get(name, ()), found[name], time, columns - 2)
            lines += ["", name, *(f"  {line}" for line in _aligned(rows))]
    return [line[:columns] for line in lines]


class _StatusTime(NamedTuple):
    """The time of a status by the node's clock, None before it has started, and the seconds since the former one."""

    now: Optional[float]
    seconds: float


class _Column(NamedTuple):
    """A column of a status table.

    Attributes:
        name: heading.
        of: returns the cell of a record, from the record, its former version (None if it is new), and the time.
        elastic: whether long cells may be shortened to fit the terminal.
        rare: whether the column is omitted if all its cells are zero or empty.
    """

    name: str
    of: Callable[[PlainRecord, Optional[PlainRecord], _StatusTime], str]
    elastic: bool = False
    rare: bool = False


class _TableForm(NamedTuple):
    """The columns of a table, and the names of the fields that identify a record in two answers."""

    keys: Tuple[str, ...]
    columns: Tuple[_Column, ...]


def _key(row: PlainRecord, form: _TableForm) -> Tuple[Any, ...]:
    return tuple(row.get(name) for name in form.keys)


def _work(record: PlainRecord) -> str:
    if not record.get("work"):
        return "idle"
    place = f" at {record['work_place']}" if record.get("work_place") else ""
    goal = f": {record['work_goal']}" if record.get("work_goal") else ""
    return f"busy for {_span(record.get('work_time'))} with {record['work']}{goal}{place}"


def _rate(before: Optional[PlainRecord], row: PlainRecord, name: str, time: _StatusTime) -> str:
    """Return the rate of a counter; 0 if it has decreased, because a restarted node counts from 0."""
    if before is None or time.seconds <= 0:
        return "-"
    return f"{max(0, row[name] - before[name]) / time.seconds:.1f}"


def _span(seconds: Optional[float]) -> str:
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


def _age(instant: Optional[float], time: _StatusTime) -> str:
    return "-" if instant is None or time.now is None else _span(time.now - instant)


def _lag(seconds: Optional[float]) -> str:
    if not seconds:
        # Messages without stamps.
        return "-"
    return f"{seconds * 1000:.0f}ms" if abs(seconds) < 1 else _span(seconds)


def _plain(name: str, head: str = "", elastic: bool = False, rare: bool = False) -> _Column:
    return _Column(head or name, lambda row, before, time: _shown(row.get(name, 0)), elastic, rare)


def _growth(name: str, head: str) -> _Column:
    return _Column(head, lambda row, before, time: _rate(before, row, name, time))


def _since(name: str, head: str) -> _Column:
    return _Column(head, lambda row, before, time: _age(row.get(name), time))


def _awaited(row: PlainRecord, before: Optional[PlainRecord], time: _StatusTime) -> str:
    memories = [f"{memory['id']} {_span(memory.get('behind'))} behind" for memory in row.get("memories", ())]
    return ", ".join(memories) + (f", {row['left_out']} more" if row.get("left_out") else "")


def _megabytes(size: int) -> str:
    return f"{size / 1e6:.1f}" if size >= 50_000 else "0"


_RATES = {"taken": "events", "fired": "firings"}
_COUNTS = ("queued", "dropped", "errors", "warnings", "alarms")
_NOTHING = ("", "-", "0")

_TABLES = {
    "rules": _TableForm(
        ("label", "place", "text"),
        (
            _Column("rule", lambda row, before, time: _shown(row["label"] or row["text"]), elastic=True),
            _growth("fired", "firings/s"),
            _since("last_fired", "last"),
            _plain("waiting", rare=True),
            _plain("keys", rare=True),
            _Column("MB", lambda row, before, time: _megabytes(row.get("bytes", 0)), rare=True),
            _plain("errors", rare=True),
            _plain("dropped", rare=True),
        ),
    ),
    "memories": _TableForm(
        ("id",),
        (
            _plain("id", elastic=True),
            _plain("event", elastic=True),
            _Column("records", lambda row, before, time: f"{row['records']} of {row['size']}"),
            _growth("added", "added/s"),
            _since("newest", "newest"),
            _since("oldest", "oldest"),
        ),
    ),
    "subscriptions": _TableForm(
        ("topic", "id"),
        (
            _plain("topic", elastic=True),
            _plain("id", elastic=True),
            _plain("event", elastic=True),
            _growth("sent", "sent/s"),
            _plain("late", rare=True),
            _plain("dropped", rare=True),
        ),
    ),
    "waiting": _TableForm(
        ("event", "since"),
        (
            _plain("event", elastic=True),
            _since("since", "since"),
            _Column("waits for", _awaited, elastic=True),
        ),
    ),
    "inputs": _TableForm(
        ("topic",),
        (
            _plain("topic", elastic=True),
            _plain("type", elastic=True),
            _growth("messages", "messages/s"),
            _Column("last", lambda row, before, time: _span(row.get("age"))),
            _Column("lag", lambda row, before, time: _lag(row.get("lag"))),
            _plain("publishers"),
            _Column(
                "lost",
                lambda row, before, time: str(row.get("dropped", 0) + row.get("refused", 0)),
                rare=True,
            ),
        ),
    ),
}


def _rows(
    form: _TableForm,
    before: Sequence[PlainRecord],
    records: Sequence[PlainRecord],
    time: _StatusTime,
    width: int,
) -> List[List[str]]:
    """Return the heading and the rows of a table that fits a width, without empty rare columns."""
    # Rows are identified by key, not by position: rules and topics may have been added or removed meanwhile.
    former_rows = {_key(row, form): row for row in before}
    shown: List[_Column] = []
    cells: List[List[str]] = []
    for column in form.columns:
        values = [column.of(row, former_rows.get(_key(row, form)), time) for row in records]
        if not column.rare or any(cell not in _NOTHING for cell in values):
            shown.append(column)
            cells.append([column.name, *values])
    widths = [max(map(len, column)) for column in cells]
    elastic = [index for index, column in enumerate(shown) if column.elastic]
    over = sum(widths) + 2 * (len(widths) - 1) - width
    # The widest column is shortened character by character, so that short columns remain complete.
    while over > 0:
        widest = max(elastic, key=lambda index: widths[index])
        # All shortened columns have reached the minimum; the lines are cut at the terminal's width afterwards.
        if widths[widest] <= _MIN_COLUMN_WIDTH:
            break
        widths[widest] -= 1
        over -= 1
    return [[_cut(cell, widths[index]) for index, cell in enumerate(row)] for row in zip(*cells)]


def table(rows: Sequence[PlainRecord]) -> List[str]:
    """Return the lines of a table: headings, then rows."""
    names: Dict[str, None] = {}
    for row in rows:
        names.update(dict.fromkeys(row))
    return _aligned([list(names), *([_shown(row.get(name, "")) for name in names] for row in rows)])


def _is_table(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and isinstance(value[0], Mapping)


def _shown(value: Any) -> str:
    """Return a value as one line of at most `MAX_COLUMN_WIDTH` characters."""
    if value is None or value == []:
        text = "-"
    elif isinstance(value, Mapping):
        text = ", ".join(f"{name} {_shown(part)}" for name, part in value.items())
    elif isinstance(value, list):
        text = "; ".join(map(_shown, value))
    elif isinstance(value, float):
        text = f"{value:.6f}".rstrip("0").rstrip(".")
    else:
        text = str(value)
    return _cut(" ".join(text.split()), MAX_COLUMN_WIDTH)


def _cut(text: str, width: int) -> str:
    """Return a text cut to a width: its beginning, or the end of a path, which distinguishes it from others."""
    if len(text) <= width:
        return text
    return "..." + text[3 - width :] if text.startswith("/") else text[: width - 3] + "..."


def _aligned(rows: Sequence[Sequence[str]]) -> List[str]:
    widths = [max(map(len, column)) for column in zip(*rows)]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip() for row in rows]
