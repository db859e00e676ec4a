"""Check of a program: errors and likely mistakes, found by loading it into an engine that receives no events."""

import os
import time
from pathlib import Path
from typing import Collection, Dict, Iterable, Iterator, List, Optional, Tuple

from ..events.checks.check_runner import (
    ERROR,
    WARNING,
    Finding,
    Suppressions,
    code_of_load_problem,
    run_checks,
)
from ..events.checks.event_flow_checks import EventProducers, explain_missing_producer
from ..events.checks.message_checks import find_output_fault
from ..events.checks.program_model import FunctorSuggestions, ProgramModel, RecordedTopic
from ..events.clock.clock import Clock
from ..events.language.called_predicates import PredicateCall, is_defined
from ..events.program.topic_configuration import (
    AUTO,
    TOPICS,
    DirectTopics,
    Topics,
    TopicType,
    direct_topics,
    find_program_folder,
    find_topics,
    read_topics,
)
from ..foundation.errors import (
    MessageError,
    Omission,
    ProgramErrors,
    RetalisError,
    RuleError,
    UndefinedPredicate,
    UnknownMessage,
)
from ..foundation.ros_name_checks import strip_slashes
from ..foundation.source_places import Place
from ..messages.type_registry import Definitions
from ..prolog.system.prolog_system import PrologSystem
from ..prolog.terms.types import CompoundTerm, Functor, Term
from .engine import Engine
from .engine_settings import Settings
from .ros_param_predicate import no_parameters
from .runtime.problem_reports import Reports

_CODES_OF_NAMES = ("RT1201", "RT1402", "RT1405", "RT1406")
"""Codes of the checks of single names, variables, and events without a producer. At the place of a problem of
loading, they describe the same mistake in another way; other checks describe another one."""


class FindingCollector(Reports):
    """Reports that collect problems as findings."""

    def __init__(self) -> None:
        super().__init__()
        self.findings: List[Finding] = []
        self._suppressions = Suppressions()

    def error(self, error: Exception, kind: object = None) -> None:
        """Collect an error."""
        self.errors += 1
        self._add_finding(ERROR, error)

    def warning(self, problem: object, kind: object = None, texts: int = 1, once: bool = False) -> None:
        """Collect a warning."""
        self.warnings += 1
        # A clause that is omitted makes the loaded program differ from the file, which is an error for a check.
        self._add_finding(ERROR if isinstance(problem, Omission) else WARNING, problem)

    def _add_finding(self, severity: str, problem: object) -> None:
        error = problem if isinstance(problem, RetalisError) else RuleError(str(problem))
        error.code = code_of_load_problem(error)
        if severity == ERROR or not self._suppressions.suppresses(error):
            self.findings.append(Finding(severity, "load", error))

    def drop_consequences(self, is_loaded: bool, has_topics: bool) -> None:
        """Drop findings about names that a file with errors may define.

        Args:
            is_loaded: whether all files were loaded without errors.
            has_topics: whether ``pub_sub.xml`` was read, which names the events of topics.
        """
        dropped = (() if is_loaded else (UndefinedPredicate,)) + (() if has_topics else (UnknownMessage,))
        self.findings = [finding for finding in self.findings if not isinstance(finding.problem, dropped)]

    def drop_defined(self, logic: PrologSystem) -> None:
        """Drop findings about predicates that a later file has defined."""

        def is_outdated(problem: RetalisError) -> bool:
            return (
                isinstance(problem, UndefinedPredicate)
                and isinstance(problem.call, PredicateCall)
                and is_defined(logic, problem.call)
            )

        self.findings = [finding for finding in self.findings if not is_outdated(finding.problem)]

    def add_errors(self, error: RetalisError) -> None:
        """Collect all errors of a program."""
        for single_error in error.errors if isinstance(error, ProgramErrors) else [error]:
            self._add_finding(ERROR, single_error)


