"""Dispatcher: runs the listeners of an event and of all events that are derived from it, depth first.

`ListenerIndex` finds the listeners of an event by the functor of their patterns, then by the constants in their
arguments. Both levels are dictionaries, so an event has no cost for listeners with other constants. The index also
owns what depends on the set of listeners, and invalidates it when a listener is added or removed: plans (see
`discrimination_tree`), pushdown filters, fused actions and argument projections.

An event is dispatched by following the plan of its functor and calling matcher and action of each listener in order.
An action returns the next frame of the machine. If it returns the frame that it got, it is finished; otherwise the
machine runs the returned frame first, and that frame continues with the remaining listeners. Derived events of low
depth are dispatched by recursive calls, deeper ones by the loop of the machine, so chains of any length need no
Python stack.

`Dispatcher.current` is the context of the event that is being dispatched, `Dispatcher.cause` the rule or event that
events created now follow from. Both must be restored on every exit, including errors.
"""

from itertools import count
from typing import AbstractSet, Any, Callable, Dict, Hashable, List, Optional, Tuple, TypeVar
from weakref import WeakValueDictionary

from ...foundation.bounded_caches import Cache
from ...foundation.callbacks import CallbackList
from ...foundation.errors import UsageError
from ...prolog.database.compiled_goal import CompiledGoal
from ...prolog.machine.errors import PrologError
from ...prolog.machine.resource_limits import Budget, record_caught_error
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms.term_traversal import copy, has_no_variables, is_ground, term_key
from ...prolog.terms.types import Atom, EventAction, Frame, Functor, Term, Values, Var, deref
from ...serialization.state_fields import NextNumber, StateFields, StateOwner, field
from ...serialization.stored_field_types import COUNT
from .argument_projection import ArgumentProjection, find_unread_positions
from .discrimination_tree import Plan, PushdownFilter, SwitchNode, make_plan, matches_all_events
from .listeners import (
    CALL_LISTENERS,
    DEPTH,
    END,
    GROUND,
    MAX_RECURSIVE_DEPTH,
    RESTORE_CAUSE,
    START,
    TERM,
    TOKEN,
    Context,
    Listener,
    ListenerPhase,
)
from .matcher_compiler import Matcher, compile_matcher

Result = TypeVar("Result")


_MIN_FILTERS_TO_SWEEP = 1000
"""Number of functors with filters above which unused filters are removed."""


class ListenerIndex:
    """Listeners of events, with the plans, filters and fused actions that are derived from them.

    Attributes:
        fused_actions: by functor, action of its only listener, which may be called with None for the values; see
            `listen`.
        projection: arguments of events that no listener reads.
        on_change: called when listeners are added or removed; it must be fast and must not fail.
    """

    def __init__(self) -> None:
        self._listeners: Dict[Optional[Functor], Dict[Listener, None]] = {}
        self.projection = ArgumentProjection(self._listeners)
        self.on_change: CallbackList[Callable[[], object]] = CallbackList()
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
        is_fused: bool = False,
        unread_variables: AbstractSet[Var] = frozenset(),
    ) -> Listener:
        """Add a listener, whose ``action`` is called for every event that unifies with ``pattern``.

        A listener that is added while an event is dispatched gets later events only.

        Args:
            phase: phase in which it is called.
            pattern: an atom, a compound term, or a variable for all events. It is copied.
            action: processes a match and returns the next frame, which is its argument ``frame`` if it is finished.
            rank: position within the phase; by default after all others.
            is_fused: whether ``action`` may be called with None for the values and then takes them from the event. It
                is called so for ground input events if the functor has no other listener and the pattern matches all
                its events.
            unread_variables: variables of the pattern whose values are not read, so that they may be `NOT_READ`. If
                the pattern itself is such a variable, the listener gets events that contain `NOT_READ`.

        Raises:
            UsageError: if the pattern is a number or a string, which no event is.
        """
        unread_positions = find_unread_positions(pattern, unread_variables)
        accepts_unread = pattern.__class__ is Var and pattern in unread_variables
        # The caller may bind the variables of its own pattern later.
        pattern = copy(pattern)
        functor = _functor_of(pattern)
        key = term_key(pattern)
        # Rules often share patterns; equal patterns share one compiled function.
        matcher = self._matchers.get(key)
        if matcher is None:
            matcher = self._matchers[key] = compile_matcher(pattern)
        order = (int(phase), *(rank or (next(self._numbers),)), next(self._numbers))
        listener = Listener(
            order=order,
            pattern=pattern,
            functor=functor,
            matcher=matcher,
            action=action,
            is_fused=is_fused,
            unread_positions=unread_positions,
            accepts_unread=accepts_unread,
        )
        self._listeners.setdefault(functor, {})[listener] = None
        # The listener must be in the table before the next call, see `ArgumentProjection.announce`.
        self.projection.reject_events_with_unread(listener)
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

    def listened_names(self) -> List[str]:
        """Return the names of the events that listeners receive."""
        return list(dict.fromkeys(functor.name for functor in self.listened_functors()))

    def listened_functors(self) -> List[Functor]:
        """Return the functors of the events that listeners receive; patterns for all events have none."""
        return [functor for functor in list(self._listeners) if functor is not None]

    def _invalidate_plans(self, functor: Optional[Functor]) -> None:
        """Drop what depends on the listeners of a functor, or of all functors if it is None."""
        for callback in self.on_change:
            callback()
        # A listener for all events (functor None) is part of every plan.
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

    def build_plan(self, functor: Functor) -> Plan:
        """Build and return the plan for the events of a functor, and pass it to the filters."""
        listeners = [*self._listeners.get(functor, ()), *self._listeners.get(None, ())]
        listeners.sort(key=lambda listener: listener.order)
        plan = self._plans.store(functor, make_plan(listeners), len(functor.name))
        for filters in self._filters_of(functor):
            for event_filter in list(filters.values()):
                event_filter.plan = plan
        # Without values, an action cannot tell a match from a mismatch, so the pattern must accept all events.
        if len(listeners) == 1 and listeners[0].is_fused and matches_all_events(listeners[0].pattern):
            self.fused_actions[functor] = listeners[0].action
        return plan


