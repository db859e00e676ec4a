"""Consumption policies: which waiting partners an event takes, and what becomes of them."""

from typing import (
    Any,
    Callable,
    Dict,
    Hashable,
    Iterable,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Tuple,
    TypeVar,
)

from ...prolog.machine.resource_limits import Meter
from ...prolog.terms.types import Frame
from .match_buffer import MatchBuffer, surely_same
from .partial_matches import PartialMatch, unify_sides

Emit = Callable[[PartialMatch, Frame], Frame]
_REMEMBERED = 2000
Join = Callable[[PartialMatch, PartialMatch], Optional[PartialMatch]]
_Matched = Callable[[PartialMatch, Hashable, PartialMatch, PartialMatch, Frame], Frame]
"""Takes a match, its key, a partner, their result and the next frame."""
_Among = Callable[[PartialMatch, Hashable, Iterator[PartialMatch], Frame], Frame]
_Others = Callable[[PartialMatch, Hashable, PartialMatch, Frame], Frame]
"""Takes a match, its key, a partner that does not fit, and the next frame."""
T = TypeVar("T")


class MatchSide(NamedTuple):
    """One operand of a two-sided node, as an arriving match sees it.

    Attributes:
        own: where matches of this side wait.
        other: where possible partners wait.
        join: gives the result of an arriving match and a partner, or None where they do not fit.
        shared: the positions of shared variables, this side's and the other's.
        left: whether this is the left operand.
        waits: whether a match without a partner waits.
        stays: whether it waits even after it has found one.
        wait: lets a match wait, where that is not to be at once.
    """

    own: MatchBuffer
    other: MatchBuffer
    join: Join
    shared: Tuple[Tuple[int, int], ...]
    left: bool
    waits: bool
    stays: bool
    wait: Optional[Callable[[PartialMatch, Hashable], None]] = None


def waiting_only(side: MatchSide) -> Emit:
    """Return what a match does that can complete nothing."""
    wait, key_of = side.own.add, side.own.key

    def arrive(match: PartialMatch, after: Frame) -> Frame:
        try:
            key = key_of(match.values)
        except ValueError:
            key = None
        wait(match, key)
        return after

    return arrive


def taking_one(
    side: MatchSide, newest: bool, uses: bool, emit: Emit, completed: Optional[Dict[Hashable, None]] = None
) -> Emit:
    """Return what a match does that takes one partner.

    Args:
        side: the operand at which it arrives.
        newest: whether it takes the newest that fits, else the oldest.
        uses: whether the partner is used up.
        emit: where results go.
        completed: where one single event may be at both sides: those that have completed as the right one.
    """
    own, other, join, waits = side.own, side.other, side.join, side.waits
    key_of = own.key
    waiting = other.newest
    wait = own.add if side.wait is None else side.wait
    matched = _matched(side, uses, emit, completed)
    among = _among(side, matched)
    others = _others(side, newest, among)

    def arrive(match: PartialMatch, after: Frame) -> Frame:
        try:
            key = key_of(match.values)
        except ValueError:
            return among(match, None, other.partners(None, match.start, match.end, newest), after)
        if None in waiting:
            return among(match, key, other.partners(key, match.start, match.end, newest), after)
        last = waiting.get(key)
        if last is not None:
            partner = last if newest else last.newer
            result = join(match, partner)
            if result is not None and partner.buffer is not None:
                return matched(match, key, partner, result, after)
            if last.older is not last:
                return others(match, key, partner, after)
        if waits:
            wait(match, key)
        return after

    if completed is not None and side.left:
        return _waiting_after_completion(arrive, own, completed)
    return arrive


def among_others(side: MatchSide, newest: bool, emit: Emit) -> _Others:
    """Return what gives a match, that uses partners up, one of those but one which does not fit."""
    return _others(side, newest, _among(side, _matched(side, True, emit, None)))


def _others(side: MatchSide, newest: bool, among: _Among) -> _Others:
    other = side.other

    def others(match: PartialMatch, key: Hashable, unfit: PartialMatch, after: Frame) -> Frame:
        found = other.partners(key, match.start, match.end, newest)
        return among(match, key, (one for one in found if one is not unfit), after)

    return others


def _among(side: MatchSide, matched: _Matched) -> _Among:
    """Return what gives a match the first partner that fits, of several; without one it waits."""
    waits = side.waits
    wait = side.own.add if side.wait is None else side.wait
    meter = side.own.rule.meter

    def among(match: PartialMatch, key: Hashable, partners: Iterator[PartialMatch], after: Frame) -> Frame:
        for partner in counted(partners, meter):
            result = join_any(side, match, key, partner)
            if result is not None and partner.buffer is not None:
                return matched(match, key, partner, result, after)
        if waits:
            wait(match, key)
        return after

    return among


