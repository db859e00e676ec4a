"""Partial matches and their identity.

A partial match is a token of the Rete network: the values of a node's variables, an interval, and the parts that it
was joined from. A match of a single event stores only the event (`EventMatch`), because millions of those may be
stored at a time. A match stores its own links to the neighbours in its `MatchBuffer`.

Two matches are identical if they consist of identical event terms in the same places, whatever the time stamps. The
policy ``recent`` uses this identity: a new occurrence replaces the older one. `identity` computes it for the whole
tree of parts without recursion and shares the keys of common prefixes, so a long sequence costs no more than a short
one.

If events are tracked for retraction and explanation, matches also lead to the occurrences that they contain:
`event_tokens` and `lineage_sources` enumerate these, and `arrival_number_of` orders matches by the last of them.
"""

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
from ...prolog.terms.types import Functor, Term, Trail, Values, Var
from ...prolog.terms.unification import undo, unify
from ...serialization.state_fields import ObjectFields, constraint, field
from ...serialization.stored_field_types import (
    BOOLEAN,
    COMPOUND_TERM,
    COUNT,
    INSTANT,
    KEY,
    MATCH_VALUE,
    TERM,
    FieldType,
    PlainType,
    ReadContext,
    ValueCheck,
    objects_and_values,
    objects_of,
    optional,
    reference,
    sequence_of,
    tuple_of,
)
from ..streams.stream_operators import MATCH_KINDS

if TYPE_CHECKING:
    from ...serialization.object_graph import ObjectWriter


REPETITION_KINDS = ("repetition chain", "no repetitions")
"""Kinds of `RepetitionChain`; `NO_REPETITIONS` is an external object."""

MATCH_VALUES = sequence_of(MATCH_VALUE, tuple)
"""Values of the variables of a match."""

TOKEN = reference("event", is_source=True, accepts=optional(COUNT))
"""Identity of an event: a number, or the event itself if lineage is recorded."""

MATCH_REFERENCE = reference(*MATCH_KINDS)
OPTIONAL_EVENT = reference("event", is_optional=True)


def _check_part(value: object) -> "Union[int, ComputedValues]":
    if isinstance(value, list):
        (values,) = _STORED_VALUES.check(value)
        return ComputedValues(values)
    return COUNT.check(value)


_STORED_VALUES = tuple_of(MATCH_VALUES)
_PART = PlainType("a number of a branch, or computed values", _check_part)

_DEPENDENT = reference(
    *MATCH_KINDS,
    accepts=tuple_of(
        reference("node"), reference("run", "node", "run group"), reference(*MATCH_KINDS, accepts=COUNT)
    ),
)
"""See `Dependent`. A buffer entry is named by a number in repeat nodes, and by the match itself elsewhere."""


def _are_buffer_entries(source: Any) -> bool:
    return all(
        node.has_entry(owner, entry)
        for dependent in source.dependents
        if dependent.__class__ is tuple
        for node, owner, entry in (dependent,)
    )


LINEAGE_FIELDS = (
    field("derived", sequence_of(reference("event", "repetition chain"))),
    field("dependents", sequence_of(_DEPENDENT)),
    field("retracted", BOOLEAN),
    field("reported", BOOLEAN),
    field("suppressed", sequence_of(reference("suppressed"))),
    constraint("dependents that are matches, or buffer entries of nodes", _are_buffer_entries),
)
"""Stored links of the nodes of a lineage."""


def _token_key_checker(context: ReadContext) -> ValueCheck[Hashable]:
    check_token = TOKEN.checker(context)
    is_reference = objects_of(context).is_reference

    def check_key(value: object) -> Hashable:
        if isinstance(value, list) and any(map(is_reference, value)):
            return tuple([check_key(item) for item in value])
        return check_token(value) if is_reference(value) else KEY.check(value)

    return check_key


def _encode_token_key(key: Any, graph: "ObjectWriter") -> object:
    if graph.is_object(key):
        return graph.reference_to(key)
    is_sequence = key.__class__ is tuple and not (key and key[0].__class__ is Functor)
    return [_encode_token_key(item, graph) for item in key] if is_sequence else key


TOKEN_KEY = FieldType("a key of terms or identities of events", _token_key_checker, _encode_token_key)


class MatchContainer(Protocol):
    """Container of stored matches: a `MatchBuffer` or a run group."""

    @property
    def retention(self) -> Optional[int]:
        """Retention time of its matches in ns; None for no bound."""

    @property
    def is_negated(self) -> bool:
        """True if its matches belong to a negated pattern; those are not skipped after a match."""

    def remove(self, match: "PartialMatch", /) -> None:
        """Remove a match."""


