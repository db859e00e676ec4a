"""Serialization of rules and their state: partial matches, tracked events, alarms, pending queries, and timers.

Each rule and node returns its state as data, and `GraphWriter` encodes the objects in it in columns. Reading checks
the data against the loaded program before anything is restored. `rule_state` checks that the nodes of a rule have the
same types as when the state was written, and that each partial match fits the buffer that it is put into
(`match_checks`). `StreamCheck` checks the state of stream operators: windows, rate operators, absence timeouts and
row patterns.
"""

from types import MappingProxyType
from typing import Any, Callable, Dict, List, Sequence, Tuple

from ..engine.runtime.clock import Clock
from ..events.knowledge.knowledge_base import KnowledgeBase
from ..events.knowledge.timeouts import TimeoutAlarm
from ..events.matches.partial_matches import EventMatch
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
from ..events.streams.stream_operator import StreamElement, StreamOperator
from ..events.streams.windows import AnchoredTumblingWindow, HoppingWindow
from ..foundation.errors import UsageError
from ..prolog.terms.term_traversal import term_key
from ..prolog.terms.unification import may_unify
from .match_checks import (
    MatchShape,
    buffer_shapes,
    check_arrivals,
    check_lineage,
    check_stored_once,
    group_fits,
)
from .match_graph import MATCH_KINDS, GraphReader, GraphWriter
from .schema import (
    Decoded,
    ValueCheck,
    anything,
    boolean,
    callable_term,
    count,
    each,
    fixed,
    instant,
    integer,
    integers,
    invalid_value,
    items,
    key,
    match_order,
    match_orders,
    named,
    nothing,
    optional,
    record,
    term,
    text,
)


