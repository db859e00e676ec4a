"""Steps of timestamps ahead of a clock that follows events, and the return from wrong ones.

The timestamp of one event may be wrong by hours or years. A clock that follows it is ahead of all later events:
alarms are called too early, and windows refuse events. On the other hand, nothing may have happened for a long time,
or a recording may continue on another day. The next events decide:

1. A timestamp up to `MAX_STEP` ahead moves the clock.
2. A timestamp up to `MAX_FOLLOWED_STEP` ahead, and the first one of all, moves the clock at once, but on trial. If
   `MIN_EARLIER_EVENTS` events continue the time before, the clock returns, and the names of the events that were
   ahead are *suspects*. The trial ends if timestamps advance by `TRIAL_SPAN` without such an event.
3. A timestamp further ahead, or of a suspect, does not move the clock. It does so, on trial, when the timestamps of
   this name have advanced by `TRIAL_SPAN` in steps of at most `MAX_STEP` while no other event has moved the clock.

Events of one name count as one source: a sensor with a wrong clock repeats its error, which confirms nothing. If all
events agree, only rule 1 applies, whatever their date is. The decisions depend on the order and the timestamps of
events only, so that they are the same live, from a file, and after a restore.
"""

from enum import Enum
from typing import Dict, Hashable, List, NamedTuple, Optional, Sequence, Tuple

from ...prolog.terms.timestamps import BEFORE_ALL_INSTANTS, SECOND
from ...serialization.state_fields import StateFields, StateOwner, field, rows_of
from ...serialization.stored_field_types import BOOLEAN, CLOCK_INSTANT, COUNT, FUNCTOR, optional, sequence_of

MAX_STEP = 10 * SECOND
"""Step in ns up to which a timestamp always moves the clock."""

MAX_FOLLOWED_STEP = 30 * 86_400 * SECOND
"""Step in ns up to which a timestamp of a name without errors moves the clock at once: thirty days."""

TRIAL_SPAN = 10 * SECOND
"""Time in ns by which timestamps must advance to confirm a step."""

MIN_EARLIER_EVENTS = 3
"""Number of events with the time before a step after which the clock returns to it."""

MAX_TRIALS = 3
"""Maximum number of steps that are on trial at the same time; the oldest one is confirmed if there are more."""

SUSPICION_SPAN = 600 * SECOND
"""Time in ns of the clock for which a name is a suspect after its last timestamp ahead: ten minutes."""

MAX_SUSPECTS = 1000
"""Maximum number of suspects; the oldest is dropped."""

EventName = Hashable
"""Name and arity of events; None for an event that is a variable."""


class StoredTrial(NamedTuple):
    """Stored form of a `_Trial`, with the same attributes."""

    base: Optional[int]
    ahead: int
    earlier_count: int
    earlier_end: int
    sources: Sequence[EventName]


class StoredSuspect(NamedTuple):
    """Stored form of a `_Suspect`, with its source."""

    source: EventName
    first: Optional[int]
    last: int
    clock: int


class JumpDecision(Enum):
    """Decision about the timestamp of an event.

    `FOLLOWED`: it moves the clock, or is not ahead. `HELD`: it is ahead and does not move the clock. `RETURNED`: it
    shows that the clock has followed an error; the clock returns.
    """

    FOLLOWED = 1
    HELD = 2
    RETURNED = 3


class _Suspect:
    """A source whose timestamps do not move the clock while they are ahead.

    Attributes:
        first: timestamp from which its timestamps advance steadily while the clock stands still; None if unknown.
        last: its last timestamp ahead.
        clock: time of the clock at that timestamp.
    """

    __slots__ = ("first", "last", "clock")

    def __init__(self, first: Optional[int], last: int, clock: int):
        self.first = first
        self.last = last
        self.clock = clock


