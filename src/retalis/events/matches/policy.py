"""Consumption policies: which waiting partners an event takes, and what becomes of them."""

from enum import Enum
from typing import Any, Callable, Dict, Iterator, List, NamedTuple, Optional, Tuple

from .matches import Match, unify_sides
from .places import MatchBuffer, surely_same

Frame = Any
Emit = Callable[[Match, Frame], Frame]
_REMEMBERED = 2000
Join = Callable[[Match, Match], Any]


class Policy(Enum):
    """A consumption policy; see the table in the language reference."""

    RECENT = "recent"
    """The newest that fits; a newer occurrence of the same event replaces a waiting one."""
    RECENT_2 = "recent_2"
    """The newest that fits; identical events both wait."""
    CHRONOLOGICAL = "chronological"
    """The oldest that fits."""
    CHRONOLOGICAL_2 = "chronological_2"
    """The oldest that fits."""
    UNRESTRICTED = "unrestricted"
    """All that fit, oldest first; nothing is used up."""

    @property
    def newest(self) -> bool:
        """Whether the newest partner is taken first."""
        return self in (Policy.RECENT, Policy.RECENT_2)

    @property
    def consuming(self) -> bool:
        """Whether a partner is used up."""
        return self is not Policy.UNRESTRICTED

    @property
    def replacing(self) -> bool:
        """Whether a newer occurrence of the same event replaces the one that waits."""
        return self is Policy.RECENT


class NetworkOptions(NamedTuple):
    """How the network runs: set by flags, the same for all rules."""

    policy: Policy = Policy.RECENT
    out_of_order: bool = False
    tracked: bool = False
    revised: bool = False


class Side(NamedTuple):
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
    wait: Optional[Callable[[Match, Any], None]] = None


def waiting_only(side: Side) -> Emit:
    """Return what a match does that can complete nothing."""
    wait, key_of = side.own.add, side.own.key

    def arrive(match: Match, after: Frame) -> Frame:
        try:
            key = key_of(match.values)
        except ValueError:
            key = None
        wait(match, key)
        return after

    return arrive


def taking_one(
    side: Side, newest: bool, uses: bool, emit: Emit, completed: Optional[Dict[Any, None]] = None
) -> Emit:
    """Return what a match does that takes one partner.

    Args:
        side: the operand at which it arrives.
        newest: whether it takes the newest that fits, else the oldest.
        uses: whether the partner is used up.
        emit: where results go.
        completed: where one single event may be at both sides: those that have completed as the right one.
    """
    own, other, join, waits, stays = side.own, side.other, side.join, side.waits, side.stays
    key_of = own.key
    waiting = other.newest
    wait = side.own.add if side.wait is None else side.wait
    remembering = completed is not None and not side.left

    def arrive(match: Match, after: Frame) -> Frame:
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
                others = other.partners(key, match.start, match.end, newest)
                return among(match, key, (one for one in others if one is not partner), after)
        if waits:
            wait(match, key)
        return after

    def among(match: Match, key: Any, partners: Iterator[Match], after: Frame) -> Frame:
        for partner in partners:
            result = join_any(side, match, key, partner)
            if result is not None and partner.buffer is not None:
                return matched(match, key, partner, result, after)
        if waits:
            wait(match, key)
        return after

    def matched(match: Match, key: Any, partner: Match, result: Match, after: Frame) -> Frame:
        if uses:
            other.remove(partner)
        match.used = partner
        if stays:
            wait(match, key)
        if remembering and match.event is not None:
            if len(completed) > _REMEMBERED:  # type: ignore[arg-type]
                del completed[next(iter(completed))]  # type: ignore[union-attr, arg-type]
            completed[match.event] = None  # type: ignore[index]
        return emit(result, after)

    if completed is not None and side.left:
        return _waiting_after_completion(arrive, own, completed)
    return arrive


def _waiting_after_completion(arrive: Emit, own: MatchBuffer, completed: Dict[Any, None]) -> Emit:
    """Have a single event that has completed as the right side only wait as the left one."""

    def as_left(match: Match, after: Frame) -> Frame:
        if match.event is not None and match.event in completed:
            own.add(match, own.key_of(match))
            return after
        return arrive(match, after)

    return as_left


def taking_all(side: Side, emit: Emit) -> Emit:
    """Return what a match does that takes all partners and uses up none."""
    own, other, waits = side.own, side.other, side.waits
    wait = own.add if side.wait is None else side.wait
    key_of = own.key_of

    def arrive(match: Match, after: Frame) -> Frame:
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
            for partner in partners
            if partner.buffer is not None
            for result in (join_any(side, match, key, partner),)
            if result is not None
        )
        return emit_each(results, emit, after)

    return arrive


def taking_all_at_once(side: Side, uses: bool, emit: Emit) -> Emit:
    """Return what a match does that takes all partners there are, using them up or itself."""
    own, other, waits, stays = side.own, side.other, side.waits, side.stays
    wait = own.add if side.wait is None else side.wait

    def arrive(match: Match, after: Frame) -> Frame:
        key = own.key_of(match)
        results: List[Match] = []
        for partner in other.partners_now(key, match.start, match.end):
            result = join_any(side, match, key, partner)
            if result is not None and partner.buffer is not None:
                if uses:
                    other.remove(partner)
                results.append(result)
        if stays or (waits and not results):
            wait(match, key)
        return emit_each(iter(results), emit, after)

    return arrive


def join_any(side: Side, match: Match, key: Any, partner: Match) -> Any:
    """Join two matches whose shared values may have variables."""
    if surely_same(key, partner):
        return side.join(match, partner)
    sides = unify_sides(match, partner, side.shared)
    return None if sides is None else side.join(*sides)


def emit_each(results: Any, emit: Callable[[Any, Frame], Frame], after: Frame) -> Frame:
    """Return the frame that emits one result after the other, each with all that it leads to."""
    burst = _Burst(results, emit)
    return burst.run((burst, after))


class _Burst:
    """Code of a frame that emits the results that are left."""

    __slots__ = ("results", "emit")

    def __init__(self, results: Any, emit: Callable[[Any, Frame], Frame]):
        self.results = results
        self.emit = emit

    def run(self, frame: Frame) -> Frame:
        emit = self.emit
        for result in self.results:
            after = emit(result, frame)
            if after is not frame:
                return after
        return frame[1]
