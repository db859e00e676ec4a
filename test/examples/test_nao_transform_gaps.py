"""Option of the command ``bag`` for transforms of the NAO that are missing for two seconds.

The test cases of the program have the poses and the warnings for such a gap.
"""

import sys
from pathlib import Path
from typing import List

import pytest

from retalis import BagReader, BagWriter
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


@pytest.fixture
def incomplete_bag(tmp_path: Path) -> Path:
    """Return a bag without the transforms of one joint for two seconds."""
    complete, incomplete = tmp_path / "complete.bag", tmp_path / "incomplete.bag"
    make_bag.make_bag(complete, seconds=8.0, seed=7)
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
    return incomplete


def test_option_max_gap_limits_gap(incomplete_bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pose_counts: List[int] = []
    for options in ([], ["--max-gap", "0.5"], ["--max-gap", "0"]):
        main(["bag", str(incomplete_bag), "--program", str(PROGRAM), *options])
        pose_counts.append(capsys.readouterr().out.count("PoseStamped("))
    assert pose_counts[1] < pose_counts[0] == pose_counts[2]
