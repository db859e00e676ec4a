"""Items and outputs of operators on streams, and the state that an operator holds for each key.

An operator holds a state for each key: the values by which its items are grouped. `KeyedOperator` bounds these states
by time and by number. Keys are ordered by their last use, so that idle keys are found at the front of the order, and
each event pays for at most one key that is dropped later.
"""

from collections import OrderedDict
from typing import Any, Callable, Hashable, List, NamedTuple, Optional, Protocol, Tuple

from ...foundation.errors import RuleError
from ...prolog.machine.resource_limits import Meter
from ...prolog.terms.term_traversal import PLAIN, term_key
from ...prolog.terms.types import Values


class StreamElement:
    """A match that has come, as a stream sees it.

    Attributes:
        match: the match, where it is given on or tracked.
        start: where its interval starts.
        end: where it ends.
        by: the values that say to which group it belongs.
        key: the same, to be compared.
        values: what is looked at: one value for each measure of a window, or that which may change.
        order: the larger, the later it came.
        gone: whether it has left the window.
    """

    __slots__ = ("match", "start", "end", "by", "key", "values", "order", "gone")

    def __init__(self, match: Any, start: int, end: int, by: Values, values: Tuple[Any, ...]):
        self.match = match
        self.start = start
        self.end = end
        self.by = by
        self.values = values
        self.order = 0
        self.gone = False
        if len(by) == 1:
            only = by[0]
            self.key: Hashable = only if only.__class__ in PLAIN else term_key(only)
        else:
            self.key = tuple([term_key(one) for one in by])

    def file(self) -> None:
        """Be in, under the key that it has by its values."""
        self.gone = False
        by = self.by
        self.key = term_key(by[0]) if len(by) == 1 else tuple([term_key(one) for one in by])


class StreamOutput(NamedTuple):
    """What an operator on a stream gives on.

    Attributes:
        items: those that it is made of, in the order in which they came; the newest only where nobody tracks them.
        start: where its interval starts.
        end: where it ends.
        found: the results of a window's measures; empty elsewhere.
        error: why these could not be measured; nothing else follows from it, and nothing is given on.
    """

    items: Tuple[StreamElement, ...]
    start: int
    end: int
    found: Values = ()
    error: Optional[RuleError] = None


KnownState = Tuple[Any, ...]
"""What an operator knows, as numbers, terms, items and lists of them."""
NEVER = -(1 << 63)
"""An instant before all others."""


class KeyBounds(NamedTuple):
    """Bounds of the states of keys.

    Attributes:
        span: the longest interval of an output that is of use, in ns; None for no bound.
        idle: the time in ns for which a key is kept without an item of its own; None for no bound.
        keys: the largest number of keys.
    """

    span: Optional[int] = None
    idle: Optional[int] = None
    keys: int = 1 << 62


class StreamOperator(Protocol):
    """An operator on streams: a state that takes items and instants, and gives outputs on.

    It knows nothing of rules, events and their dispatch, and is the same for the same items and instants: what an
    event that is taken back has changed is found by running it again without that.

    Attributes:
        next: the instant at which `ring` has something to give on; None where only items do.
        late: how many items came too late to be taken.
        crowded: number of alternatives that were not followed, because one start had too many.
        evicted: number of keys that were dropped because there were too many.
        bounds: bounds of the states of keys.
        keys: number of keys that have a state.
        bytes: estimate of the memory of the states: numbers of keys and items times constants that were measured.
        tracked: whether outputs name the items that they are made of, a hundred at most, else the newest only.
        meter: counts the items that are looked at as pattern work; None if nothing is counted.
        allowed: gives the newest end that moves the time of the stream on; of later ones only the items are taken.
    """

    next: Optional[int]
    late: int
    crowded: int
    evicted: int
    bounds: KeyBounds
    tracked: bool
    meter: Optional[Meter]
    allowed: Callable[[], int]

    @property
    def keys(self) -> int:
        """See the attributes."""

    @property
    def bytes(self) -> int:
        """See the attributes."""

    def set_bounds(self, bounds: KeyBounds, /) -> None:
        """Bound the states of keys from the next item on."""

    def take(self, item: StreamElement, now: int, channel: int, /) -> List[StreamOutput]:
        """Take an item, and return what is given on.

        Args:
            item: the item.
            now: the present instant by the clock.
            channel: 0, or 1 for what must not happen.

        Raises:
            RuleError: where a value is not one that can be measured; nothing has changed then.
        """

    def ring(self, instant: int, /) -> List[StreamOutput]:
        """Return what is given on as the clock has come to an instant."""

    def __len__(self) -> int:
        """Return how many items, or keys, are held."""

    def drop_oldest(self) -> List[StreamOutput]:
        """Forget the item, or the key, that is held for the longest time; return what is given on because of it."""

    def kept(self) -> KnownState:
        """Return what it knows; see `restore`."""

    def restore(self, kept: KnownState, /) -> None:
        """Know what another one did that was made in the same way."""


