"""Tracing a goal by its ports: call, exit, redo, fail and exception."""

from contextlib import contextmanager
from typing import Callable, Dict, Iterator, Optional

from ..machine import Code, Frame, Guard
from ..syntax import write_term
from ..terms import COLON, COMMA, Atom, Functor, Term, Var, copy, deref, functor, undo, unify
from .predicates import Predicates

_SILENT = frozenset(functor(name, 0) for name in ("true", "!", "fail", "false", "otherwise"))
_CONTROL = frozenset(
    (
        functor(name, arity)
        for name, arity in ((";", 2), ("|", 2), ("->", 2), ("*->", 2), ("\\+", 1), ("call", 1))
    )
)


class _TracedCall:
    """One call: its goal, its depth, and whether it has exited with choices left."""

    __slots__ = ("goal", "depth", "exited")

    def __init__(self, goal: Term, depth: int):
        self.goal = goal
        self.depth = depth
        self.exited = False


class Tracer:
    """Runs goals from their terms and tells of each port that they pass.

    The program's own clauses are interpreted while it is on; predicates of the system are one call each,
    but the goals that they call are traced.

    Args:
        logic: whose goals.
        tell: called with a line for each port.
    """

    def __init__(self, logic: Predicates, tell: Callable[[str], None]):
        self._logic = logic
        self._tell = tell
        self._control = logic.control
        self._choices = logic.machine.choices
        self._trail = logic.machine.trail
        self._depth = 0
        self._guard = Guard("trace", self._unwound)
        self._guard.run = self._failed
        self._exit = Code("trace exit", self._exited)
        self._again = Code("trace redo", self._redone)
        self._next = Code("trace clause", self._next_clause)

    @contextmanager
    def on(self) -> Iterator[None]:
        """Trace the goals that are run meanwhile."""
        self.start()
        try:
            yield
        finally:
            self.stop()

    def start(self) -> None:
        """Trace what is run from now on."""
        control = self._control
        self._plain = control.solve
        control.solve = self._logic.database.solve = self.solve  # type: ignore[method-assign]

    def stop(self) -> None:
        """Trace no more."""
        control = self._control
        if control.solve == self.solve:
            del control.solve
            self._logic.database.solve = control.solve

    def solve(self, goal: Term, height: int, after: Frame) -> Optional[Frame]:
        """Do what `Control.solve` does, by ports."""
        goal = deref(goal)
        while goal.__class__ is tuple and goal[0] is COMMA:
            after = (self._control.code, goal[2], height, after)
            goal = deref(goal[1])
        if goal.__class__ is tuple and goal[0] is COLON:
            return self.solve(self._logic.database.modules.goal(goal), height, after)
        key = _key(goal)
        if key is None or key in _SILENT or key in _CONTROL:
            return self._plain(goal, height, after)
        return self._call(goal, key, after)

    def _call(self, goal: Term, key: Functor, after: Frame) -> Optional[Frame]:
        self._depth += 1
        call = _TracedCall(goal, self._depth)
        self._port("Call", call)
        here = len(self._choices)
        self._choices.append((self._guard, call, len(self._trail)))
        leave = (self._exit, call, here, after)
        predicate = self._logic.lookup(key) or self._logic.database.predicate(key)
        if predicate.kind == "user" and not predicate.library:
            arguments = goal[1:] if goal.__class__ is tuple else ()
            clauses = list(predicate.live())
            return self._next_clause((self._next, arguments, clauses, 0, leave, call, None))
        return self._plain(goal, here + 1, leave)

    def _next_clause(self, entry: Frame) -> Optional[Frame]:
        """Try the clauses of a call from one on."""
        _, arguments, clauses, at, leave, call, _ = entry
        self._depth = call.depth
        trail = self._trail
        mark = len(trail)
        height = len(self._choices)
        for number in range(at, len(clauses)):
            clause = clauses[number]
            fresh: Dict[Var, Term] = {}
            head = copy(clause.head, fresh)
            others = head[1:] if head.__class__ is tuple else ()
            if all(unify(one, other, trail) for one, other in zip(arguments, others)):
                if number + 1 < len(clauses):
                    rest = (self._next, arguments, clauses, number + 1, leave, call, mark)
                    self._choices.append(rest)
                return self._control.solve(copy(clause.body, fresh), height, leave)
            undo(trail, mark)
        return None

    def _exited(self, frame: Frame) -> Frame:
        after: Frame
        _, call, here, after = frame
        self._port("Exit", call)
        self._depth = call.depth - 1
        if len(self._choices) == here + 1:
            self._choices.pop()
        else:
            call.exited = True
            self._choices.append((self._again, call, len(self._trail)))
        return after

    def _redone(self, entry: Frame) -> None:
        call = entry[1]
        call.exited = False
        self._depth = call.depth
        self._port("Redo", call)

    def _failed(self, entry: Frame) -> None:
        self._port("Fail", entry[1])
        self._depth = entry[1].depth - 1

    def _unwound(self, entry: Frame) -> None:
        call = entry[1]
        if not call.exited:
            self._port("Exception", call)
        self._depth = call.depth - 1

    def _port(self, port: str, call: _TracedCall) -> None:
        text = write_term(
            call.goal, self._logic.operators, quoted=True, numbervars=True, spacing=True, priority=999
        )
        self._tell(f"{port:>9}: ({call.depth}) {text}")


def _key(goal: Term) -> Optional[Functor]:
    if goal.__class__ is tuple:
        key: Functor = goal[0]
        return key
    return goal.functor if goal.__class__ is Atom else None
