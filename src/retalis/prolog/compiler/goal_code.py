"""Compilation of goals that Python calls, with inputs and outputs by position.

A goal is compiled in up to two forms. If it consists of inline goals and of predicates that can be functions, it
becomes one Python function from inputs to outputs (`GoalGenerator.generate_function`). Otherwise, or if the function
gives up at run time, it becomes code for a frame of the machine, whose last goal ``outputs`` passes the outputs to an
`OutputCollector`.
"""

from typing import TYPE_CHECKING, Any, Callable, Dict, List, Optional, Sequence, Tuple

from ...foundation.codegen import MAX_TERM_ARGUMENTS
from ...foundation.errors import Place
from ..machine.machine import Code, OutputCollector
from ..machine.resource_limits import LimitError
from ..terms.term_traversal import copy, is_larger, resolve, variables
from ..terms.types import Frame, Step, Term, Var, deref, functor
from .body_code import BodyGenerator
from .clause_nodes import BodyParser, CallNode, GoalNode, Height, PredicateResolver, needed_by
from .code_scope import ClauseVariables, Scope, Unit
from .function_code import body_cost, choose_functions, function_parser, give_up, goals_of
from .inline_goals import write_sequence
from .predicate_code import title_of

if TYPE_CHECKING:
    from ..database.predicate import Predicate

_OUTPUTS = functor("outputs", 0)


class OutputsNode(CallNode):
    """Goal node ``outputs`` at the end of a goal, which passes the outputs to the continuation."""

    __slots__ = ()


def _deliver_outputs(frame: Frame) -> Optional[Frame]:
    # Outputs are resolved: the bindings are undone before Python reads them.
    collector: Tuple[OutputCollector, ...] = frame[-1]
    return collector[0].collect(collector, tuple([resolve(value) for value in frame[1:-1]]))


OUTPUTS_CODE = Code("outputs", _deliver_outputs)


class GoalGenerator:
    """Generator of the code of one goal.

    Args:
        database: the predicates that it may call.
        term: the goal.
        inputs: variables that get values, by position.
        outputs: terms whose values are returned, by position.
        place: source position of the goal, or None.
        name: name of the code in tracebacks.
    """

    def __init__(
        self,
        database: PredicateResolver,
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
        if not isinstance(node, CallNode) or node.inline or tuple(map(deref, node.args)) != self._inputs:
            return None
        predicate = self._database.predicate(node.key)
        return None if predicate.is_library_predicate and predicate.is_protected else predicate

    def _scope(self, unit: Unit) -> Scope:
        # Inputs are counted twice: a variable that occurs once is void, and its value would be dropped.
        scope = Scope(unit, ClauseVariables((*self._inputs, self._term, *self._outputs, *self._inputs)))
        for position, var in enumerate(self._inputs):
            scope.names[var] = f"a{position}"
        return scope

    def _compile(self, unit: Unit) -> Callable[..., Any]:
        source = unit.source()
        function: Callable[..., Any] = unit.finish(source, title_of(self._place, self._name))["main"]
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
        calls_functions = any(goal.form == "direct" for goal in goals_of(nodes))
        if any(not node.inline for node in nodes) or (
            calls_functions and body_cost(self._database, nodes) is None
        ):
            return None
        choose_functions(nodes, True)
        # Without calls the function always decides; only with calls must it be repeatable.
        unit = Unit(self._database.machine, self._database, repeats=calls_functions)
        scope = self._scope(unit)
        scope.fail = scope.cut = _UNDO_AND_FAIL
        if calls_functions:
            unit.namespace.update(give_up=give_up, LimitError=LimitError)
            scope.give_up = _GIVE_UP
        write_sequence(scope, nodes, frozenset(variables((_OUTPUTS, *self._outputs))))
        values = [_resolved_output(scope, output) for output in self._outputs]
        result = f"({', '.join(values)}{',' if len(values) == 1 else ''})"
        lines = scope.lines
        if scope.binds:
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
        unit.add([f"def main({parameters}):", *lines, f"    return {result}"])
        return self._compile(unit)

    def generate_frame_code(self, delivers_outputs: bool) -> Tuple[Step, bool]:
        """Return the function of the goal's frame, and whether it keeps the choice points (see
        `Code.keeps_choice_points`).

        Args:
            delivers_outputs: whether the frame passes its outputs to a collector instead of returning to a frame.
        """
        if self._interprets:
            return self._make_interpreter(delivers_outputs), False
        unit = Unit(self._database.machine, self._database)
        scope = self._scope(unit)
        input_names = [scope.names[var] for var in self._inputs]
        nodes: Sequence[GoalNode] = self._nodes
        if delivers_outputs:
            nodes = [*nodes, OutputsNode("call", _OUTPUTS, self._outputs, False)]
        if self._entry in needed_by(nodes):
            scope.push("height = len(choices)")
            scope.names[self._entry] = "height"
        bodies = BodyGenerator(
            unit, scope.clause, self._entry, self._database.interpret, self._name, None, OUTPUTS_CODE
        )
        bodies.write(scope, nodes)
        unit.add(["def main(frame):", f"    {', '.join(['_', *input_names, 'after'])} = frame", *scope.lines])
        return self._compile(unit), not scope.pushes

    def _make_interpreter(self, delivers_outputs: bool) -> Step:
        """Return a function of the frame that interprets the goal."""
        call: Callable[[Term, Frame], Optional[Frame]] = self._database.machine.logic.control.call
        inputs, goal, outputs = self._inputs, self._term, self._outputs

        def run(frame: Frame) -> Optional[Frame]:
            values: Dict[Var, Term] = dict(zip(inputs, frame[1:-1]))
            body = copy(goal, values)
            if not delivers_outputs:
                return call(body, frame[-1])
            return call(body, (OUTPUTS_CODE, *copy((_OUTPUTS, *outputs), values)[1:], frame[-1]))

        return run


_UNDO_AND_FAIL = "return undo(trail, mark)"
_GIVE_UP = "return give_up(trail, mark)"


def _resolved_output(scope: Scope, output: Term) -> str:
    output = deref(output)
    if output.__class__ is not Var:
        return f"resolve({scope.build(output)})"
    operand = scope.numbers.get(output)
    if operand is not None and scope.names.get(output) == operand[0]:
        return operand[0]
    name = scope.local(output)
    return name if output in scope.fresh else f"resolve({name})"
