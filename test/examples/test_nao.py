import os
import shutil
import subprocess
import sys
from bisect import bisect_left
from collections import defaultdict
from math import acos, sin
from pathlib import Path

import pytest

pytest.importorskip("rosbags")
NAO = Path(__file__).parents[2] / "examples" / "nao"
sys.path.insert(0, str(NAO))

import make_bag  # noqa: E402
import nao_robot  # noqa: E402
import nao_truth  # noqa: E402

from retalis import BagReader, Definitions, deref, list_items  # noqa: E402
from retalis.messages.type_registry import InstalledTypes  # noqa: E402

pytestmark = pytest.mark.slow

SECONDS = 12


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    path = tmp_path_factory.mktemp("nao") / "nao.bag"
    return path, make_bag.make_bag(path, SECONDS, seed=3)


@pytest.fixture(scope="module")
def records(made):
    known = Definitions(InstalledTypes([], [], include_rosbags=False))
    found = []
    with BagReader(made[0]) as reader:
        for record in reader.records():
            definition = known.add(record.topic.type, record.topic.definition)
            assert definition.md5sum == record.topic.md5sum
            found.append(
                (record.topic.name, record.time, plain(known.decoder(definition).decode(record.data)))
            )
    return found


def plain(term):
    """Return a term as nested lists and texts."""
    term = deref(term)
    items = list_items(term)
    if items is not None:
        return [plain(item) for item in items]
    if term.__class__ is tuple:
        return [plain(argument) for argument in term[1:]]
    return getattr(term, "name", term)


def nanoseconds(stamp):
    return stamp[0] * 10**9 + stamp[1]


def transforms(records):
    """Return (stamp, receipt, pose) of each pair of frames, in the order of receipt."""
    found = defaultdict(list)
    for topic, received, message in records:
        if topic == "/tf":
            (transform,) = message[0]
            (_, stamp, parent), child, (position, rotation) = transform
            pose = (tuple(position), tuple(rotation))
            found[parent.strip('"'), child.strip('"')].append((nanoseconds(stamp), received, pose))
    return found


def interpolate(left, right, share):
    (p, q), (r, s) = left, right
    position = tuple(a + (b - a) * share for a, b in zip(p, r))
    cosine = sum(a * b for a, b in zip(q, s))
    if cosine < 0:
        cosine, s = -cosine, tuple(-part for part in s)
    angle = acos(min(1.0, cosine))
    one, other = (
        (1 - share, share)
        if angle < 1e-9
        else (sin((1 - share) * angle) / sin(angle), sin(share * angle) / sin(angle))
    )
    return position, tuple(one * a + other * b for a, b in zip(q, s))


def at(history, stamp):
    stamps = [one[0] for one in history]
    after = bisect_left(stamps, stamp)
    if stamps[after] == stamp:
        return history[after][2]
    before = history[after - 1]
    share = (stamp - before[0]) / (history[after][0] - before[0])
    return interpolate(before[2], history[after][2], share)


@pytest.mark.slow
def test_topics_and_rates(made, records):
    with BagReader(made[0]) as reader:
        assert {(topic.name, topic.type) for topic in reader.topics} == {
            ("/tf", "tf/tfMessage"),
            ("/ar_pose_marker", "ar_pose/ARMarkers"),
            ("/face_recognition/feedback", "face_recognition/FaceRecognitionActionFeedback"),
        }
    number = defaultdict(int)
    for topic, _, _ in records:
        number[topic] += 1
    assert number == {
        "/tf": 1900 * SECONDS,
        "/ar_pose_marker": 7 * SECONDS,
        "/face_recognition/feedback": 3 * SECONDS,
    }


def test_the_chain_comes_at_its_rates_and_in_order(records):
    found = transforms(records)
    rates = {pair: len(history) / SECONDS for pair, history in found.items()}
    assert [rates[parent, child] for parent, child, _ in nao_robot.CHAIN] == [10, 50, 10, 10, 50]
    assert set(rates.values()) <= {8, 10, 12, 50}
    for parent, child, _ in nao_robot.CHAIN:
        history = found[parent, child]
        assert history == sorted(history)
    late = [received - stamp for history in found.values() for stamp, received, _ in history]
    assert min(late) > 0
    assert 0.3e9 < max(late) <= 0.51e9


def test_rotations_are_rotations(records):
    for history in transforms(records).values():
        for _, _, (_, rotation) in history:
            assert sum(part * part for part in rotation) == pytest.approx(1.0, abs=1e-12)


