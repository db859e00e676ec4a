"""Event rules at run time: node tree, clock, stored matches, and the firing of the head.

An `EventRule` owns the nodes that the compiler builds from its pattern, and connects them for the current options
(`EventRule.configure`). It is the `MatchStore` of the partial matches in all of its buffers. A match leaves its
buffer when

* it is consumed or replaced (`consumption_policy`),
* its retention time ends, or it ended before the window of garbage control (`EventRule.advance_clock`),
* it is skipped after a match (`after_match_skip`),
* a sweep finds that it is ruled out (`RuledOutSweep`), or
* the rule has too many matches: then the oldest one is dropped and reported.

The rule's clock is the largest end of the events that it has matched. A timestamp too far in the future does not
advance it.

A complete match fires the head of the rule: it dispatches an event, or sets an alarm for one. If neither a window
nor tracking needs the match, its values go directly to generated code (`compile_firing_action`).
"""

from itertools import chain
from typing import (
    TYPE_CHECKING,
    Any,
    Callable,
    Dict,
    Hashable,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
)

from ...foundation.codegen import MAX_TERM_ARGUMENTS
from ...foundation.errors import RuleError, UsageError
from ...foundation.source_places import line_of
from ...prolog.terms.term_traversal import is_larger, variables
from ...prolog.terms.timestamps import BEFORE_ALL_INSTANTS
from ...prolog.terms.types import Atom, EventAction, Frame, Functor, Term, Values, Var, deref
from ...serialization.state_fields import (
    StateFields,
    StateOwner,
    constraint,
    field,
    part,
    part_list,
    record_of,
    rows_of,
)
from ...serialization.stored_field_types import (
    COUNT,
    INSTANT,
    MATCH_ORDER,
    State,
    integer,
    optional,
    references,
    sequence_of,
)
from ..dispatch.listeners import Listener, ListenerPhase
from ..dispatch.matcher_compiler import compile_builder
from ..fused.fused_single_event import Continuation, compile_firing_action
from ..language.pattern_tree import (
    ConditionPattern,
    OrPattern,
    Pattern,
    RepeatedPattern,
    RuleDefinition,
    WindowPattern,
    walk,
)
from ..language.rule_heads import resolve_alarm
from ..language.rule_labels import rule_name, rule_title
from ..matches.expiration import ExpirationQueue, smaller_bound
from ..matches.match_buffer import MatchBuffer
from ..matches.match_limit import MatchStore
from ..matches.match_policies import NetworkOptions, check_policy
from ..matches.match_types import MATCH_REFERENCE, TOKEN, PartialMatch
from ..streams.stream_operators import MATCH_KINDS
from ..streams.windows import OpenWindow, Window
from .after_match_skip import AfterMatchSkip, select_skip_state
from .goal_evaluation import ExtendValues
from .pattern_nodes import EventNode
from .rule_compiler import RuleCompiler
from .stream_node import StreamNode

if TYPE_CHECKING:
    from ...prolog.system.prolog_system import PrologSystem
    from ..matches.consumption_policy import Emit
    from .network_context import NetworkContext


class RuleMetrics(StateOwner):
    """Counters of a rule; a separate object, because they change with most events.

    Attributes:
        firing_count: number of complete matches, whether or not their event had listeners.
        last_end: end of the last one; None before the first.
        error_count: number of errors.
    """

    __slots__ = ("error_count", "last_end", "firing_count")

    STATE = StateFields(
        field("firing_count", COUNT),
        field("last_end", optional(INSTANT)),
        field("error_count", COUNT),
    )

    def __init__(self) -> None:
        self.firing_count = self.error_count = 0
        self.last_end: Optional[int] = None


