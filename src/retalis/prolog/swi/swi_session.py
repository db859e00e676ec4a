"""Start of SWI-Prolog in this process, and execution of goals in its engines.

SWI-Prolog is started once for all programs, and loads ``bridge.pl``. Its clauses call predicates of a program through
the callback ``$retalis_ask/1``.

An engine is attached to its thread for each call and detached after it. A goal that may have more solutions remains
open as a query. SWI-Prolog requires that the innermost open query is used first. The machine of the program
backtracks in the same order, except when solutions are dropped out of order, such as by Python's garbage collection.
Such a query is marked as abandoned, and closed as soon as it is the innermost one.

Calls nest: a goal in SWI-Prolog may call back a goal of the program (`SwiEngine.run_callback`), which may call
SWI-Prolog again. Each nesting is a `GoalLevel`. An exception at any point, including one of a signal handler, is
followed by `_restore`, which returns the engine to the state at the start of the level, however far the call had
proceeded.
"""

from contextlib import closing
from ctypes import byref, c_void_p
from functools import lru_cache, partial
from pathlib import Path
from threading import Lock, get_ident, local
from time import monotonic
from typing import Any, Callable, Iterator, List, MutableMapping, NamedTuple, Optional, Tuple, Union
from weakref import WeakValueDictionary, finalize

from ...foundation.errors import RetalisError, UsageError
from ..machine.errors import PrologError, from_python, resource_error
from ..machine.machine import LAST, Machine
from ..machine.resource_limits import MEGABYTE, LimitError, RemainingLimits
from ..system.prolog_system import PrologSystem
from ..terms.list_terms import make_list
from ..terms.term_traversal import copy, variant_key
from ..terms.types import COLON, SLASH, Term, Values, Var, atom, functor
from .libswipl import (
    BRIDGE_MODULE,
    FAILED,
    LAST_SOLVED,
    QUERY_FLAGS,
    RAISED,
    SOLVED,
    Callbacks,
    Interrupter,
    LimitedGoal,
    SwiLibrary,
    UnaryCallback,
    find_library,
    preserved_signal_stack,
    signal_stack_predicates,
)
from .swi_terms import Bindings, Refs, SwiTerms

_BRIDGE_FILE = Path(__file__).resolve().parent / "bridge.pl"
"""Prolog file that is loaded into SWI-Prolog at its start."""

# `lru_cache` alone would let two threads start SWI-Prolog at once.
_START_LOCK = Lock()


class SwiRuntime(NamedTuple):
    """The running SWI-Prolog of this process.

    Attributes:
        swi: functions of the library.
        interrupter: thread that interrupts goals that exceed a limit.
        engines: engines by their numbers in SWI-Prolog.
        callbacks: functions that C calls, which must not be freed.
    """

    swi: SwiLibrary
    interrupter: Interrupter
    engines: "MutableMapping[int, SwiEngine]"
    callbacks: object


def start() -> SwiRuntime:
    """Start SWI-Prolog at the first call, and return it.

    Raises:
        UsageError: if it is not installed or does not start.
    """
    with _START_LOCK:
        return _start_runtime()


@lru_cache(maxsize=1)
def _start_runtime() -> SwiRuntime:
    swi = find_library()
    swi.start()
    engines: MutableMapping[int, SwiEngine] = WeakValueDictionary()

    callback_list: Any = Callbacks(engines, swi.thread_self, partial(_raise_unknown_engine, swi))
    callbacks: List[Tuple[str, int, Any]] = [("$retalis_ask", 1, UnaryCallback(callback_list))]
    callbacks += [(name, 0, function) for name, function in signal_stack_predicates()]
    for name, arity, callback in callbacks:
        # Registered before the bridge is loaded, which refers to these predicates.
        swi.register(BRIDGE_MODULE.encode(), name.encode(), arity, callback, 0)
    ref = swi.new_refs(1)
    SwiTerms(swi).put(ref, atom(str(_BRIDGE_FILE)), {})
    if not swi.call_predicate(None, 0, swi.predicate(b"consult", 1, b"user"), ref):
        raise UsageError(f"SWI-Prolog does not load {_BRIDGE_FILE}")
    swi.detach_thread()
    return SwiRuntime(swi, Interrupter(swi), engines, callbacks)


