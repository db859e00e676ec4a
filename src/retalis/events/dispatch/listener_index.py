"""Who listens to events: found by their functor and then by the constants in patterns.

Both are dictionaries, so an event costs nothing for listeners whose constants differ.
"""

from itertools import count
from typing import AbstractSet, Callable, Collection, Dict, Hashable, List, Optional, Tuple
from weakref import WeakValueDictionary

from ...foundation.bounded_caches import Cache
from ...foundation.errors import UsageError
from ...prolog.terms.term_traversal import copy, term_key
from ...prolog.terms.types import Atom, EventAction, Functor, Term, Var
from .discrimination_tree import Plan, PushdownFilter, make_plan, takes_all
from .listeners import ArgumentProjection, Listener, ListenerPhase, unread_positions
from .matcher_compiler import Matcher, compile_matcher


def nothing() -> None:
    """Do nothing."""


_GATES = 1000
"""Functors with gates from which on it is looked which gates are still used."""


class ListenerIndex:
    """The listeners of events, with the plans, gates and fused actions that follow from them.

    Attributes:
        fused: actions that take the events of a functor without their values, by functor; see `listen`.
        unread: which arguments of events nobody reads.
        on_change: called when listeners have come or gone; it may not fail, nor take long.
    """

    def __init__(self) -> None:
        self._listeners: Dict[Optional[Functor], Dict[Listener, None]] = {}
        self.unread = ArgumentProjection(self._listeners)
        self.on_change: Callable[[], object] = nothing
        self._plans: Cache[Functor, Plan] = Cache(10_000, 16 << 20)
        self.fused: Dict[Functor, EventAction] = {}
        self._gates: Dict[Functor, WeakValueDictionary[Tuple[int, ...], PushdownFilter]] = {}
        self._many_gates = _GATES
        self._matchers: WeakValueDictionary[Hashable, Matcher] = WeakValueDictionary()
        self._order = count()

    def listen(
        self,
        stage: ListenerPhase,
        pattern: Term,
        action: EventAction,
        rank: Tuple[int, ...] = (),
        fused: bool = False,
        unused: AbstractSet[Var] = frozenset(),
    ) -> Listener:
        """Have ``action`` called for every event that unifies with ``pattern``.

        A listener added while an event is dispatched sees later events only.

        Args:
            stage: when it is served.
            pattern: an atom, a compound term, or a variable for any event. It is copied.
            action: does its part and returns the frame to go on with, ``next`` if there is nothing more to do.
            rank: place within the stage; by default after all there are.
            fused: whether ``action`` may get None for the values, which are the arguments of the event then. It
                does for events without variables that come in, if no other listener takes events of the functor
                and the pattern takes all of them.
            unused: variables of the pattern whose values nobody looks at, so that they may be `NOT_READ`. Where
                the pattern is one of them, it gets events as they come, with `NOT_READ` in them.

        Raises:
            UsageError: for a pattern that no event can match (a number, a string).
        """
        unread = unread_positions(pattern, unused)
        partial = pattern.__class__ is Var and pattern in unused
        pattern = copy(pattern)
        functor = _functor_of(pattern)
        key = term_key(pattern)
        matcher = self._matchers.get(key)
        if matcher is None:
            matcher = self._matchers[key] = compile_matcher(pattern)
        order = (int(stage), *(rank or (next(self._order),)), next(self._order))
        listener = Listener(order, pattern, functor, matcher, action, fused, unread, partial)
        self._listeners.setdefault(functor, {})[listener] = None
        self.unread.guard(listener)
        self._changed(functor)
        return listener

    def remove(self, listener: Listener) -> None:
        """Take a listener away; removing it twice is not an error."""
        group = self._listeners.get(listener.functor, {})
        if group.pop(listener, 0) is None:
            if not group:
                del self._listeners[listener.functor]
            self._changed(listener.functor)

    def keep_only(self, stage: ListenerPhase, chosen: Collection[Listener]) -> None:
        """Take away all listeners of a stage but some."""
        for group in list(self._listeners.values()):
            for listener in list(group):
                if listener.order[0] == stage and listener not in chosen:
                    self.remove(listener)

    def gate(self, functor: Functor, positions: Tuple[int, ...] = ()) -> PushdownFilter:
        """Return what tells whether an event of a functor can concern anybody, see `PushdownFilter`.

        Args:
            functor: of the events.
            positions: which of their arguments are looked at, counted from 1.
        """
        gates = self._gates.get(functor)
        if gates is None:
            if len(self._gates) >= self._many_gates:  # of rules and clauses that come and go
                self._gates = {key: found for key, found in self._gates.items() if len(found)}
                self._many_gates = 2 * len(self._gates) + _GATES
            gates = self._gates[functor] = WeakValueDictionary()
        gate = gates.get(positions)
        if gate is None:
            gate = gates[positions] = PushdownFilter(positions, self._plans.get(functor))
        return gate

    def takes_name(self, name: str) -> bool:
        """Return whether a pattern names events with this name; patterns for all events do not count."""
        return any(functor is not None and functor.name == name for functor in list(self._listeners))

    def _changed(self, functor: Optional[Functor]) -> None:
        self.on_change()
        if functor is None:
            self._plans.clear()
            self.fused.clear()
        else:
            self._plans.pop(functor, None)
            self.fused.pop(functor, None)
        for gates in list(self._gates.values()) if functor is None else self._gates_of(functor):
            for gate in list(gates.values()):
                gate.plan = None

    def _gates_of(self, functor: Functor) -> "List[WeakValueDictionary[Tuple[int, ...], PushdownFilter]]":
        gates = self._gates.get(functor)
        return [] if gates is None else [gates]

    def plan(self, functor: Functor) -> Plan:
        """Return what is done with the events of a functor, and have its gates know it."""
        listeners = [*self._listeners.get(functor, ()), *self._listeners.get(None, ())]
        listeners.sort(key=lambda listener: listener.order)
        plan = self._plans.keep(functor, make_plan(listeners), len(functor.name))
        for gates in self._gates_of(functor):
            for gate in list(gates.values()):
                gate.plan = plan
        if len(listeners) == 1 and listeners[0].fused and takes_all(listeners[0].pattern):
            self.fused[functor] = listeners[0].action
        return plan


def functor_of_event(term: Term) -> Functor:
    """Return the functor of an event.

    Raises:
        UsageError: for what is none.
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
        found: Functor = term[0]
        return found
    if term.__class__ is Atom:
        return term.functor
    if term.__class__ is Var:
        return None
    raise UsageError("an event is an atom or a compound term, not a number or a string")
