"""Which run of a simulated clock a message belongs to: a bag that is played again begins the next one.

`Clock` says that time has gone back. Messages come over other connections than ``/clock``, so those of the next run
may come before it, and those of the run before after it. The rule for them:

1. A run begins for a node when its own ``/clock`` has gone back by more than `JUMP`, and each node that sends it
   events as text has told in their midst that its own has, too; who does not tell within
   `CLOCK_WAIT_SECONDS` is not waited
   for. What comes in between waits for the run. What was received before is worked off in the run before.
2. A frame of a topic follows the clock if its stamps went on as the clock did, ahead of it or behind it, by however
   much; messages that were held up on their way count neither for nor against it. Only such a frame tells anything
   about runs (`Skew`).
3. It is early if it goes back, to further behind the clock than it ever was. Then all that its publisher sends waits
   until the run begins. Where the clock does not go back within `CLOCK_WAIT_SECONDS`, nothing was early: all
   is taken in order.
4. It is left over if it goes on where the run before ended, ahead of the run at hand. It is dropped.
5. What has no stamp belongs to the time of its receipt. All other stamps are taken as they are: those that stand
   still (static transforms, latched messages), those that follow no clock, and all where time is not simulated.
"""

import threading
import time
from collections import deque
from contextlib import ExitStack
from typing import (
    Any,
    Callable,
    ContextManager,
    Deque,
    Dict,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Set,
    Tuple,
)

from ...foundation.errors import counted
from .clock import JUMP
from .problem_reports import Reports

CLOCK_WAIT_SECONDS = 1.0
"""Seconds for which messages wait for a clock, and a run for those who have not told."""

PAUSE = 10.0
"""Seconds after a wait in vain in which nothing counts as early."""

MAX_HELD_MESSAGES = 20_000
MAX_HELD_BYTES = 64_000_000

SENDERS = 100
"""Senders of texts that are remembered."""

Began = Callable[[int], object]
"""Called when a run begins, with the instant at which the one before ended."""


class _Ahead(NamedTuple):
    """What waits.

    Attributes:
        take: takes it.
        messages: those that came together.
        size: their bytes.
    """

    take: Callable[[List[Any]], object]
    messages: List[Any]
    size: int