class StreamCheck:
    """Check of the state of a stream operator.

    Args:
        graph: contains the elements.
        stream: an operator of the same part of the program.
        widths: number of values of an element that form the key, and number of values that are measured.
        of_terms: if elements consist of terms (those of a subscription) instead of matches.
        needs: if each element has a match.
        shapes: shapes of these matches, by channel.
    """

    def __init__(
        self,
        graph: GraphReader,
        stream: StreamOperator,
        widths: Tuple[int, int],
        of_terms: bool = False,
        needs: bool = False,
        shapes: Sequence[MatchShape] = (),
    ):
        self._refer = graph.ref("element")
        self._stream = stream
        self._widths = widths
        self._of_terms = of_terms
        self._needs = needs
        self._shapes = shapes
        make_accumulators: Callable[[], Sequence[Any]] = getattr(stream, "make", lambda: ())
        scopes = getattr(stream, "scopes", None)
        self._checks = (
            [accumulator.check for accumulator in make_accumulators() if accumulator.checks_values]
            if scopes is None
            else []
        )

    def item(self, value: Decoded, channel: int = 0) -> StreamElement:
        """Check an element of a channel."""
        element: StreamElement = self._refer(value)
        key_width, value_width = self._widths
        if len(element.by) != key_width or len(element.values) != value_width:
            expected = f"an element with {key_width} key values and {value_width} measured values"
            raise invalid_value((element.by, element.values), expected)
        if element.match is None:
            is_valid = not self._needs
        elif self._of_terms:
            is_valid = not isinstance(element.match, EventMatch)
        else:
            is_valid = self._shapes[channel].fits(element.match)
        if not is_valid or element.start > element.end:
            raise invalid_value(element.match, "an element of the right type")
        if not self._of_terms and any(item_value is None for item_value in element.values):
            raise invalid_value(element.values, "values")
        for check in self._checks:
            check(element)
        element.restore_key()
        return element

    def _check_distinct(self, elements: Sequence[StreamElement], order: int) -> None:
        """Check that elements are distinct and have distinct sequence numbers."""
        orders = {item.order for item in elements}
        if len(orders) != len(elements) or not all(1 <= number <= order for number in orders):
            raise invalid_value(
                sorted(item.order for item in elements), "elements with distinct sequence numbers"
            )

    def operator_state(self, value: Decoded) -> Decoded:
        """Check the complete state of the operator; see `StreamOperator.snapshot`."""
        stream = self._stream
        elements = each(self.item)
        if isinstance(stream, RowPatternWindow):
            return self._row_pattern_state(stream, value)
        if isinstance(stream, Throttle):
            return fixed(instant, elements)(value)
        if isinstance(stream, DistinctUntilChanged):
            state = fixed(each(instant), elements)(value)
            if len(state[0]) != len(state[1]):
                raise invalid_value(len(state[0]), f"{len(state[1])} instants")
            return state
        if isinstance(stream, Debounce):
            state = fixed(count, instant, elements)(value)
            self._check_distinct(state[2], state[0])
            return state
        if isinstance(stream, AbsenceTimeout):
            forbidden_elements = each(lambda element: self.item(element, 1))
            state = fixed(count, instant, elements, forbidden_elements)(value)
            self._check_distinct([*state[2], *state[3]], state[0])
            return state
        # The remaining operators are windows, which have the same state except for the items appended here.
        window_time: List[ValueCheck] = (
            [instant] if isinstance(stream, (AnchoredTumblingWindow, HoppingWindow)) else []
        )
        future_elements: List[ValueCheck] = [elements] if isinstance(stream, HoppingWindow) else []
        # Only these windows emit when the clock reaches an instant.
        due = optional(instant) if window_time else nothing
        group = fixed(instant, elements)
        state = fixed(instant, due, count, count, each(group), *window_time, *future_elements)(value)
        self._groups(
            [members for _, members in state[4]],
            sum((list(elements_of_window) for elements_of_window in state[6:]), []),
            state[3],
        )
        if isinstance(stream, HoppingWindow):
            _check_next_window(stream, state)
        return state

    def _groups(
        self, groups: List[List[StreamElement]], future_elements: List[StreamElement], order: int
    ) -> None:
        self._check_distinct([item for members in groups for item in members] + future_elements, order)
        keys = [{item.key for item in members} for members in groups]
        if any(len(group_keys) != 1 for group_keys in keys) or len(set().union(*keys)) != len(keys):
            raise invalid_value(len(keys), "distinct partitions, each with one key")

    def _row_pattern_state(self, stream: RowPatternWindow, value: Decoded) -> Decoded:
        step = integer(0, len(stream.nfa.steps) - 1)
        steps = each(step, tuple)
        pairs = each(fixed(count, step), tuple)
        computation_state = fixed(
            integer(-1, len(stream.nfa.steps) - 1),
            count,
            optional(steps),
            each(optional(count), tuple),
            pairs,
            count,
        )
        group = fixed(instant, each(self.item), each(computation_state, tuple), each(pairs, tuple))
        state = fixed(count, count, instant, each(group))(value)
        # The operator relies on these invariants: computation states and completed matches refer to elements of
        # their partition, in order, and each state has an element for each navigation.
        self._groups([entry[1] for entry in state[3]], [], state[1])
        for _, members, states, complete in state[3]:
            orders = [item.order for item in members]
            marked = [order for entry in states for order in entry[3] if order is not None]
            assigned = [order for entry in states for order, _ in entry[4]] + [
                order for entry in complete for order, _ in entry
            ]
            positions = [entry[5] for entry in states]
            if (
                not states
                or not all(complete)
                or orders != sorted(orders)
                or not {*marked, *assigned} <= set(orders)
                or any(len(entry[3]) != len(stream.nfa.navigations) for entry in states)
                or any(bool(entry[4]) != (entry[0] >= 0) for entry in states)
                or any(entry[2] is not None and not entry[2] for entry in states)
                or any(list(entry[4]) != sorted(entry[4], key=lambda pair: pair[0]) for entry in states)
                or positions != sorted(positions)
                or len(complete) != positions[-1] - positions[0]
                # Without either, a partition could lose its last state, and have none to continue with.
                or not any(entry[0] == SCANNING or _is_certain(stream.nfa, entry) for entry in states)
            ):
                raise invalid_value(states, "valid computation states of a row pattern")
        return state


