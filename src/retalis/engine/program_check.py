"""A program checked without running it: it is loaded into an engine of its own, and looked through."""

import os
import time
from pathlib import Path
from typing import Dict, Iterable, List, Optional, Tuple

from ..events.checks.check_registry import ERROR, WARNING, Finding, look_through
from ..events.checks.message_checks import output_fault
from ..events.checks.producer_checks import without_maker
from ..events.checks.program_model import ProgramModel
from ..events.program.program_folder import (
    AUTO,
    TOPICS,
    DirectTopics,
    Topics,
    TopicType,
    direct_topics,
    read_topics,
)
from ..foundation.errors import MessageError, Omission, Place, ProgramErrors, RetalisError, RuleError
from ..messages.type_registry import Definitions
from ..prolog.terms.types import CompoundTerm, Term
from .engine import Engine
from .engine_settings import Settings
from .event_input import by_name
from .runtime.clock import Clock
from .runtime.problem_reports import Reports


class Problems(Reports):
    """Keeps what is reported while a program is loaded."""

    def __init__(self) -> None:
        super().__init__()
        self.found: List[Finding] = []

    def error(self, error: Exception, kind: object = None) -> None:
        """Keep an error."""
        self.errors += 1
        self._keep(ERROR, error)

    def warning(self, problem: object, kind: object = None, texts: int = 1, once: bool = False) -> None:
        """Keep a warning."""
        self.warnings += 1
        self._keep(ERROR if isinstance(problem, Omission) else WARNING, problem)

    def _keep(self, severity: str, problem: object) -> None:
        one = problem if isinstance(problem, RetalisError) else RuleError(str(problem))
        self.found.append(Finding(severity, "load", one))

    def all_of(self, error: RetalisError) -> None:
        """Keep all errors of a program."""
        for one in error.errors if isinstance(error, ProgramErrors) else [error]:
            self._keep(ERROR, one)


def check_program(
    folder: Path,
    definitions: Definitions,
    direct: DirectTopics = AUTO,
    settings: Optional[Settings] = None,
) -> List[Finding]:
    """Return all that is wrong with a program, or hardly meant, in the order of its files.

    Its goals are called, as a node calls them when it starts.

    Args:
        folder: the program's; or a file of rules alone, whose events others may make and take.
        definitions: the message types that are known.
        direct: the value of ``~direct``: topics that become events besides those in ``pub_sub.xml``.
        settings: of the engine.
    """
    problems = Problems()
    topics = Topics()
    alone = os.path.isfile(folder)
    try:
        topics = read_topics(folder / TOPICS) if os.path.isdir(folder) else topics
    except RetalisError as error:
        problems.all_of(error)
    engine = Engine(Clock(time.time_ns), settings, problems, definitions)
    parts = engine
    parts.logic.output = parts.logic.error_output = lambda text: None
    own = direct_topics(direct, topics, by_name)
    parts.input_topics.begin(lambda wanted: None, topics, own)
    try:
        engine.load_program(folder)
    except RetalisError as error:
        problems.all_of(error)
    topics = parts.input_topics.joined(topics)
    program = ProgramModel(parts.rules, parts.knowledge, definitions, topics, own, folder, observed=alone)
    sound = not any(one.severity == ERROR for one in problems.found)
    said = {one.problem.place for one in problems.found if one.problem.place is not None}
    new = [one for one in look_through(program, sound) if one.problem.place not in said]
    return _in_order([*problems.found, *new])


def never_comes(
    engine: Engine, pattern: Term, definitions: Definitions, topics: Topics, direct: Iterable[TopicType]
) -> str:
    """Return why events of a pattern will hardly come, "" where they may.

    Messages may come of topics that are subscribed later.
    """
    parts = engine
    topics = parts.input_topics.joined(topics)
    program = ProgramModel(parts.rules, parts.knowledge, definitions, topics, tuple(direct))
    return without_maker(program, pattern)


def never_sent(subscription: CompoundTerm, topic: str, kind: str, definitions: Definitions) -> str:
    """Return why no output of a subscription can be a message of its topic's type.

    Return "" if some may be, or the type is not known.

    Args:
        subscription: the goal ``subscribe/5``.
        topic: is named in the answer.
        kind: the type of the topic.
        definitions: the message types that are known.
    """
    try:
        definition = definitions.find(kind)
    except MessageError:
        return ""
    return output_fault(definition, subscription, topic) or ""


def _in_order(found: List[Finding]) -> List[Finding]:
    """Order findings by file, in the order in which the files came up, and there by line and column."""
    files: Dict[Optional[str], int] = {}
    for one in found:
        files.setdefault(_source(one.problem.place), len(files))

    def where(one: Finding) -> Tuple[int, int, int]:
        place = one.problem.place
        return (
            (files[_source(place)], 0, 0)
            if place is None
            else (files[_source(place)], place.line, place.column)
        )

    return sorted(found, key=where)


def _source(place: Optional[Place]) -> Optional[str]:
    return None if place is None else os.path.normpath(place.source)
