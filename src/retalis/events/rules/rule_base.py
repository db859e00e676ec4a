"""The rule base: the event rules of a program, found by label and by definition, and the flags that configure them.

A rule is compiled to a network (`EventRule`) and activated, which makes its nodes listen to events. Rules fire in the
order in which they were activated. Flags and properties of labels (consumption policy, garbage control, time to live)
are applied at once to all active rules.
"""

from typing import Callable, Dict, Hashable, Iterator, List, Sequence

from ...foundation.callbacks import CallbackList
from ...foundation.errors import RetalisError
from ...prolog.files.source_files import SourceFiles
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms.term_traversal import copy, term_key
from ...prolog.terms.timestamps import from_seconds
from ...prolog.terms.types import Functor, Term, Trail
from ...prolog.terms.unification import unify
from ...serialization.state_fields import StateFields, StateOwner, field
from ...serialization.stored_field_types import COUNT
from ..clock.clock import Clock
from ..dispatch.dispatcher import Dispatcher
from ..dispatch.event_recording import EventLog
from ..language.event_declarations import STRICTLY, UNDECLARED, DeclaredEvents
from ..language.pattern_tree import RuleDefinition
from ..language.rule_heads import has_timeout
from ..language.rule_labels import WATERMARK_DELAY, Property
from ..matches.match_policies import options_with_property
from ..matches.watermarks import delay_setting
from ..network.event_rule import EventRule
from ..network.network_context import NetworkContext
from ..network.stream_node import StreamNode
from ..provenance.explanation_terms import Justifier, label_of
from .language_flags import MAX_WATERMARK_DELAY, Flags
from .program_timers import Timers

_RuleGroups = Dict[Hashable, Dict[EventRule, None]]
"""Rules by a key; the rules of a key are in order."""


class RuleIndex:
    """Active rules in order, with indexes by label and by definition."""

    def __init__(self) -> None:
        self._all: Dict[EventRule, None] = {}
        self._by_label: _RuleGroups = {}
        self._by_key: _RuleGroups = {}

    def __iter__(self) -> Iterator[EventRule]:
        return iter(self._all)

    def add(self, rule: EventRule) -> None:
        """Add a rule at the end."""
        self._all[rule] = None
        self._by_label.setdefault(term_key(label_of(rule)), {})[rule] = None
        self._by_key.setdefault(rule.definition.key, {})[rule] = None

    def discard(self, rule: EventRule) -> bool:
        """Remove a rule; return whether it was present."""
        if self._all.pop(rule, 0) is not None:
            return False
        _remove_from_group(self._by_label, term_key(label_of(rule)), rule)
        _remove_from_group(self._by_key, rule.definition.key, rule)
        return True

    def find_by_label(self, label: Term) -> List[EventRule]:
        """Return the rules with a label."""
        return list(self._by_label.get(term_key(label), ()))

    def find_equal(self, key: Hashable) -> List[EventRule]:
        """Return the rules with an equal definition; see `RuleDefinition.key`."""
        return list(self._by_key.get(key, ()))


def _remove_from_group(groups: _RuleGroups, key: Hashable, rule: EventRule) -> None:
    """Remove a rule from the group of a key, and an empty group from the index."""
    del groups[key][rule]
    if not groups[key]:
        del groups[key]


_NETWORK_FLAGS = frozenset(
    ("event_consumption_policy", "out_of_order", "revision_flag", "etalis_justification", "garbage_control")
    + ("garbage_window", "garbage_window_step", "state_ttl", "max_keys")
)
"""Flags that change the options of network nodes."""


