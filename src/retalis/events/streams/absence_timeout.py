"""What is given on when a time has passed in which something did not happen."""

import heapq
from typing import Any, Callable, Dict, Hashable, Iterator, List, NamedTuple, Optional, Tuple

from .stream_elements import NEVER, KeyedOperator, KnownState, StreamElement, StreamOutput

_SMALL_QUEUE = 32


class Correlation(NamedTuple):
    """How what is awaited and what must not happen are put together.

    Attributes:
        key: gives the values that they have in common, by the match and the channel; None where these have
            variables, so that all have to be looked at.
        rules_out: tells whether a match that must not happen, and that lies between, rules one out that is
            awaited.
        alike: whether it does so for all of the same key, where that has no variables.
        name: gives what a match and a waiting one that it replaces have in common; None where none replaces
            another.
    """

    key: Callable[[Any, int], Hashable]
    rules_out: Callable[[Any, Any], bool]
    alike: bool
    name: Optional[Callable[[Any], Hashable]]


class _Forbidden:
    """What must not have happened, under one key; one goes where others rule out all that it does."""

    __slots__ = ("items", "number", "newest")

    def __init__(self) -> None:
        self.items: List[StreamElement] = []  # some may be gone, where they are many
        self.number = 0
        self.newest = NEVER

    def add(self, item: StreamElement, span: int, thin: bool) -> List[StreamElement]:
        """Add one; returns those that are superfluous now."""
        items = self.items
        self.newest = max(self.newest, item.start)
        if thin and len(items) > 1:
            first, middle = items[-2], items[-1]
            rising = first.start <= middle.start <= item.start and first.end <= middle.end <= item.end
            if rising and item.end - first.start < span and not (first.gone or middle.gone):
                items[-1] = item
                return [middle]
        items.append(item)
        self.number += 1
        return []

    def left(self) -> None:
        """Take note that one is gone; of many not each is taken out by itself."""
        self.number -= 1
        if self.number < _SMALL_QUEUE or len(self.items) > 2 * self.number:
            self.items = [one for one in self.items if not one.gone]


