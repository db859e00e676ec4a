"""What an event or a question may use with all that it starts, and the errors of what has used more.

What an event or a question has used with all that it started.
"""

import os
from contextlib import contextmanager
from threading import get_ident
from time import monotonic
from typing import (
    Any,
    Callable,
    Dict,
    Iterable,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Protocol,
    Tuple,
    Type,
    TypeVar,
    Union,
)

from ...foundation.cancellation import WATCH, watch_for
from ...foundation.errors import UsageError, shortened
from ..terms.types import Term
from .errors import PrologError, resource_error

SLICE = (None,) * 1021
"""Steps between two looks at the limits: a prime, so that no loop is always looked at at the same step of it."""

LOOP = (None,) * 256
"""Turns of a loop inside one step."""


MEGABYTE = 1_000_000
"""Bytes of a megabyte, wherever a limit is given in megabytes."""

MAX_LIMIT = 1e9
"""The largest number of seconds or megabytes that a limit may be: 31 years."""

MAX_COUNT = 10**20
"""The largest number of inferences that a limit may be."""

Number = TypeVar("Number", int, float)


def checked_number(name: str, value: object, kind: Type[Number]) -> Number:
    """Return a number of 0 or more that a setting gives.

    Args:
        name: the setting's, for the error.
        value: an ``int`` or a ``float``.
        kind: ``int`` for whole numbers, which may be given as floats (``1e6``).

    Raises:
        UsageError: for anything else: a ``bool``, a text, a negative number, NaN, infinity, or a number that is too
            large for a time.
    """
    largest = MAX_COUNT if kind is int else MAX_LIMIT
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        if 0 <= value <= largest and kind(value) == value:
            return kind(value)
        found = str(value) if abs(value) < 1e300 else "a larger number"
    else:
        found = shortened(repr(value))
    whole = "a whole number" if kind is int else "a number"
    raise UsageError(f"{name}: expected {whole} from 0 to {largest:.0e}, found {found}")


class _LimitFields(NamedTuple):
    seconds: Optional[float]
    inferences: Optional[int]
    megabytes: Optional[float]
    output_megabytes: Optional[float]


class Limits(_LimitFields):
    """What an event or a question may use with all that it starts; None means without limit.

    >>> engine = Engine(settings=Settings(limits=Limits(inferences=10000)))
    >>> engine.load(rules="forever :- forever.")
    >>> engine.call("catch(forever, error(resource_error(_), _), true)")
    True

    Attributes:
        seconds: of wall time.
        inferences: calls of predicates, and steps of walks over large terms (counted by the thousand).
        megabytes: growth of the process's resident memory, in 1,000,000 bytes.
        output_megabytes: what goals write to ``user_output`` and ``user_error`` together, in 1,000,000 bytes; 1 by
            default.

    Raises:
        UsageError: for a limit that is no number from 0 on; it names the limit.
    """

    __slots__ = ()

    def __new__(
        cls,
        seconds: Optional[float] = None,
        inferences: Optional[int] = None,
        megabytes: Optional[float] = None,
        output_megabytes: Optional[float] = 1.0,
    ) -> "Limits":
        """Check the limits and keep them."""
        return super().__new__(
            cls,
            None if seconds is None else checked_number("seconds", seconds, float),
            None if inferences is None else checked_number("inferences", inferences, int),
            None if megabytes is None else checked_number("megabytes", megabytes, float),
            None if output_megabytes is None else checked_number("output_megabytes", output_megabytes, float),
        )

    @classmethod
    def _make(cls, iterable: Iterable[Any]) -> "Limits":  # type: ignore[override]
        """Return limits of four values; ``_replace`` comes here."""
        return cls(*iterable)


NO_LIMITS = Limits(output_megabytes=None)


class Refuses(Protocol):
    """Whose limit has run out, a `Budget`."""

    def close(self, error: "LimitError") -> None:
        """Refuse further goals because of an error."""


