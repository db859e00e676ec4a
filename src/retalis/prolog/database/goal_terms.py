"""Goals and clauses as terms: checks of bodies, closures with arguments, heads and bodies of clauses."""

from typing import Any, Optional, Tuple

from ...foundation.errors import TermTooLarge
from ...foundation.limit_checks import STEPS_PER_ROUND, check_limits
from ..compiler.clause_nodes import ARROW, BAR, CALL, NOT, SEMICOLON, SOFT_ARROW
from ..machine.errors import instantiation_error, type_error
from ..terms.term_traversal import CYCLE_CHECK_ROUND, WALK_ROUNDS, require_acyclic
from ..terms.types import COMMA, TRUE, Atom, Functor, Term, Values, Var, deref, functor
from .module_system import Modules

_COLON = functor(":", 2)
_NECK = functor(":-", 2)

BODY_CONSTRUCTS = {COMMA, SEMICOLON, BAR, ARROW, SOFT_ARROW, NOT}
"""Control constructs whose arguments are goals of the body in which they stand."""


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
