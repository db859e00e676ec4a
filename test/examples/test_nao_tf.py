"""The NAO example by the tree of transforms, compared with the one by memories on the same bag."""

import sys
from pathlib import Path

import pytest

pytest.importorskip("rosbags")
ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "examples" / "nao"))

import make_bag  # noqa: E402

from retalis import BagReader, Playback, deref, list_items  # noqa: E402

MARKERS = [f"marker{number}" for number in range(1, 9)]


def flat(term):
    """Yield the leaves of a term."""
    term = deref(term)
    items = list_items(term)
    parts = items if items is not None else term[1:] if term.__class__ is tuple else None
    if parts is None:
        yield term
    else:
        for part in parts:
            yield from flat(part)


def outputs(folder, bag):
    errors = []
    with BagReader(bag) as reader:
        found = [
            (output.topic, output.time, output.data is not None, list(flat(output.term)))
            for output in Playback(folder, report=errors.append, bag=reader).run(reader)
            if output.topic in MARKERS
        ]
    assert not errors
    return found


def test_the_same_poses_at_the_same_times(tmp_path):
    truth = make_bag.make_bag(tmp_path / "nao.bag", 4, seed=3)
    expected = outputs(ROOT / "application_source", tmp_path / "nao.bag")
    found = outputs(ROOT / "examples" / "nao-tf", tmp_path / "nao.bag")
    assert len(found) == len(expected) > 10
    assert len(found) <= len(truth.complete)
    for one, other in zip(found, expected):
        assert one[:3] == other[:3] and one[2]
        for value, right in zip(one[3], other[3]):
            if isinstance(value, float):
                assert abs(value - right) < 1e-9
            else:
                assert value == right


def test_a_third_of_the_lines():
    def count(folder):
        lines = [
            line
            for name in ("eventRules.txt", "goalPredicates.txt")
            for line in (folder / name).read_text(encoding="utf-8").partition("% ---- Faces")[0].splitlines()
        ]
        return sum(1 for line in lines if line.strip() and not line.startswith("%") and "face" not in line)

    assert 3 * count(ROOT / "examples" / "nao-tf") <= count(ROOT / "application_source")
