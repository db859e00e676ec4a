"""The rule that nodes belong to and what it is part of, as far as nodes look at them."""

from typing import Any, Hashable, List, Optional, Protocol, Tuple

from ...foundation import RetalisError, RuleError
from ...prolog.machine import Frame
from ...prolog.terms import Term
from ..dispatch import EventAction, Listener
from ..fused import Completion
from ..history import Fired, Remembered, Tracker
from ..matches import Match, MatchBuffer, NetworkOptions, Owner
from ..streams import KeyBounds


class Listening(Protocol):
    """A node that waits for events."""

    @property
    def term(self) -> Term:
        """What the events unify with."""

    @property
    def rank(self) -> int:
        """Its place among the nodes of the rule: lower ones are served first."""


class Buffer(Protocol):
    """Where matches wait.

    Attributes:
        forbids: whether what waits is about what must not happen.
    """

    forbids: bool

    @property
    def span(self) -> Optional[int]:
        """For how many nanoseconds what waits is of use; None for no bound."""

    def mend(self) -> List[Match]:
        """Put right what an interrupt may have left half done; return what waits, oldest first."""


class Wakeful(Protocol):
    """What nodes that the clock wakes belong to: a rule, or what stands beside rules.

    Attributes:
        serial: its place among them: lower ones are served first.
    """

    serial: int

    @property
    def active(self) -> bool:
        """Whether it takes events."""


class Woken(Protocol):
    """A node that the clock wakes.

    Attributes:
        woken: the instant at which it is to be woken.
        place: its place among the nodes of the same.
    """

    woken: Optional[int]
    place: int

    @property
    def rule(self) -> "Wakeful":
        """What it belongs to."""

    def ring(self, instant: int, after: Frame, /) -> Frame:
        """Return the frame that does what is due, and goes on with ``after``."""


class UnderWay:
    """What the conditions of all rules share while they are tested.

    Attributes:
        nested: how many of them are being tested, one within the other.
        checked: the interval that ``t1/1`` and ``t2/1`` give, of the innermost that has one.
    """

    nested: int = 0
    checked: Optional[Tuple[int, int]] = None


class Counted(Protocol):
    """What a rule counts.

    Attributes:
        errors: how many errors it had.
    """

    errors: int


class Network(Remembered, Protocol):
    """All rules of a program, as one of them sees the others."""

    @property
    def under_way(self) -> UnderWay:
        """What conditions share while they are tested."""

    @property
    def tracker(self) -> Tracker:
        """What keeps what events came from."""

    def time(self) -> int:
        """Return the present instant, by which alarms ring."""

    def wake(self, node: "Woken", instant: int) -> None:
        """Have a node ring when an instant has come."""

    def came_late(self, rule: "RuleOwner", what: str) -> None:
        """Report that a match of a rule came too late to be taken."""

    def newest_allowed(self) -> int:
        """Return the newest stamp that may move the clock of a rule."""

    def dropped(self, rule: "RuleOwner", ways: int = 0) -> None:
        """Report that a rule has too many partial matches, or more than `ways` ways to take steps from one start."""

    @property
    def key_bounds(self) -> KeyBounds:
        """The bounds of the states of keys that flags set for all rules."""

    def dropped_key(self, rule: "RuleOwner") -> None:
        """Report that an operator of a rule has too many keys."""

    def set_alarm(self, rule: "RuleOwner", term: Term, start: int, instant: int, token: Any = None) -> None:
        """Have an event fire when its instant has come."""

    def look_at_alarm(self, rule: "RuleOwner", head: Term, alarm: Optional[Tuple[Term, int, int]]) -> None:
        """Report an alarm for an instant that is over."""

    def goal_failed(self, rule: "RuleOwner", goal: Term, error: RetalisError) -> None:
        """Report an error that a goal of a rule raised."""

    def rule_failed(self, rule: "RuleOwner", error: RuleError) -> None:
        """Report what stopped a rule from firing."""


class RuleOwner(Owner, Fired, Protocol):
    """A rule, as its nodes see it.

    Attributes:
        mode: how it runs: what the flags say, and the properties of its label.
        window: the longest interval that its label allows, in ns; None for no bound.
        idle: the time in ns for which what has no new event is kept; None for no bound.
        clock: the newest end among the events that its patterns matched.
        timed: whether its clock has to be kept.
        double: whether one event may be in two parts of a match.
        later: the matches that are to wait when another event comes.
        listeners: of its leaves.
        dropped: how many partial matches it has lost so far.
        alarms_dropped: how many alarms were not set.
        alarms_past: how many were for an instant that was over.
        root: the node of its whole pattern.
        completion: what takes the values of whole matches, where nothing is tracked.
        late: how many matches came too late to be taken.
        serial: the place among the rules: older ones are served first.
    """

    mode: NetworkOptions
    window: Optional[int]
    idle: Optional[int]
    serial: int
    late: int
    clock: int
    timed: bool
    double: bool
    later: List[Tuple[MatchBuffer, Match, Hashable]]
    listeners: List[Listener]
    dropped: int
    alarms_dropped: int
    alarms_past: int
    root: Any
    completion: Optional[Completion]

    @property
    def collects(self) -> bool:
        """Whether garbage control removes what waits."""

    @property
    def network(self) -> Network:
        """All rules of the program."""

    @property
    def skipping(self) -> Optional[Any]:
        """What its matches have skipped, see `Skipping`; None where they skip nothing."""

    @property
    def firings(self) -> "Counted":
        """What it counts."""

    @property
    def active(self) -> bool:
        """Whether it takes events."""

    def tick(self, end: int) -> None:
        """Move the rule's clock and remove what is too old by it."""

    def listen(self, leaf: Listening, action: EventAction, fused: bool = False) -> None:
        """Have a leaf's action called for its events."""

    def add_later(self, buffer: MatchBuffer, match: Match, key: Hashable) -> None:
        """Let a match wait in a buffer when the next event comes."""

    def settle(self, only: Optional[MatchBuffer] = None) -> None:
        """Let all matches wait that are to wait; with ``only``, those of one buffer."""