class RuleUseCounts:
    """Outcomes of the conditions of a rule, and matches of the branches of its ``or`` patterns.

    They serve the coverage of a program by tests. Only rules of an engine with `Settings.counts_uses` have them. The
    compiler of the rule then wraps the tests of conditions and the actions of branches in functions that count, so
    that other rules have no cost. The nodes of a pattern are identified by their objects. A repetition that is
    written out as a sequence consists of copies of its pattern, whose counts are those of the pattern
    (`add_repetitions`).

    Attributes:
        outcomes: for each condition from left to right, how often it was false and true.
        branch_matches: for each ``or`` from left to right, the number of matches of each branch.
    """

    def __init__(self, pattern: Pattern):
        nodes = walk(pattern, negated=True)
        conditions = [node for node in nodes if isinstance(node, ConditionPattern)]
        alternatives = [node for node in nodes if isinstance(node, OrPattern)]
        self.outcomes = [(node, [0, 0]) for node in conditions]
        self.branch_matches = [(node, [0] * len(node.branches)) for node in alternatives]
        self._counts: Dict[int, List[int]] = {
            id(node): counts for node, counts in (*self.outcomes, *self.branch_matches)
        }
        # An id is unique only while its object exists.
        self._copies: List[Pattern] = []

    def add_repetitions(self, repeated: RepeatedPattern, sequence: Pattern) -> None:
        """Count the parts of a sequence as those of the repeated pattern that was written out."""
        originals = walk(repeated.pattern, negated=True)
        # The pairs of the sequence precede its repetitions.
        copies = walk(sequence, negated=True)[repeated.times - 1 :]
        for position, copy in enumerate(copies):
            counts = self._counts.get(id(originals[position % len(originals)]))
            if counts is not None:
                self._counts[id(copy)] = counts
        self._copies.append(sequence)

    def count_outcomes(self, condition: ConditionPattern, extend_values: ExtendValues) -> ExtendValues:
        """Return the test of a condition, extended by the counting of its outcomes."""
        counts = self._counts[id(condition)]

        def extend_and_count(values: Values) -> Optional[Values]:
            result = extend_values(values)
            counts[result is not None] += 1
            return result

        return extend_and_count

    def branch_counts(self, alternatives: OrPattern) -> List[int]:
        """Return the numbers of matches of the branches, which the node of the ``or`` increments."""
        return self._counts[id(alternatives)]


class Arrivals(NamedTuple):
    """Stored matches of a rule in order of arrival.

    Attributes:
        buffer_numbers: positions of their buffers among those of all nodes; -1 for a sequence in a run group.
    """

    matches: List[PartialMatch]
    buffer_numbers: List[int]
    orders: List[int]


class DeferredMatch(NamedTuple):
    """A match that is stored when the next event is dispatched."""

    buffer_number: int
    match: PartialMatch


MATCH_BYTES = 930
"""Memory of a partial match with two small arguments, in bytes; measured with tracemalloc on CPython 3.11."""


def _name_rule(definition: RuleDefinition, logic: "PrologSystem") -> str:
    def show(term: Term) -> str:
        # Variables of a rule that was added at run time have no names; numbered ones would differ in each message.
        names = {**dict.fromkeys(variables(term), "_"), **definition.names}
        return logic.brief(term, names, is_constructed=True)

    return rule_name(definition.label, definition.head, definition.term, show)


