"""From an event to those who listen to its kind, in order, depth first."""

from itertools import count
from typing import Any, Callable, Dict, Optional, Tuple, TypeVar

from ...foundation import UsageError
from ...prolog.database import CompiledGoal
from ...prolog.logic import Logic
from ...prolog.machine import Budget, Frame, PrologError, keep_back
from ...prolog.terms import Atom, EventAction, Functor, Term, Values, Var, copy, deref, is_ground, is_plain
from .audience import Audience, functor_of_event
from .plans import Choice, Onlookers, Sole
from .serving import AT_ONCE, CAUSE_AGAIN, LEFT_OUT, SERVE_AGAIN, Dispatch, Lane, event_of

Result = TypeVar("Result")


class Dispatcher(Audience):
    """Hands events to listeners.

    Args:
        logic: the program's logic, whose machine runs the frames.
        max_depth: how many events may be derived one from the other; the first of all is none of them.

    Attributes:
        current: what is being served, or None: a `Dispatch`, or what `event` makes one of where somebody asks:
            term, start and end of one, what was being served before, and whether it has no variables, where that is
            not sure.
        mark: makes the token of an event; tracking replaces it.
        tracked: whether tokens tell what events came from.
        retractions: how often events were taken back, with what came from them.
        cause: where that is tracked, the rule and match whose goal is running, or the token of the event that asked
            the query that is answered.
        shortcuts: by the functor of an event, what can take the values of a rule's match in place of the event:
            takes the rule and the action that makes the event; gives an action and a lane for a rule of one event,
            or None where the rule's head does not allow it.
    """

    def __init__(self, logic: Optional[Logic] = None, max_depth: int = 1000) -> None:
        super().__init__()
        self.max_depth = max_depth
        self._deepest = max_depth + 1
        self._at_once = min(AT_ONCE, self._deepest)
        self._machine: Any = None if logic is None else logic.machine
        self._budget = Budget() if logic is None else logic.machine.budget
        self._tokens = count(1)
        self.current: Any = None
        self.cause: Any = None
        self.shortcuts: Dict[Functor, Callable[[Any, EventAction], Optional[Tuple[EventAction, Lane]]]] = {}
        self.mark: Callable[[Dispatch], Any] = lambda event: next(self._tokens)
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
        # What is common stays in one piece: to call `Dispatch.run` in place of the loop takes 5 % more instructions
        # where rules of one event follow one from another, all that is done for an event counted.
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
            plan = self._plan(functor)
        while plan.__class__ is Choice:
            plan = plan.branch(term)
        if not plan:
            return after
        if not own:
            term, ground = _own(term)
        if plan.__class__ is Onlookers:
            return self.show(plan, term, start, end, after)
        parent = self.current
        if parent is None and plan.__class__ is Sole and token is None:
            [(matcher, action)] = plan
            values = None
            if not plan.bare:
                values = matcher(term)
                if values is None:
                    return after
            self.current = (term, start, end, None, ground)
            frame: Frame = (SERVE_AGAIN, self, None, after)
            next_frame = action(term, values, start, end, frame)
            if next_frame is not frame:
                return next_frame  # type: ignore[no-any-return]
            self.current = None
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
        if parent.__class__ is tuple:
            parent = self.event()
        event.parent = parent
        event.depth = depth = 1 if parent is None else parent.depth + 1
        frame = (event, after)
        if depth > self._at_once:
            return self._later(frame, depth)
        self.current = event
        for matcher, action in steps:  # as `Dispatch.run`
            values = matcher(term)
            if values is not None:
                next_frame = action(term, values, start, end, frame)
                if next_frame is not frame:
                    return next_frame  # type: ignore[no-any-return]
        self.current = parent
        return after

    def show(self, plan: Onlookers, term: Term, start: int, end: int, after: Frame) -> Frame:
        """Call those who only look on, for an event whose dispatch need not be set up; return the next frame."""
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

    def _later(self, frame: Frame, depth: int) -> Frame:
        """Return the frame of an event that the machine's loop is to serve, where that may still be derived."""
        if depth > self._deepest:
            raise self._too_deep()
        if self._budget.closed:
            self._refuse_past_limits()
        return frame

    def _too_deep(self) -> UsageError:
        return UsageError(f"more than {self.max_depth} events were derived one from another")

    def _refuse_past_limits(self) -> None:
        """Raise an error where all is used up that what came in may use: it derives no more long chains of events."""
        try:
            self._budget.admit()
        except PrologError as error:
            keep_back(error)
            raise UsageError(f"no more events are derived from it ({error.message})") from error

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
        """Return the frame that calls a goal by steps of the machine; see `call`.

        Apart from `call`, whose own variables would be slower if functions inside of it used them.
        """

        def failed(error: PrologError) -> None:
            self.current = event
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

    def event(self) -> Optional[Dispatch]:
        """Return the event that is being served, or None."""
        current = self.current
        if current.__class__ is not tuple:
            return current  # type: ignore[no-any-return]
        made = self.current = self._made(*current)
        return made

    def _made(self, term: Term, start: int, end: int, before: Any, ground: Optional[bool] = True) -> Dispatch:
        """Return the event of its parts, and of what was served when it came."""
        parent = self._made(*before) if before.__class__ is tuple else before
        event = event_of(self, term, start, end, 1 if parent is None else parent.depth + 1)
        event.parent = parent
        event.cause = self.cause
        event.ground = ground
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


def _own(term: Term) -> Tuple[Term, bool]:
    """Return an event whose variables are its own, and whether it has none."""
    if is_plain(term):
        return term, True
    fresh: Dict[Var, Term] = {}
    term = copy(term, fresh)
    return term, not fresh
