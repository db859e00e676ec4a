"""Records of a run: the lines that ``bag --events --json`` writes and ``plot --from`` reads.

The name of the first field is the type of the record. Times are nanoseconds since the epoch, terms are texts. Writers
and readers use these types, so that mypy finds a name that they do not share.
"""

from typing import List, Optional, TypedDict, Union


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


class OutputRecord(TypedDict):
    """An output, with its topic and the id of its subscription; the id is None if the output has none."""

    output: str
    topic: str
    id: Optional[str]
    time: int


RunRecord = Union[EventRecord, WaitRecord, MemoryStateRecord, OutputRecord]

RECORD_TYPES = {"event": EventRecord, "wait": WaitRecord, "memory": MemoryStateRecord, "output": OutputRecord}
"""Type of a record by the name of its first field."""
