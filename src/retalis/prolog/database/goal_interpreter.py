"""Interpretation of goals on the machine: control constructs, ``call/N``, exceptions, and solution collection.

`Control.solve` turns a goal term into the frame that runs it. A conjunction becomes a chain of frames, a disjunction
pushes a choice point, and a cut shortens the choice point stack to the height at which its clause was entered.
``catch/3`` pushes a choice point of its own kind; while the goal runs, the machine searches the stack for it after an
exception.

Rarely called bodies are interpreted, but a body that is called once may run its goals a million times by
backtracking. `JustInTimeBodies` finds those by sampling: the machine reports the goal that it is about to interpret
once per slice of steps (`Machine.on_interpreted_goal`). A body that is reported twice is compiled, with its variables
as arguments, and the compiled code runs from then on.
"""

from typing import Any, Callable, Dict, List, NamedTuple, Optional, Set, Tuple

from ...foundation.cancellation import STEPS_PER_ROUND, check_limits
from ...foundation.errors import TermTooLarge
from ..compiler.clause_nodes import ARROW, BAR, CALL, IGNORE, NOT, ONCE, SEMICOLON, SOFT_ARROW
from ..compiler.predicate_code import ClauseParts, PredicateGenerator
from ..machine.errors import PrologError, instantiation_error, type_error
from ..machine.machine import DEAD, RESUME, CatchMark, Code, Machine
from ..terms.list_terms import list_parts, make_list
from ..terms.term_traversal import CYCLE_CHECK_ROUND, WALK_ROUNDS, copy, is_ground, require_acyclic
from ..terms.types import (
    COMMA,
    FALSE,
    NIL,
    TRUE,
    Atom,
    CompoundTerm,
    Frame,
    Functor,
    Lazy,
    Step,
    Term,
    Values,
    Var,
    deref,
    functor,
)
from .module_system import Modules
from .predicate_table import Database

_MAX_BODY_PARTS = 400
"""Size limit of bodies that are compiled; larger ones most likely contain data that was passed to them."""

_MAX_BODIES = 16
"""Bodies that are observed at a time; the oldest one is dropped."""

BODY_CONSTRUCTS = {COMMA, SEMICOLON, BAR, ARROW, SOFT_ARROW, NOT}
"""Control constructs whose arguments are goals of the body in which they stand."""


class CompiledBody(NamedTuple):
    """A body that is compiled while it runs.

    Attributes:
        run: the compiled code, a step of a frame with the values of the variables.
        variables: the variables of the body.
        body: the body itself, which keeps its ``id`` in use.
    """

    run: Step
    variables: Tuple[Var, ...]
    body: Term


class JustInTimeBodies:
    """Just-in-time compiler of interpreted bodies, by the identity of their terms.

    Attributes:
        compiled: the compiled bodies by the ``id`` of the body.
    """

    def __init__(self, database: Database):
        self._database = database
        self.compiled: Dict[int, CompiledBody] = {}
        self._reported: Dict[int, Term] = {}
        self._refused: Set[int] = set()

    def __len__(self) -> int:
        """Return the number of stored bodies."""
        return len(self._reported) + len(self.compiled)

    def clear(self) -> None:
        """Drop all bodies, at the end of a goal or after a redefinition of a predicate."""
        self.compiled.clear()
        self._reported.clear()
        self._refused.clear()

    def record_interpreted(self, body: Term) -> None:
        """Record that a body is about to be interpreted, and compile it if that was recorded before."""
        if body.__class__ is not tuple or self._database.is_interpreter_only:
            return
        if body[0] not in BODY_CONSTRUCTS and not self._database.is_inline(body[0]):
            return
        # An id may be reused by another term, so the identity is compared as well.
        if self._reported.get(id(body)) is not body:
            if len(self._reported) >= _MAX_BODIES:
                self._drop(next(iter(self._reported)))
            self._reported[id(body)] = body
        elif id(body) not in self.compiled and id(body) not in self._refused:
            entry = None if _has_bound_goal(body) else self._compile(body)
            if entry is None:
                self._refused.add(id(body))
            else:
                self.compiled[id(body)] = entry

    def _drop(self, body_id: int) -> None:
        del self._reported[body_id]
        self.compiled.pop(body_id, None)
        self._refused.discard(body_id)

    def _compile(self, body: Term) -> Optional[CompiledBody]:
        """Return the compiled body; None if it is too large or its compilation raises an error."""
        copies: Dict[Var, Term] = {}
        try:
            source = _BodyCopier(copies).copy(body)
            if source is None:
                return None
            key = functor("$body", len(copies))
            clause = ClauseParts(tuple(copies.values()), source)
            step = PredicateGenerator(
                self._database, key, [clause], Code("body", _never_called)
            ).generate_clause(0)
        except (PrologError, RecursionError):
            # The interpreter raises the error when it reaches the goal, or never if it does not.
            return None
        return CompiledBody(step, tuple(copies), body)


