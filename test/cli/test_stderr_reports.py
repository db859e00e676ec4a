"""Reports on standard error: colours of labels, and levels of what goals log."""

import logging
import sys
from io import StringIO
from typing import Type

import pytest

from retalis import RetalisError
from retalis.cli.stderr_reports import StderrReporter, detach_reporters, paint


class Terminal(StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    ("make_file", "expected"),
    [(Terminal, "\033[1;31merror\033[0m: it is hot\n"), (StringIO, "error: it is hot\n")],
)
def test_labels_are_coloured_on_terminals_only(
    monkeypatch: pytest.MonkeyPatch, make_file: Type[StringIO], expected: str
) -> None:
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm")
    file = make_file()
    monkeypatch.setattr(sys, "stderr", file)
    StderrReporter()(RetalisError("it is hot"))
    assert file.getvalue() == expected


@pytest.mark.parametrize(("name", "value"), [("NO_COLOR", "1"), ("TERM", "dumb")])
def test_colours_can_be_switched_off(monkeypatch: pytest.MonkeyPatch, name: str, value: str) -> None:
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv(name, value)
    assert paint("warning", "warning", Terminal()) == "warning"


def test_texts_of_goals_have_their_level_and_are_no_problems(capsys: pytest.CaptureFixture[str]) -> None:
    reporter = StderrReporter().attach()
    try:
        for level in (logging.DEBUG, logging.INFO, logging.ERROR):
            logging.getLogger("retalis.goals").log(level, "%s", "hot\x1b[2J")
    finally:
        detach_reporters()
    assert capsys.readouterr().err == "info: hot\\x1b[2J\nerror: hot\\x1b[2J\n"
    assert reporter.errors == 0