def _check_next_window(stream: HoppingWindow, state: Decoded) -> None:
    """Check that the next window ends after its elements, and is not separated from them by many empty windows."""
    due, ahead = state[1], state[6]
    members = [element for _, elements in state[4] for element in elements]
    if due is None:
        is_valid = not members and not ahead
    elif members:
        is_valid = all(element.end < due for element in members)
    else:
        is_valid = not ahead or min(element.end for element in ahead) < due
    if not is_valid or (due is not None and due % stream.every):
        raise invalid_value(due, "the end of the next window")


def _is_certain(nfa: RowPatternNFA, entry: Decoded) -> bool:
    """Return whether a computation state, given as data, is certain to complete."""
    step, count, remaining = entry[:3]
    steps = nfa.transitions_after(step, count).steps if remaining is None else tuple(remaining)
    return bool(steps) and nfa.is_certain_to_complete(steps)


def rule_state(graph: GraphReader, rule: EventRule, value: Decoded) -> RuleState:
    """Check the state of a rule; see `EventRule.state`."""
    nodes = [node for node, _, _ in rule.nodes]
    named_states = each(fixed(text, anything))(items(value)[2]) if len(items(value)) == 7 else []
    # A rule with the same text can be compiled to other nodes by another version of the package.
    if [type_name for type_name, _ in named_states] != [type(node).__name__ for node in nodes]:
        raise UsageError(f"{rule.name}: its nodes differ from those in the state")
    checked_states = [
        (type_name, named(type_name, _node_check(graph, node))(node_state))
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
        counts=fixed(count, optional(instant), count, count, count, count, count),
        times=fixed(instant, match_order, optional(instant)),
        nodes=lambda _: checked_states,
        arrivals=fixed(graph.numbered(*MATCH_KINDS), integers(-1, len(shapes) - 1), match_orders),
        deferred_matches=each(fixed(buffer_number, graph.match)),
        deferring_event=graph.token,
        skipped=optional(fixed(instant, each(instant, tuple))),
    )(value)
    check_arrivals(rule, state, shapes)
    return state


def _node_check(graph: GraphReader, node: Any) -> ValueCheck:
    """Return a check of the state of a node; see `NetworkNode.snapshot`."""
    if isinstance(node, JoinNode):
        return fixed(each(graph.token_key), each(_match_check(graph, node.right)))
    if isinstance(node, KleeneNode):
        return each(_match_check(graph, node.repeated))
    if isinstance(node, RepeatNode):
        return _repeat_node_check(graph, node)
    if isinstance(node, StreamNode):
        return _stream_node_check(graph, node)
    return nothing


def _match_check(graph: GraphReader, node: NetworkNode) -> ValueCheck:
    """Return a check of a reference to a match of a node."""
    shape = MatchShape(node)

    def check(value: Decoded) -> Decoded:
        match = graph.match(value)
        if not shape.fits(match):
            raise invalid_value(
                match.values, f"a match with {shape.width} values and the event of its pattern"
            )
        return match

    return check


def _repeat_node_check(graph: GraphReader, node: RepeatNode) -> ValueCheck:
    # Complete sequences are not stored.
    number = integer(1, node.times - 1)
    group_of = graph.ref("run group")

    def own_group(value: Decoded) -> Decoded:
        group = group_of(value)
        if not group_fits(node, group):
            raise invalid_value(value, "runs of this node")
        return group

    return fixed(boolean, each(number), each(own_group), each(fixed(key, each(number))))


