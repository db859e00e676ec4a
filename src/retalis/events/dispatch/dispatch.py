"""From an event to those who listen to its kind, in order, depth first.

Listeners are found by the event's functor and then by the constants in their patterns, through
dictionaries, so an event costs nothing for listeners whose constants differ.
"""

from itertools import count
from typing import Any, Callable, Collection, Dict, Hashable, List, Optional, Tuple, TypeVar
from weakref import WeakValueDictionary

from ...foundation import Cache, UsageError
from ...prolog.database import CompiledGoal
from ...prolog.logic import Logic
from ...prolog.machine import Budget, Frame, PrologError, keep_back
from ...prolog.terms import (
    Atom,
    EventAction,
    Functor,
    Lazy,
    Term,
    Values,
    Var,
    copy,
    deref,
    is_ground,
    is_plain,
    term_key,
)
from .gates import Gate
from .matching import Matcher, compile_matcher
from .plans import Choice, Onlookers, Plan, make_plan
from .serving import AT_ONCE, LEFT_OUT, RESTORE, Dispatch, Lane, Listener, Stage, event_of

Result = TypeVar("Result")


_GATES = 1000
"""Functors with gates from which on it is looked which gates are still used."""


class Dispatcher:
    """Hands events to listeners.

    Args:
        logic: the program's logic, whose machine runs the frames.
        max_depth: how many events may be derived one from the other; the first of all is none of them.

    Attributes:
        current: what is being served, or None: an `Dispatch`, or what `event` makes one of where somebody asks:
            term, start and end of one, and what was being served before.
        lanes: for events of a functor that one listener only takes, all of them, what serves them faster.
        mark: makes the token of an event; tracking replaces it.
        cause: the rule and match whose goal is running, where that is tracked.
        shortcuts: by the functor of an event, what can take the values of a rule's match in place of the event:
            takes the rule and the action that makes the event; gives an action and a lane for a rule of one event,
            or None where the rule's head does not allow it.
    """

    def __init__(self, logic: Optional[Logic] = None, max_depth: int = 1000) -> None:
        self.max_depth = max_depth
        self._deepest = max_depth + 1
        self._at_once = min(AT_ONCE, self._deepest)
        self._machine: Any = None if logic is None else logic.machine
        self._budget = Budget() if logic is None else logic.machine.budget
        self._listeners: Dict[Optional[Functor], Dict[Listener, None]] = {}
        self._plans: Cache[Functor, Plan] = Cache(10_000, 16 << 20)
        self.lanes: Dict[Functor, Lane] = {}
        self._gates: Dict[Functor, WeakValueDictionary[Tuple[int, ...], Gate]] = {}
        self._many_gates = _GATES
        self._matchers: WeakValueDictionary[Hashable, Matcher] = WeakValueDictionary()
        self._order = count()
        self._tokens = count(1)
        self.current: Any = None
        self.cause: Any = None
        self.shortcuts: Dict[Functor, Callable[[Any, EventAction], Optional[Tuple[EventAction, Lane]]]] = {}
        self.mark: Callable[[Dispatch], Any] = lambda event: next(self._tokens)

    def listen(
        self,
        stage: Stage,
        pattern: Term,
        action: EventAction,
        rank: Tuple[int, ...] = (),
        lane: Optional[Lane] = None,
        looks_on: bool = False,
    ) -> Listener:
        """Have ``action`` called for every event that unifies with ``pattern``.

        A listener added while an event is dispatched sees later events only.

        Args:
            stage: when it is served.
            pattern: an atom, a compound term, or a variable for any event. It is copied.
            action: does its part and returns the frame to go on with, ``next`` if there is nothing more to do.
            rank: place within the stage; by default after all there are.
            lane: does the same as ``action`` for an event without variables whose arguments are the
                values, where nobody else listens; it may leave ``current`` to `event`.
            looks_on: whether ``action`` always returns the next frame; where all do so, it may leave ``current``
                to `event`.

        Raises:
            UsageError: for a pattern that no event can match (a number, a string).
        """
        pattern = copy(pattern)
        functor = _functor_of(pattern)
        key = term_key(pattern)
        matcher = self._matchers.get(key)
        if matcher is None:
            matcher = self._matchers[key] = compile_matcher(pattern)
        order = (int(stage), *(rank or (next(self._order),)), next(self._order))
        listener = Listener(order, pattern, functor, matcher, action, lane, looks_on)
        self._listeners.setdefault(functor, {})[listener] = None
        self._changed(functor)
        return listener

    def remove(self, listener: Listener) -> None:
        """Take a listener away; removing it twice is not an error."""
        group = self._listeners.get(listener.functor, {})
        if group.pop(listener, 0) is None:
            if not group:
                del self._listeners[listener.functor]
            self._changed(listener.functor)

    def keep_only(self, stage: Stage, chosen: Collection[Listener]) -> None:
        """Take away all listeners of a stage but some."""
        for group in list(self._listeners.values()):
            for listener in list(group):
                if listener.order[0] == stage and listener not in chosen:
                    self.remove(listener)

    def mend(self) -> None:
        """Make the plans anew and serve nothing, after an interrupt."""
        self._changed(None)
        self.restore()

    def gate(self, functor: Functor, positions: Tuple[int, ...] = ()) -> Gate:
        """Return what tells whether an event of a functor can concern anybody, see `Gate`.

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
            gate = gates[positions] = Gate(positions, self._plans.get(functor))
        return gate

    def dispatch(  # noqa: C901  (each event takes it: calls would cost more than what is done)
        self,
        term: Any,
        start: int,
        end: int,
        after: Frame,
        token: Any = None,
        ground: Optional[bool] = None,
        own: bool = True,
    ) -> Frame:
        """Return the frame that serves an event and then goes on with ``after``.

        Where nobody listens, or all is done already, that is ``after`` itself. Callers have nothing left to do
        but to return the frame: listeners may have been served when it is returned.

        Args:
            term: the event, an atom or compound term.
            start: the instant at which it began.
            end: the instant at which it ended.
            after: the frame to go on with.
            token: what tells the event from others, where its maker has one already.
            ground: whether it has no variables, where its maker knows.
            own: whether the term has no bound variables, and its unbound ones are its own; otherwise a copy
                is served, which is made only where somebody listens.

        Raises:
            UsageError: where the term is not an event, the interval is reversed, or the chain of derived events
                is too long.
        """
        if start > end:
            raise UsageError(f"an event cannot end before it starts ({start} > {end} ns)")
        kind = term.__class__
        if kind is tuple:
            functor = term[0]
        elif kind is Atom:
            functor = term.functor
        else:
            term = deref(term)
            functor = _functor_of_event(term)
        plan: Any = self._plans.get(functor)
        if plan is None:
            plan = self._plan(functor)
        while plan.__class__ is Choice:
            plan = plan.branch(term)
        if not plan:
            return after
        if not own:
            if is_plain(term):
                ground = True
            else:
                fresh: Dict[Var, Term] = {}
                term = copy(term, fresh)
                ground = not fresh
        if plan.__class__ is Onlookers:
            current = self.current
            if current.__class__ is tuple and current[3] is not None:
                current = self.event()
            if current.__class__ is Dispatch and current.depth >= self._deepest:
                raise self._too_deep()
            self.current = (term, start, end, current)
            for matcher, action in plan:
                values = matcher(term)
                if values is not None:
                    action(term, values, start, end, after)
            self.current = current
            return after
        event = Dispatch()
        event.dispatcher = self
        event.steps = steps = iter(plan)
        event.term = term
        event.start = start
        event.end = end
        event.token = token
        event.cause = self.cause
        event.ground = ground
        parent = self.current
        if parent.__class__ is tuple:
            parent = self.event()
        event.parent = parent
        event.depth = depth = 1 if parent is None else parent.depth + 1
        frame = (event, after)
        if depth > self._at_once:
            if depth > self._deepest or self._budget.closed:
                self._admit(depth)
            return frame
        self.current = event
        for matcher, action in steps:  # as `Dispatch.run`
            values = matcher(term)
            if values is not None:
                next_frame = action(term, values, start, end, frame)
                if next_frame is not frame:
                    return next_frame  # type: ignore[no-any-return]
        self.current = parent
        return after

    def _admit(self, depth: int) -> None:
        """Raise an error where an event is derived through too many, or through many past the limits."""
        if depth > self._deepest:
            raise self._too_deep()
        self._refuse_past_limits()

    def _too_deep(self) -> UsageError:
        return UsageError(f"more than {self.max_depth} events were derived one from another")

    def _refuse_past_limits(self) -> None:
        """Raise an error where all is used up that what came in may use: it derives no more long chains of events."""
        try:
            self._budget.admit()
        except PrologError as error:
            keep_back(error)
            raise UsageError(f"no more events are derived from it ({error.message})") from error

    def one_listens(self, functor: Functor) -> bool:
        """Tell whether just one listens to events of this functor, where there is any."""
        return len(self._listeners[functor]) == 1 and None not in self._listeners

    def left_out(self, functor: Functor) -> Optional[Dispatch]:
        """Return what is to be current in place of an event that need not be made; None where it has to be.

        It need not where just one listens to it, and may do at once what there is to do.
        """
        current = self.current
        if current is None or not self.one_listens(functor):
            return None
        depth = 1 if current.__class__ is tuple else current.depth
        return LEFT_OUT[depth] if depth < self._at_once else None

    def call(
        self,
        goal: CompiledGoal,
        given: Values,
        on_error: Callable[[Values, PrologError], None],
        solved: EventAction,
        term: Term,
        values: Values,
        start: int,
        end: int,
        after: Frame,
    ) -> Frame:
        """Return the frame to go on with when a goal was called once for the event that is being served.

        What is to be handed on comes as arguments: functions made for each call would cost more than the rest of it.

        Args:
            goal: what to call.
            given: its inputs.
            on_error: is told of values and error where the goal raised one.
            solved: takes term, values with the outputs of the first solution after them, start, end and next frame.
            term: handed on.
            values: handed on.
            start: handed on.
            end: handed on.
            after: the frame to go on with where there is no solution, too.
        """
        event = self.event()
        if event is not None and event.depth > AT_ONCE:
            return self._call_by_frames(event, goal, given, on_error, solved, term, values, start, end, after)
        try:
            found = goal.test(given)
        except PrologError as error:
            self.current = event
            on_error(values, error)
            return after
        return after if found is None else solved(term, values + found, start, end, after)

    def _call_by_frames(
        self,
        event: Dispatch,
        goal: CompiledGoal,
        given: Values,
        on_error: Callable[[Values, PrologError], None],
        solved: EventAction,
        term: Term,
        values: Values,
        start: int,
        end: int,
        after: Frame,
    ) -> Frame:
        """Return the frame that calls a goal by steps of the machine; see `call`."""

        def failed(error: PrologError) -> None:
            self.current = event
            on_error(values, error)

        return self._machine.attempt(  # type: ignore[no-any-return]
            goal, given, lambda found: solved(term, values + found, start, end, after), after, failed
        )

    def state(self) -> Tuple[Any, Any]:
        """Return what is being served and why, for `restore`."""
        return self.current, self.cause

    def restore(self, state: Tuple[Any, Any] = (None, None)) -> None:
        """Serve again what was being served, nothing without a state: what came in between is over, or has failed."""
        self.current, self.cause = state

    def serve_again(self, current: Any) -> None:
        """Serve again what was `current` before a goal that raised an error, maybe amid an event that it made."""
        self.current = current

    def caused_by(
        self, cause: Any, then: Callable[..., Frame], after: Frame
    ) -> Tuple[Callable[..., Frame], Frame]:
        """Have events know the rule and match whose goal makes them, until that goal is over.

        Returns:
            What to go on with in place of ``then`` and ``after``.
        """
        before = self.cause

        def over(*found: Any) -> Frame:
            self.cause = before
            return then(*found)

        self.cause = cause
        return over, (RESTORE, self, "cause", before, after)

    def undisturbed(self, work: Callable[[], Result]) -> Result:
        """Return what work returns; where it raises, what was being served before is being served again."""
        state = self.state()
        try:
            return work()
        except BaseException:
            self.restore(state)
            raise

    def apart(self, work: Callable[[], Result]) -> Result:
        """Return what work returns; what it dispatches follows from nothing that is being served."""
        state = self.state()
        self.restore()
        try:
            return work()
        finally:
            self.restore(state)

    def event(self) -> Optional[Dispatch]:
        """Return the event that is being served, or None."""
        current = self.current
        if current.__class__ is not tuple:
            return current  # type: ignore[no-any-return]
        made = self.current = self._made(*current)
        return made

    def _made(self, term: Term, start: int, end: int, before: Any) -> Dispatch:
        """Return the event of its parts, and of what was served when it came."""
        parent = self._made(*before) if before.__class__ is tuple else before
        event = event_of(self, term, start, end, 1 if parent is None else parent.depth + 1)
        event.parent = parent
        event.cause = self.cause
        return event

    def ground(self) -> bool:
        """Tell whether the event that is being served has no variables."""
        event = self.event()
        assert event is not None
        known = event.ground
        if known is None:
            known = event.ground = is_ground(event.term)
        return known

    def is_of_ground(self, match: Any) -> bool:
        """Tell whether a match is of the event alone that is being served, and that has no variables."""
        event = self.event()
        return match.parts is None and event is not None and match.term is event.term and self.ground()

    def token(self) -> Any:
        """Return what tells the event that is being served from all others."""
        event = self.event()
        assert event is not None
        token = event.token
        if token is None:
            token = event.token = self.mark(event)
        return token

    def _changed(self, functor: Optional[Functor]) -> None:
        if functor is None:
            self._plans.clear()
            self.lanes.clear()
        else:
            self._plans.pop(functor, None)
            self.lanes.pop(functor, None)
        for gates in list(self._gates.values()) if functor is None else self._gates_of(functor):
            for gate in list(gates.values()):
                gate.set(None)

    def _gates_of(self, functor: Functor) -> "List[WeakValueDictionary[Tuple[int, ...], Gate]]":
        gates = self._gates.get(functor)
        return [] if gates is None else [gates]

    def _plan(self, functor: Functor) -> Plan:
        listeners = [*self._listeners.get(functor, ()), *self._listeners.get(None, ())]
        listeners.sort(key=lambda listener: listener.order)
        plan = self._plans.keep(functor, make_plan(listeners), len(functor.name))
        for gates in self._gates_of(functor):
            for gate in list(gates.values()):
                gate.set(plan)
        if len(listeners) == 1 and listeners[0].lane is not None and _takes_all(listeners[0].pattern):
            self.lanes[functor] = listeners[0].lane
        return plan


def _takes_all(pattern: Term) -> bool:
    """Tell whether a pattern's arguments are variables, all different."""
    if pattern.__class__ is not tuple:
        return False
    found = set(pattern[1:])
    return len(found) == len(pattern) - 1 and all(item.__class__ is Var for item in found)


def _functor_of_event(term: Term) -> Functor:
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
    if term.__class__ is Lazy:
        return term.functor
    if term.__class__ is Var:
        return None
    raise UsageError("an event is an atom or a compound term, not a number or a string")
