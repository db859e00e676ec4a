"""Execution of goals in an engine of SWI-Prolog.

An engine is attached to its thread for each call and detached after it. A goal that may have more solutions stays
open as a query. SWI-Prolog requires that the innermost open query is used first. The machine of the program
backtracks in the same order, except when solutions are dropped out of order, such as by Python's garbage collection:
such a query is marked and closed as soon as it is the innermost one.

Calls nest: a goal in SWI-Prolog may call back a goal of the program (`SwiEngine.answer`), which may call SWI-Prolog
again. Each nesting is a `GoalLevel`. An exception at any point, also one of a signal handler, is followed by
`_restore`, which returns the engine to the state at the start of the level: that state does not depend on how far the
call had proceeded.
"""

from contextlib import closing
from ctypes import byref, c_void_p
from threading import get_ident, local
from time import monotonic
from typing import Callable, Iterator, List, NamedTuple, Optional, Union
from weakref import finalize

from ...foundation.errors import RetalisError
from ..machine.errors import PrologError, from_python, resource_error
from ..machine.machine import LAST, Machine
from ..machine.resource_limits import MEGABYTE, Left, LimitError
from ..system.prolog_system import PrologSystem
from ..terms.list_terms import make_list
from ..terms.term_traversal import copy, variant_key
from ..terms.types import COLON, Term, Values, atom, functor
from .libswipl import (
    FAILED,
    LAST_SOLVED,
    QUERY_FLAGS,
    RAISED,
    SOLVED,
    LimitedGoal,
    SwiLibrary,
    signal_stack_kept,
)
from .swi_startup import BRIDGE, Started
from .swi_terms import Bindings, Refs, SwiTerms


class OpenGoal:
    """An open query of a goal that may have more solutions.

    Attributes:
        query: handle of the query.
        frame: handle of the foreign frame to discard with it.
        refs: term references of its variables.
        over: whether its other solutions are not needed.
        closed: whether it has been closed.
    """

    __slots__ = ("query", "frame", "refs", "over", "closed")

    def __init__(self, query: int, frame: int, refs: Refs):
        self.query = query
        self.frame = frame
        self.refs = refs
        self.over = self.closed = False


class GoalLevel(NamedTuple):
    """A level of nested calls: the outermost goals of an engine, or the goals within a callback.

    Attributes:
        base: number of goals that were open before.
        query: query that has called back; 0 at the outermost level.
        depth: number of nested attachments of the engine.
        watched: running goal with limits.
    """

    base: int
    query: int
    depth: int
    watched: Optional[LimitedGoal]


_LIMITED = functor("limited", 2)
_FAILURE = atom("$retalis_failure")

_CLEANUP_TIMEOUT_SECONDS = 1.0
"""Time limit for the cleanup of a goal whose other solutions are not needed."""

_MAX_CALLBACK_SOLUTIONS = 100_000
"""Limit for the solutions of a goal in a callback."""


