"""Session windows: elements of a key that follow each other within a gap.

A session is a maximal sequence of elements, ordered by their ends, in which each ends less than the gap after the
previous one. If its length is bounded, an element that ends this time or later after the first one begins the next
session. A session ends the gap after its last element, or at its maximum length, and emits its result then.

Elements may arrive in any order. An element that arrives between two open sessions merges them, so a key can have
several open sessions, and results are computed at the end, from the elements in order of arrival. The sessions of a
key are a function of its open elements: they are those that the elements in order of their ends would have formed.
"""

import heapq
from bisect import bisect_left, insort
from collections import OrderedDict
from operator import itemgetter
from typing import Hashable, List, Optional, Sequence, Tuple

from ...foundation.errors import RuleError
from ...prolog.terms.timestamps import BEFORE_ALL_INSTANTS, MAX_TIMESTAMP
from ...serialization.state_fields import StateFields, field
from ...serialization.stored_field_types import INSTANT
from .aggregates import value_error
from .stream_operators import StreamElement, StreamOutput
from .windows import AccumulatorFactory, KeyedWindow, OpenWindow, StoredWindow, Window

_SessionEntry = Tuple[int, int, StreamElement]
"""End, order of arrival, and the element."""


class OpenSession:
    """Elements of an open session.

    Attributes:
        entries: the elements, ordered by their ends.
        serial: number of its entry in the heap of deadlines; 0 if it has been merged or dropped.
    """

    __slots__ = ("entries", "serial")

    def __init__(self, entries: List[_SessionEntry]):
        self.entries = entries
        self.serial = 0

    @property
    def begin(self) -> int:
        """End of the first element, in ns."""
        return self.entries[0][0]

    @property
    def last(self) -> int:
        """End of the last element, in ns."""
        return self.entries[-1][0]


