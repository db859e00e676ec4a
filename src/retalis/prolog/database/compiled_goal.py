"""Goals that Python code calls, compiled once with inputs and outputs by position.

A goal has up to three forms, each generated when it is first needed: a Python function from inputs to outputs, code
for a frame whose last goal ``outputs`` passes the outputs to an `OutputCollector`, and code for a frame without
outputs. A function is possible if the goal consists of inline goals and of predicates that can be functions; it is
tried first.
If it meets a case that it does not implement (see `FunctionCode`), it returns `BAIL` and the frame runs instead;
after `_MAX_BAILS` such attempts it is not tried again.
"""

from typing import TYPE_CHECKING, Any, Callable, Dict, List, Optional, Sequence, Tuple, Union

from ...foundation.codegen import MAX_TERM_ARGUMENTS
from ...foundation.source_places import Place
from ..compiler.body_code import BodyGenerator
from ..compiler.clause_nodes import BodyParser, CallNode, GoalNode, Height, needed_by
from ..compiler.code_scope import ClauseVariables, CompilationUnit, Scope
from ..compiler.inline_goals import write_sequence
from ..compiler.predicate_code import title_of
from ..compiler.semidet_functions import (
    BAIL,
    body_cost,
    calls_in,
    function_parser,
    give_up,
    mark_first_solution_calls,
)
from ..machine.errors import PrologError, from_python
from ..machine.machine import Code, OutputCollector
from ..machine.resource_limits import LimitError
from ..terms.term_traversal import copy, is_larger, resolve, variables
from ..terms.types import Frame, Step, Term, Values, Var, deref, functor
from ..terms.unification import undo
from .predicate_database import Database

if TYPE_CHECKING:
    from .predicate import Predicate

_MAX_BAILS = 20
"""Number of calls of the function that return `BAIL` after which the goal only runs on the machine."""

_CALL_WITH_OUTPUTS = Code("go on", lambda frame: frame[1](frame[2]))
"""Code of a frame that calls a function with the outputs of a goal to get the next frame."""

_OUTPUTS = functor("outputs", 0)
_UNDO_AND_FAIL = "return undo(trail, mark)"
_GIVE_UP = "return give_up(trail, mark)"


class OutputsNode(CallNode):
    """Goal node ``outputs`` at the end of a goal, which passes the outputs to the continuation."""

    __slots__ = ()


def _deliver_outputs(frame: Frame) -> Optional[Frame]:
    """Pass the outputs in a frame to the collector that follows it."""
    # Outputs are resolved: the bindings are undone before Python reads them.
    continuation: Frame = frame[-1]
    collect: OutputCollector = continuation[0]
    return collect(continuation, tuple([resolve(value) for value in frame[1:-1]]))


OUTPUTS_CODE = Code("outputs", _deliver_outputs)