def _raise_unknown_engine(swi: SwiLibrary) -> None:
    """Raise the error for a callback from a thread of SWI-Prolog, which belongs to no program."""
    ref = swi.new_refs(1)
    error_term = (functor("existence_error", 2), atom("retalis_engine"), (SLASH, atom("retalis"), 1))
    SwiTerms(swi).put(ref, (functor("error", 2), error_term, Var()), {})
    swi.raise_exception(ref)


class OpenGoal:
    """An open query of a goal that may have more solutions.

    Attributes:
        query: handle of the query.
        foreign_frame: handle of the foreign frame to discard when the query is closed.
        refs: term references of the variables of the goal.
        is_abandoned: whether no further solutions are needed.
        is_closed: whether the query has been closed.
    """

    __slots__ = ("query", "foreign_frame", "refs", "is_abandoned", "is_closed")

    def __init__(self, query: int, frame: int, refs: Refs):
        self.query = query
        self.foreign_frame = frame
        self.refs = refs
        self.is_abandoned = self.is_closed = False


class GoalLevel(NamedTuple):
    """A level of nested calls: the outermost goals of an engine, or the goals within a callback.

    Attributes:
        open_before: number of open goals when the level began.
        query: query that has called back; 0 at the outermost level.
        depth: number of nested attachments of the engine.
        limited_goal: running goal with limits.
    """

    open_before: int
    query: int
    depth: int
    limited_goal: Optional[LimitedGoal]


_FAILURE = atom("$retalis_failure")

_CLEANUP_TIMEOUT_SECONDS = 1.0
"""Time limit for the cleanup of a goal whose other solutions are not needed."""

_MAX_CALLBACK_SOLUTIONS = 100_000
"""Maximum number of solutions of a goal in a callback."""


