"""Clock skew monitor: detection of timestamps that do not fit the earlier ones of their topic and frame.

A wrong clock on a robot shows as timestamps that jump relative to earlier timestamps of the same publisher. Absolute
comparison with the time of receipt would be useless: a bag is years old, and clocks of different computers differ.
The monitor therefore keeps a `FrameClock` per topic and ``frame_id`` and predicts the next timestamp in several ways:
the same as the last one, or advanced by the real time, by the node's time, or by the progress of other topics. The
distance to the nearest prediction is the skew.

A bag can be paused or played faster than real time, so the highest observed rate (pace) is a factor of the
prediction. After `MIN_AGREEING_STAMPS` distant timestamps that agree with each other, the clock counts as set, and
they become the reference. At a jump of time back, messages that were still queued belong to the epoch before
(refused), and messages of the next epoch can precede the clock (`EarlyMessage`); both are recognized if the frame's
timestamps followed the node's time before.
"""

import time
from typing import Callable, Dict, Iterator, List, Optional, Set

from ...events.clock.clock import JUMP
from ...foundation.bounded_caches import Cache
from ...foundation.displayed_text import printable, shorten
from ...messages.decoder import Decoder
from ...messages.header_stamps import FrameStamp, format_frame_key, make_observed_decoder
from ...prolog.terms.timestamps import SECOND
from .problem_reports import Reports

MAX_UNREPORTED_SKEW_NS = 10 * SECOND
"""Maximum distance in ns of a timestamp from a prediction without a warning; ``max_distance_seconds`` may be less."""

MIN_AGREEING_STAMPS = 10
"""Number of consecutive messages with agreeing distant timestamps after which the clock counts as set."""

MAX_UNKNOWN_PACE = 10.0
"""Maximum pace of a bag relative to real time while no pace was measured."""

MIN_FOLLOW_NS = SECOND // 2
"""Minimum duration in ns for deciding whether timestamps follow the node's time."""

FULLY_CHECKED_MESSAGES = 100
"""Number of messages of a frame that are all checked, unless its timestamps are known earlier to follow the node's
time; afterwards one message per second is checked."""

MAX_FRAMES = 5000
"""Maximum number of frames per topic."""

MAX_FRAME_BYTES = 16 << 20
"""Maximum memory in bytes for the frames of all topics, and separately for those of the previous epoch."""

_FRAME_BYTES = 500
"""Estimated memory of a frame in bytes, in addition to its key."""

MAX_TOPICS = 1000
"""Maximum number of topics; when it is reached, all frames are removed."""

MAX_NAMED_FRAMES = 20
"""Maximum number of frames of a topic that are named in warnings."""

_UNKNOWN_SECOND = -1
"""Value of `FrameClock.second` if the next message must be checked."""


class RefusedMessage(Exception):
    """Raised for a message with a timestamp that is too far away or of the previous epoch; already reported."""


class EarlyMessage(Exception):
    """Raised for a message that may belong to an epoch that the clock has not begun; see `ClockEpochs`."""


