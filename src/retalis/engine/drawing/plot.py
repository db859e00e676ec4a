"""Pictures of a timeline: a page that zooms and needs nothing but a browser, and a picture by matplotlib."""

from pathlib import Path
from typing import Any, Dict, List

from ...foundation import UsageError, printable, printable_json
from ...prolog.terms import timestamps
from .timeline import KINDS, Timeline, TimelineLane, tracks

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
