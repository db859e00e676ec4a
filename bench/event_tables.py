"""Tables of the figures of ``bench/events.py``."""

import json
import math
from pathlib import Path
from typing import Any, Dict, Iterator, List, Sequence, Tuple

from event_streams import STREAMS
from fitting import exponent

Rows = Sequence[Dict[str, Any]]


def joined(files: Sequence[Path]) -> Dict[str, Any]:
    """Return the combined figures of several files."""
    figures: Dict[str, Any] = {"rows": [], "memory": {}}
    for file in files:
        try:
            found = json.loads(file.read_text())
            figures["rows"] += found["rows"]
            figures["memory"].update(found["memory"])
            figures["python"] = found["python"]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise SystemExit(f"{file} has not the figures that --json writes: {error!r}") from error
    return figures


def plain(rows: Rows) -> Iterator[str]:
    """Yield the lines of a table: microseconds per completing event, or per result if an event has many."""
    sizes = sorted({row["waiting"] for row in rows})
    yield f"{'setting':<8} {'operator':<19} {'policy':<15} " + " ".join(f"{size:>9}" for size in sizes)
    for (setting, name, policy), found in _cells(rows).items():
        figures = [f"{per_result(found[size]):9.1f}" if size in found else " " * 9 for size in sizes]
        each = " a result" if any(row["results"] > 1 for row in found.values()) else ""
        yield f"{setting:<8} {name:<19} {policy:<15} " + " ".join(figures) + f"  {_power(found)}{each}"


def markdown(rows: Rows) -> Iterator[str]:
    """Yield the lines of one table for each setting, in Markdown."""
    for setting in dict.fromkeys(row["setting"] for row in rows):
        mine = [row for row in rows if row["setting"] == setting]
        if setting == "streams":
            yield from _streams(mine)
            continue
        sizes = sorted({row["waiting"] for row in mine})
        yield ""
        yield "| operator | policy | " + " | ".join(f"{size:,}" for size in sizes) + " |"
        yield "| --- | --- |" + " ---: |" * len(sizes)
        for (_, name, policy), found in sorted(_cells(mine).items(), key=lambda item: _place(mine, item[0])):
            figures = [_rounded(per_result(found[size])) if size in found else "" for size in sizes]
            yield f"| `{name}` | `{policy}` | " + " | ".join(figures) + " |"


def _streams(rows: Rows) -> Iterator[str]:
    """Yield the lines of the table of windows, shapes, timers, states and the like."""
    sizes = sorted({row["waiting"] for row in rows})
    yield ""
    yield "| row | what | " + " | ".join(f"{size:,}" for size in sizes) + " | exponent |"
    yield "| --- | --- |" + " ---: |" * (len(sizes) + 1)
    cells = {name: found for (_, name, _), found in _cells(rows).items()}
    for name in [one for one in STREAMS if one in cells]:
        found = cells[name]
        figures = [_rounded(per_result(found[size])) if size in found else "" for size in sizes]
        yield f"| `{name}` | {STREAMS[name].about} | " + " | ".join(figures) + f" | {_power(found)} |"


def _power(found: Dict[int, Dict[str, Any]]) -> str:
    """Return the exponent of a cost's growth from N = 100 on as text; empty if unknown."""
    power = exponent([(size, per_result(row)) for size, row in found.items() if size >= 100])
    return "" if math.isnan(power) else f"{power:.2f}"


def keys(row: Dict[str, Any]) -> Tuple[str, str, str]:
    """Return the key of a row."""
    return row["setting"], row["operator"], row["policy"]


def per_result(row: Dict[str, Any]) -> float:
    """Return the microseconds per event, divided by its results if it has many."""
    return float(row["us"]) / max(1, int(row["results"]))


def _cells(rows: Rows) -> Dict[Tuple[str, str, str], Dict[int, Dict[str, Any]]]:
    """Return the rows by key and by number of partial matches."""
    found: Dict[Tuple[str, str, str], Dict[int, Dict[str, Any]]] = {}
    for row in rows:
        found.setdefault(keys(row), {})[row["waiting"]] = row
    return found


def _place(rows: Rows, cell: Tuple[str, str, str]) -> Tuple[int, int]:
    """Return the sort key of a cell: operators in order of measurement, policies from the newest to all."""
    names: List[str] = list(dict.fromkeys(row["operator"] for row in rows))
    policies = ("recent", "recent_2", "chronological", "chronological_2", "unrestricted")
    return names.index(cell[1]), policies.index(cell[2])


def _rounded(figure: float) -> str:
    return f"{figure:.1f}" if figure < 100 else f"{figure:,.0f}"