class FrameClock:
    """Timestamps of one frame on one topic.

    Attributes:
        second: second of the last timestamp if messages of the same second need no check; negative if all need one.
        stamp: last timestamp.
        now: node's time at its receipt, which may be simulated.
        real_time: monotonic time at its receipt, which is not simulated.
        progress: progress of the timestamps of all topics at its receipt.
        pace: highest rate of timestamps relative to real time; None if unknown.
        pace_start_stamp: timestamp from which the pace is measured.
        pace_start: real time of its receipt.
        candidate: first of consecutive distant timestamps that agree with each other.
        agreeing_count: number of messages with these.
        is_reported: whether a warning was logged.
        min_offset: minimum offset, which is a timestamp minus the node's time at its receipt; negative if behind.
        max_offset: maximum offset.
        comparison_time: node's time at the receipt that later ones are compared with; 0 before the node has a time.
        comparison_offset: timestamp minus node's time at that receipt.
        follows_clock: whether the timestamps have advanced like the node's time.
        accepted_count: number of timestamps that fitted.
    """

    __slots__ = (
        "second",
        "stamp",
        "now",
        "real_time",
        "progress",
        "pace",
        "pace_start_stamp",
        "pace_start",
        "candidate",
        "agreeing_count",
        "is_reported",
        "min_offset",
        "max_offset",
        "comparison_time",
        "comparison_offset",
        "follows_clock",
        "accepted_count",
    )

    def __init__(self, stamp: int, now: int, real_time: int, progress: int):
        self.second = _UNKNOWN_SECOND
        self.stamp = stamp
        self.now = now
        self.real_time = real_time
        self.progress = progress
        self.pace: Optional[float] = None
        self.pace_start_stamp, self.pace_start = stamp, real_time
        self.candidate: Optional[FrameClock] = None
        self.agreeing_count = self.accepted_count = 0
        self.is_reported = self.follows_clock = False
        self.comparison_time = now
        self.min_offset = self.max_offset = self.comparison_offset = stamp - now

    def distance_from_prediction(self, stamp: int, now: int, real_time: int, progress: int) -> int:
        """Return the signed distance of a timestamp from the nearest prediction, in ns; positive if later.

        Predictions are the last timestamp, and the last one advanced by the time that has passed by one of the clocks
        or on other topics. A bag may be paused, and may be played at another rate. Any timestamp therefore fits that
        has advanced by at most the passed real time multiplied by the highest measured pace, or by
        `MAX_UNKNOWN_PACE` if the pace is unknown, or if a pause of the bag may have hidden it (after a second).
        """
        step, elapsed = stamp - self.stamp, real_time - self.real_time
        if 0 <= step <= elapsed * (MAX_UNKNOWN_PACE if elapsed >= SECOND or self.pace is None else self.pace):
            return 0
        return min(
            (step - prediction for prediction in (0, elapsed, now - self.now, progress - self.progress)),
            key=abs,
        )

    def accept(self, stamp: int, now: int, real_time: int, checks_all: bool) -> None:
        """Record a timestamp that fits.

        Args:
            stamp: the timestamp.
            now: node's time.
            real_time: monotonic time.
            checks_all: whether later messages of the same second must be checked, too.
        """
        # The pace is measured over at least half a second, because single intervals vary with the machine's load.
        elapsed = real_time - self.pace_start
        if elapsed >= SECOND // 2:
            self.pace = max(
                self.pace or 1.0, min((stamp - self.pace_start_stamp) / elapsed, MAX_UNKNOWN_PACE)
            )
            self.pace_start_stamp, self.pace_start = stamp, real_time
        self._update_clock_offset(stamp, now)
        self.progress += stamp - self.stamp
        self.stamp, self.now, self.real_time = stamp, now, real_time
        self.accepted_count += 1
        # The decoder skips messages of the same second as the last one, once enough is known about the frame.
        self.second = (
            _UNKNOWN_SECOND
            if checks_all or not (self.follows_clock or self.accepted_count > FULLY_CHECKED_MESSAGES)
            else stamp // SECOND
        )
        self.candidate, self.agreeing_count = None, 0

    def _update_clock_offset(self, stamp: int, now: int) -> None:
        """Update the offsets from the node's time, and decide whether timestamps advance like it.

        A busy machine delays messages, so that their timestamps seem to lag. A lagging timestamp therefore means
        nothing. One that is further ahead than before means that earlier ones were delayed, or that the timestamps
        advance too fast.
        """
        offset = stamp - now
        # The node had no time at the first receipt.
        if not self.comparison_time:
            self.comparison_time = now
            self.min_offset = self.max_offset = self.comparison_offset = offset
        elapsed = now - self.comparison_time
        self.min_offset, self.max_offset = min(self.min_offset, offset), max(self.max_offset, offset)
        # The message was accepted although it goes back, so the publisher's clock was set, and time did not go back.
        if stamp < self.stamp - JUMP:
            self.comparison_time, self.comparison_offset, self.follows_clock = now, offset, False
        elif not self.follows_clock and offset > self.comparison_offset + elapsed / 4:
            self.comparison_time, self.comparison_offset = now, offset
        elif not self.follows_clock and elapsed >= MIN_FOLLOW_NS:
            self.follows_clock = offset >= self.comparison_offset - elapsed / 4

    def is_early(self, stamp: int, now: int) -> bool:
        """Return whether a timestamp goes back, and is further behind the node's time than any before.

        It may belong to the next epoch then.
        """
        return stamp < self.stamp - JUMP and stamp - now < self.min_offset - JUMP and self.follows_clock

    def continues_epoch(self, stamp: int, end: int, now: int) -> bool:
        """Return whether a timestamp continues the epoch that ended at ``end``: it is ahead of the present time."""
        is_continuation = (
            self.stamp <= stamp <= end + self.max_offset + JUMP + (self.max_offset - self.min_offset)
        )
        return is_continuation and stamp - now > self.max_offset + JUMP and self.follows_clock

    def add_distant(
        self, stamp: int, now: int, real_time: int, progress: int, max_distance: int, is_first: bool
    ) -> bool:
        """Record a distant timestamp; return whether those of enough consecutive messages agree.

        Args:
            stamp: the timestamp.
            now: node's time.
            real_time: monotonic time.
            progress: progress of the timestamps of all topics.
            max_distance: maximum distance in ns of timestamps that agree.
            is_first: whether it is the first timestamp of the frame in its message.
        """
        reference = self.candidate
        if (
            reference is not None
            and abs(reference.distance_from_prediction(stamp, now, real_time, progress)) <= max_distance
        ):
            # The elements of one message agree also if its publisher is wrong.
            self.agreeing_count += is_first
            reference.accept(stamp, now, real_time, True)
        else:
            self.candidate, self.agreeing_count = FrameClock(stamp, now, real_time, progress), 1
        self.second = _UNKNOWN_SECOND
        return self.agreeing_count >= MIN_AGREEING_STAMPS