def check_program(
    folder: Path,
    definitions: Definitions,
    direct: DirectTopics = AUTO,
    settings: Optional[Settings] = None,
    recorded_topics: Tuple[RecordedTopic, ...] = (),
) -> List[Finding]:
    """Return the errors and likely mistakes of a program, grouped by file, and in each file by position.

    The goals of the program are called, as a node calls them at its start.

    Args:
        folder: folder of the program, or a single event file, whose events may have other sources and listeners. The
            form of strings is that of the program in the nearest folder.
        definitions: known message types.
        direct: value of ``~direct``: topics whose messages become events, in addition to those of ``pub_sub.xml``.
        settings: settings of the engine.
        recorded_topics: topics of bags that the program is to run with.
    """
    collector = FindingCollector()
    topics = Topics()
    is_single_file = os.path.isfile(folder)
    has_topics = True
    try:
        topics = read_topics(folder / TOPICS) if os.path.isdir(folder) else topics
    except RetalisError as error:
        collector.add_errors(error)
        has_topics = False
    if is_single_file:
        settings = _with_strings_of_program(folder, settings or Settings())
    # The computer's clock, as in a node, so that goals which need the time succeed.
    engine = Engine(Clock(time.time_ns), settings, collector, definitions)
    engine.program.logic.discard_output()
    direct_types = direct_topics(direct, topics, strip_slashes)
    # Requested topics are recorded by the engine, which subscribes to none of them.
    engine.on_topic_request(lambda topic: None, topics, direct_types)
    engine.on_service_call(lambda call: None)
    engine.on_parameter_read(no_parameters)
    try:
        engine.load_program(folder)
    except RetalisError as error:
        collector.add_errors(error)
    collector.drop_defined(engine.program.logic)
    topics = engine.with_requested_topics(topics)
    program = ProgramModel(
        engine.program.rules,
        engine.program.knowledge,
        definitions.with_strings(engine.strings),
        topics,
        direct_types,
        folder,
        has_observer=is_single_file,
        recorded_topics=recorded_topics,
    )
    # After an error a part of the program is missing, and checks of the whole program would report its absence.
    is_loaded = not any(finding.severity == ERROR for finding in collector.findings)
    collector.drop_consequences(is_loaded, has_topics)
    reported_places = {finding.problem.place for finding in collector.findings if finding.problem.place}
    new_findings = [
        finding
        for finding in run_checks(program, is_loaded)
        if finding.problem.code not in _CODES_OF_NAMES or finding.problem.place not in reported_places
    ]
    return _sort_findings([*collector.findings, *new_findings])


def _with_strings_of_program(path: Path, settings: Settings) -> Settings:
    """Return the settings with the form of strings of the program that a file belongs to, if there is one."""
    folder = find_program_folder(path)
    topics = None if folder is None else find_topics(folder)
    return settings if topics is None else settings._replace(strings=topics.strings)


def explain_missing_events(
    engine: Engine, pattern: Term, definitions: Definitions, topics: Topics, direct: Iterable[TopicType]
) -> str:
    """Return the reason why events of a pattern will not occur, or "" if they may occur.

    Messages of topics that are subscribed to later are not known.
    """
    topics = engine.with_requested_topics(topics)
    definitions = definitions.with_strings(engine.strings)
    program = ProgramModel(engine.program.rules, engine.program.knowledge, definitions, topics, tuple(direct))
    return explain_missing_producer(program, pattern)


def find_absent_events(engine: Engine, occurred: Collection[Functor]) -> Iterator[RuleError]:
    """Yield the awaited events that did not occur in a stream, if it had an event with a similar name."""
    program = ProgramModel(engine.program.rules, engine.program.knowledge, Definitions(), Topics())
    producers = EventProducers(program)
    awaited = {subterm.key: subterm for subterm, _ in program.patterns() if subterm.key is not None}
    # An event that the program awaits or emits is not a misspelt one.
    others = [key for key in occurred if key not in awaited and key not in producers.places_by_functor]
    suggestions = FunctorSuggestions()
    suppressions = Suppressions()
    for key, subterm in awaited.items():
        suggestion = "" if key in occurred or key in producers else suggestions.suggest(key, others)
        if suggestion:
            error = RuleError(f"no event {key} occurred; did you mean {suggestion}?", subterm.place)
            error.code = "RT1201"
            if not suppressions.suppresses(error):
                yield error


def explain_output_mismatch(
    subscription: CompoundTerm, topic: str, type_name: str, definitions: Definitions
) -> str:
    """Return the reason why no output of a subscription matches the message type of its topic.

    Return "" if an output may match, or if the type is unknown.

    Args:
        subscription: the goal ``subscribe/5``.
        topic: name of the topic, for the message.
        type_name: message type of the topic.
        definitions: known message types.
    """
    try:
        definition = definitions.find(type_name)
    except MessageError:
        return ""
    return find_output_fault(definition, subscription, topic) or ""


def _sort_findings(findings: List[Finding]) -> List[Finding]:
    """Sort findings by file, in the order in which the files first occur, then by line and column."""
    file_positions: Dict[Optional[str], int] = {}
    for finding in findings:
        file_positions.setdefault(_normalize_source(finding.problem.place), len(file_positions))

    def make_sort_key(finding: Finding) -> Tuple[int, int, int]:
        place = finding.problem.place
        line, column = (0, 0) if place is None else (place.line, place.column)
        return file_positions[_normalize_source(place)], line, column

    return sorted(findings, key=make_sort_key)


def _normalize_source(place: Optional[Place]) -> Optional[str]:
    return None if place is None else os.path.normpath(place.source)
