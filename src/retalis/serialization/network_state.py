"""Serialization of rules and their state: partial matches, tracked events, alarms, pending queries, and timers.

Each rule and node returns its state as data, and `GraphWriter` encodes the objects in it in columns. Reading checks
the data against the loaded program before anything is restored. `check_rule_state` checks that the nodes of a rule
have the same types as when the state was written, and that each partial match fits the buffer that it is restored
into (`match_checks`). `StreamCheck` checks the state of stream operators: windows, rate operators, absence timeouts
and row patterns.
"""

from itertools import chain
from operator import itemgetter
from types import MappingProxyType
from typing import Any, Callable, Dict, List, NamedTuple, Optional, Sequence, Tuple

from ..events.clock.clock import Clock
from ..events.knowledge.knowledge_base import KnowledgeBase
from ..events.knowledge.timeouts import TimeoutAlarm, Timeouts
from ..events.matches.match_types import EventMatch
from ..events.network.event_rule import EventRule, RuleState
from ..events.network.join_node import JoinNode
from ..events.network.kleene_node import KleeneNode
from ..events.network.pattern_nodes import NetworkNode
from ..events.network.repeat_node import RepeatNode
from ..events.network.stream_node import StreamNode
from ..events.program.event_file_checker import reread_rule
from ..events.rules.rule_base import RuleBase
from ..events.rules.timer_service import RuleAlarm
from ..events.streams.absence_timeout import AbsenceTimeout
from ..events.streams.rate_operators import Debounce, DistinctUntilChanged, Throttle
from ..events.streams.row_pattern import SCANNING, RowPatternNFA, RowPatternWindow
from ..events.streams.stream_operators import StreamElement, StreamOperator
from ..events.streams.windows import AnchoredTumblingWindow, HoppingWindow
from ..foundation.errors import UsageError
from ..prolog.terms.term_traversal import term_key
from ..prolog.terms.unification import may_unify
from .decoded_value_checks import (
    Decoded,
    ValueCheck,
    any_value,
    boolean,
    callable_term,
    count,
    instant,
    integer,
    integers,
    invalid_value,
    items,
    key,
    match_order,
    match_orders,
    none,
    optional,
    record,
    sequence_of,
    term,
    text,
    tuple_of,
    with_name,
)
from .match_checks import (
    MatchShape,
    buffer_shapes,
    check_arrivals,
    check_lineage,
    check_stored_once,
    group_fits,
)
from .match_graph import MATCH_KINDS, GraphReader, GraphWriter


