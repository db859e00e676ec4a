"""What operators on streams would have given on without an event that is taken back: they are run again."""

from collections import Counter
from typing import Any, Callable, Dict, Hashable, List, Optional, Tuple

from ...prolog.machine import Meter
from ...prolog.terms import term_key
from ..matches import Held, Match, counted, taken_back
from ..streams import KnownState, StreamItem, StreamOperator, StreamOutput

KEPT = 10_000
"""How many items are remembered in one node; what is older is settled but for those that are held."""


class Replay:
    """Remembers what an operator on streams has taken and given on.

    Args:
        begin: makes the operator anew.
        known: what it knows already; that is settled.
    """

    def __init__(self, begin: Callable[[], StreamOperator], known: KnownState = ()):
        self._begin = begin
        self._base: KnownState = _copied(known)
        self._taken: List[Tuple[int, StreamItem, int]] = []
        self._given: List[Tuple[StreamOutput, Held]] = []
        self._new: List[StreamOutput] = []
        self._forgotten: Dict[int, Match] = {}

    def __len__(self) -> int:
        return len(self._taken)

    def begin_step(self, stream: StreamOperator) -> None:
        """Settle what has been, if it is much, before the operator takes an item or gives on what is due."""
        if len(self._taken) >= KEPT or len(self._given) >= KEPT:
            self._base = _copied(stream.kept())
            self._taken, self._given = [], []

    def took(self, channel: int, item: StreamItem, now: int) -> None:
        """Remember an item that was taken."""
        self._taken.append((channel, _again(item), now))

    def gave(self, output: StreamOutput, held: Held) -> None:
        """Remember what was given on, and what stands for it."""
        self._given.append((output, held))

    def forget(self, match: Match) -> bool:
        """Forget a match when the operator is run again; return True, as that may give other outputs then."""
        self._forgotten[id(match)] = match
        return True

    def run_again(self, now: int, meter: Optional[Meter]) -> Optional[Tuple[StreamOperator, List[Held]]]:
        """Run the operator again over what is left.

        Args:
            now: the present instant.
            meter: counts the items as pattern work; None if nothing is counted.

        Returns:
            The operator as it stands then, and what stands for outputs that are no longer there. Those that are
            new are kept for `take_new`. None if pattern work had to stop: then nothing here is of use any more, as
            outputs that were left out would be taken back.
        """
        forgotten = self._forgotten
        self._taken = [one for one in self._taken if id(one[1].match) not in forgotten]
        self._forgotten = {}
        stream = self._begin()
        if self._base:
            stream.restore(_without_what_is_gone(_copied(self._base)))
        outputs: List[StreamOutput] = []
        for channel, item, instant in counted(self._taken, meter):
            outputs += stream.ring(instant)
            outputs += stream.take(_again(item), instant, channel)
        outputs += stream.ring(now)
        if meter is not None and meter(0):
            return None
        outputs = [output for output in outputs if output.error is None]  # such was reported already
        there = Counter(_key(output) for output in outputs)
        stand: List[Tuple[StreamOutput, Held]] = []
        lost: List[Held] = []
        for output, held in self._given:
            if held.gone:
                continue
            key = _key(output)
            if there[key]:
                there[key] -= 1
                stand.append((output, held))
            else:
                lost.append(held)
        self._given = stand
        self._new = []
        for output in reversed(outputs):  # of equal ones the last are those that are new
            if there[_key(output)]:
                there[_key(output)] -= 1
                self._new.append(output)
        self._new.reverse()
        return stream, lost

    def take_new(self) -> List[StreamOutput]:
        """Return the outputs that `run_again` has found to be there now and that were not before, once."""
        found, self._new = self._new, []
        return found

    def kept(self) -> Tuple[Any, ...]:
        """Return what is remembered; see `restore`."""
        given = [((list(output.items), *output[1:]), held) for output, held in self._given]
        return (self._base, self._taken, given)

    def restore(self, kept: Tuple[Any, ...]) -> None:
        """Remember what another one did."""
        self._base, self._taken, given = kept
        self._given = [(StreamOutput(tuple(items), *rest), held) for (items, *rest), held in given]
        if self._base:  # what cannot be run again is to fail now, not when an event is taken back
            self._begin().restore(_copied(self._base))


def _again(item: StreamItem) -> StreamItem:
    """Return the same item as it came."""
    return StreamItem(item.match, item.start, item.end, item.by, item.values)


def _copied(data: Any) -> Any:
    """Return what an operator knows with copies of the items, which change as it goes on."""
    if isinstance(data, StreamItem):
        made = _again(data)
        made.order = data.order
        return made
    if data.__class__ is list:
        return [_copied(one) for one in data]
    if data.__class__ is tuple and any(one.__class__ in (list, tuple, StreamItem) for one in data):
        return tuple([_copied(one) for one in data])
    return data


def _without_what_is_gone(data: Any) -> Any:
    """Return what an operator knows without the items whose events were taken back."""
    if data.__class__ is list:
        return [
            _without_what_is_gone(one)
            for one in data
            if not (isinstance(one, StreamItem) and one.match is not None and taken_back(one.match))
        ]
    if data.__class__ is tuple and any(one.__class__ in (list, tuple) for one in data):
        return tuple([_without_what_is_gone(one) for one in data])
    return data


def _key(output: StreamOutput) -> Hashable:
    """Return what tells one output from another: what it is made of last, its interval, and what was found."""
    last = output.items[-1]
    named = last.by if output.found else ()
    found = tuple([term_key(one) for one in (*named, *output.found)])
    return (id(last.match) if not output.found else None, output.start, output.end, found)
