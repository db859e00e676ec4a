"""Translation of grammar rules (``-->``) and single-sided unification rules (``=>``) to clauses.

A definite clause grammar rule gets two more arguments, the list before and after the part that it parses.

The head of a rule ``Head, Guard => Body`` is matched against a call without binding the call's variables
(single-sided unification, SSU, as in SWI-Prolog). The first rule whose head matches and whose guard succeeds is
committed to, and a call that matches no rule is an error. A rule becomes a clause that tests its arguments and cuts.
A clause that raises the error follows the last rule.
"""

from typing import Any, List, NamedTuple, Set, Tuple

from ..compiler.clause_nodes import ARROW, BAR, EQUAL, NOT, SEMICOLON, SOFT_ARROW
from ..database.goal_terms import add_arguments
from ..machine.errors import instantiation_error, instantiation_or_type_error, no_matching_rule, type_error
from ..terms.list_terms import conjunction, list_items, make_list
from ..terms.term_traversal import resolve
from ..terms.types import (
    COLON,
    COMMA,
    CONS,
    EMPTY_BLOCK,
    NIL,
    TRUE,
    Atom,
    CompoundTerm,
    String,
    Term,
    Var,
    atom,
    deref,
    functor,
)
from .builtin_registry import ProgramMachine, deterministic

_NECK = functor(":-", 2)
_CURLY = functor("{}", 1)
_PHRASE = functor("phrase", 3)
_CALL = "call"


def translate_rule(rule: CompoundTerm) -> Term:
    """Return the clause of a grammar rule ``Head --> Body``.

    Raises:
        PrologError: if the head or the body is not valid in a grammar.
    """
    head, body = deref(rule[1]), rule[2]
    first, last = Var(), Var()
    if head.__class__ is tuple and head[0] is COMMA:
        # Pushback: the terminals after the head are put in front of the list that remains after the body.
        pushback = _parse_terminals(deref(head[2]))
        middle = Var()
        translated = (COMMA, translate_body(body, first, middle), _terminals_goal(pushback, last, middle))
        return (_NECK, add_arguments(head[1], (first, last)), translated)
    if head.__class__ not in (tuple, Atom):
        raise instantiation_or_type_error("callable", head)
    return (_NECK, add_arguments(head, (first, last)), translate_body(body, first, last))


def translate_body(body: Term, first: Term, last: Term) -> Term:
    """Return the goal that parses the part of a list that a grammar body describes.

    Args:
        body: the grammar body.
        first: the list before the part.
        last: the list after it.
    """
    translated_body = Var()
    # Nested bodies are translated later, into variables of the goal, so the depth of a body is not limited by
    # recursion.
    pending: List[_PendingBody] = [_PendingBody(translated_body, body, first, last)]
    while pending:
        goal_var, body, first, last = pending.pop()
        elements = _split_conjunction(body)
        goals = []
        state = first
        for index, element in enumerate(elements):
            next_state = last if index == len(elements) - 1 else Var()
            goals.append(_translate_element(element, state, next_state, pending))
            state = next_state
        goal_var.ref = conjunction(goals)
    return resolve(translated_body)


class _PendingBody(NamedTuple):
    """A variable of a goal that is bound to the translation of a nested body, with the states of the list."""

    goal: Var
    body: Term
    first: Term
    last: Term


def _nested_body(pending: List[_PendingBody], body: Term, first: Term, last: Term) -> Var:
    """Return the variable of a nested body, whose translation is pending."""
    pending_body = _PendingBody(Var(), body, first, last)
    pending.append(pending_body)
    return pending_body.goal


def _split_conjunction(body: Term) -> List[Term]:
    """Return the elements of a sequence in a grammar body."""
    elements = []
    stack = [body]
    while stack:
        item = deref(stack.pop())
        if item.__class__ is tuple and item[0] is COMMA:
            stack += (item[2], item[1])
        else:
            elements.append(item)
    return elements


def _translate_element(element: Term, first: Term, last: Term, pending: List[_PendingBody]) -> Term:
    if element.__class__ is tuple:
        return _translate_compound(element, first, last, pending)
    # The body is known only at run time, and is translated then.
    if element.__class__ is Var:
        return (_PHRASE, element, first, last)
    if element is NIL or element.__class__ is String:
        return _terminals_goal(_parse_terminals(element), first, last)
    if element.__class__ is not Atom:
        raise type_error("callable", element)
    # A cut has to stay a goal of the clause itself; within `phrase/3` it would be local.
    if element.name == "!":
        return (COMMA, element, (EQUAL, first, last))
    if element is EMPTY_BLOCK:
        return (EQUAL, first, last)
    return (functor(element.name, 2), first, last)


