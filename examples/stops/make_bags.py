#!/usr/bin/env python3
"""Write recordings of three robots on two days, as ``FOLDER/ROBOT/DAY.bag``.

    examples/stops/make_bags.py recordings

Each recording has the position of the robot once a second, and the level of its battery once a minute. The last one
is cut, as by a crash of the recorder. The same messages are written each time.
"""

import argparse
import sys
from datetime import datetime, timezone
from pathlib import Path
from typing import Dict, Iterator, NamedTuple, Tuple

_SOURCE = Path(__file__).resolve().parents[2] / "src"
if _SOURCE.is_dir() and str(_SOURCE) not in sys.path:
    sys.path.append(str(_SOURCE))

from retalis import BagWriter, Definitions, Term, atom, functor, make_list  # noqa: E402

SECOND = 10**9
STOP_SECONDS = 20
DOCK, DOOR, LIFT = (0.0, 0.0), (4.5, 2.0), (9.0, 6.0)


class Recording(NamedTuple):
    """A recording: its length in minutes, the level of the battery at its start, and the stops by their second."""

    minutes: int
    level: float
    stops: Dict[int, Tuple[float, float]]


RECORDINGS = {
    "r07/2026-11-28": Recording(20, 0.9, {100: DOOR, 500: DOOR, 900: LIFT}),
    "r07/2026-11-29": Recording(15, 0.3, {300: DOOR, 700: LIFT}),
    "r08/2026-11-28": Recording(20, 0.8, {200: LIFT}),
    "r08/2026-11-29": Recording(10, 0.7, {}),
    "r09/2026-11-28": Recording(30, 0.35, {100: DOOR, 400: DOOR, 1000: DOOR, 1150: LIFT}),
    "r09/2026-11-29": Recording(15, 0.6, {60: DOCK, 800: DOCK}),
}
CUT = "r09/2026-11-29"
"""The recording that is cut."""

PERCENT_A_MINUTE = 1


def make_term(name: str, *arguments: Term) -> Term:
    """Return a message as a term."""
    return functor(name, len(arguments))(*arguments)


def list_messages(recording: Recording, start: int) -> Iterator[Tuple[int, str, Term]]:
    """Yield time, topic and term of each message.

    Args:
        recording: the recording.
        start: its first second, since the epoch.
    """
    for second in range(recording.minutes * 60):
        stops = [place for begin, place in recording.stops.items() if 0 <= second - begin < STOP_SECONDS]
        x, y = stops[0] if stops else (second * 0.01, second * 0.02)
        header = make_term("std_msgs__0__Header", second, make_list([start + second, 0]), atom('"map"'))
        pose = make_term(
            "geometry_msgs__0__Pose",
            make_term("geometry_msgs__0__Point", x, y, 0.0),
            make_term("geometry_msgs__0__Quaternion", 0.0, 0.0, 0.0, 1.0),
        )
        # A message is received 20 ms after it is stamped.
        time = (start + second) * SECOND + SECOND // 50
        yield time, "/pose", make_term("geometry_msgs__0__PoseStamped", header, pose)
        if second % 60 == 0:
            level = recording.level - PERCENT_A_MINUTE / 100 * (second // 60)
            yield time, "/battery", make_term("std_msgs__0__Float32", level)


def write_bag(path: Path, recording: Recording, start: int) -> None:
    """Write a recording."""
    definitions = Definitions()
    types = {"/pose": "geometry_msgs/PoseStamped", "/battery": "std_msgs/Float32"}
    with BagWriter(path, overwrite=True) as bag:
        connections = {topic: bag.add(topic, definitions.find(name)) for topic, name in types.items()}
        for time, topic, term in list_messages(recording, start):
            bag.write(connections[topic], time, definitions.encoder(types[topic]).encode(term))


def main() -> None:
    """Write all recordings."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("folder", type=Path)
    folder: Path = parser.parse_args().folder
    for name, recording in RECORDINGS.items():
        path = folder / f"{name}.bag"
        path.parent.mkdir(parents=True, exist_ok=True)
        morning = datetime.strptime(f"{path.stem} 08:00 +0000", "%Y-%m-%d %H:%M %z").astimezone(timezone.utc)
        write_bag(path, recording, int(morning.timestamp()))
        if name == CUT:
            content = path.read_bytes()
            path.write_bytes(content[: len(content) // 2])


if __name__ == "__main__":
    main()
