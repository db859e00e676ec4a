"""Compilation of clause bodies to functions that return continuation frames.

The machine runs frames ``(code, argument..., next)``, so a body is written in continuation-passing style. Inline
goals (unification, arithmetic, tests, deterministic built-ins) become Python statements. At the first call of a
predicate the function returns a frame for the call whose ``next`` runs the remaining goals. Up to `_MAX_FRAME_CALLS`
calls are nested in one frame expression; goals after them become a continuation, a function of its own whose frame
carries the live variables, as a WAM environment does. A disjunction or condition whose branches contain calls pushes
a choice point and joins its branches in a shared continuation. A last call of the predicate itself becomes another
iteration of a loop.
"""

from typing import FrozenSet, List, Optional, Sequence, Tuple

from ..machine.machine import Code
from ..terms.list_terms import conjunction
from ..terms.term_traversal import variables
from ..terms.types import Atom, Functor, Term, Var, deref, functor
from .clause_nodes import (
    ARG,
    KNOWN_ARG,
    CallNode,
    Cut,
    Disjunction,
    Fail,
    GoalNode,
    Height,
    IfThenElse,
    Interpret,
    Needed,
    needed_by,
)
from .code_scope import ClauseVariables, CompilationUnit, Operand, Scope
from .inline_goals import forget, join_goals, write_inline, write_test

_MAX_FRAME_CALLS = 12
"""Calls nested in one frame expression; goals after them run in a continuation."""

_MAX_FILTERED_ARGUMENTS = 4
"""Arguments of an event that its pushdown filter compares."""

_MAX_GROUND_TESTS = 16
"""Variables of an event that are tested for groundness; a term with more counts as not ground."""

_OUTPUTS = functor("outputs", 0)
_NONE_NEEDED: FrozenSet[Needed] = frozenset()
_NO_OPERAND: Operand = ("", "")


