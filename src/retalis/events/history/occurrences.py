"""Events as they are remembered: what they came from, what came from them, what they kept from firing."""

from typing import Any, Iterator, List, Optional, Protocol, Sequence, Tuple, Union

from ...prolog.machine import Frame
from ...prolog.terms import Term
from ..matches import Held, Holder, Match, leaves, sources, taken_back
from .owners import Fired


class Occurrence:
    """An event that was dispatched.

    Attributes:
        term, start, end: the event.
        rule: the rule that fired it, or None.
        match: what its rule, or the goal that made it, had matched; None for an event from outside.
        derived: the events that came from it, while it is remembered.
        forgotten: whether it is too old to be remembered; what waits may still hold it.
        held: partial matches that hold it.
        gone: whether it was taken back.
        reported: whether that has been said: by the ``rev`` that named it, or by one that was derived for it.
        takes_back: the occurrences that it takes back, for an event ``rev(E)`` that was derived.
        suppressed: what it has kept from firing, with the node to try again.
        number: the larger, the later it was dispatched; 0 for what has not happened: an alarm that is pending, or
            an event that was refused.
    """

    __slots__ = (
        "number",
        "term",
        "start",
        "end",
        "rule",
        "match",
        "derived",
        "forgotten",
        "held",
        "gone",
        "reported",
        "takes_back",
        "suppressed",
    )

    def __init__(self, term: Term, start: int, end: int, rule: Optional[Fired], match: Optional[Match]):
        self.term = term
        self.start = start
        self.end = end
        self.rule = rule
        self.match = match
        self.derived: List[Tracked] = []
        self.forgotten = False
        self.held: List[Holder] = []
        self.gone = False
        self.reported = False
        self.takes_back: Optional[List[Occurrence]] = None
        self.suppressed: List[Suppressed] = []
        self.number = 0

    def follows(self, found: "Sequence[Tracked]") -> None:
        """Have what it came from know it."""
        for source in found:
            if not source.forgotten:
                source.derived.append(self)

    def sources(self) -> List["Occurrence"]:
        """Return the occurrences that it came from."""
        return [] if self.match is None else occurrences_in(self.match)


Tracked = Union[Occurrence, Held]
Tried = Union[Match, Tuple[Match, Match]]
"""A match, or two that are to be joined."""


def following(source: Tracked) -> Iterator[Occurrence]:
    """Yield the events that came from one and that nobody has been told of; what has been is not gone into.

    Nor is what has not happened: nobody knows of it.
    """
    stack = source.derived[::-1]
    while stack:
        one = stack.pop()
        if not one.reported:
            one.reported = True
            if isinstance(one, Held):
                stack.extend(reversed(one.derived))
            elif one.number:
                yield one


class TriesAgain(Protocol):
    """A node that tries again what something kept from firing."""

    @property
    def rule(self) -> Fired:
        """The rule it belongs to."""

    def retry(self, what: Any, after: Frame, /) -> Frame:
        """Return the frame that fires what is tried, if it still does, and goes on with ``after``."""


class Suppressed:
    """A match, or two that were to be joined, which a negated match has kept from firing.

    Several occurrences may make up the negated match: taking back any of them sets it free, once.
    """

    __slots__ = ("node", "what", "number", "freed")

    def __init__(self, node: TriesAgain, what: Tried, number: int):
        self.node = node
        self.what = what
        self.number = number
        self.freed = False

    def free(self) -> bool:
        """Tell whether it can be tried again now: not yet set free, and none of its own events taken back."""
        if self.freed:
            return False
        self.freed = True
        matches = (self.what,) if isinstance(self.what, Match) else self.what
        return not any(taken_back(match) for match in matches)


def occurrences_in(match: Match) -> List[Occurrence]:
    """Return the events of a match, as far as they were tracked."""
    return [token for token in leaves(match) if isinstance(token, Occurrence)]


def known_in(match: Match) -> List[Tracked]:
    """Return the events of a match, as far as they were tracked; in place of repetitions the last `Held`, linked."""
    found: List[Tracked] = []
    for one in sources(match):
        if isinstance(one, Held):
            _link(one)
            found.append(one)
        elif isinstance(one, Occurrence):
            found.append(one)
    return found


def _link(last: Held) -> None:
    """Have what repetitions came from know them, and each of them the next one."""
    new = []
    one: Any = last
    while one.match is not None and not one.linked:
        one.linked = True
        new.append(one)
        one = one.earlier
    for one in reversed(new):
        known = known_in(one.match)
        if one.earlier.match is not None:
            known.append(one.earlier)
        for source in known:
            one.gone = one.gone or source.gone
            if not source.forgotten:
                source.derived.append(one)
