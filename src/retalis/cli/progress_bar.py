"""Progress bar of commands on standard error: on terminals a line that is drawn again, in logs a line each minute."""

import sys
import time
from contextlib import contextmanager
from typing import IO, Callable, Iterator, Optional

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
