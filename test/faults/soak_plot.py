#!/usr/bin/env python3
"""Draw the log of a long run: ``soak_plot.py FILE.csv FILE.png``. Needs matplotlib, no ROS."""

import csv
import sys
from typing import Any


def draw(log: Any, picture: Any) -> None:
    """Draw memory above, and numbers of messages below, over the minutes."""
    import matplotlib as mpl  # noqa: PLC0415 - not installed with every Python that has ROS

    mpl.use("Agg")
    from matplotlib import pyplot  # noqa: PLC0415

    with open(log, newline="") as file:
        rows = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]
    minutes = [row["seconds"] / 60 for row in rows]
    figure, (above, below) = pyplot.subplots(2, 1, sharex=True, figsize=(8, 6))
    for name in ("retalis", "retalis_ros_interface"):
        above.plot(minutes, [row[name] or None for row in rows], label=name)
    above.set_ylabel("resident memory [MB]")
    above.set_ylim(bottom=0)
    for name in ("sent", "images", "poses", "calls", "dropped"):
        below.plot(minutes, [row[name] for row in rows], label=name)
    below.set_yscale("symlog")
    below.set_ylabel("number in all")
    below.set_xlabel("minutes")
    before = 0.0
    for minute, row in zip(minutes, rows):
        if row["restarts"] > before:
            before = row["restarts"]
            for axes in (above, below):
                axes.axvline(minute, color="grey", linewidth=0.6)
    for axes in (above, below):
        axes.legend(fontsize="small")
        axes.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(picture, dpi=120)


if __name__ == "__main__":
    draw(*sys.argv[1:3])
