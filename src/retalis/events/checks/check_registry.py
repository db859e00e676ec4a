"""Registry of the static checks: name, code, severity, and whether a check requires an error-free program.

`run_checks` runs all checks on a `ProgramModel` and yields each finding once. Comments suppress findings:
``% retalis: ignore=RT1203`` those of the line in which it stands, ``% retalis: ignore-file=RT1203`` those of its
file. Errors cannot be suppressed.
"""

import os
import re
from pathlib import Path
from typing import Callable, Dict, Iterator, NamedTuple, Optional, Set, Tuple, Type

from ...foundation.errors import (
    Omission,
    Place,
    RetalisError,
    RuleError,
    SyntaxFault,
    UsageError,
)
from ..program.topic_configuration import read_text
from .event_flow_checks import never_made, never_taken, unfitting
from .memory_checks import stale_tables, unknown_memories, wrong_records
from .message_checks import outputs, topics, unpublished, values, wrong_messages
from .predicate_checks import (
    labels,
    redefined,
    retracted,
    singletons,
    slipped_arrows,
    undefined,
    unknown_states,
    unread_rules,
)
from .program_model import MAX_SOURCE_CHARACTERS, ProgramModel
from .time_checks import cycles, missed_pairs, never_meet, timers, unbounded_keys, waits_for_ever, windows
from .value_type_checks import kinds, numerals

ERROR, WARNING, INFO = "error", "warning", "info"


class Check(NamedTuple):
    """Static check.

    Attributes:
        name: identifier in the output of the command, for programs.
        code: stable code of its findings, shown with each of them.
        find: yields the problems.
        whole: whether the check is valid only for a program that was loaded without errors.
        severity: `WARNING`, or `INFO` for constructs that are often intended; nodes log only warnings.
    """

    name: str
    code: str
    find: Callable[[ProgramModel], Iterator[RuleError]]
    whole: bool = False
    severity: str = WARNING


CHECKS: Tuple[Check, ...] = (
    Check("topics", "RT1101", topics),
    Check("unread-rules", "RT1401", unread_rules, whole=True),
    Check("messages", "RT1104", wrong_messages),
    Check("declared", "RT1108", unfitting, whole=True),
    Check("values", "RT1105", values),
    Check("kinds", "RT1106", kinds),
    Check("numerals", "RT1107", numerals),
    Check("outputs", "RT1103", outputs),
    Check("unpublished", "RT1102", unpublished, whole=True),
    Check("never-made", "RT1201", never_made, whole=True),
    Check("never-taken", "RT1202", never_taken, whole=True),
    Check("memories", "RT1301", unknown_memories, whole=True),
    Check("records", "RT1302", wrong_records, whole=True),
    Check("slipped-arrow", "RT1405", slipped_arrows),
    Check("undefined", "RT1402", undefined, whole=True),
    Check("redefined", "RT1403", redefined, whole=True),
    Check("retracted", "RT1404", retracted, whole=True),
    Check("stale-tables", "RT1304", stale_tables, whole=True),
    Check("cycle", "RT1203", cycles),
    Check("never-meets", "RT1204", never_meet, whole=True),
    Check("window", "RT1205", windows),
    Check("waits-for-ever", "RT1206", waits_for_ever),
    Check("unbounded-keys", "RT1207", unbounded_keys, severity=INFO),
    Check("missed-pairs", "RT1208", missed_pairs, whole=True, severity=INFO),
    Check("timers", "RT1209", timers, whole=True),
    Check("states", "RT1303", unknown_states, whole=True),
    Check("label", "RT1210", labels),
    Check("singleton", "RT1406", singletons),
)


LOAD_CODES: Tuple[Tuple[Type[RetalisError], str], ...] = (
    (SyntaxFault, "RT1001"),
    (Omission, "RT1002"),
    (RuleError, "RT1003"),
    (RetalisError, "RT1000"),
)
"""Codes of errors and warnings of loading; the first matching class decides."""

_IGNORE = re.compile(r"%\s*retalis:\s*ignore(-file)?=\s*(RT\d{4}(?:\s*,\s*RT\d{4})*)")


class Suppressions:
    """Comments in the files of a program that suppress findings."""

    def __init__(self) -> None:
        self._codes_by_file: Dict[str, Set[str]] = {}

    def suppresses(self, problem: RetalisError) -> bool:
        """Return whether a comment in the line or file of a problem contains its code."""
        place = problem.place
        if place is None or place.source is None:
            return False
        return problem.code in _ignored_codes(place.text, "") or problem.code in self._file_codes(
            place.source
        )

    def _file_codes(self, source: str) -> Set[str]:
        """Return the codes that are suppressed in a whole file; none if the source is not a file."""
        codes = self._codes_by_file.get(source)
        if codes is None:
            try:
                content = read_text(Path(source)) if os.path.isfile(source) else ""
            except UsageError:  # reported when the file was loaded
                content = ""
            codes = _ignored_codes(content[:MAX_SOURCE_CHARACTERS], "-file")
            self._codes_by_file[source] = codes
        return codes


def _ignored_codes(text: str, scope: str) -> Set[str]:
    """Return the codes in the comments of a text that have a scope, "" for the line or "-file" for the file."""
    return {
        code.strip()
        for comment_scope, codes in _IGNORE.findall(text)
        if comment_scope == scope
        for code in codes.split(",")
    }


def load_code(error: RetalisError) -> str:
    """Return the code of an error or warning of loading."""
    return next(code for error_class, code in LOAD_CODES if isinstance(error, error_class))


class Finding(NamedTuple):
    """Error or likely mistake in a program.

    Attributes:
        severity: `ERROR`, `WARNING` or `INFO`.
        check: name of the check, or ``load``.
        problem: message and place.
    """

    severity: str
    check: str
    problem: RetalisError


def run_checks(program: ProgramModel, sound: bool = True) -> Iterator[Finding]:
    """Yield the findings of all checks, without duplicates.

    Args:
        program: the program.
        sound: whether it was loaded without errors.
    """
    reported: Set[Tuple[str, Optional[Place]]] = set()
    suppressions = Suppressions()
    for check in CHECKS:
        # In a program with errors, definitions may be missing because they could not be loaded: reporting their uses
        # as well would hide the cause.
        if check.whole and not sound:
            continue
        for problem in check.find(program):
            key = (problem.message, problem.place)
            problem.code = check.code
            if key not in reported and not suppressions.suppresses(problem):
                reported.add(key)
                yield Finding(check.severity, check.name, problem)