class EventMatch:
    """A match of one event without duration whose arguments are the values of its pattern.

    It has the attributes of a `PartialMatch` and is annotated as one, but takes 80 bytes instead of 136: millions may
    be stored. Its timestamp is its start, its end and its order, all three in one slot. Therefore the timestamp must
    be larger than the orders of all matches that the rule has stored before; see `OrderedEventMatch`. The
    attributes ``values``, ``event``, ``parts``, ``identity`` and ``consumed_by`` cannot be set.

    Attributes:
        start: start of the interval.
        end: end of the interval.
        event: None.
        parts: None.
        buffer: the place where the match is stored; None if it is not stored (any more).
        key: its key in that buffer.
        older: the match of the same key that was stored before it; for the oldest match, the newest one.
        newer: the match of the same key that was stored after it; for the newest match, the oldest one.
        order: increases with each match that the rule stores.
        identity: the identity by which a newer match replaces it; None if it has not been computed.
        consumed_by: the match that consumed it last; else None.
    """

    __slots__ = ("start", "term", "buffer", "key", "older", "newer")

    STATE = ObjectFields(
        "event match",
        field("start", INSTANT),
        field("end", INSTANT, same_as="start"),
        field("term", COMPOUND_TERM),
        # The order of a restored match is set when it is stored, which a slot for three values does not allow.
        restored_kind="match",
    )

    start: int
    # Declared as Any: code that reads it knows that the match is of a single event.
    term: Any
    buffer: "Optional[MatchContainer]"
    key: Hashable
    older: "PartialMatch"
    newer: "PartialMatch"

    if TYPE_CHECKING:
        end: int
        order: int
        values: Values
        event: Hashable
        parts: "Optional[Parts]"
        identity: Hashable
        consumed_by: "Optional[PartialMatch]"
    else:
        event = parts = consumed_by = None

        @property
        def values(self) -> Values:
            """The arguments of the event."""
            return self.term[1:]

        @property
        def identity(self) -> Hashable:
            """The identity; computed at each access."""
            return term_key(self.term)

    @property
    def latest_end(self) -> int:
        """Largest end so far; garbage control selects expired matches by this value."""
        return self.end

    @property
    def values_with_key(self) -> Values:
        """Values from which the key in a buffer is computed."""
        return self.values

    def after_restore(self) -> None:
        """Set the attributes that follow from the event, or are not used."""
        # A restored match has the attributes of a `PartialMatch`, see `STATE`.
        match: Any = self
        match.values = self.term[1:]
        match.event = match.parts = match.consumed_by = match.buffer = match.identity = None

    def discard(self) -> None:
        """Remove the match from the buffer where it is stored, if any."""
        if self.buffer is not None:
            self.buffer.remove(self)  # type: ignore[arg-type]  # annotated as `PartialMatch`, whose attributes it has


if not TYPE_CHECKING:
    # Further names of one slot: the three values are the same object.
    EventMatch.end = EventMatch.order = EventMatch.start


class OrderedEventMatch(EventMatch):
    """An `EventMatch` of an event with a duration, or of one that is not later than all matches before it."""

    __slots__ = ("end", "order")

    end: int
    order: int


class IdentifiedEventMatch(OrderedEventMatch):
    """An `OrderedEventMatch` that stores its identity, because it is compared with other matches of its key."""

    __slots__ = ("identity",)

    identity: Hashable


class PartialMatch(OrderedEventMatch):
    """A match of a node of a pattern.

    Attributes:
        values: values of the node's variables.
        event: token of the event, if the match consists of a single event; else None.
        term: the event, if this is the match of an event pattern; else None.
        parts: the parts that it was joined from: matches, `RepetitionChain` and `ComputedValues`, and the number of a
            branch.

    The other attributes are those of `EventMatch`.
    """

    __slots__ = ("values", "event", "parts", "identity", "consumed_by")

    STATE = ObjectFields(
        "match",
        field("values", MATCH_VALUES),
        field("start", INSTANT),
        field("end", INSTANT, same_as="start"),
        field("event", TOKEN),
        field("term", optional(TERM)),
        field("parts", objects_and_values(*MATCH_KINDS, *REPETITION_KINDS, "buffer slice", accepts=_PART)),
        field("consumed_by", reference(*MATCH_KINDS, is_optional=True)),
        constraint("an event or parts", lambda match: match.term is not None or match.parts is not None),
    )

    def after_restore(self) -> None:
        """Set the attributes that are not stored."""
        self.buffer = self.identity = None

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
        self.identity = self.consumed_by = None