def test_located_markers_are_where_they_are(made, records):
    """Interpolating the links at each observation gives the true pose of the marker, though the robot moves."""
    truth = made[1]
    found = transforms(records)
    chain = [found[parent, child] for parent, child, _ in nao_robot.CHAIN]
    located = {}
    complete = {(one.marker, one.stamp) for one in truth.complete}
    number = 0
    for topic, _, message in records:
        if topic != "/ar_pose_marker":
            continue
        ((header, identifier, ((position, rotation), covariance), _),) = message[1]
        name, stamp = header[2].strip('"'), nanoseconds(header[1])
        assert identifier == int(name[-1])
        assert covariance == [0.0] * 36
        if (name, stamp) not in complete:
            continue
        number += 1
        pose = nao_robot.IDENTITY
        for history in chain:
            pose = nao_robot.compose(pose, at(history, stamp))
        pose = nao_robot.compose(pose, (tuple(position), tuple(rotation)))
        assert nao_robot.distance(pose[0], truth.markers[name][0]) < 0.01
        located[name] = pose[0]
    assert number == len(truth.complete) > 7 * SECONDS - 5
    comparisons = nao_truth.compare(truth, located)
    assert [one.marker for one in comparisons] == list(nao_robot.MARKERS)
    assert all(one.good for one in comparisons)
    assert max(one.error for one in comparisons) > 1e-6  # the robot does move


def test_observations(made, records):
    path, truth = made
    assert nao_truth.load(path) == truth
    assert {one.marker for one in truth.observations[:20]} == set(nao_robot.MARKERS)
    received = [time for topic, time, _ in records if topic == "/ar_pose_marker"]
    assert [one.received for one in truth.observations] == received
    delays = [one.received - one.stamp for one in truth.observations]
    assert min(delays) >= 0.03e9
    assert 0.2e9 < max(delays) <= 0.5e9
    stamps = sorted(one.stamp for one in truth.observations)
    gaps = {second - first for first, second in zip(stamps, stamps[1:])}
    assert len(gaps) > SECONDS


def test_faces(records):
    names = set()
    for _topic, received, (header, status, (order, found, confidence)) in [
        record for record in records if record[0] == "/face_recognition/feedback"
    ]:
        assert 0.05e9 <= received - nanoseconds(header[1]) <= 0.15e9
        assert (status[1], order) == (1, 1)
        assert len(found) == len(confidence) in (1, 2)
        names.update(found)
    assert names == {f'"{name}"' for name in make_bag.FACES}


def test_the_same_seed_gives_the_same_bag(tmp_path):
    paths = [tmp_path / name for name in ("a.bag", "b.bag", "c.bag")]
    for path, seed in zip(paths, (1, 1, 2)):
        make_bag.make_bag(path, 2, seed)
    contents = [path.read_bytes() for path in paths]
    assert contents[0] == contents[1] != contents[2]
    assert nao_truth.truth_path(paths[0]).read_text() == nao_truth.truth_path(paths[1]).read_text()


@pytest.mark.slow
def test_the_command(tmp_path):
    output = tmp_path / "x.bag"
    command = [sys.executable, str(NAO / "make_bag.py"), "--seconds", "1", "--output", str(output)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(
        f"{output}: 1 s, 7 observations of 8 markers; true positions in {tmp_path}/x.truth.json"
    )
    again = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert again.returncode == 1
    assert again.stderr == f"make_bag.py: {output} already exists\n"
    assert subprocess.run([*command, "--force"], capture_output=True, check=False, timeout=60).returncode == 0


def test_comparison_table():
    truth = nao_truth.Truth(
        1, 1, 0, {"4x4_1": ((1.0, 2.0, 3.0), (0, 0, 0, 1)), "4x4_2": ((0.0, 0.0, 0.0), (0, 0, 0, 1))}, []
    )
    one, other = nao_truth.compare(truth, {"4x4_1": (1.0, 2.0, 3.03)})
    assert one.error == pytest.approx(0.03)
    assert not one.good
    assert not other.good
    assert "30.0 mm" in nao_truth.table([one, other])
    assert "not located" in nao_truth.table([one, other])


ROSBAG = shutil.which("rosbag", path=f"/usr/bin{os.pathsep}{os.environ.get('PATH', '')}")


@pytest.mark.skipif(ROSBAG is None, reason="no ROS here")
def test_ros_reads_the_bag(made, tmp_path):
    environment = {**os.environ, "PATH": "/usr/bin:" + os.environ["PATH"], "ROS_LOG_DIR": str(tmp_path)}
    done = subprocess.run(
        [ROSBAG, "info", "--yaml", "--key=messages", str(made[0])],
        capture_output=True,
        text=True,
        env=environment,
        check=False,
        timeout=60,
    )
    assert done.stdout.strip() == str(1910 * SECONDS), done.stderr
