"""Index of listeners: by functor of the pattern, then by the constants in its arguments.

Both levels are dictionaries, so an event has no cost for listeners with other constants. The index also owns what
depends on the set of listeners, and invalidates it when a listener is added or removed: plans (see
`discrimination_tree`), pushdown filters, fused actions and argument projections.
"""

from itertools import count
from typing import AbstractSet, Callable, Collection, Dict, Hashable, List, Optional, Tuple
from weakref import WeakValueDictionary

from ...foundation.bounded_caches import Cache
from ...foundation.errors import UsageError
from ...prolog.terms.term_traversal import copy, term_key
from ...prolog.terms.types import Atom, EventAction, Functor, Term, Var
from .discrimination_tree import Plan, PushdownFilter, make_plan, matches_all_events
from .listeners import ArgumentProjection, Listener, ListenerPhase, unread_positions
from .matcher_compiler import Matcher, compile_matcher


def do_nothing() -> None:
    """Do nothing."""


_MIN_FILTERS_TO_SWEEP = 1000
"""Number of functors with filters above which unused filters are removed."""


class ListenerIndex:
    """Listeners of events, with the plans, filters and fused actions that are derived from them.

    Attributes:
        fused_actions: by functor, action that takes an event without its values; see `listen`.
        projection: arguments of events that no listener reads.
        on_change: called when listeners are added or removed; it must be fast and must not fail.
    """

    def __init__(self) -> None:
        self._listeners: Dict[Optional[Functor], Dict[Listener, None]] = {}
        self.projection = ArgumentProjection(self._listeners)
        self.on_change: Callable[[], object] = do_nothing
        self._plans: Cache[Functor, Plan] = Cache(10_000, 16 << 20)
        self.fused_actions: Dict[Functor, EventAction] = {}
        self._filters: Dict[Functor, WeakValueDictionary[Tuple[int, ...], PushdownFilter]] = {}
        self._sweep_threshold = _MIN_FILTERS_TO_SWEEP
        self._matchers: WeakValueDictionary[Hashable, Matcher] = WeakValueDictionary()
        self._numbers = count()

    def listen(
        self,
        phase: ListenerPhase,
        pattern: Term,
        action: EventAction,
        rank: Tuple[int, ...] = (),
        fused: bool = False,
        unused: AbstractSet[Var] = frozenset(),
    ) -> Listener:
        """Add a listener, whose ``action`` is called for every event that unifies with ``pattern``.

        A listener that is added while an event is dispatched gets later events only.

        Args:
            phase: phase in which it is called.
            pattern: an atom, a compound term, or a variable for all events. It is copied.
            action: processes a match and returns the next frame, which is its argument ``frame`` if it is finished.
            rank: position within the phase; by default after all others.
            fused: whether ``action`` may be called with None for the values, and then takes them from the event. This
                is done for ground input events, if the functor has no other listener and the pattern matches all its
                events.
            unused: variables of the pattern whose values are not read, so that they may be `NOT_READ`. If the pattern
                itself is such a variable, the listener gets events that contain `NOT_READ`.

        Raises:
            UsageError: if the pattern is a number or a string, which no event is.
        """
        unread = unread_positions(pattern, unused)
        accepts_omitted = pattern.__class__ is Var and pattern in unused
        # The caller may bind the variables of its own pattern later.
        pattern = copy(pattern)
        functor = _functor_of(pattern)
        key = term_key(pattern)
        # Rules often share patterns; equal patterns share one compiled function.
        matcher = self._matchers.get(key)
        if matcher is None:
            matcher = self._matchers[key] = compile_matcher(pattern)
        order = (int(phase), *(rank or (next(self._numbers),)), next(self._numbers))
        listener = Listener(order, pattern, functor, matcher, action, fused, unread, accepts_omitted)
        self._listeners.setdefault(functor, {})[listener] = None
        # The listener must be in the table before `reject_incomplete_events` runs; see `ArgumentProjection.announce`.
        self.projection.reject_incomplete_events(listener)
        self._invalidate_plans(functor)
        return listener

    def remove(self, listener: Listener) -> None:
        """Remove a listener; removing it twice is not an error."""
        group = self._listeners.get(listener.functor, {})
        # The value of a present listener is None, so the default 0 marks an absent one.
        if group.pop(listener, 0) is None:
            if not group:
                del self._listeners[listener.functor]
            self._invalidate_plans(listener.functor)

    def remove_all_except(self, phase: ListenerPhase, chosen: Collection[Listener]) -> None:
        """Remove all listeners of a phase except some."""
        for group in list(self._listeners.values()):
            for listener in list(group):
                if listener.order[0] == phase and listener not in chosen:
                    self.remove(listener)

    def event_filter(self, functor: Functor, positions: Tuple[int, ...] = ()) -> PushdownFilter:
        """Return a filter that decides whether an event can match a listener, see `PushdownFilter`.

        Args:
            functor: functor of the events.
            positions: the arguments that are known to the caller, counted from 1.
        """
        filters = self._filters.get(functor)
        if filters is None:
            # Removed rules and clauses free their filters, but leave empty entries for their functors.
            if len(self._filters) >= self._sweep_threshold:
                self._filters = {key: filters for key, filters in self._filters.items() if len(filters)}
                self._sweep_threshold = 2 * len(self._filters) + _MIN_FILTERS_TO_SWEEP
            filters = self._filters[functor] = WeakValueDictionary()
        event_filter = filters.get(positions)
        if event_filter is None:
            event_filter = filters[positions] = PushdownFilter(positions, self._plans.get(functor))
        return event_filter

    def has_listener_for_name(self, name: str) -> bool:
        """Return whether a pattern has this event name; patterns for all events are ignored."""
        return any(functor is not None and functor.name == name for functor in list(self._listeners))

    def _invalidate_plans(self, functor: Optional[Functor]) -> None:
        self.on_change()
        # A listener for all events takes part in every plan.
        if functor is None:
            self._plans.clear()
            self.fused_actions.clear()
        else:
            self._plans.pop(functor, None)
            self.fused_actions.pop(functor, None)
        for filters in list(self._filters.values()) if functor is None else self._filters_of(functor):
            for event_filter in list(filters.values()):
                event_filter.plan = None

    def _filters_of(self, functor: Functor) -> "List[WeakValueDictionary[Tuple[int, ...], PushdownFilter]]":
        filters = self._filters.get(functor)
        return [] if filters is None else [filters]

    def plan(self, functor: Functor) -> Plan:
        """Build and return the plan for the events of a functor, and pass it to the filters."""
        listeners = [*self._listeners.get(functor, ()), *self._listeners.get(None, ())]
        listeners.sort(key=lambda listener: listener.order)
        plan = self._plans.store(functor, make_plan(listeners), len(functor.name))
        for filters in self._filters_of(functor):
            for event_filter in list(filters.values()):
                event_filter.plan = plan
        # Without values, an action cannot tell a match from a mismatch, so the pattern must accept all events.
        if len(listeners) == 1 and listeners[0].fused and matches_all_events(listeners[0].pattern):
            self.fused_actions[functor] = listeners[0].action
        return plan


def functor_of_event(term: Term) -> Functor:
    """Return the functor of an event.

    Raises:
        UsageError: if the term is not an event.
    """
    functor = _functor_of(term)
    if functor is None:
        raise UsageError("an event is an atom or a compound term, not a variable")
    return functor


def _functor_of(term: Term) -> Optional[Functor]:
    """Return the functor of a pattern or event; None for a variable.

    Raises:
        UsageError: for a number or string.
    """
    if term.__class__ is tuple:
        functor: Functor = term[0]
        return functor
    if term.__class__ is Atom:
        return term.functor
    if term.__class__ is Var:
        return None
    raise UsageError("an event is an atom or a compound term, not a number or a string")
