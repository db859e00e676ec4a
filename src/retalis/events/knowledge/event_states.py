"""Event states: conditions that hold from one event until another (the fluents of the event calculus).

``state(State, Begins, Ends)`` declares that ``State`` holds from each event that unifies with ``Begins`` until an
event that unifies with ``Ends`` and has the same values of the shared variables. A state that has ended is itself an
event, whose interval is the time for which it held; rules and memories can use it. With ``within``, a state also
ends by itself after some time.

`DeclaredState` stores the open states of one declaration, indexed by their terms and by the values that the ending
event shares, and a bounded number of past ones. `StateRegistry` owns all declarations and defines the predicates
``state``, ``holds``, ``holds_at`` and ``delete_state``.

If events may be retracted, an open state remembers the first events with which it may have begun: if the first one
is retracted, the state holds since the next one.
"""

from collections import OrderedDict, deque
from itertools import count
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
    Set,
    Tuple,
    Union,
)

from ...foundation.errors import UsageError
from ...foundation.similar_names import closest_name
from ...prolog.builtins.argument_checks import callable_of
from ...prolog.builtins.tabling import tables_of
from ...prolog.builtins.time_predicates import instant_of
from ...prolog.machine.errors import (
    CONTEXT,
    domain_error,
    existence_error,
    indicator,
    permission_error,
    resource_error,
)
from ...prolog.machine.machine import Machine
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms.term_traversal import copy, freeze, term_key, variables
from ...prolog.terms.timestamps import lazy_term
from ...prolog.terms.types import Frame, Functor, Term, Values, Var, atom, deref, functor, functor_of
from ...prolog.terms.unification import may_unify
from ...serialization.state_fields import (
    NextNumber,
    StateFields,
    StateOwner,
    constraint,
    field,
    part,
    rows_of,
)
from ...serialization.stored_field_types import (
    CALLABLE_TERM,
    COUNT,
    INSTANT,
    KEY,
    State,
    sequence_of,
    tuple_of,
)
from ..clock.clock import Clock
from ..dispatch.dispatcher import Dispatcher
from ..dispatch.listeners import Listener, ListenerPhase
from ..dispatch.matcher_compiler import compile_builder
from ..language.state_parser import StateForm, parse_state_declaration
from ..matches.match_types import OPTIONAL_EVENT
from ..matches.watermarks import PatternWatermark, Watermarks
from ..network.lineage_graph import Occurrence
from .memory import Warn
from .timeout_queue import Timeouts, are_increasing_orders

# Versions are unique among all declarations, so a table that depends on one declaration can compare numbers only.
_VERSIONS = count()

_MAX_OPENINGS = 100
"""Maximum number of remembered events with which a state may have begun, in case the first of them is retracted."""

Opening = Tuple[int, Optional[Occurrence]]
"""End of an event with which a state may have begun, and the occurrence of that event if events are tracked."""


class StoredOpenState(NamedTuple):
    """Stored form of an `OpenState`, with the same attributes."""

    order: int
    key: Hashable
    term: Term
    shared_key: Hashable
    openings: List[Opening]


class OpenState:
    """A state that holds.

    Attributes:
        key: key of its term.
        shared_key: keys of the values that it shares with the event that ends it.
        order: identity; increases in the order in which states began.
        openings: events with which it may have begun, first one first.
    """

    __slots__ = ("key", "term", "shared_key", "order", "openings")

    def __init__(self, key: Hashable, term: Term, shared_key: Hashable, order: int, openings: List[Opening]):
        self.key = key
        self.term = term
        self.shared_key = shared_key
        self.order = order
        self.openings = openings

    @property
    def start(self) -> Optional[int]:
        """The instant since which it holds; None if all events with which it may have begun were retracted."""
        openings = self.openings
        while openings:
            start, token = openings[0]
            if token is None or not token.retracted:
                return start
            openings.pop(0)
        return None


