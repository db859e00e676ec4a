"""Partial matches, and what can be asked about them.

By what a network runs: the consumption policy, and what else the flags say.

The rule that matches wait for and what is around it, as far as matches look at them.
"""

from enum import Enum
from typing import (
    TYPE_CHECKING,
    Any,
    Dict,
    Hashable,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Protocol,
    Tuple,
    Union,
)

from ...prolog.terms.term_traversal import copy, resolve, term_key
from ...prolog.terms.types import Term, Trail, Values, Var
from ...prolog.terms.unification import undo, unify


class Waited(Protocol):
    """Where a match waits, as the match sees it.

    Attributes:
        span: for how many nanoseconds what waits is of use; None for no bound.
        forbids: whether what waits is about what must not happen.
    """

    @property
    def span(self) -> Optional[int]:
        """See above."""

    @property
    def forbids(self) -> bool:
        """See above."""

    def remove(self, match: "PartialMatch") -> None:
        """Take out a match that waits here."""


class EventMatch:
    """A match of one event whose arguments are the values of its pattern.

    It has the attributes of a `PartialMatch` and is annotated as one, but takes 32 bytes less: millions may wait.
    Only `values`, `event` and `parts` cannot be set.

    Attributes:
        values: the arguments of the event.
        start: where the interval starts.
        end: where it ends.
        event: None.
        term: the event.
        parts: None.
        buffer: where it waits; None while it does not wait (any more).
        key: under which key it waits there.
        older: the one that began to wait under the key before it; that of the oldest is the newest.
        newer: the one that began to wait there after it.
        order: the larger, the later it began to wait.
        identity: what it has in common with those that it replaces there; None while nobody has asked.
        used: what it last completed something with and was used up by; else None.
    """

    __slots__ = (
        "start",
        "end",
        "term",
        "buffer",
        "key",
        "older",
        "newer",
        "order",
        "identity",
        "used",
    )

    start: int
    end: int
    term: Any  # whoever asks for it knows that it is of one event
    buffer: Optional[Waited]
    key: Hashable
    older: "PartialMatch"
    newer: "PartialMatch"
    order: int
    identity: Hashable
    used: "Optional[PartialMatch]"

    if TYPE_CHECKING:
        values: Values
        event: Hashable
        parts: "Optional[Parts]"
    else:
        event = parts = None

        @property
        def values(self) -> Values:
            """The arguments of the event."""
            return self.term[1:]

        def __getattr__(self, name: str) -> Any:
            """Give a match the attribute that it was made without: the values are the arguments of its event."""
            if name not in _LEFT_OUT:
                raise AttributeError(name)
            found = self.term[1:] if name == "values" else None
            setattr(self, name, found)
            return found

    @property
    def latest(self) -> int:
        """The largest end so far: what waits is as old as that."""
        return self.end

    @property
    def filed_by(self) -> Values:
        """The values of which those that are shared are the key under which it waits."""
        return self.values

    def mend(self) -> None:
        """Put right what an interrupt may have left half done."""

    def leave(self) -> None:
        """Take the match out of where it waits, if it does."""
        if self.buffer is not None:
            self.buffer.remove(self)  # type: ignore[arg-type]  # annotated as what it is like


class PartialMatch(EventMatch):
    """A match of a node of a pattern.

    Attributes:
        values: the values of the node's variables.
        event: the token of the event, where the match is of one single event; else None.
        term: the event, where it is the match of an event pattern.
        parts: what else it was put together from: matches, `TrackedMatch` and `Found`, and the number of a branch.

    The other attributes are those of `EventMatch`.
    """

    __slots__ = ("values", "event", "parts")

    def __init__(
        self,
        values: Values,
        start: int,
        end: int,
        event: Hashable,
        term: Optional[Term],
        parts: "Optional[Parts]",
    ):
        self.values = values
        self.start = start
        self.end = end
        self.event = event
        self.term = term
        self.parts = parts
        self.buffer = None
        self.used = None


_LEFT_OUT = frozenset(("values", "event", "parts", "identity", "used"))


