"""Program of the NAO with transforms missing for two seconds: poses within and outside the gap, and warnings."""

import logging
import sys
from pathlib import Path
from typing import Any, Dict, List, Tuple

import pytest
from checked_access import compound, items, number

from retalis import BagReader, BagWriter, Playback, Settings
from retalis.cli.command_line import main

ROOT = Path(__file__).resolve().parent.parent.parent
PROGRAM = ROOT / "application_source"

sys.path.append(str(ROOT / "examples" / "nao"))
import make_bag  # noqa: E402
import nao_messages  # noqa: E402

pytestmark = pytest.mark.slow

SECOND = 10**9
GAP_START, GAP_END = (make_bag.START + 4) * SECOND, (make_bag.START + 6) * SECOND
FRAMES = b"base_link", b"torso"
DELAY = SECOND // 100
"""Upper limit of the delay of a transform, in ns."""


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Tuple[Any, ...]:
    """Return a bag, and the same without the transforms of one joint for two seconds."""
    folder = tmp_path_factory.mktemp("gaps")
    complete, incomplete = folder / "complete.bag", folder / "incomplete.bag"
    make_bag.make_bag(complete, seconds=10.0, seed=7)
    with BagReader(complete) as bag, BagWriter(incomplete) as out:
        connections, definitions = {}, nao_messages.definitions()
        for topic, instant, data in bag.records():
            if topic not in connections:
                connections[topic] = out.add(topic.name, definitions[topic.type])
            if not (
                topic.name == "/tf"
                and all(frame in data for frame in FRAMES)
                and GAP_START <= instant < GAP_END
            ):
                out.write(connections[topic], instant, data)
    return complete, incomplete


def play(path: Any, settings: Any = None) -> Tuple[Any, ...]:
    """Return each pose by marker and stamp, and the times of the transforms of the joint in ms."""
    playback = Playback(PROGRAM, print, settings=settings)
    poses: Dict[Any, Any] = {}
    with BagReader(path) as bag:
        for output in playback.run(bag):
            if output.topic.startswith("marker"):
                header, pose = compound(compound(output.term)[1]), compound(output.term)[2]
                seconds, rest = (number(part) for part in items(header[2]))
                poses[output.topic, seconds * SECOND + rest] = playback.engine.show(pose)
    answers = playback.engine.query("access_mem(base_torso, _, [T, _]), absoluteTime(T, S)")
    midnight = make_bag.START - make_bag.START % 86400
    return poses, sorted(round((midnight + answer["S"]) * 1000) for answer in answers)


def widest_gap(stamps: Any) -> Any:
    """Return start and end of the widest gap."""
    return max((end - start, start, end) for start, end in zip(stamps, stamps[1:]))[1:]


def test_limit_of_gap_omits_poses_in_gap_only(
    bags: Tuple[Any, ...], caplog: pytest.LogCaptureFixture
) -> None:
    exact, _ = play(bags[0])
    poses, stamps = play(bags[1], Settings(max_gap=0.5))
    gap_start, gap_end = (limit * 10**6 for limit in widest_gap(stamps))
    assert GAP_START - SECOND // 4 < gap_start < GAP_START < GAP_END - DELAY < gap_end < GAP_END + SECOND // 4
    expected = {key: pose for key, pose in exact.items() if not gap_start < key[1] < gap_end}
    assert len(expected) < len(exact) - 5
    assert poses == expected
    assert [record for record in caplog.records if record.levelno >= logging.WARNING] == []


def test_interpolated_gap_is_warned_of(bags: Tuple[Any, ...], caplog: pytest.LogCaptureFixture) -> None:
    exact, _ = play(bags[0])
    poses, stamps = play(bags[1])
    gap_start, gap_end = (limit * 10**6 for limit in widest_gap(stamps))
    assert poses.keys() == exact.keys()
    assert all(poses[key] == exact[key] for key in exact if not gap_start < key[1] < gap_end)
    warning, total = [record.message for record in caplog.records if record.levelno >= logging.WARNING]
    text = (
        "memory base_torso: a value is interpolated over a gap of 2 s; its records are usually 0.02 s apart"
    )
    assert warning.startswith(text)
    count = sum(1 for key in exact if gap_start < key[1] < gap_end)
    assert total.startswith(f"{count} times in all: {text}")


def test_option_max_gap_limits_gap(bags: Tuple[Any, ...], capsys: pytest.CaptureFixture[str]) -> None:
    pose_counts: List[Any] = []
    for options in ([], ["--max-gap", "0.5"], ["--max-gap", "0"]):
        main(["bag", str(bags[1]), "--program", str(PROGRAM), *options])
        pose_counts.append(capsys.readouterr().out.count("PoseStamped("))
    assert pose_counts[1] < pose_counts[0] == pose_counts[2]
