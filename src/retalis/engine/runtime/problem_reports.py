"""Reports of problems while events are processed: logged, counted, and limited in rate."""

import logging
import traceback
from typing import Callable, Dict, Optional, Set

from ...foundation.displayed_text import MAX_SHOWN_CHARACTERS, printable, shorten
from ...foundation.errors import MAX_MESSAGE_CHARACTERS, RecurringWarning, RetalisError

log = logging.getLogger("retalis")

COUNTED_ATTRIBUTE = "counted"
"""Attribute of log records whose problems `Reports` has counted."""

_MAX_PROBLEMS = 1000
_MAX_KEPT_PROBLEMS = _MAX_PROBLEMS // 2
"""Maximum number of problems, counted by their sources, that are kept when the table is full."""


class Reports:
    """A log of problems. A recurring problem is logged at its 1st, 2nd, 4th, 8th, ... occurrence.

    >>> reports = Reports()
    >>> engine = Engine(reports=reports)
    >>> engine.load(rules="alarm <- heat(T) where T > 40.")
    >>> engine.event("heat(much)", 1)
    >>> reports.errors, reports.warnings
    (1, 0)

    Args:
        once: whether only first occurrences are logged; for batch runs, which call `sum_up` at the end.

    Attributes:
        errors: number of errors, logged or not.
        warnings: number of warnings, logged or not.
        once: see above.
    """

    def __init__(self, once: bool = False) -> None:
        self.errors = 0
        self.warnings = 0
        self.once = once
        self._problems: Dict[bytes, _RecurringProblem] = {}
        """Problems by the digest of their kind, because kinds may be large objects."""
        self._evicted_count = 0
        """Number of unlogged occurrences of problems that were evicted from the table."""

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
        if isinstance(problem, RecurringWarning):
            self._log_recurring(problem)
            return
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
            self._update_count(problem)
            if problem.count > problem.logged_count:
                problem.logged_count = problem.count
                log.log(
                    problem.level,
                    "%d times in all: %s",
                    problem.count,
                    problem.first_line,
                    extra={COUNTED_ATTRIBUTE: True},
                )
        if self._evicted_count:
            log.warning(
                "%d more problems were not shown", self._evicted_count, extra={COUNTED_ATTRIBUTE: True}
            )
            self._evicted_count = 0

    def _log_recurring(self, warning: RecurringWarning) -> None:
        """Log a warning whose source counts the occurrences and has decided to show this one."""
        text = printable(str(warning))
        problem = self._find_problem(_digest(warning.category), logging.WARNING, text)
        problem.count_occurrences = warning.count_occurrences
        self._update_count(problem)
        if self.once and problem.logged_count:
            return
        problem.logged_count = problem.count
        log.warning("%s", text, extra={COUNTED_ATTRIBUTE: True})

    def _update_count(self, problem: "_RecurringProblem") -> None:
        """Read the number of occurrences from the source that counts them."""
        if problem.count_occurrences is not None:
            count = problem.count_occurrences()
            # The count of a rule that was loaded again starts at 0.
            self.warnings += max(0, count - problem.count)
            problem.count = count

    def _log(self, level: int, kind: object, text: str, max_texts: int = 1, first_only: bool = False) -> None:
        """Count a problem, and log it at its 1st, 2nd, 4th, ... occurrence, or if its text is new."""
        key = _digest(kind)
        text = printable(shorten(text, MAX_MESSAGE_CHARACTERS))
        problem = self._find_problem(key, level, text)
        problem.count = count = problem.count + 1
        is_new = len(problem.text_hashes) < max_texts and hash(text) not in problem.text_hashes
        if is_new:
            problem.text_hashes.add(hash(text))
        # Counts other than 1, 2, 4, 8, ... have more than one bit.
        elif count & (count - 1) or first_only or self.once:
            return
        problem.logged_count = count
        logged_text = text if is_new else f"{text}\n({count} times so far)"
        log.log(level, "%s", logged_text, extra={COUNTED_ATTRIBUTE: True})

    def _find_problem(self, key: bytes, level: int, text: str) -> "_RecurringProblem":
        """Return the problem with a key, possibly a new one."""
        problem = self._problems.get(key)
        if problem is None:
            if len(self._problems) >= _MAX_PROBLEMS:
                self._evict()
            problem = self._problems[key] = _RecurringProblem(
                level, text[:MAX_SHOWN_CHARACTERS].split("\n", 1)[0]
            )
        return problem

    def _evict(self) -> None:
        """Remove the problems from the full table, and count their unlogged occurrences.

        The whole table is cleared: evicting single entries would need their order, for a case that only a program
        with more than `_MAX_PROBLEMS` kinds of problems reaches. Problems that their sources count are kept, the
        newest `_MAX_KEPT_PROBLEMS` of them. Otherwise `_update_count` would add all their occurrences again.
        """
        problems = list(self._problems.items())
        kept = dict(
            [(key, problem) for key, problem in problems if problem.count_occurrences is not None][
                -_MAX_KEPT_PROBLEMS:
            ]
        )
        for key, problem in problems:
            if key not in kept:
                self._update_count(problem)
                self._evicted_count += problem.count - problem.logged_count
        self._problems = kept


def _digest(kind: object) -> bytes:
    """Return a key of fixed size for a kind of problems.

    A hash could be the same for different kinds: those of -1 and -2 are equal.
    """
    from hashlib import blake2b  # noqa: PLC0415 - most engines have no problems

    return blake2b(repr(kind).encode("utf-8", "surrogatepass"), digest_size=16).digest()


class _RecurringProblem:
    """Recurring problem: its count, the count at the last log entry, its first line, and hashes of logged texts.

    Attributes:
        count_occurrences: returns the count if the source of the problem counts it; else None.
    """

    __slots__ = ("first_line", "level", "text_hashes", "count", "logged_count", "count_occurrences")

    def __init__(self, level: int, first_line: str):
        self.level = level
        self.first_line = first_line
        self.count = 0
        self.logged_count = 0
        self.text_hashes: Set[int] = set()
        self.count_occurrences: Optional[Callable[[], int]] = None
