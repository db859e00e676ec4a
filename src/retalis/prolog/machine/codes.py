"""Steps and choice points: what frames run. See `machine`."""

from typing import Any, Callable, Optional, Protocol

from ..terms import Frame, Functor, Step, Values


class Takes(Protocol):
    """What a frame begins with that a goal hands its outputs to."""

    def take(self, frame: Frame, outputs: Values, /) -> Optional[Frame]:
        """Take the outputs of a solution; return the frame to go on with, or None for the next solution."""


class Asked(Protocol):
    """A `CompiledGoal`, as far as the machine knows it."""

    @property
    def straight(self) -> Optional[Callable[..., Any]]:
        """Its function, which returns its outputs, None, or `BAIL`; None where there is none."""

    def bail(self) -> None:
        """Note that its function could not tell."""

    def enter(self, values: Values, collector: Frame, /) -> Frame:
        """Return the frame that runs it and hands its outputs to a `Takes`."""


BAIL = object()
"""What the function of a `CompiledGoal` returns where the goal has to be run by frames after all."""

LAST = object()
"""What a nondeterministic built-in yields at a solution after which there is surely none."""


class Code:
    """A step given by a Python function.

    Attributes:
        name: for errors.
        run: does the step.
        functor: of what is run, for errors.
        steady: whether the step leaves the stack of choice points alone, so that it may be done before a run,
            see `Machine.check`.
        closes: whether it is that of a choice point below a goal whose solutions are taken together, or which is
            over when it has one: a call in the goal cannot go on after that.
        dropped: called with a choice point that is cut, where the interpreter does not end by itself what it alone
            holds.
    """

    __slots__ = ("name", "run", "functor", "steady", "closes", "dropped")

    def __init__(self, name: str, run: Step, closes: bool = False):
        self.name = name
        self.closes = closes
        self.run = run
        self.functor: Optional[Functor] = None
        self.steady = False
        self.dropped: Optional[Callable[[Frame], None]] = None

    def __repr__(self) -> str:
        return f"<{self.name}>"


class Guard(Code):
    """A choice point that has to be told when it goes, by failure or by an exception.

    Args:
        name: for errors.
        unwind: called with the choice point. Where a goal exits, whoever cuts the choice point calls it.
    """

    __slots__ = ("unwind",)

    def __init__(self, name: str, unwind: Callable[[Frame], None]):
        super().__init__(name, unwind, True)
        self.unwind = unwind


def drop(entry: Frame) -> None:
    """End what only a choice point has held that was cut."""
    dropped = getattr(entry[0], "dropped", None)  # of a `Code`; whatever else does steps holds nothing
    if dropped is not None:
        dropped(entry)


def fail(frame: Frame) -> None:
    """Fail: what a choice point without another solution does."""
    return


STOP = Code("stop", fail, True)
"""Choice point below a run: reached when the run has no (more) solution."""

DEAD = Code("dead", fail)
"""Choice point that was taken back where the stack could not be cut."""

RESUME = Code("resume", lambda frame: frame[1], True)
"""Choice point that goes on with the frame that it holds."""


class CatchMark:
    """State of a ``catch/3``; goes on the trail when its goal has exited, so that backtracking reopens it."""

    __slots__ = ("ref",)

    def __init__(self) -> None:
        self.ref: Optional[bool] = None
