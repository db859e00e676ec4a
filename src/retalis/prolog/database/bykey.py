"""Calls of a predicate with many clauses: straight to the only clause that the key of an argument leaves.

Of most tables of facts and rules one argument is known in most calls, and leaves one clause.
"""

from typing import Any, Callable, Dict, List, Optional

from ..compiler import key_of
from ..machine import Frame, Step
from ..terms import Atom, Var
from .clause import Clause


def by_key(
    position: int,
    own: Dict[object, List[Clause]],
    choices: List[Frame],
    search: Callable[..., Optional[Frame]],
    otherwise: Step,
) -> Step:
    """Return a function that does a call while the predicate does not change.

    Args:
        position: of the argument, from 0; no clause has a variable there.
        own: the clauses by the key of that argument.
        choices: those of the machine.
        search: finds a ground fact, see `fact_search`.
        otherwise: does a call where several clauses are left, or one that has not been compiled yet.
    """
    at = position + 1

    def run(frame: Frame) -> Optional[Frame]:
        arg: Any = frame[at]
        kind = arg.__class__
        while kind is Var:
            ref = arg.ref
            if ref is None:
                return otherwise(frame)
            arg = ref
            kind = ref.__class__
        found = own.get(arg if kind is Atom or kind is int else arg[0] if kind is tuple else key_of(arg))
        if found is None:
            return None
        if len(found) == 1:
            clause = found[0]
            if clause.ground:
                return search(frame, found, 0, 1, 0, None)
            if clause.code is not None:
                return clause.code((*frame, len(choices)))
        return otherwise(frame)

    return run
