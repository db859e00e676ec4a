"""Checks of what nodes of rules and shapes of subscriptions know, against the program that they belong to.

Event rules with what waits in them, what is kept of past events, and the alarms that are set.
"""

from types import MappingProxyType
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

from ..engine.runtime.clock import Clock
from ..events.knowledge.knowledge_base import KnowledgeBase
from ..events.knowledge.timeouts import TimeoutAlarm
from ..events.matches.partial_matches import PartialMatch
from ..events.matches.run_groups import Run
from ..events.network.event_rule import EventRule, RuleState
from ..events.network.join_node import JoinNode
from ..events.network.kleene_node import KleeneNode
from ..events.network.pattern_nodes import NotNode
from ..events.network.repeat_node import RepeatNode
from ..events.network.stream_node import StreamNode
from ..events.program.event_file_checker import reread_rule
from ..events.rules.rule_base import RuleBase
from ..events.rules.timer_service import RuleAlarm
from ..events.streams.absence_timeout import AbsenceTimeout
from ..events.streams.rate_operators import Debounce, DistinctUntilChanged, Throttle
from ..events.streams.row_pattern import RowPatternWindow
from ..events.streams.stream_elements import StreamElement, StreamOperator
from ..events.streams.windows import AnchoredTumblingWindow, HoppingWindow
from ..foundation.errors import UsageError
from ..prolog.terms.term_traversal import term_key
from ..prolog.terms.unification import may_unify
from .match_graph import GraphReader, GraphWriter
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
    items,
    key,
    named,
    nothing,
    optional,
    record,
    term,
    text,
    wrong,
)
from .schema import named as named_check

_NEVER = -(1 << 63)