class GoalGenerator:
    """Generator of the code of one goal.

    Args:
        database: the predicates that it may call.
        inputs: variables that get values, by position.
        outputs: terms whose values are returned, by position.
        place: source position of the goal, or None.
        name: name of the code in tracebacks.
    """

    def __init__(
        self,
        database: Database,
        term: Term,
        inputs: Tuple[Var, ...],
        outputs: Tuple[Term, ...],
        place: Optional[Place],
        name: str,
    ):
        self._database = database
        self._term = resolve(term)
        self._interprets = database.is_interpreter_only or is_larger(self._term, MAX_TERM_ARGUMENTS)
        self._inputs = inputs
        self._outputs = outputs
        self._place = place
        self._name = name
        self._nodes: List[GoalNode] = []
        self._entry = Height("height")

    def parse(self) -> None:
        """Parse the goal with the predicates that are currently defined.

        Raises:
            PrologError: a type error if the term is not a goal.
        """
        self._entry = Height("height")
        self._nodes = BodyParser(self._database, self._entry).parse(self._term)

    def called_predicate(self) -> "Optional[Predicate]":
        """Return the predicate if the goal is a single call of it with the inputs as arguments, else None.

        A predicate of the system is excluded, because the program may replace it later.
        """
        if len(self._nodes) != 1:
            return None
        node = self._nodes[0]
        if not isinstance(node, CallNode) or node.is_inline or tuple(map(deref, node.args)) != self._inputs:
            return None
        predicate = self._database.predicate(node.key)
        return None if predicate.is_library_predicate and predicate.is_protected else predicate

    def _scope(self, unit: CompilationUnit) -> Scope:
        # Inputs are counted twice: a variable that occurs once is void, and its value would be dropped.
        scope = Scope(unit, ClauseVariables((*self._inputs, self._term, *self._outputs, *self._inputs)))
        for position, var in enumerate(self._inputs):
            scope.names[var] = f"a{position}"
        return scope

    def _compile(self, unit: CompilationUnit) -> Callable[..., Any]:
        source = unit.complete_source()
        function: Callable[..., Any] = unit.define(source, title_of(self._place, self._name))["main"]
        return function

    def generate_function(self) -> Optional[Callable[..., Any]]:
        """Return the goal as a function of its inputs, or None if that is impossible.

        The function undoes its bindings, whether it succeeds or not. It returns `BAIL` if the goal has to run on the
        machine, including after an error, which the machine raises again with its context.
        """
        if self._interprets:
            return None
        entry = Height("height")
        nodes = function_parser(self._database, entry).parse(self._term)
        calls_functions = any(goal.form == "function" for goal in calls_in(nodes))
        if any(not node.is_inline for node in nodes) or (
            calls_functions and body_cost(self._database, nodes) is None
        ):
            return None
        mark_first_solution_calls(nodes, True)
        # Without calls the function always decides; only with calls must it be repeatable.
        unit = CompilationUnit(self._database.machine, self._database, is_repeatable=calls_functions)
        scope = self._scope(unit)
        scope.fail = scope.fail_after_cut = _UNDO_AND_FAIL
        if calls_functions:
            unit.namespace.update(give_up=give_up, LimitError=LimitError)
            scope.give_up = _GIVE_UP
        write_sequence(scope, nodes, frozenset(variables((_OUTPUTS, *self._outputs))))
        values = [_resolved_output(scope, output) for output in self._outputs]
        result = f"({', '.join(values)}{',' if len(values) == 1 else ''})"
        lines = scope.lines
        if scope.may_bind:
            lines = ["    mark = len(trail)", *lines, f"    result = {result}", "    undo(trail, mark)"]
            # A limit is exceeded only once: running the goal again would use the same time or memory a second time.
            # Any other exception is left to the machine, which adds the caller to it.
            if calls_functions:
                lines = [lines[0], "    try:", *["    " + line for line in lines[1:]]]
                lines += [
                    "    except LimitError:",
                    "        undo(trail, mark)",
                    "        raise",
                    "    except Exception:",
                    f"        {_GIVE_UP}",
                ]
            result = "result"
        else:
            # Without bindings there is no mark to undo to.
            lines = [line.replace(_UNDO_AND_FAIL, "return None") for line in lines]
        parameters = ", ".join(f"a{position}" for position in range(len(self._inputs)))
        unit.add_function([f"def main({parameters}):", *lines, f"    return {result}"])
        return self._compile(unit)

    def generate_frame_code(self, delivers_outputs: bool) -> Tuple[Step, bool]:
        """Return the function of the goal's frame, and whether it keeps the choice points (see
        `Code.keeps_choice_points`).

        Args:
            delivers_outputs: whether the frame passes its outputs to a collector instead of returning to a frame.
        """
        if self._interprets:
            return self._make_interpreter(delivers_outputs), False
        unit = CompilationUnit(self._database.machine, self._database)
        scope = self._scope(unit)
        input_names = [scope.names[var] for var in self._inputs]
        nodes: Sequence[GoalNode] = self._nodes
        if delivers_outputs:
            nodes = [*nodes, OutputsNode("call", _OUTPUTS, self._outputs, False)]
        if self._entry in needed_by(nodes):
            scope.write_choice("height = len(choices)")
            scope.names[self._entry] = "height"
        bodies = BodyGenerator(
            unit, scope.clause, self._entry, self._database.interpret, self._name, None, OUTPUTS_CODE
        )
        bodies.write(scope, nodes)
        unit.add_function(
            ["def main(frame):", f"    {', '.join(['_', *input_names, 'after'])} = frame", *scope.lines]
        )
        return self._compile(unit), not scope.uses_choices

    def _make_interpreter(self, delivers_outputs: bool) -> Step:
        """Return a function of the frame that interprets the goal."""
        call: Callable[[Term, Frame], Optional[Frame]] = self._database.control.call
        inputs, goal, outputs = self._inputs, self._term, self._outputs

        def run(frame: Frame) -> Optional[Frame]:
            values: Dict[Var, Term] = dict(zip(inputs, frame[1:-1]))
            body = copy(goal, values)
            if not delivers_outputs:
                return call(body, frame[-1])
            return call(body, (OUTPUTS_CODE, *copy((_OUTPUTS, *outputs), values)[1:], frame[-1]))

        return run


