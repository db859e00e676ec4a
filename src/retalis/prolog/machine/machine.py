"""Steps and choice points: what frames run. See `machine`.

The trail of a long run: what of it need not be remembered.

The machine: frames, choice points, trail and exceptions.

A *frame* is a tuple ``(code, argument..., next)``: ``code.run(frame)`` does one step and returns the next
frame, or None for failure. A *choice point* is a frame with one more item, the length of the trail when it
was pushed; on failure the newest one is popped, the trail is undone to that length, and the frame is run.
There is no recursion: the depth of a program is the length of a chain of frames.
"""

from typing import Any, Callable, Generator, List, Optional, Protocol, Tuple

from ...foundation.cancellation import watched_by
from ...foundation.errors import RetalisError, TermTooLarge
from ...foundation.python_interpreter import SEEN_AT, releasing, seen_elsewhere
from ..terms.term_traversal import copy
from ..terms.types import Frame, Functor, Step, Term, Trail, Values, Var
from ..terms.unification import undo, unify
from .errors import CONTEXT, ERROR, PrologError, first_called, from_python, indicator, resource_error
from .resource_limits import SLICE, Budget


class Takes(Protocol):
    """What a frame begins with that a goal hands its outputs to."""

    def take(self, frame: Frame, outputs: Values, /) -> Optional[Frame]:
        """Take the outputs of a solution; return the frame to go on with, or None for the next solution."""


class Asked(Protocol):
    """A `CompiledGoal`, as far as the machine knows it."""

    @property
    def straight(self) -> Optional[Callable[..., Any]]:
        """Its function, which returns its outputs, None, or `BAIL`; None where there is none."""

    def bail(self) -> None:
        """Note that its function could not tell."""

    def enter(self, values: Values, collector: Frame, /) -> Frame:
        """Return the frame that runs it and hands its outputs to a `Takes`."""


BAIL = object()
"""What the function of a `CompiledGoal` returns where the goal has to be run by frames after all."""

LAST = object()
"""What a nondeterministic built-in yields at a solution after which there is surely none."""


class Code:
    """A step given by a Python function.

    Attributes:
        name: for errors.
        run: does the step.
        functor: of what is run, for errors.
        steady: whether the step leaves the stack of choice points alone, so that it may be done before a run,
            see `Machine.check`.
        closes: whether it is that of a choice point below a goal whose solutions are taken together, or which is
            over when it has one: a call in the goal cannot go on after that.
        dropped: called with a choice point that is cut, where the interpreter does not end by itself what it alone
            holds.
    """

    __slots__ = ("name", "run", "functor", "steady", "closes", "dropped")

    def __init__(self, name: str, run: Step, closes: bool = False):
        self.name = name
        self.closes = closes
        self.run = run
        self.functor: Optional[Functor] = None
        self.steady = False
        self.dropped: Optional[Callable[[Frame], None]] = None

    def __repr__(self) -> str:
        return f"<{self.name}>"


class Guard(Code):
    """A choice point that has to be told when it goes, by failure or by an exception.

    Args:
        name: for errors.
        unwind: called with the choice point. Where a goal exits, whoever cuts the choice point calls it.
    """

    __slots__ = ("unwind",)

    def __init__(self, name: str, unwind: Callable[[Frame], None]):
        super().__init__(name, unwind, True)
        self.unwind = unwind


def drop(entry: Frame) -> None:
    """End what only a choice point has held that was cut."""
    dropped = getattr(entry[0], "dropped", None)  # of a `Code`; whatever else does steps holds nothing
    if dropped is not None:
        dropped(entry)


def fail(frame: Frame) -> None:
    """Fail: what a choice point without another solution does."""
    return


STOP = Code("stop", fail, True)
"""Choice point below a run: reached when the run has no (more) solution."""

DEAD = Code("dead", fail)
"""Choice point that was taken back where the stack could not be cut."""

RESUME = Code("resume", lambda frame: frame[1], True)
"""Choice point that goes on with the frame that it holds."""


class CatchMark:
    """State of a ``catch/3``; goes on the trail when its goal has exited, so that backtracking reopens it."""

    __slots__ = ("ref",)

    def __init__(self) -> None:
        self.ref: Optional[bool] = None


