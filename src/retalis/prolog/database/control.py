"""Control on the machine: running a goal from its term, and the built-ins that decide what runs next."""

from typing import Any, Callable, Dict, List, Optional, Tuple

from ...foundation import BULK, TermTooLarge, look
from ..compiler import ARROW, BAR, CALL, IGNORE, NOT, ONCE, SEMICOLON, SOFT_ARROW
from ..machine import (
    DEAD,
    RESUME,
    CatchMark,
    Code,
    Frame,
    Machine,
    PrologError,
    instantiation_error,
    type_error,
)
from ..terms import (
    COMMA,
    FALSE,
    LATE_ROUND,
    NIL,
    ROUNDS,
    TRUE,
    Atom,
    CompoundTerm,
    Functor,
    Lazy,
    Term,
    Values,
    Var,
    copy,
    deref,
    functor,
    is_ground,
    list_parts,
    make_list,
    refuse_cycles,
)
from .database import Database
from .hot import STRUCTURES, HotBodies
from .modules import Modules

_CUT = functor("!", 0)
_FAIL = functor("fail", 0)
_COLON = functor(":", 2)
_NECK = functor(":-", 2)


Controls = Callable[[Machine, Values, Frame], Optional[Frame]]
"""A control built-in: takes the machine, the arguments and the frame that follows."""


