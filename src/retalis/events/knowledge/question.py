"""A query with the event that its first solution triggers."""

from typing import Any, Callable, Hashable, NamedTuple, Optional, Sequence, Tuple

from ...foundation import Place, UsageError
from ...prolog.database import CompiledGoal
from ...prolog.logic import Logic
from ...prolog.machine import Frame, PrologError, keep_back
from ...prolog.terms import MINUS, TRUE, Term, Values, Var, copy, deref, functor, variables
from ..dispatch import Dispatcher, compile_builder
from .recording import Warn

_CALL = functor("call", 1)
_NAME = "synchronized query"


class Surroundings(NamedTuple):
    """Where questions are asked: whose goals, where their events go, and who takes warnings."""

    logic: Logic
    dispatcher: Dispatcher
    warn: Warn


class Question:
    """A query and the event that it triggers, compiled for values that are known when it is asked.

    Args:
        around: where it is asked.
        goal: the query; None where it has a solution always.
        inputs: places of the goal's inputs among the values.
        build: makes the event from the values and, after them, what the goal has given.
        unsolved: makes from the values alone what the event is before, for reports.

    Attributes:
        event: makes from the values alone what the event is before it is asked.
        terms: makes from the values event and query, as a question of any event takes them.
        ask: takes values, start, end and next frame; returns the frame that calls the query and triggers the
            event where it has a solution.
    """

    __slots__ = ("_around", "_dispatcher", "_dispatch", "_goal", "_inputs", "_build", "event", "ask", "terms")

    terms: Callable[[Values], Tuple[Term, Term]]

    ask: Callable[[Values, int, int, Frame], Frame]

    def __init__(
        self,
        around: Surroundings,
        goal: Optional[CompiledGoal],
        inputs: Tuple[int, ...],
        build: Callable[[Values], Term],
        unsolved: Callable[[Values], Term],
    ):
        self._around = around
        self._dispatcher = around.dispatcher
        self._dispatch = around.dispatcher.dispatch
        self._goal = goal
        self._inputs = inputs
        self._build = build
        self.event = unsolved
        self.ask = self._trigger if goal is None else self._call

    def _call(self, values: Values, start: int, end: int, after: Frame) -> Frame:
        goal: Any = self._goal  # there is one: else nobody calls it
        given = tuple([values[at] for at in self._inputs])
        call = self._dispatcher.call
        return call(goal, given, self._failed, self._found, TRUE, values, start, end, after)

    def _found(self, term: Term, values: Values, start: int, end: int, after: Frame) -> Frame:
        return self._trigger(values, start, end, after)

    def _trigger(self, values: Values, start: int, end: int, after: Frame) -> Frame:
        event = self._build(values)
        try:
            return self._dispatch(event, start, end, after)
        except UsageError as error:
            show = self._around.logic.brief
            self._around.warn(f"{show(event)} is dropped: {error}", ("dropped", kind_of(event)))
            return after

    def _failed(self, values: Values, error: PrologError) -> None:
        if not keep_back(error):
            return
        event = self.event(values)
        self._around.warn(
            f"{self._around.logic.brief(event)} is dropped, its query raised: {error}",
            ("raised", kind_of(event)),
        )


class Bell(Question):
    """What somebody outside waits for instead of a query: where it would be asked, somebody is told.

    Args:
        named: what it is called in reports.
        tell: called once.
    """

    __slots__ = ("_named", "_tell")

    def __init__(self, named: Term, tell: Callable[[], None]):
        self._named = named
        self._tell = tell
        self.event = self._name
        self.ask = self._ring

    def _name(self, values: Values) -> Term:
        return self._named

    def _ring(self, values: Values, start: int, end: int, after: Frame) -> Frame:
        self._tell()
        return after


class Followed(Question):
    """A question that waits, where it is kept what events came from: its event follows from the one that asked.

    Args:
        dispatcher: of the events.
        asked: the question.
        token: of the event that is being served while it begins to wait.
    """

    __slots__ = ("_asked", "_token")

    def __init__(self, dispatcher: Dispatcher, asked: Question, token: object):
        self._dispatcher = dispatcher
        self._asked = asked
        self._token = token
        self.event = asked.event
        self.terms = asked.terms
        self.ask = self._ask

    @property
    def token(self) -> object:
        """The token of the event that its own follows from."""
        return self._token

    def _ask(self, values: Values, start: int, end: int, after: Frame) -> Frame:
        return self._asked.ask(values, start, end, self._dispatcher.following(self._token, after))


def general_question(around: Surroundings) -> Question:
    """Return the question whose values are an event and a query, whatever they are.

    The query comes with an event, which anybody may have sent: it may not change flags.
    """
    event, query = Var(), Var()
    goal = around.logic.compile_goal((_CALL, query), [event, query], [event], name=_NAME, from_outside=True)
    made = Question(around, goal, (0, 1), lambda values: values[2], lambda values: values[0])
    made.terms = lambda values: (values[0], values[1])
    return made


def compile_question(
    around: Surroundings,
    event: Term,
    query: Term,
    names: Sequence[Var],
    place: Optional[Place],
    from_outside: bool,
) -> Optional[Question]:
    """Return the question for values of ``names`` without variables; None where only the values tell what it is.

    Args:
        around: where it is asked.
        event: what it triggers.
        query: its goal.
        names: the variables that are known.
        place: where it was read.
        from_outside: whether others than the program have given it.
    """
    event, query = deref(event), deref(query)
    mentioned = set(variables(query))
    known = set(names)
    if query.__class__ is Var:
        if query not in known:
            return None
        query = (_CALL, query)
    found = [var for var in variables(event) if var in mentioned and var not in known]
    build = compile_builder(event, [*names, *found], f"event of a {_NAME}")
    inputs = [at for at, name in enumerate(names) if name in mentioned]
    goal = None
    if query is not TRUE:
        try:
            goal = around.logic.compile_goal(
                query, [names[at] for at in inputs], found, place, _NAME, from_outside
            )
        except PrologError:  # reported for each event that asks it
            return None
    made = Question(
        around, goal, tuple(inputs), build, lambda values: build((*values, *[Var() for _ in found]))
    )
    made.terms = lambda values: copy((MINUS, event, query), dict(zip(names, values)))[1:]
    return made


def kind_of(event: Term) -> Hashable:
    """Return what events of one kind share: the functor, or the atom."""
    event = deref(event)
    return event[0] if event.__class__ is tuple else event