class PastState(NamedTuple):
    """A state that has ended: its interval, and the occurrence of its event if events are tracked."""

    key: Hashable
    term: Term
    start: int
    end: int
    token: Optional[Occurrence]

    @property
    def retracted(self) -> bool:
        """True if its event was retracted."""
        return self.token is not None and self.token.retracted


class DeclaredState(StateOwner):
    """One declaration with its open and past states.

    As the code of a frame ``(self, ended states, next frame)`` it dispatches the events of states that have ended.

    Args:
        logic: the system whose machine processes events.
        dispatcher: dispatcher of the events that begin and end states.
        clock: calls alarms for states that end by themselves.
        watermarks: the watermarks that such ends wait for.
        warn: receives warnings.

    Attributes:
        open: open states by the keys of their terms, oldest first.
        past: past states, newest last.
        timeouts: deadlines of open states that end by themselves.
        dropped_count: number of states that were dropped because too many were open.
        version: changes with each change of the states; unique among all declarations.
    """

    STATE = StateFields(
        field("next_order", COUNT),
        field(
            "stored_open_states",
            rows_of(
                StoredOpenState,
                order=COUNT,
                key=KEY,
                term=CALLABLE_TERM,
                shared_key=KEY,
                openings=sequence_of(tuple_of(INSTANT, OPTIONAL_EVENT), min_count=1),
            ),
        ),
        field(
            "stored_past_states",
            rows_of(
                PastState,
                key=KEY,
                term=CALLABLE_TERM,
                start=INSTANT,
                end=INSTANT,
                token=OPTIONAL_EVENT,
            ),
        ),
        field("dropped_count", COUNT),
        part("timeouts"),
        constraint(
            "states with increasing orders",
            lambda declaration, state: are_increasing_orders(
                [open_state.order for open_state in state["stored_open_states"]], state["next_order"]
            ),
        ),
        constraint(
            "declared states that have begun",
            lambda declaration, state: all(map(declaration.has_begun, state["stored_open_states"])),
        ),
        constraint(
            "distinct states",
            lambda declaration, state: (
                len({open_state.key for open_state in state["stored_open_states"]})
                == len(state["stored_open_states"])
            ),
        ),
    )

    def __init__(
        self,
        form: StateForm,
        logic: PrologSystem,
        dispatcher: Dispatcher,
        clock: Clock,
        watermarks: Watermarks,
        warn: Warn,
    ):
        self.form = form
        self._logic = logic
        self._dispatcher = dispatcher
        self._warn = warn
        begin_vars, end_vars, state_vars = (
            variables(term) for term in (form.begin_event, form.end_event, form.state)
        )
        self.name = f"state {logic.brief(form.state, dict.fromkeys(state_vars, '_'))}"
        shared_vars = [var for var in state_vars if var in set(end_vars)]
        self._build_state_term = compile_builder(form.state, begin_vars, "state")
        self._shared_at_begin = [begin_vars.index(var) for var in shared_vars]
        self._shared_at_end = [end_vars.index(var) for var in shared_vars]
        self._unused_vars: Tuple[Set[Var], Set[Var]] = (
            set(begin_vars) - set(state_vars),
            set(end_vars) - set(shared_vars),
        )
        # An OrderedDict finds its first entry directly. A dict would search it behind all entries that were removed.
        self.open: OrderedDict[Hashable, OpenState] = OrderedDict()
        self._open_by_shared_key: Dict[Hashable, Dict[Hashable, OpenState]] = {}
        self._open_by_order: Dict[int, OpenState] = {}
        self._next_order = count()
        self.past: Deque[PastState] = deque(maxlen=form.max_past)
        self.dropped_count = 0
        self._searched_retractions = dispatcher.retractions
        """Number of retractions up to which the open states were searched for retracted ones."""
        self.version = next(_VERSIONS)
        self._clock = clock
        self.timeouts = Timeouts(
            clock,
            self._open_by_order,
            self._end_by_timeout,
            watermarks,
            watermarks.watch(frozenset(map(functor_of, (form.begin_event, form.end_event))))
            if form.max_duration is not None
            else PatternWatermark(),
        )
        self.listeners: List[Listener] = []

    def listen(self) -> None:
        """Start to receive events.

        The ending event is registered first, so that one event can end a state and begin the next one.
        """
        listen, (begin_vars, end_vars) = self._dispatcher.listen, self._unused_vars
        self.listeners = [
            listen(
                ListenerPhase.STATES, self.form.end_event, self._process_end_event, unread_variables=end_vars
            ),
            listen(
                ListenerPhase.STATES,
                self.form.begin_event,
                self._process_begin_event,
                unread_variables=begin_vars,
            ),
        ]

    def unlisten(self) -> None:
        """Stop receiving events."""
        for listener in self.listeners:
            self._dispatcher.remove(listener)
        self.listeners = []

    # ---- beginning -----------------------------------------------------------------------------------

    def _process_begin_event(self, term: Term, values: Values, start: int, end: int, frame: Frame) -> Frame:
        state = self._build_state_term(values)
        try:
            key = freeze(state)
            shared_key = tuple([freeze(values[position]) for position in self._shared_at_begin])
        except ValueError:
            self._warn_of_variables(term, "begins")
            return frame
        token = self._dispatcher.token() if self._dispatcher.tracks_lineage else None
        open_state = self.open.get(key)
        # A state does not hold if all events with which it may have begun were retracted.
        if open_state is not None and open_state.start is None:
            self._remove_open_state(open_state)
            open_state = None
        ended_states: List[PastState] = []
        if open_state is not None and self._has_expired(open_state, end):
            ended_states = self._end_expired([open_state])
            open_state = None
        if open_state is None:
            self._add_open_state(OpenState(key, state, shared_key, next(self._next_order), [(end, token)]))
        # The state holds already. This event would have begun it if the earlier ones are retracted.
        elif token is not None and len(open_state.openings) < _MAX_OPENINGS:
            open_state.openings.append((end, token))
            self.version = next(_VERSIONS)
        return self._dispatch_ended_states((self, iter(ended_states), frame)) if ended_states else frame

    def _add_open_state(self, state: OpenState) -> None:
        self.version = next(_VERSIONS)
        # Open states that never end would accumulate, so their number is bounded, and the oldest is dropped with a
        # warning.
        if len(self.open) >= self.form.max_open:
            self._remove_retracted_states()
        if len(self.open) >= self.form.max_open:
            self._drop_oldest(next(iter(self.open.values())))
        self._index_open_state(state)
        start = state.start
        if self.form.max_duration is not None and start is not None:
            self.timeouts.add_at(state.order, int(start) + self.form.max_duration)

    def _index_open_state(self, state: OpenState) -> None:
        self.open[state.key] = state
        self._open_by_shared_key.setdefault(state.shared_key, {})[state.key] = state
        self._open_by_order[state.order] = state

    def _remove_retracted_states(self) -> None:
        """Remove the open states that do not hold, because all events with which they may have begun were retracted.

        Each would take the place of a state that holds, which would be dropped instead.
        """
        retractions = self._dispatcher.retractions
        # The search visits all open states, so it is repeated only after a retraction.
        if retractions != self._searched_retractions:
            for state in list(self.open.values()):
                if state.start is None:
                    self._remove_open_state(state)
            self._searched_retractions = retractions

    def _drop_oldest(self, oldest: OpenState) -> None:
        self._remove_open_state(oldest)
        self.dropped_count += 1
        text = f"more than {self.form.max_open} are open; {self.dropped_count} of the oldest have been dropped so far"
        self._warn(f"{self.name}: {text}", ("open", self.name))

    def _remove_open_state(self, state: OpenState) -> None:
        self.version = next(_VERSIONS)
        del self.open[state.key]
        del self._open_by_order[state.order]
        states_with_key = self._open_by_shared_key[state.shared_key]
        del states_with_key[state.key]
        # Empty groups are removed: the values of states are unbounded in the long run.
        if not states_with_key:
            del self._open_by_shared_key[state.shared_key]

    def _warn_of_variables(self, event: Term, verb: str) -> None:
        text = f"{self._logic.brief(event)} has variables: it {verb} no state"
        self._warn(f"{self.name}: {text}", ("variables", self.name))

    # ---- ending --------------------------------------------------------------------------------------

    def _process_end_event(self, term: Term, values: Values, start: int, end: int, frame: Frame) -> Frame:
        try:
            states_to_end = self._open_by_shared_key.get(
                tuple([freeze(values[position]) for position in self._shared_at_end])
            )
        except ValueError:
            self._warn_of_variables(term, "ends")
            return frame
        if states_to_end is None:
            return frame
        token = self._dispatcher.token() if self._dispatcher.tracks_lineage else None
        # All states are ended before their events are dispatched: such an event may begin or end states of this
        # declaration.
        states = list(states_to_end.values())
        ended_states = self._end_expired([state for state in states if self._has_expired(state, start)])
        ended_by_event = [
            self._end_state(state, start, token) for state in states if state.order in self._open_by_order
        ]
        ended_states += [state for state in ended_by_event if state is not None]
        return self._dispatch_ended_states((self, iter(ended_states), frame))

    def _has_expired(self, state: OpenState, instant: int) -> bool:
        """Return whether a state ended by itself before an instant, and only waits for events that are late."""
        start, max_duration = state.start, self.form.max_duration
        if max_duration is None or start is None:
            return False
        return int(start) + max_duration <= min(instant, self._clock.reached())

    def _end_expired(self, states: Iterable[OpenState]) -> List[PastState]:
        """End states that have ended by themselves, and return them."""
        # Only states with a start and a bounded duration expire.
        ended_states = [
            self._end_state(state, int(state.start or 0) + (self.form.max_duration or 0), None)
            for state in states
        ]
        return [state for state in ended_states if state is not None]

    def _end_state(self, state: OpenState, end: int, token: Optional[Occurrence]) -> Optional[PastState]:
        """End a state and return it; return None if it begins after the instant, or its beginning was retracted."""
        start = state.start
        if start is not None and start > end:
            return None
        # This also sets a new version, which dependent tables compare.
        self._remove_open_state(state)
        if start is None:
            return None
        occurrence = None
        if self._dispatcher.tracks_lineage:
            occurrence = Occurrence(state.term, start, end, None, None)
            occurrence.derive_from([source for source in (state.openings[0][1], token) if source is not None])
        past_state = PastState(state.key, state.term, start, end, occurrence)
        self.past.append(past_state)
        return past_state

    def run(self, frame: Frame) -> Frame:
        """Dispatch the events of the remaining states."""
        return self._dispatch_ended_states(frame)

    def _dispatch_ended_states(self, frame: Frame) -> Frame:
        """Dispatch the events of states that have ended, one after the other."""
        ended_states: Iterator[PastState] = frame[1]
        for past_state in ended_states:
            next_frame = self._dispatcher.dispatch(
                past_state.term, past_state.start, past_state.end, frame, past_state.token, True
            )
            if next_frame is not frame:
                return next_frame
        continuation: Frame = frame[2]
        return continuation

    def _end_by_timeout(self, order: int, instant: int) -> None:
        """End a state whose time has passed."""
        state, max_duration = self._open_by_order[order], self.form.max_duration
        start = state.start
        if max_duration is not None and start is not None and int(start) + max_duration > instant:
            # The first opening was retracted, so the state began later.
            self.timeouts.add_at(order, int(start) + max_duration)
            return
        ended_state = self._end_state(state, int(instant), None)
        if ended_state is not None:
            machine = self._logic.machine
            # The alarm may be called while another event is dispatched; the event of the state does not depend on it.
            self._dispatcher.run_without_context(
                lambda: machine.run(self._dispatch_ended_states((self, iter([ended_state]), machine.done)))
            )

    # ---- queries -------------------------------------------------------------------------------------

    def open_states(self, key: Optional[Hashable]) -> List[Tuple[Term, int]]:
        """Return the terms and starts of open states: of the state with a key, or of all if the key is None."""
        states = list(self.open.values()) if key is None else [self.open[key]] if key in self.open else []
        return [(state.term, start) for state in states for start in (state.start,) if start is not None]

    def states_at(self, key: Optional[Hashable], instant: int) -> List[Term]:
        """Return the terms of stored states that held at an instant; ``key`` as in `open_states`."""
        terms: Dict[Hashable, Term] = {}
        for past_state in list(self.past):
            if (
                key in (None, past_state.key)
                and past_state.start <= instant <= past_state.end
                and not past_state.retracted
            ):
                terms[past_state.key] = past_state.term
        max_duration = self.form.max_duration
        for term, start in self.open_states(key):
            # A state that ends by itself may still be open, because its end waits for late events.
            if start <= instant and (max_duration is None or instant <= int(start) + max_duration):
                terms[freeze(term)] = term
        return list(terms.values())

    # ---- administration --------------------------------------------------------------------------------

    def clear(self) -> None:
        """Remove all open and past states, because the clock went back or the declaration was deleted."""
        self.close(True)

    def drop_after(self, instant: int) -> None:
        """Remove the open states that begin after an instant: no event with the present time could end them."""
        for state in list(self.open.values()):
            if state.start is not None and state.start > instant:
                self._remove_open_state(state)

    def close(self, includes_past: bool) -> None:
        """Remove the open states, and with ``includes_past`` also the past ones."""
        self.version = next(_VERSIONS)
        for index in (self.open, self._open_by_shared_key, self._open_by_order):
            index.clear()
        self.timeouts.clear()
        if includes_past:
            self.past.clear()

    next_order = NextNumber("_next_order", "The order of the next state that begins.")

    @property
    def stored_open_states(self) -> List[StoredOpenState]:
        """The open states; one whose beginning was retracted does not hold, and is left out."""
        return [
            StoredOpenState(state.order, state.key, state.term, state.shared_key, list(state.openings))
            for state in self.open.values()
            if state.start is not None
        ]

    @stored_open_states.setter
    def stored_open_states(self, states: Sequence[StoredOpenState]) -> None:
        for order, key, term, shared_key, openings in states:
            self._index_open_state(OpenState(key, term, shared_key, order, list(openings)))

    @property
    def stored_past_states(self) -> List[PastState]:
        """The past states."""
        return list(self.past)

    @stored_past_states.setter
    def stored_past_states(self, states: Sequence[PastState]) -> None:
        self.past.extend(states)

    def restore(self, saved: State) -> None:
        """Set the states of an equal declaration; the clock restores their alarms."""
        self.version = next(_VERSIONS)
        super().restore(saved)

    def has_begun(self, state: StoredOpenState) -> bool:
        """Return whether a restored state is of this declaration, and its key is that of its term."""
        return state.key == term_key(state.term) and may_unify(self.form.state, state.term)


