"""What the package logs, handed on to ROS."""

import logging
from typing import List

import rospy

from ..foundation import ProgramErrors, RetalisError


class _RosHandler(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        text = self.format(record)
        if record.levelno >= logging.ERROR:
            rospy.logerr("%s", text)
        elif record.levelno >= logging.WARNING:
            rospy.logwarn("%s", text)
        else:
            rospy.loginfo("%s", text)


def forward_log(logger: logging.Logger) -> None:
    """Send what a logger gets to rospy's log functions, so that it is seen on the screen and on ``/rosout``."""
    logger.addHandler(_RosHandler())
    logger.setLevel(logging.INFO)
    logger.propagate = False


def log_error(error: RetalisError) -> List[str]:
    """Log an error, each by itself where it is several; return their texts."""
    texts = [str(one) for one in (error.errors if isinstance(error, ProgramErrors) else [error])]
    for text in texts:
        rospy.logerr("%s", text)
    return texts
