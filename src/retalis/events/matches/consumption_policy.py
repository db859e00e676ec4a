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

Revision: if an event is retracted, matches that a negation had prevented may arise, and results of runs are computed
again. Such a *revived* match arrives later than its events did. It must join exactly the partners that it would have
joined if the retracted event had never existed. In a sequence with events in order, a second operand is not stored,
because no first operand arrives after it. If first operands can be revived, `RetainedMatches` keeps a bounded number
of second operands for them. A revived first operand joins the first of those that arrived after it and is still
valid; a revived second operand joins only first operands that had arrived before it. The order of arrival is the
number of the last event of a match, see `arrival_number_of`.
"""

from collections import deque
from typing import (
    Any,
    Callable,
    Deque,
    Dict,
    Hashable,
    Iterable,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
    TypeVar,
)

from ...prolog.machine.resource_limits import Meter
from ...prolog.terms.types import Frame
from ...serialization.state_fields import StateFields, StateOwner, constraint, field
from ...serialization.stored_field_types import sequence_of
from .match_buffer import MatchBuffer, has_equal_key
from .match_types import MATCH_REFERENCE, PartialMatch, arrival_number_of, lineage_sources, unify_sides

Emit = Callable[[PartialMatch, Frame], Frame]
"""Takes a match and the frame to continue with; returns the next frame."""
_MAX_COMPLETED_EVENTS = 2000
"""Maximum number of events that are remembered because they have completed a pair; see `join_one_partner`."""
MAX_RETAINED_MATCHES = 10_000
"""Maximum number of second operands that are retained in one buffer."""
Join = Callable[..., Optional[PartialMatch]]
"""Returns the result of an arriving match and a partner; None if they do not satisfy the join.

