"""The abstract machine: frames, choice points, the trail, and exceptions.

A *frame* is a continuation, a tuple ``(code, argument..., next)``: ``code.run(frame)`` executes one step and returns
the next frame, or None for failure. A *choice point* is a frame with one more item, the length of the trail when it
was pushed. On failure the newest choice point is popped, the bindings above that length are undone, and the frame is
executed. A cut removes choice points from the end of the list. These are the environment, choice point and trail of
the WAM (Warren 1983; Ait-Kaci, "Warren's Abstract Machine"), with continuations on the heap in place of an
environment stack.

The machine does not recurse: the depth of a program is the length of a chain of frames, limited by memory only. A
frame that nothing refers to is freed by Python, so last-call optimisation needs no extra code: a last call passes its
own continuation on.

``catch/3``, cleanup handlers and the limits of sub-goals are choice points, too. `Machine._recover` pops choice
points until one handles the error. A deterministic loop can run for ever without a choice point, and its
trail would grow without bound; `compact` removes the entries that no other object refers to.

Python calls the machine in three ways: `Machine.run` (first solution, bindings kept), `Machine.check` (a test,
bindings undone) and `Machine.solutions` (all solutions, one at a time). `CompiledGoal.attempt` runs a goal once
within a run, without a nested loop.
"""

from sys import getrefcount
from typing import Any, Callable, Generator, List, NamedTuple, Optional, Tuple

from ...foundation.errors import RetalisError, TermTooLarge
from ...foundation.garbage_collection import collect_if_grown
from ...foundation.limit_checks import set_limit_check
from ..terms.term_traversal import copy
from ..terms.types import Frame, Functor, Step, Term, Trail, Values, Var
from ..terms.unification import undo, unify
from .errors import CONTEXT, ERROR, PrologError, first_goal_functor, from_python, indicator, resource_error
from .resource_limits import SLICE, Budget, BudgetState

OutputCollector = Callable[[Frame, Values], Optional[Frame]]
"""First item of a continuation that receives the outputs of a solution of a goal.

Returns the next frame, or None to request the next solution.
"""


LAST = object()
"""Yielded by a nondeterministic built-in at a solution that is known to be the last one."""


class Code:
    """A step implemented by a Python function.

    Attributes:
        name: the name in error messages.
        run: executes the step.
        functor: the functor of the executed goal, for error messages.
        keeps_choice_points: whether the step leaves the choice points unchanged, so that it can be executed outside
            of a run; see `Machine.check`.
        closes_goal: whether a choice point with this code closes the goal above it, because its solutions are
            collected or only the first one is used. A call inside the goal cannot continue after that.
    """

    __slots__ = ("name", "run", "functor", "keeps_choice_points", "closes_goal")

    def __init__(self, name: str, run: Step, closes_goal: bool = False):
        self.name = name
        self.closes_goal = closes_goal
        self.run = run
        self.functor: Optional[Functor] = None
        self.keeps_choice_points = False

    def __repr__(self) -> str:
        return f"<{self.name}>"


class Guard(Code):
    """A choice point that is notified when it is removed by failure or by an exception.

    Args:
        name: the name in error messages.
        unwind: called with the choice point. If the goal exits, the code that cuts the choice point calls it.
        on_failure: called with the choice point when it is removed by failure; by default ``unwind``.
    """

    __slots__ = ("unwind",)

    def __init__(
        self,
        name: str,
        unwind: Callable[[Frame], None],
        on_failure: Optional[Callable[[Frame], None]] = None,
    ):
        super().__init__(name, unwind if on_failure is None else on_failure, True)
        self.unwind = unwind


class GoalCode(Code):
    """Code of a frame that runs a goal from its term, the first argument of the frame.

    Args:
        run: executes the step.
        sample: called with the goal that is about to run, at most once in a slice of steps, to find goals worth
            compiling.
    """

    __slots__ = ("sample",)

    def __init__(self, run: Step, sample: Callable[[Term], None]):
        super().__init__("goal", run)
        self.sample = sample


