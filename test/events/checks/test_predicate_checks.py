"""Checks of predicates: rule files that no goal reads, calls of undefined predicates, and counters."""

import os
from pathlib import Path
from typing import Any, List

import pytest
from recorded_calls import preceded_by

from retalis import Definitions, Engine, ProgramErrors
from retalis.engine.program_check import check_program


def unread_files(engine: Any, folder: Any) -> List[Any]:
    return [
        warning.message
        for warning in engine.warnings(folder, Definitions())
        if "is not read" in warning.message
    ]


def test_file_that_is_not_read_is_reported(tmp_path: Path) -> None:
    engine = Engine()
    assert unread_files(engine, tmp_path) == []
    (tmp_path / "eventRules.txt").write_text("a <- b.")
    assert unread_files(engine, tmp_path) == [
        f"{tmp_path}/eventRules.txt is not read: no goal in goalPredicates.txt calls "
        "compile_event_file('eventRules.txt')"
    ]
    (tmp_path / "goalPredicates.txt").write_text("% compile_event_file('eventRules.txt')\n")
    engine.load_program(tmp_path)
    assert len(unread_files(engine, tmp_path)) == 1
    for condition in ("", "fail -> true ; "):
        (tmp_path / "goalPredicates.txt").write_text(f"({condition}compile_event_file('eventRules.txt'))")
        engine.load_program(tmp_path)
        assert unread_files(engine, tmp_path) == []
    (tmp_path / "goalPredicates.txt").write_text('(fail -> compile_event_file("eventRules.txt") ; true)')
    engine = Engine()
    engine.load_program(tmp_path)
    assert unread_files(engine, tmp_path) == []
    (tmp_path / "goalPredicates.txt").write_text("compile_event_file('eventRules.txt')")
    (tmp_path / "eventRules.txt").write_text("a <- .")
    engine = Engine()
    with pytest.raises(ProgramErrors):
        engine.load_program(tmp_path)
    assert unread_files(engine, tmp_path) == []  # the errors of the load are reported already


def test_folder_without_permission_is_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The system call is replaced, because root may enter all folders."""
    real_stat, real_path_stat = os.stat, Path.stat

    def refuse(path: Any) -> None:
        if str(path).startswith(f"{tmp_path}/"):
            raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(os, "stat", preceded_by(refuse, real_stat))
    monkeypatch.setattr(Path, "stat", preceded_by(refuse, real_path_stat))
    assert unread_files(Engine(), tmp_path) == []


def write_program(folder: Path, rules: Any) -> None:
    (folder / "pub_sub.xml").write_text("<publish_subscribe/>")
    (folder / "goalPredicates.txt").write_text("compile_event_file('eventRules.txt')\n")
    (folder / "eventRules.txt").write_text(f"{rules}\n")


def findings_of(path: Any, code: str, definitions: Any) -> List[Any]:
    return [
        finding.problem.message
        for finding in check_program(path, definitions)
        if finding.problem.code == code
    ]


def findings_of_rules(folder: Path, rules: Any, code: str, definitions: Any) -> Any:
    path = folder / "rules.txt"
    path.write_text(f"{rules}\n")
    return findings_of(path, code, definitions)


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
    (message,) = findings_of(tmp_path, "RT1404", definitions)
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
    assert findings_of(tmp_path, "RT1404", definitions) == []


def test_counter_of_single_file_is_not_reported(tmp_path: Path, definitions: Definitions) -> None:
    assert findings_of_rules(tmp_path, COUNTER, "RT1404", definitions) == []


def test_clause_is_not_suggested_for_its_own_call(tmp_path: Path, definitions: Definitions) -> None:
    rules = "near(X) :- nearr(X).\na <- b(X) where near(X)."
    (message,) = findings_of_rules(tmp_path, rules, "RT1402", definitions)
    assert message == "there is no predicate nearr/1: define it, or assert facts of it"
