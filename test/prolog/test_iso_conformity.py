"""Conformity to the ISO standard, except for the documented differences."""

import re
from pathlib import Path
from typing import Any, Dict

import pytest
from script_modules import load_script

iso_conformity = load_script(Path(__file__).with_name("iso_conformity.py"))

PAGE = Path(__file__).resolve().parents[2] / "docs" / "explanation" / "compatibility.md"
FILES = ("goals.txt", "syntax.txt")
ROW = re.compile(r"^\| `` (.*?) `` \| `` .*? `` \| `` .*? `` \| (.+) \|$", re.MULTILINE)


def exceptions() -> Dict[Any, Any]:
    return {
        goal.replace("\\|", "|"): reason for goal, reason in ROW.findall(PAGE.read_text(encoding="utf-8"))
    }


@pytest.fixture(scope="module")
def answers() -> Any:
    results: Dict[Any, Any] = {}
    for file in FILES:
        program = iso_conformity.clauses(file)
        for case in iso_conformity.cases(file):
            results[case] = iso_conformity.agrees(case, program)
    return results


@pytest.mark.slow
def test_undocumented_goals_agree_with_standard(answers: Any) -> None:
    differing = {case.goal: (case.answer, answer) for case, (good, answer) in answers.items() if not good}
    documented = exceptions()
    assert {goal: pair for goal, pair in differing.items() if goal not in documented} == {}
    assert [goal for goal in documented if goal not in differing] == []


@pytest.mark.slow
def test_page_states_number_of_agreeing_goals(answers: Any) -> None:
    good = sum(1 for good, _ in answers.values() if good)
    assert good / len(answers) >= 0.98
    page = PAGE.read_text(encoding="utf-8")
    assert f"holds {len(answers):,} goals and texts" in page
    assert f"{good:,} of them agree" in page


def test_documented_differences_have_reasons() -> None:
    reasons = exceptions().values()
    assert reasons
    assert all(len(reason) > 20 for reason in reasons)
