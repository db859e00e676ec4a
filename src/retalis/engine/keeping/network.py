"""Event rules with what waits in them, what is kept of past events, and the alarms that are set."""

from types import MappingProxyType
from typing import Any, Dict, List, Sequence, Tuple

from ...events.knowledge import Knowledge, TimeoutAlarm
from ...events.network import Rule, RuleState
from ...events.rules import RuleAlarm, Rules
from ..runtime import Clock
from .graph import GraphReader, GraphWriter


def keep_rules(rules: Rules, graph_rules: Sequence[Rule]) -> Dict[str, Any]:
    """Return what rules say, the properties of labels, and the flags.

    Args:
        rules: the program's.
        graph_rules: those that are named, which may be more than take events: what was deleted may have an alarm set.
    """
    active = set(rules.rules)
    said = [
        (rule.definition._replace(names=dict(rule.definition.names)), rule.serial, rule.name, rule in active)
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
    """Have the rules of another program take events; return all that are named, in order."""
    for name, value in kept["flags"].items():
        rules.flags.set(name, value)
    made = []
    for definition, serial, name, active in kept["rules"]:
        names = MappingProxyType(definition.names)
        rule = Rule(rules, definition._replace(names=names), serial, name)
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
    for instant, order, alarm in sorted(clock.alarms, key=lambda one: one[:2]):
        if isinstance(alarm, RuleAlarm):
            found.append((instant, order, alarm.rule, alarm.term, alarm.start, alarm.instant, alarm.token))
        elif isinstance(alarm, TimeoutAlarm) and alarm.timeouts is knowledge.waiting.timeouts:
            found.append((instant, order, alarm.set_for))
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
    graph = GraphReader(data["rows"], named)
    for rule, state in zip(named, data["states"]):
        rule.restore(RuleState(*graph.read(state)))
    rules.tracker.restore(graph.read(data["tracked"]))
    queries = knowledge.waiting
    queries.restore(data["order"], [graph.read(one) for one in data["waiting"]])
    queries.timeouts.restore(*data["timeouts"])
    for one in data["alarms"]:
        instant, order, *rest = graph.read(one)
        alarm: Any = TimeoutAlarm(queries.timeouts, *rest) if len(rest) == 1 else RuleAlarm(rules, *rest)
        clock.put_back(instant, order, alarm)
    rules.timers.restore(*data["timers"])
    knowledge.states.restore([graph.read(one) for one in data["held"]])
    knowledge.subscriptions.restore_rates([graph.read(one) for one in data["rates"]])
    rules.store.restore(data["stored"])
    rules.serial, rules.fired_before, rules.revs_of_nothing = data["counts"]