class TopicFrames(Cache[bytes, FrameClock]):
    """Frames of a topic, by the bytes of their ids.

    Attributes:
        previous_frames: frames of the previous epoch that have not occurred in the present one.
        distant_count: number of messages with a distant timestamp.
        refused_count: number of these that were refused.
        first_distance: distance in ns in the first warning about a frame; None if there was none.
        are_all_reported: whether a warning about other frames at the same distance was logged.
        reported_step: step in ns in the last warning about a clock that was set; None if there was none.
    """

    __slots__ = (
        "name",
        "previous_frames",
        "distant_count",
        "refused_count",
        "first_distance",
        "are_all_reported",
        "reported_step",
    )

    def __init__(self, name: str):
        super().__init__(MAX_FRAMES, 4 << 20, 1 << 12)
        self.name = name
        self.previous_frames: Dict[bytes, FrameClock] = {}
        self.distant_count = self.refused_count = 0
        self.first_distance: Optional[int] = None
        self.are_all_reported = False
        self.reported_step: Optional[int] = None

    def clear(self) -> None:
        """Remove all frames, and invalidate references to them."""
        for frame in list(self.values()):
            frame.second = _UNKNOWN_SECOND
        super().clear()


class ClockSkewMonitor:
    """Monitor of the timestamps of messages, which are compared with those of the same topic and frame.

    The first timestamp of a frame defines its reference. The time of receipt and other frames are no reference,
    because bags are old and the clocks of a robot differ.

    The monitor is not thread-safe: decoders of `watch` and methods are called under one lock, in a node
    `MessageProcessing.lock`.

    Args:
        reports: receives a warning per topic and frame.
        now: returns the node's time.
        real_time: returns the monotonic time in ns, which is not simulated.
        max_distance_seconds: distance in seconds from which messages are refused; None for no limit.
        buffers_early_messages: returns whether messages may be delayed as `EarlyMessage`.
    """

    def __init__(
        self,
        reports: Reports,
        now: Callable[[], int],
        real_time: Callable[[], int] = time.monotonic_ns,
        max_distance_seconds: Optional[float] = None,
        buffers_early_messages: Callable[[], bool] = lambda: False,
    ):
        self._reports = reports
        self._now = now
        self._real_time = real_time
        self.set_max_distance(max_distance_seconds)
        self._topics: Dict[str, TopicFrames] = {}
        self._progress = 0
        self._buffers_early_messages = buffers_early_messages
        self._previous_epoch_end = 0
        self._frame_bytes = 0

    def set_max_distance(self, seconds: Optional[float]) -> None:
        """Set the distance in seconds from which messages are refused; None for no limit."""
        self._max_distance = None if seconds is None else round(seconds * SECOND)
        self._max_skew = (
            MAX_UNREPORTED_SKEW_NS
            if self._max_distance is None
            else min(MAX_UNREPORTED_SKEW_NS, self._max_distance)
        )
        self._checks_all = self._max_skew < MAX_UNREPORTED_SKEW_NS

    def __iter__(self) -> Iterator[TopicFrames]:
        return iter(list(self._topics.values()))

    def watch(self, decoder: Decoder, topic: str, publisher: str = "") -> Decoder:
        """Return a decoder that also checks the timestamps of each message.

        The caller must call both `decode` and `stamp`, because either may run the check. The check raises
        `RefusedMessage` for a message to be dropped, and `EarlyMessage` for one to be delayed.
        """
        frames = self._topics.get(topic)
        if frames is None:
            if len(self._topics) >= MAX_TOPICS:
                # Also invalidates the references that existing decoders hold.
                self.reset()
                self._topics.clear()
            frames = self._topics[topic] = TopicFrames(topic)
        topic_frames = frames
        return make_observed_decoder(
            decoder, topic_frames, lambda stamps: self._check_message(topic_frames, publisher, stamps)
        )

    def reset(self) -> None:
        """Remove all frames, because another stream begins."""
        for frames in self:
            frames.previous_frames = {}
        self._clear()

    def begin_epoch(self, previous_end: int) -> None:
        """Begin a new epoch after time went back.

        Args:
            previous_end: last instant of the previous epoch; messages that continue it are refused.
        """
        self._previous_epoch_end = previous_end
        for frames in self:
            frames.previous_frames = dict(frames)
        self._clear()

    def _clear(self) -> None:
        for frames in self:
            frames.clear()
        self._frame_bytes = 0

    def log_counts(self) -> None:
        """Log the number of messages with distant timestamps per topic, if more than one."""
        for frames in self:
            if frames.distant_count > 1:
                refused = f", {frames.refused_count} of them dropped" if frames.refused_count else ""
                self._reports.warning(
                    f"topic {frames.name}: {frames.distant_count} messages in all "
                    f"had a stamp far from those before{refused}"
                )

    def _check_message(self, frames: TopicFrames, publisher: str, stamps: List[FrameStamp]) -> None:
        """Check the timestamps of a message.

        Raises:
            RefusedMessage: if a timestamp is too far away, or belongs to the previous epoch.
            EarlyMessage: if a timestamp may belong to the next epoch.
        """
        now, real_time = self._now(), self._real_time()
        farthest = 0
        self._check_epoch(frames, stamps, now)
        checked_keys: Set[bytes] = set()
        for key, stamp in stamps:
            is_first = key not in checked_keys
            checked_keys.add(key)
            frame = frames.get(key)
            if frame is None:
                self._store_frame(frames, key, FrameClock(stamp, now, real_time, self._progress))
                continue
            # Most timestamps are near the last one, which saves the full prediction.
            max_skew, distance = self._max_skew, stamp - frame.stamp
            if not -max_skew <= distance <= max_skew:
                distance = frame.distance_from_prediction(stamp, now, real_time, self._progress)
            if not -max_skew <= distance <= max_skew:
                if not frame.add_distant(stamp, now, real_time, self._progress, self._max_skew, is_first):
                    farthest = max(farthest, abs(distance))
                    self._warn_about_distance(frames, frame, key, distance, publisher)
                    continue
                self._warn_about_set_clock(frames, key, stamp - frame.stamp)
                # A set clock is a step and not progress, so the common progress must not follow it.
                frame.stamp = frame.pace_start_stamp = stamp
                frame.pace_start = real_time
            frame.accept(stamp, now, real_time, self._checks_all)
            if frame.progress > self._progress:
                self._progress = frame.progress
        if farthest:
            frames.distant_count += 1
            if self._max_distance is not None and farthest > self._max_distance:
                frames.refused_count += 1
                raise RefusedMessage

    def _check_epoch(self, frames: TopicFrames, stamps: List[FrameStamp], now: int) -> None:
        """Check whether a message belongs to another epoch.

        Raises:
            RefusedMessage: if it belongs to the previous epoch.
            EarlyMessage: if it may belong to the next epoch.
        """
        previous_frames = frames.previous_frames
        for key, stamp in stamps:
            frame = frames.get(key)
            if frame is not None and frame.is_early(stamp, now) and self._buffers_early_messages():
                raise EarlyMessage
            previous_frame = previous_frames.get(key) if previous_frames else None
            if previous_frame is None:
                continue
            if previous_frame.continues_epoch(stamp, self._previous_epoch_end, now):
                self._reports.warning(
                    f"a message on {frames.name} is dropped: it is of the time before the clock went back",
                    ("left over", frames.name),
                )
                raise RefusedMessage
            # The frame has occurred in the present epoch.
            del previous_frames[key]

    def _store_frame(self, frames: TopicFrames, key: bytes, frame: FrameClock) -> None:
        """Store a frame. If the frames of all topics exceed the limit together, all are removed."""
        bytes_before = frames.total_bytes
        frames.store(key, frame, _FRAME_BYTES + 2 * len(key))
        self._frame_bytes += frames.total_bytes - bytes_before
        if self._frame_bytes > MAX_FRAME_BYTES:
            self._clear()
            frames.store(key, frame, _FRAME_BYTES + 2 * len(key))
            self._frame_bytes = frames.total_bytes

    def _warn_about_distance(
        self, frames: TopicFrames, frame: FrameClock, key: bytes, distance: int, publisher: str
    ) -> None:
        """Warn about the first distant timestamp of a frame."""
        if frame.is_reported:
            return
        frame.is_reported = True
        topic = frames.name
        if frames.first_distance is None:
            frames.first_distance = distance
        # If the clock of the publisher was set, all of its frames are equally far; one warning covers them.
        elif abs(frames.first_distance - distance) <= MAX_UNREPORTED_SKEW_NS:
            self._warn_about_all_frames(frames, distance)
            return
        place = f"topic {topic}, frame {_format_frame_name(key)}"
        origin = f" from {printable(shorten(publisher))}" if publisher else ""
        consequence = (
            ""
            if self._max_distance is None or abs(distance) <= self._max_distance
            else "; such messages are dropped"
        )
        self._reports.warning(
            f"{place}: a stamp{origin} is {_format_distance(distance)} the stamps before it{consequence}",
            ("skew", topic),
            texts=MAX_NAMED_FRAMES,
        )

    def _warn_about_all_frames(self, frames: TopicFrames, distance: int) -> None:
        if frames.are_all_reported:
            return
        frames.are_all_reported = True
        cause = "a bag that is played again without /clock, or a clock" if distance < 0 else "a clock"
        self._reports.warning(
            f"topic {frames.name}: the stamps of other frames are {_format_distance(distance)} those before them "
            f"too, as by {cause} that was set; such frames are not named"
        )

    def _warn_about_set_clock(self, frames: TopicFrames, key: bytes, step: int) -> None:
        """Warn that a clock counts as set, unless a warning about other frames covers it."""
        if (
            frames.are_all_reported
            and frames.reported_step is not None
            and abs(frames.reported_step - step) <= MAX_UNREPORTED_SKEW_NS
        ):
            return
        frames.reported_step = step
        topic = frames.name
        self._reports.warning(
            f"topic {topic}, frame {_format_frame_name(key)}: the last {MIN_AGREEING_STAMPS} stamps agree and are "
            f"{_format_distance(step)} those before them; they count as correct from now on",
            ("set clock", topic),
            texts=MAX_NAMED_FRAMES,
        )


def _format_frame_name(key: bytes) -> str:
    return printable(shorten(format_frame_key(key))) or "without a name"


def _format_distance(distance: int) -> str:
    return f"{abs(distance) / SECOND:.10g} s {'ahead of' if distance > 0 else 'behind'}"
