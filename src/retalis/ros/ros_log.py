"""The node's log: records of the package sent to ROS, counts of warnings and errors, and what goals print.

Texts from outside get into both. So control characters are shown as escapes, and only what the node itself logs
begins a line as a record does: further lines of a record are indented, and lines that goals print have a mark.
"""

import io
import logging
import sys
import threading
from typing import List

import rospy

from ..engine.runtime.problem_reports import COUNTED
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

    All that these log from now on is counted in `log_counts`, and shown as `show_safely` says.
    """
    rosout = logging.getLogger("rosout")
    rosout.addHandler(log_counts)
    for filtered in (rosout, *rosout.handlers, *logging.getLogger().handlers):
        filtered.addFilter(show_safely)
    logger.addHandler(_RosHandler())
    logger.setLevel(logging.INFO)
    logger.propagate = False


def show_safely(record: logging.LogRecord) -> bool:
    """Change the text of a log record so that no part of it is taken for another record or acted on; return True.

    rospy's own handler would put values in place of ``${...}`` in the text, and fail at one without an end.
    """
    if not hasattr(record, "shown_safely"):
        try:
            text = printable(record.getMessage())
        except Exception:  # wrong arguments: rospy's handler would raise the error where the text is logged
            text = printable(f"{record.msg} {record.args}")
        record.msg, record.args = text.replace("\n", "\n    ").replace("${", "\\x24{"), ()
        record.shown_safely = True
    return True


PRINTED = "| "
"""Before each line that goals print."""

MAX_PRINTED_LINE_CHARACTERS = 4096
"""Characters of a printed line: what is longer goes on in another."""


class PrintedLines:
    """Prints what goals write to ``user_output`` or ``user_error``, in whole lines.

    Args:
        stream: ``stdout`` or ``stderr``.
    """

    def __init__(self, stream: str):
        self._stream = stream
        self._held = ""

    def __call__(self, text: str) -> None:
        """Print the lines that are complete by now."""
        *lines, self._held = (self._held + text).split("\n")
        if len(self._held) > MAX_PRINTED_LINE_CHARACTERS:
            size = len(self._held) // MAX_PRINTED_LINE_CHARACTERS * MAX_PRINTED_LINE_CHARACTERS
            lines += [
                self._held[at : at + MAX_PRINTED_LINE_CHARACTERS]
                for at in range(0, size, MAX_PRINTED_LINE_CHARACTERS)
            ]
            self._held = self._held[size:]
        stream = getattr(sys, self._stream)
        if lines and stream is not None:  # None where the node was started with it closed
            stream.write("".join(f"{PRINTED}{line}\n" for line in lines))

    def end(self) -> None:
        """Print a last line that nothing ended."""
        if self._held:
            self("\n")


def print_lines_of(logic: PrologSystem) -> None:
    """Have goals print lines that cannot be taken for records of the log."""
    streams = PrintedLines("stdout"), PrintedLines("stderr")
    logic.print_to(*streams)
    for stream in streams:
        rospy.on_shutdown(stream.end)


def log_error(error: RetalisError) -> List[str]:
    """Log an error, each by itself where it is several; return their texts."""
    texts = [str(one) for one in (error.errors if isinstance(error, ProgramErrors) else [error])]
    for text in texts:
        rospy.logerr("%s", text)
    return texts
