#!/usr/bin/env python3
"""Draw the pictures of example programs and of their events: nao-program.svg, nao-map.png, timeline.png and door.png.

    docs/pictures.py [--folder docs/images]

Needs matplotlib, Graphviz and rosbags, and no ROS. All positions, times and values in the pictures come from runs of
the programs.
"""

import argparse
import importlib.util
import os
import re
import sys
import tempfile
from pathlib import Path
from typing import Any, List, NamedTuple, Sequence, Tuple

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
sys.path[:0] = [str(ROOT / folder) for folder in ("src", "examples/nao")]

import matplotlib  # noqa: E402
from nao_robot import Robot  # noqa: E402

from retalis import BagReader, Engine, Playback, list_items  # noqa: E402
from retalis.cli.command_line import main as retalis  # noqa: E402
from retalis.prolog.terms.term_traversal import resolve  # noqa: E402

matplotlib.use("Agg")
from matplotlib import pyplot  # noqa: E402

MESSAGE, EVENT, RESULT = "#888888", "#0072b2", "#d55e00"
SECOND = 10**9


class TimelineRow(NamedTuple):
    """A row of a timeline: its title, and the prefix and the colour of its events.

    A prefix without a parenthesis is the whole text of the event.
    """

    title: str
    prefix: str
    colour: str


class RecordedEvent(NamedTuple):
    """An event of a run, with its interval in nanoseconds."""

    text: str
    start: int
    end: int


def load_bag_maker(example: str) -> Any:
    """Return the module ``make_bag.py`` of an example, under a name of its own, because two examples have one."""
    spec: Any = importlib.util.spec_from_file_location(
        f"{example}_bag", str(ROOT / "examples" / example / "make_bag.py")
    )
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def draw_nao_map(path: Path) -> None:
    """Draw the path of the simulated NAO, the markers, and the marker positions that its program publishes."""
    seconds, seed, nao = 40.0, 1, load_bag_maker("nao")
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "nao.bag"
        truth = nao.make_bag(bag, seconds, seed)
        published = marker_positions(bag)
    robot = Robot(seed)
    track = [robot.chain[0].pose(0.1 * step)[0] for step in range(int(10 * seconds))]
    figure, axis = pyplot.subplots(figsize=(6.4, 6.4))
    axis.plot(
        [x for x, _, _ in track], [y for _, y, _ in track], "-", color=MESSAGE, label="path of the robot"
    )
    last, earlier = track[-1], track[-8]
    axis.annotate("", last[:2], earlier[:2], arrowprops={"arrowstyle": "-|>", "color": MESSAGE, "lw": 2})
    markers = {name: position for name, (position, _) in truth.markers.items()}
    true = list(markers.values())
    axis.plot(
        [x for x, _, _ in true], [y for _, y, _ in true], "s", ms=13, mfc="none", mec=EVENT, label="markers"
    )
    for number, (stamp, x, y) in enumerate(published[::4]):
        camera = robot.camera(stamp / SECOND - nao.START)[0]
        label = "line of sight of the camera, one in four" if number == 0 else None
        axis.plot([camera[0], x], [camera[1], y], "-", lw=0.7, alpha=0.35, color=RESULT, label=label)
    label = f"{len(published)} poses that the program published"
    axis.plot(
        [x for _, x, _ in published], [y for _, _, y in published], ".", ms=4, color=RESULT, label=label
    )
    for name, (x, y, _) in markers.items():
        axis.annotate(name, (x, y), (0, 11), textcoords="offset points", ha="center", fontsize=8)
    axis.set_aspect("equal")
    axis.margins(0.12)
    axis.set_xlabel("metres")
    axis.set_ylabel("metres")
    axis.set_title(f"{seconds:.0f} seconds of a walking NAO, seen from above", fontsize=11)
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.1), ncol=2, frameon=False)
    save(figure, path)


def marker_positions(bag: Path) -> List[Tuple[int, float, float]]:
    """Return the marker positions that the NAO program publishes: timestamp in ns, x and y on the map in metres."""
    positions = []
    with BagReader(bag) as reader:
        for output in Playback(ROOT / "application_source", print).run(reader):
            if output.topic.startswith("marker"):
                header, pose = resolve(output.term)[1:]
                seconds, nanoseconds = list_items(header[2])
                positions.append((seconds * SECOND + nanoseconds, pose[1][1], pose[1][2]))
    return positions