def _never_called(frame: Frame) -> Optional[Frame]:
    raise AssertionError("a body does not call itself")


def _has_bound_goal(body: Term) -> bool:
    """Return whether a bound variable occurs as a goal of a body.

    A cut in its value cuts the body, which compiled code (``call/1`` of the variable) would not do.
    """
    stack = [body]
    while stack:
        goal = stack.pop()
        if goal.__class__ is Var and goal.ref is not None:
            return True
        if goal.__class__ is tuple and goal[0] in BODY_CONSTRUCTS:
            stack += goal[1:]
    return False


class _BodyCopier:
    """Copier of a body as it was written.

    Bound variables are copied as variables, because they may have other values the next time.
    """

    def __init__(self, names: Dict[Var, Term]):
        self._names = names
        self._parts_left = _MAX_BODY_PARTS

    def copy(self, term: Any) -> Optional[Term]:
        """Return the copy; None if the body is too large or contains a term that has not been decoded."""
        if term.__class__ is Var:
            return self._names.setdefault(term, Var())
        if term.__class__ is Lazy:
            return None
        if term.__class__ is not tuple:
            return term  # type: ignore[no-any-return]
        parts: List[Any] = [term[0]]
        self._parts_left -= len(term)
        if self._parts_left < 0:
            return None
        for part in term[1:]:
            copied = self.copy(part)
            if copied is None:
                return None
            parts.append(copied)
        return tuple(parts)


_CUT = functor("!", 0)
_FAIL = functor("fail", 0)
_COLON = functor(":", 2)
_NECK = functor(":-", 2)


ControlFunction = Callable[[Machine, Values, Frame], Optional[Frame]]
"""Control built-in: takes the machine, the arguments and the next frame; returns the frame to run."""