def fail(frame: Frame) -> None:
    """Fail, as a choice point without further solutions does."""
    return


STOP = Code("stop", fail, True)
"""Choice point below a run, reached when the run has no further solution."""

DEAD = Code("dead", fail)
"""Choice point that was invalidated in place, because the list could not be cut there."""

RESUME = Code("resume", lambda frame: frame[1], True)
"""Choice point that continues with the frame in its second item."""


class CatchMark:
    """State of a ``catch/3``, pushed on the trail when its goal exits: backtracking activates it again."""

    __slots__ = ("ref",)

    def __init__(self) -> None:
        self.ref: Optional[bool] = None


MIN_COMPACTED_ENTRIES = 20_000
"""Minimum length of a trail for which `compact` is worthwhile."""

_unshared_count = 1
"""Reference count of an object that only a local variable refers to; corrected below."""


def drop_unshared(objects: List[Any], object_type: type) -> List[Any]:
    """Empty a list of objects; return those that are referenced elsewhere, and all of other classes."""
    referenced = []
    objects.reverse()
    # First to last: an object that is dropped may hold the last reference to a later one.
    while objects:
        candidate = objects.pop()
        if getrefcount(candidate) > _unshared_count or candidate.__class__ is not object_type:
            referenced.append(candidate)
    return referenced


# Up to Python 3.13, the argument of the call counts as a further reference.
if drop_unshared([object()], object):
    _unshared_count = 2


def compact(trail: Trail, low: int) -> None:
    """Remove trail entries above ``low`` that no other object refers to; ``low`` belongs to the newest choice point.

    A deterministic loop leaves only such entries: variables that are reachable from the trail alone. Nobody can
    observe whether they are unbound, so the trail need not restore them.
    """
    # The entries are moved, not copied: `drop_unshared` counts references, and the trail must not be one of them.
    # Entries below the newest choice point are kept, as backtracking restores the trail to their positions.
    entries = trail[low:]
    del trail[low:]
    trail += drop_unshared(entries, Var)


_FIRST_STEPS = (None,) * 16
"""Steps that a run executes before it enters the main loop; most events and goals finish within them."""

_FINISHED: Frame = (STOP, 1 << 62)
"""Choice point that `Machine.done` pushes before it fails. Leaving the loop in this way costs the other steps no
test."""


class MachineState(NamedTuple):
    """Position of a machine, to which `Machine.restore` returns it.

    Attributes:
        height: height of the choice point stack.
        mark: length of the trail.
    """

    height: int
    mark: int
    budget: BudgetState