def _stream_node_check(graph: GraphReader, node: StreamNode) -> ValueCheck:
    child = node.children[0]
    keys, values = node.spec.item((1,) * len(child.vars))
    needs_match = node.spec.result is None and not isinstance(node.stream, (Throttle, DistinctUntilChanged))
    shapes = [MatchShape(child) for child in node.children]
    stream = StreamCheck(graph, node.stream, (len(keys), len(values)), False, needs_match, shapes)

    def received(value: Decoded) -> Decoded:
        channel, element, at = _received(value)
        return channel, stream.item(element, channel), at

    def contributors(value: Decoded) -> Decoded:
        # The last element identifies an output when the operator runs again.
        if not items(value):
            raise invalid_value(value, "the elements of an output")
        return each(stream.item)(value)

    channel = integer(0, len(node.children) - 1)
    _received = fixed(channel, anything, instant)
    output = fixed(contributors, instant, instant, each(term, tuple), nothing)
    emitted = fixed(output, graph.ref("tracked match"))

    def base(value: Decoded) -> Decoded:
        return stream.operator_state(value) if items(value) else ()

    replay = fixed(base, each(received), each(emitted))
    return fixed(stream.operator_state, count, optional(replay))


def keep_rules(rules: RuleBase, graph_rules: Sequence[EventRule]) -> Dict[str, Any]:
    """Return the definitions of rules, the properties of labels, and the flags.

    Args:
        rules: the rule base of the program.
        graph_rules: rules that other data refers to. They include deleted rules with pending alarms.
    """
    active = set(rules.rules)
    definitions = [
        (
            *(rule.definition.term, rule.definition.label, rule.definition.place),
            *(dict(rule.definition.names), rule.serial, rule.name, rule in active),
        )
        for rule in graph_rules
    ]
    return {
        "rules": definitions,
        "properties": [
            label_property for properties in rules.all_properties().values() for label_property in properties
        ],
        "flags": rules.flags.changed_flags(),
        "loaded": sorted(str(path) for path in rules.files.loaded),
        "own": list(rules.files.sandbox.program_folders),
    }


def restore_rules(rules: RuleBase, kept: Dict[str, Any]) -> List[EventRule]:
    """Create and activate rules in another program; return all rules in order, including deleted ones.

    Raises:
        RetalisError: if a rule is invalid, or a flag does not exist.
    """
    # Rules are kept in the order of their serials.
    serials = [serial for _, _, _, _, serial, _, active in kept["rules"] if active]
    if serials != sorted(set(serials)):
        raise invalid_value(serials, "rules with increasing serials")
    # Flags first: they determine how rules are compiled.
    for name, value in kept["flags"].items():
        rules.flags.set(name, value)
    restored = []
    for rule_term, label, place, names, serial, name, active in kept["rules"]:
        definition = reread_rule(rule_term, label, place, names)
        rule = EventRule(rules, definition._replace(names=MappingProxyType(names)), serial, name)
        restored.append(rule)
        # Deleted rules are only created for their pending alarms.
        if active:
            rules.activate(rule)
    for label_property in kept["properties"]:
        rules.set_property(label_property)
    for folder in kept["own"]:
        rules.files.sandbox.add_program_folder(folder)
    return restored


def keep_matches(
    rules: RuleBase, knowledge: KnowledgeBase, clock: Clock, active: Sequence[EventRule]
) -> Tuple[Any, List[EventRule]]:
    """Return partial matches and recorded events, and the rules that they refer to, active ones first."""
    graph = GraphWriter(active)
    states = [_write_state(graph, rule) for rule in active]
    queries = knowledge.pending_queries
    order, waiting = queries.snapshot()
    data = {
        "states": states,
        "tracked": graph.write(rules.tracker.snapshot()),
        "alarms": [graph.write(entry) for entry in _alarms(clock, knowledge)],
        "order": order,
        "waiting": [graph.write(entry) for entry in waiting],
        "held": [graph.write(entry) for entry in knowledge.states.snapshot()],
        "rates": [graph.write(entry) for entry in knowledge.subscriptions.snapshot()],
        "timeouts": queries.timeouts.snapshot(),
        "timers": (rules.timers.snapshot(), rules.timers.omitted_count),
        "stored": rules.store.stored(),
        "counts": (rules.serial, rules.fired_before, rules.failed_retraction_count),
    }
    data["objects"] = graph.encode()
    return data, graph.rules


