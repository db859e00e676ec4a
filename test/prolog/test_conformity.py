"""Conformity to the ISO standard, except for the documented differences."""

import importlib.util
import re
from pathlib import Path

import pytest

_spec = importlib.util.spec_from_file_location("conformity", str(Path(__file__).with_name("conformity.py")))
conformity = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(conformity)

PAGE = Path(__file__).resolve().parents[2] / "docs" / "explanation" / "compatibility.md"
FILES = ("goals.txt", "syntax.txt")
ROW = re.compile(r"^\| `` (.*?) `` \| `` .*? `` \| `` .*? `` \| (.+) \|$", re.MULTILINE)


def exceptions():
    return {
        goal.replace("\\|", "|"): reason for goal, reason in ROW.findall(PAGE.read_text(encoding="utf-8"))
    }


@pytest.fixture(scope="module")
def answers():
    found = {}
    for file in FILES:
        program = conformity.clauses(file)
        for case in conformity.cases(file):
            found[case] = conformity.agrees(case, program)
    return found


@pytest.mark.slow
def test_all_others_agree(answers):
    wrong = {case.goal: (case.answer, found) for case, (good, found) in answers.items() if not good}
    listed = exceptions()
    assert {goal: why for goal, why in wrong.items() if goal not in listed} == {}
    assert [goal for goal in listed if goal not in wrong] == []


@pytest.mark.slow
def test_how_many_agree(answers):
    good = sum(1 for good, _ in answers.values() if good)
    assert good / len(answers) >= 0.98
    page = PAGE.read_text(encoding="utf-8")
    assert f"holds {len(answers):,} goals and texts" in page and f"{good:,} of them agree" in page


def test_exceptions_have_reasons():
    assert all(len(reason) > 20 for reason in exceptions().values())
