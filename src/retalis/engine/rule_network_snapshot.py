"""Rules and their state in a snapshot: partial matches, tracked events, alarms, pending queries, and timers.

Each rule, node, operator and registry declares its own state; `NetworkState` names those that a snapshot has, in the
order in which they are restored. The objects that they refer to are written by `object_graph`; rules and their nodes
are external to it, and named by their numbers.
"""

from types import MappingProxyType
from typing import Dict, List, NamedTuple, Optional, Sequence, Tuple

from ..events.knowledge.knowledge_base import KnowledgeBase
from ..events.knowledge.timeout_queue import TIMEOUT_ALARMS, StoredTimeoutAlarm, TimeoutAlarm, Timeouts
from ..events.language.rule_labels import Property
from ..events.matches.match_types import NO_REPETITIONS, RepetitionChain
from ..events.network.event_rule import EventRule
from ..events.network.lineage_tracker import LineageCut
from ..events.network.node_timers import RULE_ALARMS, RuleAlarm, StoredRuleAlarm
from ..events.network.pattern_nodes import NetworkNode
from ..events.program.event_file_parser import reread_rule
from ..events.rules.rule_base import RuleBase
from ..foundation.source_places import Place
from ..prolog.system.prolog_snapshot import PLACE
from ..prolog.terms.types import Atom, Term, Var
from ..serialization.object_graph import ExternalKey, ExternalObjects, ObjectReader, ObjectWriter
from ..serialization.state_fields import (
    StateFields,
    StateOwner,
    constraint,
    field,
    part,
    part_list,
    record_of,
    rows_of,
)
from ..serialization.stored_field_types import (
    ANYTHING,
    BOOLEAN,
    CALLABLE_TERM,
    COUNT,
    PATH,
    TERM,
    TEXT,
    VARIABLE,
    FieldType,
    ReadContext,
    State,
    ValueCheck,
    invalid_value,
    mapping_of,
    optional,
    sequence_of,
    with_path,
)

# ---- definitions of rules ----------------------------------------------------------------------------


class StoredRule(NamedTuple):
    """Definition of a rule.

    Attributes:
        label: its label, or None.
        place: its place in a file, or None.
        names: names of its variables.
        serial: its position among all rules.
        is_active: whether it is active; a deleted one is stored for its pending alarms.
    """

    term: Term
    label: Optional[Term]
    place: Optional[Place]
    names: Dict[Var, str]
    serial: int
    is_active: bool


class StoredRules(NamedTuple):
    """Rules of a program, the properties of labels, and the flags.

    Attributes:
        definitions: the rules: active ones in the order of their serials, then deleted ones.
        flags: flags that have been changed, by name.
        loaded_files: paths of the event files that were loaded.
        program_folders: folders from which the program may load files.
    """

    definitions: List[StoredRule]
    properties: List[Property]
    flags: Dict[str, Term]
    loaded_files: List[str]
    program_folders: List[str]


_PROPERTY_FIELDS = record_of(
    Property,
    label=TERM,
    name=TEXT,
    value=TERM,
)


def _property_checker(context: ReadContext) -> ValueCheck[Property]:
    check_fields = _PROPERTY_FIELDS.checker(context)

    def check(value: object) -> Property:
        label_property = check_fields(value)
        if not isinstance(label_property.label, Atom) or label_property.error_text is not None:
            raise invalid_value(value, label_property.error_text or "a property of a label")
        return label_property

    return check


PROPERTIES = sequence_of(FieldType("a property of a label", _property_checker, _PROPERTY_FIELDS.encoder))

RULES = record_of(
    StoredRules,
    definitions=rows_of(
        StoredRule,
        term=CALLABLE_TERM,
        label=optional(TERM),
        place=optional(PLACE),
        names=mapping_of(VARIABLE, TEXT),
        serial=COUNT,
        is_active=BOOLEAN,
    ),
    properties=PROPERTIES,
    flags=mapping_of(TEXT, TERM),
    loaded_files=sequence_of(PATH),
    program_folders=sequence_of(PATH),
)


def stored_rules(rules: RuleBase, referenced_rules: Sequence[EventRule]) -> StoredRules:
    """Return the definitions of rules, the properties of labels, and the flags.

    Args:
        rules: the rule base of the program.
        referenced_rules: rules that other data refers to. They include deleted rules with pending alarms.
    """
    active_rules = set(rules.rules)
    return StoredRules(
        [
            StoredRule(
                rule.definition.term,
                rule.definition.label,
                rule.definition.place,
                dict(rule.definition.names),
                rule.serial,
                rule in active_rules,
            )
            for rule in referenced_rules
        ],
        [label_property for properties in rules.all_properties().values() for label_property in properties],
        rules.flags.changed_flags(),
        sorted(str(path) for path in rules.files.loaded),
        list(rules.files.sandbox.program_folders),
    )