class LimitError(PrologError):
    """A limit has run out.

    Attributes:
        final: whether no program can catch it.
        budget: whose limit it is; None for the limit that a program has set for a call.
        what: what has run out.
        refused: whether the goal was not begun any more: that is counted by the budget and reported by it.
    """

    final = False
    budget: Optional[Refuses] = None
    what = ""
    refused = False


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
            return f"the {self.kind} limit of a calling goal has been reached"
        return super().message

    def close(self) -> None:
        """Note that the call is over."""
        self.open = False

    def deliver(self) -> None:
        """Throw the ball after all where the call exits and somebody inside had kept it back."""
        if self.kept_back:
            raise self


def keep_back(error: Exception) -> bool:
    """Note that somebody stops for an error and goes on.

    Where it is the limit of a call around, that ends later; where all is used up that the event may use, its
    further goals are refused.

    Returns:
        Whether the error is to be reported: not for a refused goal, see `Budget.admit`.
    """
    if isinstance(error, LimitPassed):
        error.kept_back = error.open
    elif isinstance(error, LimitError):
        if error.budget is not None:
            error.budget.close(error)
        return not error.refused
    return True


_MEASURE_EVERY = 0.005
"""Seconds between two looks at the memory in use."""


T = TypeVar("T")

Ask = Optional[Callable[[int, int], None]]
"""Whom long steps ask, see `Watch`."""


class Turn(Protocol):
    """Who tells where entries begin and end."""

    entry: object

    @property
    def thread(self) -> Optional[int]:
        """The thread in which there is work at hand; None while there is none."""

    def follow(self, work: Callable[[], None], /) -> None:
        """Do something after the work at hand."""


Meter = Callable[[int], bool]
"""Count steps of pattern work (pairs, items, derived events); return True if pattern work has to stop."""

BudgetState = Tuple[bool, Ask, object, int, Tuple[int, ...]]
"""What runs, see `Budget.state`."""