def _resolved_output(scope: Scope, output: Term) -> str:
    """Return an expression for an output without bound variables."""
    output = deref(output)
    if output.__class__ is not Var:
        return f"resolve({scope.build(output)})"
    operand = scope.numbers.get(output)
    name = scope.local(output)
    # A local that holds the number itself is no variable.
    if operand is not None and name == operand[0]:
        return name
    return name if output in scope.fresh else f"resolve({name})"


class CompiledGoal:
    """Goal compiled with inputs and outputs; created by `PrologSystem.compile_goal`.

    Args:
        database: the predicates that it may call.
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
        # a client has no function: `attempt` calls functions without setting `Budget.goal`, from which
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

    def _count_bail(self) -> None:
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

    def attempt(
        self,
        values: Values,
        then: Callable[[Values], Optional[Frame]],
        otherwise: Optional[Frame],
        on_error: Callable[[PrologError], None],
    ) -> Optional[Frame]:
        """Run the goal once as part of a run; return the next frame.

        The outputs of the first solution are resolved, its choice points and bindings are dropped, and the run
        continues with ``then(outputs)``. If there is no solution, or the goal throws, it continues with
        ``otherwise``.

        Args:
            values: values of the inputs, by position.
            then: returns the next frame for the outputs.
            otherwise: the next frame without a solution.
            on_error: called with an error of the goal.
        """
        machine = self._machine
        if self.function is not None and not machine.budget.needs_check:
            mark = len(machine.trail)
            try:
                outputs = self.function(*values)
            except Exception as exc:
                undo(machine.trail, mark)
                error = from_python(exc)
                if error is None:
                    raise
                on_error(error)
                return otherwise
            if outputs is not BAIL:
                # `then` is called by the loop, not here: it may make another attempt, which would recurse.
                return otherwise if outputs is None else (_CALL_WITH_OUTPUTS, then, outputs)
            self._count_bail()
        return machine.attempt_by_frames(self, (self._output_code, *values), then, otherwise, on_error)

    def first_solution(self, values: Values) -> Optional[Values]:
        """Run the goal for its first solution.

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
                self._count_bail()
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
        if not machine.run((self._output_code, *values, (_collect_first, solutions, machine.done))):
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
        machine.run((self._output_code, *values, (_collect_all, solutions)))
        undo(machine.trail, mark)
        return solutions

    def __repr__(self) -> str:
        return f"<Goal {self.name}>"


def _collect_first(frame: Frame, outputs: Values) -> Frame:
    """Store the outputs, and continue with the next frame."""
    frame[1].append(outputs)
    return frame[2]  # type: ignore[no-any-return]


def _collect_all(frame: Frame, outputs: Values) -> None:
    """Store the outputs and fail, so that the machine backtracks into the next solution."""
    frame[1].append(outputs)
