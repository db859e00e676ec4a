"""Resource limits of events and queries: seconds, inferences, memory and output.

An *entry* is a unit of accounting: an event or a query with everything that it starts. Each entry may use what
`Limits` allows, and `Budget` counts it. An engine announces entries by its executor (`EntryExecutor`);
without an engine, each outermost run of the machine is an entry.

The machine counts steps in slices of `SLICE` and checks the limits after each slice, so counting costs nothing for a
single step. Long steps (sorting, copying a large term) call `check_limits`, which counts their work and checks the
limits as well.

If an entry exceeds a limit:

1. The goal throws `LimitError`. A program may catch the first one; its handler may use a tenth more inferences, and
   the other limits once again, to clean up.
2. The next error is *final*: no program can catch it.
3. Further goals of the entry are refused (`Budget.check_entry`), counted, and reported together at the end.
4. Pattern matching is not interrupted by an exception, which would leave a partial match half joined. It stops at the
   points where it counts its work (`Budget.meter`).

An interrupt (`foundation.interrupts`) acts like a limit whose first error is final: the goal ends, further goals are
refused, and pattern matching stops. The executor raises it at the end of the entry.

Limits of a single call (``call_with_time_limit/2`` and similar) are *alarms* (instants) and *ceilings* (counts of
inferences) in the budget; they throw `CallLimitError`.
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

from ...foundation.callbacks import CallbackList
from ...foundation.displayed_text import quote_shortened
from ...foundation.errors import UsageError
from ...foundation.interrupts import PENDING, are_deferred, is_interrupted, postpone, raise_pending
from ...foundation.limit_checks import CURRENT_CHECK, register_check
from ..terms.types import Term
from .errors import PrologError, resource_error

SLICE = (None,) * 1021
"""Steps between two checks of the limits. The number is prime, so that the checks of a loop fall on different
steps of it."""

LOOP = (None,) * 256
"""Iterations of a loop within one step, between two checks."""


MEGABYTE = 1_000_000
"""Bytes in a megabyte, for all limits that are given in megabytes."""

MAX_LIMIT = 1e9
"""Largest limit of seconds (31 years) or megabytes."""

MAX_COUNT = 10**20
"""Largest limit of inferences."""

Number = TypeVar("Number", int, float)


def validate_limit(name: str, value: object, number_type: Type[Number]) -> Number:
    """Return the non-negative number that a setting contains.

    Args:
        name: the name of the setting, for the error message.
        value: an ``int`` or a ``float``.
        number_type: ``int`` for whole numbers, which may be given as floats (``1e6``).

    Raises:
        UsageError: for any other value: a ``bool``, a text, a negative number, NaN, infinity, or a number above the
            maximum.
    """
    maximum = MAX_COUNT if number_type is int else MAX_LIMIT
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        if 0 <= value <= maximum and number_type(value) == value:
            return number_type(value)
        value_text = "a larger number" if abs(value) >= 1e300 else str(value)
    else:
        value_text = quote_shortened(repr(value))
    expected = "a whole number" if number_type is int else "a number"
    raise UsageError(f"{name}: expected {expected} from 0 to {maximum:.0e}, found {value_text}")


class _LimitFields(NamedTuple):
    seconds: Optional[float]
    inferences: Optional[int]
    megabytes: Optional[float]
    output_megabytes: Optional[float]


class Limits(_LimitFields):
    """Resource limits of an event or a query, with everything that it starts; None means no limit.

    >>> engine = Engine(settings=Settings(limits=Limits(inferences=10000)))
    >>> engine.load(rules="forever :- forever.")
    >>> engine.call("catch(forever, error(resource_error(_), _), true)")
    True

    Attributes:
        seconds: wall time.
        inferences: calls of predicates, and steps of walks over large terms (counted in thousands).
        megabytes: growth of the process's resident memory, in 1,000,000 bytes.
        output_megabytes: output of goals to ``user_output`` and ``user_error`` together, in 1,000,000 bytes; 1 by
            default.

    Raises:
        UsageError: if a limit is not a number from 0 on; the message names it.
    """

    __slots__ = ()

    def __new__(
        cls,
        seconds: Optional[float] = None,
        inferences: Optional[int] = None,
        megabytes: Optional[float] = None,
        output_megabytes: Optional[float] = 1.0,
    ) -> "Limits":
        """Validate the limits and store them."""
        return super().__new__(
            cls,
            None if seconds is None else validate_limit("seconds", seconds, float),
            None if inferences is None else validate_limit("inferences", inferences, int),
            None if megabytes is None else validate_limit("megabytes", megabytes, float),
            None if output_megabytes is None else validate_limit("output_megabytes", output_megabytes, float),
        )

    @classmethod
    def _make(cls, iterable: Iterable[Any]) -> "Limits":  # type: ignore[override]
        """Return limits from four values; called by ``_replace``."""
        return cls(*iterable)


NO_LIMITS = Limits(output_megabytes=None)


class LimitError(PrologError):
    """A limit has been exceeded.

    Attributes:
        is_final: whether no program can catch the error.
        budget: the budget that has the limit; None for a limit that a program has set for a call.
        was_refused: whether the goal was not started. The budget counts and reports such goals.
    """

    is_final = False
    budget: "Optional[Budget]" = None
    limit_name = ""
    was_refused = False


class CallLimitError(LimitError):
    """Error of a call that has a limit, such as ``call_with_time_limit/2``.

    Attributes:
        limit_name: "time" or "inference".
        is_call_running: whether the call is still running. If it is, the code that receives the error is inside the
            call, and is not the one that has set the limit.
        was_caught: whether code inside the call has caught the error and the call has continued.
    """

    def __init__(self, limit_name: str, term: Term):
        super().__init__(term)
        self.limit_name = limit_name
        self.is_call_running = True
        self.was_caught = False

    @property
    def message(self) -> str:  # type: ignore[override]
        """The text of the error."""
        if self.is_call_running:
            return f"the {self.limit_name} limit of a calling goal has been reached"
        return super().message

    def record_end(self) -> None:
        """Record that the call has ended."""
        self.is_call_running = False

    def raise_if_caught(self) -> None:
        """Throw the error when the call exits, if code inside the call had caught it."""
        if self.was_caught:
            raise self


def record_caught_error(error: Exception) -> bool:
    """Record that the caller catches an error and continues.

    The limit of an outer call ends that call later. If the entry has exceeded a limit, its further goals are refused.

    Returns:
        Whether to report the error; false for a refused goal, see `Budget.check_entry`.
    """
    if isinstance(error, CallLimitError):
        error.was_caught = error.is_call_running
    elif isinstance(error, LimitError):
        if error.budget is not None:
            error.budget.refuse_goals(error)
        return not error.was_refused
    return True


INTERRUPT = "interrupt"
"""Name in place of a limit's, if the entry ends because an exception has to leave the engine."""

