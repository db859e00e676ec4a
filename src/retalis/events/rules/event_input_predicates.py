"""Event input as goals: ``event/1,2``, ``new_event/2,3,5``, and the goals that fire lists and files of events.

`InputReader` parses the same goals from text, as other nodes send them. Most texts are ``event(E,[T,T])`` with two
equal timestamps; for these, only the event is parsed as a term, and the conversion of dates is cached.
`define_new_event` defines the goals that emit events with given timestamps, `define_event_predicates` those of the
event language.
"""

import re
from typing import TYPE_CHECKING, Any, Callable, Dict, List, NamedTuple, Optional, Sequence, Tuple

from ...foundation.bounded_caches import Cache
from ...foundation.errors import Errors, ProgramErrors, SyntaxFault, UsageError
from ...prolog.builtins.argument_checks import callable_of, integer
from ...prolog.builtins.time_predicates import instant_of
from ...prolog.machine.errors import PrologError, domain_error, instantiation_or_type_error, type_error
from ...prolog.machine.machine import Machine
from ...prolog.syntax.event_text import EventReader
from ...prolog.syntax.operators import Operators
from ...prolog.syntax.term_reader import read_program
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms import timestamps
from ...prolog.terms.list_terms import list_items, make_list
from ...prolog.terms.term_traversal import copy
from ...prolog.terms.timestamps import END_INSTANT, FIRST_INSTANT, SECOND, FloatSeconds, from_any
from ...prolog.terms.types import Atom, Frame, Functor, String, Term, Values, Var, deref, functor
from ..dispatch.dispatcher import Dispatcher

if TYPE_CHECKING:
    from .rule_base import RuleBase

EVENT2 = functor("event", 2)


def file_name_of(term: Term) -> str:
    """Return the name of a file that a term denotes.

    Raises:
        PrologError: if the term is not an atom or string.
    """
    term = deref(term)
    if term.__class__ not in (Atom, String):
        raise instantiation_or_type_error("atom", term)
    return str(term.name if term.__class__ is Atom else term.text)


def require_list(term: Term) -> List[Term]:
    """Return the items of a list.

    Raises:
        PrologError: if the term is not a list.
    """
    items = list_items(term)
    if items is None:
        raise type_error("list", term)
    return items


def interval_of(term: Term) -> Tuple[int, int]:
    """Return start and end of an interval ``[T1,T2]``.

    Raises:
        PrologError: if the term is not an interval, or the end precedes the start.
    """
    stamps = list_items(term)
    if stamps is None or len(stamps) != 2:
        raise type_error("interval", term)
    try:
        start, end = from_any(stamps[0]), from_any(stamps[1])
    except UsageError:
        raise type_error("datime", term) from None
    if end < start:
        raise domain_error("interval", term)
    return start, end


_DATIME_TO_SECOND = re.compile(
    r"datime\((\d{1,9}),(\d{1,9}),(\d{1,9}),(\d{1,9}),(\d{1,9}),(\d{1,9}),", re.ASCII
)
_NANOSECONDS = re.compile(r"\d{1,9}\)", re.ASCII)


class InputEvent(NamedTuple):
    """An event with its interval; start and end are None if the clock is to provide them.

    Attributes:
        ground: whether the event has no variables; None if unknown.
    """

    term: Term
    start: Any
    end: Any
    ground: Optional[bool] = None

    def interval_terms(self) -> Tuple[Any, Any]:
        """Return the terms of start and end; None if the clock is to provide them."""
        if self.start is None:
            return None, None
        return timestamps.lazy_term(self.start), timestamps.lazy_term(self.end)


class InputReader:
    """Parses events from the text of goals; not thread-safe."""

    def __init__(self, operators: Operators):
        self._reader = EventReader(operators)
        self._seconds: Cache[str, int] = Cache(64, 1 << 16)

    def parse_goal(self, text: str) -> Term:
        """Parse a goal.

        Raises:
            SyntaxFault: if the text is not a term.
        """
        return self._reader.read(text)

    def parse_event(self, text: str) -> Optional[InputEvent]:
        """Parse a goal and return the event that it denotes, or None for another goal.

        Raises:
            SyntaxFault: if the text is not a term.
            PrologError: if the arguments of the goal are invalid.
        """
        if text.startswith("event("):
            event = self._parse_stamped(text)
            if event is not None:
                return event
        return event_of(self._reader.read(text))

    def _parse_stamped(self, text: str) -> Optional[InputEvent]:
        """Parse ``event(E,[T,T])`` with two equal timestamps as other nodes write it; return None for other texts.

        The text before the timestamps, closed by ``)``, must read as ``event(E)``. This proves that the timestamps
        are the second argument and not part of a quoted text in the event.
        """
        position = text.rfind(",[datime(")
        interval_text = text[position + 2 :]
        stamp_length = (len(interval_text) - 3) // 2
        stamp = interval_text[:stamp_length]
        # Two equal timestamps, compared as text.
        if position < 0 or interval_text != f"{stamp},{stamp}])":
            return None
        nanosecond_start = stamp.rfind(",") + 1
        # Texts of one second share their first six numbers, so the cache saves the conversion of the calendar date.
        second_instant = self._seconds.get(stamp[:nanosecond_start])
        if second_instant is None:
            second_instant = self._cache_second(stamp[:nanosecond_start])
        if second_instant is None or not _NANOSECONDS.fullmatch(stamp, nanosecond_start):
            return None
        try:
            goal = self._reader.read(text[:position] + ")")
        # The general parser reports the error with its position in the whole text.
        except SyntaxFault:
            return None
        if goal.__class__ is not tuple or goal[0] is not EVENT1:
            return None
        instant = second_instant + int(stamp[nanosecond_start:-1])
        return InputEvent(callable_of(goal[1]), instant, instant, self._reader.ground)

    def _cache_second(self, text: str) -> Optional[int]:
        """Convert the text of a datime without its nanoseconds to an instant and cache it; return None if invalid."""
        match = _DATIME_TO_SECOND.fullmatch(text)
        if match is None:
            return None
        try:
            instant = timestamps.from_term((timestamps.DATIME7, *map(int, match.groups()), 0))
        except UsageError:
            return None
        return self._seconds.store(text, instant, len(text))