class Control:
    """Interpreter of goal terms on the machine of a database.

    Attributes:
        machine: the machine.
        code: code of frames ``(code, goal, height, next)`` that run a goal from its term.
        bodies: the bodies that are compiled while they run.
    """

    def __init__(self, database: Database):
        self._database = database
        self.machine = database.machine
        self._choices = database.machine.choices
        self._trail = database.machine.trail
        self.code = database.machine.goal_code = Code("goal", self._run)
        self._cut_code = Code("cut", self._run_cut)
        self._soft_cut_code = Code("soft cut", self._run_soft_cut)
        self._reject_code = Code("reject", self._run_rejection)
        self._exit_code = Code("catch exit", self._run_catch_exit)
        self._collect_code = Code("collect", self._run_collection)
        self._after_collection_code = Code("collected", lambda frame: frame[1](frame[2]), True)
        self._constructs: Dict[Functor, Callable[..., Optional[Frame]]] = {
            SEMICOLON: self._solve_disjunction,
            BAR: self._solve_disjunction,
            ARROW: self._solve_if_then,
            SOFT_ARROW: self._solve_soft_if_then,
            NOT: self._solve_negation,
            ONCE: self._solve_once,
            IGNORE: self._solve_ignore,
        }
        self.bodies = JustInTimeBodies(database)
        self._compiled = self.bodies.compiled
        database.machine.on_interpreted_goal = self.bodies.record_interpreted
        database.machine.budget.on_reset = database.on_code_discarded = self.bodies.clear
        database.interpret = self.code
        database.solve = self.solve

    def solve(  # noqa: C901 -- runs every interpreted goal; calls of helpers would slow it
        self, goal: Any, height: int, continuation: Frame
    ) -> Optional[Frame]:
        """Return the frame that runs a goal and then ``continuation``; None if the goal fails at once.

        Args:
            goal: the goal.
            height: height of the choice point stack that cuts in the goal restore.
            continuation: the next frame.
        """
        while True:
            goal_class = goal.__class__
            if goal_class is Var or goal_class is Lazy:
                goal = deref(goal)
                goal_class = goal.__class__
            if goal_class is tuple:
                key = goal[0]
                # The first goal continues in this loop; only the second one needs a frame.
                if key is COMMA:
                    continuation = (self.code, goal[2], height, continuation)
                    goal = goal[1]
                    continue
                construct = self._constructs.get(key)
                if construct is not None:
                    return construct(goal, height, continuation)
                if key is _COLON:
                    goal = self._database.modules.resolve_qualified_goal(goal)
                    continue
                return (self._database.predicate(key), *goal[1:], continuation)
            if goal_class is Atom:
                if goal is TRUE:
                    return continuation
                key = goal.functor
                if key is _CUT:
                    del self._choices[height:]
                    return continuation
                if key is _FAIL or goal is FALSE:
                    return None
                return (self._database.predicate(key), continuation)
            if goal_class is Var:
                raise instantiation_error()
            raise type_error("callable", goal)

    def call(self, goal: Term, continuation: Frame) -> Optional[Frame]:
        """Return the frame of ``call/1``, in which cuts are local to the goal."""
        if goal.__class__ is not tuple:
            goal = deref(goal)
        if goal.__class__ is tuple and goal[0] in BODY_CONSTRUCTS:
            goal = check_body(goal)
        return self.solve(goal, len(self._choices), continuation)

    def once(self, goal: Term, continuation: Frame) -> Optional[Frame]:
        """Return the frame that runs a goal for its first solution."""
        height = len(self._choices)
        return self.call(goal, (self._cut_code, height, continuation))

    def _run(self, frame: Frame) -> Optional[Frame]:
        # Most programs have no such body: the test of the empty dictionary is all that they pay.
        if self._compiled:
            compiled = self._compiled.get(id(frame[1]))
            if compiled is not None:
                # The code has a frame of a clause: its last item is the height that cuts restore.
                return compiled.run((None, *compiled.variables, frame[3], frame[2]))
        return self.solve(frame[1], frame[2], frame[3])

    def _run_cut(self, frame: Frame) -> Frame:
        del self._choices[frame[1] :]
        return frame[2]  # type: ignore[no-any-return]

    # Control constructs

    def _solve_disjunction(self, goal: CompoundTerm, height: int, continuation: Frame) -> Optional[Frame]:
        first = deref(goal[1])
        if first.__class__ is tuple and first[0] is ARROW:
            return self._solve_condition(first[1], first[2], goal[2], height, continuation)
        if first.__class__ is tuple and first[0] is SOFT_ARROW:
            base = len(self._choices)
            self._choices.append((self.code, goal[2], height, continuation, len(self._trail)))
            # The first solution of the test disables the else branch; the choice points of the test stay.
            then = (self._soft_cut_code, base, (self.code, first[2], height, continuation))
            return self.solve(first[1], base + 1, then)
        self._choices.append((self.code, goal[2], height, continuation, len(self._trail)))
        return self.solve(first, height, continuation)

    def _solve_condition(
        self, test: Term, then: Term, otherwise: Term, height: int, continuation: Frame
    ) -> Optional[Frame]:
        base = len(self._choices)
        self._choices.append((self.code, otherwise, height, continuation, len(self._trail)))
        return self.solve(test, base + 1, (self._cut_code, base, (self.code, then, height, continuation)))

    def _solve_if_then(self, goal: CompoundTerm, height: int, continuation: Frame) -> Optional[Frame]:
        # Without an else branch no choice point is needed: if the test fails, the goal fails.
        base = len(self._choices)
        return self.solve(goal[1], base, (self._cut_code, base, (self.code, goal[2], height, continuation)))

    def _solve_soft_if_then(self, goal: CompoundTerm, height: int, continuation: Frame) -> Optional[Frame]:
        return self.solve(goal[1], len(self._choices), (self.code, goal[2], height, continuation))

    def _run_soft_cut(self, frame: Frame) -> Frame:
        # The choice point of the else branch is replaced by one that fails, because entries above it cannot move.
        base = frame[1]
        self._choices[base] = (DEAD, self._choices[base][-1])
        return frame[2]  # type: ignore[no-any-return]

    def _solve_negation(self, goal: CompoundTerm, height: int, continuation: Frame) -> Optional[Frame]:
        # If the goal fails, its failure resumes the continuation. If it succeeds, the rejection removes that choice
        # point.
        base = len(self._choices)
        self._choices.append((RESUME, continuation, len(self._trail)))
        return self.solve(goal[1], base + 1, (self._reject_code, base, continuation))

    def _run_rejection(self, frame: Frame) -> None:
        del self._choices[frame[1] :]

    def _solve_once(self, goal: CompoundTerm, height: int, continuation: Frame) -> Optional[Frame]:
        return self.once(goal[1], continuation)

    def _solve_ignore(self, goal: CompoundTerm, height: int, continuation: Frame) -> Optional[Frame]:
        predicate = self._database.predicate(IGNORE)
        if not predicate.is_library_predicate:
            return (predicate, goal[1], continuation)
        base = len(self._choices)
        self._choices.append((RESUME, continuation, len(self._trail)))
        return self.call(goal[1], (self._cut_code, base, continuation))

    # Exceptions

    def catch(self, goal: Term, catcher: Term, recovery: Term, continuation: Frame) -> Optional[Frame]:
        """Return the frame of ``catch/3``."""
        mark = CatchMark()
        base = len(self._choices)
        recover = (self._database.predicate(CALL), recovery, continuation)
        self._choices.append((self.machine.catch_code, mark, catcher, recover, len(self._trail)))
        return (self._database.predicate(CALL), goal, (self._exit_code, mark, base, continuation))

    def _run_catch_exit(self, frame: Frame) -> Frame:
        continuation: Frame
        _, mark, base, continuation = frame
        if len(self._choices) == base + 1:
            self._choices.pop()  # the goal left no choice points
        else:
            # The goal may be retried, so its entry must stay but be inactive outside. The mark is on the trail:
            # backtracking into the goal resets it, which activates the catch again.
            mark.ref = True
            self._trail.append(mark)
        return continuation

    # Collecting solutions

    def collect(
        self, goal: Term, template: Term, then: Callable[[List[Term]], Optional[Frame]]
    ) -> Optional[Frame]:
        """Return the frame that runs a goal for all solutions and continues with ``then(copies)``.

        Args:
            goal: the goal.
            template: the term that is copied for each solution.
            then: takes the copies, in order of the solutions, after all bindings are undone; returns the next frame.
        """
        # The choice point runs after the last solution, when backtracking has undone all bindings.
        copies: List[Term] = []
        self._choices.append((self._after_collection_code, then, copies, len(self._trail)))
        return self.call(goal, (self._collect_code, copies, template, (RESUME, None)))

    @staticmethod
    def _run_collection(frame: Frame) -> None:
        frame[1].append(copy(frame[2]))

    def forall(self, condition: Term, action: Term, continuation: Frame) -> Optional[Frame]:
        """Return the frame of ``forall/2``."""
        goal = (NOT, (COMMA, (CALL, condition), (NOT, (CALL, action))))
        return self.solve(goal, 0, continuation)


