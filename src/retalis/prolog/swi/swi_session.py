"""What an engine of SWI-Prolog's has open.

Goals in SWI-Prolog: an engine of it, taken up for a call and left after it.
"""

from contextlib import closing
from ctypes import byref, c_void_p
from threading import get_ident
from time import monotonic
from typing import Iterator, List, NamedTuple, Optional, Union
from weakref import finalize

from ...foundation.errors import RetalisError
from ..machine.errors import PrologError, from_python, resource_error
from ..machine.machine import LAST, Machine
from ..machine.resource_limits import Left, LimitError
from ..system.prolog_system import PrologSystem
from ..terms.list_terms import make_list
from ..terms.term_traversal import copy, variant_key
from ..terms.types import Term, Values, atom, functor
from .libswipl import ASK, FAILED, LAST_SOLVED, RAISED, SOLVED, SwiLibrary, Watched, signal_stack_kept
from .swi_startup import BRIDGE, Started
from .swi_terms import Bindings, Refs, SwiTerms


class OpenGoal:
    """A goal that may have more solutions.

    Attributes:
        query: what SWI-Prolog calls it.
        frame: what is given up with it.
        refs: of its variables.
        over: whether nobody wants the others.
        closed: whether it is given up.
    """

    __slots__ = ("query", "frame", "refs", "over", "closed")

    def __init__(self, query: int, frame: int, refs: Refs):
        self.query = query
        self.frame = frame
        self.refs = refs
        self.over = self.closed = False


class GoalLevel(NamedTuple):
    """Where goals begin that may be given up together: an engine's first ones, or those of what is asked back.

    Attributes:
        base: how many goals were open before.
        query: the one that asks back, 0 where none does.
        depth: how often the engine has been taken up.
        watched: the goal that runs.
    """

    base: int
    query: int
    depth: int
    watched: Optional[Watched]


_LIMITED = functor("limited", 2)
_FAILURE = atom("$retalis_failure")

_CLEANING = 1.0
"""Seconds that the cleanup of a goal may take whose other solutions nobody wants."""

_MAX_CALLBACK_SOLUTIONS = 100_000
"""Solutions that a goal may have which SWI-Prolog asks back."""


