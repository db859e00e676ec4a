"""What flows through operators on streams: matches as they come, and what is given on."""

from typing import Any, Callable, Hashable, List, NamedTuple, Optional, Protocol, Tuple

from ...foundation import RuleError
from ...prolog.machine import Meter
from ...prolog.terms import Values, term_key


class StreamItem:
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
        self.key: Hashable = term_key(by[0]) if len(by) == 1 else tuple([term_key(one) for one in by])

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

    items: Tuple[StreamItem, ...]
    start: int
    end: int
    found: Values = ()
    error: Optional[RuleError] = None


KnownState = Tuple[Any, ...]
"""What an operator knows, as numbers, terms, items and lists of them."""


class StreamOperator(Protocol):
    """An operator on streams: a state that takes items and instants, and gives outputs on.

    It knows nothing of rules, events and their dispatch, and is the same for the same items and instants: what an
    event that is taken back has changed is found by running it again without that.

    Attributes:
        next: the instant at which `ring` has something to give on; None where only items do.
        late: how many items came too late to be taken.
        crowded: number of alternatives that were not followed, because one start had too many.
        tracked: whether outputs name the items that they are made of, a hundred at most, else the newest only.
        meter: counts the items that are looked at as pattern work; None if nothing is counted.
        allowed: gives the newest end that moves the time of the stream on; of later ones only the items are taken.
    """

    next: Optional[int]
    late: int
    crowded: int
    tracked: bool
    meter: Optional[Meter]
    allowed: Callable[[], int]

    def take(self, item: StreamItem, now: int, channel: int, /) -> List[StreamOutput]:
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