def _matched(side: MatchSide, uses: bool, emit: Emit, completed: Optional[Dict[Hashable, None]]) -> _Matched:
    """Return what is done when a match and a partner have a result; see `taking_one`."""
    other, stays = side.other, side.stays
    wait = side.own.add if side.wait is None else side.wait
    remembered = None if side.left else completed

    def matched(
        match: PartialMatch, key: Hashable, partner: PartialMatch, result: PartialMatch, after: Frame
    ) -> Frame:
        if uses:
            other.remove(partner)
        match.used = partner
        if stays:
            wait(match, key)
        if remembered is not None and match.event is not None:
            if len(remembered) > _REMEMBERED:
                del remembered[next(iter(remembered))]
            remembered[match.event] = None
        return emit(result, after)

    return matched


def _waiting_after_completion(arrive: Emit, own: MatchBuffer, completed: Dict[Hashable, None]) -> Emit:
    """Have a single event that has completed as the right side only wait as the left one."""

    def as_left(match: PartialMatch, after: Frame) -> Frame:
        if match.event is not None and match.event in completed:
            own.add(match, own.key_of(match))
            return after
        return arrive(match, after)

    return as_left


def taking_all(side: MatchSide, emit: Emit) -> Emit:
    """Return what a match does that takes all partners and uses up none."""
    own, other, waits = side.own, side.other, side.waits
    wait = own.add if side.wait is None else side.wait
    key_of = own.key_of
    meter = own.rule.meter

    def arrive(match: PartialMatch, after: Frame) -> Frame:
        key = key_of(match)
        partners = other.partners_now(key, match.start, match.end)
        # It waits before results go out: what they lead to may be a partner, and each pair is seen once.
        if waits:
            wait(match, key)
        if not partners:
            return after
        if len(partners) == 1:
            partner = partners[0]
            result = None if partner.buffer is None else join_any(side, match, key, partner)
            return after if result is None else emit(result, after)
        results = (
            result
            for partner in counted(partners, meter)
            if partner.buffer is not None
            for result in (join_any(side, match, key, partner),)
            if result is not None
        )
        return emit_each(results, emit, after)

    return arrive


def taking_all_at_once(side: MatchSide, uses: bool, emit: Emit) -> Emit:
    """Return what a match does that takes all partners there are, using them up or itself."""
    own, other, waits, stays = side.own, side.other, side.waits, side.stays
    wait = own.add if side.wait is None else side.wait
    meter = own.rule.meter

    def arrive(match: PartialMatch, after: Frame) -> Frame:
        key = own.key_of(match)
        results: List[PartialMatch] = []
        for partner in counted(other.partners_now(key, match.start, match.end), meter):
            result = join_any(side, match, key, partner)
            if result is not None and partner.buffer is not None:
                if uses:
                    other.remove(partner)
                results.append(result)
        if stays or (waits and not results):
            wait(match, key)
        return emit_each(iter(results), emit, after)

    return arrive


def join_any(
    side: MatchSide, match: PartialMatch, key: Hashable, partner: PartialMatch
) -> Optional[PartialMatch]:
    """Join two matches whose shared values may have variables."""
    if surely_same(key, partner):
        return side.join(match, partner)
    sides = unify_sides(match, partner, side.shared)
    return None if sides is None else side.join(*sides)


def emit_each(results: Iterator[T], emit: Callable[[T, Frame], Frame], after: Frame) -> Frame:
    """Return the frame that emits one result after the other, each with all that it leads to."""
    burst = _Burst(results, emit)
    return burst.run((burst, after))


def counted(items: Iterable[T], meter: Optional[Meter]) -> Iterator[T]:
    """Return the items, each of which counts as a step of pattern work; they end where that has to stop."""
    return iter(items) if meter is None else _counted(items, meter)


def _counted(items: Iterable[T], meter: Meter) -> Iterator[T]:
    for item in items:
        if meter(1):
            return
        yield item


class _Burst:
    """Code of a frame that emits the results that are left."""

    __slots__ = ("results", "emit")

    def __init__(self, results: Iterator[Any], emit: Callable[[Any, Frame], Frame]):
        self.results = results
        self.emit = emit

    def run(self, frame: Frame) -> Frame:
        emit = self.emit
        for result in self.results:
            after = emit(result, frame)
            if after is not frame:
                return after
        return frame[1]  # type: ignore[no-any-return]
