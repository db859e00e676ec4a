"""Operators that let some matches of a stream through: not too many, those that last, or where something changed."""

import heapq
from collections import OrderedDict
from typing import Dict, Hashable, List, Tuple

from ...prolog.terms.term_traversal import PLAIN, term_key
from .stream_elements import NEVER, KeyedOperator, KnownState, StreamElement, StreamOutput


class Throttle(KeyedOperator):
    """Lets an item through where the last one of its key is ``span`` ns back and more, by the newest end.

    Args:
        span: how far.
        every: whether the last one is any that came, so that the first of each burst is let through; else the last
            that was let through.
    """

    def __init__(self, span: int, every: bool):
        super().__init__()
        self.span = span
        self.every = every
        self.states: OrderedDict[Hashable, StreamElement] = OrderedDict()
        self._by_end: List[Tuple[int, int, StreamElement]] = []
        self._order = 0

    def drop_oldest(self) -> List[StreamOutput]:
        """See `StreamOperator.drop_oldest`."""
        while True:
            item = heapq.heappop(self._by_end)[2]
            if self.states.get(item.key) is item:
                del self.states[item.key]
                return []

    def take(self, item: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.take`."""
        if self._is_ahead(item.end):
            return [StreamOutput((item,), item.start, item.end)]
        self._move_on(item.end)
        self._forget_past()
        before = self.states.get(item.key)
        if before is None or (self.every and item.end > before.end):
            self._note(item)
        return [StreamOutput((item,), item.start, item.end)] if before is None else []

    def _note(self, item: StreamElement) -> None:
        noted = StreamElement(None, item.start, item.end, item.by, ())  # the match itself is not held
        self._order += 1
        noted.order = self._order
        self.states[noted.key] = noted
        if len(self.states) > self._most_keys:
            self.drop_oldest()
            self.evicted += 1
        heapq.heappush(self._by_end, (noted.end, noted.order, noted))
        if len(self._by_end) > 2 * len(self.states) + 64:
            self._by_end = [(one.end, one.order, one) for one in self.states.values()]
            heapq.heapify(self._by_end)

    def _forget_past(self) -> None:
        before = self.clock - self.span
        while self._by_end and self._by_end[0][0] <= before:
            item = heapq.heappop(self._by_end)[2]
            if self.states.get(item.key) is item:
                del self.states[item.key]

    def kept(self) -> KnownState:
        """See `StreamOperator.kept`."""
        return (self.clock, list(self.states.values()))

    def restore(self, kept: KnownState) -> None:
        """See `StreamOperator.restore`."""
        self.clock, noted = kept
        self.states.clear()
        self._by_end = []
        for item in noted:
            item.file()
            self._note(item)


class _LastValue:
    """The value of a key's last item, the item in which it was new, and the clock at the last item."""

    __slots__ = ("value", "item", "since")

    def __init__(self, value: Hashable, item: StreamElement, since: int):
        self.value = value
        self.item = item
        self.since = since


class DistinctUntilChanged(KeyedOperator):
    """Lets an item through where what is looked at is another term than in the last one of its key, or the first."""

    KEY_BYTES, ITEM_BYTES = 950, 0

    def drop_oldest(self) -> List[StreamOutput]:
        """See `StreamOperator.drop_oldest`: the key that was least recently used."""
        self.states.popitem(last=False)
        return []

    def take(self, item: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.take`."""
        looked_at = item.values[0]
        value: Hashable = looked_at if looked_at.__class__ in PLAIN else term_key(looked_at)
        end, key, states = item.end, item.key, self.states
        if self.clock < end and (end <= self.newest_allowed or not self._is_ahead(end)):
            self.clock = end
        if self._idle is not None:
            self._forget_idle()
        known = states.get(key)
        if known is not None:
            states.move_to_end(key)
            known.since = self.clock
            if known.value == value:
                return []
        self._note(value, StreamElement(None, item.start, item.end, item.by, item.values))
        return [StreamOutput((item,), item.start, item.end)]

    def _note(self, value: Hashable, item: StreamElement) -> None:
        self.states[item.key] = _LastValue(value, item, self.clock)
        if len(self.states) > self._most_keys:
            self._make_room()

    def kept(self) -> KnownState:
        """See `StreamOperator.kept`: clocks of the last uses, and items, the least recently used key first."""
        found = self.states.values()
        return ([one.since for one in found], [one.item for one in found])

    def restore(self, kept: KnownState) -> None:
        """See `StreamOperator.restore`."""
        self.states.clear()
        for self.clock, item in zip(*kept):
            item.file()
            self._note(term_key(item.values[0]), item)


class Debounce(KeyedOperator):
    """Gives an item on ``span`` ns after its end, if none of its key has come that ends as late, within these ns.

    Of one key more than one may wait where ends are ahead of the clock, each ``span`` after the other at least.
    """

    def __init__(self, span: int):
        super().__init__()
        self.span = span
        self._reached = NEVER
        self.waiting: Dict[Hashable, List[StreamElement]] = {}
        self._number = 0
        self._due: List[Tuple[int, int, StreamElement]] = []
        self._order = 0

    def __len__(self) -> int:
        return self._number

    @property
    def keys(self) -> int:
        """See `StreamOperator.keys`."""
        return len(self.waiting)

    def drop_oldest(self) -> List[StreamOutput]:
        """See `StreamOperator.drop_oldest`."""
        self._settle()
        self._leave(self._due[0][2])
        self._settle()
        return []

    def take(self, item: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.take`."""
        if now > self._reached:
            self._reached = now
        end, span = item.end, self.span
        if end + span <= self._reached or self._is_ahead(end):
            self.late += 1
            return []
        overtaken = False
        for one in list(self.waiting.get(item.key, ())):
            if one.end <= end < one.end + span:
                self._leave(one)
            elif end < one.end < end + span:
                overtaken = True
        if not overtaken:
            self._order += 1
            item.order = self._order
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

    def _wait(self, item: StreamElement) -> None:
        self.waiting.setdefault(item.key, []).append(item)
        self._number += 1
        heapq.heappush(self._due, (item.end + self.span, item.order, item))
        if len(self._due) > 2 * self._number + 64:
            self._due = [entry for entry in self._due if not entry[2].gone]
            heapq.heapify(self._due)

    def _leave(self, item: StreamElement) -> None:
        item.gone = True
        self._number -= 1
        same = self.waiting[item.key]
        same.remove(item)
        if not same:
            del self.waiting[item.key]

    def _settle(self) -> None:
        """Drop what has left from the top, and say when the next one is due."""
        while self._due and self._due[0][2].gone:
            heapq.heappop(self._due)
        self.next = self._due[0][0] if self._due else None

    def kept(self) -> KnownState:
        """See `StreamOperator.kept`."""
        waiting = [item for same in self.waiting.values() for item in same]
        return (self._order, self._reached, sorted(waiting, key=lambda one: one.order))

    def restore(self, kept: KnownState) -> None:
        """See `StreamOperator.restore`."""
        self._order, self._reached, waiting = kept
        self.waiting, self._due, self._number = {}, [], 0
        for item in waiting:
            item.file()
            self._wait(item)
        self._settle()