class StreamCheck:
    """Checks what an operator on a stream knows.

    Args:
        graph: has the items.
        stream: an operator that was made for the same part of a program.
        widths: how many values an item has by which it is grouped, and how many that are looked at.
        of_terms: whether items are made of terms (those of a subscription), not of matches.
        needs: whether each item has a match.
    """

    def __init__(
        self,
        graph: GraphReader,
        stream: StreamOperator,
        widths: Tuple[int, int],
        of_terms: bool = False,
        needs: bool = False,
    ):
        self._refer = graph.ref("item")
        self._stream = stream
        self._widths = widths
        self._of_terms = of_terms
        self._needs = needs
        make: Callable[[], Sequence[Any]] = getattr(stream, "make", lambda: ())
        scopes = getattr(stream, "scopes", None)
        self._checks = [one.check for one in make() if one.picky] if scopes is None else []

    def item(self, value: Decoded) -> StreamElement:
        """Check an item."""
        item: StreamElement = self._refer(value)
        by, values = self._widths
        if len(item.by) != by or len(item.values) != values:
            raise wrong((item.by, item.values), f"an item with {by} and {values} values")
        of_match = isinstance(item.match, PartialMatch)
        if item.match is None:
            right = not self._needs
        else:
            right = not of_match if self._of_terms else of_match
        if not right or item.start > item.end:
            raise wrong(item.match, "an item of another kind")
        if not self._of_terms and any(one is None for one in item.values):
            raise wrong(item.values, "values")
        for check in self._checks:
            check(item)
        item.file()
        return item

    def _once(self, found: Sequence[StreamElement], order: int) -> None:
        """Check that items are there once each, with orders of their own."""
        orders = {item.order for item in found}
        if len(orders) != len(found) or not all(1 <= one <= order for one in orders):
            raise wrong(sorted(item.order for item in found), "items with orders of their own")

    def known(self, value: Decoded) -> Decoded:
        """Check all that the operator knows; see `StreamOperator.kept`."""
        stream = self._stream
        one = each(self.item)
        if isinstance(stream, RowPatternWindow):
            return self._stepped(stream, value)
        if isinstance(stream, Throttle):
            return fixed(instant, one)(value)
        if isinstance(stream, DistinctUntilChanged):
            found = fixed(each(instant), one)(value)
            if len(found[0]) != len(found[1]):
                raise wrong(len(found[0]), f"{len(found[1])} instants")
            return found
        if isinstance(stream, Debounce):
            found = fixed(count, instant, one)(value)
            self._once(found[2], found[0])
            return found
        if isinstance(stream, AbsenceTimeout):
            found = fixed(count, instant, one, one)(value)
            self._once([*found[2], *found[3]], found[0])
            return found
        further: List[ValueCheck] = (
            [instant] if isinstance(stream, (AnchoredTumblingWindow, HoppingWindow)) else []
        )
        ahead: List[ValueCheck] = [one] if isinstance(stream, HoppingWindow) else []
        group = fixed(instant, one)
        found = fixed(instant, optional(instant), count, count, each(group), *further, *ahead)(value)
        self._groups([members for _, members in found[4]], sum((list(f) for f in found[6:]), []), found[3])
        return found

    def _groups(self, groups: List[List[StreamElement]], ahead: List[StreamElement], order: int) -> None:
        self._once([item for members in groups for item in members] + ahead, order)
        keys = [{item.key for item in members} for members in groups]
        if any(len(one) != 1 for one in keys) or len(set().union(*keys)) != len(keys):
            raise wrong(len(keys), "groups of items with the same values, and one of them each")

    def _stepped(self, stream: RowPatternWindow, value: Decoded) -> Decoded:
        step = integer(0, len(stream.plan.steps) - 1)
        steps = each(step, tuple)
        pairs = each(fixed(count, step), tuple)
        way = fixed(
            integer(-1, len(stream.plan.steps) - 1),
            count,
            optional(steps),
            each(optional(count), tuple),
            pairs,
            count,
        )
        group = fixed(instant, each(self.item), each(way, tuple), each(pairs, tuple))
        found = fixed(count, count, instant, each(group))(value)
        self._groups([one[1] for one in found[3]], [], found[1])
        for _, members, ways, whole in found[3]:
            known = [item.order for item in members]
            named_ones = [order for one in ways for order in one[3] if order is not None]
            taken = [order for one in ways for order, _ in one[4]] + [
                order for one in whole for order, _ in one
            ]
            after = [one[5] for one in ways]
            if (
                not ways
                or not all(whole)
                or known != sorted(known)
                or not {*named_ones, *taken} <= set(known)
                or any(len(one[3]) != len(stream.plan.marks) for one in ways)
                or any(bool(one[4]) != (one[0] >= 0) for one in ways)
                or any(one[2] is not None and not one[2] for one in ways)
                or any(list(one[4]) != sorted(one[4], key=lambda pair: pair[0]) for one in ways)
                or after != sorted(after)
                or len(whole) != after[-1] - after[0]
            ):
                raise wrong(ways, "ways through the steps")
        return found


def rule_state(graph: GraphReader, rule: EventRule, value: Decoded) -> RuleState:
    """Check what a rule knows; see `EventRule.state`."""
    nodes = [node for node, _, _ in rule.nodes]
    kinds = each(fixed(text, anything))(items(value)[2]) if len(items(value)) == 7 else []
    if [kind for kind, _ in kinds] != [type(node).__name__ for node in nodes]:
        raise UsageError(f"{rule.name}: it is made of other parts than it was")
    known = [(kind, named(kind, _node_check(graph, node))(kept)) for node, (kind, kept) in zip(nodes, kinds)]
    found = [(node, width) for node, (_, kept) in zip(nodes, known) for width in _widths(node, kept)]
    owners, widths = [node for node, _ in found], [width for _, width in found]
    place = integer(0, len(widths) - 1)
    state: RuleState = record(
        RuleState,
        counts=fixed(count, optional(instant), count, count, count, count, count),
        times=fixed(instant, count, optional(instant)),
        nodes=lambda _: known,
        arrivals=each(fixed(graph.match, integer(-1, len(widths) - 1), count)),
        later=each(fixed(place, graph.match)),
        later_event=graph.token,
        skipped=optional(fixed(instant, each(instant, tuple))),
    )(value)
    _check_waiting(rule, state, owners, widths)
    return state


