"""NAO example with the tree of transforms, compared with the example with memories on the same bag."""

import sys
from pathlib import Path
from typing import Any, Iterator, List

import pytest

pytest.importorskip("rosbags")
ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "examples" / "nao"))

import make_bag  # noqa: E402

from retalis import BagReader, Playback, deref, list_items  # noqa: E402

MARKERS = [f"marker{number}" for number in range(1, 9)]


def leaves(term: Any) -> Iterator[Any]:
    """Yield the leaves of a term."""
    term = deref(term)
    items = list_items(term)
    parts = items if items is not None else term[1:] if term.__class__ is tuple else None
    if parts is None:
        yield term
    else:
        for part in parts:
            yield from leaves(part)


def outputs(folder: Any, bag: Any) -> Any:
    errors: List[Any] = []
    with BagReader(bag) as reader:
        outputs_of_markers = [
            (output.topic, output.time, output.data is not None, list(leaves(output.term)))
            for output in Playback(folder, report=errors.append, bag=reader).run(reader)
            if output.topic in MARKERS
        ]
    assert not errors
    return outputs_of_markers


def test_poses_equal_those_of_memories(tmp_path: Path) -> None:
    truth = make_bag.make_bag(tmp_path / "nao.bag", 4, seed=3)
    expected = outputs(ROOT / "application_source", tmp_path / "nao.bag")
    poses = outputs(ROOT / "examples" / "nao-tf", tmp_path / "nao.bag")
    assert len(poses) == len(expected) > 10
    assert len(poses) <= len(truth.complete)
    for pose, expected_pose in zip(poses, expected):
        assert pose[:3] == expected_pose[:3]
        assert pose[2]
        assert len(pose[3]) == len(expected_pose[3])
        for value, expected_value in zip(pose[3], expected_pose[3]):
            if isinstance(value, float):
                assert abs(value - expected_value) < 1e-9
            else:
                assert value == expected_value


def test_program_has_a_third_of_the_lines() -> None:
    def count(folder: Any) -> int:
        lines = [
            line
            for name in ("eventRules.txt", "goalPredicates.txt")
            for line in (folder / name).read_text(encoding="utf-8").partition("% ---- Faces")[0].splitlines()
        ]
        return sum(1 for line in lines if line.strip() and not line.startswith("%") and "face" not in line)

    assert 3 * count(ROOT / "examples" / "nao-tf") <= count(ROOT / "application_source")