class SessionWindow(Window):
    """Windows of elements that end less than ``gap`` ns after the previous one; each emits at its end.

    Args:
        make_accumulators: creates the accumulators of a session.
        gap: time in ns without an element that ends a session.
        max_length: time in ns from the end of the first element at which a session ends; None for no bound.

    Attributes:
        states: open sessions of each key, in the order of their ends.
    """

    STATE = StateFields(*Window.STATE.extended(field("_latest_now", INSTANT)))

    emits_at_deadlines = True

    def __init__(self, make_accumulators: AccumulatorFactory, gap: int, max_length: Optional[int]):
        super().__init__(make_accumulators)
        self.gap = gap
        # No two instants are further apart.
        self.max_length = 2 * MAX_TIMESTAMP if max_length is None else max_length
        self.states: OrderedDict[Hashable, List[OpenSession]] = OrderedDict()
        self._latest_now = BEFORE_ALL_INSTANTS
        self._deadlines: List[Tuple[int, int, int, Hashable, OpenSession]] = []
        """Heap: deadline, order of the first element, serial, key, session.

        A deadline may be too early, because further elements extend a session; see `_update_deadline`.
        """
        self._last_serial = 0

    def process(self, element: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.process`."""
        self._check_alone(element)
        # Too far in the future: it would keep a session open forever.
        if element.end > self.max_timestamp and self._is_too_far_ahead(element.end):
            self.late_count += 1
            return []
        self._advance(element.end)
        if now > self._latest_now:
            self._latest_now = now
        sessions = self.states.get(element.key, [])
        position = len(sessions)
        while position and sessions[position - 1].begin > element.end:
            position -= 1
        extends = position > 0 and self._extends(sessions[position - 1], element.end)
        if not extends and self._has_ended(element.end, sessions[position : position + 1]):
            self.late_count += 1
            return []
        self._number_element(element)
        if not sessions:
            self.states[element.key] = sessions
            self._evict_keys()
        self.states.move_to_end(element.key)
        self.element_count += 1
        entry = (element.end, element.order, element)
        if extends:
            position -= 1
            insort(sessions[position].entries, entry)
        else:
            sessions.insert(position, OpenSession([entry]))
        if not extends or position + 1 < len(sessions):
            self._merge_following(element.key, sessions, position)
        self._update_deadline()
        return []

    def _extends(self, session: OpenSession, end: int) -> bool:
        """Return whether an element with this end, which is not before that of the first one, is in a session."""
        return end - session.last < self.gap and end - session.begin < self.max_length

    def _has_ended(self, end: int, following: Sequence[OpenSession]) -> bool:
        """Return whether the session has ended that an element with this end begins."""
        if end + self.max_length <= self._latest_now:
            return True
        is_followed = bool(following) and following[0].begin - end < self.gap
        return not is_followed and end + self.gap <= self._latest_now

    def _merge_following(self, key: Hashable, sessions: List[OpenSession], position: int) -> None:
        """Move elements of following sessions into a changed session that contains them now; set its deadline."""
        session = sessions[position]
        while position + 1 < len(sessions) and self._extends(session, sessions[position + 1].begin):
            following = sessions[position + 1]
            split = bisect_left(following.entries, (session.begin + self.max_length,))
            session.entries += following.entries[:split]
            del following.entries[:split]
            if not following.entries:
                following.serial = 0
                del sessions[position + 1]
                continue
            # The first session has its maximum length; the rest of the following one begins later than before.
            self._schedule(key, session)
            position += 1
            session = following
        self._schedule(key, session)

    def _deadline_of(self, session: OpenSession) -> int:
        return min(session.last + self.gap, session.begin + self.max_length)

    def _schedule(self, key: Hashable, session: OpenSession) -> None:
        """Index a session that is new or has another first element."""
        self._last_serial += 1
        session.serial = self._last_serial
        entry = (self._deadline_of(session), session.entries[0][1], session.serial, key, session)
        heapq.heappush(self._deadlines, entry)
        if len(self._deadlines) > 2 * self.element_count + 64:
            self._deadlines = [entry for entry in self._deadlines if entry[2] == entry[4].serial]
            heapq.heapify(self._deadlines)

    def _update_deadline(self) -> None:
        """Set the next deadline: remove or replace entries of sessions that have changed at the top of the heap."""
        while self._deadlines:
            deadline, _, serial, key, session = self._deadlines[0]
            is_valid = serial == session.serial
            # Further elements only delay a deadline, so no other one is before that at the top if it is up to date.
            if is_valid and deadline == self._deadline_of(session):
                self.next_deadline = deadline
                return
            heapq.heappop(self._deadlines)
            if is_valid:
                self._schedule(key, session)
        self.next_deadline = None

    def advance_to(self, instant: int) -> List[StreamOutput]:
        """See `StreamOperator.advance_to`."""
        outputs: List[StreamOutput] = []
        while self.next_deadline is not None and self.next_deadline <= instant:
            _, _, _, key, session = heapq.heappop(self._deadlines)
            sessions = self.states[key]
            # The sessions of a key end in their order.
            del sessions[0]
            if not sessions:
                del self.states[key]
            self.element_count -= len(session.entries)
            outputs += self._close(session)
            self._update_deadline()
        return outputs

    def _close(self, session: OpenSession) -> List[StreamOutput]:
        outputs: List[StreamOutput] = []
        window = KeyedWindow(self.make_accumulators())
        for _, _, element in sorted(session.entries, key=itemgetter(1)):
            try:
                for measure in window.checked_measures:
                    if measure.check(element) and not measure.array_count and window.element_count:
                        # The elements of the session have numbers.
                        raise value_error(measure.name, element.values[measure.index])
            except RuleError as error:
                # Its value was suitable alone, but an earlier element of this session has another kind of value.
                outputs.append(StreamOutput((element,), element.start, element.end, (), error))
            else:
                window.add(element)
        return [*outputs, *self._emit(window)] if window.element_count else outputs

    def drop_oldest(self) -> List[StreamOutput]:
        """See `StreamOperator.drop_oldest`; drops the first element of the least recently used key."""
        key, sessions = next(iter(self.states.items()))
        del sessions[0].entries[0]
        self.element_count -= 1
        if sessions[0].entries:
            # A session of maximum length may have a place for a following element.
            self._merge_following(key, sessions, 0)
        else:
            sessions[0].serial = 0
            del sessions[0]
            if not sessions:
                del self.states[key]
        self._update_deadline()
        return []

    def _drop_key(self, key: Hashable) -> None:
        """Drop a key with its elements."""
        for session in self.states.pop(key):
            session.serial = 0
            self.element_count -= len(session.entries)

    def return_to(self, instant: int) -> None:
        """See `StreamOperator.return_to`."""
        super().return_to(instant)
        self._latest_now = min(self._latest_now, instant)
        self.keyed_windows = [
            StoredWindow(stored.reference_time, elements)
            for stored in self.keyed_windows
            for elements in [[element for element in stored.elements if element.end <= self.max_timestamp]]
            if elements
        ]

    def open_windows(self, now: int) -> List[OpenWindow]:
        """See `Window.open_windows`."""
        return [
            OpenWindow(
                session.entries[0][2].key_values,
                len(session.entries),
                min(element.start for _, _, element in session.entries),
                self._deadline_of(session),
            )
            for sessions in self.states.values()
            for session in sessions
        ]

    @property
    def keyed_windows(self) -> List[StoredWindow]:
        """The elements of all keys, the least recently used one first."""
        return [
            StoredWindow(
                sessions[0].begin,
                [
                    element
                    for _, _, element in sorted(
                        (entry for session in sessions for entry in session.entries), key=itemgetter(1)
                    )
                ],
            )
            for sessions in self.states.values()
        ]

    @keyed_windows.setter
    def keyed_windows(self, stored_windows: Sequence[StoredWindow]) -> None:
        self.states.clear()
        self._deadlines.clear()
        self.element_count = sum(len(stored.elements) for stored in stored_windows)
        for stored in stored_windows:
            sessions: List[OpenSession] = []
            for entry in sorted((element.end, element.order, element) for element in stored.elements):
                if sessions and self._extends(sessions[-1], entry[0]):
                    sessions[-1].entries.append(entry)
                else:
                    sessions.append(OpenSession([entry]))
            key = stored.elements[0].key
            self.states[key] = sessions
            for session in sessions:
                self._schedule(key, session)
        self._update_deadline()
