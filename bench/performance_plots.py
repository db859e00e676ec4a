"""Plots of the benchmarks in ``docs/explanation/performance.md``."""

from typing import Any, Dict, List, Tuple

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot, ticker  # noqa: E402

BETTER = "less is better"
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#e69f00", "#56b4e9", "#555555")


def save(figure: Any, path: str) -> None:
    """Write a figure to a file."""
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


COLUMNS = {
    "terms": "this engine, events as terms",
    "messages": "this engine, events as messages",
    "reference": "the original's engine",
}


def draw_engine(result: Dict[str, Any], path: str) -> None:
    """Draw the microseconds per event in each case, with a dot for each table column."""
    cases = result["cases"]
    columns = list(dict.fromkeys(column for row in cases.values() for column in row))
    figure, axis = pyplot.subplots(figsize=(8, 0.28 * len(cases) + 1.4))
    for at, row in enumerate(cases.values()):
        axis.plot([min(row.values()), max(row.values())], [at, at], "-", color="#cccccc", zorder=1)
    for number, column in enumerate(columns):
        places = [at for at, row in enumerate(cases.values()) if column in row]
        values = [row[column] for row in cases.values() if column in row]
        shown = COLUMNS.get(column, column.replace("python", "this engine on CPython"))
        axis.plot(
            values, places, "osD^v"[number % 5], ms=5, label=shown, color=COLOURS[number % len(COLOURS)]
        )
    axis.set_yticks(range(len(cases)), list(cases), fontsize=8)
    axis.invert_yaxis()
    axis.set_xscale("log")
    _plain(axis.xaxis)
    axis.set_xlabel(f"microseconds an event, logarithmic ({BETTER})", fontsize=9)
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8, ncol=2, loc="lower center", bbox_to_anchor=(0.4, 1.0), frameon=False)
    save(figure, path)


def _plain(axis: Any) -> None:
    """Label a logarithmic axis with 0.5, 1, 2, 5, 10."""
    axis.set_major_locator(ticker.LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter(lambda value, at: f"{value:g}")
    axis.set_minor_locator(ticker.NullLocator())


def draw_node(result: Dict[str, Any], path: str) -> None:
    """Draw CPU and delay of each configuration at each speed, and memory over messages if it was measured."""
    rows, held = result["rows"], result.get("memory", [])
    ways = list(dict.fromkeys(row["way"] for row in rows))
    panels = 3 if held else 2
    figure, axes = pyplot.subplots(1, panels, figsize=(3.7 * panels + 0.6, 3.6))
    left, middle = axes[:2]
    for number, way in enumerate(ways):
        found = [row for row in rows if row["way"] == way]
        rates = [row["messages_a_second"] for row in found]
        colour = COLOURS[number % len(COLOURS)]
        left.plot(rates, [row["cpu_percent"] for row in found], "o-", label=way, color=colour)
        late = [(rate, row) for rate, row in zip(rates, found) if row.get("delay_ms_median")]
        if late:
            at = [rate for rate, _ in late]
            middle.plot(
                at, [row["delay_ms_median"] for _, row in late], "o-", color=colour, label=f"{way}, median"
            )
            middle.plot(at, [row["delay_ms_99"] for _, row in late], "^:", color=colour, label=f"{way}, 99 %")
    _axes(left, "messages a second, logarithmic", f"CPU, percent of a core ({BETTER})")
    _axes(middle, "messages a second, logarithmic", f"delay in milliseconds ({BETTER})")
    middle.legend(fontsize=6, ncol=3, loc="upper center", bbox_to_anchor=(0.5, 1.17), frameon=False)
    left.legend(fontsize=6, ncol=5, loc="upper center", bbox_to_anchor=(0.5, 1.11), frameon=False)
    for axis, marks in ((left, [2, 5, 10, 20, 50, 100]), (middle, [0.2, 0.5, 1, 2, 5, 10])):
        axis.set_xscale("log")
        axis.set_yscale("log")
        axis.minorticks_off()
        axis.set_xticks([1880, 9400, 18800, 37600], ["1,880", "9,400", "18,800", "37,600"])
        axis.set_yticks(marks, [f"{mark:g}" for mark in marks])
    if held:
        right = axes[2]
        right.plot([done / 1e6 for done, _ in held], [value for _, value in held], "-", color=COLOURS[0])
        right.set_ylim(0, 100)
        _axes(right, "million messages", f"resident memory in MB ({BETTER})", legend=False)
    save(figure, path)


def _axes(axis: Any, across: str, up: str, legend: bool = True) -> None:
    axis.set_xlabel(across, fontsize=8)
    axis.set_ylabel(up, fontsize=8)
    axis.tick_params(labelsize=7)
    axis.grid(alpha=0.3)
    if legend:
        axis.legend(fontsize=7)


def draw_offline(result: Dict[str, Any], path: str) -> None:
    """Draw the seconds of a bag run by each interpreter."""
    rows = result["rows"]
    figure, axis = pyplot.subplots(figsize=(7, 0.5 * len(rows) + 1))
    names = [f"CPython {version}" for version in rows]
    starts = [row["start"] for row in rows.values()]
    axis.barh(names, starts, label="start", color=COLOURS[5])
    axis.barh(names, [row["run"] for row in rows.values()], left=starts, label="run", color=COLOURS[0])
    axis.set_xlabel(f"seconds of CPU for {result['seconds']:.0f} seconds of a bag ({BETTER})", fontsize=9)
    axis.legend(fontsize=8, loc="center left", bbox_to_anchor=(1, 0.5), frameon=False)
    save(figure, path)


def draw_curves(result: Dict[str, Any], path: str) -> None:
    """Draw the growth of each cost."""
    rows = result["rows"]
    columns = min(4, len(rows))
    lines = -(-len(rows) // columns)
    figure, axes = pyplot.subplots(lines, columns, figsize=(2.9 * columns, 2.2 * lines + 0.6), squeeze=False)
    flat: List[Any] = [axis for row in axes for axis in row]
    for axis, row in zip(flat, rows.values()):
        points: List[Tuple[float, float]] = row["points"]
        axis.plot([size for size, _ in points], [us for _, us in points], "o-", color=COLOURS[0], ms=3)
        axis.set_xscale("log")
        axis.set_yscale("log")
        axis.set_ylim(0.3, 300)
        axis.set_title(f"{row['title']}\n$N^{{{row['exponent']:.2f}}}$", fontsize=7)
        _axes(axis, "N of them", "microseconds an event", legend=False)
        axis.set_yticks([1, 10, 100], ["1", "10", "100"])
    for axis in flat[len(rows) :]:
        axis.set_visible(False)
    figure.suptitle(
        f"both axes logarithmic; {BETTER}, and a flat line is a cost that does not grow", fontsize=9
    )
    save(figure, path)
