"""The node's log: records of the package sent to ROS, and counts of warnings and errors."""

import io
import logging
import sys
import threading
from typing import List

import rospy

from ..engine.runtime import COUNTED
from ..foundation import ProgramErrors, RetalisError


class LogCounts(logging.Handler):
    """Counts warnings and errors in the node's log, except those that `Reports` counts itself.

    Attributes:
        errors: the number of errors.
        warnings: the number of warnings.
    """

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.errors = self.warnings = 0

    def emit(self, record: logging.LogRecord) -> None:
        """Count a record."""
        if getattr(_sending, "counted", False):
            return
        if record.levelno >= logging.ERROR:
            self.errors += 1
        else:
            self.warnings += 1


_sending = threading.local()
"""True while this thread sends a record to ROS that has been counted."""


class _RosHandler(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        _sending.counted = getattr(record, COUNTED, False)
        try:
            self._send(record)
        finally:
            _sending.counted = False

    def _send(self, record: logging.LogRecord) -> None:
        text = self.format(record)
        if record.levelno >= logging.ERROR:
            rospy.logerr("%s", text)
        elif record.levelno >= logging.WARNING:
            rospy.logwarn("%s", text)
        else:
            rospy.loginfo("%s", text)


log_counts = LogCounts()
"""The counts of this node."""


def write_out_each_line() -> None:
    """Write out each line of stdout as soon as it is complete.

    rospy prints messages of level INFO there and does not flush. In a file or a pipe, which is what roslaunch gives
    its nodes unless a terminal is asked for, they would wait for 8 KiB, or for the end of the node.
    """
    if isinstance(sys.stdout, io.TextIOWrapper):  # None where the node was started with stdout closed
        sys.stdout.reconfigure(line_buffering=True)


def forward_log(logger: logging.Logger) -> None:
    """Send what a logger gets to rospy's log functions, so that it is seen on the screen and on ``/rosout``.

    All that these log from now on is counted in `log_counts`.
    """
    logging.getLogger("rosout").addHandler(log_counts)
    logger.addHandler(_RosHandler())
    logger.setLevel(logging.INFO)
    logger.propagate = False


def log_error(error: RetalisError) -> List[str]:
    """Log an error, each by itself where it is several; return their texts."""
    texts = [str(one) for one in (error.errors if isinstance(error, ProgramErrors) else [error])]
    for text in texts:
        rospy.logerr("%s", text)
    return texts
