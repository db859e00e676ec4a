"""Whether a soak has gone as it should."""

from typing import List, NamedTuple, Tuple

NEED = 0.5
"""Seconds of the stream before and after a picture from which its poses may need messages."""

SLACK = 1.0
"""Seconds before a node is ended, and after it is up again, in which messages are under way or not yet sent to it."""

MEMORY = 1.1, 10.0
"""By which factor, and how many MB, the highest memory may be above what it was before."""

CLOSE = 1e-9

NODES = "retalis", "retalis_ros_interface"


class Restart(NamedTuple):
    """When a process was ended, and how.

    Attributes:
        first: the stream's stamp, in seconds, up to which poses had come by then.
        last: what was sent when all was up again.
    """

    seconds: float
    name: str
    signal: str
    first: float
    last: float


class Poses:
    """What became of the poses: lists of a marker and its stamp in seconds of the stream.

    Attributes:
        came: how many came.
        near: those that are missing or wrong near a restart of a node.
        dropped: those that are missing or wrong where a node has counted a drop.
        lost: all others that are missing.
        wrong: all others that are not what they have to be.
        twice: those that came more than once.
    """

    def __init__(self) -> None:
        self.came = 0
        self.near: List[Tuple[str, float]] = []
        self.dropped: List[Tuple[str, float]] = []
        self.lost: List[Tuple[str, float]] = []
        self.wrong: List[Tuple[str, float]] = []
        self.twice: List[Tuple[str, float]] = []


def verdict(soak):
    """Return whether all is well, and lines that tell."""
    stream, drops = soak.stream, soak.drops
    poses = judge(stream, soak.expected, soak.restarts, drops.found, soak.options.speed)
    silent = [node for node in NODES if not drops.looks.get(node)]
    checks = [
        (poses.came > 0, f"{poses.came} poses came"),
        (not poses.lost, f"{len(poses.lost)} poses are lost without a reason{_where(poses.lost)}"),
        (
            not poses.wrong,
            f"{len(poses.wrong)} poses are not what the engine gives offline, without a reason"
            f"{_where(poses.wrong)}",
        ),
        (not poses.twice, f"{len(poses.twice)} poses came twice{_where(poses.twice)}"),
        (not silent, f"both nodes counted what they dropped{': not ' if silent else ''}{', '.join(silent)}"),
        (
            not soak.caller.failures,
            f"{soak.caller.calls} calls of services, {len(soak.caller.failures)} failed {soak.caller.failures[:3]}",
        ),
        *_memory(soak.rows, 60 * soak.options.minutes),
    ]
    kinds = ", ".join(f"{one.name} by {one.signal} at {one.seconds:.0f} s" for one in soak.restarts)
    lines = [
        f"{stream.sent} messages and {stream.images} images sent, at most {stream.late:.1f} s late; "
        f"poses at most {max((row['behind'] for row in soak.rows), default=0.0):.1f} s behind; "
        f"{drops.total} counted as dropped",
        f"restarts: {kinds or 'none'}",
        f"missing or wrong with a reason: {len(poses.near)} poses near a restart of a node, "
        f"{len(poses.dropped)} where a drop was counted",
        *(f"{'good' if good else 'BAD '} {text}" for good, text in checks),
    ]
    lines += [
        f"     dropped: {one.number} at {one.what}, sent from {one.first:.1f} to {one.last:.1f}"
        for one in drops.found[:20]
    ]
    return all(good for good, _ in checks), lines


def judge(stream, expected, restarts, drops, speed):
    """Return what became of the poses.

    A pose is excused only where what it needs was under way to a node that was ended, or sent while it was down; or
    where it was under way while a node counted drops. A restart of the master excuses nothing.
    """
    slack = SLACK * speed
    down = [(one.first - slack, one.last + slack) for one in restarts if one.name != "master"]
    lossy = [(one.first, one.last) for one in drops]
    found = Poses()
    for turn in range(stream.turns):
        for one in stream.truth.complete:
            key = one.marker, one.stamp + turn * stream.step * 10**9
            seconds = turn * stream.step + (one.stamp - stream.truth.start) / 1e9
            pose = stream.poses.get(key)
            found.came += pose is not None
            name = one.marker, round(seconds, 2)
            if stream.times[key] > 1:
                found.twice.append(name)
            exact = expected[one.marker, one.stamp]
            if pose is not None and max(abs(a - b) for a, b in zip(pose, exact)) <= CLOSE:
                continue
            if _within(seconds, down):
                found.near.append(name)
            elif _within(seconds, lossy):
                found.dropped.append(name)
            elif pose is None:
                found.lost.append(name)
            else:
                found.wrong.append(name)
    return found


def _within(seconds, spans):
    return any(first - NEED <= seconds <= last + NEED for first, last in spans)


def _where(poses):
    return f": {', '.join(f'{marker} at {seconds}' for marker, seconds in poses[:10])}" if poses else ""


def _memory(rows, seconds):
    """Compare the highest memory in the two halves of the time after minute 5."""
    settled = min(300.0, seconds / 3)
    middle = (settled + seconds) / 2
    for name in NODES:
        before = [row[name] for row in rows if settled <= row["seconds"] < middle]
        after = [row[name] for row in rows if row["seconds"] >= middle]
        most, more = max(before, default=0.0), max(after, default=0.0)
        factor, extra = MEMORY
        text = f"node {name} holds at most {most:.0f} MB from second {settled:.0f}, {more:.0f} MB from {middle:.0f}"
        yield more <= factor * most + extra, text
