"""Event rules with what waits in them, what is kept of past events, and the alarms that are set."""

from types import MappingProxyType
from typing import Any, Dict, List, Sequence, Tuple

from ...events.knowledge import Knowledge, TimeoutAlarm
from ...events.network import Rule
from ...events.program import reread_rule
from ...events.rules import RuleAlarm, Rules
from ...prolog.terms import may_unify, term_key
from ..runtime import Clock
from .graph import GraphReader, GraphWriter
from .nodes import StreamCheck, rule_state
from .schema import (
    Decoded,
    ValueCheck,
    callable_term,
    count,
    each,
    fixed,
    instant,
    items,
    key,
    nothing,
    optional,
    term,
    wrong,
)
from .schema import named as named_check


def keep_rules(rules: Rules, graph_rules: Sequence[Rule]) -> Dict[str, Any]:
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


def restore_rules(rules: Rules, kept: Dict[str, Any]) -> List[Rule]:
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
        rule = Rule(rules, definition._replace(names=MappingProxyType(names)), serial, name)
        made.append(rule)
        if active:
            rules.activate(rule)
    for one in kept["properties"]:
        rules.set_property(one)
    for folder in kept["own"]:
        rules.files.door.add_own(folder)
    return made


def keep_matches(
    rules: Rules, knowledge: Knowledge, clock: Clock, active: Sequence[Rule]
) -> Tuple[Any, List[Rule]]:
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


def _alarms(clock: Clock, knowledge: Knowledge) -> List[Tuple[Any, ...]]:
    """Return the alarms of rules and queries; timers and states have their own set, and so do programs in Python."""
    found: List[Tuple[Any, ...]] = []
    for due, order, alarm in sorted(clock.alarms, key=lambda one: one[:2]):
        if isinstance(alarm, RuleAlarm):
            found.append((due, order, alarm.rule, alarm.term, alarm.start, alarm.instant, alarm.token))
        elif isinstance(alarm, TimeoutAlarm) and alarm.timeouts is knowledge.waiting.timeouts:
            found.append((due, order, alarm.set_for))
    return found


def restore_matches(
    rules: Rules, knowledge: Knowledge, clock: Clock, data: Any, named: Sequence[Rule]
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

    def __init__(self, rules: Rules, knowledge: Knowledge, data: Any, named: Sequence[Rule]):
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

    def _query(self, knowledge: Knowledge) -> ValueCheck:
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

    def _held(self, knowledge: Knowledge, value: Decoded) -> List[Any]:
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

    def _rates(self, knowledge: Knowledge, value: Decoded) -> List[Any]:
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