class Control:
    """Runs goals from their terms as frames of a database's machine.

    Attributes:
        code: the code of a frame that runs a goal from its term.
        bodies: those of them that are compiled while they run.
    """

    def __init__(self, database: Database):
        self._database = database
        self.machine = database.machine
        self._choices = database.machine.choices
        self._trail = database.machine.trail
        self.code = database.machine.goal_code = Code("goal", self._run)
        self._cut_code = Code("cut", self._cut_run)
        self._soft_code = Code("soft cut", self._soft_run)
        self._reject_code = Code("reject", self._reject_run)
        self._exit_code = Code("catch exit", self._exit_run)
        self._collect_code = Code("collect", self._collect_run)
        self._collected_code = Code("collected", lambda frame: frame[1](frame[2]), True)
        self._plain: Dict[Functor, Callable[..., Optional[Frame]]] = {
            SEMICOLON: self._either,
            BAR: self._either,
            ARROW: self._then,
            SOFT_ARROW: self._soft,
            NOT: self._not,
            ONCE: self._once,
            IGNORE: self._ignore,
        }
        self.bodies = HotBodies(database)
        self._compiled = self.bodies.compiled
        database.machine.meet = self.bodies.meet
        database.machine.budget.on_new = database.on_forget = self.bodies.clear
        database.interpret = self.code
        database.solve = self.solve

    def solve(  # noqa: C901 -- runs each goal of what is interpreted: its tests in one place cost least
        self, goal: Any, height: int, after: Frame
    ) -> Optional[Frame]:
        """Return the frame that runs a goal and then ``after``; cuts in it cut to ``height``."""
        while True:
            kind = goal.__class__
            if kind is Var or kind is Lazy:
                goal = deref(goal)
                kind = goal.__class__
            if kind is tuple:
                key = goal[0]
                if key is COMMA:
                    after = (self.code, goal[2], height, after)
                    goal = goal[1]
                    continue
                control = self._plain.get(key)
                if control is not None:
                    return control(goal, height, after)
                if key is _COLON:
                    goal = self._database.modules.goal(goal)
                    continue
                return (self._database.predicate(key), *goal[1:], after)
            if kind is Atom:
                if goal is TRUE:
                    return after
                key = goal.functor
                if key is _CUT:
                    del self._choices[height:]
                    return after
                if key is _FAIL or goal is FALSE:
                    return None
                return (self._database.predicate(key), after)
            if kind is Var:
                raise instantiation_error()
            raise type_error("callable", goal)

    def call(self, goal: Term, after: Frame) -> Optional[Frame]:
        """Return the frame of ``call/1``: cuts in the goal are local to it."""
        if goal.__class__ is not tuple:
            goal = deref(goal)
        if goal.__class__ is tuple and goal[0] in STRUCTURES:
            goal = check_body(goal)
        return self.solve(goal, len(self._choices), after)

    def once(self, goal: Term, after: Frame) -> Optional[Frame]:
        """Return the frame that runs a goal for its first solution."""
        height = len(self._choices)
        return self.call(goal, (self._cut_code, height, after))

    def _run(self, frame: Frame) -> Optional[Frame]:
        if self._compiled:
            compiled = self._compiled.get(id(frame[1]))
            if compiled is not None:
                return compiled[0]((None, *compiled[1], frame[3], frame[2]))
        return self.solve(frame[1], frame[2], frame[3])

    def _cut_run(self, frame: Frame) -> Frame:
        del self._choices[frame[1] :]
        return frame[2]  # type: ignore[no-any-return]

    # Control constructs

    def _either(self, goal: CompoundTerm, height: int, after: Frame) -> Optional[Frame]:
        left = deref(goal[1])
        if left.__class__ is tuple and left[0] is ARROW:
            return self._test(left[1], left[2], goal[2], height, after)
        if left.__class__ is tuple and left[0] is SOFT_ARROW:
            here = len(self._choices)
            self._choices.append((self.code, goal[2], height, after, len(self._trail)))
            then = (self._soft_code, here, (self.code, left[2], height, after))
            return self.solve(left[1], here + 1, then)
        self._choices.append((self.code, goal[2], height, after, len(self._trail)))
        return self.solve(left, height, after)

    def _test(self, test: Term, then: Term, otherwise: Term, height: int, after: Frame) -> Optional[Frame]:
        here = len(self._choices)
        self._choices.append((self.code, otherwise, height, after, len(self._trail)))
        return self.solve(test, here + 1, (self._cut_code, here, (self.code, then, height, after)))

    def _then(self, goal: CompoundTerm, height: int, after: Frame) -> Optional[Frame]:
        here = len(self._choices)
        return self.solve(goal[1], here, (self._cut_code, here, (self.code, goal[2], height, after)))

    def _soft(self, goal: CompoundTerm, height: int, after: Frame) -> Optional[Frame]:
        return self.solve(goal[1], len(self._choices), (self.code, goal[2], height, after))

    def _soft_run(self, frame: Frame) -> Frame:
        here = frame[1]
        self._choices[here] = (DEAD, self._choices[here][-1])
        return frame[2]  # type: ignore[no-any-return]

    def _not(self, goal: CompoundTerm, height: int, after: Frame) -> Optional[Frame]:
        here = len(self._choices)
        self._choices.append((RESUME, after, len(self._trail)))
        return self.solve(goal[1], here + 1, (self._reject_code, here, after))

    def _reject_run(self, frame: Frame) -> None:
        del self._choices[frame[1] :]

    def _once(self, goal: CompoundTerm, height: int, after: Frame) -> Optional[Frame]:
        return self.once(goal[1], after)

    def _ignore(self, goal: CompoundTerm, height: int, after: Frame) -> Optional[Frame]:
        predicate = self._database.predicate(IGNORE)
        if not predicate.library:
            return (predicate, goal[1], after)
        here = len(self._choices)
        self._choices.append((RESUME, after, len(self._trail)))
        return self.call(goal[1], (self._cut_code, here, after))

    # Exceptions

    def catch(self, goal: Term, catcher: Term, recovery: Term, after: Frame) -> Optional[Frame]:
        """Return the frame of ``catch/3``."""
        mark = CatchMark()
        here = len(self._choices)
        recover = (self._database.predicate(CALL), recovery, after)
        self._choices.append((self.machine.catch_code, mark, catcher, recover, len(self._trail)))
        return (self._database.predicate(CALL), goal, (self._exit_code, mark, here, after))

    def _exit_run(self, frame: Frame) -> Frame:
        after: Frame
        _, mark, here, after = frame
        if len(self._choices) == here + 1:
            self._choices.pop()  # the goal left no choice points
        else:
            mark.ref = True
            self._trail.append(mark)
        return after

    # Collecting solutions

    def collect(
        self, goal: Term, template: Term, then: Callable[[List[Term]], Optional[Frame]]
    ) -> Optional[Frame]:
        """Return the frame that runs a goal for all its solutions, then goes on with ``then(copies)``.

        ``copies`` are copies of ``template``, one for each solution; the bindings are undone.
        """
        found: List[Term] = []
        self._choices.append((self._collected_code, then, found, len(self._trail)))
        return self.call(goal, (self._collect_code, found, template, (RESUME, None)))

    @staticmethod
    def _collect_run(frame: Frame) -> None:
        frame[1].append(copy(frame[2]))

    def forall(self, condition: Term, action: Term, after: Frame) -> Optional[Frame]:
        """Return the frame of ``forall/2``."""
        goal = (NOT, (COMMA, (CALL, condition), (NOT, (CALL, action))))
        return self.solve(goal, 0, after)


def check_body(goal: Term) -> Term:
    """Return a goal as a body: variables that stand as goals in it are called (cuts in them are local).

    Raises:
        PrologError: type_error(callable, whole goal) where part of a control construct can be no goal.
    """
    stack = [goal]
    open_goals = False
    for done in ROUNDS:
        for _ in BULK:
            if not stack:
                return _called(goal) if open_goals else goal
            item = deref(stack.pop())
            if item.__class__ is tuple:
                if item[0] in STRUCTURES:
                    stack.extend(item[1:])
            elif item.__class__ is Var:
                open_goals = True
            elif item.__class__ is not Atom:
                raise type_error("callable", goal)
        look()
        if done == LATE_ROUND:
            refuse_cycles(goal)
    raise TermTooLarge