def draw_fever(path: Path) -> None:
    """Draw the events of the example of the README."""
    page = (ROOT / "README.md").read_text(encoding="utf-8")
    (rules,) = re.findall(r"<!-- fever.txt -->\n```prolog\n(.*?)```", page, re.DOTALL)
    events = re.findall(r'engine.event\("(.*)", (\d+)\)', page)
    engine = Engine()
    engine.load(rules=rules)
    recorded = record_events(engine)
    for term, time in events:
        engine.event(term, int(time))
    rows = (
        TimelineRow("temperature(ann, T)", "temperature(ann", EVENT),
        TimelineRow("temperature(bob, T)", "temperature(bob", EVENT),
        TimelineRow("fever(ann, T)", "fever(ann", RESULT),
        TimelineRow("fever(bob, T)", "fever(bob", RESULT),
    )
    draw_timeline(path, rows, recorded, 0, 2.4, "fever: two temperatures above 38 within 60 seconds")


def draw_door(path: Path) -> None:
    """Draw the events of the program ``door`` of the cookbook."""
    folder, cookbook = ROOT / "examples" / "cookbook" / "door", load_bag_maker("cookbook")
    with tempfile.TemporaryDirectory() as temporary:
        bag = Path(temporary) / "door.bag"
        cookbook.make_bag(folder, bag)
        playback = Playback(folder, print)
        recorded = record_events(playback.engine)
        with BagReader(bag) as reader:
            list(playback.run(reader))
    rows = (
        TimelineRow("std_msgs/Bool: true", "std_msgs__0__Bool(true", MESSAGE),
        TimelineRow("std_msgs/Bool: false", "std_msgs__0__Bool(false", MESSAGE),
        TimelineRow("contact(true)", "contact(true", EVENT),
        TimelineRow("contact(false)", "contact(false", EVENT),
        TimelineRow("left_open", "left_open", RESULT),
        TimelineRow("was_open", "was_open(", RESULT),
    )
    title = "door: left open for ten seconds, and for how long"
    draw_timeline(path, rows, recorded, cookbook.START, 3.4, title)


def record_events(engine: Engine) -> List[RecordedEvent]:
    """Return a list to which each further event of an engine is appended."""
    recorded: List[RecordedEvent] = []

    def record(term: Any, start: int, end: int) -> None:
        recorded.append(RecordedEvent(engine.show(term), start, end))

    engine.on_event(record)
    return recorded


def draw_timeline(
    path: Path,
    rows: Sequence[TimelineRow],
    recorded: Sequence[RecordedEvent],
    epoch: int,
    height: float,
    title: str,
) -> None:
    """Draw events as bars over time, with a dot at the end of each.

    Args:
        path: File to write.
        rows: Rows from top to bottom; an event without a row is not drawn.
        recorded: Events to draw.
        epoch: Instant 0 of the time axis, in s.
        height: Height of the picture, in inches.
        title: Title of the picture.
    """
    figure, axis = pyplot.subplots(figsize=(8, height))
    for position, row in enumerate(rows):
        for event in recorded:
            if event.text == row.prefix or "(" in row.prefix and event.text.startswith(row.prefix):
                start, end = (instant / SECOND - epoch for instant in (event.start, event.end))
                axis.plot(
                    [start, end],
                    [position, position],
                    "-",
                    lw=5,
                    alpha=0.5,
                    color=row.colour,
                    solid_capstyle="butt",
                )
                axis.plot([end], [position], "o", ms=6, color=row.colour)
                label = event_label(event.text)
                if label:
                    axis.annotate(
                        label, (end, position), (0, 7), textcoords="offset points", ha="center", fontsize=8
                    )
    axis.set_yticks(range(len(rows)), [row.title for row in rows], fontsize=9, family="monospace")
    axis.set_ylim(len(rows) - 0.4, -0.8)
    axis.set_xlabel("seconds", fontsize=9)
    axis.set_title(title, fontsize=10)
    axis.grid(axis="x", alpha=0.3)
    axis.tick_params(axis="x", labelsize=8)
    for side in ("top", "right", "left"):
        axis.spines[side].set_visible(False)
    save(figure, path)


def event_label(text: str) -> str:
    """Return the label of an event: its quoted text or its decimal numbers, but no timestamp."""
    quoted = re.findall(r'"(.*)"', text)
    if quoted:
        return str(quoted[0])
    numbers = re.findall(r"\d+\.\d+", text)
    return ", ".join(numbers) if "(datime" not in text else ""


def save(figure: Any, path: Path) -> None:
    """Write a figure to a file."""
    figure.tight_layout()
    figure.savefig(path, dpi=100)
    pyplot.close(figure)


def main() -> None:
    """Draw all pictures."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--folder", type=Path, default=HERE / "images", help="folder of the pictures")
    options = parser.parse_args()
    folder = options.folder.resolve()
    os.chdir(str(ROOT))  # The picture shows the name of the program relative to the working directory.
    retalis(["graph", "application_source", "--output", str(folder / "nao-program.svg")])
    draw_nao_map(folder / "nao-map.png")
    draw_fever(folder / "timeline.png")
    draw_door(folder / "door.png")


if __name__ == "__main__":
    main()
