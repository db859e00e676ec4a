"""Escaping of foreign text in the log. Needs rospy, no master."""

import io
import logging

import pytest

pytest.importorskip("rospy", reason="ROS is not installed")

from rosgraph.roslogging import RosStreamHandler  # noqa: E402

from retalis.ros1.ros_log import escape_record  # noqa: E402

FORGED = "[ERROR] [1700000000.000000]: the robot is on fire"


@pytest.fixture
def log():
    return io.StringIO()


@pytest.fixture
def logger(log):
    made = logging.Logger("test_log", logging.INFO)  # `getLogger` would keep it in the process
    made.addHandler(RosStreamHandler(colorize=False, stdout=log, stderr=log))
    made.addFilter(escape_record)
    return made


def test_a_text_forges_no_record_and_no_colour(logger, log):
    logger.info("heard %s", f"\x1b[31m\u202e\n{FORGED}\r{FORGED}")
    lines = log.getvalue().splitlines()
    assert len(lines) == 2
    assert lines[0].endswith(r"heard \x1b[31m\u202e")
    assert lines[1] == f"    {FORGED}\\r{FORGED}"


@pytest.mark.parametrize("text", ["${time:", "${node}", "${walltime: 100%", "100 % ${"])
def test_a_text_is_no_template_of_the_log(logger, log, text):
    logger.warning(text)
    assert log.getvalue().endswith(f"]: {text}\n".replace("${", r"\x24{"))


def test_wrong_arguments_of_a_record_raise_nothing_where_it_is_logged(logger, log):
    logger.warning("%d things", "\x1b")
    assert log.getvalue().endswith(r"]: %d things ('\x1b',)" + "\n")


def test_an_error_with_its_line_stays_readable(logger, log):
    logger.warning("%s", "rules.txt:1:3: wrong\na $ b\n  ^")
    assert log.getvalue().endswith("rules.txt:1:3: wrong\n    a $ b\n      ^\n")
