"""Whether a soak has gone as it should."""

from typing import NamedTuple

from stream import STEP

NEAR = 15.0
"""Seconds of the stream before and after a restart in which poses may be missing, or computed over the gap."""

MEMORY = 1.1, 10.0
"""By which factor, and how many MB, the highest memory may be above what it was before."""

CLOSE = 1e-9


class Restart(NamedTuple):
    """When a process was ended, how, and the stream's stamps (in seconds) of then and of when all was up again."""

    seconds: float
    name: str
    signal: str
    first: float
    last: float


def verdict(soak):
    """Return whether all is well, and lines that tell."""
    lost, wrong, twice, near, came = _poses(soak)
    dropped = soak.rows[-1]["dropped"]
    checks = [
        (
            len(lost) <= dropped,
            f"{came} poses came, {near} near a restart are missing; {len(lost)} others are lost",
        ),
        # What is computed beside a transform that was dropped goes over the gap.
        (
            not wrong or len(wrong) + len(lost) <= dropped,
            f"{len(wrong)} poses are not what the engine gives offline",
        ),
        (not twice, f"{len(twice)} poses came twice {twice[:3]}"),
        (
            not soak.caller.failures,
            f"{soak.caller.calls} calls of services, {soak.caller.failures[:3]} failed",
        ),
        *_memory(soak.rows, 60 * soak.options.minutes),
    ]
    kinds = ", ".join(f"{one.name} by {one.signal} at {one.seconds:.0f} s" for one in soak.restarts)
    lines = [f"{'good' if good else 'BAD '} {text}" for good, text in checks]
    stamps = sorted(round((key[1] - soak.stream.truth.start) / 1e9, 1) for key, _, _ in wrong)
    if stamps or soak.stream.unsent:
        lines.append(f"     wrong at {stamps[:30]}, not sent at {soak.stream.unsent[:5]}")
    first = f"{soak.stream.sent} messages and {soak.stream.images} images sent, {dropped} reported as dropped"
    return all(good for good, _ in checks), [first, f"restarts: {kinds or 'none'}", *lines]


def _poses(soak):
    gaps = [(one.first - NEAR, one.last + NEAR) for one in soak.restarts if one.name != "master"]
    lost, wrong, twice, near, came = [], [], [], 0, 0
    complete = [(one.marker, one.stamp) for one in soak.stream.truth.complete]
    for turn in range(soak.stream.turns):
        for marker, stamp in complete:
            seconds = turn * STEP + (stamp - soak.stream.truth.start) / 1e9
            key = marker, stamp + turn * STEP * 10**9
            found = soak.stream.poses.get(key)
            disturbed = any(first <= seconds <= last for first, last in gaps)
            came += found is not None
            if found is None:
                near += disturbed
                if not disturbed:
                    lost.append(key)
                continue
            if soak.stream.times[key] > 1:
                twice.append(key)
            exact = soak.expected[marker, stamp]
            if not disturbed and max(abs(a - b) for a, b in zip(found, exact)) > CLOSE:
                wrong.append((key, found, exact))
    return lost, wrong, twice, near, came


def _memory(rows, seconds):
    """Compare the highest memory in the two halves of the time after minute 5."""
    settled = min(300.0, seconds / 3)
    middle = (settled + seconds) / 2
    for name in ("retalis", "retalis_ros_interface"):
        before = [row[name] for row in rows if settled <= row["seconds"] < middle]
        after = [row[name] for row in rows if row["seconds"] >= middle]
        most, more = max(before, default=0.0), max(after, default=0.0)
        factor, extra = MEMORY
        text = f"node {name} holds at most {most:.0f} MB from second {settled:.0f}, {more:.0f} MB from {middle:.0f}"
        yield more <= factor * most + extra, text
