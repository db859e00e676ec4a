"""Bags of the simulated NAO: topics, rates, poses, and comparison with the truth."""

import os
import shutil
import subprocess
import sys
from bisect import bisect_left
from collections import Counter, defaultdict
from math import acos, sin
from pathlib import Path
from typing import Any, Dict, List, Set, Tuple

import pytest
from asserting_accessors import required
from message_registries import empty_registry

from retalis import Term

pytest.importorskip("rosbags")
NAO = Path(__file__).parents[2] / "examples" / "nao"
sys.path.insert(0, str(NAO))

import make_bag  # noqa: E402
import nao_robot  # noqa: E402
import nao_truth  # noqa: E402

from retalis import BagReader, deref, list_items  # noqa: E402

pytestmark = pytest.mark.slow

BAG_SECONDS = 12


@pytest.fixture(scope="module")
def bag_and_truth(tmp_path_factory: pytest.TempPathFactory) -> Tuple[Any, ...]:
    path = tmp_path_factory.mktemp("nao") / "nao.bag"
    return path, make_bag.make_bag(path, BAG_SECONDS, seed=3)


@pytest.fixture(scope="module")
def records(bag_and_truth: Tuple[Any, ...]) -> Any:
    definitions = empty_registry()
    messages: List[Any] = []
    with BagReader(bag_and_truth[0]) as reader:
        for record in reader.records():
            definition = definitions.add(record.topic.type, record.topic.definition)
            assert definition.md5sum == record.topic.md5sum
            messages.append(
                (record.topic.name, record.time, plain(definitions.decoder(definition).decode(record.data)))
            )
    return messages


def plain(term: Term) -> Any:
    """Return a term as nested lists and texts."""
    value = deref(term)
    items = list_items(value)
    if items is not None:
        return [plain(item) for item in items]
    if isinstance(value, tuple):
        return [plain(argument) for argument in value[1:]]
    return getattr(value, "name", value)


def nanoseconds(stamp: Any) -> Any:
    return stamp[0] * 10**9 + stamp[1]


def transforms(records: Any) -> Any:
    """Return (stamp, receipt, pose) of each pair of frames, in the order of receipt."""
    transforms_by_frames = defaultdict(list)
    for topic, received, message in records:
        if topic == "/tf":
            (transform,) = message[0]
            (_, stamp, parent), child, (position, rotation) = transform
            pose = (tuple(position), tuple(rotation))
            transforms_by_frames[parent.strip('"'), child.strip('"')].append(
                (nanoseconds(stamp), received, pose)
            )
    return transforms_by_frames


def interpolate(left: Any, right: Any, share: Any) -> Tuple[Any, ...]:
    (p, q), (r, s) = left, right
    position = tuple(a + (b - a) * share for a, b in zip(p, r))
    cosine = sum(a * b for a, b in zip(q, s))
    if cosine < 0:
        cosine, s = -cosine, tuple(-part for part in s)
    angle = acos(min(1.0, cosine))
    left_weight, right_weight = (
        (1 - share, share)
        if angle < 1e-9
        else (sin((1 - share) * angle) / sin(angle), sin(share * angle) / sin(angle))
    )
    return position, tuple(left_weight * a + right_weight * b for a, b in zip(q, s))


def pose_at(history: Any, stamp: Any) -> Any:
    stamps = [entry[0] for entry in history]
    after = bisect_left(stamps, stamp)
    if stamps[after] == stamp:
        return history[after][2]
    before = history[after - 1]
    share = (stamp - before[0]) / (history[after][0] - before[0])
    return interpolate(before[2], history[after][2], share)


@pytest.mark.slow
def test_bag_has_topics_with_rates(bag_and_truth: Tuple[Any, ...], records: Any) -> None:
    with BagReader(bag_and_truth[0]) as reader:
        assert {(topic.name, topic.type) for topic in reader.topics} == {
            ("/tf", "tf/tfMessage"),
            ("/ar_pose_marker", "ar_pose/ARMarkers"),
            ("/face_recognition/feedback", "face_recognition/FaceRecognitionActionFeedback"),
        }
    assert Counter(topic for topic, _, _ in records) == {
        "/tf": 1900 * BAG_SECONDS,
        "/ar_pose_marker": 7 * BAG_SECONDS,
        "/face_recognition/feedback": 3 * BAG_SECONDS,
    }


def test_transforms_of_chain_have_rates_and_order(records: Any) -> None:
    histories = transforms(records)
    rates = {pair: len(history) / BAG_SECONDS for pair, history in histories.items()}
    assert [rates[parent, child] for parent, child, _ in nao_robot.CHAIN] == [10, 50, 10, 10, 50]
    assert set(rates.values()) <= {8, 10, 12, 50}
    for parent, child, _ in nao_robot.CHAIN:
        history = histories[parent, child]
        assert history == sorted(history)
    delays = [received - stamp for history in histories.values() for stamp, received, _ in history]
    assert min(delays) > 0
    assert 0.3e9 < max(delays) <= 0.51e9


def test_rotations_have_unit_length(records: Any) -> None:
    histories = transforms(records)
    assert histories
    for history in histories.values():
        for _, _, (_, rotation) in history:
            assert sum(part * part for part in rotation) == pytest.approx(1.0, abs=1e-12)