def restore_rules(rules: RuleBase, saved: StoredRules) -> List[EventRule]:
    """Create rules in another program, and activate them.

    Args:
        rules: the rule base of the other program.
        saved: a result of `stored_rules`.

    Returns:
        All rules: active ones in the order of their serials, then deleted ones.

    Raises:
        RetalisError: if a rule is invalid, or a flag does not exist.
    """
    serials = [rule.serial for rule in saved.definitions if rule.is_active]
    if serials != sorted(set(serials)):
        raise invalid_value(serials, "rules with increasing serials")
    # Flags first: they determine how rules are compiled.
    for name, value in saved.flags.items():
        rules.flags.set(name, value)
    restored_rules = []
    for term, label, place, names, serial, is_active in saved.definitions:
        definition = reread_rule(term, label, place, names)
        rule = EventRule(rules.network, definition._replace(names=MappingProxyType(names)), serial)
        restored_rules.append(rule)
        # Deleted rules are only created for their pending alarms.
        if is_active:
            rules.activate(rule)
    for label_property in saved.properties:
        rules.set_property(label_property)
    for folder in saved.program_folders:
        rules.files.sandbox.add_program_folder(folder)
    return restored_rules


# ---- state of rules ----------------------------------------------------------------------------------


class _RulesAndNodes(ExternalObjects):
    """Rules, their nodes, and `NO_REPETITIONS`, by numbers.

    Args:
        rules: rules with known numbers. Deleted rules that are still referred to are added after them.
    """

    def __init__(self, rules: Sequence[EventRule]):
        self.rules: List[EventRule] = []
        self._rule_numbers: Dict[int, int] = {}
        self._node_keys: Dict[int, ExternalKey] = {}
        for rule in rules:
            self._number_of(rule)

    def _number_of(self, rule: EventRule) -> int:
        number = self._rule_numbers.get(id(rule))
        if number is None:
            number = self._rule_numbers[id(rule)] = len(self.rules)
            self.rules.append(rule)
            for node_number, node in enumerate(rule.nodes):
                self._node_keys[id(node)] = number, node_number
        return number

    def may_contain(self, item_class: type) -> bool:
        """See `ExternalObjects.may_contain`."""
        return issubclass(item_class, (EventRule, NetworkNode, RepetitionChain))

    def kind_of(self, item: object) -> Optional[str]:
        """See `ExternalObjects.kind_of`."""
        if isinstance(item, EventRule):
            return "rule"
        if isinstance(item, NetworkNode):
            return "node"
        return "no repetitions" if item is NO_REPETITIONS else None

    def key_of(self, item: object) -> ExternalKey:
        """See `ExternalObjects.key_of`."""
        if isinstance(item, EventRule):
            # Numbers are assigned here, because those of deleted rules are not known before.
            return (self._number_of(item),)
        if isinstance(item, NetworkNode):
            if id(item) not in self._node_keys:
                self._number_of(item.rule)
            return self._node_keys[id(item)]
        return ()

    def find(self, kind: str, key: ExternalKey) -> object:
        """See `ExternalObjects.find`."""
        if kind == "no repetitions" and not key:
            return NO_REPETITIONS
        if kind == "rule" and len(key) == 1 and key[0] < len(self.rules):
            return self.rules[key[0]]
        if kind == "node" and len(key) == 2 and key[0] < len(self.rules):
            nodes = self.rules[key[0]].nodes
            if key[1] < len(nodes):
                return nodes[key[1]]
        raise invalid_value(key, f"numbers of an object of kind {kind}")


