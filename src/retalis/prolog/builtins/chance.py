"""Random numbers, items and orders."""

import random

from ...foundation import watched
from ..machine import domain_error, instantiation_error
from ..terms import Term, Var, deref, make_list, unify
from .arguments import integer, items
from .ordering import order_of
from .program import Machine
from .registry import deterministic


@deterministic("random/1")
def random_float(machine: Machine, value: Term) -> bool:
    """Give a float between 0 and 1, both excluded."""
    return unify(value, random.random() or 0.5, machine.trail)


@deterministic("random_between/3")
def random_between(machine: Machine, low: Term, high: Term, value: Term) -> bool:
    """Give an integer between two, both included."""
    first, last = integer(low), integer(high)
    return first <= last and unify(value, random.randint(first, last), machine.trail)


@deterministic("random_member/2")
def random_member(machine: Machine, value: Term, given: Term) -> bool:
    """Give an item of a list."""
    found = items(given)
    if not found:
        raise domain_error("non_empty_list", given)
    return unify(value, random.choice(found), machine.trail)


@deterministic("random_permutation/2")
def random_permutation(machine: Machine, given: Term, result: Term) -> bool:
    """Give the items of a list in another order."""
    found = items(given)
    ranks = [random.random() for _ in watched(found)]
    return unify(result, make_list([found[at] for at in order_of(ranks)]), machine.trail)


@deterministic("set_random/1")
def set_random(machine: Machine, option: Term) -> bool:
    """Set the seed: ``seed(Number)`` or ``seed(random)``."""
    option = deref(option)
    if option.__class__ is Var:
        raise instantiation_error()
    if option.__class__ is not tuple or option[0].name != "seed":
        raise domain_error("random_option", option)
    seed = deref(option[1])
    random.seed(seed if seed.__class__ is int else None)
    return True
