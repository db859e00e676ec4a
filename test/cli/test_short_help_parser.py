"""Help and errors of the parsers of commands."""

from pathlib import Path
from typing import Any, List

import pytest

from retalis.cli.command_line import COMMANDS, main

MAX_LINES = 24
"""Lines of a usual terminal window."""


def usage_error(arguments: Any, capsys: pytest.CaptureFixture[str]) -> List[str]:
    with pytest.raises(SystemExit) as raised:
        main(arguments)
    assert raised.value.code == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    return captured.err.splitlines()


def printed_help(arguments: Any, capsys: pytest.CaptureFixture[str]) -> str:
    with pytest.raises(SystemExit) as raised:
        main(arguments)
    assert not raised.value.code
    return capsys.readouterr().out


@pytest.mark.parametrize("command", COMMANDS)
def test_help_fits_on_screen(
    command: Any, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    lines = printed_help([command, "--help"], capsys).splitlines()
    assert len(lines) <= MAX_LINES
    assert lines[0].startswith(f"usage: retalis {command} [options]")


def test_full_help_has_groups_omitted_from_short(capsys: pytest.CaptureFixture[str]) -> None:
    short, full = (printed_help(["bag", option], capsys) for option in ("--help", "--help-all"))
    for name in ("--max-seconds", "--jobs", "--direct", "--folder", "many bags:", "with --json each line"):
        assert name in full
        assert name not in short
    assert "--help-all" in short
    assert "--program" in short


def test_command_without_groups_has_no_full_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert "--help-all" not in printed_help(["list", "--help"], capsys)


@pytest.mark.parametrize(
    ("arguments", "usage", "error"),
    [
        (["bga", "x.bag"], "retalis [options] COMMAND ...", "there is no command 'bga'; did you mean bag?"),
        (["xyzzy"], "retalis [options] COMMAND ...", "there is no command 'xyzzy'"),
        (
            ["check", "--strct"],
            "retalis check [options] [FOLDER]",
            "unknown option '--strct'; did you mean --strict?",
        ),
        (
            ["bag", "--progam", "p", "x.bag"],
            "retalis bag [options] -p FOLDER BAG [BAG ...]",
            "unknown option '--progam'; did you mean --program?",
        ),
        (
            ["bag", "x.bag"],
            "retalis bag [options] -p FOLDER BAG [BAG ...]",
            "the following arguments are required: -p/--program",
        ),
        (["check", "a", "b"], "retalis check [options] [FOLDER]", "unknown argument 'b'"),
        (["check", "-z"], "retalis check [options] [FOLDER]", "unknown argument '-z'"),
    ],
)
def test_error_shows_usage_and_similar_name(
    arguments: List[str], usage: str, error: str, capsys: pytest.CaptureFixture[str]
) -> None:
    *usage_lines, last = usage_error(arguments, capsys)
    assert usage_lines == [f"usage: {usage}"]
    assert last.partition(": error: ")[2] == error


def test_abbreviated_option_is_accepted(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "rules.txt").write_text("a <- b.")
    assert main(["check", str(tmp_path / "rules.txt"), "--form", "json"]) == 0
    assert '"findings"' in capsys.readouterr().out
