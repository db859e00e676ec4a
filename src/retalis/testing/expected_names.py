"""Names in expectations that a program does not have.

An event or output with a misspelt name never occurs. An expectation that forbids or bounds its occurrences would
therefore hold, and show nothing.
"""

import re
from functools import cached_property
from typing import Dict, Iterable, Iterator, Mapping, Optional, Set

from ..engine.engine import Engine
from ..events.program.topic_configuration import GOALS, TOPICS, Topics, read_topics
from ..foundation.errors import MessageError
from ..foundation.ros_name_checks import strip_slashes
from ..foundation.similar_names import did_you_mean
from ..messages.type_definition import Definition, functor_name
from ..messages.type_registry import Definitions
from ..playback.playback import Playback
from ..prolog.syntax.term_reader import OF_FILES
from ..prolog.syntax.tokenizer import NAME, QUOTED, TEXT, Source, tokenize
from ..prolog.terms.types import Functor
from .case_definition import CaseProgram, ExpectedItem, ExpectedSequence
from .expectation_checks import Failure, RunItem, functor_of
from .message_comparison import SlotComparison

_WORD = re.compile(r"\w+")
"""A word in a name or text of a program. Only names that are words are checked."""


class ProgramNames:
    """Names that a program has after its run. They are collected when an expectation needs them.

    Args:
        program: its files or texts.
        events: events that have occurred.
    """

    def __init__(
        self, playback: Playback, program: CaseProgram, outputs: Iterable[RunItem], events: Iterable[RunItem]
    ):
        self._playback = playback
        self._program = program
        self._outputs = outputs
        self._events = events

    @cached_property
    def topics(self) -> Mapping[str, Optional[Definition]]:
        """Topics of its outputs without slashes at the ends, and their types; None for topics without type."""
        topics: Dict[str, Optional[Definition]] = dict.fromkeys(
            map(strip_slashes, self._playback.engine.output_topics())
        )
        for topic, message_type in self._configuration.published:
            topics[strip_slashes(topic)] = _find_type(self._playback.definitions, message_type)
        topics.update((strip_slashes(output.topic), output.definition) for output in self._outputs)
        return topics

    @cached_property
    def events(self) -> Set[str]:
        """Names of events: the types of its topics, the events that have occurred, and all names in its texts."""
        input_types = (*self._program.topics, *self._configuration.subscribed)
        names = {functor_name(message_type) for _, message_type in input_types}
        names.update(name_of(functor_of(event.term)) for event in self._events)
        for text in _read_texts(self._playback.engine, self._program):
            # A goal may read an event from a text. A comment is no source of events.
            for kind, _, start, end in tokenize(Source("", text), lambda: OF_FILES):
                if kind in (NAME, QUOTED, TEXT):
                    names.update(_WORD.findall(text, start, end))
        return names

    @cached_property
    def _configuration(self) -> Topics:
        folder = self._program.folder
        return Topics() if folder is None else read_topics(folder / TOPICS)


def _find_type(definitions: Definitions, name: str) -> Optional[Definition]:
    try:
        return definitions.find(name)
    except MessageError:
        # It is reported when the program is loaded.
        return None


def _read_texts(engine: Engine, program: CaseProgram) -> Iterator[str]:
    """Yield the texts of a program, also of files that it loads; a file that cannot be read has none."""
    yield from (source.text for source in (program.rules, program.goals) if source is not None)
    yield from (fact.text for fact in program.facts)
    paths = set(engine.program.rules.files.loaded)
    if program.folder is not None:
        paths.add(program.folder / GOALS)
    for path in paths:
        try:
            yield path.read_text(encoding="utf-8", errors="replace")
        except OSError:
            continue


def name_of(functor: Optional[Functor]) -> str:
    """Return the name of a term's functor or atom; "" for other terms."""
    return getattr(functor, "name", "")


def find_unknown_name(
    expected: ExpectedSequence, event_names: Iterable[str], names: ProgramNames
) -> Optional[Failure]:
    """Return the failure of an expectation with a topic or event that the program does not have, or None.

    Args:
        expected: the expectation.
        event_names: names of its items; "" for an item without one, such as a variable.
        names: names of the program.
    """
    for item, event_name in zip(expected.items, event_names):
        problem = _find_unknown_topic(item, names) if expected.subject == "outputs" else ""
        if expected.subject == "events" and event_name.isidentifier() and event_name not in names.events:
            problem = f"the program has no event '{event_name}'{did_you_mean(event_name, names.events)}"
        if problem:
            return Failure(f"{expected.subject}: {problem}", item.place)
    return None


def _find_unknown_topic(item: ExpectedItem, names: ProgramNames) -> str:
    if item.topic is None or strip_slashes(item.topic) in names.topics:
        return ""
    return f"the program has no output on topic '{item.topic}'{did_you_mean(item.topic, names.topics)}"


def check_slot_names(expected: ExpectedSequence, start: int, names: ProgramNames) -> None:
    """Check the slots of expected messages whose type is known.

    Raises:
        CaseFileError: if a type does not have an expected slot, or one with a tolerance.
    """
    for item in expected.items:
        if item.message is None or item.topic is None:
            continue
        definition = names.topics.get(strip_slashes(item.topic))
        if definition is not None:
            comparison = SlotComparison(item.tolerance, item.slot_tolerances, start)
            comparison.check_names(definition, item.message)
            comparison.check_tolerance_paths(definition, item.place)
