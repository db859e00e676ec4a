"""A progress bar on standard error, where somebody looks."""

import sys
import time
from contextlib import contextmanager
from typing import IO, Callable, Iterator, Optional

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