def test_interpolated_poses_locate_markers(bag_and_truth: Tuple[Any, ...], records: Any) -> None:
    """Interpolation of the links at each observation results in the true pose of the marker."""
    truth = bag_and_truth[1]
    histories = transforms(records)
    chain = [histories[parent, child] for parent, child, _ in nao_robot.CHAIN]
    located: Dict[Any, Any] = {}
    complete = {(entry.marker, entry.stamp) for entry in truth.complete}
    count = 0
    for topic, _, message in records:
        if topic != "/ar_pose_marker":
            continue
        ((header, identifier, ((position, rotation), covariance), _),) = message[1]
        name, stamp = header[2].strip('"'), nanoseconds(header[1])
        assert identifier == int(name[-1])
        assert covariance == [0.0] * 36
        if (name, stamp) not in complete:
            continue
        count += 1
        pose = nao_robot.IDENTITY
        for history in chain:
            pose = nao_robot.compose(pose, pose_at(history, stamp))
        pose = nao_robot.compose(pose, (tuple(position), tuple(rotation)))
        assert nao_robot.distance(pose[0], truth.markers[name][0]) < 0.01
        located[name] = pose[0]
    assert count == len(truth.complete) > 7 * BAG_SECONDS - 5
    comparisons = nao_truth.compare(truth, located)
    assert [entry.marker for entry in comparisons] == list(nao_robot.MARKERS)
    assert all(entry.good for entry in comparisons)
    assert max(entry.error for entry in comparisons) > 1e-6  # the robot moves


def test_observations_have_delays_and_are_stored(bag_and_truth: Tuple[Any, ...], records: Any) -> None:
    path, truth = bag_and_truth
    assert nao_truth.load(path) == truth
    assert {observation.marker for observation in truth.observations[:20]} == set(nao_robot.MARKERS)
    received = [time for topic, time, _ in records if topic == "/ar_pose_marker"]
    assert [observation.received for observation in truth.observations] == received
    delays = [observation.received - observation.stamp for observation in truth.observations]
    assert min(delays) >= 0.03e9
    assert 0.2e9 < max(delays) <= 0.5e9
    stamps = sorted(observation.stamp for observation in truth.observations)
    gaps = {second - first for first, second in zip(stamps, stamps[1:])}
    assert len(gaps) > BAG_SECONDS


def test_bag_has_faces(records: Any) -> None:
    names: Set[Any] = set()
    for topic, received, message in records:
        if topic != "/face_recognition/feedback":
            continue
        header, status, (order, faces, confidence) = message
        assert 0.05e9 <= received - nanoseconds(header[1]) <= 0.15e9
        assert (status[1], order) == (1, 1)
        assert len(faces) == len(confidence) in (1, 2)
        names.update(faces)
    assert names == {f'"{name}"' for name in make_bag.FACES}


def test_seed_determines_bag(tmp_path: Path) -> None:
    paths = [tmp_path / name for name in ("a.bag", "b.bag", "c.bag")]
    for path, seed in zip(paths, (1, 1, 2)):
        make_bag.make_bag(path, 2, seed)
    contents = [path.read_bytes() for path in paths]
    assert contents[0] == contents[1] != contents[2]
    assert nao_truth.truth_path(paths[0]).read_text() == nao_truth.truth_path(paths[1]).read_text()


@pytest.mark.slow
def test_command_writes_bag(tmp_path: Path) -> None:
    output = tmp_path / "x.bag"
    command = [sys.executable, str(NAO / "make_bag.py"), "--seconds", "1", "--output", str(output)]
    process = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert process.returncode == 0, process.stderr
    assert process.stdout.startswith(
        f"{output}: 1 s, 7 observations of 8 markers; true positions in {tmp_path}/x.truth.json"
    )
    second_process = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert second_process.returncode == 1
    assert second_process.stderr == f"make_bag.py: {output} already exists\n"
    assert subprocess.run([*command, "--force"], capture_output=True, check=False, timeout=60).returncode == 0


def test_table_has_errors_of_markers() -> None:
    truth = nao_truth.Truth(
        1, 1, 0, {"4x4_1": ((1.0, 2.0, 3.0), (0, 0, 0, 1)), "4x4_2": ((0.0, 0.0, 0.0), (0, 0, 0, 1))}, []
    )
    located, missing = nao_truth.compare(truth, {"4x4_1": (1.0, 2.0, 3.03)})
    assert located.error == pytest.approx(0.03)
    assert not located.good
    assert not missing.good
    assert "30.0 mm" in nao_truth.table([located, missing])
    assert "not located" in nao_truth.table([located, missing])


ROSBAG = shutil.which("rosbag", path=f"/usr/bin{os.pathsep}{os.environ.get('PATH', '')}")


@pytest.mark.skipif(ROSBAG is None, reason="ROS is not installed")
def test_rosbag_reads_bag(bag_and_truth: Tuple[Any, ...], tmp_path: Path) -> None:
    environment = {**os.environ, "PATH": "/usr/bin:" + os.environ["PATH"], "ROS_LOG_DIR": str(tmp_path)}
    process = subprocess.run(
        [required(ROSBAG), "info", "--yaml", "--key=messages", str(bag_and_truth[0])],
        capture_output=True,
        text=True,
        env=environment,
        check=False,
        timeout=60,
    )
    assert process.stdout.strip() == str(1910 * BAG_SECONDS), process.stderr
