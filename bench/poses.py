#!/usr/bin/env python3
"""Cost of a chain of transforms: look-up of a pose and storage of a transform, beside tf2's if it is installed.

    bench/poses.py [--samples N]

Five transforms with 2,500 samples each at 50 Hz, and 10,000 look-ups at random instants, in order of time, of the
pose in the world of something that the last frame sees. All implementations get the same work in alternating parts; a
figure is the median of the parts, in microseconds of CPU time.

    clauses        ``transform_marker/3`` of the NAO's program: look-ups, interpolations, their product
    pose_chain     the predicate for the whole chain
    tf_transform   the predicate that reads the tree of transforms, by tf2_py if it is installed
    in python      the same, computed in Python as in playback
    tf_lookup      the predicate for the pose of the last frame, by tf2_py if it is installed
    tf2 look-up    ``lookup_transform_core`` alone
    tf2            ``lookup_transform_core`` and the product with the last pose, by tf2_py
    message        storage of a transform from a message, split by the NAO's rules
    event          storage of a transform from an event ``tf(Parent, Child, V, Q)``
    /tf            storage of a transform from the bytes of a message, of a frame that no look-up has needed
    /tf, used      the same of a frame that look-ups need
    /tf, copied    the same, and the next look-up, which copies the samples to tf2_py, if that is installed
    /tf python     the same in the buffer in Python
    set_transform  storage of a transform from a message in tf2's buffer
"""

import argparse
import importlib.util
import math
import random
import statistics
import struct
import sys
import time
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List, NamedTuple, Sequence, Tuple

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "src")]

import workload as work  # noqa: E402
from arguments import positive  # noqa: E402

from retalis import Engine, Settings, functor, limit_gc_pauses, make_list  # noqa: E402
from retalis.events.knowledge.transform_buffer import TransformBuffer  # noqa: E402
from retalis.messages.transform_messages import TransformReader  # noqa: E402

SAMPLES, QUESTIONS, PART = 2500, 10_000, 200
LAST = ((1.0, 0.5, 0.2), (0.0, 0.0, math.sin(0.2), math.cos(0.2)))
NAMES = ", ".join(name for _, _, name, _ in work.CHAIN)
RULES = f"""
last([{list(LAST[0])}, {list(LAST[1])}]).
clauses([]).
clauses([T|Ts]) :- last(P), transform_marker(P, T, _), clauses(Ts).
chains([]).
chains([T|Ts]) :- last(P), pose_chain([{NAMES}, P], T, _), chains(Ts).
"""
TREE_RULES = f"""
last([{list(LAST[0])}, {list(LAST[1])}]).
trees(Ts) :- last(P), trees(Ts, P).
trees([], _).
trees([T|Ts], P) :- tf_transform(P, 'CameraTop_frame', odom, T, _), trees(Ts, P).
lookups([]).
lookups([T|Ts]) :- tf_lookup(odom, 'CameraTop_frame', T, _), lookups(Ts).
"""
CACHE = 1_000_000.0
"""History of transforms in seconds: all samples."""


class Sample(NamedTuple):
    """A transform at an instant (ns): parent, child, position, rotation."""

    instant: int
    parent: str
    child: str
    position: Sequence[float]
    rotation: Sequence[float]


def samples(number: int) -> List[Sample]:
    """Return the samples of all joints, in order of time."""
    found = []
    for joint, (parent, child, _, _) in enumerate(work.CHAIN):
        for k in range(number):
            t = k / 50 + 0.001 * joint
            half, tilt = 0.25 * math.sin(t * 0.3 + joint), 0.3 * math.cos(t * 0.2 + 2 * joint)
            turn = [
                math.sin(half) * math.cos(tilt),
                math.sin(half) * math.sin(tilt),
                0.1 * math.sin(t + joint),
            ]
            turn.append(math.cos(half))
            length = math.sqrt(sum(value * value for value in turn))
            instant = work.BASE * 10**9 + 20_000_000 * k + 1_000_000 * joint
            place = [math.sin(t + joint), 0.1 * joint, 0.2 + 0.01 * t % 1]
            found.append(Sample(instant, parent, child, place, [value / length for value in turn]))
    return sorted(found)


