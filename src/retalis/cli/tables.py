"""Records as text in columns, for terminals."""

from textwrap import wrap
from typing import Any, Dict, List, Mapping, Sequence

WIDEST = 60
"""Characters of a column."""


def report(found: Mapping[str, Any]) -> List[str]:
    """Return the lines of a record: single values, then a table for each list of records.

    >>> for line in report({"events": 3, "memories": [{"id": "odom", "size": 10}]}):
    ...     print(line)
    events  3
    <BLANKLINE>
    memories
      id    size
      odom  10
    """
    plain = [(name, value) for name, value in found.items() if not _is_table(value)]
    lines = _aligned([[name, _shown(value)] for name, value in plain])
    for name, rows in found.items():
        if _is_table(rows):
            lines += ["", name, *(f"  {line}" for line in table(rows))]
    return lines


def page(found: Mapping[str, Any], columns: int, height: int) -> List[str]:
    """Return as much of a report as a terminal shows: single values that say something, then tables.

    >>> page({"node": "/a", "work": "", "errors": 0, "events": 3, "memories": [{"id": "odom"}]}, 80, 5)
    ['node /a  events 3', '', 'memories', '  id']
    """
    plain = [f"{name} {_shown(value)}" for name, value in found.items() if value and not _is_table(value)]
    tables = report({name: value for name, value in found.items() if _is_table(value)})
    lines = [  # names and values are kept together by blanks that do not break
        line.replace("\xa0", " ")
        for line in wrap("  ".join(one.replace(" ", "\xa0") for one in plain), columns)
    ]
    return [line[:columns] for line in [*lines, *tables]][: height - 1]


def table(rows: Sequence[Mapping[str, Any]]) -> List[str]:
    """Return the lines of a table: the names of its columns, then its rows."""
    names: Dict[str, None] = {}
    for row in rows:
        names.update(dict.fromkeys(row))
    return _aligned([list(names), *([_shown(row.get(name, "")) for name in names] for row in rows)])


def _is_table(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and isinstance(value[0], Mapping)


def _shown(value: Any) -> str:
    """Return a value in one line that is not too long."""
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
    text = " ".join(text.split())
    if len(text) <= WIDEST:
        return text
    is_path = text.startswith("/")  # whose end tells it from others
    return "..." + text[3 - WIDEST :] if is_path else text[: WIDEST - 3] + "..."


def _aligned(rows: Sequence[Sequence[str]]) -> List[str]:
    widths = [max(map(len, column)) for column in zip(*rows)]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip() for row in rows]
