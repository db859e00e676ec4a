"""Evaluation of a long run: poses, service calls, and memory."""

from typing import Any, Iterator, List, NamedTuple, Tuple

POSE_MARGIN_SECONDS = 0.5
"""Seconds of the stream before and after an image in which its poses may need messages."""

RESTART_MARGIN_SECONDS = 1.0
"""Seconds before the end of a node and after its restart in which messages are in transit or not sent to it."""

MAX_MEMORY_FACTOR_AND_MEGABYTES = 1.1, 10.0
"""Factor and MB by which the maximum memory may exceed the previous maximum."""

POSE_TOLERANCE = 1e-9

NODES = "retalis", "retalis_ros_interface"


class Restart(NamedTuple):
    """The restart of a process.

    Attributes:
        seconds: time since the start.
        name: the process.
        signal: the signal that ended it.
        first: newest stamp of a received pose before the end, in seconds of the stream.
        last: stamp that was sent when all processes were running again.
    """

    seconds: float
    name: str
    signal: str
    first: float
    last: float


class Poses:
    """Poses by outcome: lists of a marker and its stamp in seconds of the stream.

    Attributes:
        received: the number of received poses.
        near: missing or wrong poses near a restart of a node.
        dropped: missing or wrong poses at a drop that a node has counted.
        lost: other missing poses.
        wrong: other wrong poses.
        twice: poses that are received more than once.
    """

    def __init__(self) -> None:
        self.received = 0
        self.near: List[Tuple[str, float]] = []
        self.dropped: List[Tuple[str, float]] = []
        self.lost: List[Tuple[str, float]] = []
        self.wrong: List[Tuple[str, float]] = []
        self.twice: List[Tuple[str, float]] = []


def verdict(soak: Any) -> Tuple[Any, ...]:
    """Return whether all checks succeed, and a line for each of them."""
    stream, drops = soak.stream, soak.drops
    poses = judge(stream, soak.expected, soak.restarts, drops.growths, soak.options.speed)
    silent = [node for node in NODES if not drops.report_counts.get(node)]
    checks = [
        (poses.received > 0, f"{poses.received} poses received"),
        (not poses.lost, f"{len(poses.lost)} poses are lost without a reason{_where(poses.lost)}"),
        (
            not poses.wrong,
            f"{len(poses.wrong)} poses differ from those of the playback without a reason"
            f"{_where(poses.wrong)}",
        ),
        (not poses.twice, f"{len(poses.twice)} poses received twice{_where(poses.twice)}"),
        (not silent, f"both nodes counted dropped messages{': not ' if silent else ''}{', '.join(silent)}"),
        (
            not soak.caller.failures,
            f"{soak.caller.calls} calls of services, {len(soak.caller.failures)} failed {soak.caller.failures[:3]}",
        ),
        *_memory(soak.rows, 60 * soak.options.minutes),
    ]
    restarts = ", ".join(
        f"{restart.name} by {restart.signal} at {restart.seconds:.0f} s" for restart in soak.restarts
    )
    lines = [
        f"{stream.sent} messages and {stream.images} images sent, at most {stream.late:.1f} s late; "
        f"poses at most {max((row['behind'] for row in soak.rows), default=0.0):.1f} s behind; "
        f"{drops.total} counted as dropped",
        f"restarts: {restarts or 'none'}",
        f"missing or wrong with a reason: {len(poses.near)} poses near a restart of a node, "
        f"{len(poses.dropped)} where a drop was counted",
        *(f"{'good' if is_good else 'BAD '} {text}" for is_good, text in checks),
    ]
    lines += [
        f"     dropped: {drop.number} at {drop.status}, sent from {drop.first:.1f} to {drop.last:.1f}"
        for drop in drops.growths[:20]
    ]
    return all(is_good for is_good, _ in checks), lines


def judge(stream: Any, expected: Any, restarts: Any, drops: Any, speed: Any) -> Poses:
    """Return the poses by outcome.

    A missing or wrong pose has a reason only if its messages were in transit to a node that was ended, were sent
    while it was down, or were in transit while a node counted drops. A restart of the master is no reason.
    """
    margin = RESTART_MARGIN_SECONDS * speed
    down = [
        (restart.first - margin, restart.last + margin) for restart in restarts if restart.name != "master"
    ]
    lossy = [(drop.first, drop.last) for drop in drops]
    poses = Poses()
    for turn in range(stream.turns):
        for view in stream.truth.complete:
            key = view.marker, view.stamp + turn * stream.step * 10**9
            seconds = turn * stream.step + (view.stamp - stream.truth.start) / 1e9
            pose = stream.poses.get(key)
            poses.received += pose is not None
            name = view.marker, round(seconds, 2)
            if stream.times[key] > 1:
                poses.twice.append(name)
            exact = expected[view.marker, view.stamp]
            if pose is not None and max(abs(a - b) for a, b in zip(pose, exact)) <= POSE_TOLERANCE:
                continue
            if _within(seconds, down):
                poses.near.append(name)
            elif _within(seconds, lossy):
                poses.dropped.append(name)
            elif pose is None:
                poses.lost.append(name)
            else:
                poses.wrong.append(name)
    return poses


def _within(seconds: Any, spans: Any) -> bool:
    return any(first - POSE_MARGIN_SECONDS <= seconds <= last + POSE_MARGIN_SECONDS for first, last in spans)


def _where(poses: Any) -> str:
    return f": {', '.join(f'{marker} at {seconds}' for marker, seconds in poses[:10])}" if poses else ""


def _memory(rows: Any, seconds: Any) -> Iterator[Any]:
    """Compare the maximum memory in the two halves of the time after minute 5."""
    settled = min(300.0, seconds / 3)
    middle = (settled + seconds) / 2
    for name in NODES:
        before = [row[name] for row in rows if settled <= row["seconds"] < middle]
        after = [row[name] for row in rows if row["seconds"] >= middle]
        old_size, new_size = max(before, default=0.0), max(after, default=0.0)
        factor, extra = MAX_MEMORY_FACTOR_AND_MEGABYTES
        text = (
            f"node {name} holds at most {old_size:.0f} MB from second {settled:.0f}, "
            f"{new_size:.0f} MB from {middle:.0f}"
        )
        yield new_size <= factor * old_size + extra, text
