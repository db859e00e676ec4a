#!/usr/bin/env python3
"""Write a ROS 1 bag of a simulated NAO, and next to it a file with the true positions of the markers.

The bag has the topics of the original example: ``/tf``, ``/ar_pose_marker`` and
``/face_recognition/feedback``. The same seconds and seed give the same bag.
"""

import argparse
import sys
from heapq import merge
from pathlib import Path
from random import Random
from typing import Iterator, List, NamedTuple, Optional, Sequence, Tuple

_HERE = Path(__file__).resolve().parent
for _folder in (_HERE, _HERE.parent.parent / "src"):
    if str(_folder) not in sys.path:
        sys.path.append(str(_folder))

import nao_messages  # noqa: E402
import nao_truth  # noqa: E402
from nao_robot import MARKERS, Link, Robot  # noqa: E402
from nao_truth import Observation, Truth  # noqa: E402

from retalis import BagWriter, RetalisError, Term  # noqa: E402

START = 1413748205
"""Start of the bag in seconds since the epoch."""

MARKER_RATE = 7.0
FACE_RATE = 3.0
FACES = ("anna", "boris", "chen", "dora")

TF, MARKER, FACE = "/tf", "/ar_pose_marker", "/face_recognition/feedback"
_TYPES = {
    TF: "tf/tfMessage",
    MARKER: "ar_pose/ARMarkers",
    FACE: "face_recognition/FaceRecognitionActionFeedback",
}
_CALLERS = {TF: "/robot_state_publisher", MARKER: "/ar_multi", FACE: "/face_recognition"}

_LATEST = 0.5
_LATE_MARKERS = 0.15
_LATE_FILLER = 0.01


class _Event(NamedTuple):
    received: int
    topic: str
    term: Term


def make_bag(path: nao_truth.PathLike, seconds: float = 10.0, seed: int = 1) -> Truth:
    """Write a bag and a file with the truth; return the truth.

    Raises:
        RetalisError: where the bag exists already or cannot be written.
    """
    robot = Robot(seed)
    observations: List[Observation] = []
    definitions = nao_messages.definitions()
    encoders = nao_messages.encoders(definitions)
    with BagWriter(path) as bag:
        connections = {
            topic: bag.add(topic, definitions[kind], caller=_CALLERS[topic]) for topic, kind in _TYPES.items()
        }
        encode = {topic: encoders[kind].encode for topic, kind in _TYPES.items()}
        for received, topic, term in _events(robot, seconds, seed, observations):
            bag.write(connections[topic], received, encode[topic](term, topic))
    truth = Truth(seconds, seed, START * 10**9, robot.markers, observations)
    nao_truth.save(truth, path)
    return truth


def _events(robot: Robot, seconds: float, seed: int, observations: List[Observation]) -> Iterator[_Event]:
    """Yield all messages in the order of their receipt; record the observations of markers."""
    streams = [
        _link(link, seconds, Random(f"chain {seed} {index}"), 0.0) for index, link in enumerate(robot.chain)
    ]
    for index, link in enumerate(robot.filler):
        late = _link(link, seconds, Random(f"filler {seed} {index}"), _LATE_FILLER)
        streams.append(iter(sorted(late, key=_received)))
    seen = sorted(_seen(seconds, seed), key=lambda one: one[1])
    first, last = _span(robot, seconds)
    observations += [
        Observation(name, stamp, received, first <= stamp <= last) for stamp, received, name in seen
    ]
    streams.append(_marker_events(robot, seen))
    streams.append(iter(sorted(_face_events(seconds, seed), key=_received)))
    return merge(*streams, key=_received)


def _received(event: _Event) -> int:
    return event.received


def _nanoseconds(time: float) -> int:
    return START * 10**9 + round(time * 1e9)


def _times(link: Link, seconds: float) -> Iterator[float]:
    """Yield the times of a link's transforms; each link has another phase."""
    shift = (sum(map(ord, link.child)) % 97) / 97 / link.rate
    number = 0
    while True:
        time = shift + number / link.rate
        if time >= seconds:
            return
        yield time
        number += 1


