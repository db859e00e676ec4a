"""Reporting on standard error: errors and warnings with a count, and a progress bar on terminals."""

import io
import logging
import os
import sys
import time
from contextlib import contextmanager
from typing import IO, Callable, Iterator, Optional

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


UPDATE_INTERVAL_SECONDS = 0.1
"""Minimum time in seconds between two updates of the bar."""

LOG_INTERVAL_SECONDS = 60.0
"""Time in seconds between two lines of progress in a log."""

BAR_WIDTH = 30
"""Width of the bar in characters, without text."""

_CLEAR_LINE = "\r\033[K"


class ProgressBar:
    """Progress in one line: completed fraction, count, rate and remaining time.

    On a terminal, the line is drawn again and again, with a bar. In a log, it is printed once a minute.

    Args:
        fraction: returns the completed fraction, from 0 to 1.
        file: terminal or log.
        clock: clock in seconds.
        is_log: whether the file is a log.

    Attributes:
        state: further text at the end of the line.
    """

    def __init__(
        self,
        item_name: str,
        fraction: Callable[[], float],
        file: IO[str],
        clock: Callable[[], float] = time.monotonic,
        is_log: bool = False,
    ):
        self._item_name = item_name
        self._fraction = fraction
        self._file = file
        self._clock = clock
        self._is_log = is_log
        self._interval_seconds = LOG_INTERVAL_SECONDS if is_log else UPDATE_INTERVAL_SECONDS
        self._start_time = self._last_draw_time = clock()
        self.state = ""

    def __call__(self, completed_count: int) -> None:
        """Show the number of completed items, unless the interval since the last line has not passed."""
        now = self._clock()
        if now - self._last_draw_time >= self._interval_seconds:
            self._last_draw_time = now
            line = self.format_line(completed_count, now - self._start_time)
            self._file.write(f"{line.lstrip()}\n" if self._is_log else _CLEAR_LINE + line)
            self._file.flush()

    def format_line(self, completed_count: int, seconds: float) -> str:
        """Return the line to show after some seconds."""
        fraction = min(1.0, max(0.0, self._fraction()))
        filled = round(fraction * BAR_WIDTH)
        remaining = f", {_format_duration(seconds * (1 - fraction) / fraction)} left" if fraction else ""
        rate = _format_rate(completed_count / seconds) if seconds else "-/s"
        bar = "" if self._is_log else f" [{'#' * filled}{'.' * (BAR_WIDTH - filled)}]"
        # The lines of a log differ also while one item takes long.
        elapsed = f" in {_format_duration(seconds)}" if self._is_log else ""
        state = f"; {self.state}" if self.state else ""
        return (
            f"{fraction:4.0%}{bar} {completed_count:,} {self._item_name}{elapsed}, {rate}{remaining}{state}"
        )

    def clear(self) -> None:
        """Erase the bar, so that other text may be printed; the next update draws it again."""
        if not self._is_log:
            self._file.write(_CLEAR_LINE)
            self._file.flush()


@contextmanager
def show_progress(item_name: str, fraction: Callable[[], float]) -> Iterator[Optional[ProgressBar]]:
    """Yield a progress bar; None if standard error is not a terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    with show_long_progress(item_name, fraction) as bar:
        yield bar


@contextmanager
def show_long_progress(item_name: str, fraction: Callable[[], float]) -> Iterator[ProgressBar]:
    """Yield a progress bar, which prints a line once a minute if standard error is not a terminal."""
    bar = ProgressBar(item_name, fraction, sys.stderr, is_log=not sys.stderr.isatty())
    try:
        yield bar
    finally:
        bar.clear()


def _format_rate(rate: float) -> str:
    if 0 < rate < 0.1:
        return f"{rate * 60:.1f}/min"
    return f"{rate:,.0f}/s" if rate >= 10 or not rate else f"{rate:.1f}/s"


def _format_duration(seconds: float) -> str:
    minutes, seconds_left = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{seconds_left:02}" if hours else f"{minutes}:{seconds_left:02}"
