"""Gates: whether an event can match any listener, tested before it is made.

A message that is taken apart gives many events of which few are wanted. A gate tells from the arguments that
are at hand already, by the same tests that the dispatcher makes, which events nobody listens to.
"""

from typing import Callable, List, Optional, Tuple

from ...foundation import Block, Statement, shared_function, source_of
from ...prolog.terms import LAST, SECOND, Atom
from .plans import NOBODY, Choice, Plan

Passes = Callable[..., bool]
"""Takes seconds, nanoseconds and the arguments at a gate's positions."""


class Gate:
    """The gate for the events of one functor; made by `Audience.gate`.

    Attributes:
        plan: what the dispatcher does with such events; None while that is not known.
        passes: tells whether an event may concern anybody, or its time is unusual or none.
    """

    __slots__ = ("plan", "passes", "__weakref__")

    plan: Optional[Plan]
    passes: Passes

    def __init__(self, positions: Tuple[int, ...], plan: Optional[Plan]):
        self.plan = plan
        self.passes = _passing(positions)(self)


_TIME = (
    "seconds.__class__ is nanoseconds.__class__ is int and 0 <= seconds < LAST and 0 <= nanoseconds < SECOND"
)
_NAMES = {"Choice": Choice, "Atom": Atom, "NOBODY": NOBODY, "LAST": LAST // SECOND, "SECOND": SECOND}


def _passing(positions: Tuple[int, ...]) -> Callable[[Gate], Passes]:
    """Return a factory of `Gate.passes`, which follows the plan as far as it tests known arguments."""
    parameters = ", ".join(["seconds", "nanoseconds", *[f"a{at}" for at in positions]])
    chosen = [
        Block(f"{'if' if number == 0 else 'elif'} at == {at}:", [f"value = a{at}"])
        for number, at in enumerate(positions)
    ]
    walk: List[Statement] = [
        "at = plan.at",
        *chosen,
        Block("else:", ["return True"]),
        Block("if value.__class__ is not Atom:", ["return True"]),
        "plan = plan.table.get(value, plan.default)",
    ]
    body: List[Statement] = [
        "plan = gate.plan",
        *([Block("while plan.__class__ is Choice:", walk)] if positions else []),
        f"return plan is not NOBODY or not ({_TIME})",
    ]
    source = source_of(
        [Block("def made(gate):", [Block(f"def passes({parameters}):", body), "return passes"])]
    )
    made: Callable[[Gate], Passes] = shared_function(source, _NAMES, "gate")
    return made