class SwiEngine:
    """An engine of SWI-Prolog that runs goals of a program in one thread.

    Callbacks run on the machine of the program, inside the goal that has called SWI-Prolog.

    Attributes:
        limited_goal: the running goal, if it has limits.
        limited_predicate: handle of the predicate of the bridge that calls a goal with an inference limit.
    """

    def __init__(self, logic: PrologSystem, runtime: SwiRuntime):
        self._logic = logic
        self._budget = logic.machine.budget
        self._runtime = runtime
        self._swi = swi = runtime.swi
        self._interrupter = runtime.interrupter
        self.limited_goal: Optional[LimitedGoal] = None
        self._thread = get_ident()
        self._depth = 0
        self._is_in_use = False
        self._previous_engine = c_void_p()
        self._previous_engine_ref = byref(self._previous_engine)
        self._open_goals: List[OpenGoal] = []
        self._level = GoalLevel(0, 0, 0, None)
        self._stored_error: Optional[BaseException] = None
        # A list, because the finalizer must set the flag without a reference to this object.
        self._destroyed: List[bool] = []
        with preserved_signal_stack():
            self._engine = swi.create_engine(None)
        self._enter()
        try:
            self.number: int = swi.thread_self()
            self._terms = SwiTerms(swi)
            # The finalizer must not refer to the engine object, which it would keep alive.
            finalize(self, _destroy_engine, swi, self._engine, self._terms, self._destroyed).atexit = False
            self.limited_predicate: int = swi.predicate(b"limited", 2, BRIDGE_MODULE.encode())
            self._statistics_predicate = swi.predicate(b"statistics", 2, b"system")
        finally:
            self._leave()
        runtime.engines[self.number] = self
        self._interrupter.add(self)

    def predicate_handle(self, module: str, name: str, arity: int) -> int:
        """Return the handle of a predicate."""
        swi = self._swi
        level = self._level
        foreign_frame = 0
        try:
            self._enter()
            foreign_frame = swi.open_frame()
            module_handle = swi.new_module(self._terms.handle(atom(module)))
            predicate: int = swi.predicate_of(
                swi.new_functor(self._terms.handle(atom(name)), arity), module_handle
            )
            # The handle of a predicate stays valid without the frame: SWI-Prolog never frees predicates.
            swi.discard_frame(foreign_frame)
            self._leave()
        except BaseException as error:
            self._restore(level, error, foreign_frame)
            raise
        return predicate

    def _enter(self) -> None:
        """Attach the engine to this thread."""
        if self._is_in_use:  # an exception has interrupted `_restore`
            self._restore(self._level, None)
        self._is_in_use = True
        # Only the outermost call attaches the engine; nested ones find it attached.
        if not self._depth and self._swi.set_engine(self._engine, self._previous_engine_ref):
            raise RetalisError("an engine of SWI-Prolog is in use by another thread")
        self._depth += 1

    def _leave(self) -> None:
        """Detach the engine from this thread, at the outermost level."""
        self._depth -= 1
        if not self._depth:
            self._swi.set_engine(self._previous_engine.value, None)
        self._is_in_use = False

    def _restore(self, level: GoalLevel, error: Optional[BaseException], foreign_frame: int = 0) -> None:
        """Restore the state at the start of a level after an exception.

        Args:
            level: the level to restore.
            error: the exception, or None. If it is None or not an error of a goal, such as an interrupt, all open
                goals of the level are closed.
            foreign_frame: foreign frame to discard; 0 for none.
        """
        swi = self._swi
        self._is_in_use = True
        self._level = level
        previous_engine = c_void_p()
        if swi.set_engine(self._engine, byref(previous_engine)):
            return
        if previous_engine.value != self._engine:  # the exception came before the engine was attached
            self._previous_engine.value = previous_engine.value
        # An interrupt for a goal that has ended must not hit the next one.
        if self.limited_goal is not level.limited_goal:
            self.limited_goal = level.limited_goal
            self._interrupter.wait_for_interrupt()
        abandoned_goals = []
        if not isinstance(error, Exception):
            abandoned_goals = self._open_goals[level.open_before :]
            del self._open_goals[level.open_before :]
        # SWI-Prolog's own list of queries is authoritative: a query may have been opened without being recorded here.
        innermost_query = (
            self._open_goals[-1].query if len(self._open_goals) > level.open_before else level.query
        )
        while swi.current_query() not in (0, innermost_query):
            self._close_query(swi.current_query())
        for open_goal in abandoned_goals:
            open_goal.is_closed = True
        foreign_frame = abandoned_goals[0].foreign_frame if abandoned_goals else foreign_frame
        if foreign_frame:
            swi.discard_frame(foreign_frame)
        self._depth = level.depth
        if not self._depth:
            swi.set_engine(self._previous_engine.value, None)
        self._is_in_use = False

    # Goals

    def call(
        self, machine: Machine, predicate: int, arguments: Values, remaining: Optional[RemainingLimits]
    ) -> Union[bool, Iterator[object]]:
        """Call a predicate; return whether it succeeds, or its solutions if there may be several.

        Args:
            machine: the machine of the program.
            predicate: handle of the predicate.
            arguments: arguments of the call.
            remaining: resources that the goal may still use; None if it has no limits.
        """
        swi, terms, level = self._swi, self._terms, self._level
        foreign_frame = 0
        try:
            self._enter()
            if self._open_goals:
                self._close_abandoned()
            foreign_frame = swi.open_frame()
            refs: Refs = {}
            first = ref = swi.new_refs(len(arguments) or 1)
            for argument in arguments:
                terms.put(ref, argument, refs)
                ref += 1
            query = swi.open_query(None, QUERY_FLAGS, predicate, first)
            status = self._next_solution(query, remaining)
            if status == RAISED:
                raise self._read_exception(query)
            bindings = [] if status == FAILED else self._read_bindings(refs)
            if status == SOLVED:
                open_goal = OpenGoal(query, foreign_frame, refs)
                self._open_goals.append(open_goal)
            else:
                swi.close_finished_query(query)
                swi.discard_frame(foreign_frame)
            self._leave()
        except BaseException as error:
            self._restore(level, error, foreign_frame)
            raise
        if status == SOLVED:
            return self._solutions(machine, open_goal, bindings)
        return status != FAILED and (not bindings or machine.unify_all(*bindings))

    def _read_bindings(self, refs: Refs) -> Bindings:
        """Return the values of the variables of a solution.

        The marks of variables are undone at once: a cleanup of the goal, which runs when the query is closed, could
        store them.
        """
        foreign_frame = self._swi.open_frame()
        bindings = self._terms.read_values(refs)
        self._swi.discard_frame(foreign_frame)
        return bindings

    def _solutions(self, machine: Machine, open_goal: OpenGoal, bindings: Bindings) -> Iterator[object]:
        """Yield at each solution of an open goal; ``bindings`` are those of the first one."""
        try:
            while True:
                if machine.unify_all(*bindings):
                    yield LAST if open_goal.is_closed else None
                # The goal was closed because this was its last solution, or by `_restore`.
                if open_goal.is_closed:
                    return
                next_bindings = self._next_bindings(open_goal)
                if next_bindings is None:
                    return
                bindings = next_bindings
        finally:
            if not open_goal.is_closed:
                self._abandon_goal(open_goal)

    def _next_bindings(self, open_goal: OpenGoal) -> Optional[Bindings]:
        """Return the bindings of the next solution, or None if there is none."""
        if self._thread != get_ident():
            raise RetalisError(
                "solutions in SWI-Prolog must be requested by the thread that requested the first one"
            )
        level = self._level
        remaining = self._budget.remaining_limits()
        try:
            self._enter()
            if self._open_goals[-1:] != [open_goal]:
                self._close_abandoned()
            if self._open_goals[-1:] != [open_goal]:
                raise RetalisError(
                    "solutions of an outer goal were requested while an inner one is still open"
                )
            status = self._next_solution(open_goal.query, remaining)
            if status == RAISED:
                raise self._read_exception(open_goal.query)
            bindings = None if status == FAILED else self._read_bindings(open_goal.refs)
            if status == LAST_SOLVED:
                open_goal.is_abandoned = True
                self._close_abandoned()
            self._leave()
        except BaseException as error:
            self._restore(level, error)
            raise
        return bindings

    def _next_solution(self, query: int, remaining: Optional[RemainingLimits]) -> int:
        """Request the next solution of a query; return the status.

        Raises:
            PrologError: if a limit has been exceeded.
        """
        self._stored_error = None
        if remaining is None:
            status: int = self._swi.next_solution(query)
        else:
            # SWI-Prolog counts the inferences, which are added to the budget of the program afterwards.
            start_inferences = 0 if remaining.inferences is None else self._count_inferences()
            outer_limited_goal = self.limited_goal
            limited_goal = self.limited_goal = LimitedGoal(remaining, self.number, start_inferences)
            if self._interrupter.is_idle:
                self._interrupter.start()
            try:
                status = self._swi.next_solution(query)
            finally:
                self.limited_goal = outer_limited_goal
            if limited_goal.exceeded_resource:
                # The interrupt may still be in progress. Without the wait it would hit the next goal.
                self._interrupter.wait_for_interrupt()
                raise self._limit_error(limited_goal.exceeded_resource)
            if remaining.inferences is not None:
                self._budget.check_limits(self._count_inferences() - start_inferences)
        stored_error = self._stored_error
        if stored_error is not None and not isinstance(stored_error, Exception):
            self._stored_error = None
            raise stored_error
        return status

    def _limit_error(self, resource: str) -> PrologError:
        stored_error, self._stored_error = self._stored_error, None
        if isinstance(stored_error, LimitError):
            return stored_error
        # If the limit is exceeded according to the budget too, the budget raises its own error.
        self._budget.check_limits(0)
        return resource_error(resource)

    def _count_inferences(self) -> int:
        swi = self._swi
        foreign_frame = swi.open_frame()
        try:
            ref = swi.new_refs(2)
            self._terms.put(ref, atom("inferences"), {})
            swi.call_predicate(None, QUERY_FLAGS, self._statistics_predicate, ref)
            return self._terms.read(ref + 1)  # type: ignore
        finally:
            swi.discard_frame(foreign_frame)

    def _read_exception(self, query: int) -> BaseException:
        """Return the error that has ended a goal."""
        terms = self._terms
        # An error term may contain handles such as streams, which are read as text.
        terms.start_reading(lenient=True)
        ball = terms.read(self._swi.exception(query))
        stored_error, self._stored_error = self._stored_error, None
        if stored_error is not None and (ball is _FAILURE or _is_same_error(stored_error, ball)):
            return stored_error
        return PrologError(ball)

    # End of goals

    def _abandon_goal(self, open_goal: OpenGoal) -> None:
        """Close a goal now, or before the next one if the engine is in use or this is another thread."""
        open_goal.is_abandoned = True
        # A generator may be finalized at any time and in any thread. In these cases the next call closes the goal.
        if self._is_in_use or self._thread != get_ident() or self._destroyed:
            return
        level = self._level
        try:
            self._enter()
            self._close_abandoned()
            self._leave()
        except BaseException as error:
            self._restore(level, error)
            raise

    def _close_abandoned(self) -> None:
        """Close the innermost goals of this level as long as no further solutions of them are needed."""
        while len(self._open_goals) > self._level.open_before and self._open_goals[-1].is_abandoned:
            self._close_innermost()

    def _close_innermost(self) -> None:
        open_goal = self._open_goals.pop()
        open_goal.is_closed = True
        self._close_query(open_goal.query)
        self._swi.discard_frame(open_goal.foreign_frame)

    def _close_query(self, query: int) -> None:
        """Close a query, with a time limit for its cleanup goals."""
        outer_limited_goal = self.limited_goal
        limited_goal = self.limited_goal = LimitedGoal(
            RemainingLimits(monotonic() + _CLEANUP_TIMEOUT_SECONDS, None, None), self.number
        )
        if self._interrupter.is_idle:
            self._interrupter.start()
        try:
            self._swi.close_query(query)
        finally:
            self.limited_goal = outer_limited_goal
        if limited_goal.exceeded_resource:
            self._interrupter.wait_for_interrupt()

    # Callbacks

    def run_callback(self, call_ref: int) -> bool:
        """Unify the second argument of a term with the list of all solutions of its first argument.

        Errors are raised in SWI-Prolog.

        Returns:
            Whether the callback succeeds.
        """
        swi, terms, outer_level = self._swi, self._terms, self._level
        try:
            # The callback is a new level, so an error in it closes only the goals that the callback has opened.
            level = GoalLevel(len(self._open_goals), swi.current_query(), self._depth, self.limited_goal)
            try:
                self._level, self._is_in_use = level, False
                goal = self._callback_goal(call_ref)
                solutions = make_list(self._all_solutions(goal))
                self._close_all()
                ref = swi.new_refs(1)
                swi.get_argument(2, call_ref, ref)
                terms.put(ref, solutions, {})
            except BaseException as error:  # no exception can be propagated through C
                self._restore(level, error)
                self._close_all()
                self.raise_in_swi(error)
                return False
            return True
        finally:
            self._level, self._is_in_use = outer_level, True

    def _callback_goal(self, call_ref: int) -> Term:
        swi, terms = self._swi, self._terms
        foreign_frame = swi.open_frame()
        try:
            terms.start_reading()
            ref = swi.new_refs(1)
            swi.get_argument(1, call_ref, ref)
            return terms.read(ref)
        finally:
            swi.discard_frame(foreign_frame)  # also undoes the bindings that mark variables

    def _close_all(self) -> None:
        while len(self._open_goals) > self._level.open_before:
            self._close_innermost()

    def _all_solutions(self, goal: Term) -> List[Term]:
        copies = []
        with closing(self._logic.solutions(goal)) as solutions:
            for _ in solutions:
                copies.append(copy(goal))
                if len(copies) > _MAX_CALLBACK_SOLUTIONS:
                    raise resource_error("solutions")
        return copies

    def raise_in_swi(self, error: BaseException) -> None:
        """Raise an error in SWI-Prolog.

        If the exception is not an error of a goal, such as an interrupt, it is stored, and raised again when
        SWI-Prolog returns.
        """
        prolog_error = from_python(error)
        self._stored_error = error if prolog_error is None or isinstance(prolog_error, LimitError) else None
        swi, terms = self._swi, self._terms
        ref = swi.new_refs(1)
        try:
            terms.put(ref, _FAILURE if prolog_error is None else prolog_error.term, {})
        except RetalisError:  # the error term is too large
            self._stored_error = prolog_error
            terms.put(ref := swi.new_refs(1), _FAILURE, {})
        swi.raise_exception(ref)


