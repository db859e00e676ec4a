"""Errors on standard error, counted.

A progress bar on standard error, where somebody looks.
"""

import logging
import sys
import time
from contextlib import contextmanager
from typing import IO, Callable, Iterator, Optional

from ..foundation.errors import RetalisError, printable

_log = logging.getLogger("retalis")
_shown = logging.getLogger("retalis.events")
"""Has the events that facts of a program want to be shown."""


class NobodyReads(BaseException):
    """Whoever read our output has had enough: what a callback of the engine raises to end the run."""


def to_reader(callback: Callable[..., None]) -> Callable[..., None]:
    """Return a callback of the engine that prints, which ends the run where nobody reads any more."""

    def printing(*arguments: object) -> None:
        try:
            callback(*arguments)
        except BrokenPipeError:
            raise NobodyReads from None

    return printing


class Report(logging.Handler):
    """Prints errors and warnings to standard error and counts the errors.

    Attributes:
        errors: how many errors there were.
    """

    def __init__(self) -> None:
        super().__init__()
        self.errors = 0

    def __call__(self, error: RetalisError) -> None:
        """Report an error."""
        self.errors += 1
        print(f"error: {error}", file=sys.stderr)

    def emit(self, record: logging.LogRecord) -> None:
        """Report what was logged."""
        text = printable(self.format(record))
        if record.name == _shown.name:
            print(text, file=sys.stderr)
            return
        if record.levelno < logging.WARNING:
            return
        if record.levelno >= logging.ERROR:
            self.errors += 1
        print(f"{record.levelname.lower()}: {text}", file=sys.stderr)

    def listen(self, events: bool = False) -> "Report":
        """Report what the package logs from now on, until `leave`; on request also events that a program shows."""
        if events:
            _shown.setLevel(logging.INFO)
        _log.addHandler(self)
        _log.propagate = False
        return self


def leave() -> None:
    """End all reports: what the package logs goes where it went before."""
    for handler in [one for one in _log.handlers if isinstance(one, Report)]:
        _log.removeHandler(handler)
    _shown.setLevel(logging.NOTSET)
    _log.propagate = True


EVERY = 0.1
"""Seconds between two looks of the bar."""

WIDTH = 30
"""Characters of the bar itself."""

_CLEAR = "\r\033[K"


class Bar:
    """A bar that is drawn again and again in one line: share, number, rate and time left.

    Args:
        what: is counted.
        share: says how much of the whole is done, from 0 to 1.
        file: where it is drawn.
        clock: gives seconds.
    """

    def __init__(
        self,
        what: str,
        share: Callable[[], float],
        file: IO[str],
        clock: Callable[[], float] = time.monotonic,
    ):
        self._what = what
        self._share = share
        self._file = file
        self._clock = clock
        self._begun = self._drawn = clock()

    def __call__(self, done: int) -> None:
        """Draw it, if some time has passed, with the number of what is done."""
        now = self._clock()
        if now - self._drawn >= EVERY:
            self._drawn = now
            self._file.write(_CLEAR + self.line(done, now - self._begun))
            self._file.flush()

    def line(self, done: int, seconds: float) -> str:
        """Return what is shown after some seconds."""
        share = min(1.0, max(0.0, self._share()))
        full = round(share * WIDTH)
        left = f", {_duration(seconds * (1 - share) / share)} left" if share else ""
        rate = _rate(done / seconds) if seconds else "-"
        bar = "#" * full + "." * (WIDTH - full)
        return f"{share:4.0%} [{bar}] {done:,} {self._what}, {rate}/s{left}"

    def clear(self) -> None:
        """Take it away, so that something else may be printed; it comes back by itself."""
        self._file.write(_CLEAR)
        self._file.flush()


@contextmanager
def progress(what: str, share: Callable[[], float]) -> Iterator[Optional[Bar]]:
    """Give a bar that is told how much is done; None where standard error is no terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    bar = Bar(what, share, sys.stderr)
    try:
        yield bar
    finally:
        bar.clear()


def _rate(rate: float) -> str:
    return f"{rate:,.0f}" if rate >= 10 or not rate else f"{rate:.1f}"


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"