class StreamCheck:
    """Check of the state of a stream operator.

    Args:
        graph: contains the elements.
        stream: operator that was compiled from the same pattern as the one that wrote the state.
        value_counts: number of key values and number of measured values of an element.
        elements_are_terms: whether elements contain terms (subscriptions) or matches (rules).
        needs_match: whether each element must have a match.
        shapes: shapes of these matches, by channel.
    """

    def __init__(
        self,
        graph: GraphReader,
        stream: StreamOperator,
        value_counts: Tuple[int, int],
        elements_are_terms: bool = False,
        needs_match: bool = False,
        shapes: Sequence[MatchShape] = (),
    ):
        self._read_element = graph.reference_to("element")
        self._stream = stream
        self._value_counts = value_counts
        self._elements_are_terms = elements_are_terms
        self._needs_match = needs_match
        self._shapes = shapes
        make_accumulators: Callable[[], Sequence[Any]] = getattr(stream, "make", lambda: ())
        scopes = getattr(stream, "scopes", None)
        # With scopes, a measure uses only elements of some steps, so the values of other elements need not suit it.
        self._checks = (
            [accumulator.check for accumulator in make_accumulators() if accumulator.checks_values]
            if scopes is None
            else []
        )

    def check_element(self, value: Decoded, channel: int = 0) -> StreamElement:
        """Check an element of a channel."""
        element: StreamElement = self._read_element(value)
        key_count, value_count = self._value_counts
        if len(element.key_values) != key_count or len(element.values) != value_count:
            expected = f"an element with {key_count} key values and {value_count} measured values"
            raise invalid_value((element.key_values, element.values), expected)
        if element.match is None:
            is_valid = not self._needs_match
        elif self._elements_are_terms:
            is_valid = not isinstance(element.match, EventMatch)
        else:
            is_valid = self._shapes[channel].fits(element.match)
        if not is_valid or element.start > element.end:
            raise invalid_value(element.match, "an element of the right type")
        if not self._elements_are_terms and any(measured is None for measured in element.values):
            raise invalid_value(element.values, "values")
        for check in self._checks:
            check(element)
        element.restore_key()
        return element

    def _check_distinct(self, elements: Sequence[StreamElement], order: int) -> None:
        """Check that elements are distinct and have distinct sequence numbers."""
        orders = {element.order for element in elements}
        if len(orders) != len(elements) or not all(1 <= number <= order for number in orders):
            raise invalid_value(
                sorted(element.order for element in elements), "elements with distinct sequence numbers"
            )

    def check_state(self, value: Decoded) -> Decoded:
        """Check the complete state of the operator; see `StreamOperator.snapshot`."""
        stream = self._stream
        elements = sequence_of(self.check_element)
        if isinstance(stream, RowPatternWindow):
            return self._check_row_pattern_state(stream, value)
        if isinstance(stream, Throttle):
            return tuple_of(instant, elements)(value)
        if isinstance(stream, DistinctUntilChanged):
            state = instants, last_elements = tuple_of(sequence_of(instant), elements)(value)
            if len(instants) != len(last_elements):
                raise invalid_value(len(instants), f"{len(last_elements)} instants")
            return state
        if isinstance(stream, Debounce):
            state = last_order, _, waiting_elements = tuple_of(count, instant, elements)(value)
            self._check_distinct(waiting_elements, last_order)
            return state
        if isinstance(stream, AbsenceTimeout):
            # Channel 1 are the events that must not happen.
            forbidden_elements = sequence_of(lambda element: self.check_element(element, 1))
            state = tuple_of(count, instant, elements, forbidden_elements)(value)
            last_order, _, waiting_elements, forbidding_elements = state
            self._check_distinct([*waiting_elements, *forbidding_elements], last_order)
            return state
        # The remaining operators are windows, which have the same state except for the items appended here.
        window_time: List[ValueCheck] = (
            [instant] if isinstance(stream, (AnchoredTumblingWindow, HoppingWindow)) else []
        )
        future_elements: List[ValueCheck] = [elements] if isinstance(stream, HoppingWindow) else []
        # Only these windows emit when the clock reaches an instant.
        next_end = optional(instant) if window_time else none
        keyed_window = tuple_of(instant, elements)
        checked_state = tuple_of(
            instant, next_end, count, count, sequence_of(keyed_window), *window_time, *future_elements
        )(value)
        # See `KeyedWindows.snapshot`.
        _, next_window_end, _, last_order, keyed_windows, *appended_items = checked_state
        partitions = [elements_of_key for _, elements_of_key in keyed_windows]
        elements_of_later_windows = appended_items[1] if isinstance(stream, HoppingWindow) else []
        self._check_partitions(partitions, elements_of_later_windows, last_order)
        if isinstance(stream, HoppingWindow):
            _check_next_window(stream, next_window_end, partitions, elements_of_later_windows)
        return checked_state

    def _check_partitions(
        self, partitions: List[List[StreamElement]], future_elements: List[StreamElement], order: int
    ) -> None:
        self._check_distinct([*chain.from_iterable(partitions), *future_elements], order)
        keys = [{element.key for element in partition} for partition in partitions]
        if any(len(partition_keys) != 1 for partition_keys in keys) or len(set().union(*keys)) != len(keys):
            raise invalid_value(len(keys), "distinct partitions, each with one key")

    def _check_row_pattern_state(self, stream: RowPatternWindow, value: Decoded) -> Decoded:
        """Check the state of a row pattern; see `RowPatternWindow.snapshot`."""
        step = integer(0, len(stream.nfa.steps) - 1)
        steps = sequence_of(step, tuple)
        pairs = sequence_of(tuple_of(count, step), tuple)
        computation_state = record(
            _ComputationStateData,
            step=integer(SCANNING, len(stream.nfa.steps) - 1),
            element_count=count,
            remaining_steps=optional(steps),
            targets=sequence_of(optional(count), tuple),
            assigned=pairs,
            preceding_matches=count,
        )
        partition = tuple_of(
            instant,
            sequence_of(self.check_element),
            sequence_of(computation_state, tuple),
            sequence_of(pairs, tuple),
        )
        checked_state = tuple_of(count, count, instant, sequence_of(partition))(value)
        _, last_order, _, partitions = checked_state
        # The operator relies on these invariants: computation states and completed matches refer to elements of
        # their partition, in order, and each state has an element for each navigation.
        self._check_partitions([elements for _, elements, _, _ in partitions], [], last_order)
        for _, elements, states, completed in partitions:
            orders = [element.order for element in elements]
            target_orders = [order for state in states for order in state.targets if order is not None]
            assigned_orders = [
                order for pairs in (*(state.assigned for state in states), *completed) for order, _ in pairs
            ]
            preceding_matches = [state.preceding_matches for state in states]
            if (
                not states
                or not all(completed)
                or orders != sorted(orders)
                or not {*target_orders, *assigned_orders} <= set(orders)
                or any(len(state.targets) != len(stream.nfa.navigations) for state in states)
                or any(bool(state.assigned) != (state.step != SCANNING) for state in states)
                or any(state.remaining_steps is not None and not state.remaining_steps for state in states)
                or any(list(state.assigned) != sorted(state.assigned, key=itemgetter(0)) for state in states)
                or preceding_matches != sorted(preceding_matches)
                or len(completed) != preceding_matches[-1] - preceding_matches[0]
                # At least one state must be scanning or certain to complete. Otherwise all states of the partition
                # could fail, and no state would remain to process the next element.
                or not any(state.step == SCANNING or _is_certain(stream.nfa, state) for state in states)
            ):
                raise invalid_value(states, "valid computation states of a row pattern")
        return checked_state


