"""Problems while events flow: logged, counted, and never a flood."""

import logging
import traceback
from typing import Any, Dict

from .errors import RetalisError

log = logging.getLogger("retalis")

_KINDS = 1000


class Reports:
    """Logs problems; one that comes again and again at the same place is logged at its 1st, 2nd, 4th, 8th ... time.

    Attributes:
        errors: how many errors there were, logged or not.
        warnings: the same of warnings.
    """

    def __init__(self) -> None:
        self.errors = 0
        self.warnings = 0
        self._times: Dict[Any, int] = {}

    def error(self, error: Exception) -> None:
        """Log an error of a program, or of the package itself with its traceback."""
        self.errors += 1
        if isinstance(error, RetalisError):
            self._log(logging.ERROR, error.place or error.message, str(error))
            return
        trace = "".join(traceback.format_exception(type(error), error, error.__traceback__))
        self._log(logging.ERROR, repr(error), f"internal error\n{trace}")

    def warning(self, problem: Any, kind: Any = None) -> None:
        """Log a warning; those of one ``kind`` (its place or text by default) count together."""
        self.warnings += 1
        self._log(logging.WARNING, kind or getattr(problem, "place", None) or str(problem), str(problem))

    def _log(self, level: int, kind: Any, text: str) -> None:
        if len(self._times) >= _KINDS:
            self._times.clear()
        times = self._times[kind] = self._times.get(kind, 0) + 1
        if times == 1:
            log.log(level, "%s", text)
        elif times & (times - 1) == 0:
            log.log(level, "%s\n(%d times so far)", text, times)
