"""Goals that Python code calls, compiled once with inputs and outputs by position.

A goal has up to three forms, each generated when it is first needed: a Python function from inputs to outputs, code
for a frame that passes its outputs to a collector, and code for a frame without outputs. The function is tried first.
If it meets a case that it does not implement (see `FunctionCode`), it returns `BAIL` and the frame runs instead;
after `_MAX_BAILS` such attempts it is not tried again.
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
"""Number of calls of the function that return `BAIL` after which the goal only runs on the machine."""


class CompiledGoal:
    """Goal compiled with inputs and outputs; created by `PrologSystem.compile_goal`.

    Args:
        database: the predicates that it may call.
        term: the goal.
        inputs: variables that get values, by position.
        outputs: terms whose values are returned, by position.
        place: source position of the goal, or None.
        name: name of the caller, for errors.
        is_from_client: whether the goal comes from a client and not from the program. Such goals may not change
            flags.

    Attributes:
        function: Python function of the inputs that returns the outputs of the first solution, None if there is none,
            or `BAIL` if the goal has to run on the machine. None if no function can be generated for the goal.
        code: code of frames ``(code, *inputs, next_frame)`` that run the goal without returning outputs.
    """

    def __init__(
        self,
        database: Database,
        term: Term,
        inputs: Sequence[Var],
        outputs: Sequence[Term],
        place: Optional[Place] = None,
        name: str = "goal",
        is_from_client: bool = False,
    ):
        self.term = term
        self.is_from_client = is_from_client
        self.place = place
        self.name = name
        self._database = database
        self._machine = database.machine
        self._inputs = tuple(inputs)
        self._outputs = tuple(outputs)
        self._generator = GoalGenerator(database, term, self._inputs, self._outputs, place, name)
        self._generator.parse()
        self._install_stubs()
        database.compiled_goals.add(self)

    def _install_stubs(self) -> None:
        """Install stubs that generate the code when they first run."""
        generator = self._generator
        self.function: Any = self._generate_function
        self._bail_count = 0
        self._output_code = Code(self.name, self._generate_output_code)
        predicate = generator.called_predicate()
        self.code: Union[Code, Predicate] = (
            Code(self.name, self._generate_code) if predicate is None else predicate
        )

    def invalidate(self) -> None:
        """Discard the generated code, because a predicate that it refers to has been redefined."""
        self._generator.parse()
        self.function = self._generate_function
        self._output_code.run = self._generate_output_code
        code: Any = self.code
        # Frames and compiled clauses may hold the code object, so it is reset and not replaced.
        if code.__class__ is Code:
            code.run, code.keeps_choice_points = self._generate_code, False
        else:
            self.code = self._generator.called_predicate() or Code(self.name, self._generate_code)

    def _generate_function(self, *values: Term) -> Any:
        # Generated at the first call, because the predicates that the goal calls may be defined after it. A goal from
        # a client has no function: `Machine.attempt` calls functions without setting `Budget.goal`, from which
        # `PrologSystem.require_flags` learns that the goal comes from a client.
        self.function = None if self.is_from_client else self._generator.generate_function()
        return BAIL if self.function is None else self.function(*values)

    def precompile(self) -> None:
        """Generate the function before the first call, if all predicates that it calls are defined."""
        if self.function != self._generate_function or self.is_from_client:
            return
        try:
            self.function = self._generator.generate_function() or self._generate_function
        except (PrologError, RecursionError):
            # The first call raises the same error, with its caller as context.
            return

    def count_bail(self) -> None:
        """Count a call of the function that returned `BAIL`; after `_MAX_BAILS` of them discard the function."""
        self._bail_count += 1
        if self._bail_count > _MAX_BAILS:
            self.function = None

    def _generate_output_code(self, frame: Frame) -> Optional[Frame]:
        self._output_code.run, _ = self._generator.generate_frame_code(True)
        return self._output_code.run(frame)

    def _generate_code(self, frame: Frame) -> Optional[Frame]:
        run, keeps_choice_points = self._generator.generate_frame_code(False)
        code: Any = self.code  # a `Code`, because a `Predicate` has its own step
        code.run, code.keeps_choice_points = run, keeps_choice_points
        return self.code.run(frame)

    def make_frame(self, values: Values, collector: Frame) -> Frame:
        """Return the frame that runs the goal and passes its resolved outputs to a collector.

        For each solution the frame calls ``collector[0].collect(collector, outputs)``, which returns the next frame.
        """
        return (self._output_code, *values, collector)

    def first_solution(self, values: Values) -> Optional[Values]:
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
        # The budget names the running goal in errors about limits. The outer goal is restored when this one has
        # ended.
        outer_goal = budget.goal
        budget.goal = self
        try:
            if self.function is not None:
                result: Any = self._call_function(values)
                if result is not BAIL:
                    return result  # type: ignore[no-any-return]
                self.count_bail()
            return self._run(values)
        finally:
            budget.goal = outer_goal

    def _run(self, values: Values) -> Optional[Values]:
        machine = self._machine
        mark = len(machine.trail)
        if not self._outputs:
            frame = (self.code, *values, machine.done)
            # A step that pushes no choice point can be executed without the main loop of the machine.
            if self.code.keeps_choice_points:
                return () if machine.check(frame, self) else None
            succeeded = machine.run(frame)
            undo(machine.trail, mark)
            return () if succeeded else None
        solutions: List[Values] = []
        if not machine.run((self._output_code, *values, (_COLLECT_FIRST, solutions, machine.done))):
            return None
        undo(machine.trail, mark)
        return solutions[0]

    def _call_function(self, values: Values) -> Any:
        """Return the result of the function, with the errors and limits of a run on the machine."""
        machine = self._machine
        budget = machine.budget
        limited = budget.limited
        saved = budget.enter() if limited else None
        mark = len(machine.trail)
        try:
            return self.function(*values)
        except BaseException as exc:
            undo(machine.trail, mark)
            error = from_python(exc)
            if error is None or error is exc:
                raise
            raise error from exc
        finally:
            if limited:
                budget.leave(saved)

    def all_solutions(self, values: Values) -> List[Values]:
        """Return the resolved outputs of all solutions."""
        machine = self._machine
        mark = len(machine.trail)
        solutions: List[Values] = []
        machine.run((self._output_code, *values, (_COLLECT_ALL, solutions)))
        undo(machine.trail, mark)
        return solutions

    def __repr__(self) -> str:
        return f"<Goal {self.name}>"


class _FirstSolution:
    """Collector that stores the outputs and continues with the next frame."""

    def collect(self, frame: Frame, outputs: Values) -> Frame:
        frame[1].append(outputs)
        return frame[2]  # type: ignore[no-any-return]


class _AllSolutions:
    """Collector that stores the outputs and fails, so that the machine backtracks into the next solution."""

    def collect(self, frame: Frame, outputs: Values) -> None:
        frame[1].append(outputs)


_COLLECT_FIRST = _FirstSolution()
_COLLECT_ALL = _AllSolutions()