def questions(number: int) -> List[int]:
    """Return the instants of the look-ups, at which all joints are known."""
    rnd = random.Random(1)
    first, last = work.BASE * 10**9 + 24_000_000, work.BASE * 10**9 + 20_000_000 * (number - 2)
    return sorted(rnd.randrange(first, last) for _ in range(QUESTIONS))


def parts(items: Sequence[Any]) -> Iterator[Sequence[Any]]:
    """Yield a sequence in parts of equal length."""
    return (items[at : at + PART] for at in range(0, len(items) - PART + 1, PART))


def engine() -> Engine:
    """Return an engine with the NAO's program and memories."""
    made = Engine()
    made.load(goals="set_etalis_flag(event_consumption_policy, unrestricted)")
    made.load_rules((work.APPLICATION / "eventRules.txt").read_text(encoding="utf-8"), "eventRules.txt")
    made.load(rules=RULES, goals=work.MEMORIES)
    return made


def event(sample: Sample) -> Any:
    """Return the event that the NAO's rules emit for a transform."""
    pose = make_list(sample.position), make_list(sample.rotation)
    return work.make_term("tf", work.quoted(sample.parent), work.quoted(sample.child), *pose)


def message(sample: Sample) -> Any:
    """Return the term of a message of one transform."""
    make = work.Messages()
    numbers = make.numbers("Vector3", *sample.position), make.numbers("Quaternion", *sample.rotation)
    header = make.header(*divmod(sample.instant, 10**9), sample.parent)
    transform = make.make("geometry_msgs__0__Transform", *numbers)
    stamped = make.make("geometry_msgs__0__TransformStamped", header, work.quoted(sample.child), transform)
    return work.make_term("tf__0__tfMessage", make_list([stamped]))


Way = Tuple[str, Callable[[Any], object], List[Any]]
"""Name, function for a part of the work, and the parts."""


def ours(found: List[Sample], asked: List[int]) -> Iterator[Way]:
    """Yield the engine's implementations."""
    full, by_event, by_message = engine(), engine(), engine()
    for sample in found:
        full.post(event(sample), sample.instant)
    times = [make_list([make_list(divmod(instant, 10**9)) for instant in part]) for part in parts(asked)]
    yield "clauses", lambda part: full.call(functor("clauses", 1)(part)), times
    yield "pose_chain", lambda part: full.call(functor("chains", 1)(part)), times

    def post(into: Engine) -> Callable[[Any], object]:
        return lambda part: [into.post(term, instant) for term, instant in part]

    yield "message", post(by_message), list(parts([(message(sample), sample.instant) for sample in found]))
    yield "event", post(by_event), list(parts([(event(sample), sample.instant) for sample in found]))


def serialized(sample: Sample) -> bytes:
    """Return a message on /tf with one transform."""
    parent, child = sample.parent.encode(), sample.child.encode()
    return b"".join(
        (
            struct.pack("<5I", 1, 0, *divmod(sample.instant, 10**9), len(parent)),
            parent,
            struct.pack("<I", len(child)),
            child,
            struct.pack("<7d", *sample.position, *sample.rotation),
        )
    )


def trees(found: List[Sample], asked: List[int]) -> Iterator[Way]:
    """Yield the engine's implementations that read the tree of transforms."""
    buffers = [("in python", "/tf python", TransformBuffer)]
    if importlib.util.find_spec("tf2_py") is not None:
        from retalis.ros1.tf2_buffer import Tf2Buffer

        buffers.insert(0, ("tf_transform", "/tf", Tf2Buffer))
    messages = [serialized(sample) for sample in found]
    times = [make_list([make_list(divmod(instant, 10**9)) for instant in part]) for part in parts(asked)]
    for ask_name, store_name, buffer in buffers:

        def made(buffer: Callable[[float], TransformBuffer] = buffer) -> Engine:
            return Engine(settings=Settings(tf_cache=CACHE, transform_buffer=buffer))

        full = made()
        full.load(rules=TREE_RULES)
        storage(full)(messages)
        yield ask_name, lambda part, full=full: full.call(functor("trees", 1)(part)), times  # type: ignore[misc]
        yield store_name, storage(made()), list(parts(messages))
        if store_name == "/tf":
            calls = functor("lookups", 1)
            yield "tf_lookup", lambda part, full=full, calls=calls: full.call(calls(part)), times  # type: ignore[misc]
            yield "/tf, used", used_storage(made(), messages[:PART], False), list(parts(messages[PART:]))
            yield "/tf, copied", used_storage(made(), messages[:PART], True), list(parts(messages[PART:]))


