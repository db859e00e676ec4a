"""Reports of problems while events are processed: logged, counted, and limited in rate."""

import logging
import traceback
from typing import Dict, Set

from ...foundation.errors import (
    MAX_MESSAGE_CHARACTERS,
    MAX_SHOWN_CHARACTERS,
    RetalisError,
    beginning,
    printable,
)

log = logging.getLogger("retalis")

COUNTED = "counted"
"""Attribute of log records whose problems `Reports` has counted."""

_MAX_PROBLEMS = 1000


class Reports:
    """A log of problems. A recurring problem is logged at its 1st, 2nd, 4th, 8th, ... occurrence.

    >>> reports = Reports()
    >>> engine = Engine(reports=reports)
    >>> engine.load(rules="alarm <- heat(T) where T > 40.")
    >>> engine.event("heat(much)", 1)
    >>> reports.errors, reports.warnings
    (1, 0)

    Attributes:
        errors: number of errors, logged or not.
        warnings: number of warnings, logged or not.
        once: whether only first occurrences are logged; for runs with an end, where `sum_up` logs the counts.
    """

    def __init__(self) -> None:
        self.errors = 0
        self.warnings = 0
        self.once = False
        self._problems: Dict[int, _RecurringProblem] = {}
        """By hash of the kind, as kinds may be large objects."""
        self._evicted_count = 0
        """Number of problems that were not logged, of kinds that were evicted."""

    def error(self, error: Exception, kind: object = None) -> None:
        """Log an error of a program, or an internal error with its traceback.

        Errors of one ``kind`` (by default the place or the message) are counted together.

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
        """Log a warning. Warnings of one ``kind`` (by default the place or the text) are counted together.

        Up to ``texts`` different texts of a kind are always logged. With ``once`` only the first occurrence is
        logged, and `sum_up` logs the count.

        >>> reports = Reports()
        >>> reports.warning("the battery is low")
        >>> reports.warnings
        1
        """
        self.warnings += 1
        key = kind or getattr(problem, "place", None) or str(problem)
        self._log(logging.WARNING, key, str(problem), texts, once)

    def sum_up(self) -> None:
        """Log the counts of all problems that occurred more often than they were logged.

        >>> reports = Reports()
        >>> for _ in range(3):
        ...     reports.warning("the battery is low")
        >>> reports.sum_up()
        """
        for problem in list(self._problems.values()):
            if problem.count > problem.logged_count:
                problem.logged_count = problem.count
                log.log(
                    problem.level,
                    "%d times in all: %s",
                    problem.count,
                    problem.first_line,
                    extra={COUNTED: True},
                )
        if self._evicted_count:
            log.warning("%d more problems were not shown", self._evicted_count, extra={COUNTED: True})
            self._evicted_count = 0

    def _log(self, level: int, key: object, text: str, texts: int = 1, once: bool = False) -> None:
        key = hash(key)
        text = printable(beginning(text, MAX_MESSAGE_CHARACTERS))
        problem = self._problems.get(key)
        if problem is None:
            if len(self._problems) >= _MAX_PROBLEMS:
                self._evicted_count += sum(
                    evicted.count - evicted.logged_count for evicted in list(self._problems.values())
                )
                self._problems.clear()
            problem = self._problems[key] = _RecurringProblem(
                level, text[:MAX_SHOWN_CHARACTERS].split("\n", 1)[0]
            )
        problem.count = times = problem.count + 1
        is_new = len(problem.texts) < texts and hash(text) not in problem.texts
        if is_new:
            problem.texts.add(hash(text))
        elif times & (times - 1) or once or self.once:
            return
        problem.logged_count = times
        shown = text if is_new else f"{text}\n({times} times so far)"
        log.log(level, "%s", shown, extra={COUNTED: True})


class _RecurringProblem:
    """A recurring problem: its count, the count at the last log entry, and its first line."""

    __slots__ = ("first_line", "level", "texts", "count", "logged_count")

    def __init__(self, level: int, first_line: str):
        self.level = level
        self.first_line = first_line
        self.count = 0
        self.logged_count = 0
        self.texts: Set[int] = set()
