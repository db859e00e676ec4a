"""Recorded answers of SWI-Prolog 9.0.4 to goals over the built-ins; ``differential.py`` asks it for more."""

import importlib.util
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent
KNOWN = FOLDER / "goals_differing.txt"
"""Goals that are answered differently, each behind its reason."""

_spec = importlib.util.spec_from_file_location("differential", str(FOLDER / "differential.py"))
differential = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(differential)


def differing():
    """Return the goals listed as differing with their reasons."""
    lines = KNOWN.read_text(encoding="utf-8").rstrip("\n").split("\n")
    return {goal: reason for reason, goal in (line.split("\t", 1) for line in lines)}


def recorded():
    """Return the recorded goals with SWI-Prolog's answers: any arguments, arguments by kind, wrong ones chosen."""
    names = ("goals.tsv", "goals_kinds.tsv", "goals_wrong_arguments.tsv")
    texts = [(FOLDER / name).read_text(encoding="utf-8") for name in names]
    return dict(line.split("\t", 1) for text in texts for line in text.rstrip("\n").split("\n"))


def test_reasons_are_on_the_page():
    page = (FOLDER.parents[1] / "docs" / "explanation" / "compatibility.md").read_text(encoding="utf-8")
    names = [found.name for found in differential.REASONS]
    assert [name for name in names if f"| {name} |" not in page] == []
    assert set(differing().values()) <= set(names)


@pytest.mark.slow
def test_recorded_answers():
    known, found = differing(), recorded()
    assert len(found) >= 500
    wrong = {}
    for goal, theirs in found.items():
        ours = differential.answer(goal)
        if differential.plain(ours) != differential.plain(theirs):
            wrong[goal] = (theirs, ours)
    assert {goal: answers for goal, answers in wrong.items() if goal not in known} == {}
    assert sorted(set(known) - set(wrong)) == []
