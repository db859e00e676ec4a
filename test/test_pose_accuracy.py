"""Computed positions, compared with tf2 and with the truth."""

import sys
from pathlib import Path
from typing import Any, Dict, List, Tuple

import pytest
from asserting_accessors import compound, items, name_of, number

from retalis import BagReader, Definitions, Playback, deref

HERE = Path(__file__).resolve().parent
NAO = HERE.parent / "examples" / "nao"
PR2 = HERE.parent.parent / "shared" / "bags" / "pr2_mylaserdata.bag"

sys.path += [str(NAO), str(HERE)]
import nao_truth  # noqa: E402
from make_bag import make_bag  # noqa: E402

pytestmark = pytest.mark.slow


def play(program: Any, path: Any) -> Tuple[Any, ...]:
    problems: List[Any] = []
    playback = Playback(program, problems.append)
    with BagReader(path) as bag:
        outputs = list(playback.run(bag))
    assert problems == []
    return playback.engine, outputs


def vector(term: Any) -> Any:
    return tuple(deref(value) for value in compound(term)[1:])


class Pose:
    """Fields of a published PoseStamped."""

    def __init__(self, output: Any) -> None:
        header, pose = compound(output.term[1]), compound(output.term[2])
        seconds, nanoseconds = (number(part) for part in items(header[2]))
        self.stamp = seconds * 10**9 + nanoseconds
        self.marker = name_of(header[3]).strip('"')
        self.topic = output.topic
        self.position, self.rotation = vector(pose[1]), vector(pose[2])


@pytest.fixture(scope="module")
def nao(tmp_path_factory: pytest.TempPathFactory) -> Tuple[Any, ...]:
    path = tmp_path_factory.mktemp("nao") / "nao.bag"
    truth = make_bag(path, seconds=10.0, seed=7)
    _, outputs = play(HERE.parent / "application_source", path)
    return path, truth, outputs


@pytest.fixture(scope="module")
def poses(nao: Tuple[Any, ...]) -> List[Pose]:
    return [Pose(output) for output in nao[2] if output.topic.startswith("marker")]


def test_each_complete_observation_has_one_pose(nao: Tuple[Any, ...], poses: List[Pose]) -> None:
    expected = sorted((observation.marker, observation.stamp) for observation in nao[1].complete)
    assert sorted((pose.marker, pose.stamp) for pose in poses) == expected
    assert len(expected) > 50


def test_each_marker_has_topic(poses: List[Pose]) -> None:
    assert {(pose.marker, pose.topic) for pose in poses} == {(f"4x4_{i}", f"marker{i}") for i in range(1, 9)}


def test_positions_equal_truth_within_2_cm(nao: Tuple[Any, ...], poses: List[Pose]) -> None:
    assert poses
    for pose in poses:
        true = nao[1].markers[pose.marker][0]
        assert sum((a - b) ** 2 for a, b in zip(pose.position, true)) ** 0.5 < nao_truth.TOLERANCE


@pytest.mark.slow
def test_positions_agree_with_tf2(nao: Tuple[Any, ...], poses: List[Pose]) -> None:
    import tf2_reference as tf2  # noqa: PLC0415 - needs numpy

    reference = tf2.Reference(nao[0])
    relative = observations(nao[0])
    assert poses
    for pose in poses:
        camera = reference.pose("odom", "CameraTop_frame", pose.stamp)
        position, rotation = tf2.compose(camera, relative[pose.marker, pose.stamp])
        assert tf2.distance(pose.position, position) < 1e-6
        assert tf2.angle(pose.rotation, rotation) < 1e-6


def observations(path: Any) -> Any:
    """Return the pose of each observation relative to the camera, by marker and stamp."""
    definitions = Definitions()
    poses_by_key: Dict[Any, Any] = {}
    with BagReader(path) as bag:
        for record in bag.records(["/ar_pose_marker"]):
            definition = definitions.add(record.topic.type, record.topic.definition)
            message = definitions.decoder(definition).decode(record.data)
            for item in items(compound(message)[2]):
                marker = compound(item)
                header, pose = compound(marker[1]), compound(compound(marker[3])[1])
                seconds, nanoseconds = (number(part) for part in items(header[2]))
                key = name_of(header[3]).strip('"'), seconds * 10**9 + nanoseconds
                poses_by_key[key] = vector(pose[1]), vector(pose[2])
    return poses_by_key


def test_known_face_near_marker_is_published(nao: Tuple[Any, ...]) -> None:
    texts = [name_of(output.term[1]) for output in nao[2] if output.topic == "face_by_marker"]
    assert texts
    assert all(" by 4x4_" in text for text in texts)


@pytest.mark.skipif(not PR2.exists(), reason="needs a recorded bag of a PR2")
def test_head_of_pr2_agrees_with_tf2() -> None:
    import tf2_reference as tf2  # noqa: PLC0415 - needs numpy

    engine, _ = play(HERE / "data" / "pr2", PR2)
    reference = tf2.Reference(PR2)
    with BagReader(PR2) as bag:
        start, end = bag.start, bag.end
    instants = [start + (end - start) * i // 400 for i in range(400)]
    compared = 0
    for instant in instants:
        expected = reference.pose("odom_combined", "head_plate_frame", instant)
        answers = engine.query(f"head_plate([{instant // 10**9},{instant % 10**9}],[P,Q])")
        assert bool(answers) == (expected is not None)
        if expected is None:
            continue
        compared += 1
        position = [deref(value) for value in items(answers[0]["P"])]
        rotation = [deref(value) for value in items(answers[0]["Q"])]
        assert tf2.distance(position, expected[0]) < 2e-8
        assert tf2.angle(rotation, expected[1]) < 2e-8
    assert compared >= 200