def compact(trail: Trail, low: int) -> None:
    """Drop entries above the newest choice point, which is at ``low``, that nothing else can see any more.

    A deterministic loop leaves nothing but such entries behind: variables that only the trail still
    holds. Their unbinding could not be noticed, so they need not be remembered.
    """
    entries = trail[low:]
    del trail[low:]
    trail += seen_elsewhere(entries, Var)


_EMPTY_STACK = (None,) * 16
"""Steps that a run begins with: most events and goals are done with sooner, without setting up the loop."""

_FINISHED: Frame = (STOP, 1 << 62)
"""What `Machine.done` pushes before it fails: leaving the loop that way costs its steps no test."""

_GO_ON = Code("go on", lambda frame: frame[1](frame[2]))
"""Code of a frame that calls a function for the frame to go on with."""


class Machine:
    """Runs frames.

    Attributes:
        trail: variables bound since choice points were pushed; the list object never changes.
        choices: choice points; the list object never changes.
        done: the frame that ends a run: the continuation of the first frame of each `run`.
        goal_code: the code that runs a goal from its term, the first argument of its frame.
        meet: is shown what is about to be run that way once in a slice of steps, if it is then.
        budget: what goals may use and have used.
        idle: how long choices and trail are while nothing runs, see `recovery`.
    """

    def __init__(self) -> None:
        self.trail: Trail = []
        self.choices: List[Frame] = releasing(drop)
        self.idle = (0, 0)
        finish = self.choices.append
        self.done: Frame = (Code("done", lambda frame: finish(_FINISHED)),)
        self.budget = Budget()
        self._compact_at = SEEN_AT
        self._enter_code = Code("attempt", self._enter_attempt)
        self._attempt_code = Code("attempt", self._attempt_failed, True)
        self._exit_code = _AttemptExit(self)
        self.catch_code = Code("catch", fail, True)
        self.goal_code: Optional[Code] = None
        self.meet: Callable[[Term], None] = lambda goal: None
        self.logic: Any = None

    def unify(self, left: Term, right: Term) -> bool:
        """Make two terms equal by binding variables, and say whether they could be; if not, nothing is bound."""
        trail = self.trail
        mark = len(trail)
        if unify(left, right, trail):
            return True
        undo(trail, mark)
        return False

    def unify_all(self, *pairs: Tuple[Term, Term]) -> bool:
        """Unify pairs of terms, all or none."""
        trail = self.trail
        mark = len(trail)
        for left, right in pairs:
            if not unify(left, right, trail):
                undo(trail, mark)
                return False
        return True

    def run(self, frame: Frame) -> bool:
        """Run a frame that ends in `done` to its first solution; choice points left are dropped.

        Returns:
            Whether there was a solution; its bindings stay.

        Raises:
            PrologError: what the program threw and did not catch; then all bindings are undone.
        """
        done = self.done
        if frame is done:
            return True
        choices = self.choices
        base = len(choices)
        budget = self.budget
        limited = budget.limited
        saved = budget.enter() if limited else None
        mark = len(self.trail)
        choices.append((STOP, mark))
        try:
            try:
                for _ in _EMPTY_STACK:
                    frame = frame[0].run(frame)
                    if frame is done or frame is None:
                        break
            except Exception as exc:
                frame = self._handle(exc, frame, base)
            return frame is done or self._loop(frame, base)
        except BaseException:
            self._leave(base)
            undo(self.trail, mark)
            raise
        finally:
            if len(choices) == base + 1:
                choices.pop()
            else:
                del choices[base:]
            if limited:
                budget.leave(saved)
            elif budget.used and not base and not budget.at_work:
                budget.start_anew()

    def check(self, frame: Frame, goal: Asked) -> bool:
        """As `run`, for the frame of a `CompiledGoal` that is steady: most often its step is all there is to do.

        No bindings stay.
        """
        budget = self.budget
        if budget.closed:
            budget.admit()
        asked = budget.goal
        budget.goal = goal
        limited = budget.limited
        saved = budget.enter() if limited else None
        mark = len(self.trail)
        try:
            return self.settle(frame[0].run(frame), mark)
        except Exception as exc:
            error = self.error(exc, frame, mark)
            if error is exc:
                raise
            raise error from exc
        finally:
            if len(self.trail) > mark:
                undo(self.trail, mark)
            budget.goal = asked
            if limited:
                budget.leave(saved)

    def settle(self, frame: Optional[Frame], mark: int) -> bool:
        """Run what is left after a step outside of a run, and take back the bindings since ``mark``."""
        found = frame is self.done or (frame is not None and self.run(frame))
        if len(self.trail) > mark:
            undo(self.trail, mark)
        return found

    def error(self, exc: Exception, frame: Frame, mark: int) -> PrologError:
        """Return the error of an exception that a step outside of a run raised, and take back its bindings.

        What is not an error of the program is raised again.
        """
        try:
            self._handle(exc, frame, len(self.choices))
        except PrologError as error:
            return error
        finally:
            undo(self.trail, mark)
        raise exc

    def solutions(self, frame: Optional[Frame], goal: Optional[Term] = None) -> Generator[None, None, None]:
        """Run a frame that ends in `done`, of a goal; yield at each solution, with its bindings in place.

        Closing the iterator drops what is left and undoes the bindings. Other runs may take place
        between solutions as long as they are over before the next one is asked for.
        """
        choices = self.choices
        base = len(choices)
        budget = self.budget
        inside = base or budget.running
        budget.running = budget.running or budget.limited
        mark = len(self.trail)
        stop = (STOP, mark)
        choices.append(stop)
        try:
            while self._loop(frame, base) if inside else self._watched(frame, goal):
                height = len(choices)
                if not inside:
                    self.idle = (height, len(self.trail))
                yield None
                if not inside:
                    self.idle = (0, 0)
                if len(choices) != height or choices[base] is not stop:
                    raise RetalisError(
                        "solutions of an outer goal were requested while an inner goal is still open"
                    )
                frame = None
        finally:
            if len(choices) > base and choices[base] is stop:  # else an interrupt has ended all long ago
                self._leave(base)
                del choices[base:]
                undo(self.trail, mark)
                if not inside:
                    self.idle = (0, 0)
                    budget.running = False
                if not (inside or budget.at_work):
                    budget.start_anew()

    def _leave(self, base: int) -> None:
        """Tell the guards of a run that it is over, also by what no program can catch, as an interrupt."""
        choices = self.choices
        while len(choices) > base + 1:
            entry = choices[-1]
            if entry[0].__class__ is Guard:
                entry[0].unwind(entry)
            elif entry[0] is self._attempt_code:
                self.budget.goal = entry[1]
            del choices[-1:]

    def _watched(self, frame: Optional[Frame], goal: Optional[Term]) -> bool:
        """Go on with an outermost run; long steps in it look at the limits too."""
        budget = self.budget
        asked, budget.goal = budget.goal, goal
        before = watched_by(budget.look)
        try:
            return self._loop(frame, 0)
        finally:
            watched_by(before)
            budget.goal = asked

    def _loop(  # noqa: C901 -- a call for each step would cost more than the step
        self, frame: Optional[Frame], base: int
    ) -> bool:
        choices = self.choices
        trail = self.trail
        pop = choices.pop
        pop_trail = trail.pop
        if frame is None:
            frame = (DEAD,)
        left: Any = iter(SLICE)  # also after an exception: what throws again and again is counted too
        while True:
            try:
                while True:
                    for _ in left:
                        frame = frame[0].run(frame)
                        if frame is None:
                            frame = pop()
                            mark = frame[-1]
                            while len(trail) > mark:
                                pop_trail().ref = None
                            if frame[0] is STOP:
                                self.budget.ended(len(SLICE) - left.__length_hint__())
                                if frame is _FINISHED:
                                    return True
                                choices.append(frame)
                                return False
                    left = iter(SLICE)
                    if frame[0] is self.goal_code:
                        self.meet(frame[1])
                    if len(trail) > self._compact_at:
                        self._compact()
                    self.budget.sliced()
            except Exception as exc:
                frame = self._handle(exc, frame, base)

    def _compact(self) -> None:
        compact(self.trail, self.choices[-1][-1] if self.choices else 0)
        self._compact_at = max(SEEN_AT, 2 * len(self.trail))

    # Exceptions

    def _handle(self, exc: Exception, frame: Any, base: int) -> Frame:
        """Return the frame that handles an exception, or raise it where nothing above ``base`` does."""
        error = from_python(exc)
        if error is None:
            raise exc
        return self._recover(error, frame, base)

    def _recover(self, error: PrologError, frame: Frame, base: int) -> Frame:
        """Return the frame that handles an error, or raise it where nothing above ``base`` does."""
        choices = self.choices
        error = self._copied(error)
        ball = error.term
        self._add_context(ball, frame)
        is_final = getattr(error, "final", False)
        while len(choices) > base + 1:
            entry = choices[-1]
            del choices[-1:]
            code = entry[0]
            if code is self.catch_code:
                if entry[1].ref is None and not is_final and self._catches(entry, ball):
                    return entry[3]  # type: ignore[no-any-return]
            elif code.__class__ is Guard:
                code.unwind(entry)
            elif code is self._attempt_code:
                undo(self.trail, entry[-1])
                self.budget.goal = entry[1]
                entry[3](error)
                return entry[2]  # type: ignore[no-any-return]
        raise error

    @staticmethod
    def _copied(error: PrologError) -> PrologError:
        """Return an error with a copy of its term, because bindings are about to be undone."""
        try:
            error.term = copy(error.term)
        except TermTooLarge:
            error.term = resource_error("term_size").term
        except PrologError as limit:  # the copy took too long
            return limit
        return error

    def _catches(self, entry: Frame, ball: Term) -> bool:
        """Undo what a ``catch/3`` has to undo, and tell whether its catcher unifies with the ball."""
        trail = self.trail
        undo(trail, entry[-1])
        try:
            if unify(entry[2], ball, trail):
                return True
        except (TermTooLarge, PrologError):  # too large to be compared in time: not the error looked for
            pass
        undo(trail, entry[-1])
        return False

    def _add_context(self, ball: Term, frame: Frame) -> None:
        if ball.__class__ is tuple and ball[0] is ERROR and ball[2].__class__ is Var:
            key = getattr(frame[0], "functor", None)
            if frame[0] is self.goal_code:
                key = first_called(frame[1])
            if key is not None:
                ball[2].ref = (CONTEXT, indicator(key), Var())

    # Attempts

    def attempt(
        self,
        goal: Asked,
        values: Values,
        then: Callable[[Values], Optional[Frame]],
        otherwise: Optional[Frame],
        on_error: Callable[[PrologError], None],
    ) -> Optional[Frame]:
        """Run a `CompiledGoal` once behind a barrier, as part of a run: return the frame to go on with.

        The first solution's outputs are resolved, its choice points and bindings are dropped, and the run
        goes on with ``then(outputs)``; if there is none, or ``on_error(error)`` was called, with
        ``otherwise``.
        """
        straight = goal.straight
        if straight is not None and not self.budget.closed:
            mark = len(self.trail)
            try:
                outputs = straight(*values)
            except Exception as exc:
                undo(self.trail, mark)
                error = from_python(exc)
                if error is None:
                    raise
                on_error(error)
                return otherwise
            if outputs is not BAIL:
                # Not called here: it may ask for another attempt, and so on.
                return otherwise if outputs is None else (_GO_ON, then, outputs)
            goal.bail()
        # A frame of its own: an attempt may be asked for before the loop runs that its choice point belongs to.
        return (self._enter_code, goal, values, then, on_error, otherwise)

    def _enter_attempt(self, frame: Frame) -> Frame:
        goal: Asked
        _, goal, values, then, on_error, otherwise = frame
        choices = self.choices
        height = len(choices)
        budget = self.budget
        choices.append((self._attempt_code, budget.goal, otherwise, on_error, len(self.trail)))
        if budget.closed:
            budget.admit()
        budget.goal = goal
        return goal.enter(values, (self._exit_code, height, then))

    def _attempt_failed(self, entry: Frame) -> Optional[Frame]:
        self.budget.goal = entry[1]
        return entry[2]  # type: ignore[no-any-return]


class _AttemptExit:
    """Continuation of an attempt's goal, which hands its outputs over."""

    __slots__ = ("_machine",)

    def __init__(self, machine: Machine):
        self._machine = machine

    def take(self, frame: Frame, outputs: Values) -> Optional[Frame]:
        machine = self._machine
        height = frame[1]
        entry = machine.choices[height]
        del machine.choices[height:]
        undo(machine.trail, entry[-1])
        machine.budget.goal = entry[1]
        return frame[2](outputs)  # type: ignore[no-any-return]