class _ComputationStateData(NamedTuple):
    """Saved `ComputationState`, which refers to elements by their order.

    Attributes:
        step: step of the last element, or `SCANNING`.
        element_count: number of elements of that step.
        remaining_steps: after a skipped element, the steps that can still accept one; otherwise None.
        targets: order of the element of each navigation, or None if there is none yet.
        assigned: order and step of each element of the match.
        preceding_matches: see `ComputationState`.
    """

    step: int
    element_count: int
    remaining_steps: Optional[Tuple[int, ...]]
    targets: Tuple[Optional[int], ...]
    assigned: Tuple[Tuple[int, int], ...]
    preceding_matches: int


def _check_next_window(
    stream: HoppingWindow,
    next_end: Optional[int],
    partitions: List[List[StreamElement]],
    future_elements: List[StreamElement],
) -> None:
    """Check that the end of the next window is a multiple of the step and follows its elements.

    If the window is empty, the first element of a later window must end before it. Otherwise the clock would have to
    close many empty windows.
    """
    elements = list(chain.from_iterable(partitions))
    if next_end is None:
        is_valid = not elements and not future_elements
    elif elements:
        is_valid = all(element.end < next_end for element in elements)
    else:
        is_valid = not future_elements or min(element.end for element in future_elements) < next_end
    if not is_valid or (next_end is not None and next_end % stream.slide):
        raise invalid_value(next_end, "the end of the next window")