class BodyGenerator:
    """Generator of the body of one clause: statements of the entry function, and continuations.

    Args:
        unit: receives the generated functions.
        entry: height of the choice point stack at entry, the target of the clause's cuts.
        interpret: the code that runs a body from its term.
        title: name of the continuations in tracebacks.
        key: functor of the clause, for errors.
        outputs: code that receives the arguments of the goal ``outputs``, which ends a compiled goal.
    """

    def __init__(
        self,
        unit: CompilationUnit,
        clause: ClauseVariables,
        entry: Height,
        interpret: object,
        title: str,
        key: Optional[Functor],
        outputs: Optional[Code] = None,
    ):
        self.unit = unit
        self.clause = clause
        self.entry = entry
        self.interpret = interpret
        self.title = title
        self.key = key
        self.outputs = outputs

    def write(self, scope: Scope, nodes: Sequence[GoalNode]) -> None:
        """Write goals up to the end of the function; the last statement returns the next frame."""
        nodes = join_goals(self.unit.database, self.clause.counts, nodes)
        position = 0
        while position < len(nodes):
            node: GoalNode = nodes[position]
            if not node.is_inline:
                if not self._is_deterministic_arg(scope, nodes, position):
                    break
                node = self._write_arg_test(scope, nodes[position:])
            scope.needed_later = needed_by(nodes[position + 1 :])
            write_inline(scope, node)
            # Goals after a failure are unreachable; code for them would only be dead text after a return.
            if isinstance(nodes[position], Fail):
                return
            position += 1
        remaining_nodes = nodes[position:]
        if not remaining_nodes:
            self._write_pending_statements(scope)
            scope.write(f"return {scope.continuation}")
        elif isinstance(remaining_nodes[0], (CallNode, Interpret)):
            self._write_calls(scope, remaining_nodes)
        elif isinstance(remaining_nodes[0], Disjunction):
            self._write_disjunction(scope, remaining_nodes[0], remaining_nodes[1:])
        elif isinstance(remaining_nodes[0], IfThenElse):
            self._write_condition(scope, remaining_nodes[0], remaining_nodes[1:])
        else:
            raise AssertionError(remaining_nodes[0])

    def _is_deterministic_arg(self, scope: Scope, nodes: Sequence[GoalNode], position: int) -> bool:
        """Return whether a goal is ``arg/3`` with an argument number that is most likely bound.

        If it is, ``arg/3`` is deterministic and can be written inline.
        """
        node = nodes[position]
        database = self.unit.database
        if not isinstance(node, CallNode) or node.key is not ARG or database.is_library:
            return False
        if not database.predicate(ARG).is_library_predicate:
            return False  # redefined by the program
        number = deref(node.args[0])
        is_bound = number.__class__ is Var and number in scope.names and number not in scope.fresh
        return is_bound and all(_is_callable(remaining.source) for remaining in nodes[position:])

    def _write_arg_test(self, scope: Scope, nodes: Sequence[GoalNode]) -> CallNode:
        """Write the test whether the number of ``arg/3`` is unbound; if so, the remaining goals are interpreted.

        Returns:
            The inline goal for a bound number.
        """
        goal = nodes[0]
        assert isinstance(goal, CallNode)
        var = deref(goal.args[0])
        assert var.__class__ is Var
        number = scope.names[var]
        inline_goal = CallNode("builtin", KNOWN_ARG, goal.args, True)
        if scope.numbers.get(var, _NO_OPERAND)[0] == number:
            return inline_goal
        scope.dereference(number)
        scope.write("if k is Var:")
        # The rare case enumerates arguments by backtracking. Interpreting the rest keeps one copy of its code: a
        # second compiled copy would double the function with each arg/3 of the clause.
        saved_scope = scope.snapshot()
        scope.depth += 1
        height = scope.names.get(self.entry)
        if height is None:
            height = scope.temp("h")
            scope.write_choice(f"{height} = len(choices)")
        remaining_body = scope.build(conjunction(node.source for node in nodes if node.source is not None))
        self._write_pending_statements(scope)
        scope.write(
            f"return ({scope.unit.constant(self.interpret)}, {remaining_body}, {height}, {scope.continuation})"
        )
        scope.depth -= 1
        scope.restore(saved_scope)
        return inline_goal

    # Leaving the function

    def _write_pending_statements(self, scope: Scope, needed: FrozenSet[Needed] = _NONE_NEEDED) -> None:
        """Write the statements that must precede returning a frame or pushing a choice point."""
        # The height is read before the choice point of the other clauses is pushed: a cut removes that one, too.
        if self.entry in needed and self.entry not in scope.names:
            self._write_height(scope)
        if scope.pending_choice is not None:
            scope.write_choice(scope.pending_choice)
            scope.pending_choice = None
            scope.fail = "return None"

    def _write_calls(self, scope: Scope, nodes: Sequence[GoalNode]) -> None:
        """Write the return of a frame for the leading calls, with a continuation for the goals after them."""
        count = 0
        while count < min(len(nodes), _MAX_FRAME_CALLS) and isinstance(nodes[count], (CallNode, Interpret)):
            if nodes[count].is_inline:
                break
            count += 1
        calls, remaining_nodes = nodes[:count], nodes[count:]
        self._write_pending_statements(scope, needed_by(remaining_nodes) | needed_by(calls))
        if count == 1 and not remaining_nodes and self._write_iteration(scope, calls[0]):
            return
        # Variables are created in statements before the frame expression: two calls that share a variable must get
        # the same object.
        for call in calls:
            for var in sorted(call.needed, key=self.clause.number):
                if isinstance(var, Var) and var not in scope.names and not self.clause.is_void(var):
                    scope.create(var)
        frame = (
            self._continuation_frame(scope, remaining_nodes, scope.continuation)
            if remaining_nodes
            else scope.continuation
        )
        if self._is_called_inline(calls[0]):
            self._write_inline_call(scope, calls, frame, not remaining_nodes)
            return
        # Frames nest from the last call outwards, because each one holds its successor.
        for call in reversed(calls):
            frame = self._frame_expression(scope, call, frame)
        first = calls[0]
        if isinstance(first, CallNode) and first.key is scope.direct_last_call:
            frame = f"{self.unit.predicate(first.key)}.run({frame})"
        scope.write(f"return {frame}")

    def _is_called_inline(self, call: GoalNode) -> bool:
        """Return whether a call is of a control predicate that most often finishes within the call."""
        return (
            isinstance(call, CallNode) and call.key is not _OUTPUTS and self.unit.is_called_inline(call.key)
        )

    def _write_inline_call(self, scope: Scope, calls: Sequence[GoalNode], frame: str, is_last: bool) -> None:
        """Write the first call inline; if it returns its continuation unchanged, no frame is run for it.

        A control predicate returns another frame only if it has left work to the machine.
        """
        first, remaining = calls[0], calls[1:]
        assert isinstance(first, CallNode)
        for later_call in reversed(remaining):
            frame = self._frame_expression(scope, later_call, frame)
        depth = scope.depth
        condition = self._filter_condition(scope, first)
        if condition is not None:
            scope.write(f"if {condition}:")
            scope.depth += 1
        args = "".join(f"{scope.build(arg)}, " for arg in first.args)
        call_prefix = f"{self.unit.builtin(first.key)}(M, ({args}), "
        ground_argument = "" if condition is None else f", {self._ground_condition(scope, first.args[0])}"
        if remaining:
            then, result = scope.temp("then"), scope.temp("r")
            scope.write(f"{then} = {frame}")
            scope.write(f"{result} = {call_prefix}{then}{ground_argument})")
            scope.write(f"if {result} is not {then}:")
            scope.write(f"    return {result}")
        else:
            scope.write(f"return {call_prefix}{frame}{ground_argument})")
        scope.depth = depth
        # A recursive last call becomes an iteration; otherwise the frame of the remaining calls is returned.
        wrote_iteration = is_last and len(remaining) == 1 and self._write_iteration(scope, remaining[0])
        if not wrote_iteration and (remaining or condition is not None):
            scope.write(f"return {frame}")

    def _filter_condition(self, scope: Scope, call: CallNode) -> Optional[str]:
        """Return the condition under which a call can have an effect; None if every call may.

        This is predicate pushdown: for an event that no listener accepts, the event term is not even built.
        """
        if not call.args:
            return None
        term = deref(call.args[0])
        positions: List[int] = []
        known_values: List[str] = []
        if term.__class__ is tuple:
            key: Functor = term[0]
            for position, arg in enumerate(term[1:], 1):
                arg = deref(arg)
                # A fresh variable has no value to compare, and a compound argument would have to be built first.
                is_known = arg.__class__ is Var and arg in scope.names and arg not in scope.fresh
                if arg.__class__ is Atom or is_known:
                    positions.append(position)
                    known_values.append(scope.build(arg))
        elif term.__class__ is Atom:
            key = term.functor
        else:
            return None
        passes = self.unit.pushdown_filter(call.key, key, tuple(positions[:_MAX_FILTERED_ARGUMENTS]))
        if passes is None:
            return None
        values = [*[scope.build(arg) for arg in call.args[1:]], *known_values[:_MAX_FILTERED_ARGUMENTS]]
        return f"{passes}({', '.join(values)})"

    @staticmethod
    def _ground_condition(scope: Scope, term: Term) -> str:
        """Return a condition that is true only if a term has no unbound variables."""
        term_variables = variables(term)
        names = [scope.names.get(var) for var in term_variables]
        if (
            len(names) > _MAX_GROUND_TESTS
            or None in names
            or any(var in scope.fresh for var in term_variables)
        ):
            return "False"
        return " and ".join(f"{name}.__class__ in ATOMIC" for name in names) or "True"

    def _frame_expression(self, scope: Scope, call: GoalNode, continuation: str) -> str:
        if isinstance(call, Interpret):
            term = scope.build(call.term)
            return (
                f"({scope.unit.constant(self.interpret)}, {term}, {scope.names[call.height]}, {continuation})"
            )
        assert isinstance(call, CallNode)
        if self.outputs is not None and call.key is _OUTPUTS:
            code = self.unit.constant(self.outputs)
        else:
            code = self.unit.predicate(call.key)
        frame_items = [code, *[scope.build(arg) for arg in call.args], continuation]
        return f"({', '.join(frame_items)})"

    def _write_iteration(self, scope: Scope, call: GoalNode) -> bool:
        """Write a last call of the predicate itself as another iteration of the loop around it.

        Returns:
            Whether the call was written; False if it is no such call.
        """
        if scope.loop is None or not isinstance(call, CallNode) or scope.continuation != "after":
            return False
        key, arguments, next_iteration, base_case = scope.loop
        if call.key is not key:
            return False
        values = [scope.build(arg) for arg in call.args]
        # Another iteration with the base case's constant would only succeed: return at once.
        if base_case is not None:
            base_position, base_constant = base_case
            scope.write(f"if {values[base_position]} is {base_constant}:")
            scope.write(f"    return {scope.continuation}")
        changed = [(argument, value) for argument, value in zip(arguments, values) if argument != value]
        # One tuple assignment, because a new argument may be computed from the old value of another one.
        if changed:
            targets, sources = zip(*changed)
            scope.write(f"{', '.join(targets)} = {', '.join(sources)}")
        if next_iteration or not changed:
            scope.write(next_iteration or "pass")
        scope.has_iteration = True
        return True

    # Continuations

    def _live_variables(self, scope: Scope, needed: FrozenSet[Needed]) -> List[Needed]:
        """Return those of the needed variables and heights that have a value, in order of first use."""
        return sorted((var for var in needed if var in scope.names), key=self.clause.number)

    def _continuation_frame(
        self, scope: Scope, nodes: Sequence[GoalNode], continuation: str, is_choice_point: bool = False
    ) -> str:
        """Return an expression for the frame that runs ``nodes``; their function is written by a job of the unit.

        Args:
            scope: the function that builds the frame.
            nodes: the goals that the frame runs.
            continuation: expression for the frame that follows them.
            is_choice_point: whether the frame is a choice point, which ends with the length of the trail.
        """
        live = self._live_variables(scope, needed_by(nodes))
        code, function = self._new_code()
        self._add_continuation_job(function, live, nodes, is_choice_point)
        frame_items = [code, *[scope.names[var] for var in live], continuation]
        if is_choice_point:
            frame_items.append("len(trail)")
        # The frame holds these variables now, so code that runs later may bind them.
        scope.fresh.difference_update(live)
        return f"({', '.join(frame_items)})"

    def _new_code(self) -> Tuple[str, str]:
        """Return the name of the constant for a new code object, and the name of the function that it runs."""
        function = self.unit.unique_name("then_")
        code = self.unit.make_code(self.title, function)
        code.functor = self.key
        return self.unit.constant(code), function

    def _add_continuation_job(
        self, function: str, live: List[Needed], nodes: Sequence[GoalNode], is_choice_point: bool
    ) -> None:
        def write() -> None:
            scope = Scope(self.unit, self.clause)
            scope.is_entry = False
            scope.names = {var: self.clause.local(var) for var in live}
            # Only live names are unpacked: the frame of goals without a cut carries no height.
            parts = ["_", *scope.names.values(), "after", *(["_"] if is_choice_point else [])]
            scope.write(f"{', '.join(parts)} = frame")
            self.write(scope, nodes)
            self.unit.add_function([f"def {function}(frame):", *scope.lines])

        # Deferred: writing continuations within continuations would recurse as deep as the body is long.
        self.unit.jobs.append(write)

    def _create_shared(self, scope: Scope, groups: Sequence[Sequence[GoalNode]]) -> None:
        """Create the variables that several parts of a control construct need.

        Branches and continuation run in different functions and must refer to the same variable.
        """
        needed_so_far: FrozenSet[Needed] = _NONE_NEEDED
        shared: FrozenSet[Needed] = _NONE_NEEDED
        for group in groups:
            needed = needed_by(group)
            shared |= needed_so_far & needed
            needed_so_far |= needed
        for var in sorted(shared, key=self.clause.number):
            if isinstance(var, Var) and var not in scope.names:
                scope.create(var)
                scope.fresh.discard(var)

    def _write_joined_frame(self, scope: Scope, remaining_nodes: Sequence[GoalNode]) -> None:
        """Write the frame of the goals after a control construct, which all of its branches continue with."""
        if remaining_nodes:
            frame = self._continuation_frame(scope, remaining_nodes, scope.continuation)
            scope.continuation = scope.temp("after")
            scope.write(f"{scope.continuation} = {frame}")

    def _push_alternative(self, scope: Scope, nodes: Sequence[GoalNode]) -> None:
        """Write a statement that pushes a choice point which runs ``nodes``."""
        if nodes:
            # The choice point is needed even if it only fails: heights count it, and a cut removes it.
            if isinstance(nodes[0], Fail):
                scope.write_choice("choose((DEAD, len(trail)))")
            else:
                scope.write_choice(
                    f"choose({self._continuation_frame(scope, nodes, scope.continuation, True)})"
                )
        else:
            scope.write_choice(f"choose((RESUME, {scope.continuation}, len(trail)))")

    # Control

    def _write_disjunction(
        self, scope: Scope, node: Disjunction, remaining_nodes: Sequence[GoalNode]
    ) -> None:
        self._create_shared(scope, [*node.branches, remaining_nodes])
        self._write_pending_statements(scope, needed_by([node, *remaining_nodes]))
        self._write_joined_frame(scope, remaining_nodes)
        first, *others = node.branches
        # The stack is last in, first out: the second branch must be on top.
        for branch in reversed(others):
            self._push_alternative(scope, branch)
        scope.fail = "return None"
        self.write(scope, first)

    def _write_condition(self, scope: Scope, node: IfThenElse, remaining_nodes: Sequence[GoalNode]) -> None:
        self._create_shared(scope, [[*node.test, *node.then], node.otherwise, remaining_nodes])
        if all(goal.is_inline for goal in node.test) and node.test_height is None and not node.is_soft:
            self._write_if(scope, node, remaining_nodes)
            return
        self._write_pending_statements(scope, needed_by([node, *remaining_nodes]))
        self._write_joined_frame(scope, remaining_nodes)
        # The height is taken below the choice point of the else branch, so that the cut after the test removes both
        # that one and the choice points of the test.
        # Continuations carry the height under its name, so the name must be unique in the clause, not only in the
        # function.
        height = Height("")
        height.name = f"g{self.clause.number(height)}"
        scope.write_choice(f"{height.name} = len(choices)")
        scope.names[height] = height.name
        self._push_alternative(scope, node.otherwise)
        if node.test_height is not None:
            scope.write_choice(f"{node.test_height.name} = len(choices)")
            scope.names[node.test_height] = node.test_height.name
        scope.fail = "return None"
        self.write(scope, [*node.test, Cut(height, node.is_soft), *node.then])

    def _write_if(self, scope: Scope, node: IfThenElse, remaining_nodes: Sequence[GoalNode]) -> None:
        """Write a condition with an inline test and calls in its branches as a Python ``if``."""
        scope.needed_later = needed_by([*node.then, *remaining_nodes])
        if remaining_nodes:
            # Both branches use the joined frame, so what it needs is written before the test.
            self._ensure_height(scope, remaining_nodes)
            self._write_joined_frame(scope, remaining_nodes)
        unset = write_test(scope, node.test)
        saved_scope = scope.snapshot()
        scope.depth += 1
        self.write(scope, node.then)
        scope.depth -= 1
        scope.restore(saved_scope)
        forget(scope, unset)
        scope.write("else:")
        scope.depth += 1
        self.write(scope, node.otherwise)
        scope.depth -= 1

    def _ensure_height(self, scope: Scope, nodes: Sequence[GoalNode]) -> None:
        if self.entry in needed_by(nodes) and self.entry not in scope.names:
            self._write_height(scope)

    def _write_height(self, scope: Scope) -> None:
        """Write the assignment of the height at entry."""
        scope.write_choice(f"{self.entry.name} = len(choices)")
        scope.names[self.entry] = self.entry.name


def _is_callable(term: Optional[Term]) -> bool:
    """Return whether a goal can be interpreted from its term; goals that the compiler adds have none."""
    if term is None:
        return False
    goal = deref(term)
    return goal.__class__ is tuple or goal.__class__ is Atom