def check_body(goal: Term) -> Term:
    """Return a goal as a body, with variables as goals replaced by ``call/1`` (cuts in their values are local).

    Raises:
        PrologError: ``type_error(callable, Goal)`` with the whole goal if part of a control construct is not
            callable.
        TermTooLarge: if the goal has too many parts.
    """
    # Between the rounds the work can be cancelled, and after many of them the term is tested for cycles, in which the
    # traversal would not end.
    stack = [goal]
    has_variables = False
    for round_number in WALK_ROUNDS:
        for _ in STEPS_PER_ROUND:
            if not stack:
                return _wrap_variables(goal) if has_variables else goal
            item = deref(stack.pop())
            if item.__class__ is tuple:
                if item[0] in BODY_CONSTRUCTS:
                    stack.extend(item[1:])
            elif item.__class__ is Var:
                has_variables = True
            elif item.__class__ is not Atom:
                raise type_error("callable", goal)
        check_limits()
        if round_number == CYCLE_CHECK_ROUND:
            require_acyclic(goal)
    raise TermTooLarge


def _wrap_variables(goal: Term) -> Term:
    """Return a body with its variables wrapped in ``call/1``; conjunctions are traversed without recursion."""
    conjuncts = []
    goal = deref(goal)
    while goal.__class__ is tuple and goal[0] in BODY_CONSTRUCTS and len(goal) == 3:
        conjuncts.append((goal[0], _wrap_variables(goal[1])))
        goal = deref(goal[2])
    if goal.__class__ is Var:
        goal = (CALL, goal)
    elif goal.__class__ is tuple and goal[0] is NOT:
        goal = (NOT, _wrap_variables(goal[1]))
    for key, conjunct in reversed(conjuncts):
        goal = (key, conjunct, goal)
    return goal


def check_partial_list(term: Term) -> None:
    """Require a list or a partial list.

    Raises:
        PrologError: a type error for any other term.
    """
    _, tail = list_parts(term)
    if tail.__class__ is not Var and tail is not NIL:
        raise type_error("list", term)