class RepetitionChain:
    """Linked list of the repetitions of a run, shared by all results of the run.

    Each repetition has one `RepetitionChain`, which refers to the one of the repetition before it. It is not compared
    when two results are tested for identity.

    Attributes:
        match: the last repetition; None if there is none.
        earlier: the `RepetitionChain` of the repetitions before it.
        number: number of the last event in it, see `arrival_number_of`.
        omitted_count: number of older matches in a window that ``match`` omits.
        linked: whether the occurrences that it contains refer to it, if events are tracked.
        derived, dependents, suppressed, retracted, reported, forgotten: see `Occurrence`.
    """

    __slots__ = (
        "match",
        "earlier",
        "number",
        "omitted_count",
        "linked",
        "derived",
        "dependents",
        "suppressed",
        "retracted",
        "reported",
    )

    forgotten = False

    STATE = ObjectFields(
        "repetition chain",
        field("match", reference(*MATCH_KINDS, is_optional=True, is_source=True)),
        field("earlier", reference(*REPETITION_KINDS, is_optional=True, is_source=True)),
        field("number", COUNT),
        field("omitted_count", COUNT),
        field("linked", BOOLEAN),
        *LINEAGE_FIELDS,
        constraint(
            "a beginning, and a match after it",
            lambda chain: (chain.earlier is None) == (chain.match is None),
        ),
    )

    def __init__(
        self, match: Optional[PartialMatch], earlier: Optional["RepetitionChain"], omitted_count: int = 0
    ):
        self.match = match
        self.earlier = earlier
        self.omitted_count = omitted_count
        self.number: int = (
            0 if match is None or earlier is None else max(earlier.number, arrival_number_of(match))
        )
        self.linked = self.retracted = self.reported = False
        self.derived: List[Any] = []
        self.dependents: List[Dependent] = []
        self.suppressed: List[Any] = []

    @property
    def matches(self) -> List[PartialMatch]:
        """All repetitions, oldest first."""
        repetitions = []
        chain: Optional[RepetitionChain] = self
        while chain is not None and chain.match is not None:
            repetitions.append(chain.match)
            chain = chain.earlier
        repetitions.reverse()
        return repetitions


NO_REPETITIONS = RepetitionChain(None, None)


class IdentifyingRepetitions:
    """Matches that follow each other and are parts of one match; they belong to its identity."""

    __slots__ = ()

    @property
    def matches(self) -> List[PartialMatch]:
        """The matches, oldest first."""
        raise NotImplementedError


class ComputedValues(NamedTuple):
    """Values that goals, repetitions and aggregates have computed for a match and that are not passed on.

    They belong to the identity of the match, like the values that are passed on; see `MatchKeys`.
    """

    values: Values


class IdentityWithValues(NamedTuple):
    """Identity of a stored match, if its events do not determine all values that it passes on.

    Attributes:
        structure: its `identity`.
        value_keys: keys of the values that the events do not determine; they may be variables that a later join
            binds.
    """

    structure: Hashable
    value_keys: Tuple[Hashable, ...]


MatchPart = Union[PartialMatch, RepetitionChain, IdentifyingRepetitions, ComputedValues, int]
Parts = Tuple[MatchPart, ...]
Dependent = Union[PartialMatch, Tuple[Any, ...]]
"""A dependent of an event: a stored match that contains it, or a node and the data that it must remove."""


class Identity:
    """Identity of a match with several parts: the identities of these, compared without recursion.

    The identity of a long sequence shares those of its prefixes, so it costs no more to create than that of a short
    one.
    """

    __slots__ = ("parts", "hash")

    def __init__(self, parts: Tuple[Hashable, ...]):
        self.parts = parts
        self.hash = hash(parts)

    def __hash__(self) -> int:
        return self.hash

    def __eq__(self, other: object) -> bool:
        # A sequence of 10,000 events is a tree of that depth, so recursion would exceed Python's limit.
        pairs: List[Tuple[Any, Any]] = [(self, other)]
        while pairs:
            left, right = pairs.pop()
            if left is right:
                continue
            if left.__class__ is Identity and right.__class__ is Identity:
                if left.hash != right.hash or len(left.parts) != len(right.parts):
                    return False
                pairs += zip(left.parts, right.parts)
            elif left.__class__ is Identity or right.__class__ is Identity or left != right:
                return False
        return True


