"""One memory instance: the newest N records of a kind of event, in order of their end times."""

from bisect import bisect_left, bisect_right
from typing import Iterator, List, NamedTuple, Optional

from ..terms import Term


class Record(NamedTuple):
    """What a memory keeps of an event: the record and the event's interval (instants)."""

    term: Term
    start: int
    end: int


class Memory:
    """A bounded history, ordered by end time; records with equal ends stay in order of arrival.

    Adding at the end and every look-up cost the same whatever the size: the records lie in a list of which
    only the last ``size`` count, cut back when it has grown to twice that; look-ups are binary searches.
    Lists are replaced, never shortened or reordered in place, so that a reader who walks an older list is
    not disturbed by what is added meanwhile.

    Attributes:
        size: how many records are kept at most.
        added: how many records were ever taken.
        late: how many events were refused because they were older than all records of a full memory.
        latest: the newest end of all events taken, None before the first.
    """

    __slots__ = ("size", "added", "late", "latest", "_ends", "_records", "_room")

    def __init__(self, size: int):
        self.size = size
        self._room = 2 * size + 16
        self.added = 0
        self.late = 0
        self.clear()

    def clear(self) -> None:
        """Forget all records; the counts stay."""
        self.latest: Optional[int] = None
        self._ends: List[int] = []
        self._records: List[Record] = []

    def __len__(self) -> int:
        return min(len(self._ends), self.size)

    def add(self, term: Term, start: int, end: int) -> bool:
        """Take a record; returns False where it is older than all records of a full memory."""
        ends = self._ends
        latest = self.latest
        if latest is None or end >= latest:
            self.latest = end
            ends.append(end)
            self._records.append((term, start, end))  # type: ignore[arg-type]  # a plain tuple is twice as fast
            self.added += 1
            if len(ends) >= self._room:
                self._cut()
            return True
        at = bisect_right(ends, end)
        if self.size and at <= len(ends) - self.size:
            self.late += 1
            return False
        self._ends = [*ends[:at], end, *ends[at:]]
        self._records = [*self._records[:at], Record(term, start, end), *self._records[at:]]
        self.added += 1
        self._cut()
        return True

    def _cut(self) -> None:
        first = max(0, len(self._ends) - self.size)
        self._ends = self._ends[first:]
        self._records = self._records[first:]

    def at_or_before(self, instant: int) -> Optional[Record]:
        """Return the last record whose end is not after ``instant``."""
        at = bisect_right(self._ends, instant) - 1
        if at < 0 or at < len(self._ends) - self.size:
            return None
        return self._records[at]

    def at_or_after(self, instant: int) -> Optional[Record]:
        """Return the first record whose end is not before ``instant``."""
        ends = self._ends
        size = self.size
        first = len(ends) - size
        at = bisect_left(ends, instant, first if first > 0 else 0)
        return self._records[at] if at < len(ends) else None

    def newest_first(self) -> Iterator[Record]:
        """Yield the records there are at this moment, newest first."""
        records = self._records
        for at in range(len(records) - 1, max(0, len(records) - self.size) - 1, -1):
            yield records[at]
