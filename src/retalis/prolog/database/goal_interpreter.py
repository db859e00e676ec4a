"""Interpretation of goals on the machine: control constructs, ``call/N``, exceptions, and solution collection.

`Control.solve` turns a goal term into the frame that runs it. A conjunction becomes a chain of frames, a disjunction
pushes a choice point, and a cut shortens the choice point stack to the height at which its clause was entered.
``catch/3`` pushes a choice point of its own kind; while the goal runs, the machine searches the stack for it after an
exception.

A body that runs often is compiled while it runs, see `database.just_in_time_bodies`.
"""

from typing import TYPE_CHECKING, Any, Callable, Dict, List, Mapping, Optional, Tuple

from ..compiler.clause_nodes import ARROW, BAR, CALL, IGNORE, NOT, ONCE, SEMICOLON, SOFT_ARROW
from ..machine.errors import PrologError, instantiation_error, type_error
from ..machine.machine import DEAD, RESUME, CatchMark, Code, GoalCode, Machine
from ..terms.list_terms import list_parts, make_list
from ..terms.term_traversal import copy, is_ground
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
    Term,
    Values,
    Var,
    deref,
    functor,
)
from .goal_terms import BODY_CONSTRUCTS, add_arguments, check_body
from .just_in_time_bodies import JustInTimeBodies

if TYPE_CHECKING:
    from .predicate_database import Database

_CUT = functor("!", 0)
_FAIL = functor("fail", 0)
_COLON = functor(":", 2)


SolveFunction = Callable[[Term, int, Frame], Optional[Frame]]
"""Returns the frame that runs a goal, from the goal, a cut height and the next frame; see `Control.solve`."""

ControlFunction = Callable[[Machine, Values, Frame], Optional[Frame]]
"""Control built-in: takes the machine, the arguments and the next frame; returns the frame to run."""


class Control:
    """Interpreter of goal terms on the machine of a database.

    Attributes:
        code: code of frames ``(code, goal, height, next)`` that run a goal from its term.
        bodies: the bodies that are compiled while they run.
    """

    def __init__(self, database: "Database"):
        self._database = database
        self.machine = database.machine
        self._choices = database.machine.choices
        self._trail = database.machine.trail
        self.bodies = JustInTimeBodies(database)
        self._compiled = self.bodies.compiled
        self.code = GoalCode(self._run, self.bodies.record_interpreted)
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
        database.machine.budget.on_reset.add(self.bodies.clear)

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

    def start_tracing(self, solve: SolveFunction) -> SolveFunction:
        """Let a tracer run the goals; return the function that has run them so far."""
        previous = self.solve
        # An instance attribute hides the method, so that calls need no test whether tracing is on.
        self.solve = solve  # type: ignore[method-assign, assignment]
        return previous

    def stop_tracing(self, solve: SolveFunction) -> None:
        """Stop tracing if goals are run by a tracer's function."""
        if self.solve == solve:
            del self.solve

    def call(self, goal: Term, continuation: Frame) -> Optional[Frame]:
        """Return the frame of ``call/1``, in which cuts are local to the goal."""
        if goal.__class__ is not tuple:
            goal = deref(goal)
        if goal.__class__ is tuple and goal[0] in BODY_CONSTRUCTS:
            goal = check_body(goal)
        return self.solve(goal, len(self._choices), continuation)

    def call_with(self, goal: Term, arguments: Values, continuation: Frame) -> Optional[Frame]:
        """Return the frame of ``call/N``, which adds arguments to a goal."""
        return self.call(add_arguments(goal, arguments, self._database.modules), continuation)

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


def check_partial_list(term: Term) -> None:
    """Require a list or a partial list.

    Raises:
        PrologError: a type error for any other term.
    """
    _, tail = list_parts(term)
    if tail.__class__ is not Var and tail is not NIL:
        raise type_error("list", term)


def thrown(ball: Term) -> PrologError:
    """Return the exception of ``throw/1``.

    Raises:
        PrologError: an instantiation error if the ball is unbound.
    """
    ball = deref(ball)
    if ball.__class__ is Var:
        raise instantiation_error()
    return PrologError(ball if is_ground(ball) else copy(ball))


def control_predicates(control: Control, flags: Mapping[str, Term]) -> Dict[Tuple[str, int], ControlFunction]:
    """Return the control built-ins, functions ``(machine, args, next) -> frame``, by name and arity.

    Args:
        control: runs goals.
        flags: the Prolog flags of the program.
    """

    def call(machine: Machine, args: Values, continuation: Frame) -> Optional[Frame]:
        if len(args) == 1:
            return control.call(args[0], continuation)
        return control.call_with(args[0], args[1:], continuation)

    def catch(machine: Machine, args: Values, continuation: Frame) -> Optional[Frame]:
        return control.catch(args[0], args[1], args[2], continuation)

    def throw(machine: Machine, args: Values, continuation: Frame) -> Optional[Frame]:
        raise thrown(args[0])

    def findall(machine: Machine, args: Values, continuation: Frame) -> Optional[Frame]:
        template, goal, result = args[0], args[1], args[2]
        tail = args[3] if len(args) == 4 else NIL
        if flags["iso"] is TRUE:
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
