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
        self._generator = GoalGenerator(database, term, self._inputs, self._outputs, place, name)
        self._generator.parse()
        self._install_stubs()
        database.goals.add(self)

    def _install_stubs(self) -> None:
        """Install stubs that generate the code when they first run."""
        generator = self._generator
        self.straight: Any = self._generate_straight
        self._bails = 0
        self._output_code = Code(self.name, self._generate_output_code)
        predicate = generator.call()
        self.code: Union[Code, Predicate] = (
            Code(self.name, self._generate_code) if predicate is None else predicate
        )

    def forget(self) -> None:
        """Drop generated code, whose references to predicates are out of date."""
        self._generator.parse()
        self.straight = self._generate_straight
        self._output_code.run = self._generate_output_code
        code: Any = self.code
        # Frames and compiled clauses may hold the code object, so it is reset and not replaced.
        if code.__class__ is Code:
            code.run, code.keeps_choice_points = self._generate_code, False
        else:
            self.code = self._generator.call() or Code(self.name, self._generate_code)

    def _generate_straight(self, *values: Term) -> Any:
        # Generated at the first call, because the predicates that the goal calls may be defined after it. A goal from
        # a client has no function: while a function runs, the budget does not know which goal it belongs to.
        self.straight = None if self.from_outside else self._generator.straight()
        return BAIL if self.straight is None else self.straight(*values)

    def prepare(self) -> None:
        """Generate the function before the first call, if all predicates that it calls are defined."""
        if self.straight != self._generate_straight or self.from_outside:
            return
        try:
            self.straight = self._generator.straight() or self._generate_straight
        except (PrologError, RecursionError):
            # The first call raises the same error, with its caller as context.
            return

    def bail(self) -> None:
        """Count an attempt in which the function could not decide; after `_MAX_BAILS` of them drop the function."""
        self._bails += 1
        if self._bails > _MAX_BAILS:
            self.straight = None

    def _generate_output_code(self, frame: Frame) -> Optional[Frame]:
        self._output_code.run, _ = self._generator.enter(True)
        return self._output_code.run(frame)

    def _generate_code(self, frame: Frame) -> Optional[Frame]:
        run, keeps_choice_points = self._generator.enter(False)
        code: Any = self.code  # not a predicate here: those run themselves
        code.run, code.keeps_choice_points = run, keeps_choice_points
        return self.code.run(frame)

    def enter(self, values: Values, collector: Frame) -> Frame:
        """Return the frame that runs the goal and passes its resolved outputs to a collector.

        For each solution it calls ``collector[0].take(collector, outputs)``, which returns the next frame.
        """
        return (self._output_code, *values, collector)

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
        if budget.needs_check:
            budget.check_entry()
        # The budget names the goal in errors about limits; a nested goal must not stay named after it has ended.
        outer_goal = budget.goal
        budget.goal = self
        try:
            if self.straight is not None:
                result: Any = self._call_straight(values)
                if result is not BAIL:
                    return result  # type: ignore[no-any-return]
                self.bail()
            return self._run(values)
        finally:
            budget.goal = outer_goal

    def _run(self, values: Values) -> Optional[Values]:
        machine = self._machine
        mark = len(machine.trail)
        if not self._outputs:
            frame = (self.code, *values, machine.done)
            # A step that keeps the choice points pushes none, so it may run without setting up a run of the machine.
            if self.code.keeps_choice_points:
                return () if machine.check(frame, self) else None
            succeeded = machine.run(frame)
            undo(machine.trail, mark)
            return () if succeeded else None
        solutions: List[Values] = []
        if not machine.run((self._output_code, *values, (_STORE, solutions, machine.done))):
            return None
        undo(machine.trail, mark)
        return solutions[0]

    def _call_straight(self, values: Values) -> Any:
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
        solutions: List[Values] = []
        machine.run((self._output_code, *values, (_STORE_ALL, solutions)))
        undo(machine.trail, mark)
        return solutions

    def __repr__(self) -> str:
        return f"<Goal {self.name}>"


class _FirstSolution:
    """Collector that stores the outputs and continues with the next frame."""

    def take(self, frame: Frame, outputs: Values) -> Frame:
        frame[1].append(outputs)
        return frame[2]  # type: ignore[no-any-return]


class _AllSolutions:
    """Collector that stores the outputs and fails, so that the machine backtracks into the next solution."""

    def take(self, frame: Frame, outputs: Values) -> None:
        frame[1].append(outputs)


_STORE = _FirstSolution()
_STORE_ALL = _AllSolutions()