def _is_certain(nfa: RowPatternNFA, state: _ComputationStateData) -> bool:
    """Return whether a computation state is certain to complete."""
    steps = state.remaining_steps
    if steps is None:
        steps = nfa.transitions_after(state.step, state.element_count).steps
    return bool(steps) and nfa.can_never_fail(steps)


def check_rule_state(graph: GraphReader, rule: EventRule, value: Decoded) -> RuleState:
    """Check the state of a rule; see `EventRule.state`."""
    nodes = [node for node, _, _ in rule.nodes]
    saved_fields = items(value)
    # The record is checked below; here only the states of its nodes are needed.
    has_all_fields = len(saved_fields) == len(RuleState._fields)
    saved_nodes = RuleState(*saved_fields).nodes if has_all_fields else []
    named_states = sequence_of(tuple_of(text, any_value))(saved_nodes)
    # A rule with the same text can be compiled to other nodes by another version of the package.
    if [type_name for type_name, _ in named_states] != [type(node).__name__ for node in nodes]:
        raise UsageError(f"{rule.name}: its nodes differ from those in the state")
    checked_states = [
        (type_name, with_name(type_name, _make_node_check(graph, node))(node_state))
        for node, (type_name, node_state) in zip(nodes, named_states)
    ]
    # Buffers are numbered across all nodes of the rule, and a match names its buffer by that number.
    shapes = [
        shape
        for node, (_, node_state) in zip(nodes, checked_states)
        for shape in buffer_shapes(node, node_state)
    ]
    buffer_number = integer(0, len(shapes) - 1)
    state: RuleState = record(
        RuleState,
        counts=tuple_of(count, optional(instant), count, count, count, count, count, count),
        times=tuple_of(instant, match_order, optional(instant)),
        nodes=lambda _: checked_states,
        arrivals=tuple_of(graph.objects_by_number(*MATCH_KINDS), integers(-1, len(shapes) - 1), match_orders),
        deferred_matches=sequence_of(tuple_of(buffer_number, graph.check_match)),
        deferring_event=graph.check_token,
        skipped=optional(tuple_of(instant, sequence_of(instant, tuple))),
    )(value)
    check_arrivals(rule, state, shapes)
    return state


def _make_node_check(graph: GraphReader, node: Any) -> ValueCheck:
    """Return a check of the state of a node; see `NetworkNode.snapshot`."""
    if isinstance(node, JoinNode):
        return tuple_of(sequence_of(graph.check_token_key), sequence_of(_make_match_check(graph, node.right)))
    if isinstance(node, KleeneNode):
        return sequence_of(_make_match_check(graph, node.repeated))
    if isinstance(node, RepeatNode):
        return _make_repeat_node_check(graph, node)
    if isinstance(node, StreamNode):
        return _make_stream_node_check(graph, node)
    return none


def _make_match_check(graph: GraphReader, node: NetworkNode) -> ValueCheck:
    """Return a check of a reference to a match of a node."""
    shape = MatchShape(node)

    def check(value: Decoded) -> Decoded:
        match = graph.check_match(value)
        if not shape.fits(match):
            raise invalid_value(
                match.values, f"a match with {shape.width} values and the event of its pattern"
            )
        return match

    return check


def _make_repeat_node_check(graph: GraphReader, node: RepeatNode) -> ValueCheck:
    """Return a check of the state of a `RepeatNode`: lengths of sequences and run groups."""
    # Complete sequences are not stored.
    length = integer(1, node.times - 1)
    read_run_group = graph.reference_to("run group")

    def check_run_group(value: Decoded) -> Decoded:
        run_group = read_run_group(value)
        if not group_fits(node, run_group):
            raise invalid_value(value, "runs of this node")
        return run_group

    lengths_by_key = sequence_of(tuple_of(key, sequence_of(length)))
    return tuple_of(boolean, sequence_of(length), sequence_of(check_run_group), lengths_by_key)