def _check_waiting(
    rule: EventRule, state: RuleState, owners: List[Any], widths: List[Tuple[type, Optional[int]]]
) -> None:
    """Check that what waits fits the buffers where it waits."""
    orders = [order for _, _, order in state.arrivals]
    if len({id(match) for match, _, _ in state.arrivals}) != len(orders) or len(set(orders)) != len(orders):
        raise UsageError(f"{rule.name}: something waits twice")
    if any(order > state.times[1] for order in orders):
        raise UsageError(f"{rule.name}: something waits that has not come")
    waiting = [(match, place) for match, place, _ in state.arrivals]
    for match, place in (*waiting, *((match, place) for place, match in state.later)):
        if place < 0:
            if match.buffer is None:
                raise UsageError(f"{rule.name}: a sequence waits that goes on nowhere")
            continue
        kind, width = widths[place]
        if (
            match.__class__ is not kind
            or (width is not None and min(len(match.filed_by), len(match.values)) < width)
            or match.start > match.end
            or (kind is Run and not _is_run_of(owners[place], match))
        ):
            raise wrong(match.values, f"{rule.name}: a match with {width} values at least")


def _is_run_of(node: KleeneNode, run: Any) -> bool:
    """Tell whether a run has what a node of repetitions or of an aggregate gives one."""
    return (
        (run.fixed is None or len(run.fixed) == len(node.fixed))
        and len(run.open) == len(node.open_vars)
        and len(run.taken) == len(run.steps)
        and run.sound <= len(run.taken)
        and (run.state is None if node.collector is None else node.collector.is_state(run.state))
    )


def _widths(node: Any, kept: Any) -> List[Tuple[type, Optional[int]]]:
    """Return of each buffer of a node of which class what waits there is, and how many values it has."""
    number = node.number_of_buffers(kept) if isinstance(node, RepeatNode) else len(node.buffers())
    found: List[Tuple[type, Optional[int]]] = [(PartialMatch, None)] * number
    if isinstance(node, JoinNode):
        known = [node.left, node.right, *node.negated]
    elif isinstance(node, KleeneNode):
        known = [node.first, node.repeated]
    elif isinstance(node, NotNode):
        known = [node.negated]
    else:
        known = []
    carried = any(absence.carried for absence in getattr(node, "absences", ()))
    for at, below in enumerate(known[: 2 if carried else None]):
        kind = Run if isinstance(node, KleeneNode) and not at else PartialMatch
        found[at] = (kind, len(below.vars))
    return found


def _node_check(graph: GraphReader, node: Any) -> ValueCheck:
    """Return a check of what a node itself knows; see `NetworkNode.kept`."""
    if isinstance(node, JoinNode):
        return fixed(each(graph.token_key), each(graph.match))
    if isinstance(node, KleeneNode):
        return each(graph.match)
    if isinstance(node, RepeatNode):
        return _repeating(graph, node)
    if isinstance(node, StreamNode):
        return _streaming(graph, node)
    return nothing


def _repeating(graph: GraphReader, node: RepeatNode) -> ValueCheck:
    number = integer(1, node.times)
    train = graph.ref("train")

    def own(value: Decoded) -> Decoded:
        found = train(value)
        tokens = [token for token in found.tokens if token is not None and token.buffer is found]
        if found.node is not node or len(found.tokens) >= node.times:
            raise wrong(value, "sequences of this node")
        if not tokens or any(len(token.values) != len(node.child.vars) for token in tokens):
            raise wrong(value, "sequences with values")
        return found

    return fixed(boolean, each(number), each(own), each(fixed(key, each(number))))


def _streaming(graph: GraphReader, node: StreamNode) -> ValueCheck:
    child = node.children[0]
    by, values = node.making.item((1,) * len(child.vars))
    needs = node.making.result is None and not isinstance(node.stream, (Throttle, DistinctUntilChanged))
    stream = StreamCheck(graph, node.stream, (len(by), len(values)), False, needs)
    channel = integer(0, len(node.children) - 1)
    taken = fixed(channel, stream.item, instant)
    output = fixed(each(stream.item), instant, instant, each(term, tuple), nothing)
    given = fixed(lambda value: output(value) if items(value) else None, graph.ref("held"))

    def base(value: Decoded) -> Decoded:
        return stream.known(value) if items(value) else ()

    replay = fixed(base, each(taken), each(given))
    return fixed(stream.known, count, optional(replay))