def _called(goal: Term) -> Term:
    """Return a body with its variables called; no recursion along conjunctions."""
    before = []
    goal = deref(goal)
    while goal.__class__ is tuple and goal[0] in STRUCTURES and len(goal) == 3:
        before.append((goal[0], _called(goal[1])))
        goal = deref(goal[2])
    if goal.__class__ is Var:
        goal = (CALL, goal)
    elif goal.__class__ is tuple and goal[0] is NOT:
        goal = (NOT, _called(goal[1]))
    for key, left in reversed(before):
        goal = (key, left, goal)
    return goal


def check_partial_list(term: Term) -> None:
    """Raise a type error for what is neither a list nor may become one.

    Raises:
        PrologError: a type error.
    """
    _, tail = list_parts(term)
    if tail.__class__ is not Var and tail is not NIL:
        raise type_error("list", term)


def add_arguments(goal: Term, extra: Values, modules: Optional[Modules] = None) -> Term:
    """Return a goal with more arguments, as ``call/N`` makes it."""
    found: Any = deref(goal)
    kind = found.__class__
    if kind is tuple:
        if found[0] is _COLON:
            inner = deref(found[2]) if modules is None else modules.closure_of(found, len(extra))
            return add_arguments(inner, extra, modules)
        return (functor(found[0].name, len(found) - 1 + len(extra)), *found[1:], *extra)
    if kind is Atom:
        return (functor(found.name, len(extra)), *extra)
    if kind is Var:
        raise instantiation_error()
    raise type_error("callable", found)


def thrown(ball: Term) -> PrologError:
    """Return the exception of ``throw/1``."""
    ball = deref(ball)
    if ball.__class__ is Var:
        raise instantiation_error()
    return PrologError(ball if is_ground(ball) else copy(ball))


def control_predicates(control: Control) -> Dict[Tuple[str, int], Controls]:
    """Return the control built-ins: functions ``(machine, args, next) -> frame``."""

    def call(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
        if len(args) == 1:
            return control.call(args[0], after)
        return control.call(add_arguments(args[0], args[1:], machine.logic.database.modules), after)

    def catch(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
        return control.catch(args[0], args[1], args[2], after)

    def throw(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
        raise thrown(args[0])

    def findall(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
        template, goal, result = args[0], args[1], args[2]
        tail = args[3] if len(args) == 4 else NIL
        if machine.logic.flags["iso"] is TRUE:
            check_partial_list(result)

        def then(found: List[Term]) -> Optional[Frame]:
            return after if machine.unify(result, make_list(found, tail)) else None

        return control.collect(goal, template, then)

    def forall(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
        return control.forall(args[0], args[1], after)

    found: Dict[Tuple[str, int], Controls] = {("call", arity): call for arity in range(1, 9)}
    found.update({("catch", 3): catch, ("throw", 1): throw, ("findall", 3): findall, ("findall", 4): findall})
    found.update({("forall", 2): forall, ("repeat", 0): _repeat(control.machine)})
    for key in (*STRUCTURES, ONCE, IGNORE):
        found[key.name, key.arity] = _structure(control, key)
    return found


def _structure(control: Control, key: Functor) -> Controls:
    def run(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
        return control.call((key, *args), after)

    return run


def _repeat(machine: Machine) -> Controls:
    def repeat(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
        machine.choices.append((again, args, after, len(machine.trail)))
        return after

    again = Code("repeat", lambda frame: repeat(machine, frame[1], frame[2]))
    again.functor = functor("repeat", 0)
    return repeat


def functor_of(head: Term) -> Functor:
    """Return the functor of an atom or a compound: of a clause's head, of an event."""
    if head.__class__ is tuple:
        key: Functor = head[0]
        return key
    assert head.__class__ is Atom
    return head.functor


def split_clause(term: Term) -> Tuple[Term, Term]:
    """Return head and body of a clause.

    Raises:
        PrologError: instantiation and type errors where the term is not a clause.
    """
    head: Term = term
    body: Term = TRUE
    if term.__class__ is tuple and term[0] is _NECK:
        head, body = deref(term[1]), deref(term[2])
    if head.__class__ is tuple and head[0].name == ":" and len(head) == 3:
        head = deref(head[2])
    kind = head.__class__
    if kind is Var:
        raise instantiation_error()
    if kind is not tuple and kind is not Atom:
        raise type_error("callable", head)
    if body.__class__ is Var:
        body = (CALL, body)
    else:
        body = check_body(body)
    return head, body