class RuleBase(StateOwner):
    """The event rules of a program.

    Args:
        logic, dispatcher, clock, on_error, on_warning: see `NetworkContext`.
        is_external_event: returns whether events of a functor come from outside the program without a declaration.

    Attributes:
        logic, dispatcher, clock: see above.
        network: the context of the rules.
        on_reset: called if a goal drops partial matches, with True if stored events are dropped, too.
        flags: the flags of ``set_etalis_flag/2``.
        serial: serial number of the newest rule; rules fire in the order of their serial numbers.
        fired_by_deleted_rules: number of complete matches of deleted rules.
    """

    STATE = StateFields(
        field("serial", COUNT),
        field("fired_by_deleted_rules", COUNT),
        field("failed_retraction_count", COUNT),
    )

    def __init__(
        self,
        logic: PrologSystem,
        dispatcher: Dispatcher,
        clock: Clock,
        files: SourceFiles,
        on_error: Callable[[RetalisError], None],
        on_warning: Callable[[RetalisError], None],
        is_external_event: Callable[[Functor], bool],
    ):
        self._rule_index = RuleIndex()
        self.flags = Flags(self._apply_flag)
        self.logic = logic
        self.dispatcher = dispatcher
        self.clock = clock
        self.network = NetworkContext(
            logic,
            dispatcher,
            clock,
            lambda: (rule.definition for rule in self._rule_index),
            self.flags.network_options(),
            self.flags.key_bounds(),
            on_error=on_error,
            on_warning=on_warning,
        )
        self.files = files
        self.serial = 0
        self.fired_by_deleted_rules = 0
        self.on_reset: CallbackList[Callable[[bool], None]] = CallbackList()
        self._properties: Dict[Hashable, List[Property]] = {}
        self.declared_events = DeclaredEvents(logic, self._requires_declarations, is_external_event)
        self.justifier = Justifier(self._rule_index, self.network.tracker)
        self.event_log = EventLog(dispatcher, logic, files.sandbox, on_warning)
        self.timers = Timers(self)

    @property
    def failed_retraction_count(self) -> int:
        """Number of events ``rev(E)`` without an event E."""
        return self.network.failed_retraction_count

    @failed_retraction_count.setter
    def failed_retraction_count(self, count: int) -> None:
        self.network.restore_failed_retraction_count(count)

    # ---- rules ---------------------------------------------------------------------------------------

    @property
    def rules(self) -> List[EventRule]:
        """The active rules, oldest first."""
        return list(self._rule_index)

    def add(self, definition: RuleDefinition) -> EventRule:
        """Add a rule at the end; it receives later events only."""
        rule = self.compile(definition)
        self.activate(rule)
        return rule

    def compile(self, definition: RuleDefinition) -> EventRule:
        """Compile a rule without activating it.

        Raises:
            RetalisError: if a goal or pattern cannot be compiled.
        """
        self.serial += 1
        return EventRule(self.network, definition, self.serial)

    def activate(self, rule: EventRule) -> None:
        """Activate a rule, so that it receives events."""
        self._rule_index.add(rule)
        self.network.watermarks.note_changed_rules()
        if has_timeout(rule.definition.head):
            self.network.watermarks.start_observing()
        self._configure(rule)

    def delete(self, label: Term) -> bool:
        """Delete all rules with a label, with their partial matches; return whether there were any."""
        rules = self._rule_index.find_by_label(label)
        for rule in rules:
            self.remove(rule)
        return bool(rules)

    def delete_equal(self, definition: RuleDefinition) -> None:
        """Delete the first rule that is equal to a definition, with its partial matches.

        The label is part of the identity only if the definition has one.
        """
        for rule in self._rule_index.find_equal(definition.key):
            if definition.label is None or label_of(rule) is definition.label:
                self.remove(rule)
                return

    def delete_by_head(self, head: Term) -> bool:
        """Delete all rules whose head unifies with a term; return whether there were any."""
        matching = []
        for rule in self.rules:
            trail: Trail = []
            rule_head = rule.definition.head
            if rule_head is not None and unify(copy(rule_head), copy(head), trail):
                matching.append(rule)
        for rule in matching:
            self.remove(rule)
        return bool(matching)

    def remove(self, rule: EventRule) -> None:
        """Remove a rule and its partial matches."""
        was_active = self._rule_index.discard(rule)
        self.network.watermarks.note_changed_rules()
        rule.unlisten()
        rule.clear()
        if was_active:
            self.fired_by_deleted_rules += rule.metrics.firing_count

    def detach(self, rule: EventRule) -> None:
        """Deactivate a rule and keep its partial matches."""
        self._rule_index.discard(rule)
        rule.unlisten()

    def activate_exactly(self, rules: Sequence[EventRule], deleted: Sequence[EventRule] = ()) -> None:
        """Activate exactly these rules, in this order; they keep their partial matches.

        Args:
            rules: new, active or deactivated rules.
            deleted: deactivated rules to be deleted.
        """
        # `remove` below counts the matches in `fired_by_deleted_rules` only for rules that are in the index.
        for rule in deleted:
            self._rule_index.add(rule)
        retained_rules = set(rules)
        for rule in self.rules:
            if rule in retained_rules:
                self._rule_index.discard(rule)
            else:
                self.remove(rule)
        for rule in rules:
            # The serial number defines the order of firing, so it must follow the new positions.
            self.serial += 1
            rule.serial = self.serial
            self.activate(rule)

    def terms(self) -> List[Term]:
        """Return the terms of all rules and the bodies of all clauses of the program."""
        predicates = [
            predicate for predicate in self.logic.database.predicates.values() if predicate.kind == "user"
        ]
        bodies = [
            clause.body
            for predicate in predicates
            if not predicate.is_library_predicate
            for clause in predicate.active_clauses()
        ]
        return [*(rule.definition.term for rule in self.rules), *bodies]

    # ---- properties and flags ------------------------------------------------------------------------

    def set_property(self, prop: Property) -> None:
        """Set a property of a label; it is applied at once to the rules with the label."""
        properties = self._properties.setdefault(term_key(prop.label), [])
        # A word replaces the previous value of the property. Numbers accumulate, and the smallest one applies. A
        # delay is either.
        if prop.word_value is not None or prop.name == WATERMARK_DELAY:
            properties[:] = [other for other in properties if other.name != prop.name]
        if prop not in properties:
            properties.append(prop)
        for rule in self._rule_index.find_by_label(prop.label):
            self._configure(rule)

    def all_properties(self) -> Dict[Hashable, List[Property]]:
        """Return the properties by label; see `restore_properties`."""
        return {key: list(properties) for key, properties in self._properties.items()}

    def restore_properties(self, properties: Dict[Hashable, List[Property]]) -> None:
        """Replace the properties of all labels, and apply them to the rules."""
        if properties != self._properties:
            self._properties = properties
            for rule in self.rules:
                self._configure(rule)

    def properties(self, label: Term) -> List[Property]:
        """Return the properties of a label."""
        return self._properties.get(term_key(label), [])

    def _configure(self, rule: EventRule) -> None:
        """Apply the flags and the properties of its label to a rule."""
        times: Dict[str, List[int]] = {}
        options = self.network.options
        delay_values: List[Term] = []
        for prop in self.properties(label_of(rule)):
            if prop.name == WATERMARK_DELAY:
                delay_values = [prop.value]
            elif prop.word_value is not None:
                options = options_with_property(options, prop.name, prop.word_value)
            else:
                times.setdefault(prop.name, []).append(from_seconds(prop.numeric_value))
        for node in rule.nodes:
            if isinstance(node, StreamNode):
                setting = delay_setting(delay_values[0]) if delay_values else None
                self.network.watermarks.configure(node.watermark, bool(delay_values), setting)
        windows = times.get("window", []) + times.get("event_rule_window", [])
        rule.configure(options, min(windows) if windows else None, self.flags.garbage_control(times))

    def _apply_flag(self, name: str) -> None:
        if name in _NETWORK_FLAGS:
            self.network.configure(
                self.flags.network_options(), self.flags.key_bounds(), self.flags.is_on("revision_flag")
            )
            # Options are compiled into the nodes, so a change reconfigures all rules.
            for rule in self.rules:
                self._configure(rule)
        elif name in (WATERMARK_DELAY, MAX_WATERMARK_DELAY):
            self.network.watermarks.set_default(
                self.flags.watermark_delay(),
                from_seconds(self.flags.number(MAX_WATERMARK_DELAY)),
            )
        elif name == "store_fired_events":
            self.event_log.set_storing(self.flags.is_on(name))
        elif name == UNDECLARED.name:
            # The flag makes undeclared events errors, so each event must be checked even if nothing is declared.
            self.declared_events.check_all()

    def _requires_declarations(self) -> bool:
        """Return whether the flag makes undeclared events errors."""
        return self.flags.get(UNDECLARED.name) is STRICTLY

    def clear(self) -> None:
        """Remove all partial matches and stored events after time went back; timers start again."""
        self.network.node_timers.clear()
        self.network.watermarks.clear()
        for rule in self.rules:
            rule.clear()
        self.network.tracker.clear()
        self.timers.restart()

    def return_to(self, instant: int) -> None:
        """Set the time of all rules and timers back, because the clock had followed a wrong timestamp."""
        for rule in self.rules:
            rule.return_to(instant)
        self.timers.return_to(instant)

    def report_reset(self, includes_past: bool) -> None:
        """Report that a goal drops partial matches, and stored events if ``includes_past`` is true."""
        for callback in self.on_reset:
            callback(includes_past)

    def reset(self) -> None:
        """Remove all rules, properties, partial matches, stored events and timers, and reset all flags."""
        for rule in list(self.rules):
            self.remove(rule)
        self.report_reset(True)
        self._properties.clear()
        self.declared_events.clear()
        self.event_log.clear()
        self.network.tracker.clear()
        self.timers.clear()
        self.flags.reset()
        self.files.loaded.clear()

    @property
    def fired(self) -> int:
        """Number of complete matches of all rules, including deleted ones."""
        return self.fired_by_deleted_rules + sum(rule.metrics.firing_count for rule in self.rules)

    @property
    def match_count(self) -> int:
        """Number of partial matches."""
        return sum(rule.match_count for rule in self.rules)
