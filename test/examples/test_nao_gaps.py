"""The NAO program where transforms fail to come for two seconds: what it says of that time, and of the rest."""

import logging
import sys
from pathlib import Path

import pytest

from retalis import BagReader, BagWriter, Playback, Settings, deref, list_items
from retalis.cli.command_line import main

ROOT = Path(__file__).resolve().parent.parent.parent
PROGRAM = ROOT / "application_source"

sys.path.append(str(ROOT / "examples" / "nao"))
import make_bag  # noqa: E402
import nao_messages  # noqa: E402

pytestmark = pytest.mark.slow

SECOND = 10**9
BEGINS, ENDS = (make_bag.START + 4) * SECOND, (make_bag.START + 6) * SECOND
FRAMES = b"base_link", b"torso"
DELAY = SECOND // 100
"""Longer than a transform is under way."""


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    """Return a bag, and the same without the transforms of one joint for two seconds."""
    folder = tmp_path_factory.mktemp("gaps")
    whole, holed = folder / "whole.bag", folder / "holed.bag"
    make_bag.make_bag(whole, seconds=10.0, seed=7)
    with BagReader(whole) as bag, BagWriter(holed) as out:
        connections, definitions = {}, nao_messages.definitions()
        for topic, instant, data in bag.records():
            if topic not in connections:
                connections[topic] = out.add(topic.name, definitions[topic.type])
            if not (
                topic.name == "/tf" and all(frame in data for frame in FRAMES) and BEGINS <= instant < ENDS
            ):
                out.write(connections[topic], instant, data)
    return whole, holed


def play(path, settings=None):
    """Return each pose by marker and stamp, and when the joint's transforms were."""
    playback = Playback(PROGRAM, print, settings=settings)
    poses = {}
    with BagReader(path) as bag:
        for output in playback.run(bag):
            if output.topic.startswith("marker"):
                header, pose = deref(output.term[1]), deref(output.term[2])
                seconds, rest = (deref(part) for part in list_items(header[2]))
                poses[output.topic, seconds * SECOND + rest] = playback.engine.show(pose)
    answers = playback.engine.query("access_mem(base_torso, _, [T, _]), absoluteTime(T, S)")
    midnight = make_bag.START - make_bag.START % 86400
    return poses, sorted(round((midnight + found["S"]) * 1000) for found in answers)


def hole(stamps):
    """Return the widest step, in nanoseconds."""
    return max((late - early, early, late) for early, late in zip(stamps, stamps[1:]))[1:]


def test_no_pose_in_the_hole_and_the_exact_ones_outside(bags, caplog):
    exact, _ = play(bags[0])
    poses, stamps = play(bags[1], Settings(max_gap=0.5))
    begins, ends = (limit * 10**6 for limit in hole(stamps))
    assert BEGINS - SECOND // 4 < begins < BEGINS < ENDS - DELAY < ends < ENDS + SECOND // 4
    expected = {key: pose for key, pose in exact.items() if not begins < key[1] < ends}
    assert len(expected) < len(exact) - 5
    assert poses == expected
    assert [record for record in caplog.records if record.levelno >= logging.WARNING] == []


def test_without_a_limit_the_memory_is_named_once(bags, caplog):
    exact, _ = play(bags[0])
    poses, stamps = play(bags[1])
    begins, ends = (limit * 10**6 for limit in hole(stamps))
    assert poses.keys() == exact.keys()
    assert all(poses[key] == exact[key] for key in exact if not begins < key[1] < ends)
    warning, total = [record.message for record in caplog.records if record.levelno >= logging.WARNING]
    told = (
        "memory base_torso: a value is interpolated over a gap of 2 s; its records are usually 0.02 s apart"
    )
    assert warning.startswith(told)
    times = sum(1 for key in exact if begins < key[1] < ends)
    assert total.startswith(f"{times} times in all: {told}")


def test_as_an_option_of_bag(bags, capsys):
    printed = []
    for options in ([], ["--max-gap", "0.5"], ["--max-gap", "0"]):
        main(["bag", str(bags[1]), "--program", str(PROGRAM), *options])
        printed.append(capsys.readouterr().out.count("PoseStamped("))
    assert printed[1] < printed[0] == printed[2]