class Budget:
    """What an entry, an event or a question with all that it starts, has used and may still use.

    Who takes events (the engine) tells by its turns where entries begin and end, see `count_for`. Where nobody
    does, each outermost run of the machine is an entry.

    Attributes:
        limits: of each entry.
        limited: whether the machine has to `enter` each run: there are limits, and nobody says where entries end.
        closed: whether goals have to ask `admit` before they begin.
        turn: says where entries begin and end: its ``thread`` is that in which one is at work, or None; its ``entry``
            tells it from others: what came in.
        goal: what is being asked, a `CompiledGoal` or a term; None while only patterns are at work.
        inferences: all that were counted.
        alarms: times (of the monotonic clock) with what is to be thrown then.
        ceilings: counts of inferences with what is to be thrown past them.
        used: whether there is anything to forget at the end of the entry.
        rounds: how often the entry may use its seconds: once more when a program may have caught the first error.
        refused: how many goals of the entry were refused.
        metered: whether rules count their pattern work: not in an engine that has no limits.
        pattern_steps: the number of steps of pattern work until the limits are checked again, negative from then on;
            one item of a list that never changes, as code has bound it.
        stopped: the rule that was at work when a limit stopped the pattern work of the entry, and the limit; or None.
        left_out: steps of pattern work that the entry has not done since then.
        on_new: called where what an entry has used is forgotten.
        on_refused: told at the end of an entry how many goals were refused, what had run out, and the entry.
        on_stopped: called at the end of an entry whose pattern work was stopped, with the rule, the limit, the steps
            left out, and the entry.
        running: whether a run is under way that was entered.
    """

    def __init__(self) -> None:
        self.turn: Optional[Turn] = None
        self.goal: object = None
        self.on_new: Callable[[], None] = lambda: None
        self.on_refused: Callable[[int, str, object], None] = lambda number, what, entry: None
        self.on_stopped: Callable[[object, str, int, object], None] = lambda rule, what, steps, entry: None
        self.metered = False
        self.pattern_steps = [0]
        self.allow(NO_LIMITS)
        self.running = False
        self._ask = self.look
        self.inferences = 0
        self.alarms: List[Tuple[float, LimitPassed]] = []
        self.ceilings: Dict[int, LimitPassed] = {}
        self._steps = 0  # that are not counted as inferences yet
        self._measured = 0.0
        self._expired: object = None
        self._entry: object = None  # that of the turn when it was first used
        self.start_anew()

    def allow(self, limits: Limits) -> None:
        """Set what each entry may use."""
        self._spent = 0
        self.limits = limits
        # what steps look at; output is counted where it is written
        self._bounded = limits[:3] != NO_LIMITS[:3]
        # Steps since the last check may be those of earlier entries: a small part of the limit, at most.
        most = len(SLICE) if limits.inferences is None else int(limits.inferences) // 8
        self._pattern_slice = self.pattern_steps[0] = min(len(SLICE), max(1, most))
        self.limited = limits != NO_LIMITS and self.turn is None

    def count_for(self, turn: Turn) -> None:
        """Take the pieces of work of a turn (see `turn`) for entries; ``turn.follow`` does something after one."""
        self.turn = turn
        self.metered = self._bounded
        self.limited = False
        watch_for(self)

    @property
    def at_work(self) -> bool:
        """Whether an entry of a turn is at work."""
        return self.turn is not None and self.turn.thread is not None

    @property
    def runs_here(self) -> bool:
        """Whether a goal of an entry of a turn runs in this thread."""
        return self.goal is not None and self.turn is not None and self.turn.thread == get_ident()

    # Entries

    def enter(self) -> "Union[Ask, _Inside]":
        """Begin a run with limits; return what `leave` needs at its end.

        Long steps look at the limits too, see `watching`. A run inside another belongs to that.
        """
        if self.running:
            return _INSIDE
        self.running = True
        before = WATCH.ask
        WATCH.ask = self._ask
        return before

    def leave(self, saved: "Union[Ask, _Inside]") -> None:
        """End a run with limits."""
        if isinstance(saved, _Inside):
            return
        self.running = False
        WATCH.ask = saved
        if self.used:
            self.start_anew()

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Have long work on a solution of a goal count for the goal."""
        before = WATCH.ask
        WATCH.ask = self._ask
        try:
            yield
        finally:
            WATCH.ask = before

    def start_anew(self) -> None:
        """Forget what an entry has used."""
        self._begin()
        self.alarms.clear()
        self.ceilings.clear()
        self.on_new()

    def state(self) -> BudgetState:
        """Return what runs, for `restore`."""
        return self.running, WATCH.ask, self.goal, len(self.alarms), tuple(self.ceilings)

    def restore(self, state: Optional[BudgetState]) -> None:
        """Go back to what ran, or to nothing that runs with None, whatever an interrupt has left."""
        if state is None:
            self.running = False
            self.goal = None
            if WATCH.ask == self._ask:
                WATCH.ask = None
            self.end()
            return
        self.running, WATCH.ask, self.goal, alarms, ceilings = state
        del self.alarms[alarms:]
        self.ceilings = {at: error for at, error in self.ceilings.items() if at in ceilings}

    def _begin(self) -> None:
        self.used = False
        self._spent = 0
        self._printed = 0  # bytes of output
        self._deadline: Optional[float] = None
        self._memory: Optional[int] = None
        self.rounds = 1
        self.refused = 0
        self._out: Optional[str] = None  # what has run out, so that goals are refused
        self.closed = False
        self.stopped: Optional[Tuple[object, str]] = None
        self.left_out = 0
        if self.pattern_steps[0] < 0:
            self.pattern_steps[0] = self._pattern_slice

    def end(self) -> None:
        """End an entry: report what was refused and left out, and forget what it has used."""
        self._report()
        self.start_anew()

    def _report(self) -> None:
        """Report the goals of the entry that were refused, and the pattern work that was left out."""
        if self.refused and self._out is not None:
            self.on_refused(self.refused, self._out, self._entry)
        if self.stopped is not None:
            self.on_stopped(*self.stopped, self.left_out, self._entry)

    def apart(self, entry: object, work: Callable[[], T]) -> T:
        """Return what work returns; it is an entry of its own, in the midst of another of a turn."""
        turn = self.turn
        assert turn is not None
        outer = turn.entry, self.goal
        kept = [getattr(self, name) for name in _OF_ENTRY] if self.used else None
        if kept is not None:
            self._begin()
        turn.entry, self.goal = entry, None
        try:
            return work()
        finally:
            turn.entry, self.goal = outer
            if self.used:
                self._report()
                self._begin()
            if kept is not None:
                for name, value in zip(_OF_ENTRY, kept):
                    setattr(self, name, value)
                if self.stopped is not None:
                    self.pattern_steps[0] = -1

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Have nothing that the entry at hand waits for meanwhile (a user) count for it; it may use as much again."""
        turn = self.turn
        assert turn is not None
        what: Any
        what, turn.entry = turn.entry, None
        try:
            yield
        finally:
            turn.entry = None if what is None else (*what, None)  # another one, of the same name
            self._begin()

    # Goals of entries

    def admit(self) -> None:
        """Raise an error where all is used up that the entry may use: a goal is not begun then."""
        if self._out is not None:
            self.refused += 1
            error = self._error(self._out)
            error.final = error.refused = True
            raise error
        self.closed = False
        past = self._past(monotonic())
        if past is not None:
            raise self._exceeded(past)

    def close(self, error: LimitError) -> None:
        """Refuse further goals of the entry, because of an error that ended one of them."""
        self._use()
        self.closed = True
        if self._out is None:
            self._out = error.what

    def expire(self, entry: object) -> None:
        """Note that an entry has used its seconds, if it is still at work; any thread may call this."""
        self._expired = entry
        self.closed = True
        if self.goal is None:  # else the goal at work is over first
            self.pattern_steps[0] = -1

    # Pattern work of entries

    def meter(self, rule: object) -> Optional[Meter]:
        """Return the function that counts the pattern work of a rule; None if nothing is counted.

        Pattern work is not ended by an error, which would leave matches half joined: wherever it counts it stops by
        itself when the function returns True, and from then on no rule derives an event from what came in.
        """
        if not self.metered:
            return None

        pattern_steps = self.pattern_steps

        def count(steps: int) -> bool:
            pattern_steps[0] = left = pattern_steps[0] - steps
            return left < 0 and self.stops(rule)

        return count

    def stops(self, rule: object) -> bool:
        """Check the limits, the steps until the next check being used up; return True if pattern work has to stop."""
        if self.stopped is None:
            self._steps += max(0, self._pattern_slice - self.pattern_steps[0])
            self._count()
            past = self._past(monotonic()) if self._bounded else None
            if past is None:
                self.pattern_steps[0] = self._pattern_slice
                return False
            self.stopped = rule, past
            self.close(self._error(past))
            self.pattern_steps[0] = -1
        self.left_out += 1
        return True

    # Limits of calls

    def warn_at(self, instant: float, error: LimitPassed) -> None:
        """Have an error thrown past an instant of the monotonic clock."""
        self._use()
        self.alarms.append((instant, error))

    def warn_past(self, ceiling: int, error: LimitPassed) -> None:
        """Have an error thrown past a count of inferences."""
        self._use()
        self.ceilings[ceiling] = error

    def cap(self, most: int) -> int:
        """Return a ceiling for some more inferences; no two are the same."""
        ceiling = self.inferences + most
        while ceiling in self.ceilings:
            ceiling += 1
        return ceiling

    # Counting

    def sliced(self) -> None:
        """Count a slice of steps and enforce the limits."""
        self._steps += len(SLICE)
        self._enforce()

    def turned(self) -> None:
        """Count the turns of a loop inside a step (as many as `LOOP` is long) and enforce the limits."""
        self._steps += len(LOOP)
        if self._steps >= len(SLICE):
            self._enforce()

    def look(self, work: int, size: int = 0) -> None:
        """Count pieces of work inside a step and enforce the limits, with room for so many more bytes."""
        self._steps += work
        self._enforce(size)

    def ended(self, steps: int) -> None:
        """Count the steps of a run that is over; past a limit the next goal is not begun."""
        self._steps += steps
        if self._steps >= len(SLICE):
            self._count()
            if self._bounded and self._past(monotonic()) is not None:
                self.closed = True

    def count_output(self, size: int) -> None:
        """Count bytes that are about to be written to the user's streams.

        Raises:
            LimitError: if the entry may not write as many. A handler may write a tenth more.
        """
        most = self.limits.output_megabytes
        if most is None or not (self.running or self.at_work):
            return
        self._use()
        if self._printed + size > most * MEGABYTE * (1.0 if self.rounds == 1 else 1.1):
            raise self._exceeded("output")
        self._printed += size

    def left(self) -> "Optional[Left]":
        """Return what a step that cannot look at the limits by itself may use; None where nothing is limited.

        Raises:
            PrologError: where a limit has been passed already.
        """
        if not (self._bounded or self.alarms or self.ceilings):
            return None
        self._enforce()
        if self._memory is None and self.limits.megabytes is not None:
            self._memory = resident_bytes() + int(self.limits.megabytes * MEGABYTE)
        if not self.alarms and not self.ceilings and self.limits.inferences is None:
            return Left(self._deadline, None, self._memory)
        times = [at for at, _ in self.alarms]
        if self._deadline is not None:
            times.append(self._deadline)
        inferences = [ceiling - self.inferences for ceiling in self.ceilings]
        if self.limits.inferences is not None:
            inferences.append(self.limits.inferences - self._spent)
        return Left(min(times, default=None), min(inferences, default=None), self._memory)

    def _use(self) -> None:
        """Note that there is something to forget at the end of the entry."""
        if not self.used:
            self.used = True
            turn = self.turn
            if turn is not None and turn.thread is not None:
                self._entry = turn.entry
                turn.follow(self.end)

    def _count(self) -> None:
        self._use()
        steps = self._steps
        self._steps = 0
        self.inferences += steps
        self._spent += steps

    def _enforce(self, size: int = 0) -> None:
        self._count()
        if self.ceilings:
            for ceiling, error in self.ceilings.items():
                if self.inferences > ceiling:
                    raise error
        if not self._bounded and not self.alarms:
            return
        now = monotonic()
        for at, error in self.alarms:
            if now > at:
                raise error
        past = self._past(now, size)
        if past is None:
            return
        if self.goal is None and self.at_work:
            self.close(self._error(past))  # patterns are at work: they stop where they count
            self.pattern_steps[0] = -1
        else:
            raise self._exceeded(past)

    def _past(self, now: float, size: int = 0) -> Optional[str]:
        """Return the limit that the entry is past, or would be with so many more bytes; None for none."""
        self._use()
        limits = self.limits
        if limits.inferences is not None and self._spent > limits.inferences:
            return "inferences"
        if limits.seconds is not None:
            if self._deadline is None:
                self._deadline = now + limits.seconds
            elif now > self._deadline:
                return "seconds"
            if self._expired is not None and self.turn is not None and self._expired is self.turn.entry:
                return "seconds"
        if limits.megabytes is not None and (size or now > self._measured + _MEASURE_EVERY):
            self._measured = now
            used = resident_bytes()
            if self._memory is None:
                self._memory = used + int(limits.megabytes * MEGABYTE)
            if used + size > self._memory:
                return "memory"
        return None

    def _exceeded(self, what: str) -> LimitError:
        error = self._error(what)
        error.final = self.rounds > 1
        self.closed = self._out is not None  # who gets the error knows by it
        if error.final:  # whoever looks from now on gets it again: to swallow it gains nothing
            return error
        # A handler gets a tenth more inferences, and as much again of all else, so that it can clean up.
        self.rounds = 2
        self._spent -= (self.limits.inferences or 0) // 10
        self._deadline = None
        self._memory = None
        self._expired = None
        return error

    def _error(self, what: str) -> LimitError:
        error = LimitError(resource_error(what).term)
        error.budget, error.what = self, what
        return error


class Left(NamedTuple):
    """What may still be used: up to an instant of the monotonic clock, inferences, bytes of the whole process."""

    until: Optional[float]
    inferences: Optional[int]
    memory: Optional[int]


class _Inside:
    """What `Budget.enter` returns for a run inside another."""


_INSIDE = _Inside()

_OF_ENTRY = (
    "rounds",
    "refused",
    "closed",
    "used",
    "_entry",
    "_spent",
    "_printed",
    "_deadline",
    "_memory",
    "_out",
    "stopped",
    "left_out",
)
"""The attributes of a budget that tell what an entry has used."""

_PAGE = os.sysconf("SC_PAGE_SIZE") if hasattr(os, "sysconf") else 4096


def resident_bytes() -> int:
    """Return the bytes of memory that the process has; 0 where the system does not tell."""
    try:
        with open("/proc/self/statm", "rb") as file:
            return int(file.read().split()[1]) * _PAGE
    except OSError:  # a system without /proc has no memory limit
        return 0