def _translate_compound(element: CompoundTerm, first: Term, last: Term, pending: List[_PendingBody]) -> Term:
    key = element[0]
    if key is CONS:
        return _terminals_goal(_parse_terminals(element), first, last)
    if key in (SEMICOLON, BAR):
        left = _nested_body(pending, element[1], first, last)
        return (SEMICOLON, left, _nested_body(pending, element[2], first, last))
    if key in (ARROW, SOFT_ARROW):
        middle = Var()
        return (
            key,
            _nested_body(pending, element[1], first, middle),
            _nested_body(pending, element[2], middle, last),
        )
    # A negated body consumes nothing, whatever it parses.
    if key is NOT:
        return (COMMA, (NOT, _nested_body(pending, element[1], first, Var())), (EQUAL, first, last))
    if key is _CURLY:
        return (COMMA, element[1], (EQUAL, first, last))
    if key.name == _CALL:
        return (functor(_CALL, len(element) + 1), *element[1:], first, last)
    return add_arguments(element, (first, last))


def _parse_terminals(term: Term) -> List[Term]:
    if term.__class__ is String:
        return [ord(char) for char in term.text]
    items = list_items(term)
    if items is None:
        raise type_error("list", term)
    return items


def _terminals_goal(terminals: List[Term], first: Term, last: Term) -> Term:
    return (EQUAL, first, make_list(terminals, last))


SINGLE_SIDED = functor("=>", 2)
_IDENTICAL = functor("==", 2)
_SUBSUMES = functor("subsumes_term", 2)
_NO_RULE = functor("$no_matching_rule", 1)
_CUT = atom("!")


def translate_single_sided(rule: CompoundTerm) -> Tuple[Term, Term]:
    """Return the clause of a rule ``Head => Body``, and the clause that follows the last rule of its predicate.

    Raises:
        PrologError: if the head is not callable.
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
        clause_head: Term = head
        tests: List[Term] = []
    elif head.__class__ is tuple:
        clause_head, tests = _replace_tested_arguments(head)
    else:
        raise type_error("callable", head)
    # The cut commits to the rule after the guard and before the body.
    goals = [*tests, *([] if guard is TRUE else [guard]), _CUT, rule[2]]
    error_clause_head = (
        (clause_head[0], *(Var() for _ in clause_head[1:])) if clause_head.__class__ is tuple else clause_head
    )
    return (_NECK, clause_head, conjunction(goals)), (_NECK, error_clause_head, (_NO_RULE, error_clause_head))


def _replace_tested_arguments(head: CompoundTerm) -> Tuple[Term, List[Term]]:
    """Return the head with a new variable for each argument that has to be tested, and the tests."""
    head_variables: Set[Var] = set()
    new_arguments: List[Term] = []
    patterns: List[Term] = []
    arguments: List[Term] = []
    tests: List[Term] = []
    for argument in map(deref, head[1:]):
        # The first occurrence of a variable matches any argument, and later ones require an identical argument.
        if isinstance(argument, Var) and argument not in head_variables:
            head_variables.add(argument)
            new_arguments.append(argument)
            continue
        new_var = Var()
        new_arguments.append(new_var)
        if argument.__class__ is not tuple and argument.__class__ is not Var:
            tests.append((_IDENTICAL, new_var, argument))
        else:
            patterns.append(argument)
            arguments.append(new_var)
    if patterns:
        tests += _subsumption_goals(patterns, arguments, head_variables)
    return (head[0], *new_arguments), tests


def _subsumption_goals(patterns: List[Term], arguments: List[Term], head_variables: Set[Var]) -> List[Term]:
    """Return goals that match patterns against the arguments without binding variables of the arguments.

    Args:
        patterns: terms of the head.
        arguments: the variables that replace them in the head.
        head_variables: variables of the head that are bound before these goals.
    """
    # The bound variables are on both sides, so that `subsumes_term` does not bind them again.
    bound_variables: List[Term] = list(head_variables)
    arguments_functor = functor("$arguments", len(patterns) + len(bound_variables))
    general = (arguments_functor, *patterns, *bound_variables)
    return [
        (_SUBSUMES, general, (arguments_functor, *arguments, *bound_variables)),
        *[(EQUAL, *pair) for pair in zip(patterns, arguments)],
    ]


def is_error_clause_body(body: Term) -> bool:
    """Return whether a clause body is that of the error clause, which follows the last rule of a predicate."""
    body = deref(body)
    return body.__class__ is tuple and body[0] is _NO_RULE


@deterministic("$no_matching_rule/1")
def raise_no_matching_rule(machine: ProgramMachine, call: Term) -> bool:
    """Raise the error for a call that matches no rule."""
    raise no_matching_rule("user", call)