class TrackedMatch:
    """Matches that one was made of without being told apart by them: the repetitions of a run.

    Each repetition has one, which knows the one before it: what a run has given on, again and again, shares them.

    Attributes:
        match: the last of the repetitions; None where there is none.
        earlier: what is held of those before it.
        number: that of the last event in it, see `arrival`.
        linked: whether what it came from knows it, where events are tracked.
        derived, held, suppressed, gone, reported, forgotten: as of an event that is tracked.
    """

    __slots__ = (
        "match",
        "earlier",
        "number",
        "linked",
        "derived",
        "held",
        "suppressed",
        "gone",
        "reported",
    )

    forgotten = False

    def __init__(self, match: Optional[PartialMatch], earlier: Optional["TrackedMatch"]):
        self.match = match
        self.earlier = earlier
        self.number: int = 0 if match is None or earlier is None else max(earlier.number, arrival(match))
        self.linked = self.gone = self.reported = False
        self.derived: List[Any] = []
        self.held: List[Holder] = []
        self.suppressed: List[Any] = []

    @property
    def matches(self) -> List[PartialMatch]:
        """All of the repetitions, oldest first."""
        found = []
        one: Optional[TrackedMatch] = self
        while one is not None and one.match is not None:
            found.append(one.match)
            one = one.earlier
        found.reverse()
        return found


NOTHING_HELD = TrackedMatch(None, None)


class Repetitions:
    """Matches that one was made of, one after the other; told apart by them, as by parts."""

    __slots__ = ()

    @property
    def matches(self) -> List[PartialMatch]:
        """All of them, oldest first."""
        raise NotImplementedError


class Found(NamedTuple):
    """Values that goals, repetitions and aggregates have given a match and that are not carried on.

    They tell it from others, as do those that are; see `telling`.
    """

    values: Values


class Named(NamedTuple):
    """The name of a match where it waits, if its events do not give all the values that it carries.

    Attributes:
        structure: its `identity`.
        values: what those variables stand for; they may get their values further up.
    """

    structure: Hashable
    values: Tuple[Hashable, ...]


MatchPart = Union[PartialMatch, TrackedMatch, Repetitions, Found, int]
Parts = Tuple[MatchPart, ...]
Holder = Union[PartialMatch, Tuple[Any, ...]]
"""What is made of an event: a match that waits, or a node and what it is to forget, see `Tracker`."""


class Identity:
    """What tells a match of several parts from others: their keys, compared without recursion.

    That of a long sequence shares those of its beginnings, so that it takes no longer to make than a short one.
    """

    __slots__ = ("parts", "hash")

    def __init__(self, parts: Tuple[Hashable, ...]):
        self.parts = parts
        self.hash = hash(parts)

    def __hash__(self) -> int:
        return self.hash

    def __eq__(self, other: object) -> bool:
        pairs: List[Tuple[Any, Any]] = [(self, other)]
        while pairs:
            one, two = pairs.pop()
            if one is two:
                continue
            if one.__class__ is Identity and two.__class__ is Identity:
                if one.hash != two.hash or len(one.parts) != len(two.parts):
                    return False
                pairs += zip(one.parts, two.parts)
            elif one.__class__ is Identity or two.__class__ is Identity or one != two:
                return False
        return True


def identity(match: EventMatch) -> Hashable:
    """Return a key: equal for two matches of a node made of identical event terms, carried values apart."""
    if match.parts is None:
        return term_key(match.term)
    path: List[EventMatch] = [match]
    while path[-1].__class__ is not PartialMatch or path[-1].identity is None:
        parts = path[-1].parts
        if not parts or not isinstance(parts[0], EventMatch):
            break
        path.append(parts[0])
    last = path[-1]
    waited = last.__class__ is PartialMatch and last.identity is not None
    found: Hashable = last.identity if waited else _identity_of(last, ())
    if waited and found.__class__ is Named:
        named: Any = found
        found = named.structure
    for one in reversed(path[:-1]):
        found = _identity_of(one, (found,))
    return found


def _identity_of(match: EventMatch, key: Tuple[Hashable, ...]) -> Hashable:
    """Return the identity of a match, given those of its first parts."""
    parts = match.parts
    if parts is None:
        return term_key(match.term)
    part: Any
    for part in parts[len(key) :]:
        if isinstance(part, EventMatch):
            key += (identity(part),)
        elif part.__class__ is Found:
            key += (tuple([term_key(value) for value in part.values]),)
        elif part.__class__ is not TrackedMatch:
            key += (part,)
    return key[0] if len(key) == 1 else Identity(key)


def leaves(match: PartialMatch) -> Iterator[Hashable]:
    """Yield the tokens of the events that a match was made of, in the order of the pattern."""
    inner: Any
    stack: List[EventMatch] = [match]
    while stack:
        part = stack.pop()
        if part.parts is None:
            yield part.event
        else:
            for inner in reversed(part.parts):
                if isinstance(inner, EventMatch):
                    stack.append(inner)
                elif inner.__class__ is TrackedMatch or isinstance(inner, Repetitions):
                    stack.extend(reversed(inner.matches))