class SwiProgram:
    """SWI-Prolog as used by one program, with an engine for each thread that runs its goals.

    SWI-Prolog stores the position of the C stack with an engine, and aborts the process if a thread with another
    stack uses the engine. Therefore each engine belongs to one thread.
    """

    def __init__(self, logic: PrologSystem, runtime: SwiRuntime):
        self._logic = logic
        self._runtime = runtime
        self._threads = local()

    def predicate_caller(
        self, module: str, name: str, arity: int
    ) -> Callable[..., Union[bool, Iterator[object]]]:
        """Return the function that calls a predicate of a module, for `PrologSystem.define_nondeterministic`."""
        threads, budget = self._threads, self._logic.machine.budget
        predicate_handle = self.engine().predicate_handle(module, name, arity)
        key = functor(name, arity)
        module_atom = atom(module)

        def call(machine: Machine, *arguments: Term) -> Union[bool, Iterator[object]]:
            try:
                engine: SwiEngine = threads.engine
            except AttributeError:
                engine = self.engine()
            remaining = budget.remaining_limits()
            # SWI-Prolog counts inferences exactly. Its limit requires a wrapper goal, which is only used if the
            # program has such a limit.
            if remaining is not None and remaining.inferences is not None:
                goal = (COLON, module_atom, (key, *arguments) if arguments else atom(name))
                return engine.call(
                    machine, engine.limited_predicate, (goal, max(remaining.inferences, 0)), remaining
                )
            return engine.call(machine, predicate_handle, arguments, remaining)

        return call

    def engine(self) -> SwiEngine:
        """Return the engine of this thread."""
        engine: Optional[SwiEngine] = getattr(self._threads, "engine", None)
        if engine is None:
            engine = self._threads.engine = SwiEngine(self._logic, self._runtime)
            megabytes = self._logic.limits.megabytes
            if megabytes is not None:
                self.call_bridge("limit_stacks", int(megabytes * MEGABYTE))
        return engine

    def call_bridge(self, name: str, *arguments: Term) -> bool:
        """Call a predicate of the bridge once, and keep its bindings."""
        outcome = self.predicate_caller(BRIDGE_MODULE, name, len(arguments))(self._logic.machine, *arguments)
        if isinstance(outcome, bool):
            return outcome
        with closing(outcome) as solutions:  # type: ignore[type-var]
            return next(solutions, FAILED) is not FAILED


def _destroy_engine(swi: SwiLibrary, engine: int, terms: SwiTerms, destroyed: List[bool]) -> None:
    """Destroy an engine and release its atoms; called from any thread."""
    destroyed.append(True)  # Solutions that are dropped later must not use the engine.
    previous_engine = c_void_p()
    if not swi.set_engine(engine, byref(previous_engine)):
        try:
            terms.release()
        finally:
            swi.set_engine(previous_engine.value, None)
    swi.destroy_engine(engine)


def _is_same_error(stored_error: BaseException, ball: Term) -> bool:
    """Return whether an exception of SWI-Prolog is an error that a callback has raised there."""
    return isinstance(stored_error, PrologError) and variant_key(stored_error.term) == variant_key(ball)
