"""Goals that fire events: one, a list, a file."""

from typing import Any, Callable, List, Optional, Sequence

from ...foundation import Errors, ProgramErrors, SyntaxFault, UsageError
from ...prolog.builtins import callable_of
from ...prolog.logic import Logic
from ...prolog.machine import Frame, Machine, PrologError
from ...prolog.syntax import read_program
from ...prolog.terms import Term, Values, Var, copy, functor, list_items, make_list
from .arguments import EVENT2, interval_of, items_of, path_of

_EVENT1 = functor("event", 1)


def define_firing(rules: Any) -> None:
    """Define the goals that fire events for a program's rules."""
    _FiringGoals(rules).define(rules.logic)


class _FiringGoals:
    """Goals that fire events: one, a list, a file."""

    def __init__(self, rules: Any):
        self.rules = rules

    def define(self, logic: Logic) -> None:
        logic.define_control("event", 1, self.event, at_once=True)
        logic.define_control("event", 2, self.event, at_once=True)
        logic.define_control("fire_event_list", 1, self.fire_list)
        logic.define_control("fire_event_list_return_external_events", 2, self.fire_and_return)
        logic.define_control("execute_event_stream_file", 1, self.execute_file)
        logic.define("exists_file", 1, self.exists)

    def event(self, machine: Machine, arguments: Sequence[Term], after: Frame) -> Optional[Frame]:
        """Dispatch an event, with the interval given or stamped by the clock."""
        term = callable_of(arguments[0])
        interval: Optional[Term] = arguments[1] if len(arguments) == 2 else None
        if interval is None and term.__class__ is tuple and term[0] is EVENT2:
            interval = term[2]
            term = callable_of(term[1])
        self.rules.declared.require(term)
        if interval is None:
            start = end = self.rules.clock.stamp()
        else:
            start, end = interval_of(interval)
        found: Frame = self.rules.dispatcher.dispatch(term, start, end, after, own=False)
        return found

    def fire_list(self, machine: Machine, arguments: Sequence[Term], after: Frame) -> Optional[Frame]:
        goals = list_items(arguments[0])
        if goals is None:
            self.rules.on_warning(
                UsageError("fire_event_list takes a list; what it was given is fired as a single event")
            )
            goals = [callable_of(arguments[0])]
        return self._each([copy(goal) for goal in goals], after)

    def fire_and_return(self, machine: Machine, arguments: Sequence[Term], after: Frame) -> Optional[Frame]:
        goals = [(_EVENT1, copy(item)) for item in items_of(arguments[0])]
        if not machine.unify(arguments[1], make_list([])):
            return None
        return self._each(goals, after)

    def exists(self, machine: Machine, name: Term) -> bool:
        files = self.rules.files
        return bool(files.is_file(files.resolve(path_of(name))))

    def execute_file(self, machine: Machine, arguments: Sequence[Term], after: Frame) -> Optional[Frame]:
        files = self.rules.files
        path = files.resolve(path_of(arguments[0]))
        text = files.text(path)
        goals: List[Term] = []
        errors = Errors()
        for read in read_program(text, self.rules.logic.operators, str(path)):
            if isinstance(read, SyntaxFault):
                errors.append(read)
            else:
                goals.append(read.term)
        if errors:
            raise ProgramErrors(errors)
        return self._each(goals, after)

    def _each(self, goals: Sequence[Term], after: Frame) -> Optional[Frame]:
        """Return the frame that calls the goals in order; what fails or raises is reported, and the rest goes on."""
        stream = _Stream(self.rules, goals)
        return stream.run((stream, after))


class _Stream:
    """Code of a frame that calls the goals that are left."""

    def __init__(self, rules: Any, goals: Sequence[Term]):
        self.rules = rules
        self.goals = iter(goals)
        self.machine: Machine = rules.logic.machine
        query = Var()
        self.call = rules.logic.compile_goal((functor("call", 1), query), [query], [])

    def run(self, frame: Frame) -> Optional[Frame]:
        for goal in self.goals:
            found: Optional[Frame] = self.machine.attempt(
                self.call, (goal,), self._done(frame), (_FAILED, self, goal, frame), self._raised(goal)
            )
            return found
        last: Frame = frame[1]
        return last

    def _done(self, frame: Frame) -> Callable[[Values], Frame]:
        return lambda outputs: frame

    def _raised(self, goal: Term) -> Callable[[PrologError], None]:
        def report(error: PrologError) -> None:
            self.goals = iter([_RAISED, *self.goals])
            text = self.rules.logic.show(goal)
            self.rules.on_error(UsageError(f"{text} in an event stream: {error.message}"))

        return report


_RAISED: Any = object()


class _Failed:
    """Code of the frame for a goal of a stream that failed (or raised, which is reported already)."""

    @staticmethod
    def run(frame: Frame) -> Frame:
        after: Frame
        _, stream, goal, after = frame
        left = list(stream.goals)
        if left and left[0] is _RAISED:
            stream.goals = iter(left[1:])
        else:
            stream.goals = iter(left)
            text = stream.rules.logic.show(goal)
            stream.rules.on_error(UsageError(f"{text} in an event stream fails"))
        return after


_FAILED = _Failed()
