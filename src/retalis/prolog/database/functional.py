"""Predicates that are functions of some of their arguments."""

from typing import Any, Callable, NamedTuple, Optional, Tuple

from ..compiler import Joins
from ..machine import Machine
from ..terms import Term, unify


class Functional(NamedTuple):
    """A deterministic predicate given by a function from input arguments to the other, output arguments.

    Compiled clauses unify the outputs in line: what no goal looks at is never made, and a variable that
    is new there becomes a name for the value, without a binding.

    Attributes:
        function: takes the inputs; returns the only output, or a tuple of all, or None where it fails.
        inputs: positions of the inputs among the arguments.
        outputs: positions of the outputs.
        shows: what makes the term of each output from what the function returned, None where it is the term.
        single: whether there is one output, which is returned as such.
        joins: what tells which goals after one of it go together with it, see `compiler.joining`.
    """

    function: Callable[..., Any]
    inputs: Tuple[int, ...]
    outputs: Tuple[int, ...]
    shows: Tuple[Optional[Callable[..., Term]], ...]
    single: bool
    joins: Optional[Joins] = None

    def predicate(self) -> Callable[..., bool]:
        """Return the predicate as `Logic.define` takes it."""
        function, inputs, single = self.function, self.inputs, self.single
        outputs = tuple(zip(self.outputs, self.shows))

        def call(machine: Machine, *args: Term) -> bool:
            found = function(*[args[at] for at in inputs])
            if found is None:
                return False
            for value, (at, show) in zip((found,) if single else found, outputs):
                if not unify(args[at], value if show is None else show(value), machine.trail):
                    return False
            return True

        return call


def functional(
    function: Callable[..., Any],
    arity: int,
    outputs: Tuple[int, ...] = (),
    shows: Tuple[Optional[Callable[..., Term]], ...] = (),
) -> Functional:
    """Return the description of a function; without ``outputs`` the last argument is the only one."""
    single = not outputs
    outputs = outputs or (arity - 1,)
    inputs = tuple(at for at in range(arity) if at not in outputs)
    return Functional(function, inputs, outputs, shows or (None,) * len(outputs), single)
