"""Log of a node: forwarding of the package's records to ROS, counts of problems, and output of goals.

Records and printed lines contain text from outside, for example from messages. To prevent forged log lines, control
characters are escaped, further lines of a record are indented, and lines that goals print begin with
`PRINTED_LINE_PREFIX`.
"""

import io
import logging
import sys
import threading
from typing import List

import rospy

from ..engine.runtime.problem_reports import COUNTED_ATTRIBUTE
from ..foundation.errors import ProgramErrors, RetalisError, printable
from ..prolog.system.prolog_system import PrologSystem


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
        if getattr(_thread_state, "is_counted", False):
            return
        if record.levelno >= logging.ERROR:
            self.errors += 1
        else:
            self.warnings += 1


_thread_state = threading.local()
"""Attribute ``is_counted`` is true while this thread sends a record to ROS that `Reports` has counted."""


class _RosHandler(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        _thread_state.is_counted = getattr(record, COUNTED_ATTRIBUTE, False)
        try:
            self._send(record)
        finally:
            _thread_state.is_counted = False

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


PRINTED_LINE_PREFIX = "| "
"""Prefix of each line that goals print."""

MAX_PRINTED_LINE_CHARACTERS = 4096
"""Limit for the characters of a printed line; longer ones are wrapped."""


class PrintedLines:
    """Output stream for goals that write to ``user_output`` or ``user_error``, printed in complete lines.

    Args:
        stream: ``stdout`` or ``stderr``.
    """

    def __init__(self, stream: str):
        self._stream = stream
        self._incomplete_line = ""

    def __call__(self, text: str) -> None:
        """Append a text, and print the complete lines."""
        *lines, self._incomplete_line = (self._incomplete_line + text).split("\n")
        if len(self._incomplete_line) > MAX_PRINTED_LINE_CHARACTERS:
            size = len(self._incomplete_line) // MAX_PRINTED_LINE_CHARACTERS * MAX_PRINTED_LINE_CHARACTERS
            lines += [
                self._incomplete_line[start : start + MAX_PRINTED_LINE_CHARACTERS]
                for start in range(0, size, MAX_PRINTED_LINE_CHARACTERS)
            ]
            self._incomplete_line = self._incomplete_line[size:]
        stream = getattr(sys, self._stream)
        if lines and stream is not None:
            # None if the node was started with it closed.
            stream.write("".join(f"{PRINTED_LINE_PREFIX}{line}\n" for line in lines))

    def end(self) -> None:
        """Print the last line if it is incomplete."""
        if self._incomplete_line:
            self("\n")


def print_goal_output(logic: PrologSystem) -> None:
    """Redirect the output of goals to `PrintedLines`, so that it cannot be mistaken for log records."""
    streams = PrintedLines("stdout"), PrintedLines("stderr")
    logic.print_to(*streams)
    for stream in streams:
        rospy.on_shutdown(stream.end)


def log_error(error: RetalisError) -> List[str]:
    """Log an error, or each error of `ProgramErrors`; return their texts."""
    texts = [str(part) for part in (error.errors if isinstance(error, ProgramErrors) else [error])]
    for text in texts:
        rospy.logerr("%s", text)
    return texts
