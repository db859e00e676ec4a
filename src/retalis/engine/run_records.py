"""Records of a run: the lines that ``bag --events --json`` writes and ``plot --from`` reads.

The name of the first field is the type of the record. Times are nanoseconds since the epoch, terms are texts. Writers
and readers use these types, so that mypy finds a name that they do not share.
"""

from typing import Dict, Iterator, List, Optional, TypedDict, Union

from ..events.language.stream_parser import window_term
from ..prolog.syntax.term_writer import canonical_text
from ..prolog.terms import timestamps
from .loaded_items import LoadedProgram


class EventRecord(TypedDict):
    """An event, with the start and the end of its interval."""

    event: str
    start: int
    end: int


class WaitRecord(TypedDict):
    """The wait of a query: the event that it triggers, and the ids of the memories that it waits for."""

    wait: str
    memories: List[str]
    start: int
    end: int


class MemoryStateRecord(TypedDict):
    """A memory at the end of a run.

    Attributes:
        memory: id of the memory.
        pattern: pattern of the events to store.
        size: maximum number of records.
        records: number of records.
        taken: number of records ever stored.
        start: end of the oldest record; None if the memory is empty.
        end: end of the newest event that was stored; None if there was none.
    """

    memory: str
    pattern: str
    size: int
    records: int
    taken: int
    start: Optional[int]
    end: Optional[int]


class OpenStateRecord(TypedDict):
    """A declared state that is open at the end of a run, and its start."""

    open: str
    start: int


class OpenWindowRecord(TypedDict):
    """A window that has elements and has not ended at the end of a run.

    Attributes:
        open_window: the window, as ``every(10)``.
        rule: head of the rule, or its name if it has none.
        name: name of the rule.
        key: values of the key by the variables of the rule.
        elements: number of elements.
        start: start of the window, or of its elements.
        end: end of the window; None if its number of elements ends it.
    """

    open_window: str
    rule: str
    name: str
    key: Dict[str, str]
    elements: int
    start: int
    end: Optional[int]


class OutputRecord(TypedDict):
    """An output, with its topic and the id of its subscription; the id is None if the output has none."""

    output: str
    topic: str
    id: Optional[str]
    time: int


class IncompleteFileRecord(TypedDict):
    """A file of a bag that a crash has cut; see `IncompleteFile`."""

    incomplete: str
    problem: str
    messages: int
    position: Optional[int]
    unread_bytes: int
    missing_bytes: int
    lost_messages: Optional[int]
    end: int


OpenRecord = Union[OpenStateRecord, OpenWindowRecord]
RunRecord = Union[EventRecord, WaitRecord, MemoryStateRecord, OpenRecord, OutputRecord, IncompleteFileRecord]

LATER_FIELDS = frozenset(("name", "lost_messages"))
"""Fields that records of earlier versions lack."""

RECORD_TYPES = {
    "event": EventRecord,
    "wait": WaitRecord,
    "memory": MemoryStateRecord,
    "open": OpenStateRecord,
    "open_window": OpenWindowRecord,
    "output": OutputRecord,
}
"""Type of a record by the name of its first field."""


def open_records(program: LoadedProgram) -> Iterator[OpenRecord]:
    """Yield the declared states that are open, and the windows that have elements and have not ended."""
    for declaration in program.knowledge.states:
        for term, start in declaration.open_states(None):
            yield OpenStateRecord(open=canonical_text(term), start=start)
    show = program.logic.show
    for rule in program.rules.rules:
        definition = rule.definition
        head = (
            f"rule {rule.name}" if definition.head is None else show(definition.head, names=definition.names)
        )
        for pattern, key, window in rule.open_windows():
            yield OpenWindowRecord(
                open_window=show(window_term(pattern.window, timestamps.to_shortest_seconds)),
                rule=head,
                name=rule.name,
                key={name: canonical_text(value) for name, value in key.items()},
                elements=window.element_count,
                start=window.start,
                end=window.end,
            )
