"""Run groups: shared storage for the partial runs of a repetition, and runs of a Kleene closure.

For a pattern that must happen n times in sequence, up to n - 1 partial sequences are open at a time: one that has
one repetition, one that has two, and so on. Storing the repetitions of each would take quadratic space, and
extending each with the next repetition quadratic time. The solution follows the shared versioned match buffer of
SASE+, which Flink calls SharedBuffer:

* `SharedLog` stores every repetition once, in order.
* `RunGroup` contains all open sequences with the same values that end with the same repetition. The next repetition
  extends all of them at once, by appending to the log and adding one `RunCursor`.
* `RunCursor` is one of those sequences: the position in the log where it began.
* `BufferSlice` is the part list of a complete sequence: slices of logs instead of copies.

A `Run` is one execution of a Kleene closure or aggregate (`KleeneNode`): a first match and the repetitions that have
extended it.
"""

from collections import deque
from typing import (
    TYPE_CHECKING,
    Any,
    Callable,
    Deque,
    Hashable,
    Iterator,
    List,
    Optional,
    Tuple,
)

from ...prolog.terms.types import NIL, Term, Values, Var
from ...serialization.state_fields import ObjectFields, constraint, field
from ...serialization.stored_field_types import (
    COUNT,
    INSTANT,
    KEY,
    MATCH_ORDER,
    TERM,
    VARIABLE,
    optional,
    reference,
    sequence_of,
    tuple_of,
)
from ..matches.match_types import (
    MATCH_REFERENCE,
    MATCH_VALUES,
    NO_REPETITIONS,
    REPETITION_KINDS,
    IdentifyingRepetitions,
    PartialMatch,
    Parts,
    identity,
)
from ..streams.stream_operators import MATCH_KINDS

if TYPE_CHECKING:
    from .kleene_node import KleeneNode
    from .repeat_node import RepeatNode


_HASH_MASK = (1 << 61) - 1


class SharedLog:
    """Repetitions in order; it only grows, so slices of it remain valid."""

    __slots__ = ("items", "_sums")

    STATE = ObjectFields(
        "log",
        field("items", sequence_of(reference(*MATCH_KINDS, is_source=True))),
    )

    def __init__(self, items: List[PartialMatch]):
        self.items = items
        self._sums = [0]

    def after_restore(self) -> None:
        """Drop the cached sums, after repetitions were restored."""
        self._sums = [0]

    def sum_to(self, end: int) -> int:
        """Return a hash of the first ``end`` repetitions; each prefix is computed once."""
        sums = self._sums
        # Prefix sums make the hash of any slice a subtraction, so hashing does not depend on the length of a
        # sequence.
        while len(sums) <= end:
            sums.append((sums[-1] + hash(identity(self.items[len(sums) - 1]))) & _HASH_MASK)
        return sums[end]


LogSlice = Tuple[SharedLog, int, int]
"""A log, and the positions of a slice of it."""


class BufferSlice(IdentifyingRepetitions):
    """The repetitions of a match, oldest first, as slices of shared logs.

    Two are equal if they consist of identical event terms. Creating and hashing one does not depend on its length.
    """

    __slots__ = ("pieces", "length")

    STATE = ObjectFields(
        "buffer slice",
        field("pieces", sequence_of(tuple_of(reference("log", is_source=True), COUNT, COUNT), tuple)),
        constraint(
            "slices within their logs",
            lambda buffer_slice: all(
                start <= end <= len(log.items) for log, start, end in buffer_slice.pieces
            ),
        ),
    )

    def __init__(self, pieces: Tuple[LogSlice, ...]):
        self.pieces = pieces
        self.after_restore()

    def after_restore(self) -> None:
        """Compute the number of repetitions."""
        self.length = sum(end - start for _, start, end in self.pieces)

    @property
    def matches(self) -> List[PartialMatch]:
        """The repetitions."""
        return [match for log, start, end in self.pieces for match in log.items[start:end]]

    def __hash__(self) -> int:
        total = sum(log.sum_to(end) - log.sum_to(start) for log, start, end in self.pieces)
        return hash((self.length, total & _HASH_MASK))

    def __eq__(self, other: Any) -> bool:
        if self is other:
            return True
        if other.__class__ is not BufferSlice or self.length != other.length or hash(self) != hash(other):
            return False
        pairs = zip(self.matches, other.matches)
        # Equal hashes do not prove equality: the hash is a sum, which does not depend on the order.
        return all(left is right or identity(left) == identity(right) for left, right in pairs)


