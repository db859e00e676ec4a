"""Consumption policies: selection and consumption of the partners of an arriving match.

A two-sided node of the Rete network has a buffer of partial matches for each operand (the beta memories). If a match
arrives at one operand, the policy decides which matches in the other buffer it joins with, and which matches are
removed. The policies correspond to the parameter contexts of Snoop and to the consumption modes of other CEP
systems:

* `join_one_partner`: join with one partner, the newest (``recent``) or the oldest (``chronological``). Partners that
  do not satisfy the join are skipped. The chosen partner is consumed.
* `join_all_partners`: join with every partner and consume none (``unrestricted``).
* `join_all_at_once`: join with every partner that is stored now and consume those, or the arriving match.
* `store_only`: store the match. This is the left operand of a sequence, because a right operand that is already
  stored cannot come after it.

Each function compiles its choices into a closure, so that an arriving match tests no options. The closures follow
the protocol of the Prolog machine: they take the match and the frame to continue with, and return the next frame.
Results are emitted one by one through frames. A result is therefore processed completely, including all events that
it leads to, before the next pair is joined.
"""

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
from .match_buffer import MatchBuffer, has_equal_key
from .partial_matches import PartialMatch, unify_sides

Emit = Callable[[PartialMatch, Frame], Frame]
_MAX_COMPLETED_EVENTS = 2000
Join = Callable[[PartialMatch, PartialMatch], Optional[PartialMatch]]
_Matched = Callable[[PartialMatch, Hashable, PartialMatch, PartialMatch, Frame], Frame]
"""Takes a match, its key, a partner, their result and the next frame."""
_Among = Callable[[PartialMatch, Hashable, Iterator[PartialMatch], Frame], Frame]
_Others = Callable[[PartialMatch, Hashable, PartialMatch, Frame], Frame]
"""Takes a match, its key, a partner that does not satisfy the join, and the next frame."""
T = TypeVar("T")


class MatchSide(NamedTuple):
    """One operand of a two-sided node, as seen by a match that arrives at it.

    Attributes:
        own: buffer of the matches of this operand.
        other: buffer of the possible partners.
        join: returns the result of an arriving match and a partner, or None if they do not satisfy the join.
        shared: positions of the shared variables, in the values of this operand and of the other one.
        left: whether this is the left operand.
        waits: whether a match without a partner is stored.
        stays: whether a match is stored even if it has joined with a partner.
        wait: stores a match, if that is not to happen immediately; None to add it to ``own``.
    """

    own: MatchBuffer
    other: MatchBuffer
    join: Join
    shared: Tuple[Tuple[int, int], ...]
    left: bool
    waits: bool
    stays: bool
    wait: Optional[Callable[[PartialMatch, Hashable], None]] = None


def store_only(side: MatchSide) -> Emit:
    """Return the action for a match that is only stored, because no stored partner can complete it."""
    wait, key_of = side.own.add, side.own.key

    def arrive(match: PartialMatch, after: Frame) -> Frame:
        try:
            key = key_of(match.values)
        except ValueError:
            key = None
        wait(match, key)
        return after

    return arrive


def join_one_partner(
    side: MatchSide, newest: bool, uses: bool, emit: Emit, completed: Optional[Dict[Hashable, None]] = None
) -> Emit:
    """Return the action for a match that joins with one partner.

    Args:
        side: the operand at which the match arrives.
        newest: whether the newest partner that satisfies the join is chosen, else the oldest.
        uses: whether the partner is consumed.
        emit: receives the results.
        completed: the events that have completed a pair as the right operand, if one event can be in both operands;
            else None.
    """
    own_buffer, other_buffer, join, waits = side.own, side.other, side.join, side.waits
    key_of = own_buffer.key
    waiting = other_buffer.newest
    wait = own_buffer.add if side.wait is None else side.wait
    matched = _matched(side, uses, emit, completed)
    among = _among(side, matched)
    others = _others(side, newest, among)

    def arrive(match: PartialMatch, after: Frame) -> Frame:
        try:
            key = key_of(match.values)
        # A shared value with variables has no hash key. All stored matches are candidates, and each of them is
        # unified.
        except ValueError:
            return among(match, None, other_buffer.partners(None, match.start, match.end, newest), after)
        # Stored matches with variables in shared values are candidates for every key; `partners` merges both rings.
        if None in waiting:
            return among(match, key, other_buffer.partners(key, match.start, match.end, newest), after)
        last = waiting.get(key)
        # The common case is written out: if the first candidate satisfies the join, no iterator is created.
        if last is not None:
            partner = last if newest else last.newer
            result = join(match, partner)
            # The join may call conditions that make events, and those may remove the partner; check it again.
            if result is not None and partner.buffer is not None:
                return matched(match, key, partner, result, after)
            if last.older is not last:
                return others(match, key, partner, after)
        if waits:
            wait(match, key)
        return after

    if completed is not None and side.left:
        return _store_after_completion(arrive, own_buffer, completed)
    return arrive


def join_one_of_others(side: MatchSide, newest: bool, emit: Emit) -> _Others:
    """Return the action that joins a match, which consumes partners, with one of all partners except a given one.

    Fused code tries the first candidate itself and calls this action if that one does not satisfy the join.
    """
    return _others(side, newest, _among(side, _matched(side, True, emit, None)))


def _others(side: MatchSide, newest: bool, among: _Among) -> _Others:
    other_buffer = side.other

    def others(match: PartialMatch, key: Hashable, unfit: PartialMatch, after: Frame) -> Frame:
        candidates = other_buffer.partners(key, match.start, match.end, newest)
        return among(match, key, (candidate for candidate in candidates if candidate is not unfit), after)

    return others