def sources(match: PartialMatch) -> Iterator[Hashable]:
    """Yield the tokens of the events that a match was made of; for those of repetitions the last `TrackedMatch`."""
    inner: Any
    stack: List[EventMatch] = [match]
    while stack:
        part = stack.pop()
        if part.parts is None:
            yield part.event
            continue
        for inner in reversed(part.parts):
            if isinstance(inner, EventMatch):
                stack.append(inner)
            elif inner.__class__ is TrackedMatch:
                if inner.match is not None:
                    yield inner
            elif isinstance(inner, Repetitions):
                stack.extend(reversed(inner.matches))


def arrival(match: PartialMatch) -> int:
    """Return the number of the last event of a match: when it was complete. 0 where events are not tracked."""
    return max((getattr(token, "number", 0) for token in sources(match)), default=0)


def taken_back(match: PartialMatch) -> bool:
    """Tell whether an event of a match was taken back."""
    return any(getattr(token, "gone", False) for token in leaves(match))


def unify_sides(
    left: PartialMatch, right: PartialMatch, shared: Tuple[Tuple[int, int], ...]
) -> Optional[Tuple[PartialMatch, PartialMatch]]:
    """Unify shared values that have variables.

    Returns copies of the two sides with the values that follow, or None where they do not unify.
    """
    lefts = list(_renamed(left.values))
    rights = list(_renamed(right.values))
    trail: Trail = []
    result = None
    if all(unify(lefts[one], rights[other], trail) for one, other in shared):
        result = (_with(left, lefts), _with(right, rights))
    return result  # only variables of the copies are bound, so nothing has to be undone


def agreed(left: Values, right: Values) -> Optional[Values]:
    """Unify values pairwise; return them, or None where they differ."""
    trail: Trail = []
    result = None
    if all(unify(one, other, trail) for one, other in zip(left, right)):
        result = tuple([resolve(one) for one in left])
    undo(trail, 0)
    return result


def _renamed(values: Values) -> Values:
    fresh: Dict[Var, Term] = {}
    return tuple([copy(value, fresh) for value in values])


def _with(match: PartialMatch, values: List[Term]) -> PartialMatch:
    return PartialMatch(
        tuple([resolve(value) for value in values]),
        match.start,
        match.end,
        match.event,
        match.term,
        match.parts,
    )


class ConsumptionPolicy(Enum):
    """A consumption policy; see the table in the language reference."""

    RECENT = "recent"
    """The newest that fits; a newer occurrence of the same event replaces a waiting one."""
    RECENT_2 = "recent_2"
    """The newest that fits; identical events both wait."""
    CHRONOLOGICAL = "chronological"
    """The oldest that fits."""
    CHRONOLOGICAL_2 = "chronological_2"
    """The oldest that fits."""
    UNRESTRICTED = "unrestricted"
    """All that fit, oldest first; nothing is used up."""

    @property
    def newest(self) -> bool:
        """Whether the newest partner is taken first."""
        return self in (ConsumptionPolicy.RECENT, ConsumptionPolicy.RECENT_2)

    @property
    def consuming(self) -> bool:
        """Whether a partner is used up."""
        return self is not ConsumptionPolicy.UNRESTRICTED

    @property
    def replacing(self) -> bool:
        """Whether a newer occurrence of the same event replaces the one that waits."""
        return self is ConsumptionPolicy.RECENT


class AfterMatchSkipStrategy(Enum):
    """What a match that has fired skips; see "After a match" in the language reference."""

    KEEP = "keep"
    """Nothing."""
    SKIP_PAST_LAST = "skip_past_last"
    """What starts at or before its end: the next match begins after it."""
    SKIP_TO_NEXT = "skip_to_next"
    """What starts where it does: one start gives one match."""


class NetworkOptions(NamedTuple):
    """How the network runs: set by flags, and for a rule also by the properties of its label."""

    policy: ConsumptionPolicy = ConsumptionPolicy.RECENT
    out_of_order: bool = False
    tracked: bool = False
    revised: bool = False
    after_match: AfterMatchSkipStrategy = AfterMatchSkipStrategy.KEEP


def with_property(mode: NetworkOptions, name: str, word: str) -> NetworkOptions:
    """Return a mode as a property of a label changes it, for the rules of that label."""
    if name == "policy":
        return mode._replace(policy=ConsumptionPolicy(word))
    if name == "after_match":
        return mode._replace(after_match=AfterMatchSkipStrategy(word))
    assert name == "out_of_order", name
    return mode._replace(out_of_order=word == "on")
