"""The transform buffer in Python; `test/ros1/test_tf2_buffer.py` compares its results with tf2."""

import math
import sys
from pathlib import Path
from random import Random
from typing import Any, List, Tuple

import pytest
from asserting_accessors import required
from hypothesis import given
from hypothesis import strategies as st

sys.path.append(str(Path(__file__).resolve().parent))
import random_transforms  # noqa: E402

from retalis.events.knowledge import transform_buffer  # noqa: E402
from retalis.events.knowledge.transform_buffer import REPEATED, CoordinateFrame, TransformBuffer  # noqa: E402

SECOND = 10**9
NO_ROTATION = (0.0, 0.0, 0.0, 1.0)


def transform_at(x: float, rotation: Any = NO_ROTATION) -> Tuple[Any, ...]:
    return (float(x), 0.0, 0.0, *rotation)


def buffer_of(*transforms: Any, cache: int = 10) -> Any:
    buffer = TransformBuffer(cache)
    for transform in transforms:
        assert isinstance(buffer.store(*transform), CoordinateFrame)
    return buffer


def fault_kind(buffer: Any, *arguments: Any) -> Any:
    fault = buffer.find_fault(*arguments)
    assert (fault is None) == (buffer.lookup(*arguments) is not None)
    return None if fault is None else fault.kind


def matrix(position: Any, rotation: Any) -> List[Any]:
    x, y, z, w = rotation
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w), position[0]],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w), position[1]],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y), position[2]],
        [0.0, 0.0, 0.0, 1.0],
    ]


def product(first: Any, second: Any) -> List[List[Any]]:
    return [[sum(a * b for a, b in zip(row, column)) for column in zip(*second)] for row in first]


@given(st.integers(0, 10**6))
def test_pose_is_product_along_path(seed: int) -> None:
    generator = Random(seed)
    names = [f"f{number}" for number in range(generator.randint(2, 7))]
    buffer, to_root = TransformBuffer(), {"root": matrix((0, 0, 0), NO_ROTATION)}
    for position, name in enumerate(names):
        parent = generator.choice(["root", *names[:position]])
        values = [generator.uniform(-2, 2) for _ in range(3)], [generator.gauss(0, 1) for _ in range(4)]
        length = math.hypot(*values[1])
        values = values[0], [value / length for value in values[1]]
        transform: Any = (*values[0], *values[1])
        buffer.store(parent, name, 5, transform, generator.random() < 0.3)
        to_root[name] = product(to_root[parent], matrix(*values))
    target, source = generator.choice(names), generator.choice(["root", *names])
    pose = matrix(*required(buffer.lookup(target, source, 5)))
    # The pose of the source in the target, moved by the target's own pose, is the source's pose in the root.
    for row, expected in zip(product(to_root[target], pose), to_root[source]):
        assert row == pytest.approx(expected, abs=1e-9)


@given(st.floats(0, 1), st.floats(0.01, 3.1))
def test_rotations_are_interpolated_at_constant_speed(part: float, angle: float) -> None:
    turn = (0.0, 0.0, math.sin(angle / 2), math.cos(angle / 2))
    instant = SECOND + round(part * SECOND)
    buffer = buffer_of(("a", "b", SECOND, transform_at(0)), ("a", "b", 2 * SECOND, transform_at(4, turn)))
    (x, _, _), (_, _, k, w) = buffer.lookup("a", "b", instant)
    share = (instant - SECOND) / SECOND
    assert x == pytest.approx(4 * share)
    assert 2 * math.atan2(k, w) == pytest.approx(share * angle, abs=1e-7)


def test_lookup_needs_samples_before_and_after() -> None:
    buffer = buffer_of(("a", "b", 2 * SECOND, transform_at(1)), ("a", "b", 3 * SECOND, transform_at(2)))
    assert fault_kind(buffer, "a", "b", 2 * SECOND - 1) == "before"
    assert fault_kind(buffer, "a", "b", 3 * SECOND + 1) == "after"
    assert buffer.find_fault("a", "b", 1) == ("before", "b", "", 2 * SECOND)
    assert buffer.find_fault("a", "b", 9 * SECOND) == ("after", "b", "", 3 * SECOND)
    assert buffer.lookup("a", "b", 0)[0][0] == 2.0
    assert buffer.lookup("b", "a", 2 * SECOND)[0][0] == -1.0
    assert buffer.lookup("a", "a", 7) == ((0, 0, 0), (0, 0, 0, 1))


