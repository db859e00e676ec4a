"""Single-sided rules, ``Head, Guard => Body``: the head matches a call without binding anything of it.

The first rule whose head matches and whose guard succeeds is the only one; a call that none takes is an error. A
rule becomes a clause that tests its arguments, and cuts; behind the last one stands a clause that raises the error.
"""

from typing import Any, List, Set, Tuple

from ..compiler import EQUAL
from ..machine import instantiation_error, no_matching_rule, type_error
from ..terms import COLON, COMMA, TRUE, Atom, CompoundTerm, Term, Var, atom, conjunction, deref, functor
from .program import Machine
from .registry import deterministic

SINGLE_SIDED = functor("=>", 2)
_NECK = functor(":-", 2)
_IDENTICAL = functor("==", 2)
_SUBSUMES = functor("subsumes_term", 2)
_NO_RULE = functor("$no_matching_rule", 1)
_CUT = atom("!")


def translate_single_sided(rule: CompoundTerm) -> Tuple[Term, Term]:
    """Return the clause of a rule ``Head => Body``, and the one that has to stand behind all of its predicate.

    Raises:
        PrologError: where the head is none.
    """
    head: Any = deref(rule[1])
    guard: Term = TRUE
    if head.__class__ is tuple and head[0] is COMMA:
        head, guard = deref(head[1]), deref(head[2])
    if head.__class__ is tuple and head[0] is COLON:
        head = deref(head[2])
    if head.__class__ is Var:
        raise instantiation_error()
    if isinstance(head, Atom):
        called: Term = head
        tests: List[Term] = []
    elif head.__class__ is tuple:
        called, tests = _tested(head)
    else:
        raise type_error("callable", head)
    goals = [*tests, *([] if guard is TRUE else [guard]), _CUT, rule[2]]
    last = (called[0], *(Var() for _ in called[1:])) if called.__class__ is tuple else called
    return (_NECK, called, conjunction(goals)), (_NECK, last, (_NO_RULE, last))


def _tested(head: CompoundTerm) -> Tuple[Term, List[Term]]:
    """Return the head with a variable for each argument that has to be tested, and the tests."""
    seen: Set[Var] = set()
    called: List[Term] = []
    wanted: List[Term] = []
    given: List[Term] = []
    tests: List[Term] = []
    for argument in map(deref, head[1:]):
        if isinstance(argument, Var) and argument not in seen:
            seen.add(argument)
            called.append(argument)
            continue
        fresh = Var()
        called.append(fresh)
        if argument.__class__ is not tuple and argument.__class__ is not Var:
            tests.append((_IDENTICAL, fresh, argument))
        else:
            wanted.append(argument)
            given.append(fresh)
    if wanted:
        tests += _subsuming(wanted, given, seen)
    return (head[0], *called), tests


def _subsuming(wanted: List[Term], given: List[Term], seen: Set[Var]) -> List[Term]:
    """Return goals that match terms with the arguments, of which nothing is bound; ``seen`` is bound by then."""
    known: List[Term] = list(seen)
    shape = functor("$arguments", len(wanted) + len(known))
    general = (shape, *wanted, *known)
    return [(_SUBSUMES, general, (shape, *given, *known)), *[(EQUAL, *pair) for pair in zip(wanted, given)]]


def is_behind(body: Term) -> bool:
    """Tell whether a clause with this body is the one behind all rules of a predicate."""
    body = deref(body)
    return body.__class__ is tuple and body[0] is _NO_RULE


@deterministic("$no_matching_rule/1")
def raise_no_rule(machine: Machine, call: Term) -> bool:
    """Raise the error of a call that no rule takes."""
    raise no_matching_rule("user", call)
