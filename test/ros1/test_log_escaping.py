"""Escaping of foreign text in the log. Needs rospy, no master."""

import io
import logging
from typing import Any

import pytest

pytest.importorskip("rospy", reason="ROS is not installed")

from rosgraph.roslogging import RosStreamHandler  # noqa: E402

from retalis.ros1.node_lifecycle import escape_record  # noqa: E402

FORGED = "[ERROR] [1700000000.000000]: the robot is on fire"


@pytest.fixture
def log() -> Any:
    return io.StringIO()


@pytest.fixture
def logger(log: Any) -> Any:
    logger = logging.Logger("test_log", logging.INFO)  # `getLogger` would register it in the process
    logger.addHandler(RosStreamHandler(colorize=False, stdout=log, stderr=log))
    logger.addFilter(escape_record)
    return logger


def test_text_cannot_forge_records_or_colours(logger: Any, log: Any) -> None:
    logger.info("heard %s", f"\x1b[31m\u202e\n{FORGED}\r{FORGED}")
    lines = log.getvalue().splitlines()
    assert len(lines) == 2
    assert lines[0].endswith(r"heard \x1b[31m\u202e")
    assert lines[1] == f"    {FORGED}\\r{FORGED}"


@pytest.mark.parametrize("text", ["${time:", "${node}", "${walltime: 100%", "100 % ${"])
def test_text_is_not_expanded_as_template(logger: Any, log: Any, text: str) -> None:
    logger.warning(text)
    assert log.getvalue().endswith(f"]: {text}\n".replace("${", r"\x24{"))


def test_invalid_arguments_are_logged_without_error(logger: Any, log: Any) -> None:
    logger.warning("%d things", "\x1b")
    assert log.getvalue().endswith(r"]: %d things ('\x1b',)" + "\n")


def test_error_with_source_line_is_readable(logger: Any, log: Any) -> None:
    logger.warning("%s", "rules.txt:1:3: wrong\na $ b\n  ^")
    assert log.getvalue().endswith("rules.txt:1:3: wrong\n    a $ b\n      ^\n")