def event_of(goal: Term) -> Optional[InputEvent]:
    """Return the event that a goal denotes, or None for another goal.

    Raises:
        PrologError: if the arguments of the goal are invalid.
    """
    goal = deref(goal)
    if goal.__class__ is not tuple:
        return None
    reader = _PARSERS.get(goal[0])
    return None if reader is None else reader(goal[1:])


def _parse_without_interval(arguments: Sequence[Term]) -> InputEvent:
    term = callable_of(arguments[0])
    # event(event(E,[T1,T2])) is the same as event(E,[T1,T2]).
    if term.__class__ is tuple and term[0] is EVENT2:
        return _parse_with_interval(term[1:])
    return InputEvent(term, None, None)


def _parse_with_interval(arguments: Sequence[Term]) -> InputEvent:
    stamps = list_items(arguments[1])
    if stamps is None or len(stamps) != 2:
        raise type_error("interval", arguments[1])
    return _create_input_event(arguments, instant_of(stamps[0]), instant_of(stamps[1]))


def _parse_with_instant(arguments: Sequence[Term]) -> InputEvent:
    instant = timestamps.from_parts(integer(arguments[1]), integer(arguments[2]))
    return _create_input_event(arguments, instant, instant)


def _parse_with_instants(arguments: Sequence[Term]) -> InputEvent:
    start = timestamps.from_parts(integer(arguments[1]), integer(arguments[2]))
    end = timestamps.from_parts(integer(arguments[3]), integer(arguments[4]))
    return _create_input_event(arguments, start, end)


EVENT1 = functor("event", 1)
_PARSERS: Dict[Functor, Callable[[Sequence[Term]], InputEvent]] = {
    EVENT1: _parse_without_interval,
    EVENT2: _parse_with_interval,
    functor("new_event", 2): _parse_with_interval,
    functor("new_event", 3): _parse_with_instant,
    functor("new_event", 5): _parse_with_instants,
}


def _create_input_event(arguments: Sequence[Term], start: int, end: int) -> InputEvent:
    if end < start or not (timestamps.has_datime(start) and timestamps.has_datime(end)):
        raise type_error("interval", arguments[1])
    return InputEvent(callable_of(arguments[0]), start, end)


def define_new_event(logic: PrologSystem, dispatcher: Dispatcher) -> None:
    """Define ``new_event/2,3,5``: with an interval, with seconds and nanoseconds, and with those of start and end."""
    dispatch = dispatcher.dispatch

    def dispatch_at_instant(
        machine: Machine, arguments: Sequence[Term], frame: Frame, is_ground: bool = False
    ) -> Frame:
        event, seconds, nanoseconds = arguments
        # The common case of two integers in range avoids the general conversion.
        if seconds.__class__ is int and nanoseconds.__class__ is int:
            instant = seconds * SECOND + nanoseconds
            if FIRST_INSTANT <= instant < END_INSTANT:
                instant = FloatSeconds(instant)
                return dispatch(event, instant, instant, frame, None, is_ground or None, is_ground)
        return dispatch_with_conversion(machine, arguments, frame)

    def dispatch_with_conversion(machine: Machine, arguments: Sequence[Term], frame: Frame) -> Frame:
        # `is_owned=False`: the event is dispatched as if it came from outside, not as derived from the current event.
        event = _PARSERS[functor("new_event", len(arguments))](arguments)
        return dispatch(event.term, event.start, event.end, frame, is_owned=False)

    logic.define_control("new_event", 2, dispatch_with_conversion, finishes_at_once=True)
    logic.define_control(
        "new_event", 3, dispatch_at_instant, finishes_at_once=True, make_filter=dispatcher.event_filter
    )
    logic.define_control("new_event", 5, dispatch_with_conversion, finishes_at_once=True)


def define_event_predicates(rules: "RuleBase") -> None:
    """Define the goals that fire events."""
    _EventPredicates(rules).define(rules.logic)


