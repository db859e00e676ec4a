"""Comparison of the oracle with recorded scenarios, except those that contradict the definition of the language."""

import os
from pathlib import Path
from typing import Any

import pytest
from oracle.evaluator import run
from oracle.recorded_scenarios import scenarios

FOLDERS = [
    Path(os.environ.get("RETALIS_SCENARIOS", "")),
    *(
        parent / name
        for parent in Path(__file__).resolve().parents
        for name in ("scenarios", "shared/scenarios")
    ),
]
FOLDER = next((folder for folder in FOLDERS if list(folder.glob("seq_*.json"))), None)
CASES = [] if FOLDER is None else list(scenarios(FOLDER))

CONTRADICTED = {
    "during_numeric": "during is s2 =< s1 and e1 =< e2, for numbers too",
    "during_reversed": "every two-sided pattern but seq takes its sides in either order of arrival",
    "during_unrestricted": "under unrestricted nothing is used up, by any operator; sides in either order",
    "fnot_seq": "fnot: no R ended before P started, and P is the whole sequence",
    "forall_seq_recent": "forall_seq takes the waiting P oldest first",
    "meets_recent": "a completing event that matched does not wait for others",
    "ops_chronological": "starts and finishes need one side to be shorter",
    "ops_recent": "starts and finishes need one side to be shorter",
    "ops_unrestricted": "starts and finishes need one side to be shorter",
    "same_seq_rule_twice_recent": "identical rules each fire",
    "starts_numeric": "the finishes rule has its own waiting b, and takes its sides in either order",
    "starts_reversed": "every two-sided pattern but seq takes its sides in either order of arrival",
    "window_subsecond_ignored": "e - s =< V, exactly",
}
"""Scenarios that contradict the definition of the language, with the sentence that they contradict."""

OUTSIDE = {"check_nested", "check_single"}
"""Scenarios that show timestamps as terms; those of the oracle are numbers."""


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_recorded_scenario_agrees_unless_contradicted(case: Any) -> None:
    if case.name in OUTSIDE:
        pytest.skip("stamps as terms")
    agrees = run(case.rules, case.stream, **case.flags) == case.expected
    assert agrees == (case.name not in CONTRADICTED)
