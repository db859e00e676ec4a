"""What a goal may use, and what it has used."""

import os
from time import monotonic
from typing import Any, Dict, List, NamedTuple, Optional, Tuple

from ..terms import Term
from ..watching import WATCH
from .faults import PrologError, resource_error

SLICE = (None,) * 1024
"""Steps between two looks at the limits."""

LOOP = (None,) * 256
"""Turns of a loop inside one step."""

_MEASURE_EVERY = 0.005
"""Seconds between two looks at the memory in use."""


class Limits(NamedTuple):
    """What a goal may use; None means without limit.

    Attributes:
        seconds: of wall time.
        inferences: calls of predicates, and steps of walks over large terms (counted by the thousand).
        megabytes: growth of the process's resident memory.
    """

    seconds: Optional[float] = None
    inferences: Optional[int] = None
    megabytes: Optional[int] = None


NO_LIMITS = Limits()


class LimitError(PrologError):
    """A limit has run out.

    Attributes:
        final: whether no program can catch it.
    """

    final = False


class LimitPassed(LimitError):
    """The ball of a call that has a limit of its own.

    Attributes:
        kind: what is limited.
        open: whether the call still runs; then whoever stops for the error is not the one whose limit it was.
        kept_back: whether somebody inside the call stopped for it and the call went on.
    """

    def __init__(self, kind: str, term: Term):
        super().__init__(term)
        self.kind = kind
        self.open = True
        self.kept_back = False

    @property
    def message(self) -> str:  # type: ignore[override]
        """What went wrong, as text."""
        if self.open:
            return f"the {self.kind} limit of a call that led here has run out"
        return super().message

    def close(self) -> None:
        """Note that the call is over."""
        self.open = False

    def deliver(self) -> None:
        """Throw the ball after all where the call exits and somebody inside had kept it back."""
        if self.kept_back:
            raise self


def keep_back(error: Exception) -> None:
    """Note that somebody stops for an error and goes on; where it is the limit of a call around, that ends later."""
    if isinstance(error, LimitPassed):
        error.kept_back = error.open


