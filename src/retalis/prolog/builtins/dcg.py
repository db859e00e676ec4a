"""Translation of grammar rules (DCG) to clauses."""

from typing import List, NamedTuple

from ..compiler import ARROW, BAR, EQUAL, NOT, SEMICOLON, SOFT_ARROW
from ..database import add_arguments
from ..machine import instantiation_error, type_error
from ..terms import (
    COMMA,
    CONS,
    EMPTY_BLOCK,
    NIL,
    Atom,
    CompoundTerm,
    String,
    Term,
    Var,
    conjunction,
    deref,
    functor,
    list_items,
    make_list,
    resolve,
)

_NECK = functor(":-", 2)
_CURLY = functor("{}", 1)
_PHRASE = functor("phrase", 3)
_CALL = "call"


def translate_rule(rule: CompoundTerm) -> Term:
    """Return the clause of a grammar rule ``Head --> Body``.

    Raises:
        PrologError: where head or body are none of a grammar.
    """
    head, body = deref(rule[1]), rule[2]
    first, last = Var(), Var()
    if head.__class__ is tuple and head[0] is COMMA:
        pushed = _terminals(deref(head[2]))
        middle = Var()
        translated = (COMMA, translate_body(body, first, middle), _consume(pushed, last, middle))
        return (_NECK, add_arguments(head[1], (first, last)), translated)
    if head.__class__ is Var:
        raise instantiation_error()
    if head.__class__ not in (tuple, Atom):
        raise type_error("callable", head)
    return (_NECK, add_arguments(head, (first, last)), translate_body(body, first, last))


def translate_body(body: Term, first: Term, last: Term) -> Term:
    """Return the goal of a grammar body between two states of the list; without recursion, however deep it is."""
    whole = Var()
    pending: List[_Hole] = [_Hole(whole, body, first, last)]
    while pending:
        hole, body, first, last = pending.pop()
        parts = _sequence(body)
        goals = []
        state = first
        for at, part in enumerate(parts):
            following = last if at == len(parts) - 1 else Var()
            goals.append(_part(part, state, following, pending))
            state = following
        hole.ref = conjunction(goals)
    return resolve(whole)


class _Hole(NamedTuple):
    """A variable of a goal that stands for a body inside, until that is translated: between which states it is."""

    goal: Var
    body: Term
    first: Term
    last: Term


def _inside(pending: List[_Hole], body: Term, first: Term, last: Term) -> Var:
    hole = _Hole(Var(), body, first, last)
    pending.append(hole)
    return hole.goal


def _sequence(body: Term) -> List[Term]:
    parts = []
    stack = [body]
    while stack:
        item = deref(stack.pop())
        if item.__class__ is tuple and item[0] is COMMA:
            stack += (item[2], item[1])
        else:
            parts.append(item)
    return parts


def _part(part: Term, first: Term, last: Term, pending: List[_Hole]) -> Term:
    if part.__class__ is tuple:
        return _compound_part(part, first, last, pending)
    if part.__class__ is Var:
        return (_PHRASE, part, first, last)
    if part is NIL or part.__class__ is String:
        return _consume(_terminals(part), first, last)
    if part.__class__ is not Atom:
        raise type_error("callable", part)
    if part.name == "!":
        return (COMMA, part, (EQUAL, first, last))
    if part is EMPTY_BLOCK:
        return (EQUAL, first, last)
    return (functor(part.name, 2), first, last)


def _compound_part(part: CompoundTerm, first: Term, last: Term, pending: List[_Hole]) -> Term:
    key = part[0]
    if key is CONS:
        return _consume(_terminals(part), first, last)
    if key in (SEMICOLON, BAR):
        left = _inside(pending, part[1], first, last)
        return (SEMICOLON, left, _inside(pending, part[2], first, last))
    if key in (ARROW, SOFT_ARROW):
        middle = Var()
        return (key, _inside(pending, part[1], first, middle), _inside(pending, part[2], middle, last))
    if key is NOT:
        return (COMMA, (NOT, _inside(pending, part[1], first, Var())), (EQUAL, first, last))
    if key is _CURLY:
        return (COMMA, part[1], (EQUAL, first, last))
    if key.name == _CALL:
        return (functor(_CALL, len(part) + 1), *part[1:], first, last)
    return add_arguments(part, (first, last))


def _terminals(term: Term) -> List[Term]:
    if term.__class__ is String:
        return [ord(char) for char in term.text]
    found = list_items(term)
    if found is None:
        raise type_error("list", term)
    return found


def _consume(terminals: List[Term], first: Term, last: Term) -> Term:
    return (EQUAL, first, make_list(terminals, last))