def _make_stream_node_check(graph: GraphReader, node: StreamNode) -> ValueCheck:
    """Return a check of the state of a `StreamNode`: its operator, and what a replay needs."""
    child = node.children[0]
    keys, values = node.spec.key_and_values((1,) * len(child.vars))
    needs_match = node.spec.build_match_values is None and not isinstance(
        node.stream, (Throttle, DistinctUntilChanged)
    )
    shapes = [MatchShape(child) for child in node.children]
    stream = StreamCheck(
        graph,
        node.stream,
        (len(keys), len(values)),
        elements_are_terms=False,
        needs_match=needs_match,
        shapes=shapes,
    )
    channel = integer(0, len(node.children) - 1)
    received = tuple_of(channel, any_value, instant)

    def check_received(value: Decoded) -> Decoded:
        channel_number, element, received_at = received(value)
        return channel_number, stream.check_element(element, channel_number), received_at

    def check_contributors(value: Decoded) -> Decoded:
        # An output must have an element: a replay identifies outputs by their last element.
        if not items(value):
            raise invalid_value(value, "the elements of an output")
        return sequence_of(stream.check_element)(value)

    output = tuple_of(check_contributors, instant, instant, sequence_of(term, tuple), none)
    emitted = tuple_of(output, graph.reference_to("repetition chain"))

    def check_initial_state(value: Decoded) -> Decoded:
        return stream.check_state(value) if items(value) else ()

    replay = tuple_of(check_initial_state, sequence_of(check_received), sequence_of(emitted))
    return tuple_of(stream.check_state, count, optional(replay))


def snapshot_rules(rules: RuleBase, referenced_rules: Sequence[EventRule]) -> Dict[str, Any]:
    """Return the definitions of rules, the properties of labels, and the flags.

    Args:
        rules: the rule base of the program.
        referenced_rules: rules that other data refers to. They include deleted rules with pending alarms.
    """
    active_rules = set(rules.rules)
    definitions = [
        (
            *(rule.definition.term, rule.definition.label, rule.definition.place),
            *(dict(rule.definition.names), rule.serial, rule.name, rule in active_rules),
        )
        for rule in referenced_rules
    ]
    return {
        "definitions": definitions,
        "properties": [
            label_property for properties in rules.all_properties().values() for label_property in properties
        ],
        "flags": rules.flags.changed_flags(),
        "loaded_files": sorted(str(path) for path in rules.files.loaded),
        "program_folders": list(rules.files.sandbox.program_folders),
    }


def restore_rules(rules: RuleBase, saved_rules: Dict[str, Any]) -> List[EventRule]:
    """Create rules in another program, and activate them.

    Args:
        rules: the rule base of the other program.
        saved_rules: a result of `snapshot_rules`.

    Returns:
        All rules: active ones in the order of their serials, then deleted ones.

    Raises:
        RetalisError: if a rule is invalid, or a flag does not exist.
    """
    serials = [serial for _, _, _, _, serial, _, active in saved_rules["definitions"] if active]
    if serials != sorted(set(serials)):
        raise invalid_value(serials, "rules with increasing serials")
    # Flags first: they determine how rules are compiled.
    for name, value in saved_rules["flags"].items():
        rules.flags.set(name, value)
    restored_rules = []
    for rule_term, label, place, names, serial, name, active in saved_rules["definitions"]:
        definition = reread_rule(rule_term, label, place, names)
        rule = EventRule(rules, definition._replace(names=MappingProxyType(names)), serial, name)
        restored_rules.append(rule)
        # Deleted rules are only created for their pending alarms.
        if active:
            rules.activate(rule)
    for label_property in saved_rules["properties"]:
        rules.set_property(label_property)
    for folder in saved_rules["program_folders"]:
        rules.files.sandbox.add_program_folder(folder)
    return restored_rules


