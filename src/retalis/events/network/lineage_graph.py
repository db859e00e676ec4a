"""Lineage graph: occurrences of events, repetitions, and the links between them.

An `Occurrence` is an event that was dispatched, with links in both directions: to the match that it was derived from,
and to the occurrences derived from it. These links are the lineage graph (why-provenance). Negation adds links of
a third kind: a `Suppressed` match would have fired if a negated event had not occurred; if that event is retracted,
the match is tried again.

Repetitions of a pattern share their events as linked lists of `RepetitionChain`. These are nodes of the lineage
graph as well, so an occurrence has one link for all results of a run, not one per result.
"""

from typing import TYPE_CHECKING, Any, Iterator, List, Optional, Sequence, Tuple, Union

from ...prolog.terms.types import Term
from ...serialization.state_fields import ObjectFields, constraint, field
from ...serialization.stored_field_types import (
    BOOLEAN,
    COUNT,
    INSTANT,
    TERM,
    optional,
    reference,
    sequence_of,
    tuple_of,
)
from ..matches.match_types import (
    LINEAGE_FIELDS,
    MATCH_REFERENCE,
    Dependent,
    PartialMatch,
    RepetitionChain,
    event_tokens,
    is_retracted,
    lineage_sources,
)
from ..streams.stream_operators import MATCH_KINDS

if TYPE_CHECKING:
    from .event_rule import EventRule
    from .join_node import JoinNode
    from .kleene_node import KleeneNode
    from .pattern_nodes import EarlyTestNode, NotNode

    # Nodes that try a match again when the negated match that suppressed it was retracted.
    SuppressingNode = Union[EarlyTestNode, JoinNode, KleeneNode, NotNode]


