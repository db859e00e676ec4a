"""Recorded answers of SWI-Prolog 9.0.4 to goals over the built-ins; ``swi_comparison.py`` asks it for more."""

from pathlib import Path
from typing import Any, Dict

import pytest
from script_modules import load_script

FOLDER = Path(__file__).parent
DIFFERING_GOALS = FOLDER / "goals_differing.txt"
"""Goals with other answers, each after the reason."""

swi_comparison = load_script(FOLDER / "swi_comparison.py")


def differing() -> Dict[Any, Any]:
    """Return the goals listed as differing with their reasons."""
    lines = DIFFERING_GOALS.read_text(encoding="utf-8").rstrip("\n").split("\n")
    return {goal: reason for reason, goal in (line.split("\t", 1) for line in lines)}


def recorded() -> Dict[str, str]:
    """Return the recorded goals with SWI-Prolog's answers."""
    names = ("goals.tsv", "goals_kinds.tsv", "goals_wrong_arguments.tsv")
    texts = [(FOLDER / name).read_text(encoding="utf-8") for name in names]
    return dict(line.split("\t", 1) for text in texts for line in text.rstrip("\n").split("\n"))


def test_page_names_classes_of_differences() -> None:
    page = (FOLDER.parents[1] / "docs" / "explanation" / "compatibility.md").read_text(encoding="utf-8")
    names = [difference.name for difference in swi_comparison.REASONS]
    assert names
    assert [name for name in names if f"| {name} |" not in page] == []
    assert set(differing().values()) <= set(names)


@pytest.mark.slow
def test_undocumented_goals_agree_with_swi_prolog() -> None:
    known, rows = differing(), recorded()
    assert len(rows) >= 500
    differing_answers: Dict[Any, Any] = {}
    for goal, theirs in rows.items():
        ours = swi_comparison.answer(goal)
        if swi_comparison.plain(ours) != swi_comparison.plain(theirs):
            differing_answers[goal] = (theirs, ours)
    assert {goal: answers for goal, answers in differing_answers.items() if goal not in known} == {}
    assert sorted(set(known) - set(differing_answers)) == []