def repetitions(match: PartialMatch, times: int) -> List[PartialMatch]:
    """Return the repetitions of a match of ``times`` repetitions, oldest first."""
    later_repetitions: List[PartialMatch] = []
    while times > 1:
        parts: Any = match.parts
        if parts[0].__class__ is BufferSlice:
            return [*parts[0].matches, *reversed(later_repetitions)]
        match, last = parts
        later_repetitions.append(last)
        times -= 1
    return [match, *reversed(later_repetitions)]


def set_join_parts(match: PartialMatch, times: int) -> None:
    """Set the parts of a match of ``times`` repetitions as a chain of `JoinNode` nodes would."""
    first, *middle, last = repetitions(match, times)
    for repetition in middle:
        first = PartialMatch((), first.start, repetition.end, None, None, (first, repetition))
    _set_parts(match, (first, last))


def set_slice_parts(match: PartialMatch, times: int) -> None:
    """Set the parts of a match of ``times`` repetitions as a run group would."""
    _set_parts(match, (BufferSlice(slices_of(match, times)),))


def _set_parts(match: PartialMatch, parts: Parts) -> None:
    match.parts = parts
    match.identity = None


def slices_of(match: PartialMatch, times: int) -> Tuple[LogSlice, ...]:
    """Return the slices that a match of ``times`` repetitions consists of."""
    parts: Any = match.parts
    if times > 1 and parts[0].__class__ is BufferSlice:
        return parts[0].pieces
    return ((SharedLog(repetitions(match, times)), 0, times),)


_BEFORE_ALL_INSTANTS = -(1 << 80)


class RunCursor(PartialMatch):
    """A partial sequence in a run group.

    Attributes:
        first: its beginning: the first repetition, or a match of several repetitions that was stored separately.
        prefix_length: number of repetitions of such a match; 0 if the first repetition is in the log.
        log: log in which its repetitions in the group begin.
        log_position: position of the first of these in the log.
        first_number: number of that repetition in the group, counted from 0.
    """

    __slots__ = ("first", "prefix_length", "log", "log_position", "first_number")

    STATE = ObjectFields(
        "run cursor",
        *PartialMatch.STATE.extended(
            field("first", reference(*MATCH_KINDS, is_source=True)),
            field("prefix_length", COUNT),
            field("log", reference("log")),
            field("log_position", COUNT),
            field("first_number", COUNT),
            field("buffer", reference("run group", is_optional=True)),
            constraint("a position in its log", lambda cursor: cursor.log_position <= len(cursor.log.items)),
        ),
    )

    buffer: "Optional[RunGroup]"

    def after_restore(self) -> None:
        """Set the attributes that are not stored."""
        self.identity = None

    def __init__(self, first: PartialMatch, prefix_length: int, group: "RunGroup"):
        super().__init__(first.values, first.start, first.end, None, None, (first,))
        self.first = first
        self.prefix_length = prefix_length
        self.log = group.log
        self.log_position = len(group.log.items)
        self.first_number = group.repetition_count

    @property
    def latest_end(self) -> int:
        """The end so far; see `PartialMatch.latest_end`."""
        return self.end if self.buffer is None else self.buffer.end