def _among(side: MatchSide, matched: _Matched) -> _Among:
    """Return the action that joins a match with the first of several candidates that satisfies the join.

    If there is none, the match is stored.
    """
    waits = side.waits
    wait = side.own.add if side.wait is None else side.wait
    meter = side.own.rule.meter

    def among(match: PartialMatch, key: Hashable, partners: Iterator[PartialMatch], after: Frame) -> Frame:
        for partner in metered(partners, meter):
            result = unify_and_join(side, match, key, partner)
            if result is not None and partner.buffer is not None:
                return matched(match, key, partner, result, after)
        if waits:
            wait(match, key)
        return after

    return among


def _matched(side: MatchSide, uses: bool, emit: Emit, completed: Optional[Dict[Hashable, None]]) -> _Matched:
    """Return the action for a match and a partner that have a result; see `join_one_partner`."""
    other_buffer, stays = side.other, side.stays
    wait = side.own.add if side.wait is None else side.wait
    remembered = None if side.left else completed

    def matched(
        match: PartialMatch, key: Hashable, partner: PartialMatch, result: PartialMatch, after: Frame
    ) -> Frame:
        if uses:
            other_buffer.remove(partner)
        match.used = partner
        if stays:
            wait(match, key)
        if remembered is not None and match.event is not None:
            # Only events that are still being dispatched can arrive at the left operand too, so old entries are
            # dropped.
            if len(remembered) > _MAX_COMPLETED_EVENTS:
                del remembered[next(iter(remembered))]
            remembered[match.event] = None
        return emit(result, after)

    return matched


def _store_after_completion(arrive: Emit, own: MatchBuffer, completed: Dict[Hashable, None]) -> Emit:
    """Return an action that only stores an event at the left operand if it has completed a pair as the right operand.

    Otherwise one event would complete two pairs of an operator such as ``and``.
    """

    def as_left(match: PartialMatch, after: Frame) -> Frame:
        if match.event is not None and match.event in completed:
            own.add(match, own.key_of(match))
            return after
        return arrive(match, after)

    return as_left


def join_all_partners(side: MatchSide, emit: Emit) -> Emit:
    """Return the action for a match that joins with all partners and consumes none."""
    own_buffer, other_buffer, waits = side.own, side.other, side.waits
    wait = own_buffer.add if side.wait is None else side.wait
    key_of = own_buffer.key_of
    meter = own_buffer.rule.meter

    def arrive(match: PartialMatch, after: Frame) -> Frame:
        key = key_of(match)
        partners = other_buffer.partners_now(key, match.start, match.end)
        # The match is stored before results are emitted. Events that follow from them may be partners of it, and
        # each pair is joined once: by the match that arrives later.
        if waits:
            wait(match, key)
        if not partners:
            return after
        if len(partners) == 1:
            partner = partners[0]
            result = None if partner.buffer is None else unify_and_join(side, match, key, partner)
            return after if result is None else emit(result, after)
        # The generator joins each pair only when the results before it are processed. Those may remove further
        # partners.
        results = (
            result
            for partner in metered(partners, meter)
            if partner.buffer is not None
            for result in (unify_and_join(side, match, key, partner),)
            if result is not None
        )
        return emit_each(results, emit, after)

    return arrive


def join_all_at_once(side: MatchSide, uses: bool, emit: Emit) -> Emit:
    """Return the action for a match that joins with all stored partners and consumes them, or is consumed itself."""
    own_buffer, other_buffer, waits, stays = side.own, side.other, side.waits, side.stays
    wait = own_buffer.add if side.wait is None else side.wait
    meter = own_buffer.rule.meter

    def arrive(match: PartialMatch, after: Frame) -> Frame:
        key = own_buffer.key_of(match)
        # All pairs are joined before any result is emitted: an event that follows from the first result must not
        # add a partner to the same set.
        results: List[PartialMatch] = []
        for partner in metered(other_buffer.partners_now(key, match.start, match.end), meter):
            result = unify_and_join(side, match, key, partner)
            if result is not None and partner.buffer is not None:
                if uses:
                    other_buffer.remove(partner)
                results.append(result)
        if stays or (waits and not results):
            wait(match, key)
        return emit_each(iter(results), emit, after)

    return arrive


def unify_and_join(
    side: MatchSide, match: PartialMatch, key: Hashable, partner: PartialMatch
) -> Optional[PartialMatch]:
    """Join two matches whose shared values may contain variables."""
    if has_equal_key(key, partner):
        return side.join(match, partner)
    sides = unify_sides(match, partner, side.shared)
    return None if sides is None else side.join(*sides)


def emit_each(results: Iterator[T], emit: Callable[[T, Frame], Frame], after: Frame) -> Frame:
    """Return the frame that emits the results one after the other, each with all events that follow from it."""
    burst = _ResultEmission(results, emit)
    return burst.run((burst, after))


def metered(items: Iterable[T], meter: Optional[Meter]) -> Iterator[T]:
    """Return an iterator that counts each item as a step of pattern work, and stops if the limit is reached."""
    return iter(items) if meter is None else _metered(items, meter)


def _metered(items: Iterable[T], meter: Meter) -> Iterator[T]:
    for item in items:
        if meter(1):
            return
        yield item


class _ResultEmission:
    """Frame code that emits the remaining results."""

    __slots__ = ("results", "emit")

    def __init__(self, results: Iterator[Any], emit: Callable[[Any, Frame], Frame]):
        self.results = results
        self.emit = emit

    def run(self, frame: Frame) -> Frame:
        emit = self.emit
        for result in self.results:
            # The frame itself is the continuation. If the emitted result starts other work, that work returns to
            # this frame, and the loop continues with the next result.
            after = emit(result, frame)
            if after is not frame:
                return after
        return frame[1]  # type: ignore[no-any-return]