MAX_STATES = 1000
"""Maximum number of declarations."""

_STATE3, _STATE4 = functor("state", 3), functor("state", 4)


class StateRegistry:
    """All state declarations of a program.

    Args:
        logic: the system in which the predicates are defined.
        dispatcher: dispatcher of the events that begin and end states.
        clock: calls alarms for states that end by themselves.
        watermarks: the watermarks that such ends wait for.
        warn: receives warnings.
        on_event: called with each event of a declaration before it is declared; may raise an error.
    """

    def __init__(
        self,
        logic: PrologSystem,
        dispatcher: Dispatcher,
        clock: Clock,
        watermarks: Watermarks,
        warn: Warn,
        on_event: Callable[[Term], None],
    ):
        self._logic = logic
        self._dispatcher = dispatcher
        self._clock = clock
        self._watermarks = watermarks
        self._warn = warn
        self.on_event = on_event
        self._declarations: Dict[Hashable, DeclaredState] = {}
        self._detached: Dict[Hashable, DeclaredState] = {}
        self._declarations_by_functor: Dict[Functor, List[DeclaredState]] = {}
        self._tables = tables_of(logic.machine)
        _StatePredicates(self).define(logic)

    def __iter__(self) -> Iterator[DeclaredState]:
        return iter(list(self._declarations.values()))

    def declare(self, definition: Term) -> None:
        """Declare a state; a declaration that exists already continues.

        Raises:
            UsageError: if the term is not a declaration; the message says what was expected.
            PrologError: if the state is declared differently, or there are too many.
        """
        form = parse_state_declaration(copy(definition))
        existing = self._declarations.get(form.key)
        if existing is not None:
            if _are_equal_forms(existing.form, form):
                return
            raise permission_error("create", "state", form.state, "it is declared otherwise already")
        if len(self._declarations) >= MAX_STATES:
            raise resource_error("states", reason=f"more than {MAX_STATES} states are declared")
        detached_declaration = self._detached.get(form.key)
        # The declaration was detached by a reload and is unchanged: it keeps its open states.
        if detached_declaration is not None and _are_equal_forms(detached_declaration.form, form):
            declaration = self._detached.pop(form.key)
        else:
            declaration = DeclaredState(
                form, self._logic, self._dispatcher, self._clock, self._watermarks, self._warn
            )
        declaration.listen()
        self._declarations[form.key] = declaration
        self._index_by_functor()

    def delete(self, state: Term) -> bool:
        """Delete the declarations whose states unify with a term; return whether there were any."""
        keys = [
            key for key, declaration in self._declarations.items() if may_unify(declaration.form.state, state)
        ]
        for key in keys:
            declared = self._declarations.pop(key)
            declared.unlisten()
            declared.clear()
        self._index_by_functor()
        return bool(keys)

    def _index_by_functor(self) -> None:
        """Build the index of declarations by the functors of their states."""
        by_functor: Dict[Functor, List[DeclaredState]] = {}
        for declaration in self._declarations.values():
            by_functor.setdefault(declaration.form.functor, []).append(declaration)
        self._declarations_by_functor = by_functor

    def declarations_with_functor_of(self, state: Any) -> Sequence[DeclaredState]:
        """Return the declarations of states with the functor of an atom or a compound term."""
        return self._declarations_by_functor.get(state[0] if state.__class__ is tuple else state.functor, ())

    def declarations_for(self, state: Any) -> Tuple[Sequence[DeclaredState], Optional[Hashable]]:
        """Return the declarations that a query refers to, and the key of the state if the query is ground.

        An incremental table that is being evaluated depends on them from then on.

        Raises:
            PrologError: if there is no such state.
        """
        if state.__class__ is Var:
            if self._tables.active:
                self._tables.record_read(self.version, None)
            return list(self._declarations.values()), None
        callable_of(state)
        key = state[0] if state.__class__ is tuple else state.functor
        if self._tables.active:
            self._tables.record_read(self.version, key)
        declarations = self.declarations_with_functor_of(state)
        if not declarations:
            names = {functor.name: functor for functor in self._declarations_by_functor}
            closest = closest_name(key.name, names, 0.66)
            hint = (CONTEXT, Var(), atom(f"did you mean {names[closest]}?")) if closest else None
            raise existence_error("state", indicator(key), hint)
        try:
            return declarations, freeze(state)
        except ValueError:
            return declarations, None

    def version(self, part: Hashable) -> object:
        """Return a value that changes with the states of a functor; with None, with the states of all functors."""
        declarations: Iterable[DeclaredState] = self._declarations.values()
        if part is not None:
            declarations = self._declarations_by_functor.get(part, ())  # type: ignore[call-overload]
        return self._dispatcher.retractions, tuple([declaration.version for declaration in declarations])

    # ---- administration --------------------------------------------------------------------------------

    def clear(self) -> None:
        """Remove all open and past states, because the clock went back; the declarations remain."""
        for declaration in self._declarations.values():
            declaration.clear()

    def drop_after(self, instant: int) -> None:
        """Remove the open states that begin after an instant."""
        for declaration in self._declarations.values():
            declaration.drop_after(instant)

    def close(self, includes_past: bool) -> None:
        """Remove the open states, and with ``includes_past`` also the past ones; no events are dispatched."""
        for declaration in self._declarations.values():
            declaration.close(includes_past)

    def all_by_key(self) -> Dict[Hashable, DeclaredState]:
        """Return all declarations by their keys."""
        return dict(self._declarations)

    def detach(self, keys: Iterable[Hashable]) -> None:
        """Remove declarations; those that are declared again without a change continue with their states."""
        for key in keys:
            declaration = self._detached[key] = self._declarations.pop(key)
            declaration.unlisten()
        self._index_by_functor()

    def discard_detached(self) -> None:
        """Delete the declarations that were detached and not declared again."""
        for declaration in self._detached.values():
            declaration.clear()
        self._detached.clear()

    def restore_all(self, saved_declarations: Dict[Hashable, DeclaredState]) -> None:
        """Restore exactly these declarations, whether or not they have been detached meanwhile."""
        self.detach(list(self._declarations))
        self._detached = {**self._detached, **saved_declarations}
        for declaration in saved_declarations.values():
            self.declare(declaration.form.term)
        self.discard_detached()