class EventRule(MatchStore):
    """One event rule of the program.

    Attributes:
        name: its name, see `rule_name`.
        serial: position among the rules; older ones receive events first.
        from_outside: whether it was added by a service or topic, not by the program.
        skip_state: state of its after-match skip strategy; None if it skips nothing.
        window: longest interval that its label allows, in ns; None for no bound.
        idle: time in ns after which the state of a key without new events is dropped; None for no bound.
        listeners: the listeners of its event nodes.
        metrics: its counters.
        maintains_clock: whether its clock advances, because matches expire by it.
        max_timestamp: largest time stamp that is known to be allowed to advance its clock.
        completion: receives the values of complete matches, if nothing is tracked.
    """

    STATE = StateFields(
        part("metrics"),
        field("dropped_count", COUNT),
        field("dropped_alarm_count", COUNT),
        field("past_alarm_count", COUNT),
        field("late_count", COUNT),
        field("ahead_count", COUNT),
        field("clock", INSTANT),
        field("last_order", MATCH_ORDER),
        field("_last_collection", optional(INSTANT)),
        part("skip_state"),
        # A rule with the same text can be compiled to other nodes by another version of the package.
        part_list("node_states", "nodes", "its nodes differ from those in the state"),
        field(
            "stored_arrivals",
            record_of(
                Arrivals,
                matches=references(*MATCH_KINDS),
                buffer_numbers=sequence_of(integer(-1)),
                orders=sequence_of(MATCH_ORDER),
            ),
        ),
        field(
            "stored_deferred_matches",
            rows_of(
                DeferredMatch,
                buffer_number=COUNT,
                match=MATCH_REFERENCE,
            ),
        ),
        field("_deferring_event", TOKEN),
        constraint(
            "a buffer and an order for each partial match",
            lambda rule, state: len(set(map(len, state["stored_arrivals"]))) == 1,
        ),
        # Orders reproduce the order in which partial matches arrived.
        constraint(
            "partial matches with distinct orders that have been assigned",
            lambda rule, state: (
                len(set(state["stored_arrivals"].orders)) == len(state["stored_arrivals"].orders)
                and max(state["stored_arrivals"].orders, default=0) <= state["last_order"]
            ),
        ),
        constraint(
            "partial matches with the values and the event that their node requires",
            lambda rule, state: rule.can_store(state),
        ),
    )

    def __init__(self, network: "NetworkContext", definition: RuleDefinition, serial: int):
        super().__init__(network.max_stored)
        self.network = network
        self.meter = network.logic.machine.budget.meter(self)
        self.definition = definition
        self.from_outside = network.logic.is_serving_client
        self.place = definition.place
        self.label = definition.label
        self.serial = serial
        self.name = _name_rule(definition, network.logic)
        counts_uses = network.logic.counted_clauses is not None
        self.use_counts = RuleUseCounts(definition.pattern) if counts_uses else None
        self.skip_state: Optional[AfterMatchSkip] = None
        self.window: Optional[int] = None
        self.idle: Optional[int] = None
        self.metrics = RuleMetrics()
        self.dropped_alarm_count = 0
        self.past_alarm_count = 0
        self.late_count = 0
        self.ahead_count = 0
        self.maintains_clock = False
        self.max_timestamp: int = BEFORE_ALL_INSTANTS
        self.completion: Optional[Continuation] = None
        self._main_retention: Optional[int] = None
        self._last_collection: Optional[int] = None
        self._garbage_control: Optional[Tuple[int, int]] = None
        self._end_queue = ExpirationQueue()
        self.listeners: List[Listener] = []
        self.deferred_matches: List[Tuple[MatchBuffer, PartialMatch, Hashable]] = []
        self._deferring_event: object = None
        self._unused = definition.unused
        head = definition.head
        compiler = RuleCompiler(self, [] if head is None else [head], definition.pattern)
        self.root = compiler.build()
        self._bounded_nodes = compiler.nodes
        self.nodes = [bounded.node for bounded in compiler.nodes]
        self.shares_events = any(getattr(node, "shares_events", False) for node in self.nodes)
        self._builder: Optional[Callable[[Values], Term]] = None

    @property
    def title(self) -> str:
        """Its name and line, see `rule_title`."""
        return rule_title(self.name, line_of(self.place))

    def configure(
        self, options: NetworkOptions, window: Optional[int], garbage: Optional[Tuple[int, int]]
    ) -> None:
        """Connect the nodes.

        Args:
            options: the options.
            window: longest interval that the label allows, in ns; None for no bound.
            garbage: window and step of garbage control, in ns; None if it is off.

        Raises:
            UsageError: for a policy that the network does not implement; nothing has changed then.
        """
        check_policy(options.policy)
        root: Any = self.root
        self.store_deferred()
        self.options = options
        self.skip_state = skip_state = select_skip_state(self, options)
        self.window = window
        self._garbage_control = garbage
        self.idle = None if garbage is None else garbage[0]
        # Operators on streams have clocks of their own.
        self.maintains_clock = garbage is not None and not root.is_single_event
        for node, span, retention_times in self._bounded_nodes:
            retention = retention_times.out_of_order if options.out_of_order else retention_times.in_order
            node.set_span(
                smaller_bound(span, window) if node.tests_label_window else span,
                smaller_bound(retention, window),
            )
            self.maintains_clock = self.maintains_clock or any(
                buffer.retention is not None for buffer in node.buffers()
            )
        retentions = [buffer.retention for buffer in self._buffers() if buffer.retention is not None]
        # The most frequent retention time has the queue that generated code uses.
        self._main_retention = max(retentions, key=retentions.count) if retentions else None
        self.tracks_stored = self.maintains_clock or options.tracks_events or skip_state is not None
        # Sweeps are for matches that never expire. One with a retention time may be needed until that has passed.
        sweeps = [
            sweep
            for node in self.nodes
            for sweep in node.sweeps(options)
            if sweep.first_buffer.retention is None
        ]
        if options.tracks_events:
            self._expand_matches()
        self.set_sweeps([] if skip_state is not None else sweeps)
        self._enqueue_all_expirations()
        # Each node listens again in `bind`, in the order that its new options require.
        self.unlisten()
        self.completion = completion = self._continuation_of_head()
        complete = completion.action

        def complete_match(match: PartialMatch, frame: Frame) -> Frame:
            return complete(match.term, match.values, match.start, match.end, frame)

        complete_root: Emit = self._complete_tracked if options.tracks_events else complete_match
        if skip_state is not None:
            skip_state.connect(root, complete_root, options)
        elif root.is_single_event and not self.maintains_clock and not options.tracks_events:
            # Creating match objects would take 12 % more time, and goals are fused only here.
            root.bind_values(completion)
        else:
            root.bind(complete_root, options)

    def _expand_matches(self) -> None:
        """Replace stored matches that cannot hold all attributes, which tracking sets."""
        expanded_by_match: Dict[PartialMatch, PartialMatch] = {}
        for buffer in self._buffers():
            if isinstance(buffer, MatchBuffer):
                expanded_by_match.update(buffer.expand())
        if expanded_by_match:
            self.reset_arrivals([expanded_by_match.get(match, match) for match in self.arrivals])

    def stream_node(self, pattern: Pattern) -> Optional[StreamNode]:
        """Return the node that evaluates an operator on streams; None if there is none for this pattern."""
        nodes = [node for node in self.nodes if isinstance(node, StreamNode)]
        return next((node for node in nodes if node.pattern is pattern), None)

    def open_windows(self) -> Iterator[Tuple[WindowPattern, Dict[str, Term], OpenWindow]]:
        """Yield the windows that have elements and have not ended, with the values of their keys by variable."""
        for node in self.nodes:
            if isinstance(node, StreamNode) and isinstance(node.stream, Window):
                assert isinstance(node.pattern, WindowPattern)
                for window in node.stream.open_windows(node.watermark_time()):
                    # The variables of a window's matches begin with those of its key.
                    names = [self.definition.names.get(var, "_") for var in node.vars]
                    yield node.pattern, dict(zip(names, window.key_values)), window

    def _buffers(self) -> List[Any]:
        return [buffer for node in self.nodes for buffer in node.buffers()]

    # ---- state -----------------------------------------------------------------------------------------

    @property
    def stored_arrivals(self) -> Arrivals:
        """The stored matches."""
        buffer_positions = {id(buffer): position for position, buffer in enumerate(self._buffers())}
        stored = [match for match in self.arrivals if match.buffer is not None]
        return Arrivals(
            stored,
            [buffer_positions.get(id(match.buffer), -1) for match in stored],
            [int(match.order) for match in stored],
        )

    @stored_arrivals.setter
    def stored_arrivals(self, arrivals: Arrivals) -> None:
        buffers = self._buffers()
        matches_by_buffer: Dict[int, Dict[PartialMatch, None]] = {}
        for match, position, order in zip(*arrivals):
            # Orders are set before the matches are put back: buffers link them in this order.
            match.order = order
            matches_by_buffer.setdefault(position, {})[match] = None
        for position, matches in matches_by_buffer.items():
            # The node has restored the matches of its run groups (position -1).
            if position >= 0:
                buffers[position].put_back(list(matches))
        self.reset_arrivals(arrivals.matches)
        self.stored_match_count = len(set(self.arrivals))

    @property
    def stored_deferred_matches(self) -> List[DeferredMatch]:
        """The matches that are stored when the next event is dispatched."""
        buffer_positions = {id(buffer): position for position, buffer in enumerate(self._buffers())}
        return [
            DeferredMatch(buffer_positions[id(buffer)], match) for buffer, match, _ in self.deferred_matches
        ]

    @stored_deferred_matches.setter
    def stored_deferred_matches(self, deferred_matches: Sequence[DeferredMatch]) -> None:
        buffers = self._buffers()
        self.deferred_matches = [
            (buffers[position], match, buffers[position].key_of(match))
            for position, match in deferred_matches
        ]

    def restore(self, saved: State) -> None:
        """Set the state that another rule with the same definition returned, after the nodes were connected."""
        super().restore(saved)
        self._enqueue_all_expirations()

    def can_store(self, state: State) -> bool:
        """Return whether the stored and deferred matches of a state fit the buffers that they are put into."""
        checks = [
            check
            for node, node_state in zip(self.nodes, state["node_states"])
            for check in node.buffer_checks(node_state)
        ]
        matches, buffer_numbers, _ = state["stored_arrivals"]
        deferred = [(match, number) for number, match in state["stored_deferred_matches"]]
        return all(
            number < len(checks) and (checks[number](match) if number >= 0 else match.buffer is not None)
            for match, number in chain(zip(matches, buffer_numbers), deferred)
        )

    def _enqueue_all_expirations(self) -> None:
        """Enter all stored matches into the expiration queues by their current retention times."""
        self._clear_expirations()
        for match in self.arrivals:
            if match.buffer is not None:
                self._enqueue_expiration(match, match.buffer.retention)
        if self.skip_state is not None:
            self.skip_state.rebuild_entries(self.arrivals)

    def _clear_expirations(self) -> None:
        self.expiration_queue.reset(self._main_retention)
        self._end_queue = ExpirationQueue()

    def listen(self, leaf: EventNode, action: EventAction, is_fused: bool = False) -> None:
        """Register the action of an event node; see `Dispatcher.listen`."""
        listen = self.network.dispatcher.listen
        rank = (self.serial, leaf.rank)
        self.listeners.append(
            listen(ListenerPhase.RULES, leaf.term, action, rank, is_fused, unread_variables=self._unused)
        )

    @property
    def collects_garbage(self) -> bool:
        """True if garbage control removes stored matches."""
        return self._garbage_control is not None

    @property
    def vars(self) -> List[Var]:
        """Variables of the values of a match, in order."""
        return self.root.vars

    @property
    def ground_value_count(self) -> int:
        """Number of leading values of a match that contain variables only if its event does."""
        node: Any = self.root
        if not node.is_single_event:
            return 0
        while not isinstance(node, EventNode):
            # Its results may come from earlier events.
            if isinstance(node, StreamNode):
                return 0
            node = node.child
        return len(node.vars)

    @property
    def match_count(self) -> int:
        """Number of matches in its buffers and in its operators on streams."""
        return self.stored_match_count + sum(node.stored_count() for node in self.nodes)

    @property
    def keys(self) -> int:
        """Number of keys with stored matches, and of keys with a state in operators on streams."""
        buffers = [buffer for buffer in self._buffers() if isinstance(buffer, MatchBuffer)]
        return sum(len(buffer.newest) for buffer in buffers) + sum(node.keys() for node in self.nodes)

    @property
    def bytes(self) -> int:
        """Estimate of the memory of its state: numbers of matches and keys times measured constants."""
        return self.stored_match_count * MATCH_BYTES + sum(node.bytes() for node in self.nodes)

    @property
    def watermark_delay(self) -> int:
        """Longest delay in ns by which its operators on streams wait for late events."""
        nodes = [node for node in self.nodes if isinstance(node, StreamNode)]
        return max((node.watermark.delay for node in nodes), default=0)

    @property
    def active(self) -> bool:
        """True if it receives events."""
        return bool(self.listeners)

    def unlisten(self) -> None:
        """Stop receiving events."""
        for listener in self.listeners:
            self.network.dispatcher.remove(listener)
        self.listeners = []

    def clear(self) -> None:
        """Remove all partial matches and reset the clock."""
        self.clear_matches()
        if self.skip_state is not None:
            self.skip_state.clear()
        self.clock = self.max_timestamp = BEFORE_ALL_INSTANTS
        self._last_collection = None

    def return_to(self, instant: int) -> None:
        """Set the clock back, because the engine's clock had followed a wrong timestamp; matches remain."""
        self.clock = min(self.clock, instant)
        self.max_timestamp = BEFORE_ALL_INSTANTS
        if self._last_collection is not None:
            self._last_collection = min(self._last_collection, instant)
        if self.skip_state is not None:
            self.skip_state.return_to(instant)
        for node in self.nodes:
            if isinstance(node, StreamNode):
                node.return_to(instant)

    def clear_matches(self) -> None:
        """Remove all partial matches, runs and negated matches."""
        self.deferred_matches = []
        for node in self.nodes:
            node.clear()
        for match in list(self.arrivals):
            match.discard()
        self.reset_arrivals(())
        self._clear_expirations()

    def defer_storage(self, buffer: MatchBuffer, match: PartialMatch, key: Hashable) -> None:
        """Store a match in a buffer when the next event is dispatched; immediately outside of a dispatch."""
        if self.network.dispatcher.current is None:
            buffer.add(match, key)
            return
        self._deferring_event = self.network.dispatcher.token()
        self.deferred_matches.append((buffer, match, key))

    def store_deferred_of_earlier_events(self, event: object) -> None:
        """Store the matches that were deferred until another event is dispatched."""
        if self._deferring_event != event:
            self.store_deferred()
        if self.skip_state is not None:
            self.skip_state.begin_event(event)

    def store_deferred(self, only_in: Optional[MatchBuffer] = None) -> None:
        """Store all deferred matches; with ``only_in``, only those of that buffer."""
        for entry in list(self.deferred_matches):
            buffer, match, key = entry
            if only_in is None or buffer is only_in:
                self.deferred_matches.remove(entry)
                buffer.add(match, key)

    def is_ahead(self, end: int) -> bool:
        """Return whether an end is too far ahead of the engine's clock to advance that of the rule."""
        self.max_timestamp = self.network.compute_max_timestamp()
        return end > self.max_timestamp

    def advance_clock(self, end: int) -> None:
        """Advance the rule's clock and remove the matches that have expired."""
        if end <= self.clock:
            return
        # Reading the clock costs much more than this comparison, and most events lie below the last limit.
        if end > self.max_timestamp and self.is_ahead(end):
            self.network.report_ahead(self, end)
            return
        self.clock = end
        self.expiration_queue.expire(end)
        if self._garbage_control is not None:
            self._collect_garbage(*self._garbage_control)

    def _collect_garbage(self, window: int, step: int) -> None:
        """Remove the matches that ended before the window of garbage control, at most once per step."""
        clock = self.clock
        if self._last_collection is None:
            self._last_collection = clock
        if clock - self._last_collection < step:
            return
        self._last_collection = clock
        for match in self._end_queue.pop_expired(clock - window):
            if match.latest_end < clock - window:
                match.discard()
            # A run that was extended since it was entered has a later end now.
            else:
                self._end_queue.add(match.latest_end, match, self.stored_match_count)

    def track_stored(self, match: PartialMatch, retention: Optional[int]) -> None:
        """Enter a stored match into the expiration queues, and register it with the events that it contains."""
        # A match that arrives after its retention time cannot be part of a result.
        if retention is not None and match.start + retention < self.clock:
            match.discard()
            return
        network = self.network
        if network.options.tracks_events:
            network.tracker.register_match(match)
        if self.maintains_clock and match.buffer is not None:
            self._enqueue_expiration(match, retention)
        if self.skip_state is not None:
            self.skip_state.add_entry(match)

    def report_dropped(self, match: PartialMatch, is_negated: bool) -> None:
        """See `MatchStore.report_dropped`."""
        self.network.report_dropped(self, excluding=match if is_negated else None)

    def _enqueue_expiration(self, match: PartialMatch, retention: Optional[int]) -> None:
        if retention is not None:
            self.expiration_queue.add(retention, match, self.stored_match_count)
        if self._garbage_control is not None:
            self._end_queue.add(match.latest_end, match, self.stored_match_count)

    def _complete_values(self, term: Term, values: Values, start: int, end: int, frame: Frame) -> Frame:
        window = self.window
        if window is not None and end - start > window:
            return frame
        metrics = self.metrics
        metrics.firing_count += 1
        metrics.last_end = end
        return self.fire(self._head(values), start, end, frame)

    def _head(self, values: Values) -> Term:
        """Return the head with the values of a match; its builder is compiled at the first use."""
        if self._builder is None:
            assert self.definition.head is not None
            self._builder = compile_builder(self.definition.head, self.root.vars, "head of a rule")
        return self._builder(values)

    def _count_match(self, term: Term, values: Values, start: int, end: int, frame: Frame) -> Frame:
        self.metrics.firing_count += 1
        self.metrics.last_end = end
        return frame

    def _continuation_of_head(self) -> Continuation:
        """Return the continuation for the values of a complete match."""
        head = self.definition.head
        if head is None:
            return Continuation(self._count_match)
        key: Optional[Functor] = None
        if head.__class__ is Atom:
            key = head.functor
        elif head.__class__ is tuple and head[0].name not in _ALARM_FUNCTORS:
            key = head[0]
        # Generated code covers the usual case: a head that is known to be an event, and no test of the interval.
        if self.window is not None or key is None or is_larger(head, MAX_TERM_ARGUMENTS):
            return Continuation(self._complete_values)
        dispatcher = self.network.dispatcher
        event_filter = dispatcher.event_filter(key)

        def on_failure(error: UsageError, frame: Frame) -> Frame:
            self.network.report_rule_error(self, RuleError(error.message))
            return frame

        complete = compile_firing_action(head, self.root.vars, self, event_filter, on_failure)
        make_shortcut = dispatcher.shortcuts.get(head[0]) if head.__class__ is tuple else None
        shortcut = make_shortcut and make_shortcut(self, complete)
        return (
            Continuation(shortcut, True, event_filter)
            if shortcut
            else Continuation(complete, False, event_filter)
        )

    def _complete_tracked(self, match: PartialMatch, frame: Frame) -> Frame:
        window = self.window
        if window is not None and match.end - match.start > window:
            return frame
        self.metrics.firing_count += 1
        self.metrics.last_end = match.end
        if self.definition.head is None:
            return frame
        return self.network.tracker.fire(self, match, self._head(match.values), frame)

    def fire(self, head: Term, start: int, end: int, frame: Frame, token: Any = None) -> Frame:
        """Return the frame that dispatches the head, or sets its alarm, and continues with ``frame``."""
        # Each firing counts as work, so a rule that triggers itself is stopped.
        if self.meter is not None and self.meter(1):
            return frame
        network = self.network
        dispatcher = network.dispatcher
        if head.__class__ not in (tuple, Atom):
            head = deref(head)
        try:
            if head.__class__ is tuple and head[0].name in _ALARM_FUNCTORS:
                alarm = resolve_alarm(head, start, end)
                network.report_past_alarm(self, head, alarm)
                if alarm is not None:
                    network.set_alarm(self, *alarm, token)
                    return frame
            return dispatcher.dispatch(head, start, end, frame, token)
        except UsageError as error:
            network.report_rule_error(self, RuleError(error.message))
            return frame


_ALARM_FUNCTORS = frozenset(("exceptionAlarm", "exceptionAlarmAbsoluteDatime"))