def _span(robot: Robot, seconds: float) -> Tuple[int, int]:
    """Return the interval in which all links of the chain have data."""
    times = [[_nanoseconds(time) for time in _times(link, seconds)] for link in robot.chain]
    if not all(times):
        return 1, 0
    return max(found[0] for found in times), min(found[-1] for found in times)


def _link(link: Link, seconds: float, random: Random, late: float) -> Iterator[_Event]:
    """Yield a link's messages; a share ``late`` of them is received up to half a second after its stamp."""
    for sequence, time in enumerate(_times(link, seconds)):
        stamp = _nanoseconds(time)
        delay = random.uniform(0.0005, 0.004)
        if random.random() < late:
            delay = random.uniform(0.02, _LATEST)
        term = nao_messages.transform(sequence, stamp, link.parent, link.child, link.pose(time))
        yield _Event(stamp + round(delay * 1e9), TF, term)


def _frames(rate: float, seconds: float, random: Random) -> Iterator[float]:
    """Yield the times of pictures with a recognition: a constant rate with the jitter of a camera."""
    number = 0
    while number < round(seconds * rate):
        jitter = min(0.025, max(-0.025, random.gauss(0.0, 0.008)))
        yield (number + 0.5) / rate + jitter
        number += 1


def _seen(seconds: float, seed: int) -> Iterator[Tuple[int, int, str]]:
    """Yield stamp, receipt and name of each visible marker; all eight are seen in changing order."""
    random = Random(f"markers {seed}")
    turn: List[str] = []
    for time in _frames(MARKER_RATE, seconds, random):
        if not turn:
            turn = random.sample(MARKERS, len(MARKERS))
        delay = random.uniform(0.03, 0.08)
        if random.random() < _LATE_MARKERS:
            delay = random.uniform(0.15, _LATEST)
        stamp = _nanoseconds(time)
        yield stamp, stamp + round(delay * 1e9), turn.pop()


def _marker_events(robot: Robot, seen: Sequence[Tuple[int, int, str]]) -> Iterator[_Event]:
    for sequence, (stamp, received, name) in enumerate(seen):
        pose = robot.seen(name, (stamp - START * 10**9) / 1e9)
        yield _Event(received, MARKER, nao_messages.marker(sequence, stamp, name, pose, 50 + stamp % 50))


def _face_events(seconds: float, seed: int) -> Iterator[_Event]:
    random = Random(f"faces {seed}")
    for sequence, time in enumerate(_frames(FACE_RATE, seconds, random)):
        names = random.sample(FACES, 2 if random.random() < 0.2 else 1)
        confidence = [round(random.uniform(0.6, 0.98), 3) for _ in names]
        stamp = _nanoseconds(time)
        term = nao_messages.faces(sequence, stamp, START * 10**9, names, confidence)
        yield _Event(stamp + round(random.uniform(0.05, 0.15) * 1e9), FACE, term)


def main(arguments: Optional[Sequence[str]] = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--seconds", type=float, default=10.0, help="length of the bag (default 10)")
    parser.add_argument("--seed", type=int, default=1, help="another seed gives another run (default 1)")
    parser.add_argument("--output", required=True, metavar="FILE.bag", help="the bag to write")
    parser.add_argument("--force", action="store_true", help="overwrite an existing bag")
    given = parser.parse_args(arguments)
    output = Path(given.output)
    try:
        if given.force and output.exists():
            output.unlink()
        truth = make_bag(output, given.seconds, given.seed)
    except (RetalisError, OSError) as error:
        print(f"make_bag.py: {error}", file=sys.stderr)
        return 1
    print(
        f"{output}: {given.seconds:g} s, {len(truth.observations)} observations "
        f"of {len(truth.markers)} markers; true positions in {nao_truth.truth_path(output)}"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