class _StatePredicates:
    """The predicates ``state``, ``delete_state``, ``holds`` and ``holds_at``."""

    def __init__(self, states: StateRegistry):
        self.states = states

    def define(self, logic: PrologSystem) -> None:
        logic.define("state", 3, lambda machine, *parts: self.declare((_STATE3, *parts)))
        logic.define("state", 4, lambda machine, *parts: self.declare((_STATE4, *parts)))
        logic.define("delete_state", 1, lambda machine, state: self.states.delete(deref(state)))
        logic.define_nondeterministic("holds", 1, self.holds)
        logic.define_nondeterministic("holds", 2, self.holds_since)
        logic.define_nondeterministic("holds_at", 2, self.holds_at)

    def declare(self, goal: Term) -> bool:
        try:
            # The events are checked first: if one is refused, nothing has been declared.
            for event in parse_state_declaration(goal).events:
                self.states.on_event(event)
            self.states.declare(goal)
        except UsageError as error:
            raise domain_error("state", goal, error.message) from None
        return True

    def holds(self, machine: Machine, state: Term) -> Union[bool, Iterator[bool]]:
        declarations, key = self.states.declarations_for(deref(state))
        if key is not None:
            return any(declaration.open_states(key) for declaration in declarations)
        solutions = [(term,) for declaration in declarations for term, _ in declaration.open_states(None)]
        return _unify_each_solution(machine, (state,), solutions)

    def holds_since(self, machine: Machine, state: Term, start: Term) -> Iterator[bool]:
        declarations, key = self.states.declarations_for(deref(state))
        solutions = [
            (term, lazy_term(instant))
            for declaration in declarations
            for term, instant in declaration.open_states(key)
        ]
        return _unify_each_solution(machine, (state, start), solutions)

    def holds_at(self, machine: Machine, state: Term, time: Term) -> Union[bool, Iterator[bool]]:
        declarations, key = self.states.declarations_for(deref(state))
        instant = instant_of(time)
        solutions = [(term,) for declaration in declarations for term in declaration.states_at(key, instant)]
        return bool(solutions) if key is not None else _unify_each_solution(machine, (state,), solutions)


def _unify_each_solution(
    machine: Machine, terms: Tuple[Term, ...], solutions: Sequence[Tuple[Term, ...]]
) -> Iterator[bool]:
    """Unify terms with one solution after the other."""
    for solution in solutions:
        if machine.unify_all(*zip(terms, solution)):
            yield True


def _are_equal_forms(first: StateForm, second: StateForm) -> bool:
    return term_key(first.term) == term_key(second.term)