def storage(into: Engine) -> Callable[[Any], object]:
    """Return a function that stores messages."""
    read, process_input = TransformReader(is_static=False).read, into.event_input.process_input
    return lambda part: into.executor.post_each(process_input, ((read(data), None) for data in part))


def used_storage(into: Engine, first: List[bytes], then_look_up: bool) -> Callable[[Any], object]:
    """Return a function that stores messages of frames that a look-up has needed, and then may look up a pose."""
    store, look_up = storage(into), into.knowledge.transforms.buffer.lookup
    store(first)
    look_up("odom", "CameraTop_frame", 0)
    return lambda part: (store(part), then_look_up and look_up("odom", "CameraTop_frame", 0))


def theirs(found: List[Sample], asked: List[int]) -> Iterator[Way]:
    """Yield tf2's implementations; none if it is not installed."""
    try:
        import tf2_py
        from genpy import Duration, Time
        from geometry_msgs.msg import Quaternion, TransformStamped, Vector3
    except ImportError as error:
        print(f"without tf2: {error}")
        return

    def stamped(sample: Sample) -> Any:
        made = TransformStamped()
        made.header.stamp = Time(*divmod(sample.instant, 10**9))
        made.header.frame_id, made.child_frame_id = sample.parent.strip("/"), sample.child.strip("/")
        made.transform.translation = Vector3(*sample.position)
        made.transform.rotation = Quaternion(*sample.rotation)
        return made

    full, filling = tf2_py.BufferCore(Duration(1_000_000)), tf2_py.BufferCore(Duration(1_000_000))
    messages = [stamped(sample) for sample in found]
    for one in messages:
        full.set_transform(one, "bench")
    top, bottom = work.CHAIN[0][0].strip("/"), work.CHAIN[-1][1].strip("/")

    def ask(part: Sequence[Any]) -> None:
        for at in part:
            found = full.lookup_transform_core(top, bottom, at).transform
            t, r = found.translation, found.rotation
            product(((t.x, t.y, t.z), (r.x, r.y, r.z, r.w)), LAST)

    def look_up(part: Sequence[Any]) -> None:
        for at in part:
            full.lookup_transform_core(top, bottom, at)

    yield "tf2 look-up", look_up, list(parts([Time(*divmod(instant, 10**9)) for instant in asked]))
    yield "tf2", ask, list(parts([Time(*divmod(instant, 10**9)) for instant in asked]))
    yield (
        "set_transform",
        lambda part: [filling.set_transform(one, "bench") for one in part],
        list(parts(messages)),
    )


def product(left: Any, right: Any) -> Any:
    """Return the product of two poses; the left one's rotation has length 1."""
    (x, y, z), (i, j, k, w) = left
    (px, py, pz), (a, b, c, d) = right
    u, v, s = 2 * (j * pz - k * py), 2 * (k * px - i * pz), 2 * (i * py - j * px)
    place = x + px + w * u + j * s - k * v, y + py + w * v + k * u - i * s, z + pz + w * s + i * v - j * u
    turn = w * a + i * d + j * c - k * b, w * b - i * c + j * d + k * a, w * c + i * b - j * a + k * d
    return place, (*turn, w * d - i * a - j * b - k * c)


def main() -> int:
    """Run the benchmark that the command line selects."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--samples", type=positive, default=SAMPLES, help="of each transform")
    options = parser.parse_args()
    stored, asked = samples(options.samples), questions(options.samples)
    ways = [*ours(stored, asked), *trees(stored, asked), *theirs(stored, asked)]
    limit_gc_pauses()
    taken: Dict[str, List[float]] = {name: [] for name, _, _ in ways}
    for at in range(max(len(each) for _, _, each in ways)):
        for name, run, each in ways:
            if at < len(each):
                began = time.process_time()
                run(each[at])
                taken[name].append((time.process_time() - began) / PART * 1e6)
    for name, found in taken.items():
        print(f"{name:<14} {statistics.median(found):7.2f} us, at best {min(found):.2f}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