class _EventPredicates:
    """The goals that fire one event, a list of events, or a file."""

    def __init__(self, rules: "RuleBase"):
        self.rules = rules

    def define(self, logic: PrologSystem) -> None:
        logic.define_control("event", 1, self.dispatch_event, finishes_at_once=True)
        logic.define_control("event", 2, self.dispatch_event, finishes_at_once=True)
        logic.define_control("fire_event_list", 1, self.fire_event_list)
        logic.define_control("fire_event_list_return_external_events", 2, self.fire_and_return_events)
        logic.define_control("execute_event_stream_file", 1, self.execute_stream_file)
        logic.define("exists_file", 1, self.exists_file)

    def dispatch_event(self, machine: Machine, arguments: Sequence[Term], frame: Frame) -> Optional[Frame]:
        """Dispatch an event with a given interval or the clock's present time."""
        term = callable_of(arguments[0])
        interval: Optional[Term] = arguments[1] if len(arguments) == 2 else None
        if interval is None and term.__class__ is tuple and term[0] is EVENT2:
            interval = term[2]
            term = callable_of(term[1])
        self.rules.declared_events.require_declared(term)
        if interval is None:
            start = end = self.rules.clock.stamp()
        else:
            start, end = interval_of(interval)
        next_frame: Frame = self.rules.dispatcher.dispatch(term, start, end, frame, is_owned=False)
        return next_frame

    def fire_event_list(self, machine: Machine, arguments: Sequence[Term], frame: Frame) -> Optional[Frame]:
        goals = list_items(arguments[0])
        if goals is None:
            self.rules.network.on_warning(
                UsageError("fire_event_list: expected a list; the argument is fired as a single event")
            )
            goals = [callable_of(arguments[0])]
        # The terms are copied, because their variables may be bound or unbound again before their turn.
        return self._run_goals([copy(goal) for goal in goals], frame)

    def fire_and_return_events(
        self, machine: Machine, arguments: Sequence[Term], frame: Frame
    ) -> Optional[Frame]:
        goals = [(EVENT1, copy(item)) for item in require_list(arguments[0])]
        if not machine.unify(arguments[1], make_list([])):
            return None
        return self._run_goals(goals, frame)

    def exists_file(self, machine: Machine, name: Term) -> bool:
        files = self.rules.files
        return bool(files.is_file(files.resolve(file_name_of(name))))

    def execute_stream_file(
        self, machine: Machine, arguments: Sequence[Term], frame: Frame
    ) -> Optional[Frame]:
        files = self.rules.files
        path = files.resolve(file_name_of(arguments[0]))
        text = files.text(path)
        goals: List[Term] = []
        errors = Errors()
        for read_term in read_program(text, self.rules.logic.operators, str(path)):
            if isinstance(read_term, SyntaxFault):
                errors.append(read_term)
            else:
                goals.append(read_term.term)
        if errors:
            raise ProgramErrors(errors)
        return self._run_goals(goals, frame)

    def _run_goals(self, goals: Sequence[Term], frame: Frame) -> Optional[Frame]:
        """Return a frame that calls the goals in order; goals that fail or raise are reported and skipped."""
        stream = _GoalStream(self.rules, goals)
        return stream.run((stream, frame))


class _GoalStream:
    """Code of a frame that calls the remaining goals of a stream, one for each activation of the frame."""

    def __init__(self, rules: "RuleBase", goals: Sequence[Term]):
        self.rules = rules
        self.goals = iter(goals)
        query = Var()
        self.call = rules.logic.compile_goal((functor("call", 1), query), [query], [])

    def run(self, frame: Frame) -> Optional[Frame]:
        # Only the first remaining goal: the frame is activated again when the goal and its consequences are done.
        for goal in self.goals:
            return self.call.attempt(
                (goal,),
                self._create_solution_handler(frame),
                (_FAILURE_HANDLER, self, goal, frame),
                self._create_error_handler(goal),
            )
        continuation: Frame = frame[1]
        return continuation

    def _create_solution_handler(self, frame: Frame) -> Callable[[Values], Frame]:
        return lambda outputs: frame

    def _create_error_handler(self, goal: Term) -> Callable[[PrologError], None]:
        def report_error(error: PrologError) -> None:
            # The machine then also lets the goal fail; the mark prevents a second report by `_FailureHandler`.
            self.goals = iter([_ERROR_REPORTED, *self.goals])
            text = self.rules.logic.show(goal)
            self.rules.network.on_error(UsageError(f"{text} in an event stream: {error.message}"))

        return report_error


_ERROR_REPORTED: Any = object()
"""Mark at the beginning of the remaining goals of a stream: the error of the last goal was reported."""


class _FailureHandler:
    """Code of the frame for a goal of a stream that has failed or raised."""

    @staticmethod
    def run(frame: Frame) -> Frame:
        next_frame: Frame
        _, stream, goal, next_frame = frame
        remaining = list(stream.goals)
        if remaining and remaining[0] is _ERROR_REPORTED:
            stream.goals = iter(remaining[1:])
        else:
            stream.goals = iter(remaining)
            text = stream.rules.logic.show(goal)
            stream.rules.network.on_error(UsageError(f"{text} in an event stream fails"))
        return next_frame


_FAILURE_HANDLER = _FailureHandler()