def keep_rules(rules: RuleBase, graph_rules: Sequence[EventRule]) -> Dict[str, Any]:
    """Return what rules say, the properties of labels, and the flags.

    Args:
        rules: the program's.
        graph_rules: those that are named, which may be more than take events: what was deleted may have an alarm set.
    """
    active = set(rules.rules)
    said = [
        (
            *(rule.definition.term, rule.definition.label, rule.definition.place),
            *(dict(rule.definition.names), rule.serial, rule.name, rule in active),
        )
        for rule in graph_rules
    ]
    return {
        "rules": said,
        "properties": [one for found in rules.all_properties().values() for one in found],
        "flags": rules.flags.changed(),
        "loaded": sorted(str(path) for path in rules.files.loaded),
        "own": list(rules.files.door.own),
    }


def restore_rules(rules: RuleBase, kept: Dict[str, Any]) -> List[EventRule]:
    """Have the rules of another program take events; return all that are named, in order.

    Raises:
        RetalisError: for a rule that cannot fire, or a flag that does not exist.
    """
    serials = [serial for _, _, _, _, serial, _, active in kept["rules"] if active]
    if serials != sorted(set(serials)):
        raise wrong(serials, "rules in their order")
    for name, value in kept["flags"].items():
        rules.flags.set(name, value)
    made = []
    for rule_term, label, place, names, serial, name, active in kept["rules"]:
        definition = reread_rule(rule_term, label, place, names)
        rule = EventRule(rules, definition._replace(names=MappingProxyType(names)), serial, name)
        made.append(rule)
        if active:
            rules.activate(rule)
    for one in kept["properties"]:
        rules.set_property(one)
    for folder in kept["own"]:
        rules.files.door.add_own(folder)
    return made


def keep_matches(
    rules: RuleBase, knowledge: KnowledgeBase, clock: Clock, active: Sequence[EventRule]
) -> Tuple[Any, List[EventRule]]:
    """Return what waits and is remembered as rows, and the rules that it names: those that take events come first."""
    graph = GraphWriter(active)
    states = [graph.write(tuple(rule.state())) for rule in active]
    queries = knowledge.waiting
    order, waiting = queries.kept()
    data = {
        "states": states,
        "tracked": graph.write(rules.tracker.kept()),
        "alarms": [graph.write(one) for one in _alarms(clock, knowledge)],
        "order": order,
        "waiting": [graph.write(one) for one in waiting],
        "held": [graph.write(one) for one in knowledge.states.kept()],
        "rates": [graph.write(one) for one in knowledge.subscriptions.kept()],
        "timeouts": queries.timeouts.kept(),
        "timers": (rules.timers.kept(), rules.timers.left_out),
        "stored": rules.store.stored(),
        "counts": (rules.serial, rules.fired_before, rules.revs_of_nothing),
    }
    data["rows"] = graph.rows
    return data, graph.rules


def _alarms(clock: Clock, knowledge: KnowledgeBase) -> List[Tuple[Any, ...]]:
    """Return the alarms of rules and queries; timers and states have their own set, and so do programs in Python."""
    found: List[Tuple[Any, ...]] = []
    for due, order, alarm in sorted(clock.alarms, key=lambda one: one[:2]):
        if isinstance(alarm, RuleAlarm):
            found.append((due, order, alarm.rule, alarm.term, alarm.start, alarm.instant, alarm.token))
        elif isinstance(alarm, TimeoutAlarm) and alarm.timeouts is knowledge.waiting.timeouts:
            found.append((due, order, alarm.set_for))
    return found