def _write_state(graph: GraphWriter, rule: EventRule) -> Any:
    state = rule.state()
    matches, buffer_numbers, orders = state.arrivals
    # A rule can have many partial matches, so they are columns of numbers instead of references.
    arrivals: Any = list(map(graph.number, matches)), buffer_numbers, orders
    others = graph.write(tuple(state._replace(arrivals=([], [], []))))
    return tuple(RuleState(*others)._replace(arrivals=arrivals))


def _alarms(clock: Clock, knowledge: KnowledgeBase) -> List[Tuple[Any, ...]]:
    """Return the alarms of rules and queries; timers, states and Python programs restore their own."""
    alarms: List[Tuple[Any, ...]] = []
    for due, order, alarm in sorted(clock.alarms, key=lambda entry: entry[:2]):
        if isinstance(alarm, RuleAlarm):
            alarms.append((due, order, alarm.rule, alarm.term, alarm.start, alarm.instant, alarm.token))
        elif isinstance(alarm, TimeoutAlarm) and alarm.timeouts is knowledge.pending_queries.timeouts:
            alarms.append((due, order, alarm.set_for))
    return alarms


def restore_matches(
    rules: RuleBase, knowledge: KnowledgeBase, clock: Clock, data: Any, restored: Sequence[EventRule]
) -> None:
    """Restore matches, events, alarms and queries.

    Args:
        rules: the rule base, with restored rules.
        knowledge: the knowledge base, with restored memories.
        clock: the clock of the engine.
        data: data from `keep_matches`.
        restored: rules from `restore_rules`.
    """
    # All checks come first: invalid data must not leave rules and alarms half restored.
    checked = _CheckedState(rules, knowledge, data, restored)
    for rule, state in zip(restored, checked.states):
        rule.restore(state)
    rules.tracker.restore(checked.tracked)
    queries = knowledge.pending_queries
    queries.restore(checked.order, checked.waiting)
    queries.timeouts.restore(*checked.timeouts)
    for due, order, *rest in checked.alarms:
        alarm: Any = TimeoutAlarm(queries.timeouts, *rest) if len(rest) == 1 else RuleAlarm(rules, *rest)
        clock.put_back(due, order, alarm)
    rules.timers.restore(*checked.timers)
    knowledge.states.restore(checked.held)
    knowledge.subscriptions.restore_rates(checked.rates)
    rules.store.restore(checked.stored)
    rules.serial, rules.fired_before, rules.failed_retraction_count = checked.counts


