"""Printed lines of goals, and counts of the log of a node."""

import logging
import sys

import pytest

from retalis.engine.runtime.problem_reports import COUNTED_ATTRIBUTE
from retalis.node.goal_output import MAX_PRINTED_LINE_CHARACTERS, LogCounts, PrintedLines

FORGED = "[ERROR] [1700000000.000000]: the robot is on fire"


def test_printed_lines_have_mark_and_are_complete(capsys: pytest.CaptureFixture[str]) -> None:
    print_lines = PrintedLines("stdout")
    print_lines("a")
    assert capsys.readouterr().out == ""
    print_lines(f"b\n{FORGED}\nc")
    assert capsys.readouterr().out == f"| ab\n| {FORGED}\n"
    print_lines.end()
    print_lines.end()
    assert capsys.readouterr().out == "| c\n"


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        (f"a\r{FORGED}", f"a\\r{FORGED}"),
        (f"\x1b[2K\x1b[1G{FORGED}", f"\\x1b[2K\\x1b[1G{FORGED}"),
        ("\udcff\t\u00fc", "\\udcff\t\u00fc"),
    ],
)
def test_control_characters_of_line_are_escaped(
    capsys: pytest.CaptureFixture[str], text: str, shown: str
) -> None:
    PrintedLines("stdout")(f"{text}\nb\n")
    assert capsys.readouterr().out == f"| {shown}\n| b\n"


def test_long_line_is_split(capsys: pytest.CaptureFixture[str]) -> None:
    PrintedLines("stderr")("x" * (2 * MAX_PRINTED_LINE_CHARACTERS + 1))
    assert capsys.readouterr().err == f"| {'x' * MAX_PRINTED_LINE_CHARACTERS}\n" * 2


def test_missing_standard_output_is_ignored(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", None)
    PrintedLines("stdout")("a\n")


def test_records_are_counted_once() -> None:
    counts = LogCounts()
    logger = logging.Logger("test_log")
    logger.addHandler(counts)
    logger.warning("one")
    logger.error("two")
    logger.info("three")
    logger.error("counted by reports", extra={COUNTED_ATTRIBUTE: True})
    with counts.skipping(True):
        with counts.skipping(False):
            logger.warning("within")
        logger.error("counted elsewhere")
    assert (counts.errors, counts.warnings) == (1, 2)