class AbsenceTimeout(KeyedOperator):
    """Gives an item on ``span`` ns after its end, if nothing that must not happen lay wholly between.

    The key of an item that waits is what it has in common with what must not happen, and its name among those that
    wait; of what must not happen it is the first alone.

    Args:
        span: the time that has to pass.
        agreement: which items have to do with one another.
    """

    def __init__(self, span: int, agreement: Correlation):
        super().__init__()
        self.span = span
        self.agreement = agreement
        self._waiting: Dict[Hashable, Dict[Hashable, StreamElement]] = {}
        self._absent: Dict[Hashable, _Forbidden] = {}
        self._number = 0
        self._reached = NEVER
        self._due: List[Tuple[int, int, StreamElement]] = []
        self._by_start: List[Tuple[int, int, StreamElement]] = []
        self._order = 0

    KEY_BYTES, ITEM_BYTES = 300, 1100

    def __len__(self) -> int:
        return self._number

    @property
    def keys(self) -> int:
        """See `StreamOperator.keys`."""
        return len(self._waiting) + len(self._absent)

    def drop_oldest(self) -> List[StreamOutput]:
        """See `StreamOperator.drop_oldest`: of those that wait, else of what must not happen."""
        self._settle()
        if self._due:
            self._leave(self._due[0][2])
            self._settle()
        else:
            while self._by_start[0][2].gone:
                heapq.heappop(self._by_start)
            self._forget_before(self._by_start[0][0])
        return []

    def take(self, item: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.take`."""
        if now > self._reached:
            self._reached = (
                now  # an event that an alarm of the past makes finds what was known then forgotten
            )
        self._forget_before(self._reached - self.span)
        self._order += 1
        item.order = self._order
        key = self.agreement.key(item.match, channel)
        if channel:
            self._rule_out(item, key)
            self._note_absent(item, key)
        elif item.end + self.span <= self._reached:
            self.late += 1
        else:
            self._replace(item, key)
            if not self._is_ruled_out(item, key):
                self._wait(item)
        self._settle()
        return []

    def ring(self, instant: int) -> List[StreamOutput]:
        """See `StreamOperator.ring`."""
        outputs = []
        while self.next is not None and self.next <= instant:
            due, _, item = self._due[0]
            self._leave(item)
            outputs.append(StreamOutput((item,), item.start, due))
            self._settle()
        return outputs

    def kept(self) -> KnownState:
        """See `StreamOperator.kept`."""
        waiting = [item for _, _, item in self._due if not item.gone]
        absent = [item for _, _, item in self._by_start if not item.gone]
        return (self._order, self._reached, sorted(waiting, key=_order), sorted(absent, key=_order))

    def restore(self, kept: KnownState) -> None:
        """See `StreamOperator.restore`."""
        self._order, self._reached, waiting, absent = kept
        self._waiting, self._absent, self._due, self._by_start, self._number = {}, {}, [], [], 0
        for item in [*waiting, *absent]:
            item.file()
        for item in waiting:
            self._replace(item, self.agreement.key(item.match, 0))
            self._wait(item)
        for item in absent:
            self._note_absent(item, self.agreement.key(item.match, 1))
        self._settle()

    def _replace(self, item: StreamElement, key: Hashable) -> None:
        """Give an item its key, and have the one leave that it replaces."""
        name = self.agreement.name
        known = item.order if name is None else name(item.match)
        item.key = (key, known)
        older = self._waiting.get(key, {}).get(known)
        if older is not None:
            self._leave(older)

    def _wait(self, item: StreamElement) -> None:
        key: Any = item.key
        self._waiting.setdefault(key[0], {})[key[1]] = item
        self._number += 1
        _push(self._due, item.end + self.span, item, self._number)

    def _leave(self, item: StreamElement) -> None:
        item.gone = True
        key: Any = item.key
        waiting = self._waiting[key[0]]
        del waiting[key[1]]
        if not waiting:
            del self._waiting[key[0]]
        self._number -= 1

    def _settle(self) -> None:
        """Drop what has left from the top, and say when the next one is due."""
        while self._due and self._due[0][2].gone:
            heapq.heappop(self._due)
        self.next = self._due[0][0] if self._due else None

    def _rule_out(self, absent: StreamElement, key: Hashable) -> None:
        """Have all leave that wait and are ruled out."""
        waiting = list(self._that_wait(key))
        if self.meter is not None:  # not stopped half way: what is ruled out would be given on
            self.meter(len(waiting))
        for item in waiting:
            if self._lies_after(absent, item):
                self._leave(item)

    def _that_wait(self, key: Hashable) -> Iterator[StreamElement]:
        for one in list(self._waiting) if key is None else [key, None]:
            yield from self._waiting.get(one, {}).values()

    def _is_ruled_out(self, item: StreamElement, key: Hashable) -> bool:
        """Tell whether something that has come before an item lies after it and rules it out."""
        keys = list(self._absent) if key is None else [key, None]
        borders = [self._absent[one] for one in keys if one in self._absent]
        if self.meter is not None:
            self.meter(sum(len(border.items) for border in borders))
        return any(
            self._lies_after(absent, item)
            for border in borders
            if border.newest > item.end
            for absent in border.items
            if not absent.gone
        )

    def _lies_after(self, absent: StreamElement, item: StreamElement) -> bool:
        if not (item.end < absent.start and absent.end < item.end + self.span):
            return False
        agreement = self.agreement
        key: Any = item.key
        if agreement.alike and key is not None and absent.key is not None:
            return True
        return agreement.rules_out(item.match, absent.match)

    def _note_absent(self, item: StreamElement, key: Hashable) -> None:
        item.key = key
        border = self._absent.setdefault(key, _Forbidden())
        thin = self.agreement.alike and key is not None
        self._number += 1
        for one in border.add(item, self.span, thin):
            one.gone = True
            self._number -= 1
        _push(self._by_start, item.start, item, self._number)

    def _forget_before(self, before: int) -> None:
        """Forget what must not happen and has begun too long ago to be in the way of anything."""
        while self._by_start and self._by_start[0][0] <= before:
            item = heapq.heappop(self._by_start)[2]
            if not item.gone:
                item.gone = True
                self._number -= 1
                border = self._absent[item.key]
                border.left()
                if not border.number:
                    del self._absent[item.key]


def _order(item: StreamElement) -> int:
    return item.order


def _push(heap: List[Tuple[int, int, StreamElement]], instant: int, item: StreamElement, number: int) -> None:
    """Add an item to a heap; what is gone is dropped from it where it is the larger part."""
    heapq.heappush(heap, (instant, item.order, item))
    if len(heap) > 2 * number + 64:
        heap[:] = [entry for entry in heap if not entry[2].gone]
        heapq.heapify(heap)
