"""Registry of the static checks: name, code, severity, and whether a check requires an error-free program.

`run_checks` runs all checks on a `ProgramModel` and yields each finding once. Comments suppress findings:
``% retalis: ignore=RT1203`` those of its line, ``% retalis: ignore-file=RT1203`` those of its
file. Errors cannot be suppressed.
"""

import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Callable, Dict, Iterator, NamedTuple, Optional, Set, Tuple, Type

from ...foundation.errors import Omission, RetalisError, RuleError, SyntaxFault, UsageError
from ..program.topic_configuration import read_text
from .condition_checks import find_impossible_conditions
from .event_cycle_checks import find_cycles
from .event_flow_checks import find_declaration_violations, find_unconsumed_events, find_unproduced_events
from .interval_event_window_checks import find_windows_of_long_events
from .memory_and_state_checks import (
    find_empty_memories,
    find_record_mismatches,
    find_undeclared_states,
    find_unknown_memories,
)
from .message_checks import (
    find_awaited_constants,
    find_called_services,
    find_impossible_values,
    find_message_mismatches,
    find_output_mismatches,
    find_refused_services,
    find_request_mismatches,
    find_shared_events,
    find_topic_mistakes,
    find_untyped_topics,
)
from .missed_match_checks import find_conditions_after_throttle, find_missed_pairs, find_throttles_without_key
from .number_type_checks import find_inexact_decimals, find_number_type_mismatches
from .predicate_checks import (
    find_duplicate_labels,
    find_missing_first_clauses,
    find_never_asserted,
    find_operators_in_clauses,
    find_redefined_builtins,
    find_undefined_predicates,
    find_unloaded_rule_file,
)
from .program_model import MAX_SOURCE_CHARACTERS, ProgramModel
from .stale_table_checks import find_stale_tables
from .time_checks import (
    find_impossible_pairs,
    find_invalid_timers,
    find_likely_milliseconds,
    find_unlikely_spans,
    find_unreachable_limits,
)
from .unbounded_state_checks import find_unbounded_keys, find_unbounded_waits
from .value_flow import find_conflicting_flows, find_impossible_flows
from .variable_name_checks import find_constants_meant_as_variables, find_singletons
from .variable_type_checks import find_type_conflicts

if TYPE_CHECKING:
    from ...foundation.source_places import Place

ERROR, WARNING, INFO = "error", "warning", "info"


class Check(NamedTuple):
    """Static check.

    Attributes:
        name: identifier in the output of the command, for programs.
        code: stable code of its findings, shown with each of them.
        find: yields the problems.
        requires_valid_program: whether the check is valid only for a program that was loaded without errors.
        severity: `WARNING`, or `INFO` for constructs that are often intended; nodes log only warnings.
    """

    name: str
    code: str
    find: Callable[[ProgramModel], Iterator[RuleError]]
    requires_valid_program: bool = False
    severity: str = WARNING


CHECKS: Tuple[Check, ...] = (
    Check("topics", "RT1101", find_topic_mistakes),
    Check("unread-rules", "RT1401", find_unloaded_rule_file, requires_valid_program=True),
    Check("messages", "RT1104", find_message_mismatches),
    Check("declared", "RT1108", find_declaration_violations, requires_valid_program=True),
    Check("values", "RT1105", find_impossible_values),
    Check("kinds", "RT1106", find_type_conflicts),
    Check("values", "RT1105", find_impossible_flows, requires_valid_program=True),
    Check("kinds", "RT1106", find_conflicting_flows, requires_valid_program=True),
    Check("numerals", "RT1107", find_number_type_mismatches),
    Check("decimals", "RT1109", find_inexact_decimals, severity=INFO),
    Check("shared-events", "RT1110", find_shared_events, requires_valid_program=True, severity=INFO),
    Check("awaited-constants", "RT1111", find_awaited_constants, severity=INFO),
    Check("outputs", "RT1103", find_output_mismatches),
    Check("outputs", "RT1103", find_request_mismatches),
    Check("refused-services", "RT1112", find_refused_services),
    Check("called-services", "RT1113", find_called_services, severity=INFO),
    Check("unpublished", "RT1102", find_untyped_topics, requires_valid_program=True),
    Check("never-made", "RT1201", find_unproduced_events, requires_valid_program=True),
    Check("never-taken", "RT1202", find_unconsumed_events, requires_valid_program=True),
    Check("memories", "RT1301", find_unknown_memories, requires_valid_program=True),
    Check("records", "RT1302", find_record_mismatches, requires_valid_program=True),
    Check("records", "RT1302", find_empty_memories, requires_valid_program=True),
    Check("slipped-arrow", "RT1405", find_operators_in_clauses),
    Check("undefined", "RT1402", find_undefined_predicates, requires_valid_program=True),
    Check("redefined", "RT1403", find_redefined_builtins, requires_valid_program=True),
    Check("retracted", "RT1404", find_never_asserted, requires_valid_program=True),
    Check("retracted", "RT1404", find_missing_first_clauses, requires_valid_program=True),
    Check("stale-tables", "RT1304", find_stale_tables, requires_valid_program=True),
    Check("cycle", "RT1203", find_cycles),
    Check("never-meets", "RT1204", find_impossible_pairs, requires_valid_program=True),
    Check("window", "RT1205", find_unlikely_spans),
    Check("waits-for-ever", "RT1206", find_unbounded_waits),
    Check("unbounded-keys", "RT1207", find_unbounded_keys, severity=INFO),
    Check("missed-pairs", "RT1208", find_missed_pairs, requires_valid_program=True, severity=INFO),
    Check("timers", "RT1209", find_invalid_timers, requires_valid_program=True),
    Check("states", "RT1303", find_undeclared_states, requires_valid_program=True),
    Check("label", "RT1210", find_duplicate_labels),
    Check("long-elements", "RT1211", find_windows_of_long_events, severity=INFO),
    Check("throttled-first", "RT1212", find_conditions_after_throttle, severity=INFO),
    Check("milliseconds", "RT1213", find_likely_milliseconds, severity=INFO),
    Check("unkeyed", "RT1214", find_throttles_without_key, requires_valid_program=True, severity=INFO),
    Check("unreachable", "RT1215", find_unreachable_limits),
    Check("singleton", "RT1406", find_singletons),
    Check("conditions", "RT1407", find_impossible_conditions),
    Check(
        "constants", "RT1408", find_constants_meant_as_variables, requires_valid_program=True, severity=INFO
    ),
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


def code_of_load_problem(error: RetalisError) -> str:
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


def run_checks(program: ProgramModel, is_valid: bool = True) -> Iterator[Finding]:
    """Yield the findings of all checks, without duplicates."""
    reported: Set[Tuple[str, Optional[Place]]] = set()
    check_of_place: Dict[Tuple[str, Optional[Place]], Check] = {}
    suppressions = Suppressions()
    for check in CHECKS:
        # In a program with errors, definitions may be missing because they could not be loaded: reporting their uses
        # as well would hide the cause.
        if check.requires_valid_program and not is_valid:
            continue
        for problem in check.find(program):
            key = (problem.message, problem.place)
            problem.code = check.code
            # Of the checks with one code, the first one to report a place explains the mistake there.
            first = check_of_place.setdefault((check.code, problem.place), check)
            is_explained = problem.place is not None and first is not check
            if key not in reported and not is_explained and not suppressions.suppresses(problem):
                reported.add(key)
                yield Finding(check.severity, check.name, problem)
