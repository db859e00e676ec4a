"""Stamps that are far from what their topic and frame had so far."""

import time
from typing import Callable, Dict, Iterator, List, Optional

from ...foundation.bounded_caches import Cache
from ...foundation.errors import beginning, printable
from ...messages.decoder import Decoder
from ...messages.header_stamps import FrameStamp, frame_text, watched
from ...prolog.terms.timestamps import SECOND
from .clock import JUMP
from .problem_reports import Reports

FAR = 10 * SECOND
"""How far a stamp may be from what is expected, without a word."""

AGREEING = 10
"""Stamps in a row that agree among themselves after which a clock counts as set."""

PACE = 10.0
"""How many times faster than time a bag may be played, where nothing else tells how far stamps should have got."""

LONG_ENOUGH = SECOND // 2
"""For how long stamps have to go on as time does, to count as such that do."""

LOOKS = 100
"""Messages of a frame that are all looked at while that is not known; afterwards one a second is."""

FRAMES = 5000
"""Frames that are kept for a topic."""

SIZE = 16 << 20
"""Bytes that what is known of the frames of all topics may take; what was known of the run before, the same."""

TOPICS = 1000

_UNKNOWN = -1


class Refused(Exception):
    """A message whose stamp is further away than the program allows; counted and reported already."""


class Early(Exception):
    """A message that may be of a run that the clock has not begun; see `ClockRuns`."""


class FrameClock:
    """What is known of the stamps of one frame on one topic.

    Attributes:
        second: the second of the last stamp, by which most are known to fit; negative where each has to be looked at.
        stamp: the last stamp.
        now: the time of its receipt by the node's clock, which may be simulated.
        wall: the same by a clock that nobody sets.
        progress: how far the stamps of all topics had got then.
        pace: the most by which stamps went faster than wall time; None where that is not known.
        since: the stamp and the wall time from which the pace is measured.
        other: the first of those in a row that are far from the last one and agree among themselves.
        agreeing: how many these are.
        told: whether somebody has been warned.
        least: the least by which stamps were ahead of the node's time at receipt; below 0 where they were behind it.
        most: the most by which they were.
        begun: the node's time of the receipt to which later ones are compared: 0 before that time is known.
        ahead: by how much its stamp was ahead.
        followed: whether stamps went on as the node's time did.
        looks: how many fitted.
    """

    __slots__ = (
        "second",
        "stamp",
        "now",
        "wall",
        "progress",
        "pace",
        "since",
        "other",
        "agreeing",
        "told",
        "least",
        "most",
        "begun",
        "ahead",
        "followed",
        "looks",
    )

    def __init__(self, stamp: int, now: int, wall: int, progress: int):
        self.second = _UNKNOWN
        self.stamp = stamp
        self.now = now
        self.wall = wall
        self.progress = progress
        self.pace: Optional[float] = None
        self.since = stamp, wall
        self.other: Optional[FrameClock] = None
        self.agreeing = self.looks = 0
        self.told = self.followed = False
        self.begun = now
        self.least = self.most = self.ahead = stamp - now

    def distance(self, stamp: int, now: int, wall: int, progress: int) -> int:
        """Return how far a stamp is from the nearest one that could be expected, later ones as positive numbers.

        It may be as the last one, or later by what has passed since by one of the clocks or on other topics. A bag
        may be paused and need not be played at its own pace: all up to the time that has passed will do, as often as
        the highest pace says that was seen, and ten times where a pause may have hidden the pace.
        """
        step, passed = stamp - self.stamp, wall - self.wall
        if 0 <= step <= passed * (PACE if passed >= SECOND or self.pace is None else self.pace):
            return 0
        return min((step - one for one in (0, passed, now - self.now, progress - self.progress)), key=abs)

    def move_to(self, stamp: int, now: int, wall: int, exact: bool) -> None:
        """Note a stamp that fits."""
        passed = wall - self.since[1]
        if passed >= SECOND // 2:
            self.pace = max(self.pace or 1.0, min((stamp - self.since[0]) / passed, PACE))
            self.since = stamp, wall
        self._compare(stamp, now)
        self.progress += stamp - self.stamp
        self.stamp, self.now, self.wall = stamp, now, wall
        self.looks += 1
        self.second = _UNKNOWN if exact or not (self.followed or self.looks > LOOKS) else stamp // SECOND
        self.other, self.agreeing = None, 0

    def _compare(self, stamp: int, now: int) -> None:
        """Note by how much a stamp is ahead, and see whether they go on as the node's time does.

        A busy machine holds messages up, which makes them look as if their stamps lagged. So a stamp that lags tells
        nothing; one that is further ahead than before tells that those before it were held up, or go on too fast.
        """
        ahead = stamp - now
        if not self.begun:  # there was no time yet
            self.begun = now
            self.least = self.most = self.ahead = ahead
        passed = now - self.begun
        self.least, self.most = min(self.least, ahead), max(self.most, ahead)
        if stamp < self.stamp - JUMP:  # taken, so time did not go back
            self.begun, self.ahead, self.followed = now, ahead, False
        elif not self.followed and ahead > self.ahead + passed / 4:
            self.begun, self.ahead = now, ahead
        elif not self.followed and passed >= LONG_ENOUGH:
            self.followed = ahead >= self.ahead - passed / 4

    def is_early(self, stamp: int, now: int) -> bool:
        """Tell whether a stamp goes back to where it fits an earlier time only."""
        return stamp < self.stamp - JUMP and stamp - now < self.least - JUMP and self.followed

    def is_left_over(self, stamp: int, end: int, now: int) -> bool:
        """Tell whether a stamp goes on where this run ended, at an instant, and is ahead of the present one."""
        goes_on = self.stamp <= stamp <= end + self.most + JUMP + (self.most - self.least)
        return goes_on and stamp - now > self.most + JUMP and self.followed

    def agree(self, stamp: int, now: int, wall: int, progress: int, most: int) -> bool:
        """Note a stamp that is far away; tell whether enough of them in a row agree."""
        other = self.other
        if other is not None and abs(other.distance(stamp, now, wall, progress)) <= most:
            self.agreeing += 1
            other.move_to(stamp, now, wall, True)
        else:
            self.other, self.agreeing = FrameClock(stamp, now, wall, progress), 1
        self.second = _UNKNOWN
        return self.agreeing >= AGREEING


