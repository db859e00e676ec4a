"""Output of goals, errors, and numbers of problems in the log of a node.

Printed lines contain text from outside, for example from messages. To prevent forged log lines, lines that goals
print begin with `PRINTED_LINE_PREFIX`, and control characters in them, such as a carriage return, are escaped.
"""

import logging
import sys
import threading
from contextlib import contextmanager
from typing import Callable, Iterator, List

from ..engine.runtime.problem_reports import COUNTED_ATTRIBUTE
from ..foundation.displayed_text import printable
from ..foundation.errors import ProgramErrors, RetalisError
from ..prolog.system.prolog_system import PrologSystem

log = logging.getLogger("retalis")


class LogCounts(logging.Handler):
    """Counts warnings and errors in the node's log, except those that `Reports` counts itself."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.errors = self.warnings = 0
        self._thread_state = threading.local()

    @contextmanager
    def skipping(self, is_counted: bool) -> Iterator[None]:
        """Do not count the records of this thread, if they are counted elsewhere."""
        was_counted = getattr(self._thread_state, "is_counted", False)
        self._thread_state.is_counted = is_counted
        try:
            yield
        finally:
            self._thread_state.is_counted = was_counted

    def emit(self, record: logging.LogRecord) -> None:
        """Count a record."""
        if getattr(self._thread_state, "is_counted", False) or getattr(record, COUNTED_ATTRIBUTE, False):
            return
        if record.levelno >= logging.ERROR:
            self.errors += 1
        else:
            self.warnings += 1


log_counts = LogCounts()
"""The counts of this node."""


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
        # None if the node was started with it closed.
        if lines and stream is not None:
            stream.write("".join(f"{PRINTED_LINE_PREFIX}{printable(line)}\n" for line in lines))

    def end(self) -> None:
        """Print the last line if it is incomplete."""
        if self._incomplete_line:
            self("\n")


def print_goal_output(logic: PrologSystem, on_shutdown: Callable[[Callable[[], object]], object]) -> None:
    """Redirect the output of goals to `PrintedLines`, so that it cannot be mistaken for log records."""
    streams = PrintedLines("stdout"), PrintedLines("stderr")
    logic.print_to(*streams)
    for stream in streams:
        on_shutdown(stream.end)


def log_error(error: RetalisError) -> List[str]:
    """Log an error, or each error of `ProgramErrors`; return their texts."""
    texts = [str(part) for part in (error.errors if isinstance(error, ProgramErrors) else [error])]
    for text in texts:
        log.error("%s", text)
    return texts
