"""All states that a program has declared, and the goals that declare them and ask what holds."""

from typing import Any, Callable, Dict, Hashable, Iterable, Iterator, List, Optional, Sequence, Tuple, Union

from ...foundation import UsageError
from ...prolog.builtins import callable_of, instant_of, tables_of
from ...prolog.logic import Logic
from ...prolog.machine import (
    Machine,
    domain_error,
    existence_error,
    indicator,
    permission_error,
    resource_error,
)
from ...prolog.terms import Functor, Term, Var, copy, deref, freeze, functor, may_unify, shown, term_key
from ..dispatch import Dispatcher, Stage
from ..language import StateForm, state_form
from .recording import Warn
from .states import DeclaredState
from .timeouts import AlarmClock

MOST = 1000
"""Declarations that there may be."""

_STATE3, _STATE4 = functor("state", 3), functor("state", 4)


class States:
    """All states of a program.

    Args:
        logic: where the goals are defined.
        dispatcher: whose events begin and end states.
        clock: rings where states end by themselves.
        warn: takes a warning.

    Attributes:
        on_event: called with each event of a declaration before it is made; may raise an error.
    """

    def __init__(self, logic: Logic, dispatcher: Dispatcher, clock: AlarmClock, warn: Warn):
        self._logic = logic
        self._dispatcher = dispatcher
        self._clock = clock
        self._warn = warn
        self._all: Dict[Hashable, DeclaredState] = {}
        self._aside: Dict[Hashable, DeclaredState] = {}
        self._by_functor: Dict[Functor, List[DeclaredState]] = {}
        self._tables = tables_of(logic.machine)
        self.on_event: Callable[[Term], None] = lambda event: None
        _StateGoals(self).define(logic)

    def __iter__(self) -> Iterator[DeclaredState]:
        return iter(list(self._all.values()))

    def declare(self, definition: Term) -> None:
        """Have a state begin and end with events from now on; one that is declared so already goes on.

        Raises:
            UsageError: what was expected.
            PrologError: where it is declared otherwise, or there are too many.
        """
        form = state_form(copy(definition))
        known = self._all.get(form.key)
        if known is not None:
            if _same(known.form, form):
                return
            raise permission_error("create", "state", form.state, "it is declared otherwise already")
        if len(self._all) >= MOST:
            raise resource_error("states", reason=f"more than {MOST} states are declared")
        before = self._aside.get(form.key)
        if before is not None and _same(before.form, form):
            declared = self._aside.pop(form.key)
        else:
            declared = DeclaredState(form, self._logic, self._dispatcher, self._clock, self._warn)
        declared.listen()
        self._all[form.key] = declared
        self._note()

    def delete(self, state: Term) -> bool:
        """Forget the declarations whose states unify with a term, with what holds; tell whether there were any."""
        found = [key for key, one in self._all.items() if may_unify(one.form.state, state)]
        for key in found:
            declared = self._all.pop(key)
            declared.unlisten()
            declared.clear()
        self._note()
        return bool(found)

    def _note(self) -> None:
        """Know the declarations by the functors of their states."""
        found: Dict[Functor, List[DeclaredState]] = {}
        for one in self._all.values():
            found.setdefault(one.form.functor, []).append(one)
        self._by_functor = found

    def like(self, state: Any) -> Sequence[DeclaredState]:
        """Return the declarations of states with the functor of an atom or a compound term."""
        return self._by_functor.get(state[0] if state.__class__ is tuple else state.functor, ())

    def asked(self, state: Any) -> Tuple[Sequence[DeclaredState], Optional[Hashable]]:
        """Return the declarations that a question is about, and the key of the state where it names one.

        An incremental table that is evaluated depends on them.

        Raises:
            PrologError: where there is no such state.
        """
        if state.__class__ is Var:
            if self._tables.active:
                self._tables.note(self, None)
            return list(self._all.values()), None
        callable_of(state)
        key = state[0] if state.__class__ is tuple else state.functor
        if self._tables.active:
            self._tables.note(self, key)
        found = self.like(state)
        if not found:
            raise existence_error("state", indicator(key))
        try:
            return found, freeze(state)
        except ValueError:
            return found, None

    def version(self, part: Hashable) -> object:
        """Return a value that changes with the states of a functor, with None with all of them."""
        found = self._all.values() if part is None else self._by_functor.get(part, ())  # type: ignore[call-overload]
        return self._dispatcher.retractions, tuple([one.version for one in found])

    # ---- from outside --------------------------------------------------------------------------------

    def clear(self) -> None:
        """Forget what held (time went back); the declarations stay."""
        for one in self._all.values():
            one.clear()

    def close(self, past: bool) -> None:
        """Forget what holds, and which are over where that is asked for; no event tells of it."""
        for one in self._all.values():
            one.close(past)

    def standing(self) -> Dict[Hashable, DeclaredState]:
        """Return all by their keys."""
        return dict(self._all)

    def set_aside(self, keys: Iterable[Hashable]) -> None:
        """Take declarations out; those that are made again as they were go on."""
        for key in keys:
            found = self._aside[key] = self._all.pop(key)
            found.unlisten()
        self._note()

    def forget_aside(self) -> None:
        """Forget what was set aside."""
        for one in self._aside.values():
            one.clear()
        self._aside.clear()

    def restore_standing(self, before: Dict[Hashable, DeclaredState]) -> None:
        """Have these, which have been set aside meanwhile or not, and no others."""
        self.set_aside(list(self._all))
        self._aside = {**self._aside, **before}
        for one in before.values():
            self.declare(one.form.term)
        self.forget_aside()

    def mend(self) -> None:
        """Put right what an interrupt may have left half done."""
        self._note()
        for one in self._all.values():
            one.mend()
        chosen = {listener for one in self._all.values() for listener in one.listeners}
        self._dispatcher.keep_only(Stage.STATES, chosen)

    def kept(self) -> List[Any]:
        """Return what holds and held of each, in their order; see `restore`."""
        return [one.kept() for one in self._all.values()]

    def restore(self, kept: Sequence[Any]) -> None:
        """Have hold what others knew, that are declared alike."""
        for one, found in zip(self._all.values(), kept):
            one.restore(found)