If these are copies, whose values are unified, a third argument is the pair of the stored matches.
"""
_FinishJoin = Callable[[PartialMatch, Hashable, PartialMatch, PartialMatch, Frame], Frame]
"""Takes a match, its key, a partner, their result and the next frame."""
_JoinFirstOf = Callable[[PartialMatch, Hashable, Iterator[PartialMatch], Frame], Frame]
"""Takes a match, its key, the possible partners, and the next frame."""
_JoinOtherThan = Callable[[PartialMatch, Hashable, PartialMatch, Frame], Frame]
"""Takes a match, its key, a partner that does not satisfy the join, and the next frame."""
T = TypeVar("T")


class MatchSide(NamedTuple):
    """One operand of a two-sided node, as seen by a match that arrives at it.

    Attributes:
        other_buffer: buffer of the possible partners.
        join: returns the result of an arriving match and a partner, or None if they do not satisfy the join.
        shared: positions of the shared variables, in the values of this operand and of the other one.
        is_left: whether this is the left operand.
        stores_unmatched: whether a match without a partner is stored.
        stores_matched: whether a match is stored even if it has joined with a partner.
        store: stores a match, if that is not to happen immediately; None to add it to ``own_buffer``.
    """

    own_buffer: MatchBuffer
    other_buffer: MatchBuffer
    join: Join
    shared: Tuple[Tuple[int, int], ...]
    is_left: bool
    stores_unmatched: bool
    stores_matched: bool
    store: Optional[Callable[[PartialMatch, Hashable], None]] = None


def store_only(side: MatchSide) -> Emit:
    """Return the action for a match that is only stored, because no stored partner can complete it."""
    store, key_of = side.own_buffer.add, side.own_buffer.compute_key

    def on_match(match: PartialMatch, frame: Frame) -> Frame:
        try:
            key = key_of(match.values)
        except ValueError:
            key = None
        store(match, key)
        return frame

    return on_match


def join_one_partner(
    side: MatchSide,
    newest: bool,
    emit: Emit,
    completed: Optional[Dict[Hashable, None]] = None,
) -> Emit:
    """Return the action for a match that joins with one partner and consumes it.

    Args:
        side: the operand at which the match arrives.
        newest: whether the newest partner that satisfies the join is chosen, else the oldest.
        emit: receives the results.
        completed: the events that have completed a pair as the right operand, if one event can be in both operands;
            else None.
    """
    own_buffer, other_buffer, join, stores_unmatched = (
        side.own_buffer,
        side.other_buffer,
        side.join,
        side.stores_unmatched,
    )
    key_of = own_buffer.compute_key
    newest_partners = other_buffer.newest
    store = own_buffer.add if side.store is None else side.store
    finish_join = _finish_join(side, emit, completed)
    join_first_of = _join_first_of(side, finish_join)
    try_others = _join_other_than(side, newest, join_first_of)

    def on_match(match: PartialMatch, frame: Frame) -> Frame:
        try:
            key = key_of(match.values)
        # A shared value with variables has no hash key. All stored matches are candidates, and each of them is
        # unified.
        except ValueError:
            return join_first_of(
                match, None, other_buffer.partners(None, match.start, match.end, newest), frame
            )
        # Stored matches with variables in shared values are candidates for every key; `partners` merges both rings.
        if None in newest_partners:
            return join_first_of(
                match, key, other_buffer.partners(key, match.start, match.end, newest), frame
            )
        newest_partner = newest_partners.get(key)
        # The common case is written out: if the first candidate satisfies the join, no iterator is created.
        if newest_partner is not None:
            partner = newest_partner if newest else newest_partner.newer
            result = join(match, partner)
            # The join may call conditions that make events, and those may remove the partner; check it again.
            if result is not None and partner.buffer is not None:
                return finish_join(match, key, partner, result, frame)
            if newest_partner.older is not newest_partner:
                return try_others(match, key, partner, frame)
        if stores_unmatched:
            store(match, key)
        return frame

    if completed is not None and side.is_left:
        return _store_after_completion(on_match, own_buffer, completed)
    return on_match


def join_one_of_others(side: MatchSide, newest: bool, emit: Emit) -> _JoinOtherThan:
    """Return the action that joins a match, which consumes partners, with one of all partners except a given one.

    Fused code tries the first candidate itself and calls this action if that one does not satisfy the join.
    """
    return _join_other_than(side, newest, _join_first_of(side, _finish_join(side, emit, None)))


def _join_other_than(side: MatchSide, newest: bool, join_first_of: _JoinFirstOf) -> _JoinOtherThan:
    other_buffer = side.other_buffer

    def try_others(match: PartialMatch, key: Hashable, rejected: PartialMatch, frame: Frame) -> Frame:
        candidates = other_buffer.partners(key, match.start, match.end, newest)
        return join_first_of(
            match, key, (candidate for candidate in candidates if candidate is not rejected), frame
        )

    return try_others


def _join_first_of(side: MatchSide, finish_join: _FinishJoin) -> _JoinFirstOf:
    """Return the action that joins a match with the first of several candidates that satisfies the join.

    If there is none, the match is stored.
    """
    stores_unmatched = side.stores_unmatched
    store = side.own_buffer.add if side.store is None else side.store
    meter = side.own_buffer.rule.meter

    def join_first_of(
        match: PartialMatch, key: Hashable, partners: Iterator[PartialMatch], frame: Frame
    ) -> Frame:
        for partner in metered(partners, meter):
            result = unify_and_join(side, match, key, partner)
            if result is not None and partner.buffer is not None:
                return finish_join(match, key, partner, result, frame)
        if stores_unmatched:
            store(match, key)
        return frame

    return join_first_of


def _finish_join(side: MatchSide, emit: Emit, completed: Optional[Dict[Hashable, None]]) -> _FinishJoin:
    """Return the action for a match and a partner that have a result; see `join_one_partner`."""
    other_buffer, stores_matched = side.other_buffer, side.stores_matched
    store = side.own_buffer.add if side.store is None else side.store
    completed_events = None if side.is_left else completed

    def finish_join(
        match: PartialMatch, key: Hashable, partner: PartialMatch, result: PartialMatch, frame: Frame
    ) -> Frame:
        other_buffer.remove(partner)
        match.consumed_by = partner
        if stores_matched:
            store(match, key)
        if completed_events is not None and match.event is not None:
            # Only events that are still being dispatched can arrive at the left operand too, so old entries are
            # dropped.
            if len(completed_events) > _MAX_COMPLETED_EVENTS:
                del completed_events[next(iter(completed_events))]
            completed_events[match.event] = None
        return emit(result, frame)

    return finish_join


def _store_after_completion(on_match: Emit, own_buffer: MatchBuffer, completed: Dict[Hashable, None]) -> Emit:
    """Return an action that only stores an event at the left operand if it has completed a pair as the right operand.

    Otherwise one event would complete two pairs of an operator such as ``and``.
    """

    def on_left_match(match: PartialMatch, frame: Frame) -> Frame:
        if match.event is not None and match.event in completed:
            own_buffer.add(match, own_buffer.key_of(match))
            return frame
        return on_match(match, frame)

    return on_left_match


def join_all_partners(side: MatchSide, emit: Emit) -> Emit:
    """Return the action for a match that joins with all partners and consumes none."""
    own_buffer, other_buffer, stores_unmatched = side.own_buffer, side.other_buffer, side.stores_unmatched
    store = own_buffer.add if side.store is None else side.store
    key_of = own_buffer.key_of
    meter = own_buffer.rule.meter

    def on_match(match: PartialMatch, frame: Frame) -> Frame:
        key = key_of(match)
        partners = other_buffer.partner_list(key, match.start, match.end)
        # The match is stored before results are emitted. Events that follow from them may be partners of it, and
        # each pair is joined once: by the match that arrives later.
        if stores_unmatched:
            store(match, key)
        if not partners:
            return frame
        if len(partners) == 1:
            partner = partners[0]
            result = None if partner.buffer is None else unify_and_join(side, match, key, partner)
            return frame if result is None else emit(result, frame)
        # The generator joins each pair only when the results before it are processed. Those may remove further
        # partners.
        results = (
            result
            for partner in metered(partners, meter)
            if partner.buffer is not None
            for result in (unify_and_join(side, match, key, partner),)
            if result is not None
        )
        return emit_each(results, emit, frame)

    return on_match


def join_all_at_once(side: MatchSide, consumes: bool, emit: Emit) -> Emit:
    """Return the action for a match that joins with all stored partners and consumes them, or is consumed itself."""
    own_buffer, other_buffer, stores_unmatched, stores_matched = (
        side.own_buffer,
        side.other_buffer,
        side.stores_unmatched,
        side.stores_matched,
    )
    store = own_buffer.add if side.store is None else side.store
    meter = own_buffer.rule.meter

    def on_match(match: PartialMatch, frame: Frame) -> Frame:
        key = own_buffer.key_of(match)
        # All pairs are joined before any result is emitted: an event that follows from the first result must not
        # add a partner to the same set.
        results: List[PartialMatch] = []
        for partner in metered(other_buffer.partner_list(key, match.start, match.end), meter):
            result = unify_and_join(side, match, key, partner)
            if result is not None and partner.buffer is not None:
                if consumes:
                    other_buffer.remove(partner)
                results.append(result)
        if stores_matched or (stores_unmatched and not results):
            store(match, key)
        return emit_each(iter(results), emit, frame)

    return on_match


def unify_and_join(
    side: MatchSide, match: PartialMatch, key: Hashable, partner: PartialMatch
) -> Optional[PartialMatch]:
    """Return the result of two matches, whose shared values are unified if they may contain variables."""
    if has_equal_key(key, partner):
        return side.join(match, partner)
    sides = unify_sides(match, partner, side.shared)
    return None if sides is None else side.join(*sides, (match, partner))


def is_valid(match: Optional[PartialMatch]) -> bool:
    """Return whether a match is given and none of its events was retracted."""
    return match is not None and not any(
        getattr(token, "retracted", False) for token in lineage_sources(match)
    )


class RetainedMatches(StateOwner):
    """Second operands that are retained in a buffer; if there are too many, the oldest is removed.

    Args:
        accepts: returns whether a restored match is one of the operand.
    """

    STATE = StateFields(
        field("stored_matches", sequence_of(MATCH_REFERENCE)),
        constraint(
            "matches that its pattern can have",
            lambda retained, state: all(map(retained.accepts, state["stored_matches"])),
        ),
    )

    def __init__(self, buffer: MatchBuffer, accepts: Callable[[PartialMatch], bool]):
        self.buffer = buffer
        self.accepts = accepts
        self._retained: Deque[PartialMatch] = deque()

    @property
    def stored_matches(self) -> List[PartialMatch]:
        """The retained matches, oldest first; restored ones are stored in the buffer already."""
        return [match for match in self._retained if match.buffer is not None]

    @stored_matches.setter
    def stored_matches(self, matches: Sequence[PartialMatch]) -> None:
        self._retained = deque(matches)

    def add(self, match: PartialMatch, key: Hashable) -> None:
        """Store and retain a match; see `MatchBuffer.add`."""
        self.buffer.add(match, key)
        self._retained.append(match)
        if len(self._retained) > min(MAX_RETAINED_MATCHES, self.buffer.rule.max_stored // 2):
            self._retained.popleft().discard()


def is_revived(current_number: Callable[[], int], arrival_number: int) -> bool:
    """Return whether a match whose last event has a number is revived: it does not contain the current event."""
    return arrival_number < current_number()


def join_revived_first(
    current_number: Callable[[], int], side: MatchSide, consumes: bool, joins_all: bool, emit: Emit
) -> Emit:
    """Return the action for a first operand: it is stored, or joins with later second operands if it is revived.

    Args:
        current_number: returns the number of the current event.
        side: the first operand, with the buffer of the partners to search.
        consumes: whether the policy consumes partners.
        joins_all: whether a second operand joins with all stored first ones and is not consumed by them.
        emit: receives the results.
    """
    own_buffer, other_buffer = side.own_buffer, side.other_buffer

    def on_match(match: PartialMatch, frame: Frame) -> Frame:
        key = own_buffer.key_of(match)
        arrival_number = arrival_number_of(match)
        results: List[PartialMatch] = []
        if is_revived(current_number, arrival_number):
            for partner in metered(
                other_buffer.partner_list(key, match.start, match.end), own_buffer.rule.meter
            ):
                # Only partners that arrived later and were not consumed by a match that is still valid would have
                # been available.
                if arrival_number_of(partner) <= arrival_number or (
                    consumes and not joins_all and is_valid(partner.consumed_by)
                ):
                    continue
                result = unify_and_join(side, match, key, partner)
                if result is not None:
                    results.append(result)
                    if consumes:
                        partner.consumed_by = match
                    if consumes or joins_all:
                        break
        if not results or not (consumes or joins_all):
            own_buffer.add(match, key)
        return emit_each(iter(results), emit, frame)

    return on_match


def join_in_order(current_number: Callable[[], int], join: Join) -> Join:
    """Return a join of a second and a first operand for second operands that may be revived.

    A revived second operand joins only with first operands that arrived before it.
    """

    def join_if_earlier(
        match: PartialMatch,
        partner: PartialMatch,
        originals: Optional[Tuple[PartialMatch, PartialMatch]] = None,
    ) -> Optional[PartialMatch]:
        arrival_number = arrival_number_of(match)
        if is_revived(current_number, arrival_number) and arrival_number_of(partner) >= arrival_number:
            return None
        return join(match, partner, originals)

    return join_if_earlier


def earlier_partners(
    match: PartialMatch, partners: Iterable[PartialMatch], current_number: Callable[[], int]
) -> Iterable[PartialMatch]:
    """Return the partners that a match may join: all, or the earlier ones if the match is revived."""
    arrival_number = arrival_number_of(match)
    return (
        [partner for partner in partners if arrival_number_of(partner) < arrival_number]
        if is_revived(current_number, arrival_number)
        else partners
    )


def emit_each(results: Iterator[T], emit: Callable[[T, Frame], Frame], frame: Frame) -> Frame:
    """Return the frame that emits the results one after the other, each with all events that follow from it."""
    emission = _ResultEmission(results, emit)
    return emission.run((emission, frame))


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
            next_frame = emit(result, frame)
            if next_frame is not frame:
                return next_frame
        return frame[1]  # type: ignore[no-any-return]
