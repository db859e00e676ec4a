"""Gates: who is about to make an event asks whether it can concern anybody, before it is made.

A message that is taken apart gives many events of which few are wanted. A gate tells from the arguments that
are at hand already, by the same tests that the dispatcher makes, which events nobody listens to.
"""

from functools import lru_cache
from typing import Any, Callable, Tuple

from ..terms import Atom
from ..timestamps import LAST, SECOND
from ._plans import NOBODY, Choice
from ._source import compile_function


class Gate:
    """The gate for the events of one functor; made by `Dispatcher.gate`.

    Attributes:
        plan: what the dispatcher does with such events; None while that is not known.
        passes: takes seconds, nanoseconds and the arguments at the gate's positions; tells whether the event may
            concern anybody, or its time is unusual or none.
    """

    __slots__ = ("plan", "passes")

    plan: Any
    passes: Callable[..., bool]

    def __init__(self, positions: Tuple[int, ...]):
        self.plan = None
        self.passes = _passing(positions)(self)


@lru_cache(maxsize=256)
def _passing(positions: Tuple[int, ...]) -> Callable[[Gate], Callable[..., bool]]:
    """Return what makes the function of a gate: it walks the plan as far as known arguments are tested."""
    parameters = ", ".join(["seconds", "nanoseconds", *[f"a{at}" for at in positions]])
    lines = [f"    def passes({parameters}):", "        plan = gate.plan"]
    if positions:
        lines += ["        while plan.__class__ is Choice:", "            at = plan.at"]
        word = "if"
        for at in positions:
            lines += [f"            {word} at == {at}:", f"                value = a{at}"]
            word = "elif"
        lines += [
            "            else:",
            "                return True",
            "            if value.__class__ is not Atom:",
            "                return True",
            "            plan = plan.table.get(value, plan.default)",
        ]
    lines += [
        "        return (plan is not NOBODY or seconds.__class__ is not int or nanoseconds.__class__ is not int",
        "                or not 0 <= seconds < LAST or not 0 <= nanoseconds < SECOND)",
    ]
    source = "\n".join(["def made(gate):", *lines, "    return passes", ""])
    names = {"Choice": Choice, "Atom": Atom, "NOBODY": NOBODY, "LAST": LAST // SECOND, "SECOND": SECOND}
    made: Callable[[Gate], Callable[..., bool]] = compile_function(source, names, "gate")
    return made
