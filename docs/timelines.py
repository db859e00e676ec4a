#!/usr/bin/env python3
"""Draw the timelines of the language reference: each picture shows the example that follows it on the page.

    docs/timelines.py

Needs matplotlib and no ROS. A picture belongs to the first ``prolog`` fence after it. The first line ``% events =>
results`` of the fence is run, and its events and results are drawn by the lanes of ``retalis plot``. The text of the
fence is stored in the description of the picture, and a test compares the two.
"""

import re
import sys
from pathlib import Path
from typing import Dict, Iterator, List, NamedTuple, Tuple
from xml.etree import ElementTree

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "src"))

from retalis import Engine  # noqa: E402
from retalis.prolog.terms import timestamps  # noqa: E402
from retalis.prolog.terms.timestamps import SECOND  # noqa: E402
from retalis.visualization.timeline import Mark, TimelineLane, assign_rows, draw_lanes  # noqa: E402

PAGES = HERE / "reference" / "language"
PICTURE = re.compile(r"^!\[[^\]]*\]\((pictures/[\w-]+\.svg)\)$", re.MULTILINE)
FENCE = re.compile(r"^```prolog\n(.*?)^```", re.MULTILINE | re.DOTALL)
EVENT = re.compile(r"(\S.*?) \[([\d.]+),([\d.]+)\](?:, |$)")
HIDDEN = ("memory_created(", "memory_updated(", "synchronized(", "null")
"""Beginnings of events that are not drawn: those of memories and queries, and heads of rules without an event."""

DESCRIPTION = "{http://purl.org/dc/elements/1.1/}description"
WIDTH, LANE_HEIGHT = 7.2, 0.42
"""Width of a picture, and height of one of its lanes, in inches."""


class Example(NamedTuple):
    """A picture of a page, and the text of the fence that it shows."""

    path: Path
    text: str


def examples(page: Path) -> Iterator[Example]:
    """Yield the pictures of a page with their examples."""
    text = page.read_text(encoding="utf-8")
    for picture in PICTURE.finditer(text):
        fence = FENCE.search(text, picture.end())
        if fence is None:
            raise ValueError(f"{page.name}: no example follows {picture.group(1)}")
        yield Example(page.parent / picture.group(1), fence.group(1))


def run_example(text: str) -> List[TimelineLane]:
    """Return the lanes of the incoming events of an example, then those of its results."""
    line = next(line for line in text.splitlines() if line.startswith("% ") and "=>" in line)
    given = EVENT.findall(line[2:].split("=>")[0].strip())
    engine = Engine()
    lanes: Dict[Tuple[bool, str], List[Mark]] = {}
    engine.load(rules=text)

    def record(term: object, start: int, end: int) -> None:
        shown = engine.show(term)
        if not shown.startswith(HIDDEN):
            name, label = lane_and_label(shown)
            lanes.setdefault((shown not in terms, name), []).append((start / SECOND, end / SECOND, label))

    terms = {term for term, _, _ in given}
    engine.on_event(record)
    for term, start, end in given:
        engine.clock.move_to(timestamps.from_seconds(float(end)))
        engine.event(term, *(float(stamp) if "." in stamp else int(stamp) for stamp in (start, end)))
    return [
        TimelineLane("output" if derived else "event", name, marks, len(marks))
        for (derived, name), marks in sorted(lanes.items(), key=lambda item: item[0][0])
    ]


def lane_and_label(term: str) -> Tuple[str, str]:
    """Return the name of the lane of an event, and the label of its mark.

    >>> lane_and_label("temperature(left,70)"), lane_and_label("order(1)"), lane_and_label("tick")
    (('temperature(left)', '70'), ('order', '1'), ('tick', ''))

    A retraction has a lane for each event that is retracted:

    >>> lane_and_label("rev(face(ann))")
    ('rev(face(ann))', '')
    """
    name, _, rest = term.partition("(")
    if name == "rev":
        return term, ""
    first, comma, others = rest[:-1].partition(",")
    if re.fullmatch(r"[a-z]\w*", first):
        return f"{name}({first})", others
    return name, first + comma + others


def draw(example: Example) -> None:
    """Draw the picture of an example."""
    import matplotlib  # noqa: PLC0415 - only drawing needs it
    from matplotlib.figure import Figure  # noqa: PLC0415

    lanes = run_example(example.text)
    figure = Figure(figsize=(WIDTH, LANE_HEIGHT * len(lanes) + 0.6))
    axes = figure.subplots()
    draw_lanes(axes, lanes)
    for row, lane in enumerate(lanes):
        rows = assign_rows(lane.marks)
        row_count = 1 + max(index or 0 for index in rows)
        for (start, end, label), index in zip(lane.marks, rows):
            middle = (start + end) / 2
            if row_count == 1 or index is None:
                axes.annotate(
                    label, (middle, row - 0.34), (0, 1), textcoords="offset points", ha="center", fontsize=7
                )
            else:
                # Above the lane, labels of bars that overlap in time would overlap, too.
                height = row - 0.32 + (index + 0.45) * 0.64 / row_count
                axes.text(middle, height, label, ha="center", va="center", fontsize=7)
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": example.path.name}):
        metadata = {"Description": example.text, "Date": None, "Creator": None}
        figure.savefig(example.path, bbox_inches="tight", metadata=metadata)


def description(path: Path) -> str:
    """Return the example that a picture was drawn from."""
    return "".join(element.text or "" for element in ElementTree.parse(path).iter(DESCRIPTION))


def texts(path: Path) -> List[str]:
    """Return the texts that a picture shows."""
    return [
        element.text or "" for element in ElementTree.parse(path).iter("{http://www.w3.org/2000/svg}text")
    ]


def main() -> None:
    """Draw all pictures."""
    (PAGES / "pictures").mkdir(exist_ok=True)
    for page in sorted(PAGES.glob("*.md")):
        for example in examples(page):
            draw(example)


if __name__ == "__main__":
    main()
