"""Problems while events flow: logged, counted, and never a flood."""

import logging
import traceback
from typing import Dict, Set

from ...foundation.errors import MAX_MESSAGE_CHARACTERS, SHOWN, RetalisError, beginning, printable

log = logging.getLogger("retalis")

COUNTED = "counted"
"""Attribute of log records whose problems `Reports` has counted."""

_KINDS = 1000


class Reports:
    """Logs problems; one that comes again and again at the same place is logged at its 1st, 2nd, 4th, 8th ... time.

    >>> reports = Reports()
    >>> engine = Engine(reports=reports)
    >>> engine.load(rules="alarm <- heat(T) where T > 40.")
    >>> engine.event("heat(much)", 1)
    >>> reports.errors, reports.warnings
    (1, 0)

    Attributes:
        errors: how many errors there were, logged or not.
        warnings: the same of warnings.
        once: whether only the 1st is logged; for runs that come to an end, where `sum_up` tells the rest.
    """

    def __init__(self) -> None:
        self.errors = 0
        self.warnings = 0
        self.once = False
        self._kinds: Dict[int, _RecurringProblem] = {}
        """By hash: what told kinds apart may be large, and need not stay."""
        self._others = 0
        """How many were not logged of kinds that had to be forgotten."""

    def error(self, error: Exception, kind: object = None) -> None:
        """Log an error of a program, or of the package itself with its traceback.

        Those of one ``kind`` (its place or message by default) count together.

        >>> reports = Reports()
        >>> reports.error(RuleError("there is no such room"))
        >>> reports.errors
        1
        """
        self.errors += 1
        if isinstance(error, RetalisError):
            self._log(logging.ERROR, kind or error.place or error.message, str(error))
            return
        trace = "".join(traceback.format_exception(type(error), error, error.__traceback__))
        self._log(logging.ERROR, kind or repr(error), f"internal error\n{trace}")

    def warning(self, problem: object, kind: object = None, texts: int = 1, once: bool = False) -> None:
        """Log a warning; those of one ``kind`` (its place or text by default) count together.

        So many ``texts`` of a kind that read differently are logged in any case. Of what is to be said ``once`` the
        first is logged, and `sum_up` tells the rest.

        >>> reports = Reports()
        >>> reports.warning("the battery is low")
        >>> reports.warnings
        1
        """
        self.warnings += 1
        key = kind or getattr(problem, "place", None) or str(problem)
        self._log(logging.WARNING, key, str(problem), texts, once)

    def sum_up(self) -> None:
        """Say of all that came more often than was logged how often it came.

        >>> reports = Reports()
        >>> for _ in range(3):
        ...     reports.warning("the battery is low")
        >>> reports.sum_up()
        """
        for kind in list(self._kinds.values()):
            if kind.times > kind.told:
                kind.told = kind.times
                log.log(kind.level, "%d times in all: %s", kind.times, kind.first, extra={COUNTED: True})
        if self._others:
            log.warning("%d more problems were not shown", self._others, extra={COUNTED: True})
            self._others = 0

    def _log(self, level: int, key: object, text: str, texts: int = 1, once: bool = False) -> None:
        key = hash(key)
        text = printable(beginning(text, MAX_MESSAGE_CHARACTERS))
        kind = self._kinds.get(key)
        if kind is None:
            if len(self._kinds) >= _KINDS:
                self._others += sum(known.times - known.told for known in list(self._kinds.values()))
                self._kinds.clear()
            kind = self._kinds[key] = _RecurringProblem(level, text[:SHOWN].split("\n", 1)[0])
        kind.times = times = kind.times + 1
        is_new = len(kind.texts) < texts and hash(text) not in kind.texts
        if is_new:
            kind.texts.add(hash(text))
        elif times & (times - 1) or once or self.once:
            return
        kind.told = times
        shown = text if is_new else f"{text}\n({times} times so far)"
        log.log(level, "%s", shown, extra={COUNTED: True})


class _RecurringProblem:
    """What came again and again: how often, how much of that was told, and the first line of the first one."""

    __slots__ = ("first", "level", "texts", "times", "told")

    def __init__(self, level: int, first: str):
        self.level = level
        self.first = first
        self.times = 0
        self.told = 0
        self.texts: Set[int] = set()