class _StateGoals:
    """Goals about states."""

    def __init__(self, states: States):
        self.states = states

    def define(self, logic: Logic) -> None:
        logic.define("state", 3, lambda machine, *parts: self.declare((_STATE3, *parts)))
        logic.define("state", 4, lambda machine, *parts: self.declare((_STATE4, *parts)))
        logic.define("delete_state", 1, lambda machine, state: self.states.delete(deref(state)))
        logic.define_nondeterministic("holds", 1, self.holds)
        logic.define_nondeterministic("holds", 2, self.holds_since)
        logic.define_nondeterministic("holds_at", 2, self.held_at)

    def declare(self, goal: Term) -> bool:
        try:
            for event in state_form(goal).events:
                self.states.on_event(event)
            self.states.declare(goal)
        except UsageError as error:
            raise domain_error("state", goal, error.message) from None
        return True

    def holds(self, machine: Machine, state: Term) -> Union[bool, Iterator[bool]]:
        declared, key = self.states.asked(deref(state))
        if key is not None:
            return any(one.holding(key) for one in declared)
        found = [(term,) for one in declared for term, _ in one.holding(None)]
        return _solutions(machine, (state,), found)

    def holds_since(self, machine: Machine, state: Term, since: Term) -> Iterator[bool]:
        declared, key = self.states.asked(deref(state))
        found = [(term, shown(begin)) for one in declared for term, begin in one.holding(key)]
        return _solutions(machine, (state, since), found)

    def held_at(self, machine: Machine, state: Term, at: Term) -> Union[bool, Iterator[bool]]:
        declared, key = self.states.asked(deref(state))
        instant = instant_of(at)
        found = [(term,) for one in declared for term in one.holding_at(key, instant)]
        return bool(found) if key is not None else _solutions(machine, (state,), found)


def _solutions(
    machine: Machine, terms: Tuple[Term, ...], found: Sequence[Tuple[Term, ...]]
) -> Iterator[bool]:
    """Unify terms with one solution after the other."""
    for solution in found:
        if machine.unify_all(*zip(terms, solution)):
            yield True


def _same(one: StateForm, other: StateForm) -> bool:
    return term_key(one.term) == term_key(other.term)
