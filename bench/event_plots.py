"""Plots of the figures of ``bench/events.py``: growth of each operator, and memory."""

import math
from typing import Any, Dict, Iterable, List, Sequence, Tuple

import matplotlib
from fitting import exponent

matplotlib.use("Agg")
from matplotlib import pyplot, ticker  # noqa: E402

STYLES = {
    "recent": ("#0072b2", "o", "-"),
    "recent_2": ("#56b4e9", "s", "--"),
    "chronological": ("#d55e00", "^", "-"),
    "chronological_2": ("#e69f00", "v", "--"),
    "unrestricted": ("#009e73", "D", "-"),
}
TITLES = {
    "values": "partners told apart by a shared variable: the event fits one",
    "alike": "partners alike: the event fits all",
    "times": "partners told apart by their times only: the event fits one",
    "shuffled": "partners told apart by their times only, arrived in any order",
}
BOUNDS = (("#555555", "-"), ("#0072b2", "-"), ("#d55e00", "--"), ("#009e73", "-."), ("#e69f00", ":"))


def draw(figures: Dict[str, Any], prefix: str) -> List[str]:
    """Draw all plots; return the names of the files."""
    files = []
    for setting in TITLES:
        rows = [row for row in figures["rows"] if row["setting"] == setting]
        if rows:
            files.append(f"{prefix}-{setting}.png")
            draw_growth(rows, TITLES[setting], files[-1])
    if figures["memory"]:
        files.append(f"{prefix}-memory.png")
        draw_memory(figures["memory"], files[-1])
    return files


def exponents(rows: Sequence[Dict[str, Any]]) -> Dict[str, float]:
    """Return the fitted exponent of each policy."""
    return {
        policy: exponent([p for p in points(rows, policy) if p[0] >= 100])
        for policy in dict.fromkeys(row["policy"] for row in rows)
    }


def points(rows: Sequence[Dict[str, Any]], policy: str) -> List[Tuple[float, float]]:
    """Return the sizes and the microseconds for each result."""
    return [(row["waiting"], row["us"] / max(1, row["results"])) for row in rows if row["policy"] == policy]


def draw_growth(rows: Sequence[Dict[str, Any]], title: str, file: str) -> None:
    """Draw one small plot for each operator, all to the same scale."""
    names = list(dict.fromkeys(row["operator"] for row in rows))
    columns = min(len(names), 5 if len(names) % 5 in (0, 4) else 4)
    lines = math.ceil(len(names) / columns)
    figure, axes = pyplot.subplots(
        lines, columns, figsize=(2.2 * columns, 1.9 * lines + 0.9), sharex=True, sharey=True, squeeze=False
    )
    flat = [one for line in axes for one in line]
    for axis, name in zip(flat, names):
        mine = [row for row in rows if row["operator"] == name]
        _draw_operator(axis, name, mine)
    for axis in flat[len(names) :]:
        axis.set_visible(False)
    for at, axis in enumerate(flat[: len(names)]):
        if at + columns >= len(names):
            axis.tick_params(labelbottom=True)
    handles, labels = flat[0].get_legend_handles_labels()
    height = 1.9 * lines + 0.9
    figure.suptitle(title, fontsize=11, y=1 - 0.12 / height)
    figure.supxlabel(
        "N: partial matches that wait (both axes logarithmic; a flat line does not grow)",
        fontsize=9,
        y=0.1 / height,
    )
    figure.supylabel("\u00b5s of CPU for each result (less is better)", fontsize=9)
    place: Dict[str, Any] = {"loc": "upper center", "bbox_to_anchor": (0.5, 1 - 0.3 / height)}
    figure.legend(handles, labels, ncol=5, fontsize=8, frameon=False, **place)
    figure.tight_layout(rect=(0.01, 0.12 / height, 1.0, 1 - 0.5 / height), h_pad=0.8)
    figure.savefig(file, dpi=90)
    pyplot.close(figure)


def _draw_operator(axis: Any, name: str, rows: Sequence[Dict[str, Any]]) -> None:
    for policy in dict.fromkeys(row["policy"] for row in rows):
        colour, marker, line = STYLES[policy]
        axis.loglog(
            *zip(*points(rows, policy)),
            line,
            color=colour,
            marker=marker,
            markersize=3,
            linewidth=1,
            label=policy,
        )
    axis.set_title(f"{name}   {_powers(exponents(rows).values())}", fontsize=8)
    axis.grid(True, which="major", linewidth=0.4, color="#dddddd")
    axis.tick_params(labelsize=7)
    axis.set_xticks([10, 10**3, 10**5])
    axis.yaxis.set_major_locator(ticker.LogLocator(subs=(1, 2, 5)))
    axis.yaxis.set_major_formatter(lambda value, at: f"{value:g}")
    axis.minorticks_off()


def _powers(found: Iterable[float]) -> str:
    """Return the range of fitted exponents as a formula."""
    texts = [f"N^{{{max(0.0, round(value, 2)):.2f}}}" for value in sorted(found) if not math.isnan(value)]
    return " to ".join(f"${text}$" for text in dict.fromkeys(texts[:1] + texts[-1:]))


def draw_memory(memory: Dict[str, Any], file: str) -> None:
    """Draw the memory of processes over the number of partial matches."""
    figure, axis = pyplot.subplots(figsize=(6.5, 3.6))
    for (name, samples), (colour, line) in zip(memory.items(), BOUNDS):
        more = [(sample[1] - samples[0][1]) / 1e6 for sample in samples]
        events = [sample[0] for sample in samples]
        axis.plot(
            events, more, line, color=colour, label=f"{name}: {more[-1]:.0f} MB at the end", linewidth=1.6
        )
    axis.set_xlabel("half matches so far", fontsize=9)
    axis.set_ylabel("MB more than at the start (less is better)", fontsize=9)
    axis.set_title("memory with nothing ever completed", fontsize=10)
    axis.xaxis.set_major_formatter(lambda value, at: f"{value:,.0f}")
    axis.grid(True, linewidth=0.4, color="#dddddd")
    axis.tick_params(labelsize=8)
    axis.legend(fontsize=8, frameon=False)
    figure.tight_layout()
    figure.savefig(file, dpi=90)
    pyplot.close(figure)