class TopicTimes(Cache[bytes, FrameClock]):
    """What is known of the stamps of a topic, by the bytes of its frames.

    Attributes:
        name: the topic's.
        before: what was known of the run before, until a frame has begun again.
        far: how many messages had a stamp that was far away.
        refused: how many of them were not taken.
        step: by how much the frame was far that was warned of first.
        together: whether it has been said that others were as far.
        clock: how far the clock was set of which was told last.
    """

    __slots__ = ("name", "before", "far", "refused", "step", "together", "clock")

    def __init__(self, name: str):
        super().__init__(FRAMES, 4 << 20, 1 << 12)
        self.name = name
        self.before: Dict[bytes, FrameClock] = {}
        self.far = self.refused = 0
        self.step: Optional[int] = None
        self.together = False
        self.clock: Optional[int] = None

    def clear(self) -> None:
        """Forget all, also for those who hold what is known of a frame."""
        for known in list(self.values()):
            known.second = _UNKNOWN
        super().clear()


class ClockSkewMonitor:
    """Looks at the stamps of messages: warns of those that are far from what their topic and frame had so far.

    Neither the receipt nor other frames count: a bag is years old, and clocks of a robot differ. A frame's first
    stamp says where it is.

    Args:
        reports: takes a warning for each topic and frame.
        now: the present by the node's clock.
        wall: the present by a clock that nobody sets.
        most: seconds; a message whose stamp is further away is refused. None for no limit.
        may_wait: tells whether messages may be `Early`.
    """

    def __init__(
        self,
        reports: Reports,
        now: Callable[[], int],
        wall: Callable[[], int] = time.monotonic_ns,
        most: Optional[float] = None,
        may_wait: Callable[[], bool] = lambda: False,
    ):
        self._reports = reports
        self._now = now
        self._wall = wall
        self._most = None if most is None else round(most * SECOND)
        self._far = FAR if self._most is None else min(FAR, self._most)
        self._exact = self._far < FAR
        self._topics: Dict[str, TopicTimes] = {}
        self._progress = 0
        self._may_wait = may_wait
        self._ended = 0
        self._held = 0

    def __iter__(self) -> Iterator[TopicTimes]:
        return iter(list(self._topics.values()))

    def watch(self, decoder: Decoder, topic: str, publisher: str = "") -> Decoder:
        """Return a decoder that looks at all stamps of a message besides, where both its functions are called.

        One of them raises `Refused` for a message that is not to be taken, and `Early` for one that is to wait.

        Args:
            decoder: of the messages' type.
            topic: where they come from.
            publisher: who sends them.
        """
        times = self._topics.get(topic)
        if times is None:
            if len(self._topics) >= TOPICS:
                self.forget()  # also for those who go on with what they know
                self._topics.clear()
            times = self._topics[topic] = TopicTimes(topic)
        known = times
        return watched(decoder, known, lambda found: self._look(known, publisher, found))

    def forget(self) -> None:
        """Forget what was known: another stream begins."""
        for times in self:
            times.before = {}
        self._clear()

    def begin_run(self, ended: int) -> None:
        """Begin anew: time went back. What is left over of the run before, which ended at an instant, is refused."""
        self._ended = ended
        for times in self:
            times.before = dict(times)
        self._clear()

    def _clear(self) -> None:
        for times in self:
            times.clear()
        self._held = 0

    def sum_up(self) -> None:
        """Say how many messages of each topic had such a stamp, where that was more than one."""
        for times in self:
            if times.far > 1:
                refused = f", {times.refused} of them not taken" if times.refused else ""
                self._reports.warning(
                    f"topic {times.name}: {times.far} messages in all had a stamp far from those before{refused}"
                )

    def _look(self, times: TopicTimes, publisher: str, found: List[FrameStamp]) -> None:
        """Compare the stamps of a message with those before.

        Raises:
            Refused: where one is further away than is allowed, or is of the run before.
            Early: where one may be of the next run.
        """
        now, wall = self._now(), self._wall()
        farthest = 0
        self._look_at_runs(times, found, now)
        for key, stamp in found:
            known = times.get(key)
            if known is None:
                self._keep(times, key, FrameClock(stamp, now, wall, self._progress))
                continue
            far, distance = self._far, stamp - known.stamp
            if not -far <= distance <= far:
                distance = known.distance(stamp, now, wall, self._progress)
            if not -far <= distance <= far:
                if not known.agree(stamp, now, wall, self._progress, self._far):
                    farthest = max(farthest, abs(distance))
                    self._warn(times, known, key, distance, publisher)
                    continue
                self._tell_of_set_clock(times, key, stamp - known.stamp)
                known.stamp, known.since = stamp, (stamp, wall)  # which is no progress
            known.move_to(stamp, now, wall, self._exact)
            if known.progress > self._progress:
                self._progress = known.progress
        if farthest:
            times.far += 1
            if self._most is not None and farthest > self._most:
                times.refused += 1
                raise Refused

    def _look_at_runs(self, times: TopicTimes, found: List[FrameStamp], now: int) -> None:
        """See whether a message is of another run than the one at hand.

        Raises:
            Refused: where it is of the run before.
            Early: where it may be of the next one.
        """
        before = times.before
        for key, stamp in found:
            known = times.get(key)
            if known is not None and known.is_early(stamp, now) and self._may_wait():
                raise Early
            last = before.get(key) if before else None
            if last is None:
                continue
            if last.is_left_over(stamp, self._ended, now):
                self._reports.warning(
                    f"a message on {times.name} is dropped: it is of the time before the clock went back",
                    ("left over", times.name),
                )
                raise Refused
            del before[key]  # it has begun again

    def _keep(self, times: TopicTimes, key: bytes, known: FrameClock) -> None:
        """Keep what is known of a frame; all topics start anew where they would hold more than they may together."""
        held = times.held
        times.keep(key, known, 2 * len(key) + 500)
        self._held += times.held - held
        if self._held > SIZE:
            self._clear()
            times.keep(key, known, 2 * len(key) + 500)
            self._held = times.held

    def _warn(self, times: TopicTimes, known: FrameClock, key: bytes, distance: int, publisher: str) -> None:
        if known.told:
            return
        known.told = True
        topic = times.name
        if times.step is None:
            times.step = distance
        elif abs(times.step - distance) <= FAR:  # of all frames at once, which need not be named one by one
            self._tell_of_all(times, distance)
            return
        where = f"topic {topic}, frame {_shown(key)}"
        by = f" from {printable(beginning(publisher))}" if publisher else ""
        taken = "" if self._most is None or abs(distance) <= self._most else "; such messages are not taken"
        self._reports.warning(
            f"{where}: a stamp{by} is {_seconds(distance)} the stamps before it{taken}",
            ("skew", topic),
            texts=TEXTS,
        )

    def _tell_of_all(self, times: TopicTimes, distance: int) -> None:
        if times.together:
            return
        times.together = True
        why = "a bag that is played again without /clock, or a clock" if distance < 0 else "a clock"
        self._reports.warning(
            f"topic {times.name}: the stamps of other frames are {_seconds(distance)} those before them too, as by "
            f"{why} that was set; frames of which this is true are not named"
        )

    def _tell_of_set_clock(self, times: TopicTimes, key: bytes, step: int) -> None:
        if times.together and times.clock is not None and abs(times.clock - step) <= FAR:
            return
        times.clock = step
        topic = times.name
        self._reports.warning(
            f"topic {topic}, frame {_shown(key)}: the last {AGREEING} stamps agree and are {_seconds(step)} those "
            "before them; they are taken as right from now on",
            ("set clock", topic),
            texts=TEXTS,
        )


TEXTS = 20
"""Frames of a topic that are named."""


def _shown(key: bytes) -> str:
    return printable(beginning(frame_text(key))) or "without a name"


def _seconds(distance: int) -> str:
    return f"{abs(distance) / SECOND:.10g} s {'ahead of' if distance > 0 else 'behind'}"