class Machine:
    """Executes frames.

    Args:
        budget: resource limits of goals, and their use.

    Attributes:
        trail: variables bound since choice points were pushed; the list object never changes.
        choices: choice points; the list object never changes.
        done: the frame that ends a run, the continuation of the first frame of each `run`.
        budget: resource limits of goals, and their use.
    """

    def __init__(self, budget: Budget):
        self.budget = budget
        self.trail: Trail = []
        self.choices: List[Frame] = []
        self._idle_lengths = (0, 0)
        finish = self.choices.append
        self.done: Frame = (Code("done", lambda frame: finish(_FINISHED)),)
        self._compact_at = MIN_COMPACTED_ENTRIES
        self._enter_code = Code("attempt", self._enter_attempt)
        self._attempt_code = Code("attempt", self._attempt_failed, True)
        self._exit_code: OutputCollector = self._end_attempt
        self.catch_code = Code("catch", fail, True)

    def state(self) -> MachineState:
        """Return the current position, for `restore`."""
        return MachineState(len(self.choices), len(self.trail), self.budget.snapshot())

    def restore(self, state: Optional[MachineState]) -> None:
        """Return to an earlier position after an internal error, and unwind the guards above it.

        None is the position while no goal runs: only choices and bindings of solutions that Python iterates over.
        """
        height, mark = self._idle_lengths if state is None else state[:2]
        while len(self.choices) > height:
            entry = self.choices.pop()
            if entry[0].__class__ is Guard:
                entry[0].unwind(entry)
        undo(self.trail, mark)
        self.budget.restore(None if state is None else state.budget)

    def unify(self, left: Term, right: Term) -> bool:
        """Make two terms equal by binding variables; return whether they unify. If not, nothing is bound."""
        trail = self.trail
        mark = len(trail)
        if unify(left, right, trail):
            return True
        undo(trail, mark)
        return False

    def unify_all(self, *pairs: Tuple[Term, Term]) -> bool:
        """Unify pairs of terms; if one pair fails, nothing is bound."""
        trail = self.trail
        mark = len(trail)
        for left, right in pairs:
            if not unify(left, right, trail):
                undo(trail, mark)
                return False
        return True

    def run(self, frame: Frame) -> bool:
        """Run a frame that ends in `done` to its first solution, and drop the remaining choice points.

        Returns:
            Whether there was a solution; its bindings are kept.

        Raises:
            PrologError: if the program throws and does not catch; all bindings are undone.
        """
        done_code = self.done
        if frame is done_code:
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
                # Setting up the main loop costs more than these steps. Failure ends them early, too: the loop then
                # starts with None and backtracks.
                for _ in _FIRST_STEPS:
                    frame = frame[0].run(frame)
                    if frame is done_code or frame is None:
                        break
            except Exception as exc:
                frame = self._handle(exc, frame, base)
            return frame is done_code or self._loop(frame, base)
        except BaseException:
            self._leave(base)
            undo(self.trail, mark)
            raise
        finally:
            # The list is shortened, never replaced: frames, built-ins and outer runs refer to this object.
            if len(choices) == base + 1:
                choices.pop()
            else:
                del choices[base:]
            if limited:
                budget.leave(saved)
            elif budget.has_use and not base and not budget.is_processing_entry:
                budget.reset()

    def check(self, frame: Frame, goal: object) -> bool:
        """Return whether a goal that keeps the choice points has a solution; keep no bindings.

        Unlike `run`, it executes the first step without pushing a choice point; most goals finish in that step.

        Args:
            frame: the first frame of the goal.
            goal: the goal, to which the use of resources is attributed.
        """
        budget = self.budget
        if budget.needs_check:
            budget.check_entry()
        previous_goal = budget.goal
        budget.goal = goal
        limited = budget.limited
        saved = budget.enter() if limited else None
        mark = len(self.trail)
        try:
            return self.finish_step(frame[0].run(frame), mark)
        except Exception as exc:
            error = self.error(exc, frame, mark)
            if error is exc:
                raise
            raise error from exc
        finally:
            if len(self.trail) > mark:
                undo(self.trail, mark)
            budget.goal = previous_goal
            if limited:
                budget.leave(saved)

    def finish_step(self, frame: Optional[Frame], mark: int) -> bool:
        """Run the rest after a step outside of a run, and undo the bindings above ``mark``."""
        is_solved = frame is self.done or (frame is not None and self.run(frame))
        if len(self.trail) > mark:
            undo(self.trail, mark)
        return is_solved

    def error(self, exc: Exception, frame: Frame, mark: int) -> PrologError:
        """Return the error for an exception that a step outside of a run raised, and undo its bindings.

        Exceptions that are no errors of the program are raised again.
        """
        try:
            self._handle(exc, frame, len(self.choices))
        except PrologError as error:
            return error
        finally:
            undo(self.trail, mark)
        raise exc

    def solutions(self, frame: Optional[Frame], goal: Optional[Term] = None) -> Generator[None, None, None]:
        """Run a frame that ends in `done`; yield at each solution, with its bindings in place.

        Closing the generator drops the remaining choice points and undoes the bindings. Other runs may take place
        between two solutions, if they have ended before the next one is requested.

        Args:
            frame: the first frame of the goal.
            goal: the goal, for reports of resource limits.
        """
        choices = self.choices
        base = len(choices)
        budget = self.budget
        inside = base or budget.running
        budget.running = budget.running or budget.limited
        mark = len(self.trail)
        # This object marks the position of the run among the choice points: if the caller lets runs overlap, or an
        # internal error resets the machine, the position holds another object.
        stop = (STOP, mark)
        choices.append(stop)
        try:
            while self._loop(frame, base) if inside else self._run_outermost(frame, goal):
                height = len(choices)
                if not inside:
                    self._idle_lengths = (height, len(self.trail))
                yield None
                if not inside:
                    self._idle_lengths = (0, 0)
                if len(choices) != height or choices[base] is not stop:
                    raise RetalisError(
                        "solutions of an outer goal were requested while an inner goal is still open"
                    )
                frame = None
        finally:
            # Otherwise an internal error has reset the machine, and newer runs may own the choice points.
            if len(choices) > base and choices[base] is stop:
                self._leave(base)
                del choices[base:]
                undo(self.trail, mark)
                if not inside:
                    self._idle_lengths = (0, 0)
                    budget.running = False
                if not (inside or budget.is_processing_entry):
                    budget.reset()

    def _leave(self, base: int) -> None:
        """Notify the guards of a run that it has ended, also for exceptions that no program can catch."""
        choices = self.choices
        while len(choices) > base + 1:
            entry = choices.pop()
            if entry[0].__class__ is Guard:
                entry[0].unwind(entry)
            elif entry[0] is self._attempt_code:
                self.budget.goal = entry[1]

    def _run_outermost(self, frame: Optional[Frame], goal: Optional[Term]) -> bool:
        """Continue an outermost run; long steps within it check the limits as well."""
        budget = self.budget
        previous_goal, budget.goal = budget.goal, goal
        previous_check = set_limit_check(budget.check_limits)
        try:
            return self._loop(frame, 0)
        finally:
            set_limit_check(previous_check)
            budget.goal = previous_goal

    def _loop(  # noqa: C901 -- a call for each step would cost more than the step
        self, frame: Optional[Frame], base: int
    ) -> bool:
        choices = self.choices
        trail = self.trail
        pop = choices.pop
        pop_trail = trail.pop
        if frame is None:
            frame = (DEAD,)
        # The iterator counts steps in C. It survives an exception, so that a goal that throws repeatedly is counted.
        steps: Any = iter(SLICE)
        while True:
            try:
                while True:
                    for _ in steps:
                        frame = frame[0].run(frame)
                        if frame is None:
                            # Backtrack. `undo` is inlined: it would be the only call here besides the step itself.
                            frame = pop()
                            mark = frame[-1]
                            while len(trail) > mark:
                                pop_trail().ref = None
                            # Every run ends here: with its STOP after the last solution, or with `_FINISHED`, which
                            # `done` has pushed after a solution.
                            if frame[0] is STOP:
                                self.budget.count_last_steps(len(SLICE) - steps.__length_hint__())
                                if frame is _FINISHED:
                                    return True
                                choices.append(frame)
                                return False
                    # A slice has ended: a goal that is met here by sampling runs often, and may be compiled.
                    steps = iter(SLICE)
                    code = frame[0]
                    if code.__class__ is GoalCode:
                        code.sample(frame[1])
                    if len(trail) > self._compact_at:
                        self._compact()
                    collect_if_grown()
                    self.budget.count_slice()
            except Exception as exc:
                frame = self._handle(exc, frame, base)

    def _compact(self) -> None:
        compact(self.trail, self.choices[-1][-1] if self.choices else 0)
        # The next threshold doubles, so that compaction takes amortised constant time for each entry.
        self._compact_at = max(MIN_COMPACTED_ENTRIES, 2 * len(self.trail))

    # Exceptions

    def _handle(self, exc: Exception, frame: Any, base: int) -> Frame:
        """Return the frame that handles an exception; raise it if no choice point above ``base`` does."""
        error = from_python(exc)
        if error is None:
            raise exc
        return self._recover(error, frame, base)

    def _recover(self, error: PrologError, frame: Frame, base: int) -> Frame:
        """Return the frame that handles an error; raise it if no choice point above ``base`` does."""
        choices = self.choices
        error = self._copy_error(error)
        ball = error.term
        self._add_context(ball, frame)
        # A final error reports a limit that the entry has exceeded again: a program that catches it would never end.
        is_final = getattr(error, "is_final", False)
        while len(choices) > base + 1:
            # Removed before it is handled: the handler may run goals, which push choice points.
            entry = choices.pop()
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
    def _copy_error(error: PrologError) -> PrologError:
        """Return an error with a copy of its term, because its bindings are about to be undone."""
        try:
            error.term = copy(error.term)
        except TermTooLarge:
            error.term = resource_error("term_size").term
        except PrologError as limit:  # copying has exceeded a limit
            return limit
        return error

    def _catches(self, entry: Frame, ball: Term) -> bool:
        """Undo the bindings of a ``catch/3``'s goal; return whether its catcher unifies with the ball."""
        trail = self.trail
        undo(trail, entry[-1])
        try:
            if unify(entry[2], ball, trail):
                return True
        except (TermTooLarge, PrologError):  # a ball too large to compare is not the expected one
            pass
        undo(trail, entry[-1])
        return False

    def _add_context(self, ball: Term, frame: Frame) -> None:
        if ball.__class__ is tuple and ball[0] is ERROR and ball[2].__class__ is Var:
            key = getattr(frame[0], "functor", None)
            if frame[0].__class__ is GoalCode:
                key = first_goal_functor(frame[1])
            if key is not None:
                ball[2].ref = (CONTEXT, indicator(key), Var())

    # Attempts

    def attempt_by_frames(
        self,
        goal: object,
        goal_frame: Tuple[Any, ...],
        then: Callable[[Values], Optional[Frame]],
        otherwise: Optional[Frame],
        on_error: Callable[[PrologError], None],
    ) -> Frame:
        """Return the frame that runs a goal once as part of a run; see `CompiledGoal.attempt`.

        Args:
            goal: the goal, for errors about limits.
            goal_frame: the frame that runs the goal, without the collector at its end.
            then: returns the next frame for the outputs.
            otherwise: the next frame without a solution.
            on_error: called with an error of the goal.
        """
        # The choice point is pushed by a frame, as the run that it belongs to may not have started yet.
        return (self._enter_code, goal, goal_frame, then, on_error, otherwise)

    def _enter_attempt(self, frame: Frame) -> Frame:
        goal_frame: Tuple[Any, ...]
        _, goal, goal_frame, then, on_error, otherwise = frame
        choices = self.choices
        height = len(choices)
        budget = self.budget
        choices.append((self._attempt_code, budget.goal, otherwise, on_error, len(self.trail)))
        if budget.needs_check:
            budget.check_entry()
        budget.goal = goal
        return (*goal_frame, (self._exit_code, height, then))

    def _attempt_failed(self, entry: Frame) -> Optional[Frame]:
        self.budget.goal = entry[1]
        return entry[2]  # type: ignore[no-any-return]

    def _end_attempt(self, frame: Frame, outputs: Values) -> Optional[Frame]:
        """Drop the choice points and bindings of an attempt's goal, and pass on its outputs."""
        height = frame[1]
        entry = self.choices[height]
        del self.choices[height:]
        undo(self.trail, entry[-1])
        self.budget.goal = entry[1]
        return frame[2](outputs)  # type: ignore[no-any-return]
