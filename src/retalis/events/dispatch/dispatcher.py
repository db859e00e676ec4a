"""From an event to those who listen to its kind, in order, depth first."""

from itertools import count
from typing import Any, Callable, Dict, Optional, Tuple, TypeVar

from ...foundation.errors import UsageError
from ...prolog.database.compiled_goal import CompiledGoal
from ...prolog.machine.errors import PrologError
from ...prolog.machine.resource_limits import Budget, keep_back
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms.term_traversal import copy, is_ground, is_plain
from ...prolog.terms.types import Atom, EventAction, Frame, Functor, Term, Values, Var, deref
from .discrimination_tree import SwitchNode
from .listener_index import ListenerIndex, functor_of_event
from .listeners import AT_ONCE, CAUSE_AGAIN, DEPTH, GROUND, SERVE, TERM, TOKEN, Context

Result = TypeVar("Result")


class Dispatcher(ListenerIndex):
    """Hands events to listeners.

    Args:
        logic: the program's logic, whose machine runs the frames.
        max_depth: how many events may be derived one from the other; the first of all is none of them.

    Attributes:
        current: the `Context` of the event that is being served; None for none.
        mark: makes the token of an event; tracking replaces it.
        at_once: to this depth events are served inside the call that makes them.
        tracked: whether tokens tell what events came from.
        retractions: how often events were taken back, with what came from them.
        cause: where that is tracked, the rule and match whose goal is running, or the token of the event that asked
            the query that is answered.
        shortcuts: by the functor of an event, what can take the values of a rule's match in place of the event:
            takes the rule and the action that makes the event; gives an action that may be fused, or None where
            the rule's head does not allow it.
    """

    def __init__(self, logic: Optional[PrologSystem] = None, max_depth: int = 1000) -> None:
        super().__init__()
        self.max_depth = max_depth
        self._deepest = max_depth + 1
        self.at_once = min(AT_ONCE, self._deepest)
        self._machine: Any = None if logic is None else logic.machine
        self._done: Any = None if logic is None else logic.machine.done
        self._run: Any = None if logic is None else logic.machine.run
        self._budget = Budget() if logic is None else logic.machine.budget
        self._tokens = count(1)
        self.current: Any = None
        self.cause: Any = None
        self.shortcuts: Dict[Functor, Callable[[Any, EventAction], Optional[EventAction]]] = {}
        self.mark: Callable[[Context], Any] = lambda context: next(self._tokens)
        self.tracked = False
        self.retractions = 0

    def mend(self) -> None:
        """Make the plans anew and serve nothing, after an interrupt."""
        self._changed(None)
        self.restore(None, None)

    def dispatch(  # noqa: C901  (each event takes it)
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
            functor = functor_of_event(term)
        plan: Any = self._plans.get(functor)
        if plan is None:
            plan = self.plan(functor)
        while plan.__class__ is SwitchNode:
            plan = plan.branch(term)
        if not plan:
            return after
        if not own:
            term, ground = _own(term)
        parent = self.current
        depth = 1 if parent is None else parent[DEPTH] + 1
        context = [term, start, end, parent, depth, ground, self.cause, token]
        steps = iter(plan)
        frame: Frame = (SERVE, self, steps, context, after)
        if depth > self.at_once:
            return self._later(frame, depth)
        self.current = context
        for matcher, action in steps:  # as `_Serve.run`, whose call would be 5 % of a short event
            values = matcher(term)
            if values is not None:
                next_frame = action(term, values, start, end, frame)
                if next_frame is not frame:
                    return next_frame  # type: ignore[no-any-return]
        self.current = parent
        return after

    def serve(self, term: Any, start: int, end: int, ground: Optional[bool]) -> None:
        """Serve an event that comes in, with all that is derived from it, by a fused action if there is one.

        If anything raises, what was being served before is being served again. The arguments and the errors are
        those of `dispatch`.
        """
        current, cause, done = self.current, self.cause, self._done
        try:
            fused = (
                self.fused.get(term[0]) if ground and current is None and term.__class__ is tuple else None
            )
            if fused is None:
                frame = self.dispatch(term, start, end, done, None, ground)
            else:
                self.current = [term, start, end, None, 1, True, cause, None]
                frame = fused(term, None, start, end, done)  # type: ignore[arg-type]
            if frame is not done:
                self._run(frame)
            self.current = current
        except BaseException:
            self.restore(current, cause)
            raise

    def _later(self, frame: Frame, depth: int) -> Frame:
        """Return the frame of an event that the machine's loop is to serve, where that may still be derived."""
        if depth > self._deepest:
            raise UsageError(f"more than {self.max_depth} events were derived one from another")
        if self._budget.closed:
            self._refuse_past_limits()
        return frame

    def _refuse_past_limits(self) -> None:
        """Raise an error where all is used up that what came in may use: it derives no more long chains of events."""
        try:
            self._budget.admit()
        except PrologError as error:
            keep_back(error)
            raise UsageError(f"no more events are derived from it ({error.message})") from error

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
        context = self.current
        if context is not None and context[DEPTH] > AT_ONCE:
            return self._call_by_frames(
                context, goal, given, on_error, solved, term, values, start, end, after
            )
        try:
            found = goal.test(given)
        except PrologError as error:
            self.current = context
            on_error(values, error)
            return after
        return after if found is None else solved(term, values + found, start, end, after)

    def _call_by_frames(
        self,
        context: Context,
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
        """Return the frame that calls a goal by steps of the machine; see `call`.

        Apart from `call`, whose own variables would be slower if functions inside of it used them.
        """

        def failed(error: PrologError) -> None:
            self.current = context
            on_error(values, error)

        return self._machine.attempt(  # type: ignore[no-any-return]
            goal, given, lambda found: solved(term, values + found, start, end, after), after, failed
        )

    @property
    def tokens(self) -> int:
        """The number that the next event gets, where events are told apart by numbers."""
        number = next(self._tokens)
        self._tokens = count(number)
        return number

    @tokens.setter
    def tokens(self, number: int) -> None:
        self._tokens = count(number)

    def state(self) -> Tuple[Any, Any]:
        """Return what is being served and why, for `restore`."""
        return self.current, self.cause

    def restore(self, current: Any, cause: Any) -> None:
        """Serve again what was being served, for the cause that it had: what came in between is over, or has failed.

        Args:
            current: what was `current`; None for nothing.
            cause: what was `cause`; that of now where nothing in between leaves another.
        """
        self.current = current
        self.cause = cause

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
        return over, (CAUSE_AGAIN, self, before, after)

    def following(self, token: object, after: Frame) -> Frame:
        """Have events know the one that they follow from by its token; return the frame that ends this."""
        before, self.cause = self.cause, token
        return CAUSE_AGAIN, self, before, after

    def undisturbed(self, work: Callable[[], Result]) -> Result:
        """Return what work returns; where it raises, what was being served before is being served again."""
        state = self.state()
        try:
            return work()
        except BaseException:
            self.restore(*state)
            raise

    def apart(self, work: Callable[[], Result]) -> Result:
        """Return what work returns; what it dispatches follows from nothing that is being served."""
        state = self.state()
        self.restore(None, None)
        try:
            return work()
        finally:
            self.restore(*state)

    def ground(self) -> bool:
        """Tell whether the event that is being served has no variables."""
        context = self._served()
        if context[GROUND] is None:
            context[GROUND] = is_ground(context[TERM])
        return context[GROUND]  # type: ignore[no-any-return]

    def is_of_ground(self, match: Any) -> bool:
        """Tell whether a match is of the event alone that is being served, and that has no variables."""
        context = self.current
        return match.parts is None and context is not None and match.term is context[TERM] and self.ground()

    def token(self) -> Any:
        """Return what tells the event that is being served from all others."""
        context = self._served()
        if context[TOKEN] is None:
            context[TOKEN] = self.mark(context)
        return context[TOKEN]

    def _served(self) -> Context:
        context: Optional[Context] = self.current
        assert context is not None
        return context


def _own(term: Term) -> Tuple[Term, bool]:
    """Return an event whose variables are its own, and whether it has none."""
    if is_plain(term):
        return term, True
    fresh: Dict[Var, Term] = {}
    term = copy(term, fresh)
    return term, not fresh
