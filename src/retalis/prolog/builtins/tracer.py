"""Tracer: goals in the box model of Byrd.

`Tracer` interprets clauses and reports each port (call, exit, redo, fail, exception) that a goal passes.
"""

from contextlib import contextmanager
from typing import Callable, Dict, Iterator, Optional

from ..machine.machine import Code, Guard
from ..syntax.term_writer import write_term
from ..terms.term_traversal import copy
from ..terms.types import COLON, COMMA, Frame, Functor, Term, Values, Var, deref, functor, functor_of
from ..terms.unification import undo, unify
from .builtin_registry import ProgramMachine, control

_UNREPORTED_GOALS = frozenset(functor(name, 0) for name in ("true", "!", "fail", "false", "otherwise"))
"""Goals without ports in a trace."""

_CONTROL_CONSTRUCTS = frozenset(
    functor(name, arity)
    for name, arity in ((";", 2), ("|", 2), ("->", 2), ("*->", 2), ("\\+", 1), ("call", 1))
)
"""Constructs without ports in a trace; the goals in them have ports."""


class _TracedCall:
    """Traced call: its goal, its depth, and whether it has exited with choice points, so that it can be retried."""

    __slots__ = ("goal", "depth", "has_exited")

    def __init__(self, goal: Term, depth: int):
        self.goal = goal
        self.depth = depth
        self.has_exited = False


class Tracer:
    """Tracer that interprets goals and reports each port that they pass.

    Clauses of the program are interpreted while it is on. A predicate of the system is a single call, but the goals
    that it calls are traced.
    """

    def __init__(self, machine: ProgramMachine, write_line: Callable[[str], None]):
        self._logic = machine.logic
        self._write_line = write_line
        self._control = self._logic.control
        self._choices = machine.choices
        self._trail = machine.trail
        self._depth = 0
        self._guard_code = Guard("trace", self._on_unwind, self._on_failure)
        self._exit_code = Code("trace exit", self._on_exit)
        self._redo_code = Code("trace redo", self._on_redo)
        self._next_clause_code = Code("trace clause", self._next_clause)

    @contextmanager
    def on(self) -> Iterator[None]:
        """Return a context in which goals are traced."""
        self.start()
        try:
            yield
        finally:
            self.stop()

    def start(self) -> None:
        """Start tracing."""
        self._untraced_solve = self._control.start_tracing(self.solve)

    def stop(self) -> None:
        """Stop tracing."""
        self._control.stop_tracing(self.solve)

    def solve(self, goal: Term, height: int, continuation: Frame) -> Optional[Frame]:
        """Return the frame that runs a goal with reports of its ports; see `Control.solve`."""
        goal = deref(goal)
        while goal.__class__ is tuple and goal[0] is COMMA:
            continuation = (self._control.code, goal[2], height, continuation)
            goal = deref(goal[1])
        if goal.__class__ is tuple and goal[0] is COLON:
            return self.solve(self._logic.database.modules.resolve_qualified_goal(goal), height, continuation)
        key = functor_of(goal)
        if key is None or key in _UNREPORTED_GOALS or key in _CONTROL_CONSTRUCTS:
            return self._untraced_solve(goal, height, continuation)
        return self._call(goal, key, continuation)

    def _call(self, goal: Term, key: Functor, continuation: Frame) -> Optional[Frame]:
        self._depth += 1
        call = _TracedCall(goal, self._depth)
        self._report_port("Call", call)
        # The guard lies below the choice points of the call: backtracking reaches it when the call has failed, and an
        # exception unwinds it.
        base = len(self._choices)
        self._choices.append((self._guard_code, call, len(self._trail)))
        exit_frame = (self._exit_code, call, base, continuation)
        predicate = self._logic.lookup(key) or self._logic.database.predicate(key)
        if predicate.kind == "user" and not predicate.is_library_predicate:
            arguments = goal[1:] if goal.__class__ is tuple else ()
            clauses = list(predicate.active_clauses())
            return self._next_clause((self._next_clause_code, arguments, clauses, 0, exit_frame, call, None))
        return self._untraced_solve(goal, base + 1, exit_frame)

    def _next_clause(self, entry: Frame) -> Optional[Frame]:
        """Try the remaining clauses of a call."""
        _, arguments, clauses, start, exit_frame, call, _ = entry
        self._depth = call.depth
        trail = self._trail
        mark = len(trail)
        height = len(self._choices)
        for index in range(start, len(clauses)):
            clause = clauses[index]
            new_vars: Dict[Var, Term] = {}
            head = copy(clause.head, new_vars)
            head_args = head[1:] if head.__class__ is tuple else ()
            if all(unify(argument, head_arg, trail) for argument, head_arg in zip(arguments, head_args)):
                if index + 1 < len(clauses):
                    self._choices.append(
                        (self._next_clause_code, arguments, clauses, index + 1, exit_frame, call, mark)
                    )
                return self._control.solve(copy(clause.body, new_vars), height, exit_frame)
            undo(trail, mark)
        return None

    def _on_exit(self, frame: Frame) -> Frame:
        continuation: Frame
        _, call, base, continuation = frame
        self._report_port("Exit", call)
        self._depth = call.depth - 1
        if len(self._choices) == base + 1:
            self._choices.pop()
        else:
            # On top of the call's choice points: backtracking into the call passes its redo port first.
            call.has_exited = True
            self._choices.append((self._redo_code, call, len(self._trail)))
        return continuation

    def _on_redo(self, entry: Frame) -> None:
        call = entry[1]
        call.has_exited = False
        self._depth = call.depth
        self._report_port("Redo", call)

    def _on_failure(self, entry: Frame) -> None:
        self._report_port("Fail", entry[1])
        self._depth = entry[1].depth - 1

    def _on_unwind(self, entry: Frame) -> None:
        call = entry[1]
        if not call.has_exited:
            self._report_port("Exception", call)
        self._depth = call.depth - 1

    def _report_port(self, port: str, call: _TracedCall) -> None:
        text = write_term(
            call.goal, self._logic.operators, quoted=True, numbervars=True, spacing=True, priority=999
        )
        self._write_line(f"{port:>9}: ({call.depth}) {text}")


@control("trace/1")
def trace(machine: ProgramMachine, args: Values, continuation: Frame) -> Optional[Frame]:
    """Call a goal and write a line to the error output for each port that it passes."""
    logic = machine.logic
    tracer = Tracer(machine, lambda line: logic.error_output(f"{line}\n"))
    tracer.start()
    # Tracing must stop when the goal fails, exits or raises, and start again when it is retried: the guard and the
    # codes below do that at the corresponding points of the choice point stack.
    height = len(machine.choices)
    machine.choices.append((_TRACE_GUARD, tracer, len(machine.trail)))
    return tracer.solve(args[0], height + 1, (_EXIT_TRACE, machine, tracer, height, continuation))


def _exit_trace(frame: Frame) -> Frame:
    """Stop tracing when the traced goal exits; backtracking into it starts tracing again."""
    machine: ProgramMachine
    tracer: Tracer
    continuation: Frame
    _, machine, tracer, height, continuation = frame
    tracer.stop()
    if len(machine.choices) == height + 1:
        machine.choices.pop()
    else:
        machine.choices.append((_RESUME_TRACE, tracer, len(machine.trail)))
    return continuation


_TRACE_GUARD = Guard("trace", lambda entry: entry[1].stop())
_EXIT_TRACE = Code("trace", _exit_trace)
_RESUME_TRACE = Code("trace", lambda entry: entry[1].start())