class Occurrence:
    """Event that was dispatched.

    Attributes:
        term, start, end: the event.
        rule: the rule that raised it, or None.
        match: match of the rule, or of the goal that created it; None for an input event, and if it is forgotten.
        derived: occurrences and repetitions derived from it, as long as it is remembered.
        forgotten: whether it is too old to be remembered; partial matches may still use it, but it has no links.
        dependents: partial matches that use it, and repetitions in runs and stream operators; see `Dependent`.
        retracted: whether it was retracted.
        reported: whether the retraction was reported, by the ``rev`` event that named it or by a derived one.
        retracts: for a derived event ``rev(E)``, the occurrences that it retracts.
        suppressed: matches that it has prevented, with the nodes that try them again.
        number: order of dispatch; 0 if it has not occurred: a pending alarm, or a rejected event.
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
        "dependents",
        "retracted",
        "reported",
        "retracts",
        "suppressed",
    )

    STATE = ObjectFields(
        "event",
        field("number", COUNT),
        field("term", TERM),
        field("start", INSTANT),
        field("end", INSTANT, same_as="start"),
        field("rule", reference("rule", is_optional=True)),
        field("match", reference(*MATCH_KINDS, is_optional=True, is_source=True)),
        field("forgotten", BOOLEAN),
        field("retracts", optional(sequence_of(reference("event")))),
        *LINEAGE_FIELDS,
    )

    def __init__(
        self, term: Term, start: int, end: int, rule: Optional["EventRule"], match: Optional[PartialMatch]
    ):
        self.term = term
        self.start = start
        self.end = end
        self.rule = rule
        self.match = match
        self.derived: List[LineageNode] = []
        self.forgotten = False
        self.dependents: List[Dependent] = []
        self.retracted = False
        self.reported = False
        self.retracts: Optional[List[Occurrence]] = None
        self.suppressed: List[Suppressed] = []
        self.number = 0

    def derive_from(self, sources: "Sequence[LineageNode]") -> None:
        """Register the occurrence with those that it is derived from."""
        for source in sources:
            if not source.forgotten:
                source.derived.append(self)

    def sources(self) -> List["Occurrence"]:
        """Return the occurrences that it is derived from, each one once."""
        # A result of ``with`` or ``absent`` refers to its event twice: as element of the operator and as match.
        return [] if self.match is None else list(dict.fromkeys(occurrences_in(self.match)))

    def omitted_source_count(self) -> int:
        """Return the number of older matches in windows from which it is derived, and which `sources` omits."""
        chains = () if self.match is None else lineage_sources(self.match)
        return sum(chain.omitted_count for chain in chains if isinstance(chain, RepetitionChain))


LineageNode = Union[Occurrence, RepetitionChain]
"""Node of the lineage graph."""

MatchOrPair = Union[PartialMatch, Tuple[PartialMatch, PartialMatch]]
"""Match, or two matches that are to be joined."""


def take_unreported_derived(source: LineageNode) -> Iterator[Occurrence]:
    """Yield the occurrences derived from a source whose retraction was not reported yet, and mark them as reported.

    Occurrences that were not dispatched are skipped, because no rule has received them.
    """
    # Marked nodes are not visited again, so the traversal is linear and each occurrence is reported once.
    stack = source.derived[::-1]
    while stack:
        derived = stack.pop()
        if not derived.reported:
            derived.reported = True
            if isinstance(derived, RepetitionChain):
                stack.extend(reversed(derived.derived))
            elif derived.number:
                yield derived


class Suppressed:
    """Match, or two matches to be joined, that a negated match has prevented from firing.

    A negated match may consist of several occurrences; the first retraction of an occurrence releases the suppressed
    match.
    """

    __slots__ = ("node", "match_or_pair", "number", "is_released")

    STATE = ObjectFields(
        "suppressed",
        field("node", reference("node")),
        field("match_or_pair", reference(*MATCH_KINDS, accepts=tuple_of(MATCH_REFERENCE, MATCH_REFERENCE))),
        field("number", COUNT),
        field("is_released", BOOLEAN),
        constraint(
            "a suppressed match that its node can try again",
            lambda suppressed: suppressed.node.can_retry(suppressed.match_or_pair),
        ),
    )

    def __init__(self, node: "SuppressingNode", match_or_pair: MatchOrPair, number: int):
        self.node = node
        self.match_or_pair = match_or_pair
        self.number = number
        self.is_released = False

    def release(self) -> bool:
        """Return whether it can be tried now: it was not released before, and its own events are not retracted."""
        if self.is_released:
            return False
        self.is_released = True
        matches = (
            (self.match_or_pair,) if isinstance(self.match_or_pair, PartialMatch) else self.match_or_pair
        )
        return not any(is_retracted(match) for match in matches)


def occurrences_in(match: PartialMatch) -> List[Occurrence]:
    """Return the tracked events of a match."""
    return [token for token in event_tokens(match) if isinstance(token, Occurrence)]


def lineage_nodes_of(match: PartialMatch) -> List[LineageNode]:
    """Return the nodes from which an event or result of a match is derived.

    These are its tracked events, and for repetitions the last `RepetitionChain`, whose links are completed first.
    """
    tracked: List[LineageNode] = []
    for source in lineage_sources(match):
        if isinstance(source, RepetitionChain):
            _link_repetitions(source)
            tracked.append(source)
        elif isinstance(source, Occurrence):
            tracked.append(source)
    return tracked


def _link_repetitions(last: RepetitionChain) -> None:
    """Register repetitions with the events they are made of, and each repetition with its predecessor."""
    new_repetitions = []
    # A run is linked when its first result fires. Links of earlier repetitions exist already, so the walk stops at
    # the first linked one.
    repetition: Any = last
    while repetition.match is not None and not repetition.linked:
        repetition.linked = True
        new_repetitions.append(repetition)
        repetition = repetition.earlier
    for repetition in reversed(new_repetitions):
        origins = lineage_nodes_of(repetition.match)
        if repetition.earlier.match is not None:
            origins.append(repetition.earlier)
        for source in origins:
            # Repetitions are visited from the oldest to the newest, so that the mark of a retracted one reaches all
            # that follow it.
            repetition.retracted = repetition.retracted or source.retracted
            if not source.forgotten:
                source.derived.append(repetition)
