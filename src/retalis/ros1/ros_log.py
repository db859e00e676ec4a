"""Log of a node: forwarding of the package's records to ROS.

Records contain text from outside, for example from messages. To prevent forged log lines, control characters are
escaped, and further lines of a record are indented.
"""

import io
import logging
import sys

import rospy

from ..engine.runtime.problem_reports import COUNTED_ATTRIBUTE
from ..foundation.displayed_text import printable
from ..node.goal_output import log_counts
from ..prolog.builtins.listing_and_messages import goal_log


class _RosHandler(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        with log_counts.skipping(getattr(record, COUNTED_ATTRIBUTE, False)):
            self._send(record)

    def _send(self, record: logging.LogRecord) -> None:
        text = self.format(record)
        if record.levelno >= logging.ERROR:
            rospy.logerr("%s", text)
        elif record.levelno >= logging.WARNING:
            rospy.logwarn("%s", text)
        elif record.levelno >= logging.INFO:
            rospy.loginfo("%s", text)
        else:
            rospy.logdebug("%s", text)


def use_line_buffering() -> None:
    """Switch stdout to line buffering.

    rospy prints messages of level INFO there and does not flush. In a file or a pipe, the stdout of a node that
    roslaunch starts, they would be delayed until 8 KiB are full or the node ends.
    """
    if isinstance(sys.stdout, io.TextIOWrapper):
        # None if the node was started with stdout closed.
        sys.stdout.reconfigure(line_buffering=True)


def forward_log(logger: logging.Logger) -> None:
    """Forward the records of a logger to rospy's log functions, for the screen and ``/rosout``.

    All later records of rospy are counted in `log_counts`, and escaped by `escape_record`.
    """
    rosout = logging.getLogger("rosout")
    rosout.addHandler(log_counts)
    # Filters of a logger are not applied to records of its children, so the handlers get the filter, too.
    for filtered in (rosout, *rosout.handlers, *logging.getLogger().handlers):
        filtered.addFilter(escape_record)
    logger.addHandler(_RosHandler())
    logger.setLevel(logging.INFO)
    logger.propagate = False
    # Rules may log for debugging: rospy drops these records unless its level is lower.
    goal_log.setLevel(logging.DEBUG)


def escape_record(record: logging.LogRecord) -> bool:
    """Escape the text of a log record so that it cannot look like another record; return True, as a log filter.

    ``${`` is escaped because rospy's console handler would substitute it, and fail if the bracket is not closed.
    """
    # A record passes several handlers, and must be escaped once.
    if not hasattr(record, "is_escaped"):
        try:
            text = printable(record.getMessage())
        except Exception:
            # Arguments that do not fit the format: rospy's handler would raise in the caller.
            text = printable(f"{record.msg} {record.args}")
        record.msg, record.args = text.replace("\n", "\n    ").replace("${", "\\x24{"), ()
        record.is_escaped = True
    return True