class _Trial:
    """A step that the clock has followed, and what speaks against it.

    Attributes:
        base: time of the clock before the step; None at the first event.
        ahead: timestamp to which the clock has moved.
        earlier_count: number of events that continue the time before the step.
        earlier_end: the latest timestamp of these, or the time before.
        sources: names of the events with the time after the step; the first one made it.
    """

    __slots__ = ("base", "ahead", "earlier_count", "earlier_end", "sources")

    def __init__(
        self,
        base: Optional[int],
        ahead: int,
        earlier_count: int,
        earlier_end: int,
        sources: Sequence[EventName],
    ):
        self.base = base
        self.ahead = ahead
        self.earlier_count = earlier_count
        self.earlier_end = earlier_end
        self.sources = dict.fromkeys(sources)

    def contradicts(self, stamp: int) -> bool:
        """Return whether a timestamp is near the time before the step, and not near the one after it."""
        if stamp >= self.ahead - MAX_STEP:
            return False
        # A timestamp long before the step is that of a late event, and proves nothing.
        return self.base is None or (self.base - MAX_STEP <= stamp and stamp - self.base < self.ahead - stamp)


class StampJumps(StateOwner):
    """Trials of steps ahead, and the sources whose timestamps are ahead.

    Attributes:
        sources: names of the events from which the clock has returned last; the first one made the step.
        step: distance in ns of the first of them from the time to which the clock has returned.
    """

    STATE = StateFields(
        field("_has_time", BOOLEAN),
        field("_steady_since", optional(CLOCK_INSTANT)),
        field(
            "trials",
            rows_of(
                StoredTrial,
                base=optional(CLOCK_INSTANT),
                ahead=CLOCK_INSTANT,
                earlier_count=COUNT,
                earlier_end=CLOCK_INSTANT,
                sources=sequence_of(optional(FUNCTOR)),
            ),
        ),
        field(
            "suspects",
            rows_of(
                StoredSuspect,
                source=optional(FUNCTOR),
                first=optional(CLOCK_INSTANT),
                last=CLOCK_INSTANT,
                clock=CLOCK_INSTANT,
            ),
        ),
    )

    def __init__(self) -> None:
        self.sources: List[EventName] = []
        self.step = 0
        self._has_time = False
        self._trials: List[_Trial] = []
        self._steady_since: Optional[int] = None
        self._suspects: Dict[EventName, _Suspect] = {}

    @property
    def is_on_trial(self) -> bool:
        """True if the clock has followed a step that is not confirmed."""
        return bool(self._trials)

    def check(self, stamp: int, time: int, source: EventName) -> Tuple[JumpDecision, int]:
        """Return the decision about a timestamp, and the time to which the clock is to be set."""
        if not self._has_time:
            self._has_time = True
            self._begin_trial(None, stamp, source)
            return JumpDecision.FOLLOWED, stamp
        step = stamp - time
        # The clock has reached the time of all trials, so only an earlier timestamp contradicts them.
        if step < 0:
            position = self._find_contradicted_trial(stamp)
            if position is not None:
                return self._contradict(position, stamp, time)
        if step <= MAX_STEP:
            if self._trials and step >= -MAX_STEP:
                self._confirm(stamp, source)
            return JumpDecision.FOLLOWED, max(time, stamp)
        suspect = self._suspects.get(source) if self._suspects else None
        if suspect is not None and time - suspect.clock > SUSPICION_SPAN:
            del self._suspects[source]
            suspect = None
        if suspect is None and step <= MAX_FOLLOWED_STEP:
            self._begin_trial(time, stamp, source)
            return JumpDecision.FOLLOWED, stamp
        return self._hold(suspect, stamp, time, source)

    def _begin_trial(self, base: Optional[int], stamp: int, source: EventName) -> None:
        trials = self._trials
        trials.append(_Trial(base, stamp, 0, BEFORE_ALL_INSTANTS if base is None else base, (source,)))
        if len(trials) > MAX_TRIALS:
            del trials[0]
        self._steady_since = stamp

    def _find_contradicted_trial(self, stamp: int) -> Optional[int]:
        """Return the position of the newest trial that a timestamp contradicts; None if there is none."""
        # The newest one first: the time before it may itself be on trial.
        for position in reversed(range(len(self._trials))):
            if self._trials[position].contradicts(stamp):
                return position
        return None

    def _contradict(self, position: int, stamp: int, time: int) -> Tuple[JumpDecision, int]:
        """Record an event that contradicts a trial; reject the trial if there are enough of them."""
        trial = self._trials[position]
        trial.earlier_count += 1
        trial.earlier_end = max(trial.earlier_end, stamp)
        self._steady_since = None
        if trial.earlier_count < MIN_EARLIER_EVENTS:
            return JumpDecision.FOLLOWED, time
        return JumpDecision.RETURNED, self._reject_trials(position)

    def _confirm(self, stamp: int, source: EventName) -> None:
        """Record an event near the time of the clock; end all trials if that time has advanced far enough."""
        trial = self._trials[-1]
        # The first trial has one source only, see `unchecked_limit`.
        if trial.base is not None and len(trial.sources) < MAX_SUSPECTS:
            trial.sources[source] = None
        if self._steady_since is None:
            self._steady_since = stamp
        elif stamp - self._steady_since > TRIAL_SPAN:
            self._trials.clear()

    def _reject_trials(self, position: int) -> int:
        """Make the sources of the trials from a position on suspects; return the time to which the clock returns."""
        rejected = self._trials[position:]
        del self._trials[position:]
        time = rejected[0].earlier_end
        self.step = rejected[0].ahead - time
        self.sources = list(dict.fromkeys(source for trial in rejected for source in trial.sources))
        for source in self.sources:
            self._add_suspect(source, _Suspect(None, rejected[0].ahead, time))
        return time

    def _add_suspect(self, source: EventName, suspect: _Suspect) -> None:
        self._suspects[source] = suspect
        if len(self._suspects) > MAX_SUSPECTS:
            del self._suspects[next(iter(self._suspects))]

    def _hold(
        self, suspect: Optional[_Suspect], stamp: int, time: int, source: EventName
    ) -> Tuple[JumpDecision, int]:
        if suspect is None:
            self._add_suspect(source, _Suspect(stamp, stamp, time))
            return JumpDecision.HELD, time
        if suspect.first is None or time != suspect.clock or abs(stamp - suspect.last) > MAX_STEP:
            suspect.first = stamp
        suspect.last, suspect.clock = stamp, time
        if stamp - suspect.first <= TRIAL_SPAN:
            return JumpDecision.HELD, time
        # Nothing else has moved the clock meanwhile: this is the time.
        del self._suspects[source]
        self._begin_trial(time, stamp, source)
        return JumpDecision.FOLLOWED, stamp

    def unchecked_limit(self) -> int:
        """Return the latest timestamp that needs no check if it is not earlier than the clock; -1 if there is none.

        At the first trial only the first event is a suspect, so that a stream whose times agree is not slower at its
        beginning.
        """
        if len(self._trials) == 1 and self._trials[0].base is None and self._steady_since is not None:
            return self._steady_since + MAX_STEP
        return -1

    def end_trials(self) -> None:
        """Confirm all steps, because the owner of the clock has moved it."""
        self._trials.clear()

    def forget_time(self) -> None:
        """Let the next event set the time, because that of the clock is independent of events."""
        self._trials.clear()
        self._has_time = False

    @property
    def trials(self) -> List[StoredTrial]:
        """The steps that are on trial."""
        return [
            StoredTrial(trial.base, trial.ahead, trial.earlier_count, trial.earlier_end, list(trial.sources))
            for trial in self._trials
        ]

    @trials.setter
    def trials(self, trials: Sequence[StoredTrial]) -> None:
        self._trials = [_Trial(*trial) for trial in trials]

    @property
    def suspects(self) -> List[StoredSuspect]:
        """The sources whose timestamps are ahead."""
        return [
            StoredSuspect(source, suspect.first, suspect.last, suspect.clock)
            for source, suspect in self._suspects.items()
        ]

    @suspects.setter
    def suspects(self, suspects: Sequence[StoredSuspect]) -> None:
        self._suspects = {source: _Suspect(first, last, clock) for source, first, last, clock in suspects}