class KeyedOperator:
    """The common part of operators: the newest end, and the states of keys with their bounds. See `StreamOperator`.

    Attributes:
        clock: the newest end of the items so far. Ends further in the future than stamps may be do not count.
        newest_allowed: the result of the last call of ``allowed``, in ns.
        states: the state of each key. For operators that drop idle keys the order is that of the last use, and
            ``since`` of each state is the clock at that use.
    """

    KEY_BYTES = 450
    """Memory of a key, without its items; measured with tracemalloc on CPython 3.11."""
    ITEM_BYTES = 450
    """Memory of an item with two small arguments; measured with tracemalloc on CPython 3.11."""

    def __init__(self) -> None:
        self.next: Optional[int] = None
        self.late = self.crowded = self.evicted = 0
        self.tracked = False
        self.meter: Optional[Meter] = None
        self.allowed: Callable[[], int] = lambda: 1 << 64
        self.set_bounds(KeyBounds())
        self.clock = self.newest_allowed = NEVER
        # The first key of a plain dict is searched for among all that were deleted before it.
        self.states: OrderedDict[Hashable, Any] = OrderedDict()

    def set_bounds(self, bounds: KeyBounds) -> None:
        """See `StreamOperator.set_bounds`."""
        self.bounds = bounds
        self._longest, self._idle, self._most_keys = bounds  # asked at each item

    def __len__(self) -> int:
        return len(self.states)

    @property
    def keys(self) -> int:
        """See `StreamOperator.keys`."""
        return len(self.states)

    @property
    def bytes(self) -> int:
        """See `StreamOperator.bytes`."""
        return self.keys * self.KEY_BYTES + len(self) * self.ITEM_BYTES

    def ring(self, instant: int) -> List[StreamOutput]:
        """See `StreamOperator.ring`."""
        return []

    def _is_ahead(self, end: int) -> bool:
        """Tell whether an end is further in the future than stamps may be: others do not wait for its time."""
        if end > self.newest_allowed:
            self.newest_allowed = self.allowed()  # which rises: it is asked where it may matter
        return end > self.newest_allowed

    def _move_on(self, end: int) -> None:
        if self.clock < end and (end <= self.newest_allowed or not self._is_ahead(end)):
            self.clock = end

    def _forget_idle(self) -> None:
        """Drop the keys whose last use is longer ago than the bound."""
        if self._idle is None:
            return
        states, before = self.states, self.clock - self._idle
        while states:
            key = next(iter(states))
            if states[key].since >= before:
                return
            self._forget(key)

    def _make_room(self) -> None:
        """Drop the least recently used keys if there are too many."""
        while len(self.states) > self._most_keys:
            self._forget(next(iter(self.states)))
            self.evicted += 1

    def _forget(self, key: Hashable) -> None:
        """Drop the state of a key."""
        del self.states[key]