_MEMORY_CHECK_INTERVAL_SECONDS = 0.005
"""Time between two measurements of resident memory."""


T = TypeVar("T")

LimitCheck = Optional[Callable[[int, int], None]]
"""The function that long steps call to check limits; see `foundation.limit_checks`."""


Meter = Callable[[int], bool]
"""Counts steps of pattern matching (pairs, items, derived events); returns True if pattern matching has to stop."""

BudgetState = Tuple[bool, LimitCheck, object, int, Tuple[int, ...]]
"""The running goals of a budget; see `Budget.snapshot`."""


class EntryExecutor(Protocol):
    """Executor of the units of work that are entries.

    Attributes:
        entry: identity of the current work.
    """

    entry: object

    @property
    def thread(self) -> Optional[int]:
        """The working thread; None if the executor is idle."""

    def replace_entry(self, entry: object) -> object:
        """Set the identity of the current work; return the previous one."""

    def call_next(self, work: Callable[[], object]) -> None:
        """Schedule work directly after the current one."""

    def begin_callback(self, name: str) -> Optional[Tuple[str]]:
        """Record that a callback of the user runs; return the outer one, for `end_callback`."""

    def end_callback(self, outer_callback: Optional[Tuple[str]]) -> None:
        """Record that a callback has ended."""