class SwiEngine:
    """An engine of SWI-Prolog's that runs goals for a program in one thread.

    Goals that may have more solutions stay open in it, each above the one that was opened before; the machine of
    the program has its choice points in the same order. What SWI-Prolog asks back runs on that machine, inside.

    Args:
        logic: of the program.
        started: SWI-Prolog.

    Attributes:
        watched: the goal that runs, where it has limits.
        number: what SWI-Prolog calls the engine.
        limited: the predicate that calls another with a limit of inferences.
    """

    def __init__(self, logic: PrologSystem, started: Started):
        self._logic = logic
        self._budget = logic.machine.budget
        self._started = started
        self._swi = swi = started.swi
        self._interrupter = started.interrupter
        self.watched: Optional[Watched] = None
        self._thread = get_ident()
        self._depth = 0
        self._busy = False
        self._before = c_void_p()
        self._to_before = byref(self._before)
        self._open: List[OpenGoal] = []
        self._level = GoalLevel(0, 0, 0, None)
        self._failure: Optional[BaseException] = None
        self._ended: List[bool] = []
        with signal_stack_kept():
            self._engine = swi.create_engine(None)
        self._enter()
        try:
            self.number: int = swi.thread_self()
            self._terms = SwiTerms(swi)
            finalize(self, _end, swi, self._engine, self._terms, self._ended).atexit = False
            self.limited: int = swi.predicate(b"limited", 2, BRIDGE.encode())
            self._count = swi.predicate(b"statistics", 2, b"system")
        finally:
            self._leave()
        started.engines[self.number] = self
        self._interrupter.add(self)

    def handle(self, module: str, name: str, arity: int) -> int:
        """Return what SWI-Prolog knows a predicate by."""
        swi = self._swi
        level = self._level
        frame = 0
        try:
            self._enter()
            frame = swi.open_frame()
            place = swi.new_module(self._terms.handle(atom(module)))
            found: int = swi.predicate_of(swi.new_functor(self._terms.handle(atom(name)), arity), place)
            swi.discard_frame(frame)
            self._leave()
        except BaseException as error:
            self._mend(level, error, frame)
            raise
        return found

    def _enter(self) -> None:
        """Have this thread use the engine."""
        if self._busy:  # something came in between when that was to be mended
            self._mend(self._level, None)
        self._busy = True
        if not self._depth and self._swi.set_engine(self._engine, self._to_before):
            raise RetalisError("an engine of SWI-Prolog is in use elsewhere")
        self._depth += 1

    def _leave(self) -> None:
        self._depth -= 1
        if not self._depth:
            self._swi.set_engine(self._before.value, None)
        self._busy = False

    def _mend(self, level: GoalLevel, error: Optional[BaseException], frame: int = 0) -> None:
        """Take back what has not been done to its end, wherever that was.

        Args:
            level: where it began.
            error: what came in between: where it is no error of a goal, as an interrupt is, nobody wants any goals
                of this level that are open. None stands for that.
            frame: what is given up with it, 0 where none is.
        """
        swi = self._swi
        self._busy = True
        self._level = level
        before = c_void_p()
        if swi.set_engine(self._engine, byref(before)):
            return
        if before.value != self._engine:  # it had not been taken up yet
            self._before.value = before.value
        if self.watched is not level.watched:
            self.watched = level.watched
            self._interrupter.settle()
        given_up = []
        if not isinstance(error, Exception):
            given_up = self._open[level.base :]
            del self._open[level.base :]
        last = self._open[-1].query if len(self._open) > level.base else level.query
        while swi.current_query() not in (0, last):
            self._close(swi.current_query())
        for opened in given_up:
            opened.closed = True
        frame = given_up[0].frame if given_up else frame
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
        """Call a predicate: return whether it succeeds, or its solutions where there may be several."""
        swi, terms, level = self._swi, self._terms, self._level
        frame = 0
        try:
            self._enter()
            if self._open:
                self._close_over()
            frame = swi.open_frame()
            refs: Refs = {}
            first = ref = swi.new_refs(len(arguments) or 1)
            for argument in arguments:
                terms.put(ref, argument, refs)
                ref += 1
            query = swi.open_query(None, ASK, predicate, first)
            status = self._next(query, left)
            if status == RAISED:
                raise self._raised(query)
            bindings = [] if status == FAILED else terms.read_values(refs)
            if status == SOLVED:
                opened = OpenGoal(query, frame, refs)
                self._open.append(opened)
            else:
                swi.close_done(query)
                swi.discard_frame(frame)
            self._leave()
        except BaseException as error:
            self._mend(level, error, frame)
            raise
        if status == SOLVED:
            return self._solutions(machine, opened, bindings)
        return status != FAILED and (not bindings or machine.unify_all(*bindings))

    def _solutions(self, machine: Machine, opened: OpenGoal, bindings: Bindings) -> Iterator[object]:
        try:
            while True:
                if machine.unify_all(*bindings):
                    yield LAST if opened.closed else None
                if opened.closed:
                    return
                found = self._following(opened)
                if found is None:
                    return
                bindings = found
        finally:
            if not opened.closed:
                self._drop(opened)

    def _following(self, opened: OpenGoal) -> Optional[Bindings]:
        """Return what the next solution makes of the variables; None where there is none."""
        if self._thread != get_ident():
            raise RetalisError(
                "solutions in SWI-Prolog were requested by another thread than the first of them"
            )
        level = self._level
        left = self._budget.left()
        try:
            self._enter()
            if self._open[-1:] != [opened]:
                self._close_over()
            if self._open[-1:] != [opened]:
                raise RetalisError(
                    "solutions of an outer goal were requested while an inner one is still open"
                )
            status = self._next(opened.query, left)
            if status == RAISED:
                raise self._raised(opened.query)
            found = None if status == FAILED else self._terms.read_values(opened.refs)
            if status == LAST_SOLVED:
                opened.over = True
                self._close_over()
            self._leave()
        except BaseException as error:
            self._mend(level, error)
            raise
        return found

    def _next(self, query: int, left: Optional[Left]) -> int:
        """Look for a solution; say what came of it.

        Raises:
            PrologError: where a limit has been passed.
        """
        self._failure = None
        if left is None:
            status: int = self._swi.next_solution(query)
        else:
            before = 0 if left.inferences is None else self._inferences()
            outer = self.watched
            watched = self.watched = Watched(left, self.number, before)
            if self._interrupter.asleep:
                self._interrupter.wake()
            try:
                status = self._swi.next_solution(query)
            finally:
                self.watched = outer
            if watched.fired:
                self._interrupter.settle()
                raise self._exceeded(watched.fired)
            if left.inferences is not None:
                self._budget.look(self._inferences() - before)
        failure = self._failure
        if failure is not None and not isinstance(failure, Exception):
            self._failure = None
            raise failure
        return status

    def _exceeded(self, what: str) -> PrologError:
        failure, self._failure = self._failure, None
        if isinstance(failure, LimitError):
            return failure
        self._budget.look(0)  # it has an error of its own, if it is past the limit too
        return resource_error(what)

    def _inferences(self) -> int:
        swi = self._swi
        frame = swi.open_frame()
        try:
            ref = swi.new_refs(2)
            self._terms.put(ref, atom("inferences"), {})
            swi.call_predicate(None, ASK, self._count, ref)
            return self._terms.read(ref + 1)  # type: ignore
        finally:
            swi.discard_frame(frame)

    def _raised(self, query: int) -> BaseException:
        """Return the error that a goal has ended with."""
        terms = self._terms
        terms.begin(lenient=True)
        ball = terms.read(self._swi.exception(query))
        failure, self._failure = self._failure, None
        if failure is not None and (ball is _FAILURE or _is_of(failure, ball)):
            return failure
        return PrologError(ball)

    # The end of goals

    def _drop(self, opened: OpenGoal) -> None:
        """Give a goal up, at once or, where something else is under way, before the next one."""
        opened.over = True
        if self._busy or self._thread != get_ident() or self._ended:
            return
        level = self._level
        try:
            self._enter()
            self._close_over()
            self._leave()
        except BaseException as error:
            self._mend(level, error)
            raise

    def _close_over(self) -> None:
        while len(self._open) > self._level.base and self._open[-1].over:
            self._close_last()

    def _close_last(self) -> None:
        opened = self._open.pop()
        opened.closed = True
        self._close(opened.query)
        self._swi.discard_frame(opened.frame)

    def _close(self, query: int) -> None:
        """Close a query; it may have cleanups to call, which are given a moment."""
        outer = self.watched
        watched = self.watched = Watched(Left(monotonic() + _CLEANING, None, None), self.number)
        if self._interrupter.asleep:
            self._interrupter.wake()
        try:
            self._swi.close_query(query)
        finally:
            self.watched = outer
        if watched.fired:
            self._interrupter.settle()

    # The way back

    def answer(self, asked: int) -> bool:
        """Have the second part of a term be the list of all solutions of its first one; errors are thrown there."""
        swi, terms, outer = self._swi, self._terms, self._level
        try:
            level = GoalLevel(len(self._open), swi.current_query(), self._depth, self.watched)
            try:
                self._level, self._busy = level, False
                goal = self._asked(asked)
                found = make_list(self._solved(goal))
                self._close_all()
                ref = swi.new_refs(1)
                swi.get_argument(2, asked, ref)
                terms.put(ref, found, {})
            except BaseException as error:  # whatever it is: there is C between it and who has called
                self._mend(level, error)
                self._close_all()
                self.fail(error)
                return False
            return True
        finally:
            self._level, self._busy = outer, True

    def _asked(self, asked: int) -> Term:
        """Return the goal that is asked."""
        swi, terms = self._swi, self._terms
        frame = swi.open_frame()
        try:
            terms.begin()
            ref = swi.new_refs(1)
            swi.get_argument(1, asked, ref)
            return terms.read(ref)
        finally:
            swi.discard_frame(frame)  # which takes the marks back

    def _close_all(self) -> None:
        while len(self._open) > self._level.base:
            self._close_last()

    def _solved(self, goal: Term) -> List[Term]:
        found = []
        with closing(self._logic.solutions(goal)) as solutions:
            for _ in solutions:
                found.append(copy(goal))
                if len(found) > _MAX_CALLBACK_SOLUTIONS:
                    raise resource_error("solutions")
        return found

    def fail(self, error: BaseException) -> None:
        """Throw an error in SWI-Prolog; what is no error of a goal is thrown on when SWI-Prolog is left."""
        known = from_python(error)
        self._failure = error if known is None or isinstance(known, LimitError) else None
        swi, terms = self._swi, self._terms
        ref = swi.new_refs(1)
        try:
            terms.put(ref, _FAILURE if known is None else known.term, {})
        except RetalisError:  # too large
            self._failure = known
            terms.put(ref := swi.new_refs(1), _FAILURE, {})
        swi.raise_exception(ref)


def _end(swi: SwiLibrary, engine: int, terms: SwiTerms, ended: List[bool]) -> None:
    """Give an engine up, and the atoms that were held for it; any thread may do that."""
    ended.append(True)  # solutions of it may be let go after it
    before = c_void_p()
    if not swi.set_engine(engine, byref(before)):
        try:
            terms.let_go()
        finally:
            swi.set_engine(before.value, None)
    swi.destroy_engine(engine)


def _is_of(failure: BaseException, ball: Term) -> bool:
    return isinstance(failure, PrologError) and variant_key(failure.term) == variant_key(ball)
