"""One memory instance: the newest N records of a kind of event, in order of their end times."""

from bisect import bisect_left, bisect_right
from itertools import count
from typing import Any, Callable, Dict, Iterator, List, Optional, Tuple

from ...prolog.terms import Term

NEVER = 1 << 100
"""More records than there will be, and later than all instants."""

WIDE = 10
"""By which factor a step between two records is wider than the others for it to be told of."""

_EPOCHS = count()

MemoryRecord = Tuple[Term, int, int]
"""What a memory keeps of an event: the record and the event's interval, start and end as instants."""


class Memory:
    """A bounded history, ordered by end time; records with equal ends stay in order of arrival.

    Adding at the end and every look-up cost the same whatever the size: the records lie in a list of which
    only the last ``size`` count, cut back when it has grown by a quarter of that; look-ups are binary searches.
    Lists are replaced, never shortened or reordered in place, so that a reader who walks an older list is
    not disturbed by what is added meanwhile.

    Attributes:
        size: how many records are kept at most.
        room: how long the lists may become.
        late: how many events were refused because they were older than all records of a full memory.
        ends: the ends of the records, as plain integers, which compare faster than other forms of instants;
            read-only outside of this package.
        records: the records, at the same places.
        indices: where values of an argument stand among the records, by the argument's place; see `matching`.
        changed: how many records there were before the first whose place is another one than it was; `NEVER` where
            all came in order since somebody has set that.
        on_wide: called with the two ends where a look-up falls between records that may be unusually far apart.
    """

    __slots__ = (
        "size",
        "room",
        "late",
        "ends",
        "records",
        "indices",
        "on_wide",
        "changed",
        "_epoch",
        "_gone",
        "_next",
    )

    def __init__(self, size: int):
        self.size = size
        self.room = size + size // 4 + 16
        self.late = 0
        self._gone = 0
        self._epoch = next(_EPOCHS)
        self.changed = NEVER
        self._next: Optional[Tuple[int, List[int], List[MemoryRecord]]] = None
        """What it is becoming, where that takes several steps: an interrupt may come between them."""
        self.ends: List[int] = []
        self.records: List[MemoryRecord] = []
        self.indices: Dict[int, Any] = {}
        self.on_wide: Callable[[int, int], object] = lambda start, end: None

    def clear(self) -> None:
        """Forget all records; the counts stay."""
        self._epoch = next(_EPOCHS)
        self._become(self._gone + len(self.ends), [], [])

    def _become(self, gone: int, ends: List[int], records: List[MemoryRecord]) -> None:
        self._next = gone, ends, records
        self.indices = {}
        self._gone, self.ends, self.records = gone, ends, records
        self._next = None

    @property
    def oldest(self) -> int:
        """How many records were taken before the first that stays: the newest does, whatever the size."""
        return self._gone + max(0, len(self.ends) - max(self.size, 1))

    def since(self, taken: int) -> Tuple[int, List[MemoryRecord]]:
        """Return the records that were taken after so many, and how many came before the first of them."""
        first = max(self.oldest, min(taken, self.added))
        return first, self.records[first - self._gone :]

    def restore(self, gone: int, late: int, ends: List[int], records: List[MemoryRecord]) -> None:
        """Have records as another memory had them."""
        self._epoch = next(_EPOCHS)
        self.late = late
        self._become(gone, ends, records)

    def mend(self) -> None:
        """Put right what an interrupt may have left half done."""
        if self._next is not None:
            self._become(*self._next)
        del self.ends[len(self.records) :]

    def __len__(self) -> int:
        return min(len(self.ends), self.size)

    @property
    def added(self) -> int:
        """How many records were ever taken."""
        return self._gone + len(self.ends)

    @property
    def version(self) -> Tuple[int, int]:
        """Another value after each change of the records; no other memory has it."""
        return self._epoch, self.added

    @property
    def latest(self) -> Optional[int]:
        """The newest end of all events taken, None before the first."""
        return self.ends[-1] if self.ends else None

    def add(self, record: MemoryRecord) -> bool:
        """Take a record; returns False where it is older than all records of a full memory."""
        ends = self.ends
        end = int(record[2])
        if ends and end < ends[-1]:
            return self._insert(record, end)
        ends.append(end)
        self.records.append(record)
        if len(ends) >= self.room:
            self.cut()
        return True

    def _insert(self, record: MemoryRecord, end: int) -> bool:
        ends, records = self.ends, self.records
        at = bisect_right(ends, end)
        if self.size and at <= len(ends) - self.size:
            self.late += 1
            return False
        self.changed = min(self.changed, self._gone + at)
        self._become(self._gone, [*ends[:at], end, *ends[at:]], [*records[:at], record, *records[at:]])
        self.cut()
        return True

    def cut(self) -> None:
        """Drop what is over the size; the newest stays, whatever the size, for what is `latest`."""
        first = max(0, len(self.ends) - max(self.size, 1))
        self._become(self._gone + first, self.ends[first:], self.records[first:])

    def at_or_before(self, instant: int) -> Optional[MemoryRecord]:
        """Return the last record whose end is not after ``instant``."""
        ends = self.ends
        at = bisect_right(ends, instant) - 1
        if at < 0 or at < len(ends) - self.size:
            return None
        return self.records[at]

    def at_or_after(self, instant: int) -> Optional[MemoryRecord]:
        """Return the first record whose end is not before ``instant``."""
        ends = self.ends
        held = len(ends)
        first = held - self.size
        at = bisect_left(ends, instant) if first <= 0 else bisect_left(ends, instant, first)
        if at >= held:
            return None
        start, end = ends[at - 1], ends[at]  # the last one before the first: no gap then
        if (end - start) * (held + WIDE - 2) >= WIDE * (ends[-1] - ends[0]) and start < end:
            self.on_wide(start, end)  # at least ten times the mean of the other steps
        return self.records[at]

    def around(self, instant: int) -> Optional[Tuple[MemoryRecord, MemoryRecord]]:
        """Return what `at_or_before` and `at_or_after` do; None without both."""
        ends = self.ends
        held = len(ends)
        at = bisect_right(ends, instant)
        if at < 1 or at <= held - self.size:
            return None
        start = ends[at - 1]
        if start == instant:
            return self.records[at - 1], self.records[
                bisect_left(ends, instant, max(0, held - self.size), at)
            ]
        if at >= held:
            return None
        end = ends[at]
        if (end - start) * (held + WIDE - 2) >= WIDE * (ends[-1] - ends[0]):  # as in `at_or_after`
            self.on_wide(start, end)
        return self.records[at - 1], self.records[at]

    @property
    def first(self) -> int:
        """The place of the oldest record that counts."""
        return max(0, len(self.ends) - self.size)

    def after(self, instant: int) -> int:
        """Return the place behind all records whose ends are not after ``instant``."""
        return bisect_right(self.ends, instant, self.first)

    def reaching(self, instant: int) -> int:
        """Return the place of the first record whose end is not before ``instant``."""
        return bisect_left(self.ends, instant, self.first)

    def newest_first(self) -> Iterator[MemoryRecord]:
        """Yield the records there are at this moment, newest first."""
        records = self.records
        for at in range(len(records) - 1, max(0, len(records) - self.size) - 1, -1):
            yield records[at]
