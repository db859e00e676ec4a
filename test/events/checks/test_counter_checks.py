"""Check of counters: facts that goals replace, and that have no first fact."""

from pathlib import Path
from typing import Any, List

import pytest

from retalis import Definitions
from retalis.engine.program_check import check_program


def write_program(folder: Path, rules: str) -> None:
    (folder / "pub_sub.xml").write_text("<publish_subscribe/>")
    (folder / "goalPredicates.txt").write_text("compile_event_file('eventRules.txt')\n")
    (folder / "eventRules.txt").write_text(f"{rules}\n")


def findings_of(path: Path, definitions: Definitions) -> List[Any]:
    return [
        finding.problem.message
        for finding in check_program(path, definitions)
        if finding.problem.code == "RT1404"
    ]


COUNTER = "c(N) do (retract(count(M)), N is M + 1, assertz(count(N))) <- tick."


@pytest.mark.parametrize(
    "rules",
    [
        COUNTER,
        f":- dynamic count/1.\n{COUNTER}",
        "next(N) :- count(M), N is M + 1, retract(count(M)), assertz(count(N)).\nc(N) <- tick where next(N).",
    ],
)
def test_counter_without_first_fact_is_reported(tmp_path: Path, definitions: Definitions, rules: str) -> None:
    write_program(tmp_path, rules)
    (message,) = findings_of(tmp_path, definitions)
    assert message == (
        "count/1 has no clause here, and goals add one only after this one succeeds: "
        "add a first fact, such as count(0)."
    )


@pytest.mark.parametrize(
    "rules",
    [
        f"count(0).\n{COUNTER}",
        f"{COUNTER}\nnull do assertz(count(0)) <- start.",
        f":- assertz(count(0)).\n{COUNTER}",
        "c(N) do ((retract(count(M)) ; M = 0), N is M + 1, assertz(count(N))) <- tick.",
        "c(N) do (retract(count(M)) -> N is M + 1, assertz(count(N)) ; N = 0, assertz(count(0))) <- tick.",
        "c do (retractall(count(_)), assertz(count(1))) <- tick.",
        f"{COUNTER}\nnull do assertz(F) <- fact(F).",
    ],
)
def test_counter_with_first_fact_is_not_reported(
    tmp_path: Path, definitions: Definitions, rules: str
) -> None:
    write_program(tmp_path, rules)
    assert findings_of(tmp_path, definitions) == []


def test_counter_of_single_file_is_not_reported(tmp_path: Path, definitions: Definitions) -> None:
    rules = tmp_path / "rules.txt"
    rules.write_text(f"{COUNTER}\n")
    assert findings_of(rules, definitions) == []