class _CheckedState:
    """State of rules, checked against the program that it belongs to.

    Args:
        rules: the rule base of the program.
        knowledge: the knowledge base of the program, with restored memories.
        data: data from `keep_matches`.
        restored: rules from `restore_rules`.

    Raises:
        UsageError: if the data does not fit the program, or cannot have been created by `keep_matches`.
    """

    def __init__(self, rules: RuleBase, knowledge: KnowledgeBase, data: Any, restored: Sequence[EventRule]):
        self._graph = graph = GraphReader(data["objects"], restored)
        active = rules.rules
        if len(items(data["states"])) != len(active):
            raise invalid_value(len(data["states"]), f"the states of {len(active)} rules")
        self.states = [rule_state(graph, rule, state) for rule, state in zip(restored, data["states"])]
        check_stored_once(restored, self.states)
        check_lineage(graph)
        event = graph.ref("event")
        self.tracked = named("tracked", fixed(each(event), count, count))(data["tracked"])
        self.alarms = each(self._alarm)(data["alarms"])
        self.order = count(data["order"])
        self.waiting = each(self._query(knowledge))(data["waiting"])
        self.held = self._held(knowledge, data["held"])
        self.rates = self._rates(knowledge, data["rates"])
        self.timeouts = fixed(each(fixed(instant, count)), each(instant))(data["timeouts"])
        timer = fixed(callable_term, term, optional(instant), instant, count)
        self.timers = fixed(each(timer), count)(data["timers"])
        self.stored = each(fixed(callable_term, instant, instant))(data["stored"])
        self.counts = fixed(count, count, count)(data["counts"])
        self._check_orders()

    def _alarm(self, value: Decoded) -> Decoded:
        graph = self._graph
        if len(items(value)) == 3:
            return fixed(instant, count, instant)(value)
        rule, token = graph.ref("rule"), optional(graph.ref("event"))
        return fixed(instant, count, rule, callable_term, instant, instant, token)(value)

    def _query(self, knowledge: KnowledgeBase) -> ValueCheck:
        pair = fixed(term, instant)

        def lagging_memory(value: Decoded) -> Decoded:
            name, until = entry = pair(value)
            memory = knowledge.memories.find(name)
            # Transforms are not part of the state, so none has reached an instant.
            if memory is None and knowledge.transforms.awaited(name) is not None:
                return entry
            # A query whose memory has already reached the time would never be run.
            if memory is None or memory.has_reached(until):
                raise invalid_value(value, "a memory that has not reached an instant")
            return entry

        awaited = each(lagging_memory)
        check = fixed(count, callable_term, term, instant, instant, awaited, self._graph.token)

        def query(value: Decoded) -> Decoded:
            entry = check(value)
            if not entry[5]:
                raise invalid_value(value, "a query that waits for a memory")
            return entry

        return query

    def _held(self, knowledge: KnowledgeBase, value: Decoded) -> List[Any]:
        token = optional(self._graph.ref("event"))
        openings = each(fixed(instant, token))
        check = fixed(
            each(fixed(key, callable_term, key, openings)),
            each(fixed(key, callable_term, instant, instant, token)),
            count,
        )
        holding = each(check)(value)
        if len(holding) != len(list(knowledge.states)):
            raise invalid_value(len(holding), "the intervals of each declared state")
        for declared, states in zip(knowledge.states, holding):
            for own_key, state, _, opened in states[0]:
                # The key is stored redundantly; a different one would make the state unreachable.
                if not opened or own_key != term_key(state) or not may_unify(declared.form.state, state):
                    raise invalid_value(state, "a declared state that has begun")
            if len({one[0] for one in states[0]}) != len(states[0]):
                raise invalid_value(len(states[0]), "distinct states")
        return holding  # type: ignore[no-any-return]

    def _rates(self, knowledge: KnowledgeBase, value: Decoded) -> List[Any]:
        subscriptions = [subscription for _, subscription in knowledge.subscriptions.items()]
        if len(items(value)) != len(subscriptions):
            raise invalid_value(len(value), f"the output rates of {len(subscriptions)} subscriptions")
        states: List[Any] = []
        for subscription, rate_state in zip(subscriptions, value):
            if subscription.rate is None:
                nothing(rate_state)
                states.append(None)
                continue
            stream = StreamCheck(
                self._graph, subscription.rate.stream, subscription.rate.widths, of_terms=True
            )
            states.append(optional(fixed(stream.operator_state, count, count))(rate_state))
        return states

    def _check_orders(self) -> None:
        """Check that alarms, timers and queries have distinct sequence numbers."""
        orders = [entry[1] for entry in self.alarms] + [entry[4] for entry in self.timers[0]]
        queries = [entry[0] for entry in self.waiting]
        if len(set(orders)) != len(orders):
            raise invalid_value(orders, "alarms with distinct sequence numbers")
        if queries != sorted(set(queries)) or any(entry >= self.order for entry in queries):
            raise invalid_value(queries, "queries with increasing sequence numbers")
