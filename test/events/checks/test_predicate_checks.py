"""Rules of a program's folder that no goal reads."""

import os
from pathlib import Path

import pytest

from retalis import Definitions, Engine, ProgramErrors


def unread(engine, folder):
    return [one.message for one in engine.warnings(folder, Definitions()) if "is not read" in one.message]


def test_rules_that_no_goal_reads(tmp_path):
    engine = Engine()
    assert unread(engine, tmp_path) == []
    (tmp_path / "eventRules.txt").write_text("a <- b.")
    assert unread(engine, tmp_path) == [
        f"{tmp_path}/eventRules.txt is not read: no goal in goalPredicates.txt calls "
        "compile_event_file('eventRules.txt')"
    ]
    (tmp_path / "goalPredicates.txt").write_text("compile_event_file('eventRules.txt')")
    engine.load_program(tmp_path)
    assert unread(engine, tmp_path) == []
    (tmp_path / "eventRules.txt").write_text("a <- .")
    engine = Engine()
    with pytest.raises(ProgramErrors):
        engine.load_program(tmp_path)
    assert unread(engine, tmp_path) == []  # that they cannot be read is said already


def test_a_folder_that_may_not_be_entered_is_no_error(tmp_path, monkeypatch):
    """Who is root may enter all of them: here the system says no."""

    real_stat, real_path_stat = os.stat, Path.stat

    def refuse(path):
        if str(path).startswith(f"{tmp_path}/"):
            raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(
        os, "stat", lambda path, *rest, **options: refuse(path) or real_stat(path, *rest, **options)
    )
    monkeypatch.setattr(Path, "stat", lambda path, **options: refuse(path) or real_path_stat(path, **options))
    assert unread(Engine(), tmp_path) == []
