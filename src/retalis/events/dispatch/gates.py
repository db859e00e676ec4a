"""Gates: who is about to make an event asks whether it can concern anybody, before it is made.

A message that is taken apart gives many events of which few are wanted. A gate tells from the arguments that
are at hand already, by the same tests that the dispatcher makes, which events nobody listens to.
"""

from typing import Any, Callable, Dict, Hashable, List, Optional, Tuple

from ...foundation import shared_function
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

    __slots__ = ("plan", "passes", "_positions", "_walk", "__weakref__")

    plan: Optional[Plan]
    passes: Passes

    def __init__(self, positions: Tuple[int, ...], plan: Optional[Plan]):
        self._positions = positions
        self._walk = _walking(positions)(self)
        self.set(plan)

    def set(self, plan: Optional[Plan]) -> None:
        """Take the dispatcher's plan, or None where that is not known any more."""
        self.plan = plan
        self.passes = self._walk
        if isinstance(plan, Choice) and plan.at in self._positions and not plan.any:
            self.passes = _looking(self._positions, plan.at)(plan.table, self._walk)


_TIME = (
    "seconds.__class__ is nanoseconds.__class__ is int and 0 <= seconds < LAST and 0 <= nanoseconds < SECOND"
)
_NAMES = {"Choice": Choice, "Atom": Atom, "NOBODY": NOBODY, "LAST": LAST // SECOND, "SECOND": SECOND}


def _parameters(positions: Tuple[int, ...]) -> str:
    return ", ".join(["seconds", "nanoseconds", *[f"a{at}" for at in positions]])


def _walking(positions: Tuple[int, ...]) -> Callable[[Gate], Passes]:
    """Return what makes the function of a gate: it walks the plan as far as known arguments are tested."""
    lines = [f"    def passes({_parameters(positions)}):", "        plan = gate.plan"]
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
    lines.append(f"        return plan is not NOBODY or not ({_TIME})")
    made: Callable[[Gate], Passes] = _made("gate", lines)
    return made


def _looking(
    positions: Tuple[int, ...], at: int
) -> Callable[[Dict[Hashable, Optional[Plan]], Passes], Passes]:
    """Return what makes a function that first looks whether anybody wants the constant at one place.

    Walking the plan for each would take 3 % more of the NAO's instructions.
    """
    lines = [
        f"    def passes({_parameters(positions)}):",
        f"        if a{at}.__class__ is Atom and a{at} not in table and {_TIME}:",
        "            return False",
        f"        return walk({_parameters(positions)})",
    ]
    made: Callable[[Dict[Hashable, Optional[Plan]], Passes], Passes] = _made("table, walk", lines)
    return made


def _made(parameters: str, lines: List[str]) -> Any:
    source = "\n".join([f"def made({parameters}):", *lines, "    return passes", ""])
    return shared_function(source, _NAMES, "gate")