def test_errors_name_the_frame() -> None:
    buffer = buffer_of(("a", "b", 2 * SECOND, transform_at(1)), ("c", "d", 3 * SECOND, transform_at(2)))
    assert buffer.find_fault("a", "x", 5) == ("unknown", "x", "", None)
    assert buffer.find_fault("/a", "b", 5).kind == "invalid"
    assert buffer.find_fault("", "b", 5).kind == "invalid"
    assert buffer.find_fault("a", "d", 3 * SECOND) == ("unconnected", "a", "d", None)
    assert buffer.find_fault("b", "d", 0) == ("unconnected", "b", "d", None)


def test_loop_of_frames_is_refused() -> None:
    buffer = buffer_of(
        ("a", "b", 5, transform_at(1)), ("b", "a", 5, transform_at(1)), ("c", "d", 5, transform_at(1))
    )
    assert fault_kind(buffer, "d", "a", 5) == "loop"
    assert fault_kind(buffer, "a", "d", 5) == "loop"
    assert buffer.find_blocking("d", "a", 5) is buffer.topology


def test_static_transforms_are_valid_at_any_time() -> None:
    buffer = buffer_of(("a", "b", 5, transform_at(1), True), ("b", "c", SECOND, transform_at(1)))
    assert buffer.lookup("a", "c", SECOND)[0][0] == 2.0
    assert buffer.lookup("a", "b", 77 * SECOND)[0][0] == 1.0
    assert buffer.latest_common("a", "b") == 0
    assert buffer.latest_common("a", "c") == SECOND
    buffer.clear()
    assert buffer.lookup("a", "b", 1)
    assert not buffer.lookup("a", "c", SECOND)
    assert buffer.sample_count == 1


def test_late_samples_are_inserted_in_history() -> None:
    buffer = buffer_of(*(("a", "b", second * SECOND, transform_at(second)) for second in range(1, 31)))
    assert buffer.sample_count == 11
    assert fault_kind(buffer, "a", "b", 20 * SECOND - 1) == "before"
    assert buffer.store("a", "b", 19 * SECOND, transform_at(0)) == "it is older than the history of 10 s"
    assert buffer.store("a", "b", 25 * SECOND, transform_at(0)) is REPEATED
    assert buffer.store("a", "b", 25 * SECOND + 5, transform_at(7)).sample_count == 12
    assert buffer.lookup("a", "b", 25 * SECOND + 5)[0][0] == 7.0
    assert buffer.refused == 1


