#!/usr/bin/env python3
"""Draw the pictures of programs and of what they do: nao-program.svg, nao-map.png, timeline.png and door.png.

    docs/pictures.py [--folder docs/images]

Needs matplotlib, Graphviz and rosbags, and no ROS. The programs are run; nothing in the pictures is written by hand
but the names of the lanes.
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


class Lane(NamedTuple):
    """A line of a timeline: its title, how the texts of its events begin, and their colour."""

    title: str
    begins: str
    colour: str


class Happened(NamedTuple):
    """An event of a run, with its interval in nanoseconds."""

    text: str
    start: int
    end: int


def bag_maker(example: str) -> Any:
    """Return the script make_bag.py of an example; there are two of that name."""
    found: Any = importlib.util.spec_from_file_location(
        f"{example}_bag", str(ROOT / "examples" / example / "make_bag.py")
    )
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module


def nao_map(path: Path) -> None:
    """Draw where the simulated NAO walked, where the markers are, and where its program has located them."""
    seconds, seed, nao = 40.0, 1, bag_maker("nao")
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "nao.bag"
        truth = nao.make_bag(bag, seconds, seed)
        found = located(bag)
    robot = Robot(seed)
    way = [robot.chain[0].pose(0.1 * step)[0] for step in range(int(10 * seconds))]
    figure, axis = pyplot.subplots(figsize=(6.4, 6.4))
    axis.plot([x for x, _, _ in way], [y for _, y, _ in way], "-", color=MESSAGE, label="the robot's way")
    last, before = way[-1], way[-8]
    axis.annotate("", last[:2], before[:2], arrowprops={"arrowstyle": "-|>", "color": MESSAGE, "lw": 2})
    places = {name: place for name, (place, _) in truth.markers.items()}
    true = list(places.values())
    axis.plot(
        [x for x, _, _ in true], [y for _, y, _ in true], "s", ms=13, mfc="none", mec=EVENT, label="markers"
    )
    for at, (stamp, x, y) in enumerate(found[::4]):
        eye = robot.camera(stamp / SECOND - nao.START)[0]
        seen = "from where the camera saw them, one in four" if at == 0 else None
        axis.plot([eye[0], x], [eye[1], y], "-", lw=0.7, alpha=0.35, color=RESULT, label=seen)
    poses = f"{len(found)} poses that the program published"
    axis.plot([x for _, x, _ in found], [y for _, _, y in found], ".", ms=4, color=RESULT, label=poses)
    for name, (x, y, _) in places.items():
        axis.annotate(name, (x, y), (0, 11), textcoords="offset points", ha="center", fontsize=8)
    axis.set_aspect("equal")
    axis.margins(0.12)
    axis.set_xlabel("metres")
    axis.set_ylabel("metres")
    axis.set_title(f"{seconds:.0f} seconds of a walking NAO, seen from above", fontsize=11)
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.1), ncol=2, frameon=False)
    save(figure, path)


def located(bag: Path) -> List[Tuple[int, float, float]]:
    """Return where the NAO program locates markers: the stamp in nanoseconds, and the place on the map."""
    places = []
    with BagReader(bag) as reader:
        for output in Playback(ROOT / "application_source", print).run(reader):
            if output.topic.startswith("marker"):
                header, pose = resolve(output.term)[1:]
                seconds, nanoseconds = list_items(header[2])
                places.append((seconds * SECOND + nanoseconds, pose[1][1], pose[1][2]))
    return places


def fever(path: Path) -> None:
    """Draw the example of the README: its rule and its events, as they stand there."""
    page = (ROOT / "README.md").read_text(encoding="utf-8")
    (rules,) = re.findall(r"<!-- fever.txt -->\n```prolog\n(.*?)```", page, re.DOTALL)
    events = re.findall(r'engine.event\("(.*)", (\d+)\)', page)
    engine = Engine()
    engine.load(rules=rules)
    happened = watch(engine)
    for term, time in events:
        engine.event(term, int(time))
    lanes = (
        Lane("temperature(ann, T)", "temperature(ann", EVENT),
        Lane("temperature(bob, T)", "temperature(bob", EVENT),
        Lane("fever(ann, T)", "fever(ann", RESULT),
        Lane("fever(bob, T)", "fever(bob", RESULT),
    )
    timeline(path, lanes, happened, 0, (2.4, "fever: two temperatures above 38 within 60 seconds"))


def door(path: Path) -> None:
    """Draw the run of the cookbook's door."""
    folder, cookbook = ROOT / "examples" / "cookbook" / "door", bag_maker("cookbook")
    with tempfile.TemporaryDirectory() as temporary:
        bag = Path(temporary) / "door.bag"
        cookbook.make_bag(folder, bag)
        playback = Playback(folder, print)
        happened = watch(playback.engine)
        with BagReader(bag) as reader:
            list(playback.run(reader))
    lanes = (
        Lane("std_msgs/Bool: true", "std_msgs__0__Bool(true", MESSAGE),
        Lane("std_msgs/Bool: false", "std_msgs__0__Bool(false", MESSAGE),
        Lane("contact(true)", "contact(true", EVENT),
        Lane("contact(false)", "contact(false", EVENT),
        Lane("left_open", "left_open", RESULT),
        Lane("was_open", "was_open(", RESULT),
    )
    timeline(
        path, lanes, happened, cookbook.START, (3.4, "door: left open for ten seconds, and for how long")
    )