def identity(match: EventMatch) -> Hashable:
    """Return a key that is equal for two matches of a node that consist of identical event terms.

    Values that are passed on are not part of the key.
    """
    if match.parts is None:
        return term_key(match.term)
    # The first parts of a sequence form a long path. Descend to the first part whose identity is known, then build
    # the identities of the longer prefixes on top of it.
    path: List[EventMatch] = [match]
    while path[-1].__class__ is not PartialMatch or path[-1].identity is None:
        parts = path[-1].parts
        if not parts or not isinstance(parts[0], EventMatch):
            break
        path.append(parts[0])
    innermost = path[-1]
    is_known = innermost.__class__ is PartialMatch and innermost.identity is not None
    key: Hashable = innermost.identity if is_known else _identity_of(innermost, ())
    # Values that are passed on are not part of this key.
    if is_known and key.__class__ is IdentityWithValues:
        key_with_values: Any = key
        key = key_with_values.structure
    for longer in reversed(path[:-1]):
        key = _identity_of(longer, (key,))
    return key


def _identity_of(match: EventMatch, keys: Tuple[Hashable, ...]) -> Hashable:
    """Return the identity of a match, given the identities of its first parts."""
    parts = match.parts
    if parts is None:
        return term_key(match.term)
    part: Any
    for part in parts[len(keys) :]:
        if isinstance(part, EventMatch):
            keys += (identity(part),)
        elif part.__class__ is ComputedValues:
            keys += (tuple([term_key(value) for value in part.values]),)
        elif part.__class__ is not RepetitionChain:
            keys += (part,)
    return keys[0] if len(keys) == 1 else Identity(keys)


def event_matches(match: EventMatch) -> Iterator[EventMatch]:
    """Yield the matches of single events that a match consists of, in the order of the pattern."""
    part: Any
    stack: List[EventMatch] = [match]
    while stack:
        inner_match = stack.pop()
        if inner_match.parts is None:
            yield inner_match
        else:
            for part in reversed(inner_match.parts):
                if isinstance(part, EventMatch):
                    stack.append(part)
                elif part.__class__ is RepetitionChain or isinstance(part, IdentifyingRepetitions):
                    stack.extend(reversed(part.matches))


def event_tokens(match: PartialMatch) -> Iterator[Hashable]:
    """Yield the tokens of the events that a match consists of, in the order of the pattern."""
    return (event_match.event for event_match in event_matches(match))


def lineage_sources(match: PartialMatch) -> Iterator[Hashable]:
    """Yield the tokens of the events of a match; for the repetitions of a run, their `RepetitionChain` instead."""
    part: Any
    stack: List[EventMatch] = [match]
    while stack:
        inner_match = stack.pop()
        if inner_match.parts is None:
            yield inner_match.event
            continue
        for part in reversed(inner_match.parts):
            if isinstance(part, EventMatch):
                stack.append(part)
            elif part.__class__ is RepetitionChain:
                if part.match is not None:
                    yield part
            elif isinstance(part, IdentifyingRepetitions):
                stack.extend(reversed(part.matches))


def arrival_number_of(match: PartialMatch) -> int:
    """Return the number of the last event of a match, at which it was complete; 0 if events are not tracked."""
    return max((getattr(token, "number", 0) for token in lineage_sources(match)), default=0)


def is_retracted(match: PartialMatch) -> bool:
    """Return whether an event of a match was retracted."""
    return any(getattr(token, "retracted", False) for token in event_tokens(match))


def unify_sides(
    left: PartialMatch, right: PartialMatch, shared: Tuple[Tuple[int, int], ...]
) -> Optional[Tuple[PartialMatch, PartialMatch]]:
    """Unify the shared values of two matches, which may contain variables.

    Args:
        left: a match.
        right: a match.
        shared: pairs of positions of a shared variable, in the values of the left and of the right match.

    Returns:
        Copies of the two matches with the resulting values, or None if the values do not unify.
    """
    left_values = list(_rename_variables(left.values))
    right_values = list(_rename_variables(right.values))
    trail: Trail = []
    result = None
    if all(
        unify(left_values[left_position], right_values[right_position], trail)
        for left_position, right_position in shared
    ):
        result = (_with_values(left, left_values), _with_values(right, right_values))
    # Only variables of the copies were bound, so no binding has to be undone.
    return result


def unify_values(left: Values, right: Values) -> Optional[Values]:
    """Unify values pairwise and return them; None if they do not unify."""
    trail: Trail = []
    try:
        if all(unify(left_value, right_value, trail) for left_value, right_value in zip(left, right)):
            return tuple([resolve(left_value) for left_value in left])
        return None
    finally:
        undo(trail, 0)


def _rename_variables(values: Values) -> Values:
    new_vars: Dict[Var, Term] = {}
    return tuple([copy(value, new_vars) for value in values])


def _with_values(match: PartialMatch, values: List[Term]) -> PartialMatch:
    return PartialMatch(
        tuple([resolve(value) for value in values]),
        match.start,
        match.end,
        match.event,
        match.term,
        match.parts,
    )