def snapshot_matches(
    rules: RuleBase,
    knowledge: KnowledgeBase,
    clock: Clock,
    active: Sequence[EventRule],
    max_explained_events: Optional[int] = None,
) -> Tuple[Any, List[EventRule]]:
    """Return partial matches and recorded events as data.

    Args:
        rules: the rule base.
        knowledge: the knowledge base.
        clock: the clock of the engine.
        active: the active rules.
        max_explained_events: maximum number of recorded events whose lineage is included if it only serves
            explanations; None for all.

    Returns:
        The data, and all rules that it refers to: active ones, then deleted ones.
    """
    remembered_events, *event_counters = rules.tracker.snapshot()
    first_event_number = 0
    # Retractions need the complete lineage, explanations do not.
    if (
        max_explained_events is not None
        and len(remembered_events) > max_explained_events
        and not rules.flags.is_on("revision_flag")
    ):
        remembered_events = remembered_events[-max_explained_events:]
        first_event_number = remembered_events[0].number
    graph = GraphWriter(active, first_event_number)
    states = [_write_state(graph, rule) for rule in active]
    queries = knowledge.pending_queries
    next_query_order, pending_queries = queries.snapshot()
    data = {
        "rules": states,
        "occurrences": graph.write((remembered_events, *event_counters)),
        "alarms": [graph.write(entry) for entry in _snapshot_alarms(clock, knowledge)],
        "next_query_order": next_query_order,
        "pending_queries": [graph.write(entry) for entry in pending_queries],
        "state_intervals": [graph.write(entry) for entry in knowledge.states.snapshot()],
        "rate_limiters": [graph.write(entry) for entry in knowledge.subscriptions.snapshot()],
        "timeouts": queries.timeouts.snapshot(),
        "timers": (rules.timers.snapshot(), rules.timers.omitted_count),
        "stored_events": rules.event_log.stored_events(),
        "counts": (rules.serial, rules.fired_by_deleted_rules, rules.failed_retraction_count),
    }
    data["objects"] = graph.encode()
    return data, graph.rules


def _write_state(graph: GraphWriter, rule: EventRule) -> Any:
    state = rule.snapshot()
    matches, buffer_numbers, orders = state.arrivals
    # A rule can have many partial matches, so they are columns of numbers instead of references.
    arrivals: Any = list(map(graph.number_of, matches)), buffer_numbers, orders
    other_fields = graph.write(tuple(state._replace(arrivals=([], [], []))))
    return tuple(RuleState(*other_fields)._replace(arrivals=arrivals))


def _snapshot_alarms(clock: Clock, knowledge: KnowledgeBase) -> List[Tuple[Any, ...]]:
    """Return the alarms of rules, pending queries and declared states; those of timers are saved with the timers.

    Each alarm has its order: alarms of the same instant are called in the order in which they were set. Nodes have
    one alarm, which comes before all others; it is set again from their deadlines.
    """
    owner_numbers = {id(timeouts): number for number, timeouts in enumerate(_all_timeouts(knowledge))}
    alarms: List[Tuple[Any, ...]] = []
    for due_at, order, alarm in sorted(clock.alarms, key=lambda entry: entry[:2]):
        if isinstance(alarm, RuleAlarm):
            alarms.append((due_at, order, alarm.rule, alarm.term, alarm.start, alarm.instant, alarm.token))
        # Alarms of declarations that were deleted have no effect, and are left out.
        elif isinstance(alarm, TimeoutAlarm) and id(alarm.timeouts) in owner_numbers:
            alarms.append((due_at, order, owner_numbers[id(alarm.timeouts)], alarm.alarm_instant))
    return alarms


def _all_timeouts(knowledge: KnowledgeBase) -> List[Timeouts]:
    """Return the deadlines of pending queries, then those of each declared state."""
    return [knowledge.pending_queries.timeouts, *(declared.timeouts for declared in knowledge.states)]


