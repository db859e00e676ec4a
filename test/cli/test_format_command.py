"""Command ``format``: files, folders, standard input, and exit status."""

import io
import os
import stat
from pathlib import Path
from typing import Any, Tuple

import pytest

from retalis.cli.command_line import main

RULES = "a(X)<-b(X)."
FORMATTED = "a(X) <- b(X).\n"


@pytest.fixture
def rules(tmp_path: Path) -> Path:
    path = tmp_path / "eventRules.txt"
    path.write_text(RULES)
    return path


def run_format(capsys: pytest.CaptureFixture[str], *arguments: Any) -> Tuple[int, str, str]:
    """Return the exit status, and the texts on standard output and standard error."""
    status = main(["format", *map(str, arguments)])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def run_on_input(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, text: str, *arguments: Any
) -> Tuple[int, str, str]:
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(text.encode())))
    return run_format(capsys, "-", *arguments)


def test_file_is_replaced(capsys: pytest.CaptureFixture[str], rules: Path) -> None:
    rules.chmod(0o640)
    status, out, err = run_format(capsys, rules)
    assert (status, out) == (0, "")
    assert err == f"reformatted {rules}\n1 file reformatted\n"
    assert rules.read_text() == FORMATTED
    assert stat.S_IMODE(rules.stat().st_mode) == 0o640
    assert os.listdir(rules.parent) == [rules.name]


def test_formatted_file_is_not_written(capsys: pytest.CaptureFixture[str], rules: Path) -> None:
    rules.write_text(FORMATTED)
    identity = rules.stat().st_ino
    assert run_format(capsys, rules) == (0, "", "1 file left unchanged\n")
    assert rules.stat().st_ino == identity


def test_check_lists_files(capsys: pytest.CaptureFixture[str], rules: Path) -> None:
    assert run_format(capsys, rules, "--check") == (
        1,
        "",
        f"would reformat {rules}\n1 file would be reformatted\n",
    )
    assert rules.read_text() == RULES
    rules.write_text(FORMATTED)
    assert run_format(capsys, rules, "--check")[0] == 0


def test_diff_prints_change(capsys: pytest.CaptureFixture[str], rules: Path) -> None:
    rules.write_text("a(X)<-b(X).\nc.\n")
    status, out, _ = run_format(capsys, rules, "--diff")
    assert status == 1
    assert out == f"--- {rules}\n+++ {rules}\n@@ -1,2 +1,2 @@\n-a(X)<-b(X).\n+a(X) <- b(X).\n c.\n"
    assert rules.read_text() == "a(X)<-b(X).\nc.\n"


def test_diff_marks_missing_newline(capsys: pytest.CaptureFixture[str], rules: Path) -> None:
    rules.write_text("a.")
    assert run_format(capsys, rules, "--diff")[1].endswith("-a.\n\\ No newline at end of file\n+a.\n")


def test_folder_is_searched_for_programs(
    capsys: pytest.CaptureFixture[str], rules: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (rules.parent / "robot").mkdir()
    (rules.parent / ".hidden").mkdir()
    (rules.parent / ".hidden" / "eventRules.txt").write_text(RULES)
    (rules.parent / "notes.txt").write_text("no rules")
    (rules.parent / "robot" / "more.retalis").write_text(RULES)
    (rules.parent / "robot" / "goalPredicates.txt").write_text("subscribe(a,[],_,t,s)\n")
    monkeypatch.chdir(rules.parent)
    status, _, err = run_format(capsys)
    assert status == 0
    assert err.endswith("3 files reformatted\n")
    assert (rules.parent / "robot" / "goalPredicates.txt").read_text() == "subscribe(a, [], _, t, s)\n"
    assert (rules.parent / ".hidden" / "eventRules.txt").read_text() == RULES


def test_folder_without_programs_is_error(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    status, _, err = run_format(capsys, tmp_path)
    assert status == 1
    assert "contains no file to format: expected eventRules.txt, goalPredicates.txt or *.event" in err


def test_missing_file_is_error(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    status, _, err = run_format(capsys, tmp_path / "rules.txt")
    assert status == 1
    assert err == f"retalis: format: there is no file {tmp_path}/rules.txt\n"


def test_syntax_error_leaves_file_alone(capsys: pytest.CaptureFixture[str], rules: Path) -> None:
    rules.write_text("a(X)<-b(X).\nc(.\n")
    other = rules.with_name("other.event")
    other.write_text(RULES)
    status, _, err = run_format(capsys, rules, other)
    assert status == 2
    assert f"error: {rules}:2:3: " in err
    assert err.endswith("1 file reformatted, 1 file with errors\n")
    assert rules.read_text() == "a(X)<-b(X).\nc(.\n"
    assert other.read_text() == FORMATTED


def test_file_that_is_not_text_is_error(capsys: pytest.CaptureFixture[str], rules: Path) -> None:
    rules.write_bytes(b"a.\n\xff.\n")
    status, _, err = run_format(capsys, rules)
    assert status == 2
    assert f"cannot read {rules}: not UTF-8 text (line 2" in err


def test_standard_input_is_printed(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert run_on_input(capsys, monkeypatch, RULES) == (0, FORMATTED, "")


def test_standard_input_has_name(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    goals = "subscribe(a,[],_,t,s)\n"
    name = ("--stdin-filename", "robot/goalPredicates.txt")
    assert run_on_input(capsys, monkeypatch, goals, *name) == (0, "subscribe(a, [], _, t, s)\n", "")
    assert "robot/goalPredicates.txt:1:" in run_on_input(capsys, monkeypatch, "a(\n", *name)[2]


def test_option_for_goal_files(capsys: pytest.CaptureFixture[str], rules: Path) -> None:
    rules.write_text("a(1,2)\n")
    assert run_format(capsys, rules)[0] == 2
    assert run_format(capsys, rules, "--goals")[0] == 0
    assert rules.read_text() == "a(1, 2)\n"


def test_line_length(capsys: pytest.CaptureFixture[str], rules: Path) -> None:
    assert run_format(capsys, rules, "--line-length", 10)[0] == 0
    assert rules.read_text() == "a(X)\n  <- b(X).\n"
