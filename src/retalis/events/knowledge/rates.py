"""Which events of a subscription are sent: those that a shape lets through, as in rules, ``P with S``."""

from typing import Any, Callable, List, Optional, Protocol, Sequence, Tuple

from ...prolog.machine import Frame
from ...prolog.terms import Term, Values, Var
from ..language import Shaped
from ..matches import NetworkOptions
from ..network import Woken, shaping
from ..streams import KeyBounds, StreamItem, StreamOperator, StreamOutput
from .recording import Warn

KeptRate = Tuple[Any, int, int]
"""What the shape knows, and how many events came too late or were too many."""


def looked_at(part: Shaped) -> Tuple[Term, ...]:
    """Return the terms that a shape looks at."""
    return part.by if part.value is None else (part.value, *part.by)


class RateClock(Protocol):
    """All rules of a program, as subscriptions look at them: they ring what has come due.

    Attributes:
        cap: how many events, or keys, a shape may hold.
        key_bounds: the bounds of the states of keys that flags set.
    """

    cap: int
    key_bounds: KeyBounds

    def time(self) -> int:
        """Return the present instant, by which alarms ring."""

    def wake(self, node: Woken, instant: int) -> None:
        """Have a node ring when an instant has come."""

    def newest_allowed(self) -> int:
        """Return the newest stamp that may move time on."""


class SubscriptionRate:
    """Sends what a shape lets through of the events that a subscription would send without it.

    It is woken as the nodes of rules are, before all of them: subscribers get an event first.

    Args:
        part: the shape.
        names: the variables of the pattern.
        name: of the subscription, for reports.
        clock: tells the time and rings.
        warn: takes a warning.
        place: its place among all subscriptions.

    Attributes:
        send: sends what an event has been made into.
        serial: its place among the rules.
        active: whether it may be woken.
        woken: the instant at which it is to be woken; None where it is not.
        late: how many events came too late to be taken.
        dropped: how many were dropped because there were too many.
        widths: how many values group its events, and how many are looked at.
    """

    serial = 0

    def __init__(
        self, part: Shaped, names: Sequence[Var], name: str, clock: RateClock, warn: Warn, place: int
    ):
        self._making = shaping(part, names)
        self.widths = (len(part.by), int(part.value is not None))
        self._name = name
        self._clock = clock
        self._warn = warn
        self.send: Callable[[Term], None] = lambda term: None
        self.place = place
        self.active = True
        self.woken: Optional[int] = None
        self.late = self.dropped = self._evicted = 0
        self._stream = self._begin()

    def _begin(self) -> StreamOperator:
        stream = self._making.stream(NetworkOptions())
        stream.allowed = self._clock.newest_allowed
        stream.set_bounds(self._clock.key_bounds)
        self._evicted = 0
        return stream

    def __len__(self) -> int:
        """Return how many events, or keys, are held."""
        return len(self._stream)

    @property
    def stream(self) -> StreamOperator:
        """The operator that lets events through."""
        return self._stream

    @property
    def rule(self) -> "SubscriptionRate":
        """What it belongs to, see `Woken`."""
        return self

    def take(self, made: Term, values: Values, start: int, end: int) -> None:
        """Take an event that the subscription would send.

        Args:
            made: what it has been made into.
            values: of the variables of the pattern.
            start: where its interval starts.
            end: where it ends.
        """
        now = self._clock.time() if self._making.clocked else 0
        stream = self._stream
        before = stream.late
        if stream.bounds is not self._clock.key_bounds:
            stream.set_bounds(self._clock.key_bounds)
        outputs = stream.take(StreamItem(made, start, end, *self._making.item(values)), now, 0)
        if stream.late != before:
            self.late += 1
            self._warn(f"{self._name}: {self._making.past}; {self.late} so far", ("late", self._name))
        if len(stream) > self._clock.cap:
            outputs = [*outputs, *stream.drop_oldest()]
            self.dropped += 1
            what = (
                f"more than {self._clock.cap} events are held; {self.dropped} of the oldest have been dropped"
            )
            self._warn(f"{self._name}: {what} so far", ("dropped", self._name))
        if stream.evicted != self._evicted:
            self.dropped += stream.evicted - self._evicted
            self._evicted = stream.evicted
            what = f"more than {stream.bounds.keys} keys are held; {self.dropped} of the oldest have been dropped"
            self._warn(f"{self._name}: {what} so far", ("dropped", self._name))
        self._wake()
        self._send(outputs)

    def ring(self, instant: int, after: Frame) -> Frame:
        """Send what is due; see `Woken`."""
        self.woken = None
        outputs = self._stream.ring(instant)
        self._wake()
        self._send(outputs)
        return after

    def _send(self, outputs: List[StreamOutput]) -> None:
        for output in outputs:
            self.send(output.items[-1].match)

    def _wake(self) -> None:
        instant = self._stream.next
        if self.active and instant is not None and (self.woken is None or instant < self.woken):
            self.woken = instant
            self._clock.wake(self, instant)

    # ---- from outside --------------------------------------------------------------------------------

    def stop(self) -> None:
        """Ring no more."""
        self.active = False
        self.woken = None

    def clear(self) -> None:
        """Forget what has come: time went back, or the program asks for it."""
        self._stream = self._begin()
        self.woken = None

    def mend(self) -> None:
        """Put right what an interrupt may have left half done."""
        self.restore(self.kept())

    def kept(self) -> KeptRate:
        """Return what it knows; see `restore`."""
        return self._stream.kept(), self.late, self.dropped

    def restore(self, kept: KeptRate) -> None:
        """Know what another one did that was made in the same way."""
        known, self.late, self.dropped = kept
        self._stream = self._begin()
        self._stream.restore(known)
        self.woken = None
        self._wake()