class RunGroup:
    """Partial sequences with the same values and different lengths, which all end with the same repetition.

    Attributes:
        node: the node that they belong to.
        cursors: the sequence with ``length`` repetitions is at index ``length - 1``; None and removed sequences are
            gaps.
        end: end of the last repetition.
        order: order of the shortest sequence, as if it were a match that was stored; each longer one has one less.
        log: the newest repetitions; sequences that began in the log before it refer to that one.
        repetition_count: number of repetitions so far.
        cursor_count: number of sequences that are stored.
    """

    __slots__ = (
        "node",
        "key",
        "cursors",
        "end",
        "order",
        "log",
        "repetition_count",
        "cursor_count",
    )

    STATE = ObjectFields(
        "run group",
        field("node", reference("node")),
        field("key", KEY),
        field("cursors", sequence_of(reference("run cursor", is_optional=True), deque)),
        field("end", INSTANT),
        field("order", MATCH_ORDER),
        field("log", reference("log")),
        field("repetition_count", COUNT),
        constraint("runs of its node", lambda group: group.node.accepts_group(group)),
    )

    def __init__(self, node: "RepeatNode", key: Hashable):
        self.node = node
        self.key = key
        self.cursors: Deque[Optional[RunCursor]] = deque()
        self.end = _BEFORE_ALL_INSTANTS
        self.order = 0
        self.log = SharedLog([])
        self.repetition_count = 0
        self.cursor_count = 0

    def after_restore(self) -> None:
        """Count the stored sequences."""
        self.cursor_count = sum(cursor is not None and cursor.buffer is self for cursor in self.cursors)

    @property
    def retention(self) -> Optional[int]:
        """Retention time of the sequences in ns; None for no bound."""
        return self.node.retention

    @property
    def is_negated(self) -> bool:
        """True if the sequences belong to a negated pattern."""
        return self.node.is_negated

    def has_stored_cursor(self) -> bool:
        """Return whether a sequence is stored in the group."""
        return any(cursor is not None and cursor.buffer is self for cursor in self.cursors)

    def cursor_with(self, length: int) -> Optional[RunCursor]:
        """Return the sequence with ``length`` repetitions, or None."""
        if length > len(self.cursors):
            return None
        cursor = self.cursors[length - 1]
        return None if cursor is None or cursor.buffer is None else cursor

    def cursors_by_length(self) -> Iterator[Tuple[int, RunCursor]]:
        """Yield all sequences with their numbers of repetitions, longest first."""
        for length in range(len(self.cursors), 0, -1):
            cursor = self.cursor_with(length)
            if cursor is not None:
                yield length, cursor

    def add(self, length: int, cursor: RunCursor) -> None:
        """Add a sequence with ``length`` repetitions."""
        cursors = self.cursors
        while len(cursors) < length:
            cursors.append(None)
        cursors[length - 1] = cursor
        self._store_cursor(cursor)

    def advance(self, match: PartialMatch, max_length: int) -> Optional[RunCursor]:
        """Extend all sequences with a repetition and begin a new one.

        Returns:
            The sequence that has ``max_length`` repetitions now and has left `cursors`; None if there is none.
        """
        cursors = self.cursors
        while cursors and (cursors[-1] is None or cursors[-1].buffer is None):
            cursors.pop()
        cursor = RunCursor(match, 0, self)
        # One append extends all sequences: each has one repetition more, because its place in `cursors` moves by
        # one.
        self.log.items.append(match)
        self.repetition_count += 1
        self.end = match.end
        completed = cursors.pop() if len(cursors) == max_length - 1 else None
        cursors.appendleft(cursor)
        rule = self.node.rule
        # Orders are reserved as if each sequence were stored anew, longest first. A sequence that leaves the group
        # later is then in the right place among matches that were stored separately.
        rule.order += max_length
        self.order = rule.order
        self._store_cursor(cursor)
        return completed

    def _store_cursor(self, cursor: RunCursor) -> None:
        cursor.buffer = self
        self.cursor_count += 1
        rule = self.node.rule
        cursor.order = rule.order = rule.order + 1

    def renew_log(self, size: int) -> None:
        """Begin a new log if the current one has ``size`` repetitions; no sequence is longer than that."""
        # A sequence spans at most two logs, so the old log is freed when its last sequence leaves.
        if len(self.log.items) >= size:
            self.log = SharedLog([])

    def remove(self, cursor: PartialMatch) -> None:
        """Remove a sequence."""
        cursor.end = self.end
        cursor.buffer = None
        self.cursor_count -= 1
        self.node.rule.stored_match_count -= 1
        if not self.cursor_count:
            self.node.groups.pop(self.key, None)

    def match_of(self, cursor: RunCursor, length: int) -> PartialMatch:
        """Return a sequence with ``length`` repetitions as a separate match."""
        if length == 1:
            return cursor.first
        return PartialMatch(
            self.node.values_of(cursor), cursor.start, self.end, None, None, (self._slices(cursor),)
        )

    def _slices(self, cursor: RunCursor) -> BufferSlice:
        prefix: Tuple[LogSlice, ...] = (
            slices_of(cursor.first, cursor.prefix_length) if cursor.prefix_length else ()
        )
        log, last = cursor.log, self.log
        if log is last:
            return BufferSlice((*prefix, (log, cursor.log_position, len(log.items))))
        return BufferSlice((*prefix, (log, cursor.log_position, len(log.items)), (last, 0, len(last.items))))