class Budget:
    """Resource use and limits of the current entry: an event or query with everything that it starts.

    An engine announces entries by its executor. Without an engine, each outermost run of the
    machine is an entry.

    Args:
        limits: the limits of each entry.
        executor: announces entries: each unit of its work is one, after which the use of resources is reset.

    Attributes:
        limits: the limits of each entry.
        limited: whether the machine must `enter` each run, because limits are set and no engine announces entries.
        needs_check: whether goals must call `check_entry` before they start.
        executor: announces entries. Its ``thread`` processes one, or is None; its ``entry`` identifies it.
        goal: the running goal, a `CompiledGoal` or a term; None while only patterns are matched.
        inferences: inferences since the start.
        alarms: instants of the monotonic clock (s), with the errors to throw after them.
        ceilings: counts of inferences, with the errors to throw above them.
        has_use: whether the entry has used resources, which must be reset at its end.
        allowance_count: 1, or 2 if the entry has exceeded a limit and may use its limits once again to clean up.
        refused_count: number of refused goals of the entry.
        meters_patterns: whether rules count their pattern matching; false in an engine without limits.
        pattern_steps: steps of pattern matching until the next check of the limits, negative afterwards. The list
            has one item, and is never replaced, because generated code refers to it.
        pattern_stop: the rule that was active when a limit stopped pattern matching, and the limit; or None.
        skipped_pattern_steps: number of steps of pattern matching skipped since then.
        on_reset: called when the use of resources is reset.
        on_refused: called at the end of an entry with the number of refused goals, the exceeded limit, and the entry.
        on_stopped: called at the end of an entry whose pattern matching was stopped, with the rule, the limit, the
            number of skipped steps, and the entry.
        running: whether a run is active for which `enter` has been called.
    """

    def __init__(self, limits: Limits = NO_LIMITS, executor: Optional[EntryExecutor] = None) -> None:
        self.executor = executor
        self.goal: object = None
        self.on_reset: CallbackList[Callable[[], None]] = CallbackList()
        self.on_refused: CallbackList[Callable[[int, str, object], None]] = CallbackList()
        self.on_stopped: CallbackList[Callable[[object, str, int, object], None]] = CallbackList()
        self.pattern_steps = [0]
        self.set_limits(limits)
        # Patterns are matched in entries of an executor only. Interrupts act where limits are checked.
        self.meters_patterns = executor is not None and (self._has_limits or are_deferred())
        self.running = False
        self._limit_check = self.check_limits
        self.inferences = 0
        self.alarms: List[Tuple[float, CallLimitError]] = []
        self.ceilings: Dict[int, CallLimitError] = {}
        self._steps = 0  # not yet counted as inferences
        self._memory_check_time = 0.0
        self._expired_entry: object = None
        self._entry: object = None  # the executor's entry at the first use
        self.reset()
        if executor is not None:
            register_check(self._check_own_goal)

    def set_limits(self, limits: Limits) -> None:
        """Set the limits of each entry."""
        self._entry_inferences = 0
        self.limits = limits
        # Whether steps have to check limits. Output is counted when it is written.
        self._has_limits = limits[:3] != NO_LIMITS[:3]
        # The steps since the last check may belong to earlier entries. A check at least eight times per limit keeps
        # this error small.
        steps = len(SLICE) if limits.inferences is None else int(limits.inferences) // 8
        self._pattern_slice = self.pattern_steps[0] = min(len(SLICE), max(1, steps))
        self.limited = limits != NO_LIMITS and self.executor is None

    @property
    def is_processing_entry(self) -> bool:
        """True while the executor processes an entry."""
        return self.executor is not None and self.executor.thread is not None

    def _check_own_goal(self, work: int, size: int) -> None:
        """Check the limits if this thread runs a goal of the executor's entry; see `check_limits`."""
        if self.goal is not None and self.executor is not None and self.executor.thread == get_ident():
            self.check_limits(work, size)

    # Entries

    def enter(self) -> "Union[LimitCheck, _NestedRun]":
        """Start a run with limits; return the value that `leave` needs at its end.

        Long steps check the limits as well; see `foundation.limit_checks`. A nested run is part of the outer one.
        """
        if self.running:
            return _NESTED_RUN
        self.running = True
        previous_check = CURRENT_CHECK.check
        CURRENT_CHECK.check = self._limit_check
        return previous_check

    def leave(self, saved: "Union[LimitCheck, _NestedRun]") -> None:
        """End a run with limits."""
        if isinstance(saved, _NestedRun):
            return
        self.running = False
        CURRENT_CHECK.check = saved
        if self.has_use:
            self.reset()

    @contextmanager
    def checking_long_steps(self) -> Iterator[None]:
        """Return a context in which long steps between two solutions of a goal are counted for that goal."""
        previous_check = CURRENT_CHECK.check
        CURRENT_CHECK.check = self._limit_check
        try:
            yield
        finally:
            CURRENT_CHECK.check = previous_check

    def reset(self) -> None:
        """Reset the use of resources."""
        self._reset_use()
        self.alarms.clear()
        self.ceilings.clear()
        for callback in self.on_reset:
            callback()

    def snapshot(self) -> BudgetState:
        """Return the running goals, for `restore`."""
        return self.running, CURRENT_CHECK.check, self.goal, len(self.alarms), tuple(self.ceilings)

    def restore(self, state: Optional[BudgetState]) -> None:
        """Restore the running goals after an internal error; None means that nothing was running."""
        if state is None:
            self.running = False
            self.goal = None
            if CURRENT_CHECK.check == self._limit_check:
                CURRENT_CHECK.check = None
            self.end()
            return
        # The error may have skipped the cleanup of inner calls: their alarms and ceilings would throw later, in goals
        # that have no limit.
        self.running, CURRENT_CHECK.check, self.goal, alarms, ceilings = state
        del self.alarms[alarms:]
        self.ceilings = {ceiling: error for ceiling, error in self.ceilings.items() if ceiling in ceilings}

    def _reset_use(self) -> None:
        self.has_use = False
        self._entry_inferences = 0
        self._output_bytes = 0  # bytes of output
        self._deadline: Optional[float] = None
        self._max_memory: Optional[int] = None
        self.allowance_count = 1
        self.refused_count = 0
        self._refusal_limit: Optional[str] = None  # the exceeded limit, if goals are refused
        self.needs_check = False
        self.pattern_stop: Optional[Tuple[object, str]] = None
        self.skipped_pattern_steps = 0
        if self.pattern_steps[0] < 0:
            self.pattern_steps[0] = self._pattern_slice

    def end(self) -> None:
        """End an entry: report refused goals and skipped pattern matching, and reset the use of resources."""
        self._report()
        self.reset()

    def _report(self) -> None:
        """Report the refused goals and the skipped pattern matching of the entry."""
        if self.refused_count and self._refusal_limit is not None and self._refusal_limit != INTERRUPT:
            for report_refusal in self.on_refused:
                report_refusal(self.refused_count, self._refusal_limit, self._entry)
        if self.pattern_stop is not None and self.pattern_stop[1] != INTERRUPT:
            for report_stop in self.on_stopped:
                report_stop(*self.pattern_stop, self.skipped_pattern_steps, self._entry)

    def run_as_entry(self, entry: object, work: Callable[[], T]) -> T:
        """Run ``work`` as an entry of its own in the middle of another entry; return its result."""
        executor = self.executor
        assert executor is not None
        previous_goal = self.goal
        # The use of the outer entry is saved attribute by attribute, because generated code and the machine refer to
        # this budget object.
        saved = [getattr(self, name) for name in _ENTRY_ATTRIBUTES] if self.has_use else None
        if saved is not None:
            self._reset_use()
        previous_entry = executor.replace_entry(entry)
        self.goal = None
        try:
            return work()
        finally:
            executor.replace_entry(previous_entry)
            self.goal = previous_goal
            if self.has_use:
                self._report()
                self._reset_use()
            if saved is not None:
                for name, value in zip(_ENTRY_ATTRIBUTES, saved):
                    setattr(self, name, value)
                # `_reset_use` has reset the counter. The outer entry must not continue to match patterns.
                if self.pattern_stop is not None:
                    self.pattern_steps[0] = -1
            if PENDING:
                # The interrupt of the inner entry ends the outer one, too.
                self._stop_soon()

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Return a context in which nothing is counted, while the entry waits for a user.

        Afterwards the entry may use its limits again.
        """
        executor = self.executor
        assert executor is not None
        entry: Any = executor.replace_entry(None)
        try:
            yield
        finally:
            # A new identity with the same name: a watchdog that still times the old entry must not expire this one.
            executor.replace_entry(None if entry is None else (*entry, None))
            self._reset_use()

    # Goals of entries

    def check_entry(self) -> None:
        """Raise an error if the entry has exceeded a limit, so that the goal does not start.

        Raises:
            LimitError: with ``refused`` set, if goals are refused.
        """
        if self._refusal_limit is not None:
            self.refused_count += 1
            error = self._limit_error(self._refusal_limit)
            error.is_final = error.was_refused = True
            raise error
        self.needs_check = False
        exceeded_limit = self._exceeded_limit(monotonic())
        if exceeded_limit is not None:
            raise self._exceeded_error(exceeded_limit)

    def refuse_goals(self, error: LimitError) -> None:
        """Refuse further goals of the entry because of an error that ended a goal."""
        self._mark_used()
        self.needs_check = True
        if self._refusal_limit is None:
            self._refusal_limit = error.limit_name

    def expire(self, entry: object) -> None:
        """Record that an entry has used its seconds, if it is still active. Any thread may call this."""
        self._expired_entry = entry
        self.needs_check = True
        # A running goal notices by its own checks, and ends before pattern matching continues.
        if self.goal is None:
            self.pattern_steps[0] = -1

    def end_entry(self, exception: BaseException) -> PrologError:
        """End the entry because of an exception that no code of the engine may handle.

        A callback has raised it, for example a `KeyboardInterrupt` or `SystemExit`. The executor raises it again at
        the end of the entry. Outside of an entry this method raises it.

        Returns:
            The error for a goal that has called the callback; no program can catch it.
        """
        if not self.is_processing_entry:
            raise exception
        postpone(exception)
        self._stop_soon()
        return self._exceeded_error(INTERRUPT)

    @contextmanager
    def ending_entry(self) -> Iterator[None]:
        """Return a context in which an exception that no code of the engine may handle ends the entry.

        Raises:
            LimitError: the result of `end_entry`, in place of such an exception.
        """
        try:
            yield
        except Exception:
            raise
        except BaseException as exception:
            raise self.end_entry(exception) from exception

    def check_interrupt(self) -> None:
        """Raise an error if an interrupt has to end the entry; called between the parts of long work without goals.

        Raises:
            LimitError: which nothing reports, and no program can catch.
        """
        if PENDING and is_interrupted():
            raise self._exceeded_error(INTERRUPT)

    def _stop_soon(self) -> None:
        """Have goals and pattern matching check the limits at their next step."""
        self._mark_used()
        self.needs_check = True
        self.pattern_steps[0] = -1

    # Pattern work of entries

    def meter(self, rule: object) -> Optional[Meter]:
        """Return the function that counts the pattern matching of a rule; None if nothing is counted.

        Pattern matching is not ended by an error, which would leave matches half joined: it stops at the points where
        it counts, when the function returns True. From then on no rule derives an event from the input of the entry.
        """
        if not self.meters_patterns:
            return None

        pattern_steps = self.pattern_steps

        def count(steps: int) -> bool:
            pattern_steps[0] = remaining = pattern_steps[0] - steps
            return remaining < 0 and self.stops(rule)

        return count

    def stops(self, rule: object) -> bool:
        """Check the limits after a slice of pattern matching; return True if it has to stop."""
        if self.pattern_stop is None:
            # The counter is negative here: the difference is the number of steps since the last check.
            self._steps += max(0, self._pattern_slice - self.pattern_steps[0])
            self._count_steps()
            exceeded_limit = self._exceeded_limit(monotonic())
            if exceeded_limit is None:
                self.pattern_steps[0] = self._pattern_slice
                return False
            self.pattern_stop = rule, exceeded_limit
            self.refuse_goals(self._limit_error(exceeded_limit))
            self.pattern_steps[0] = -1
        self.skipped_pattern_steps += 1
        return True

    # Limits of calls

    def add_alarm(self, instant: float, error: CallLimitError) -> None:
        """Throw an error after an instant of the monotonic clock (s)."""
        self._mark_used()
        self.alarms.append((instant, error))

    def add_ceiling(self, ceiling: int, error: CallLimitError) -> None:
        """Throw an error above a count of inferences."""
        self._mark_used()
        self.ceilings[ceiling] = error

    def ceiling_after(self, limit: int) -> int:
        """Return the ceiling for ``limit`` further inferences; no two ceilings are equal."""
        # Ceilings are keys of `ceilings`: two calls with the same limit must not share one.
        ceiling = self.inferences + limit
        while ceiling in self.ceilings:
            ceiling += 1
        return ceiling

    # Counting

    def count_slice(self) -> None:
        """Count a slice of steps and enforce the limits."""
        self._steps += len(SLICE)
        self._enforce()

    def count_loops(self) -> None:
        """Count `LOOP` iterations of a loop within a step, and enforce the limits once per slice."""
        self._steps += len(LOOP)
        if self._steps >= len(SLICE):
            self._enforce()

    def check_limits(self, work: int, size: int = 0) -> None:
        """Count work within a step and enforce the limits, with ``size`` bytes about to be allocated."""
        self._steps += work
        self._enforce(size)

    def count_last_steps(self, steps: int) -> None:
        """Count the steps of a run that has ended. If a limit is exceeded, the next goal does not start."""
        self._steps += steps
        if self._steps >= len(SLICE):
            self._count_steps()
            if (self._has_limits or PENDING) and self._exceeded_limit(monotonic()) is not None:
                self.needs_check = True

    def count_output(self, size: int) -> None:
        """Count bytes that are about to be written to the user's streams.

        Raises:
            LimitError: if the entry may not write them. A handler of the first error may write a tenth more.
        """
        limit = self.limits.output_megabytes
        if limit is None or not (self.running or self.is_processing_entry):
            return
        self._mark_used()
        if self._output_bytes + size > limit * MEGABYTE * (1.0 if self.allowance_count == 1 else 1.1):
            raise self._exceeded_error("output")
        self._output_bytes += size

    def remaining_limits(self) -> "Optional[RemainingLimits]":
        """Return the remaining limits for a step that cannot check them itself; None if nothing is limited.

        Raises:
            PrologError: if a limit has been exceeded already.
        """
        if not (self._has_limits or self.alarms or self.ceilings):
            return None
        self._enforce()
        if self._max_memory is None and self.limits.megabytes is not None:
            self._max_memory = resident_bytes() + int(self.limits.megabytes * MEGABYTE)
        if not self.alarms and not self.ceilings and self.limits.inferences is None:
            return RemainingLimits(self._deadline, None, self._max_memory)
        times = [instant for instant, _ in self.alarms]
        if self._deadline is not None:
            times.append(self._deadline)
        inferences = [ceiling - self.inferences for ceiling in self.ceilings]
        if self.limits.inferences is not None:
            inferences.append(self.limits.inferences - self._entry_inferences)
        return RemainingLimits(min(times, default=None), min(inferences, default=None), self._max_memory)

    def _mark_used(self) -> None:
        """Record that the entry has used resources, so that they are reset at its end."""
        if not self.has_use:
            self.has_use = True
            executor = self.executor
            if executor is not None and executor.thread is not None:
                self._entry = executor.entry
                executor.call_next(self.end)

    def _count_steps(self) -> None:
        self._mark_used()
        steps = self._steps
        self._steps = 0
        self.inferences += steps
        self._entry_inferences += steps

    def _enforce(self, size: int = 0) -> None:
        self._count_steps()
        if self.ceilings:
            for ceiling, error in self.ceilings.items():
                if self.inferences > ceiling:
                    raise error
        if PENDING and not self.is_processing_entry:
            # There is no entry at whose end the exception could be raised.
            raise_pending()
        if not (self._has_limits or self.alarms or PENDING):
            return
        # Limits of calls are checked first: an inner limit that is reached at the same time must end the inner call,
        # and not the whole entry.
        now = monotonic()
        for instant, error in self.alarms:
            if now > instant:
                raise error
        exceeded_limit = self._exceeded_limit(now, size)
        if exceeded_limit is None:
            return
        if self.goal is None and self.is_processing_entry:
            # No goal runs: an exception would interrupt pattern matching, which stops where it counts instead.
            self.refuse_goals(self._limit_error(exceeded_limit))
            self.pattern_steps[0] = -1
        else:
            raise self._exceeded_error(exceeded_limit)

    def _exceeded_limit(self, now: float, size: int = 0) -> Optional[str]:
        """Return the limit that the entry exceeds, or would exceed with ``size`` more bytes; None if none."""
        self._mark_used()
        if PENDING and is_interrupted():
            return INTERRUPT
        limits = self.limits
        if limits.inferences is not None and self._entry_inferences > limits.inferences:
            return "inferences"
        if limits.seconds is not None:
            # Time starts with the first check: entries that end before it never read the clock.
            if self._deadline is None:
                self._deadline = now + limits.seconds
            elif now > self._deadline:
                return "seconds"
            if (
                self._expired_entry is not None
                and self.executor is not None
                and self._expired_entry is self.executor.entry
            ):
                return "seconds"
        if limits.megabytes is not None and (
            size or now > self._memory_check_time + _MEMORY_CHECK_INTERVAL_SECONDS
        ):
            self._memory_check_time = now
            used = resident_bytes()
            if self._max_memory is None:
                self._max_memory = used + int(limits.megabytes * MEGABYTE)
            if used + size > self._max_memory:
                return "memory"
        return None

    def _exceeded_error(self, resource: str) -> LimitError:
        error = self._limit_error(resource)
        if resource == INTERRUPT:
            # Nothing is reported, because the executor raises the exception.
            error.is_final = error.was_refused = True
            self.needs_check = True
            return error
        error.is_final = self.allowance_count > 1
        # The next check tells the receiver of the error whether goals are refused already.
        self.needs_check = self._refusal_limit is not None
        # The use is not reset after a final error, so that every later check throws again: catching it is useless.
        if error.is_final:
            return error
        # The handler of a first error gets a tenth more inferences, and the other limits once again, to clean up.
        self.allowance_count = 2
        self._entry_inferences -= (self.limits.inferences or 0) // 10
        self._deadline = None
        self._max_memory = None
        self._expired_entry = None
        return error

    def _limit_error(self, resource: str) -> LimitError:
        error = LimitError(resource_error(resource).term)
        error.budget, error.limit_name = self, resource
        return error


class RemainingLimits(NamedTuple):
    """The remaining limits: an instant of the monotonic clock (s), inferences, and bytes of the whole process."""

    deadline: Optional[float]
    inferences: Optional[int]
    max_memory: Optional[int]


class _NestedRun:
    """Result of `Budget.enter` for a nested run."""


_NESTED_RUN = _NestedRun()

_ENTRY_ATTRIBUTES = (
    "allowance_count",
    "refused_count",
    "needs_check",
    "has_use",
    "_entry",
    "_entry_inferences",
    "_output_bytes",
    "_deadline",
    "_max_memory",
    "_refusal_limit",
    "pattern_stop",
    "skipped_pattern_steps",
)
"""Attributes of a budget that record the use of an entry."""

_PAGE_BYTES = os.sysconf("SC_PAGE_SIZE") if hasattr(os, "sysconf") else 4096


def resident_bytes() -> int:
    """Return the resident memory of the process in bytes; 0 if the system does not report it."""
    try:
        with open("/proc/self/statm", "rb") as file:
            return int(file.read().split()[1]) * _PAGE_BYTES
    except OSError:  # a system without /proc has no memory limit
        return 0