class SwiEngine:
    """An engine of SWI-Prolog that runs goals of a program in one thread.

    Callbacks run on the machine of the program, inside the goal that has called SWI-Prolog.

    Args:
        logic: the program.
        started: the running SWI-Prolog.

    Attributes:
        watched: the running goal, if it has limits.
        number: number of the engine in SWI-Prolog.
        limited: handle of the predicate that calls a goal with a limit of inferences.
    """

    def __init__(self, logic: PrologSystem, started: Started):
        self._logic = logic
        self._budget = logic.machine.budget
        self._started = started
        self._swi = swi = started.swi
        self._interrupter = started.interrupter
        self.watched: Optional[LimitedGoal] = None
        self._thread = get_ident()
        self._depth = 0
        self._busy = False
        self._before = c_void_p()
        self._to_before = byref(self._before)
        self._open: List[OpenGoal] = []
        self._level = GoalLevel(0, 0, 0, None)
        self._stored_error: Optional[BaseException] = None
        self._ended: List[bool] = []
        with signal_stack_kept():
            self._engine = swi.create_engine(None)
        self._enter()
        try:
            self.number: int = swi.thread_self()
            self._terms = SwiTerms(swi)
            # The finalizer must not refer to the engine object, which it would keep alive.
            finalize(self, _destroy, swi, self._engine, self._terms, self._ended).atexit = False
            self.limited: int = swi.predicate(b"limited", 2, BRIDGE.encode())
            self._statistics = swi.predicate(b"statistics", 2, b"system")
        finally:
            self._leave()
        started.engines[self.number] = self
        self._interrupter.add(self)

    def handle(self, module: str, name: str, arity: int) -> int:
        """Return the handle of a predicate."""
        swi = self._swi
        level = self._level
        frame = 0
        try:
            self._enter()
            frame = swi.open_frame()
            module_handle = swi.new_module(self._terms.handle(atom(module)))
            predicate: int = swi.predicate_of(
                swi.new_functor(self._terms.handle(atom(name)), arity), module_handle
            )
            # The handle of a predicate stays valid without the frame: SWI-Prolog never frees predicates.
            swi.discard_frame(frame)
            self._leave()
        except BaseException as error:
            self._restore(level, error, frame)
            raise
        return predicate

    def _enter(self) -> None:
        """Attach the engine to this thread."""
        if self._busy:  # an exception has interrupted `_restore`
            self._restore(self._level, None)
        self._busy = True
        # Only the outermost call attaches the engine; nested ones find it attached.
        if not self._depth and self._swi.set_engine(self._engine, self._to_before):
            raise RetalisError("an engine of SWI-Prolog is in use by another thread")
        self._depth += 1

    def _leave(self) -> None:
        """Detach the engine from this thread, at the outermost level."""
        self._depth -= 1
        if not self._depth:
            self._swi.set_engine(self._before.value, None)
        self._busy = False

    def _restore(self, level: GoalLevel, error: Optional[BaseException], frame: int = 0) -> None:
        """Restore the state at the start of a level after an exception.

        Args:
            level: the level.
            error: the exception, or None. If it is not an error of a goal, such as an interrupt, or is None, all
                open goals of the level are closed.
            frame: foreign frame to discard; 0 for none.
        """
        swi = self._swi
        self._busy = True
        self._level = level
        saved_state = c_void_p()
        if swi.set_engine(self._engine, byref(saved_state)):
            return
        if saved_state.value != self._engine:  # the exception came before the engine was attached
            self._before.value = saved_state.value
        # An interrupt for a goal that has ended must not hit the next one.
        if self.watched is not level.watched:
            self.watched = level.watched
            self._interrupter.settle()
        dropped = []
        if not isinstance(error, Exception):
            dropped = self._open[level.base :]
            del self._open[level.base :]
        # SWI-Prolog's own list of queries is authoritative: a query may have been opened without being recorded here.
        last = self._open[-1].query if len(self._open) > level.base else level.query
        while swi.current_query() not in (0, last):
            self._close(swi.current_query())
        for open_goal in dropped:
            open_goal.closed = True
        frame = dropped[0].frame if dropped else frame
        if frame:
            swi.discard_frame(frame)
        self._depth = level.depth
        if not self._depth:
            swi.set_engine(self._before.value, None)
        self._busy = False

    # Goals

    def call(
        self, machine: Machine, predicate: int, arguments: Values, left: Optional[Left]
    ) -> Union[bool, Iterator[object]]:
        """Call a predicate; return whether it succeeds, or its solutions if there may be several.

        Args:
            machine: the machine of the program.
            predicate: handle of the predicate.
            arguments: arguments of the call.
            left: resources that the goal may still use; None if it has no limits.
        """
        swi, terms, level = self._swi, self._terms, self._level
        frame = 0
        try:
            self._enter()
            if self._open:
                self._close_finished()
            frame = swi.open_frame()
            refs: Refs = {}
            first = ref = swi.new_refs(len(arguments) or 1)
            for argument in arguments:
                terms.put(ref, argument, refs)
                ref += 1
            query = swi.open_query(None, QUERY_FLAGS, predicate, first)
            status = self._next_status(query, left)
            if status == RAISED:
                raise self._raised(query)
            bindings = [] if status == FAILED else terms.read_values(refs)
            if status == SOLVED:
                open_goal = OpenGoal(query, frame, refs)
                self._open.append(open_goal)
            else:
                swi.close_done(query)
                swi.discard_frame(frame)
            self._leave()
        except BaseException as error:
            self._restore(level, error, frame)
            raise
        if status == SOLVED:
            return self._solutions(machine, open_goal, bindings)
        return status != FAILED and (not bindings or machine.unify_all(*bindings))

    def _solutions(self, machine: Machine, open_goal: OpenGoal, bindings: Bindings) -> Iterator[object]:
        try:
            while True:
                if machine.unify_all(*bindings):
                    yield LAST if open_goal.closed else None
                # The last solution was known to be the last, or the goal has been closed by a restore.
                if open_goal.closed:
                    return
                next_bindings = self._next_bindings(open_goal)
                if next_bindings is None:
                    return
                bindings = next_bindings
        finally:
            if not open_goal.closed:
                self._drop_goal(open_goal)

    def _next_bindings(self, open_goal: OpenGoal) -> Optional[Bindings]:
        """Return the bindings of the next solution, or None if there is none."""
        if self._thread != get_ident():
            raise RetalisError(
                "solutions in SWI-Prolog were requested by another thread than the first of them"
            )
        level = self._level
        left = self._budget.left()
        try:
            self._enter()
            if self._open[-1:] != [open_goal]:
                self._close_finished()
            if self._open[-1:] != [open_goal]:
                raise RetalisError(
                    "solutions of an outer goal were requested while an inner one is still open"
                )
            status = self._next_status(open_goal.query, left)
            if status == RAISED:
                raise self._raised(open_goal.query)
            bindings = None if status == FAILED else self._terms.read_values(open_goal.refs)
            if status == LAST_SOLVED:
                open_goal.over = True
                self._close_finished()
            self._leave()
        except BaseException as error:
            self._restore(level, error)
            raise
        return bindings

    def _next_status(self, query: int, left: Optional[Left]) -> int:
        """Request the next solution of a query; return the status.

        Raises:
            PrologError: if a limit has been exceeded.
        """
        self._stored_error = None
        if left is None:
            status: int = self._swi.next_solution(query)
        else:
            # Counted by SWI-Prolog, and charged to the budget of the program afterwards.
            start_inferences = 0 if left.inferences is None else self._inferences()
            outer_watch = self.watched
            watched = self.watched = LimitedGoal(left, self.number, start_inferences)
            if self._interrupter.asleep:
                self._interrupter.wake()
            try:
                status = self._swi.next_solution(query)
            finally:
                self.watched = outer_watch
            if watched.fired:
                # The interrupt may still be in progress. Without the wait it would hit the next goal.
                self._interrupter.settle()
                raise self._exceeded(watched.fired)
            if left.inferences is not None:
                self._budget.check_limits(self._inferences() - start_inferences)
        failure = self._stored_error
        if failure is not None and not isinstance(failure, Exception):
            self._stored_error = None
            raise failure
        return status

    def _exceeded(self, resource: str) -> PrologError:
        failure, self._stored_error = self._stored_error, None
        if isinstance(failure, LimitError):
            return failure
        self._budget.check_limits(0)  # raises the budget's own error if the limit is exceeded there too
        return resource_error(resource)

    def _inferences(self) -> int:
        swi = self._swi
        frame = swi.open_frame()
        try:
            ref = swi.new_refs(2)
            self._terms.put(ref, atom("inferences"), {})
            swi.call_predicate(None, QUERY_FLAGS, self._statistics, ref)
            return self._terms.read(ref + 1)  # type: ignore
        finally:
            swi.discard_frame(frame)

    def _raised(self, query: int) -> BaseException:
        """Return the error that has ended a goal."""
        terms = self._terms
        # An error term may contain handles such as streams, which are read as text.
        terms.begin(lenient=True)
        ball = terms.read(self._swi.exception(query))
        failure, self._stored_error = self._stored_error, None
        if failure is not None and (ball is _FAILURE or _is_same_error(failure, ball)):
            return failure
        return PrologError(ball)

    # End of goals

    def _drop_goal(self, open_goal: OpenGoal) -> None:
        """Close a goal now, or before the next one if the engine is in use or this is another thread."""
        open_goal.over = True
        # A generator may be finalized at any time and in any thread; the goal is closed by the next call instead.
        if self._busy or self._thread != get_ident() or self._ended:
            return
        level = self._level
        try:
            self._enter()
            self._close_finished()
            self._leave()
        except BaseException as error:
            self._restore(level, error)
            raise

    def _close_finished(self) -> None:
        while len(self._open) > self._level.base and self._open[-1].over:
            self._close_last()

    def _close_last(self) -> None:
        open_goal = self._open.pop()
        open_goal.closed = True
        self._close(open_goal.query)
        self._swi.discard_frame(open_goal.frame)

    def _close(self, query: int) -> None:
        """Close a query, with a time limit for its cleanup goals."""
        outer_watch = self.watched
        watched = self.watched = LimitedGoal(
            Left(monotonic() + _CLEANUP_TIMEOUT_SECONDS, None, None), self.number
        )
        if self._interrupter.asleep:
            self._interrupter.wake()
        try:
            self._swi.close_query(query)
        finally:
            self.watched = outer_watch
        if watched.fired:
            self._interrupter.settle()

    # Callbacks

    def answer(self, call_ref: int) -> bool:
        """Unify the second argument of a term with the list of all solutions of its first one.

        Errors are raised in SWI-Prolog. Returns whether it succeeds.
        """
        swi, terms, outer_level = self._swi, self._terms, self._level
        try:
            # The callback starts a new level: an error in it closes only the goals that it has opened.
            level = GoalLevel(len(self._open), swi.current_query(), self._depth, self.watched)
            try:
                self._level, self._busy = level, False
                goal = self._callback_goal(call_ref)
                solutions = make_list(self._solved(goal))
                self._close_all()
                ref = swi.new_refs(1)
                swi.get_argument(2, call_ref, ref)
                terms.put(ref, solutions, {})
            except BaseException as error:  # no exception can be propagated through C
                self._restore(level, error)
                self._close_all()
                self.fail(error)
                return False
            return True
        finally:
            self._level, self._busy = outer_level, True

    def _callback_goal(self, call_ref: int) -> Term:
        """Return the goal of a callback."""
        swi, terms = self._swi, self._terms
        frame = swi.open_frame()
        try:
            terms.begin()
            ref = swi.new_refs(1)
            swi.get_argument(1, call_ref, ref)
            return terms.read(ref)
        finally:
            swi.discard_frame(frame)  # also undoes the marks of variables

    def _close_all(self) -> None:
        while len(self._open) > self._level.base:
            self._close_last()

    def _solved(self, goal: Term) -> List[Term]:
        instances = []
        with closing(self._logic.solutions(goal)) as solutions:
            for _ in solutions:
                instances.append(copy(goal))
                if len(instances) > _MAX_CALLBACK_SOLUTIONS:
                    raise resource_error("solutions")
        return instances

    def fail(self, error: BaseException) -> None:
        """Raise an error in SWI-Prolog.

        An exception that is not an error of a goal, such as an interrupt, is stored, and raised again when SWI-Prolog
        returns.
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

    SWI-Prolog stores the position of the C stack with an engine, and aborts the process if the engine is used by a
    thread with another stack. So an engine cannot move between threads.

    Args:
        logic: the program.
        started: the running SWI-Prolog.
    """

    def __init__(self, logic: PrologSystem, started: Started):
        self._logic = logic
        self._started = started
        self._threads = local()

    def predicate(self, module: str, name: str, arity: int) -> Callable[..., Union[bool, Iterator[object]]]:
        """Return the function that calls a predicate of a module, for `PrologSystem.define_nondeterministic`."""
        threads, budget = self._threads, self._logic.machine.budget
        handle = self.engine().handle(module, name, arity)
        key = functor(name, arity)
        module_atom = atom(module)

        def call(machine: Machine, *arguments: Term) -> Union[bool, Iterator[object]]:
            try:
                engine: SwiEngine = threads.engine
            except AttributeError:
                engine = self.engine()
            left = budget.left()
            # SWI-Prolog counts inferences exactly. Its limit needs a wrapper goal, which is only used if there is
            # one.
            if left is not None and left.inferences is not None:
                goal = (COLON, module_atom, (key, *arguments) if arguments else atom(name))
                return engine.call(machine, engine.limited, (goal, max(left.inferences, 0)), left)
            return engine.call(machine, handle, arguments, left)

        return call

    def engine(self) -> SwiEngine:
        """Return the engine of this thread."""
        engine: Optional[SwiEngine] = getattr(self._threads, "engine", None)
        if engine is None:
            engine = self._threads.engine = SwiEngine(self._logic, self._started)
            megabytes = self._logic.limits.megabytes
            if megabytes is not None:
                self.ask("limit_stacks", int(megabytes * MEGABYTE))
        return engine

    def ask(self, name: str, *arguments: Term) -> bool:
        """Call a predicate of the bridge once, and keep its bindings."""
        outcome = self.predicate(BRIDGE, name, len(arguments))(self._logic.machine, *arguments)
        if isinstance(outcome, bool):
            return outcome
        with closing(outcome) as solutions:  # type: ignore[type-var]
            return next(solutions, FAILED) is not FAILED


def _destroy(swi: SwiLibrary, engine: int, terms: SwiTerms, ended: List[bool]) -> None:
    """Destroy an engine and release its atoms; called from any thread."""
    ended.append(True)  # its solutions may be dropped after it
    saved_state = c_void_p()
    if not swi.set_engine(engine, byref(saved_state)):
        try:
            terms.release()
        finally:
            swi.set_engine(saved_state.value, None)
    swi.destroy_engine(engine)


def _is_same_error(failure: BaseException, ball: Term) -> bool:
    return isinstance(failure, PrologError) and variant_key(failure.term) == variant_key(ball)