class RunGroupBuffer:
    """The sequences of all run groups of a node, in the role of a buffer.

    Attributes:
        is_negated: whether they belong to a negated pattern.
    """

    is_negated = False

    def __init__(self, node: "RepeatNode"):
        self._node = node

    @property
    def retention(self) -> Optional[int]:
        """Retention time of the sequences in ns; None for no bound."""
        return self._node.retention


NO_ITEMS = NIL
"""End of the list of items of a run; see `RepetitionItems`."""


class Run(PartialMatch):
    """One execution of a Kleene closure: a first match and the repetitions that have extended it.

    Attributes:
        node: the node that it belongs to.
        last: largest end so far.
        fixed_values: values, set by the first repetition, of variables that also occur elsewhere in the rule; or
            None.
        state: state of the accumulator of an aggregate.
        items: values that conditions further up test for each repetition.
        repetitions: the repetitions, if events are tracked.
        tracked: their `RepetitionChain`, for the results.
        step_values: for each repetition, the values of the start and those of the step tests after it.
        free_vars: variables of the aggregated term that no repetition binds; all repetitions share them.
    """

    __slots__ = (
        "last",
        "fixed_values",
        "state",
        "items",
        "repetitions",
        "tracked",
        "step_values",
        "first",
        "free_vars",
        "node",
    )

    STATE = ObjectFields(
        "run",
        *PartialMatch.STATE.extended(
            field("node", reference("node")),
            field("first", reference(*MATCH_KINDS, is_source=True)),
            field("last", INSTANT),
            field("fixed_values", optional(MATCH_VALUES)),
            field("state", lambda run: run.node.run_state_type()),
            field("items", TERM),
            field("repetitions", sequence_of(MATCH_REFERENCE)),
            field("tracked", reference(*REPETITION_KINDS, is_source=True)),
            field("step_values", sequence_of(tuple_of(MATCH_VALUES, MATCH_VALUES))),
            field("free_vars", sequence_of(VARIABLE, tuple)),
            constraint("the values that its node requires", lambda run: run.node.accepts_run(run)),
        ),
    )

    def __init__(self, node: "KleeneNode", first: PartialMatch):
        super().__init__(first.values, first.start, first.end, first.event, None, (first,))
        self.node = node
        self.first = first
        self.free_vars = tuple([Var() for _ in node.free_vars])
        self.fixed_values: Optional[Values] = None
        self.items: Term = NO_ITEMS
        self.restart(node.initial_state)

    @property
    def latest_end(self) -> int:
        """The largest end so far; see `PartialMatch.latest_end`."""
        return self.last

    @property
    def values_with_key(self) -> Values:
        """The values of the key; see `PartialMatch.values_with_key`."""
        return self.first.values

    def commit(
        self, last: int, fixed_values: Optional[Values], items: Term, values: Values, state: object
    ) -> None:
        """Extend the run by a repetition."""
        self.last, self.fixed_values, self.items, self.values, self.state = (
            last,
            fixed_values,
            items,
            values,
            state,
        )

    def restart(self, state: object) -> None:
        """Reset the run to no repetitions, with the initial state of an accumulator."""
        self.values = self.first.values
        self.last = self.first.end
        self.fixed_values = None
        self.state = state
        self.items = NO_ITEMS
        self.repetitions: List[PartialMatch] = []
        self.tracked = NO_REPETITIONS
        self.step_values: List[Tuple[Values, Values]] = []


def identity_by_start(identify: Callable[[PartialMatch], Hashable]) -> Callable[[Any], Hashable]:
    """Return an identity function of runs, given that of their starts."""
    return lambda run: identify(run.first)


def identity_by_start_interval(identify: Callable[[PartialMatch], Hashable]) -> Callable[[Any], Hashable]:
    """Return an identity function of runs by the start and its interval, given the identity function of starts."""

    def identify_run(run: Run) -> Hashable:
        first = run.first
        return (identify(first), int(first.start), int(first.end))

    return identify_run
