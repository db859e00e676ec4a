"""Reports of commands on standard error: errors and warnings, with a count and with colours on terminals."""

import io
import logging
import os
import sys
from contextlib import contextmanager
from typing import IO, Iterator

from ..foundation.displayed_text import printable
from ..foundation.errors import RetalisError

_package_logger = logging.getLogger("retalis")
_event_logger = logging.getLogger("retalis.events")
"""Logger of the events that a program requests to be shown."""

_goal_logger = logging.getLogger("retalis.goals")
"""Logger of what goals log."""


_COLOURS = {"error": "1;31", "warning": "1;33", "info": "1;34"}
"""Colour of each kind of finding on a terminal: parameters of the control sequence SGR of ECMA-48."""


def paint(text: str, kind: str, file: IO[str]) -> str:
    """Return a text in the colour of a kind of finding if a file is a terminal and colours are not switched off.

    See https://no-color.org for the environment variable ``NO_COLOR``.
    """
    if os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb" or not file.isatty():
        return text
    return f"\033[{_COLOURS[kind]}m{text}\033[0m"


class StderrReporter(logging.Handler):
    """Printer of errors and warnings to standard error, with a count of the errors."""

    def __init__(self) -> None:
        super().__init__()
        self.errors = 0

    def __call__(self, error: RetalisError) -> None:
        """Print and count an error."""
        self.errors += 1
        print(f"{paint('error', 'error', sys.stderr)}: {error}", file=sys.stderr)

    def emit(self, record: logging.LogRecord) -> None:
        """Print a log record, and count it if it is an error."""
        text = printable(self.format(record))
        # Events that the program requests to be shown are output, not problems: no level, and no count.
        if record.name == _event_logger.name:
            print(text, file=sys.stderr)
            return
        # What goals log is output, too, with its level.
        if record.name == _goal_logger.name:
            print(f"{record.levelname.lower()}: {text}", file=sys.stderr)
            return
        if record.levelno < logging.WARNING:
            return
        is_error = record.levelno >= logging.ERROR
        if is_error:
            self.errors += 1
        label = paint(record.levelname.lower(), "error" if is_error else "warning", sys.stderr)
        print(f"{label}: {text}", file=sys.stderr)

    def attach(self, show_events: bool = False) -> "StderrReporter":
        """Report log records of the package, and events on request, until `detach_reporters` is called."""
        if show_events:
            _event_logger.setLevel(logging.INFO)
        _goal_logger.setLevel(logging.INFO)
        _package_logger.addHandler(self)
        _package_logger.propagate = False
        return self


def detach_reporters() -> None:
    """Detach all reporters, and restore the loggers."""
    for handler in [
        candidate for candidate in _package_logger.handlers if isinstance(candidate, StderrReporter)
    ]:
        _package_logger.removeHandler(handler)
    _event_logger.setLevel(logging.NOTSET)
    _goal_logger.setLevel(logging.NOTSET)
    _package_logger.propagate = True


MAX_BAG_TEXT_CHARACTERS = 64 << 10
"""Limit for the characters of errors and warnings of a bag."""


class LimitedText(io.StringIO):
    """Standard error of a bag, cut after `MAX_BAG_TEXT_CHARACTERS` characters."""

    _dropped_characters = 0

    def write(self, text: str) -> int:
        """Store a text up to the limit."""
        # A bag with an error per message must not fill the memory of the process that collects the messages.
        written = text[: max(0, MAX_BAG_TEXT_CHARACTERS - self.tell())]
        self._dropped_characters += len(text) - len(written)
        super().write(written)
        return len(text)

    def getvalue(self) -> str:
        """Return the stored text, with the number of characters that were dropped."""
        truncation_note = (
            f"\n... and {self._dropped_characters} more characters\n" if self._dropped_characters else ""
        )
        return super().getvalue() + truncation_note


@contextmanager
def warnings_on_stderr() -> Iterator[None]:
    """Print the warnings of the package to standard error in a block of a command without a reporter."""
    StderrReporter().attach()
    try:
        yield
    finally:
        detach_reporters()
