"""Goals that Python code calls, compiled once with inputs and outputs by position.

A goal has up to three forms, each generated when it is first needed: a Python function from inputs to outputs, code
for a frame that passes its outputs to a collector, and code for a frame without outputs. The function is tried first.
If it cannot decide, it returns `BAIL` and the frame runs instead; after `_MAX_BAILS` such attempts it is not tried
again.
"""

from typing import Any, List, Optional, Sequence, Union

from ...foundation.errors import Place
from ..compiler.goal_code import GoalGenerator
from ..machine.errors import PrologError, from_python
from ..machine.machine import BAIL, Code
from ..terms.types import Frame, Term, Values, Var
from ..terms.unification import undo
from .database import Database
from .predicate import Predicate

_MAX_BAILS = 20
"""Attempts of the function that end in `BAIL` after which the goal only runs on the machine."""


class CompiledGoal:
    """Goal compiled with inputs and outputs; created by `PrologSystem.compile_goal`.

    Args:
        database: the predicates that it may call.
        term: the goal.
        inputs: variables that get values, by position.
        outputs: terms whose values are returned, by position.
        place: source position of the goal, or None.
        name: name of the caller, for errors.
        from_outside: whether the goal comes from a client and not from the program; such goals may not change flags.

    Attributes:
        straight: Python function of the inputs that returns the outputs of the first solution, None if there is none,
            or `BAIL` if it cannot decide; None if the goal needs the machine.
        code: runs the goal without its outputs, by frames ``(code, inputs..., next)``.
    """

    def __init__(
        self,
        database: Database,
        term: Term,
        inputs: Sequence[Var],
        outputs: Sequence[Term],
        place: Optional[Place] = None,
        name: str = "goal",
        from_outside: bool = False,
    ):
        self.term = term
        self.from_outside = from_outside
        self.place = place
        self.name = name
        self._database = database
        self._machine = database.machine
        self._inputs = tuple(inputs)
        self._outputs = tuple(outputs)
        self._source = GoalGenerator(database, term, self._inputs, self._outputs, place, name)
        self._source.parse()
        self._compile()
        database.goals.add(self)

    def _compile(self) -> None:
        """Install stubs that generate the code when they first run."""
        source = self._source
        self.straight: Any = self._first_straight
        self._bailed = 0
        self._handing_over = Code(self.name, self._first_enter)
        called = source.call()
        self.code: Union[Code, Predicate] = Code(self.name, self._first_plain) if called is None else called

    def forget(self) -> None:
        """Drop generated code, whose references to predicates are out of date."""
        self._source.parse()
        self.straight = self._first_straight
        self._handing_over.run = self._first_enter
        code: Any = self.code
        # Frames and compiled clauses may hold the code object, so it is reset and not replaced.
        if code.__class__ is Code:
            code.run, code.steady = self._first_plain, False
        else:
            self.code = self._source.call() or Code(self.name, self._first_plain)

    def _first_straight(self, *values: Term) -> Any:
        # Generated at the first call, because the predicates that the goal calls may be defined after it. A goal from
        # a client has no function: while a function runs, the budget does not know which goal it belongs to.
        self.straight = None if self.from_outside else self._source.straight()
        return BAIL if self.straight is None else self.straight(*values)

    def prepare(self) -> None:
        """Generate the function before the first call, if all predicates that it calls are defined."""
        if self.straight != self._first_straight or self.from_outside:
            return
        try:
            self.straight = self._source.straight() or self._first_straight
        except (PrologError, RecursionError):
            # The first call raises the same error, with its caller as context.
            return

    def bail(self) -> None:
        """Count an attempt in which the function could not decide; after `_MAX_BAILS` of them drop the function."""
        self._bailed += 1
        if self._bailed > _MAX_BAILS:
            self.straight = None

    def _first_enter(self, frame: Frame) -> Optional[Frame]:
        self._handing_over.run, _ = self._source.enter(True)
        return self._handing_over.run(frame)

    def _first_plain(self, frame: Frame) -> Optional[Frame]:
        run, steady = self._source.enter(False)
        code: Any = self.code  # not a predicate here: those run themselves
        code.run, code.steady = run, steady
        return self.code.run(frame)

    def enter(self, values: Values, collector: Frame) -> Frame:
        """Return the frame that runs the goal and passes its resolved outputs to a collector.

        For each solution it calls ``collector[0].take(collector, outputs)``, which returns the next frame.
        """
        return (self._handing_over, *values, collector)

    def test(self, values: Values) -> Optional[Values]:
        """Run the goal for its first solution.

        Args:
            values: values of the inputs, by position.

        Returns:
            The resolved outputs, or None if there is no solution. No bindings remain.

        Raises:
            PrologError: if the goal raises it.
        """
        budget = self._machine.budget
        if budget.closed:
            budget.admit()
        # The budget names the goal in errors about limits; a nested goal must not stay named after it has ended.
        asked = budget.goal
        budget.goal = self
        try:
            if self.straight is not None:
                result: Any = self._ask_straight(values)
                if result is not BAIL:
                    return result  # type: ignore[no-any-return]
                self.bail()
            return self._run(values)
        finally:
            budget.goal = asked

    def _run(self, values: Values) -> Optional[Values]:
        machine = self._machine
        mark = len(machine.trail)
        if not self._outputs:
            frame = (self.code, *values, machine.done)
            # A steady step pushes no choice point, so it may run without setting up a run of the machine.
            if self.code.steady:
                return () if machine.check(frame, self) else None
            succeeded = machine.run(frame)
            undo(machine.trail, mark)
            return () if succeeded else None
        found: List[Values] = []
        if not machine.run((self._handing_over, *values, (_STORE, found, machine.done))):
            return None
        undo(machine.trail, mark)
        return found[0]

    def _ask_straight(self, values: Values) -> Any:
        """Return the result of the function, with the errors and limits of a run on the machine."""
        machine = self._machine
        budget = machine.budget
        limited = budget.limited
        saved = budget.enter() if limited else None
        mark = len(machine.trail)
        try:
            return self.straight(*values)
        except BaseException as exc:
            undo(machine.trail, mark)
            error = from_python(exc)
            if error is None or error is exc:
                raise
            raise error from exc
        finally:
            if limited:
                budget.leave(saved)

    def all(self, values: Values) -> List[Values]:
        """Return the resolved outputs of all solutions."""
        machine = self._machine
        mark = len(machine.trail)
        found: List[Values] = []
        machine.run((self._handing_over, *values, (_STORE_ALL, found)))
        undo(machine.trail, mark)
        return found

    def __repr__(self) -> str:
        return f"<Goal {self.name}>"


class _KeepOne:
    """Collector that stores the outputs and continues with the next frame."""

    def take(self, frame: Frame, outputs: Values) -> Frame:
        frame[1].append(outputs)
        return frame[2]  # type: ignore[no-any-return]


class _KeepAll:
    """Collector that stores the outputs and fails, so that the machine backtracks into the next solution."""

    def take(self, frame: Frame, outputs: Values) -> None:
        frame[1].append(outputs)


_STORE = _KeepOne()
_STORE_ALL = _KeepAll()