def test_memory_of_buffer_is_bounded() -> None:
    buffer = TransformBuffer(1)
    for number in range(5000):
        buffer.store("a", "b", number * SECOND // 100, transform_at(number))
    (frame,) = [frame for frame in buffer.frames() if frame.name == "b"]
    assert buffer.sample_count == 101
    assert len(frame.stamps) < 1000
    assert required(buffer.lookup("a", "b", 4950 * SECOND // 100))[0][0] == 4950


def test_new_parent_applies_from_first_sample() -> None:
    buffer = buffer_of(("a", "b", SECOND, transform_at(0), True))
    for parent, second in (("a", 1), ("b", 3)):
        buffer.store(parent, "c", second * SECOND, transform_at(second))
    buffer.store("b", "c", 4 * SECOND, transform_at(4))
    assert buffer.lookup("a", "c", 2 * SECOND)[0][0] == 1.0
    assert buffer.lookup("b", "c", 3 * SECOND + SECOND // 2)[0][0] == 3.5


@pytest.mark.parametrize(
    ("transform", "reason"),
    [
        (("a", "a", 5, transform_at(1)), "its own parent"),
        (("a", "", 5, transform_at(1)), "is empty"),
        (("", "a", 5, transform_at(1)), "is empty"),
        (("a", "b", 5, transform_at(math.nan)), "contains nan"),
        (("a", "b", 5, transform_at(1, (0.0, 0.0, 0.0, 1.1))), "does not have length 1"),
        (("a", "b", 5, transform_at(1, (0.0, 0.0, 0.0, math.inf))), "does not have length 1"),
        (("a", "b", -1, transform_at(1)), "from 1970 to 2106"),
        (("a", "b", SECOND << 32, transform_at(1)), "from 1970 to 2106"),
        (("a", "b" * 300, 5, transform_at(1)), "at most 256 characters"),
    ],
)
def test_invalid_transforms_are_refused(transform: Tuple[Any, ...], reason: str) -> None:
    buffer = TransformBuffer()
    assert reason in str(buffer.store(*transform))
    assert (buffer.refused, len(buffer), buffer.sample_count) == (1, 0, 0)


def test_frames_and_samples_are_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(transform_buffer, "MAX_FRAMES", 5)
    monkeypatch.setattr(transform_buffer, "MAX_SAMPLES", 20)
    buffer = TransformBuffer()
    for number in range(9):
        buffer.store("root", f"f{number}", SECOND, transform_at(1))
    assert len(buffer) == 5
    assert buffer.store("root", "f8", SECOND, transform_at(1)) == "there are 5 frames already"
    for number in range(40):
        buffer.store("root", "f0", 2 * SECOND + number, transform_at(1))
    assert buffer.sample_count == 20
    assert buffer.store("root", "f0", 3 * SECOND, transform_at(1)) == "there are 20 transforms already"
    # Older transforms than the history are removed first.
    assert isinstance(buffer.store("root", "f0", 30 * SECOND, transform_at(1)), CoordinateFrame)


def test_widest_gap_is_maximum_along_path() -> None:
    buffer = buffer_of(
        ("root", "a", SECOND, transform_at(1)),
        ("root", "a", 9 * SECOND, transform_at(1)),
        ("a", "b", SECOND, transform_at(1)),
        ("a", "b", 3 * SECOND, transform_at(1)),
        ("a", "c", 2 * SECOND, transform_at(1)),
    )
    assert buffer.widest_gap("root", "b", 2 * SECOND) == (8 * SECOND, "a")
    assert buffer.widest_gap("b", "c", 2 * SECOND) == (2 * SECOND, "b")
    assert buffer.widest_gap("b", "a", 3 * SECOND) == (0, "b")
    assert buffer.widest_gap("b", "x", 3 * SECOND) == (0, "")


def test_frame_without_transform_blocks_lookup() -> None:
    buffer = buffer_of(
        ("root", "a", SECOND, transform_at(1)),
        ("a", "b", 3 * SECOND, transform_at(1)),
        ("a", "c", 5, transform_at(1), True),
    )

    def blocking(*arguments: Any) -> Any:
        frame = buffer.find_blocking(*arguments)
        return None if frame is None else frame.name

    assert blocking("root", "b", SECOND) is None
    assert blocking("root", "b", 2 * SECOND) == "a"
    assert blocking("root", "b", 4 * SECOND) == "b"
    assert blocking("c", "b", 2 * SECOND) is None, "frames above the common one are not needed"
    assert blocking("b", "c", 4 * SECOND) == "b"
    assert blocking("root", "x", SECOND) == ""


def test_loop_blocks_no_available_transform() -> None:
    """tf2 follows the parents of the source, and if one has no transform, those of the target."""
    loop = buffer_of(
        ("b", "a", 3 * SECOND, transform_at(1)),
        ("c", "b", 5, transform_at(1), True),
        ("a", "c", SECOND, transform_at(1)),
    )
    assert loop.find_fault("c", "a", 3 * SECOND) is None
    assert loop.find_blocking("c", "a", 3 * SECOND) is None
    pair = buffer_of(("b", "a", SECOND, transform_at(1)), ("a", "b", 3 * SECOND, transform_at(1)))
    assert pair.find_fault("b", "a", 3 * SECOND) is None
    assert pair.find_blocking("b", "a", 3 * SECOND) is None
    assert pair.find_blocking("b", "a", 4 * SECOND).name == "a"


@given(st.integers(0, 10**6))
def test_failed_lookup_has_no_later_result(seed: int) -> None:
    buffer = TransformBuffer()
    for operation, *arguments in random_transforms.scenario(seed):
        if operation != "ask":
            getattr(buffer, operation)(*arguments)
            continue
        target, source, instant = arguments
        fault = buffer.find_fault(*arguments)
        blocking = buffer.find_blocking(*arguments)
        if fault is None:
            assert blocking is None or instant == 0
        elif blocking is None and target and source and "/" not in target + source:
            assert fault.kind in ("before", "after", "unconnected", "loop")
        assert buffer.sample_count == sum(frame.sample_count for frame in buffer.frames())