class Dispatcher(ListenerIndex, StateOwner):
    """Dispatcher of events to listeners.

    Args:
        logic: the Prolog system whose machine runs the frames.
        max_depth: maximum length of a chain of events that are derived one from another, without the first event.

    Attributes:
        current: `Context` of the event that is being dispatched, or None.
        max_recursive_depth: depth up to which derived events are dispatched by recursive calls.
        tracks_lineage: whether tokens record the lineage of events.
        retractions: number of retractions; one counts once, whatever the number of events that depended on it.
        cause: with tracking, the rule and match whose goal is running, or the token of the event whose query is
            answered.
        shortcuts: by functor of an event, a function that replaces creating the event by an action on the values of a
            match. It takes the rule and the action that creates the event, and returns an action that may be fused,
            or None if the head of the rule does not allow it.
    """

    STATE = StateFields(field("next_token_number", COUNT))

    def __init__(self, logic: Optional[PrologSystem] = None, max_depth: int = 1000) -> None:
        super().__init__()
        self.max_depth = max_depth
        self._max_chain_length = max_depth + 1
        # The limit for chains of events may be lower than the depth for recursion.
        self.max_recursive_depth = min(MAX_RECURSIVE_DEPTH, self._max_chain_length)
        self._done: Any = None if logic is None else logic.machine.done
        self._run: Any = None if logic is None else logic.machine.run
        self._budget = Budget() if logic is None else logic.machine.budget
        self._tokens = count(1)
        self.current: Any = None
        self.cause: Any = None
        self.shortcuts: Dict[Functor, Callable[[Any, EventAction], Optional[EventAction]]] = {}
        self._create_token: Optional[Callable[[Context], Any]] = None
        self.tracks_lineage = False
        self.retractions = 0

    def track_lineage(self, create_token: Optional[Callable[[Context], Any]]) -> None:
        """Let a function create the tokens of events, which record their lineage; None stops tracking."""
        self._create_token = create_token
        self.tracks_lineage = create_token is not None

    def count_retraction(self) -> None:
        """Count a retraction."""
        self.retractions += 1

    def dispatch(  # noqa: C901  (on the path of every event)
        self,
        term: Any,
        start: int,
        end: int,
        frame: Frame,
        token: Any = None,
        ground: Optional[bool] = None,
        is_owned: bool = True,
    ) -> Frame:
        """Return the frame that dispatches an event and then goes on with ``frame``.

        If nothing remains to be done, the result is ``frame`` itself. Listeners may have run already when this
        returns, so callers must return the frame without doing anything else.

        Args:
            term: the event, an atom or compound term.
            start: start of the event in ns.
            end: end of the event in ns.
            frame: the frame to go on with.
            token: identity of the event, if it has one already.
            ground: whether the event has no variables, if that is known.
            is_owned: whether the term has no bound variables and shares no unbound ones; otherwise the event is
                copied, but only if it has listeners.

        Raises:
            UsageError: if the term is not an event, it ends before it starts, or the chain of derived events is too
                long.
        """
        if start > end:
            raise UsageError(f"an event cannot end before it starts ({start} > {end} ns)")
        term_class = term.__class__
        if term_class is tuple:
            functor = term[0]
        elif term_class is Atom:
            functor = term.functor
        else:
            term = deref(term)
            functor = functor_of_event(term)
        # The cache is bounded, so a plan may have been evicted; `build_plan` then builds it again.
        plan: Any = self._plans.get(functor)
        if plan is None:
            plan = self.build_plan(functor)
        while plan.__class__ is SwitchNode:
            plan = plan.branch(term)
        if not plan:
            return frame
        # Only after the plan is known, so that events without listeners are never copied.
        if not is_owned:
            term, ground = _owned_copy(term)
        parent = self.current
        depth = 1 if parent is None else parent[DEPTH] + 1
        context = [term, start, end, parent, depth, ground, self.cause, token]
        steps = iter(plan)
        resumption: Frame = (CALL_LISTENERS, self, steps, context, frame)
        # Each level of recursion uses several Python frames. The loop of the machine uses none.
        if depth > self.max_recursive_depth:
            return self._defer_frame(resumption, depth)
        self.current = context
        # Inlined from `_CallListeners.run`, because a call costs 5 % of a short event.
        for matcher, action in steps:
            values = matcher(term)
            if values is not None:
                next_frame = action(term, values, start, end, resumption)
                if next_frame is not resumption:
                    return next_frame  # type: ignore[no-any-return]
        self.current = parent
        return frame

    def dispatch_input(self, term: Any, start: int, end: int, ground: Optional[bool]) -> None:
        """Dispatch an input event and all events derived from it, by a fused action if possible.

        If an exception is raised, the previous context is restored. Arguments and errors are those of `dispatch`.
        """
        current, cause, done = self.current, self.cause, self._done
        try:
            # A fused action gets no values, so the event must be ground, and it must be an input event: only then is
            # no other dispatch in progress that the action would have to return to.
            fused = (
                self.fused_actions.get(term[0])
                if ground and current is None and term.__class__ is tuple
                else None
            )
            if fused is None:
                frame = self.dispatch(term, start, end, done, None, ground)
            else:
                self.current = [term, start, end, None, 1, True, cause, None]
                frame = fused(term, None, start, end, done)  # type: ignore[arg-type]
            if frame is not done:
                # Most events are finished by now; only goals that need the machine leave a frame.
                self._run(frame)
            self.current = current
        except BaseException:
            self.restore_context(current, cause)
            raise

    def _defer_frame(self, frame: Frame, depth: int) -> Frame:
        """Return the frame of a derived event for the loop of the machine, if the limits allow it."""
        if depth > self._max_chain_length:
            raise UsageError(f"more than {self.max_depth} events were derived one from another")
        # Deep chains check the limits of the input event; shallow ones are bounded by their depth.
        if self._budget.needs_check:
            self._check_input_limits()
        return frame

    def _check_input_limits(self) -> None:
        """Raise an error if the input event has used up its resource limits."""
        try:
            self._budget.check_entry()
        except PrologError as error:
            record_caught_error(error)
            raise UsageError(f"no more events are derived from it ({error.message})") from error

    def call(
        self,
        goal: CompiledGoal,
        inputs: Values,
        on_error: Callable[[Values, PrologError], None],
        on_solution: EventAction,
        term: Term,
        values: Values,
        start: int,
        end: int,
        frame: Frame,
    ) -> Frame:
        """Return the next frame after calling a goal once for the current event.

        The values for the callbacks are passed as arguments, because creating a closure per call would cost more than
        the rest of the call.

        Args:
            goal: the goal.
            inputs: its inputs.
            on_error: called with ``values`` and the error if the goal raises one.
            on_solution: called with term, values with the outputs of the first solution appended, start, end and next
                frame.
            term: passed to ``on_solution``.
            values: passed to ``on_solution``.
            start: passed to ``on_solution``.
            end: passed to ``on_solution``.
            frame: the next frame, also if there is no solution.
        """
        context = self.current
        if context is not None and context[DEPTH] > MAX_RECURSIVE_DEPTH:
            return self._call_by_frames(
                context, goal, inputs, on_error, on_solution, term, values, start, end, frame
            )
        try:
            outputs = goal.first_solution(inputs)
        except PrologError as error:
            self.current = context
            on_error(values, error)
            return frame
        return frame if outputs is None else on_solution(term, values + outputs, start, end, frame)

    def _call_by_frames(
        self,
        context: Context,
        goal: CompiledGoal,
        inputs: Values,
        on_error: Callable[[Values, PrologError], None],
        on_solution: EventAction,
        term: Term,
        values: Values,
        start: int,
        end: int,
        frame: Frame,
    ) -> Frame:
        """Return the frame that calls a goal by steps of the machine; see `call`.

        This is a separate function, because closures would make the variables of `call` slower cell variables.
        """

        def on_failure(error: PrologError) -> None:
            self.current = context
            on_error(values, error)

        return goal.attempt(  # type: ignore[return-value]
            inputs,
            lambda outputs: on_solution(term, values + outputs, start, end, frame),
            frame,
            on_failure,
        )

    next_token_number = NextNumber(
        "_tokens", "The number of the next event, if events are identified by numbers."
    )

    @property
    def current_interval(self) -> Optional[Tuple[int, int]]:
        """Start and end in ns of the event that is being dispatched; None if there is none."""
        return None if self.current is None else (self.current[START], self.current[END])

    def context_state(self) -> Tuple[Any, Any]:
        """Return the current context and cause, for `restore_context`."""
        return self.current, self.cause

    def restore_context(self, current: Any, cause: Any) -> None:
        """Restore an earlier context and cause.

        Args:
            current: earlier value of `current`; None for no event.
            cause: earlier value of `cause`.
        """
        self.current = current
        self.cause = cause

    def caused_by(
        self, cause: Any, next_action: Callable[..., Frame], frame: Frame
    ) -> Tuple[Callable[..., Frame], Frame]:
        """Set the cause of the events that a goal creates, until the goal is finished.

        Returns:
            Replacements for ``next_action`` and ``frame``, which restore the previous cause.
        """
        previous = self.cause

        def restore_cause(*solution: Any) -> Frame:
            self.cause = previous
            return next_action(*solution)

        self.cause = cause
        return restore_cause, (RESTORE_CAUSE, self, previous, frame)

    def set_cause(self, token: object, frame: Frame) -> Frame:
        """Set the cause of events to the event with a token; return the frame that ends this."""
        previous, self.cause = self.cause, token
        return RESTORE_CAUSE, self, previous, frame

    def run_restoring_context(self, work: Callable[[], Result]) -> Result:
        """Return the result of ``work``; if it raises an exception, restore the context first."""
        state = self.context_state()
        try:
            return work()
        except BaseException:
            self.restore_context(*state)
            raise

    def run_without_context(self, work: Callable[[], Result]) -> Result:
        """Return the result of ``work``; the events that it dispatches are not derived from the current event."""
        state = self.context_state()
        self.restore_context(None, None)
        try:
            return work()
        finally:
            self.restore_context(*state)

    def ground(self) -> bool:
        """Return whether the current event has no variables."""
        context = self._require_context()
        if context[GROUND] is None:
            context[GROUND] = is_ground(context[TERM])
        return context[GROUND]  # type: ignore[no-any-return]

    def consists_of_ground_event(self, match: Any) -> bool:
        """Return whether a match consists of the current event only, and that event has no variables."""
        context = self.current
        return match.parts is None and context is not None and match.term is context[TERM] and self.ground()

    def token(self) -> Any:
        """Return the unique token of the current event."""
        context = self._require_context()
        if context[TOKEN] is None:
            create_token = self._create_token
            context[TOKEN] = next(self._tokens) if create_token is None else create_token(context)
        return context[TOKEN]

    def _require_context(self) -> Context:
        context: Optional[Context] = self.current
        assert context is not None
        return context


def _owned_copy(term: Term) -> Tuple[Term, bool]:
    """Return an event that shares no variables, and whether it is ground."""
    if has_no_variables(term):
        return term, True
    fresh: Dict[Var, Term] = {}
    term = copy(term, fresh)
    return term, not fresh


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