def restore_matches(
    rules: RuleBase, knowledge: KnowledgeBase, clock: Clock, data: Any, restored_rules: Sequence[EventRule]
) -> None:
    """Restore matches, events, alarms and queries.

    Args:
        rules: the rule base, with restored rules.
        knowledge: the knowledge base, with restored memories.
        clock: the clock of the engine.
        data: data from `snapshot_matches`.
        restored_rules: rules from `restore_rules`.
    """
    # All checks come first: invalid data must not leave rules and alarms partly restored.
    checked = _CheckedState(rules, knowledge, data, restored_rules)
    for rule, state in zip(restored_rules, checked.rule_states):
        rule.restore(state)
    rules.tracker.restore(checked.occurrences)
    queries = knowledge.pending_queries
    queries.restore(checked.next_query_order, checked.pending_queries)
    queries.timeouts.restore(*checked.timeouts)
    knowledge.states.restore(checked.state_intervals)
    all_timeouts = _all_timeouts(knowledge)
    for due_at, order, owner, *arguments in checked.alarms:
        # The owner of an alarm is a number of `_all_timeouts`, or a rule.
        alarm: Any = (
            RuleAlarm(rules, owner, *arguments)
            if isinstance(owner, EventRule)
            else TimeoutAlarm(all_timeouts[owner], *arguments)
        )
        clock.put_back(due_at, order, alarm)
    rules.timers.restore(*checked.timers)
    knowledge.subscriptions.restore_rate_limiters(checked.rate_limiters)
    rules.event_log.restore(checked.stored_events)
    rules.restore_counts(*checked.counts)


_check_timeouts = tuple_of(sequence_of(tuple_of(instant, count)), sequence_of(instant))
"""Check of deadlines; see `Timeouts.snapshot`."""


