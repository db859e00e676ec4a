"""Check of rule files: those that no goal reads are reported."""

import os
from pathlib import Path
from typing import Any, List

import pytest
from recorded_calls import preceded_by

from retalis import Definitions, Engine, ProgramErrors


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
