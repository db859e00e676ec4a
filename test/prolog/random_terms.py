"""Random terms of all kinds."""

from typing import Any

from retalis import String, Var, atom, functor, make_list
from retalis.prolog.terms.types import NIL

CONSTANTS = [
    *(0, 1, -1, 2**53 + 1, 10**30, -(10**400), 0.0, -0.0, 1.0, -1.0, 2.0**53, 1.0e30, 0.5),
    *(float("inf"), float("-inf"), atom("a"), atom("b"), atom(""), atom("é"), NIL, String("a"), String("")),
]


def random_term(choose: Any, depth: int, variables: Any) -> Any:
    """Return a random term whose variables are among the given ones.

    Args:
        choose: random generator.
        depth: maximum depth.
        variables: terms that may occur as leaves.
    """
    kind = choose.random()
    if kind < 0.15:
        return choose.choice(variables)
    if kind < 0.6 or not depth:
        return choose.choice(CONSTANTS)
    arguments = [random_term(choose, depth - 1, variables) for _ in range(choose.randint(1, 3))]
    if kind < 0.7:
        return make_list(arguments, choose.choice([NIL, choose.choice(variables)]))
    bound = Var()
    bound.ref = (functor(choose.choice("fgh"), len(arguments)), *arguments)
    return choose.choice([bound, bound.ref])
