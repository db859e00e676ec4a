"""Errors on standard error, counted."""

import logging
import sys
from typing import Callable

from ..foundation import RetalisError, printable

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