class Budget:
    """What the goals of one machine have used and may still use.

    Attributes:
        limits: of each outermost run and each attempt.
        limited: whether there are any.
        inferences: all that were counted.
        alarms: times (of the monotonic clock) with what is to be thrown then.
        ceilings: counts of inferences with what is to be thrown past them.
        used: whether anything was counted since `start_anew`.
        running: whether a run is under way that has limits.
    """

    def __init__(self) -> None:
        self.allow(NO_LIMITS)
        self.running = False
        self._ask = self.look
        self.inferences = 0
        self.alarms: List[Tuple[float, LimitPassed]] = []
        self._loops = 0  # inferences that are not counted yet, in units of `LOOP`
        self._spent = 0
        self._measured = 0.0
        self._deadline: Optional[float] = None
        self._memory: Optional[int] = None
        self._exceeded = False
        self.ceilings: Dict[int, LimitPassed] = {}
        self.used = False

    def allow(self, limits: Limits) -> None:
        """Set what each outermost run and each attempt may use."""
        self._spent = 0
        self.limits = limits
        self.limited = limits != NO_LIMITS

    def enter(self) -> Any:
        """Begin a run with limits; return what `leave` needs at its end.

        Long steps look at the limits too, see `watching`. A run inside another, of a goal that a rule asks in
        between, say, has the limits to itself.
        """
        if self.running:
            return self.part()
        self.running = True
        before = WATCH.ask
        WATCH.ask = self._ask
        return before

    def leave(self, saved: Any) -> None:
        """End a run with limits."""
        if saved.__class__ is tuple:
            self.whole(saved)
            return
        self.running = False
        WATCH.ask = saved
        if self.used:
            self.start_anew()

    def start_anew(self) -> None:
        """Forget what an outermost run has used."""
        self._spent = 0
        self._deadline = None
        self._exceeded = False
        self._memory = None
        self.used = False
        self.alarms.clear()
        self.ceilings.clear()

    def state(self) -> Any:
        """Return how things are, for `restore`."""
        parts = self._spent, self._deadline, self._exceeded, self._memory
        return self.running, WATCH.ask, parts, len(self.alarms), tuple(self.ceilings)

    def restore(self, state: Any) -> None:
        """Go back to how things were, or to nothing that runs with None, whatever an interrupt has left."""
        if state is None:
            self.running = False
            if WATCH.ask == self._ask:
                WATCH.ask = None
            self.start_anew()
            return
        self.running, WATCH.ask, parts, alarms, ceilings = state
        self._spent, self._deadline, self._exceeded, self._memory = parts
        del self.alarms[alarms:]
        self.ceilings = {at: error for at, error in self.ceilings.items() if at in ceilings}

    def part(self) -> Any:
        """Begin a part that has the limits to itself; return what `whole` needs at its end."""
        saved = self._spent, self._deadline, self._exceeded
        self.used = True
        self._spent = 0
        self._deadline = None
        self._exceeded = False
        return saved

    def whole(self, saved: Any) -> None:
        """End a part: what it used counts for what is around it."""
        spent, self._deadline, self._exceeded = saved
        self._spent += spent

    def warn_at(self, instant: float, error: LimitPassed) -> None:
        """Have an error thrown past an instant of the monotonic clock."""
        self.used = True
        self.alarms.append((instant, error))

    def warn_past(self, ceiling: int, error: LimitPassed) -> None:
        """Have an error thrown past a count of inferences."""
        self.used = True
        self.ceilings[ceiling] = error

    def cap(self, most: int) -> int:
        """Return a ceiling for some more inferences; no two are the same."""
        ceiling = self.inferences + most
        while ceiling in self.ceilings:
            ceiling += 1
        return ceiling

    def sliced(self) -> None:
        """Count a slice of steps and enforce the limits."""
        self._loops += len(SLICE) // len(LOOP)
        self._enforce()

    def turned(self) -> None:
        """Count the turns of a loop inside a step (as many as `LOOP` is long) and enforce the limits."""
        self._loops += 1
        if self._loops >= len(SLICE) // len(LOOP):
            self._enforce()

    def look(self, work: int) -> None:
        """Count pieces of work inside a step and enforce the limits."""
        self._loops += work // len(LOOP)
        self._enforce()

    def _enforce(self) -> None:
        self.used = True
        steps = self._loops * len(LOOP)
        self._loops = 0
        self.inferences += steps
        self._spent += steps
        limits = self.limits
        if self.ceilings:
            for ceiling, error in self.ceilings.items():
                if self.inferences > ceiling:
                    raise error
        if not self.limited and not self.alarms:
            return
        if limits.inferences is not None and self._spent > limits.inferences:
            self._exceed("inferences")
        now = monotonic()
        for at, error in self.alarms:
            if now > at:
                raise error
        if limits.seconds is not None:
            if self._deadline is None:
                self._deadline = now + limits.seconds
            elif now > self._deadline:
                self._exceed("seconds")
        if limits.megabytes is not None and now > self._measured + _MEASURE_EVERY:
            self._measured = now
            used = _resident_bytes()
            if self._memory is None:
                self._memory = used + (limits.megabytes << 20)
            elif used > self._memory:
                self._exceed("memory")

    def _exceed(self, what: str) -> None:
        # A handler of the program gets a tenth more, so that it can clean up, and no second time.
        self._spent -= (self.limits.inferences or 0) // 10
        self._deadline = None
        self._memory = None
        error = LimitError(resource_error(what).term)
        error.final = self._exceeded
        self._exceeded = True
        raise error


_PAGE = os.sysconf("SC_PAGE_SIZE") if hasattr(os, "sysconf") else 4096


def _resident_bytes() -> int:
    try:
        with open("/proc/self/statm", "rb") as file:
            return int(file.read().split()[1]) * _PAGE
    except OSError:  # a system without /proc has no memory limit
        return 0