class ClockEpochs:
    """Tells the runs of a simulated clock, and holds what comes before the one that it belongs to.

    `clock_at` and `tell` may be called by any thread; they only take note. `step`, of a thread of its own, does the
    rest, under the locks under which messages are taken: each is taken wholly before a run begins, or afterwards.

    Args:
        reports: takes warnings.
        source: the time before anything has come from the clock.
        wake: called where `step` has something to do.
        wall: a clock that nobody sets, in seconds.

    Attributes:
        run: the number of the run at hand.
        since: when it began, by ``wall``.
        holding: whether messages may have to wait, as `holds` and `holds_texts` tell.
        dropped: how many messages were too many to be held.
    """

    def __init__(
        self,
        reports: Reports,
        source: Callable[[], int],
        wake: Callable[[], object],
        wall: Callable[[], float] = time.monotonic,
    ):
        self._reports = reports
        self._source = source
        self._wake = wake
        self._wall = wall
        self._newest = source()
        self._time: Tuple[int, int, int] = (0, self._newest, 0)
        """How often the clock has gone back, what it says, and where it was before; in one, as threads share it."""
        self._lock = threading.Lock()
        self._senders: Dict[object, Tuple[int, int]] = {}
        """For each that sends texts and tells of runs: the run it is in, and what its own count differs by."""
        self._early: Set[str] = set()
        self._held: Deque[_Ahead] = deque()
        self._number = self._bytes = 0
        self._until = self._not_before = 0.0
        self._turns: Sequence[ContextManager[object]] = ()
        self._began: Sequence[Began] = ()
        self.run = 0
        self.since = wall()
        self.holding = False
        self.dropped = 0

    def begin(self, turns: Sequence[ContextManager[object]], *began: Began) -> None:
        """Say under which locks messages are taken, and what is called under them when a run begins."""
        self._turns = turns
        self._began = began

    def now(self, run: Optional[int] = None) -> int:
        """Return the time of a run, of the one at hand by default; it stands still when the run is over."""
        times, instant, end = self._time
        if times != (self.run if run is None else run):
            return end
        return instant or self._source()

    def clock_at(self, instant: int) -> None:
        """Note what the clock says."""
        times, _, end = self._time
        if instant >= self._newest - JUMP:
            self._newest = max(instant, self._newest)
            self._time = times, instant, end
            return
        if times == self.run:
            end = self._newest
        self._newest = instant
        with self._lock:
            self._until = self._wall() + CLOCK_WAIT_SECONDS
            self.holding = True
            self._time = times + 1, instant, end
        self._wake()

    def tell(self, sender: object, number: int) -> None:
        """Note that all that a sender of texts sends from now on is of the run to which it gives a number."""
        times = self._time[0]
        with self._lock:
            _, offset = self._senders.get(
                sender, (0, times - number)
            )  # the first time it says where it stands
            if sender not in self._senders and len(self._senders) >= SENDERS:
                del self._senders[next(iter(self._senders))]
            self._senders[sender] = number + offset, offset
            if number + offset > self.run:
                self._await()
        self._wake()

    def may_wait(self) -> bool:
        """Tell whether a message that is early is to wait."""
        return self._wall() >= self._not_before

    def holds(self, publisher: str) -> bool:
        """Tell whether messages of a publisher have to wait."""
        return self._time[0] != self.run or publisher in self._early

    def holds_texts(self, sender: object) -> bool:
        """Tell whether texts of a sender have to wait: it is ahead, or says nothing and the run is about to end."""
        known = self._senders.get(sender)
        if known is None:
            return self._time[0] != self.run
        return known[0] > self.run

    def keep_early(
        self, publisher: str, take: Callable[[List[bytes]], object], messages: List[bytes]
    ) -> None:
        """Hold messages of which the first is early, and all that their publisher sends from now on."""
        self._early.add(publisher)
        self.keep(take, messages)

    def keep(self, take: Callable[[List[Any]], object], messages: List[Any]) -> None:
        """Hold messages, or texts, until the run at hand is over or the wait was in vain; then ``take`` gets them."""
        with self._lock:
            is_first = not self.holding
            self._await()
            size = sum(map(len, messages))
            self._held.append(_Ahead(take, messages, size))
            self._number += len(messages)
            self._bytes += size
            while self._held and (self._number > MAX_HELD_MESSAGES or self._bytes > MAX_HELD_BYTES):
                oldest = self._held.popleft()
                self._number -= len(oldest.messages)
                self._bytes -= oldest.size
                self.dropped += len(oldest.messages)
                self._reports.warning(
                    f"{counted(self.dropped, 'message')} dropped: too many came before the clock went back",
                    "early",
                )
        if is_first:
            self._wake()

    def step(self) -> Optional[float]:
        """Do what is due; return in how many seconds to look again, None where there is nothing to wait for."""
        with ExitStack() as stack:
            for turn in self._turns:
                stack.enter_context(turn)
            now = self._wall()
            times, _, end = self._time
            if times == self.run:
                if self.holding and now >= self._until:
                    if self._held:
                        self._not_before = now + PAUSE
                    self._release()
            elif now >= self._until or not self._behind(times):
                self._forget(self._behind(times))
                self.run = times
                self.since = self._wall()
                self._not_before = 0.0
                self._tell(end)
                self._release()
            return max(0.0, self._until - now) if self.holding else None

    def _tell(self, end: int) -> None:
        """Call all that wants to know that a run begins: what fails keeps neither the others nor messages back."""
        for began in self._began:
            try:
                began(end)
            except Exception as error:  # of whatever kind: it is not ours
                self._reports.error(error)

    def _behind(self, times: int) -> List[object]:
        """Return those who send texts and have not told of the run that begins."""
        with self._lock:
            return [sender for sender, (told, _) in self._senders.items() if told < times]

    def _forget(self, senders: List[object]) -> None:
        with self._lock:
            for sender in senders:
                del self._senders[sender]

    def _await(self) -> None:
        if not self.holding:
            self._until = self._wall() + CLOCK_WAIT_SECONDS
            self.holding = True

    def _release(self) -> None:
        with self._lock:
            held, self._held = self._held, deque()
            self._number = self._bytes = 0
            self._early.clear()
            self.holding = self._time[0] != self.run  # it went back again just now
            if self.holding:
                self._until = self._wall() + CLOCK_WAIT_SECONDS
        for one in held:
            one.take(one.messages)