class _CheckedState:
    """State of rules, checked against the program that it belongs to.

    Args:
        rules: the rule base of the program.
        knowledge: the knowledge base of the program, with restored memories.
        data: data from `snapshot_matches`.
        restored_rules: rules from `restore_rules`.

    Raises:
        UsageError: if the data does not fit the program, or cannot have been created by `snapshot_matches`.
    """

    def __init__(
        self, rules: RuleBase, knowledge: KnowledgeBase, data: Any, restored_rules: Sequence[EventRule]
    ):
        self._graph = graph = GraphReader(data["objects"], restored_rules)
        active = rules.rules
        if len(items(data["rules"])) != len(active):
            raise invalid_value(len(data["rules"]), f"the states of {len(active)} rules")
        self.rule_states = [
            check_rule_state(graph, rule, state) for rule, state in zip(restored_rules, data["rules"])
        ]
        check_stored_once(restored_rules, self.rule_states)
        check_lineage(graph)
        event = graph.reference_to("event")
        occurrences = with_name("occurrences", tuple_of(sequence_of(event), count, count))
        self.occurrences = occurrences(data["occurrences"])
        self._timeouts_number = integer(0, len(_all_timeouts(knowledge)) - 1)
        self.alarms = sequence_of(self._check_alarm)(data["alarms"])
        self.next_query_order = count(data["next_query_order"])
        self.pending_queries = sequence_of(self._make_query_check(knowledge))(data["pending_queries"])
        self.state_intervals = self._check_state_intervals(knowledge, data["state_intervals"])
        self.rate_limiters = self._check_rate_limiters(knowledge, data["rate_limiters"])
        self.timeouts = _check_timeouts(data["timeouts"])
        timer = tuple_of(callable_term, term, optional(instant), instant, count)
        self.timers = tuple_of(sequence_of(timer), count)(data["timers"])
        self.stored_events = sequence_of(tuple_of(callable_term, instant, instant))(data["stored_events"])
        self.counts = tuple_of(count, count, count)(data["counts"])
        self._check_orders()

    def _check_alarm(self, value: Decoded) -> Decoded:
        graph = self._graph
        if len(items(value)) == 4:
            return tuple_of(instant, count, self._timeouts_number, instant)(value)
        rule, token = graph.reference_to("rule"), optional(graph.reference_to("event"))
        return tuple_of(instant, count, rule, callable_term, instant, instant, token)(value)

    def _make_query_check(self, knowledge: KnowledgeBase) -> ValueCheck:
        """Return a check of a pending query."""
        pair = tuple_of(term, instant)

        def check_awaited(value: Decoded) -> Decoded:
            name, required_instant = entry = pair(value)
            memory = knowledge.memories.find(name)
            # The transform buffer is not saved, so a restored query may wait for any transform.
            if memory is None and knowledge.transforms.awaited_transform(name) is not None:
                return entry
            # A query whose memory has already reached the time would never be run.
            if memory is None or memory.has_reached(required_instant):
                raise invalid_value(value, "a memory that has not reached an instant")
            return entry

        awaited = sequence_of(check_awaited)
        check_items = tuple_of(count, callable_term, term, instant, instant, awaited, self._graph.check_token)

        def check_query(value: Decoded) -> Decoded:
            query = check_items(value)
            *_, awaited_conditions, _ = query
            if not awaited_conditions:
                raise invalid_value(value, "a query that waits for a memory")
            return query

        return check_query

    def _check_state_intervals(self, knowledge: KnowledgeBase, value: Decoded) -> List[Any]:
        """Check the open and closed intervals of each declared state."""
        token = optional(self._graph.reference_to("event"))
        openings = sequence_of(tuple_of(instant, token))
        check = tuple_of(
            count,
            sequence_of(tuple_of(count, key, callable_term, key, openings)),
            sequence_of(tuple_of(key, callable_term, instant, instant, token)),
            count,
            _check_timeouts,
        )
        checked_intervals = sequence_of(check)(value)
        if len(checked_intervals) != len(list(knowledge.states)):
            raise invalid_value(len(checked_intervals), "the intervals of each declared state")
        for declared_state, (next_order, open_states, *_) in zip(knowledge.states, checked_intervals):
            _check_increasing([order for order, *_ in open_states], next_order, "states")
            for _, stored_key, state, _, starts in open_states:
                # The key is stored redundantly; a different one would make the state unreachable.
                if (
                    not starts
                    or stored_key != term_key(state)
                    or not may_unify(declared_state.form.state, state)
                ):
                    raise invalid_value(state, "a declared state that has begun")
            if len({stored_key for _, stored_key, *_ in open_states}) != len(open_states):
                raise invalid_value(len(open_states), "distinct states")
        return checked_intervals  # type: ignore[no-any-return]

    def _check_rate_limiters(self, knowledge: KnowledgeBase, value: Decoded) -> List[Any]:
        """Check the state of the stream operator of each subscription that has one."""
        subscriptions = [subscription for _, subscription in knowledge.subscriptions.items()]
        if len(items(value)) != len(subscriptions):
            raise invalid_value(len(value), f"the output rates of {len(subscriptions)} subscriptions")
        states: List[Any] = []
        for subscription, rate_state in zip(subscriptions, value):
            if subscription.rate_limiter is None:
                none(rate_state)
                states.append(None)
                continue
            stream = StreamCheck(
                self._graph,
                subscription.rate_limiter.stream,
                subscription.rate_limiter.value_counts,
                elements_are_terms=True,
            )
            states.append(optional(tuple_of(stream.check_state, count, count, count))(rate_state))
        return states

    def _check_orders(self) -> None:
        """Check that alarms, timers and queries have distinct sequence numbers."""
        timers, _ = self.timers
        alarm_orders = [order for _, order, *_ in self.alarms] + [order for *_, order in timers]
        if len(set(alarm_orders)) != len(alarm_orders):
            raise invalid_value(alarm_orders, "alarms with distinct sequence numbers")
        _check_increasing([order for order, *_ in self.pending_queries], self.next_query_order, "queries")


def _check_increasing(orders: List[int], next_order: int, subject: str) -> None:
    """Check that sequence numbers increase and are below the next one."""
    if orders != sorted(set(orders)) or any(order >= next_order for order in orders):
        raise invalid_value(orders, f"{subject} with increasing sequence numbers")