class NetworkState(StateOwner):
    """State of the rules and of all that belongs to the processing of events, besides memories."""

    STATE = StateFields(
        part_list(
            "rule_states",
            "active_rules",
            "expected the state of each rule",
            title=lambda rule: f"rule {rule.name}",
        ),
        part("tracker"),
        part("pending_queries"),
        part_list("declared_states", "state_declarations", "expected the intervals of each declared state"),
        field("rule_alarms", RULE_ALARMS),
        field("timeout_alarms", TIMEOUT_ALARMS),
        part("timers"),
        part_list(
            "rate_limiters", "rate_limiters", "expected the output rate of each subscription that has one"
        ),
        part("event_log"),
        part("rules"),
        # A match has links for one buffer only.
        constraint("partial matches that are stored once", lambda network, state: _are_stored_once(state)),
        constraint(
            "alarms with distinct orders and existing owners",
            lambda network, state: network.can_set_alarms(state),
        ),
    )

    def __init__(self, rules: RuleBase, knowledge: KnowledgeBase):
        self.rules = rules
        self._clock = rules.clock
        self.active_rules = rules.rules
        self.tracker = rules.network.tracker
        self.timers = rules.timers
        self.event_log = rules.event_log
        self.pending_queries = knowledge.pending_queries
        self.state_declarations = list(knowledge.states)
        self.rate_limiters = knowledge.subscriptions.rate_limiters()

    # Alarms of the same instant are called in the order in which they were set. Those of timers are stored with the
    # timers. Nodes have one alarm, which comes before all others; it is set again from their deadlines.

    @property
    def rule_alarms(self) -> List[StoredRuleAlarm]:
        """The alarms of rules."""
        return [
            StoredRuleAlarm(due_at, order, alarm.rule, alarm.term, alarm.start, alarm.instant, alarm.token)
            for due_at, order, alarm in sorted(self._clock.alarms, key=lambda entry: entry[:2])
            if isinstance(alarm, RuleAlarm)
        ]

    @rule_alarms.setter
    def rule_alarms(self, alarms: Sequence[StoredRuleAlarm]) -> None:
        for due_at, order, rule, term, start, instant, token in alarms:
            self._clock.put_back(due_at, order, RuleAlarm(rule, term, start, instant, token))

    @property
    def timeout_alarms(self) -> List[StoredTimeoutAlarm]:
        """The alarms of pending queries and declared states; those of deleted declarations have no effect."""
        numbers = {id(timeouts): number for number, timeouts in enumerate(self._all_timeouts())}
        return [
            StoredTimeoutAlarm(due_at, order, numbers[id(alarm.timeouts)], alarm.alarm_instant)
            for due_at, order, alarm in sorted(self._clock.alarms, key=lambda entry: entry[:2])
            if isinstance(alarm, TimeoutAlarm) and id(alarm.timeouts) in numbers
        ]

    @timeout_alarms.setter
    def timeout_alarms(self, alarms: Sequence[StoredTimeoutAlarm]) -> None:
        all_timeouts = self._all_timeouts()
        for due_at, order, owner_number, alarm_instant in alarms:
            self._clock.put_back(due_at, order, TimeoutAlarm(all_timeouts[owner_number], alarm_instant))

    def _all_timeouts(self) -> List[Timeouts]:
        """Return the deadlines of pending queries, then those of each declared state."""
        return [self.pending_queries.timeouts, *(declared.timeouts for declared in self.state_declarations)]

    def can_set_alarms(self, state: State) -> bool:
        """Return whether the alarms and timers of a state have distinct orders, and owners."""
        alarms = [*state["rule_alarms"], *state["timeout_alarms"], *state["timers"]["stored_timers"]]
        owner_numbers = [alarm.owner_number for alarm in state["timeout_alarms"]]
        return len({alarm.order for alarm in alarms}) == len(alarms) and all(
            number < len(self._all_timeouts()) for number in owner_numbers
        )


def _are_stored_once(state: State) -> bool:
    stored = [
        id(match)
        for rule_state in state["rule_states"]
        for match in (
            *rule_state["stored_arrivals"].matches,
            *(deferred.match for deferred in rule_state["stored_deferred_matches"]),
        )
    ]
    return len(set(stored)) == len(stored)


class StoredNetwork(NamedTuple):
    """Stored form of a `NetworkState`.

    Attributes:
        objects: the objects that the state refers to, encoded.
        state: the state, encoded.
    """

    objects: object
    state: object


NETWORK = record_of(
    StoredNetwork,
    objects=ANYTHING,
    state=ANYTHING,
)


def snapshot_matches(
    network: NetworkState, max_explained_events: Optional[int] = None
) -> Tuple[StoredNetwork, List[EventRule]]:
    """Return the state of the rules as data.

    Args:
        network: the rules, knowledge and clock.
        max_explained_events: maximum number of recorded events whose lineage is included if it only serves
            explanations; None for all.

    Returns:
        The data, and all rules that it refers to: active ones, then deleted ones.
    """
    state = network.snapshot()
    remembered_events = state["tracker"]["stored_events"]
    external = _RulesAndNodes(network.active_rules)
    graph = ObjectWriter(external)
    # Retractions need the complete lineage, explanations do not.
    if (
        max_explained_events is not None
        and len(remembered_events) > max_explained_events
        and not network.rules.flags.is_on("revision_flag")
    ):
        newest_events = remembered_events[-max_explained_events:]
        state["tracker"]["stored_events"] = newest_events
        graph = ObjectWriter(external, LineageCut(newest_events[0].number))
    encoded_state = network.STATE.encode_state(state, network, graph)
    return StoredNetwork(graph.encode(), encoded_state), external.rules


def restore_matches(
    network: NetworkState, saved: StoredNetwork, restored_rules: Sequence[EventRule], context: ReadContext
) -> None:
    """Restore matches, events, alarms and queries.

    Args:
        network: the restored rules, the knowledge with restored memories, and the clock.
        saved: data from `snapshot_matches`.
        restored_rules: rules from `restore_rules`.
        context: has the changes from the format of the file.

    Raises:
        UsageError: if the data does not fit the program, or cannot have been created by `snapshot_matches`.
    """
    read_objects = with_path(
        "objects", lambda stored: ObjectReader(stored, _RulesAndNodes(restored_rules), context.changes)
    )
    objects: ObjectReader = read_objects(saved.objects)
    # All checks come first: invalid data must not leave rules and alarms partly restored.
    network.restore(network.STATE.check_state(saved.state, network, objects.context()))
