"""Transform buffers, in Python and of nodes: same poses and errors as tf2."""

import math
import sys
from pathlib import Path
from typing import Any, Dict, List

import pytest
import rospy
import tf2_py
from geometry_msgs.msg import TransformStamped
from nightly_round_numbers import round_numbers

from retalis.events.knowledge import transform_buffer
from retalis.events.knowledge.transform_buffer import TransformBuffer
from retalis.ros1.tf2_buffer import Tf2Buffer

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "events" / "knowledge"))
import random_transforms  # noqa: E402

TREES = 10_000

EXCEPTIONS = {
    "invalid": tf2_py.InvalidArgumentException,
    "unknown": tf2_py.LookupException,
    "loop": tf2_py.LookupException,
    "unconnected": tf2_py.ConnectivityException,
    "before": tf2_py.ExtrapolationException,
    "after": tf2_py.ExtrapolationException,
}


def ros_time(instant: Any) -> Any:
    return rospy.Time(*divmod(instant, 10**9))


class Reference:
    """The buffer of tf2, used as in its Python programs."""

    def __init__(self, seconds: Any) -> None:
        self.core = tf2_py.BufferCore(rospy.Duration(seconds))

    def clear(self) -> None:
        self.core.clear()

    def store(self, parent: str, child: str, instant: Any, numbers: Any, is_static: Any) -> None:
        message = TransformStamped()
        message.header.stamp = ros_time(instant)
        message.header.frame_id, message.child_frame_id = parent, child
        translation, rotation = message.transform.translation, message.transform.rotation
        translation.x, translation.y, translation.z = numbers[:3]
        rotation.x, rotation.y, rotation.z, rotation.w = numbers[3:]
        (self.core.set_transform_static if is_static else self.core.set_transform)(message, "test")

    def answer(self, target: Any, source: Any, instant: Any) -> Any:
        try:
            transform = self.core.lookup_transform_core(target, source, ros_time(instant)).transform
        except tf2_py.TransformException as error:
            return type(error)
        translation, rotation = transform.translation, transform.rotation
        return (translation.x, translation.y, translation.z), (rotation.x, rotation.y, rotation.z, rotation.w)


def answer(buffer: Any, target: Any, source: Any, instant: Any) -> Any:
    """Return a pose, or the class of the exception of tf2."""
    pose = buffer.lookup(target, source, instant)
    fault = buffer.find_fault(target, source, instant)
    assert (pose is None) == (fault is not None)
    return EXCEPTIONS[fault.kind] if pose is None else pose


def equal(first: Any, second: Any) -> bool:
    if isinstance(first, type) or isinstance(second, type):
        return first is second
    return all(
        math.isclose(a, b, rel_tol=0, abs_tol=1e-9)
        for first_numbers, second_numbers in zip(first, second)
        for a, b in zip(first_numbers, second_numbers)
    )


def play(seed: Any, counts: Any) -> None:
    """Compare the answers of a scenario."""
    reference, buffers = Reference(10), [TransformBuffer(10), Tf2Buffer(10)]
    for position, (operation, *arguments) in enumerate(random_transforms.scenario(seed)):
        if operation == "ask":
            expected = reference.answer(*arguments)
            counts[expected if isinstance(expected, type) else "pose"] = (
                counts.get(expected if isinstance(expected, type) else "pose", 0) + 1
            )
            for buffer in buffers:
                pose = answer(buffer, *arguments)
                assert equal(pose, expected), (seed, position, type(buffer), arguments, pose, expected)
        else:
            for target in (reference, *buffers):
                getattr(target, operation)(*arguments)


@pytest.mark.parametrize("part", round_numbers(1, 4))
def test_answers_equal_those_of_tf2(part: int, capfd: pytest.CaptureFixture[str]) -> None:
    counts: Dict[Any, Any] = {}
    for seed in range(part * TREES // 4, (part + 1) * TREES // 4):
        play(seed, counts)
    # Each answer occurs often.
    assert all(
        counts[answer] > 1000 for answer in {"pose", *EXCEPTIONS.values()} - {tf2_py.InvalidArgumentException}
    )
    assert counts[tf2_py.InvalidArgumentException] > 100
    capfd.readouterr()


def test_few_pending_samples_have_same_answers(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(transform_buffer, "_MAX_PENDING_SAMPLES", 2)
    counts: Dict[Any, Any] = {}
    for seed in range(500):
        play(seed, counts)
    assert counts["pose"] > 1000
    capfd.readouterr()


def set_transform_calls(buffer: Any) -> Any:
    """Return a list to which each sample of the core of the buffer is added, as its instant in seconds."""
    calls: List[Any] = []
    core = buffer._core  # noqa: SLF001

    class Core:
        def __getattr__(self, name: Any) -> Any:
            return getattr(core, name)

        def set_transform(self, message: Any, authority: Any) -> None:
            calls.append(round(float(message.header.stamp) - 86_400))
            core.set_transform(message, authority)

    buffer._core = Core()  # noqa: SLF001
    return calls


def test_samples_are_copied_once_by_next_lookup() -> None:
    buffer, identity = Tf2Buffer(10), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)

    def store(*seconds: Any) -> None:
        for second in seconds:
            buffer.store("map", "base", second * 10**9, identity)

    store(100_000, 100_002)
    assert buffer.lookup("map", "base", 100_001 * 10**9)
    calls = set_transform_calls(buffer)
    store(100_003, 100_001, 100_004)
    # A sample between copied samples is copied at once.
    assert calls == [1]
    assert buffer.lookup("map", "base", 100_004 * 10**9)
    assert buffer.lookup("map", "base", 100_003 * 10**9)
    assert calls == [1, 3, 4]
    # Samples that leave the history before a look-up are not copied.
    store(*range(100_005, 100_030))
    assert buffer.lookup("map", "base", 100_029 * 10**9)
    assert buffer.lookup("map", "base", 100_018 * 10**9) is None
    assert calls == [1, 3, 4, *range(19, 30)]