def watch(engine: Engine) -> List[Happened]:
    """Return a list that fills with the events of an engine."""
    happened: List[Happened] = []

    def note(term: Any, start: int, end: int) -> None:
        happened.append(Happened(engine.show(term), start, end))

    engine.on_event(note)
    return happened


def timeline(
    path: Path, lanes: Sequence[Lane], happened: Sequence[Happened], began: int, look: Tuple[float, str]
) -> None:
    """Draw events as bars over time, a lane for each kind; an instant is a dot."""
    height, title = look
    figure, axis = pyplot.subplots(figsize=(8, height))
    for at, lane in enumerate(lanes):
        for event in happened:
            if event.text == lane.begins or "(" in lane.begins and event.text.startswith(lane.begins):
                start, end = (instant / SECOND - began for instant in (event.start, event.end))
                axis.plot(
                    [start, end], [at, at], "-", lw=5, alpha=0.5, color=lane.colour, solid_capstyle="butt"
                )
                axis.plot([end], [at], "o", ms=6, color=lane.colour)
                value = labels(event.text)
                if value:
                    axis.annotate(
                        value, (end, at), (0, 7), textcoords="offset points", ha="center", fontsize=8
                    )
    axis.set_yticks(range(len(lanes)), [lane.title for lane in lanes], fontsize=9, family="monospace")
    axis.set_ylim(len(lanes) - 0.4, -0.8)
    axis.set_xlabel("seconds", fontsize=9)
    axis.set_title(title, fontsize=10)
    axis.grid(axis="x", alpha=0.3)
    axis.tick_params(axis="x", labelsize=8)
    for side in ("top", "right", "left"):
        axis.spines[side].set_visible(False)
    save(figure, path)


def labels(text: str) -> str:
    """Return what is written beside an event: its numbers and texts, and no stamps."""
    quoted = re.findall(r'"(.*)"', text)
    if quoted:
        return str(quoted[0])
    found = re.findall(r"\d+\.\d+", text)
    return ", ".join(found) if "(datime" not in text else ""


def save(figure: Any, path: Path) -> None:
    """Write a figure to a file."""
    figure.tight_layout()
    figure.savefig(path, dpi=100)
    pyplot.close(figure)


def main() -> None:
    """Do what the command line says."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--folder", type=Path, default=HERE / "images", help="where to write them")
    options = parser.parse_args()
    folder = options.folder.resolve()
    os.chdir(str(ROOT))  # the program is called as it is from there
    retalis(["graph", "application_source", "--output", str(folder / "nao-program.svg")])
    nao_map(folder / "nao-map.png")
    fever(folder / "timeline.png")
    door(folder / "door.png")


if __name__ == "__main__":
    main()