def restore_matches(
    rules: RuleBase, knowledge: KnowledgeBase, clock: Clock, data: Any, named: Sequence[EventRule]
) -> None:
    """Have matches, events, alarms and queries wait as they did.

    Args:
        rules: the program's, which have been put there.
        knowledge: the program's, with its memories.
        clock: of the engine.
        data: from `keep_matches`.
        named: from `restore_rules`.
    """
    checked = _Checked(rules, knowledge, data, named)
    for rule, state in zip(named, checked.states):
        rule.restore(state)
    rules.tracker.restore(checked.tracked)
    queries = knowledge.waiting
    queries.restore(checked.order, checked.waiting)
    queries.timeouts.restore(*checked.timeouts)
    for due, order, *rest in checked.alarms:
        alarm: Any = TimeoutAlarm(queries.timeouts, *rest) if len(rest) == 1 else RuleAlarm(rules, *rest)
        clock.put_back(due, order, alarm)
    rules.timers.restore(*checked.timers)
    knowledge.states.restore(checked.held)
    knowledge.subscriptions.restore_rates(checked.rates)
    rules.store.restore(checked.stored)
    rules.serial, rules.fired_before, rules.revs_of_nothing = checked.counts


class _Checked:
    """Partial matches and other state of rules, checked against the program that they belong to.

    Args:
        rules: the program's.
        knowledge: the program's, with its memories.
        data: from `keep_matches`.
        named: from `restore_rules`.

    Raises:
        UsageError: for what does not fit the program, or is none of what `keep_matches` returns.
    """

    def __init__(self, rules: RuleBase, knowledge: KnowledgeBase, data: Any, named: Sequence[EventRule]):
        self._graph = graph = GraphReader(data["rows"], named)
        active = rules.rules
        if len(items(data["states"])) != len(active):
            raise wrong(len(data["states"]), f"the states of {len(active)} rules")
        self.states = [rule_state(graph, rule, state) for rule, state in zip(named, data["states"])]
        event = graph.ref("event")
        self.tracked = named_check("tracked", fixed(each(event), count, count))(data["tracked"])
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

        def behind(value: Decoded) -> Decoded:
            name, until = found = pair(value)
            memory = knowledge.memories.find(name)
            if memory is None or memory.has(until):
                raise wrong(value, "a memory that has not reached an instant")
            return found

        awaited = each(behind)
        check = fixed(count, callable_term, term, instant, instant, awaited, self._graph.token)

        def query(value: Decoded) -> Decoded:
            found = check(value)
            if not found[5]:
                raise wrong(value, "a query that waits for a memory")
            return found

        return query

    def _held(self, knowledge: KnowledgeBase, value: Decoded) -> List[Any]:
        token = optional(self._graph.ref("event"))
        openings = each(fixed(instant, token))
        check = fixed(
            each(fixed(key, callable_term, key, openings)),
            each(fixed(key, callable_term, instant, instant, token)),
            count,
        )
        found = each(check)(value)
        if len(found) != len(list(knowledge.states)):
            raise wrong(len(found), "what holds of each state that is declared")
        for declared, states in zip(knowledge.states, found):
            for own, state, _, opened in states[0]:
                if not opened or own != term_key(state) or not may_unify(declared.form.state, state):
                    raise wrong(state, "a state that is declared and has begun")
            if len({one[0] for one in states[0]}) != len(states[0]):
                raise wrong(len(states[0]), "states that hold once each")
        return found  # type: ignore[no-any-return]

    def _rates(self, knowledge: KnowledgeBase, value: Decoded) -> List[Any]:
        subscriptions = [one for _, one in knowledge.subscriptions.items()]
        if len(items(value)) != len(subscriptions):
            raise wrong(len(value), f"the shapes of {len(subscriptions)} subscriptions")
        made: List[Any] = []
        for one, known in zip(subscriptions, value):
            if one.rate is None:
                nothing(known)
                made.append(None)
                continue
            stream = StreamCheck(self._graph, one.rate.stream, one.rate.widths, of_terms=True)
            made.append(optional(fixed(stream.known, count, count))(known))
        return made

    def _check_orders(self) -> None:
        """Check that alarms, timers and queries have orders of their own."""
        orders = [one[1] for one in self.alarms] + [one[4] for one in self.timers[0]]
        queries = [one[0] for one in self.waiting]
        if len(set(orders)) != len(orders):
            raise wrong(orders, "alarms with orders of their own")
        if queries != sorted(set(queries)) or any(one >= self.order for one in queries):
            raise wrong(queries, "queries in their order")
