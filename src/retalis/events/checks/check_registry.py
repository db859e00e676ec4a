"""Registry of the static checks: name, severity, and whether a check requires an error-free program.

`look_through` runs all checks on a `ProgramModel` and yields each finding once.
"""

from typing import Callable, Iterator, NamedTuple, Optional, Set, Tuple

from ...foundation.errors import Place, RetalisError, RuleError
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
from .producer_checks import never_made, never_taken, unfitting
from .program_model import ProgramModel
from .time_checks import cycles, missed_pairs, never_meet, timers, unbounded_keys, waits_for_ever, windows
from .value_type_checks import kinds, numerals

ERROR, WARNING, INFO = "error", "warning", "info"


class Check(NamedTuple):
    """Static check.

    Attributes:
        name: identifier in the output of the command, for programs.
        find: yields the problems.
        whole: whether the check is valid only for a program that was loaded without errors.
        severity: `WARNING`, or `INFO` for constructs that are often intended; nodes log only warnings.
    """

    name: str
    find: Callable[[ProgramModel], Iterator[RuleError]]
    whole: bool = False
    severity: str = WARNING


CHECKS: Tuple[Check, ...] = (
    Check("topics", topics),
    Check("unread-rules", unread_rules, whole=True),
    Check("messages", wrong_messages),
    Check("declared", unfitting, whole=True),
    Check("values", values),
    Check("kinds", kinds),
    Check("numerals", numerals),
    Check("outputs", outputs),
    Check("unpublished", unpublished, whole=True),
    Check("never-made", never_made, whole=True),
    Check("never-taken", never_taken, whole=True),
    Check("memories", unknown_memories, whole=True),
    Check("records", wrong_records, whole=True),
    Check("slipped-arrow", slipped_arrows),
    Check("undefined", undefined, whole=True),
    Check("redefined", redefined, whole=True),
    Check("retracted", retracted, whole=True),
    Check("stale-tables", stale_tables, whole=True),
    Check("cycle", cycles),
    Check("never-meets", never_meet, whole=True),
    Check("window", windows),
    Check("waits-for-ever", waits_for_ever),
    Check("unbounded-keys", unbounded_keys, severity=INFO),
    Check("missed-pairs", missed_pairs, whole=True, severity=INFO),
    Check("timers", timers, whole=True),
    Check("states", unknown_states, whole=True),
    Check("label", labels),
    Check("singleton", singletons),
)


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


def look_through(program: ProgramModel, sound: bool = True) -> Iterator[Finding]:
    """Yield the findings of all checks, without duplicates.

    Args:
        program: the program.
        sound: whether it was loaded without errors.
    """
    reported: Set[Tuple[str, Optional[Place]]] = set()
    for check in CHECKS:
        # In a program with errors, definitions may be missing because they could not be loaded: reporting their uses
        # as well would hide the cause.
        if check.whole and not sound:
            continue
        for problem in check.find(program):
            key = (problem.message, problem.place)
            if key not in reported:
                reported.add(key)
                yield Finding(check.severity, check.name, problem)