def add_arguments(goal: Term, extra: Values, modules: Optional[Modules] = None) -> Term:
    """Return a closure with the arguments of ``call/N`` appended."""
    closure: Any = deref(goal)
    closure_class = closure.__class__
    if closure_class is tuple:
        if closure[0] is _COLON:
            plain_closure = (
                deref(closure[2])
                if modules is None
                else modules.resolve_qualified_closure(closure, len(extra))
            )
            return add_arguments(plain_closure, extra, modules)
        return (functor(closure[0].name, len(closure) - 1 + len(extra)), *closure[1:], *extra)
    if closure_class is Atom:
        return (functor(closure.name, len(extra)), *extra)
    if closure_class is Var:
        raise instantiation_error()
    raise type_error("callable", closure)


def thrown(ball: Term) -> PrologError:
    """Return the exception of ``throw/1``.

    Raises:
        PrologError: an instantiation error if the ball is unbound.
    """
    ball = deref(ball)
    if ball.__class__ is Var:
        raise instantiation_error()
    return PrologError(ball if is_ground(ball) else copy(ball))


def control_predicates(control: Control) -> Dict[Tuple[str, int], ControlFunction]:
    """Return the control built-ins, functions ``(machine, args, next) -> frame``, by name and arity."""

    def call(machine: Machine, args: Values, continuation: Frame) -> Optional[Frame]:
        if len(args) == 1:
            return control.call(args[0], continuation)
        return control.call(add_arguments(args[0], args[1:], machine.logic.database.modules), continuation)

    def catch(machine: Machine, args: Values, continuation: Frame) -> Optional[Frame]:
        return control.catch(args[0], args[1], args[2], continuation)

    def throw(machine: Machine, args: Values, continuation: Frame) -> Optional[Frame]:
        raise thrown(args[0])

    def findall(machine: Machine, args: Values, continuation: Frame) -> Optional[Frame]:
        template, goal, result = args[0], args[1], args[2]
        tail = args[3] if len(args) == 4 else NIL
        if machine.logic.flags["iso"] is TRUE:
            check_partial_list(result)

        def then(solutions: List[Term]) -> Optional[Frame]:
            return continuation if machine.unify(result, make_list(solutions, tail)) else None

        return control.collect(goal, template, then)

    def forall(machine: Machine, args: Values, continuation: Frame) -> Optional[Frame]:
        return control.forall(args[0], args[1], continuation)

    predicates: Dict[Tuple[str, int], ControlFunction] = {("call", arity): call for arity in range(1, 9)}
    predicates.update(
        {("catch", 3): catch, ("throw", 1): throw, ("findall", 3): findall, ("findall", 4): findall}
    )
    predicates.update({("forall", 2): forall, ("repeat", 0): _repeat(control.machine)})
    for key in (*BODY_CONSTRUCTS, ONCE, IGNORE):
        predicates[key.name, key.arity] = _construct(control, key)
    return predicates


def _construct(control: Control, key: Functor) -> ControlFunction:
    def run(machine: Machine, args: Values, continuation: Frame) -> Optional[Frame]:
        return control.call((key, *args), continuation)

    return run


def _repeat(machine: Machine) -> ControlFunction:
    def repeat(machine: Machine, args: Values, continuation: Frame) -> Optional[Frame]:
        machine.choices.append((retry_code, args, continuation, len(machine.trail)))
        return continuation

    retry_code = Code("repeat", lambda frame: repeat(machine, frame[1], frame[2]))
    retry_code.functor = functor("repeat", 0)
    return repeat


def functor_of(head: Term) -> Functor:
    """Return the functor of an atom or compound term, such as a clause head or an event."""
    if head.__class__ is tuple:
        key: Functor = head[0]
        return key
    assert head.__class__ is Atom
    return head.functor


def split_clause(term: Term) -> Tuple[Term, Term]:
    """Return head and body of a clause; a module before the head is dropped.

    Raises:
        PrologError: an instantiation or type error if the term is not a clause.
    """
    head: Term = term
    body: Term = TRUE
    if term.__class__ is tuple and term[0] is _NECK:
        head, body = deref(term[1]), deref(term[2])
    if head.__class__ is tuple and head[0].name == ":" and len(head) == 3:
        head = deref(head[2])
    head_class = head.__class__
    if head_class is Var:
        raise instantiation_error()
    if head_class is not tuple and head_class is not Atom:
        raise type_error("callable", head)
    if body.__class__ is Var:
        body = (CALL, body)
    else:
        body = check_body(body)
    return head, body
