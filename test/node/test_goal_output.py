"""Lines that goals print, and counts of a node's log."""

import logging
import sys

from retalis.engine.runtime.problem_reports import COUNTED_ATTRIBUTE
from retalis.node.goal_output import MAX_PRINTED_LINE_CHARACTERS, LogCounts, PrintedLines

FORGED = "[ERROR] [1700000000.000000]: the robot is on fire"


def test_lines_of_goals_have_a_mark_and_are_whole(capsys):
    print_lines = PrintedLines("stdout")
    print_lines("a")
    assert capsys.readouterr().out == ""
    print_lines(f"b\n{FORGED}\nc")
    assert capsys.readouterr().out == f"| ab\n| {FORGED}\n"
    print_lines.end()
    print_lines.end()
    assert capsys.readouterr().out == "| c\n"


def test_a_line_without_an_end_is_not_held_for_ever(capsys):
    PrintedLines("stderr")("x" * (2 * MAX_PRINTED_LINE_CHARACTERS + 1))
    assert capsys.readouterr().err == f"| {'x' * MAX_PRINTED_LINE_CHARACTERS}\n" * 2


def test_a_node_without_standard_output_goes_on(monkeypatch):
    monkeypatch.setattr(sys, "stdout", None)
    PrintedLines("stdout")("a\n")


def test_records_are_counted_unless_reports_count_them():
    counts = LogCounts()
    logger = logging.Logger("test_log")
    logger.addHandler(counts)
    logger.warning("one")
    logger.error("two")
    logger.info("three")
    logger.error("counted by reports", extra={COUNTED_ATTRIBUTE: True})
    with counts.skipping(True):
        logger.error("counted elsewhere")
    assert (counts.errors, counts.warnings) == (1, 1)
