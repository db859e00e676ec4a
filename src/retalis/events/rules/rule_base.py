"""The rule base: the event rules of a program, found by label and by definition, and the flags that configure them.

A rule is compiled to a network (`EventRule`) and activated, which makes its nodes listen to events. Rules fire in the
order in which they were activated. Flags and properties of labels (consumption policy, garbage control, time to live)
are applied at once to all active rules. The rule base also reports problems of rules, with exponentially decreasing
frequency, so that a rule that fails at each event does not flood the log.
"""

import logging
from pathlib import Path
from typing import TYPE_CHECKING, Callable, Dict, Hashable, Iterator, List, Optional, Sequence, Tuple, Union

from ...foundation.callbacks import CallbackList
from ...foundation.errors import Place, RecurringWarning, RetalisError, RuleError
from ...prolog.files.source_files import SourceFiles
from ...prolog.machine.resource_limits import record_caught_error
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms.term_traversal import copy, term_key, variables
from ...prolog.terms.timestamps import SECOND, format_distance, from_seconds
from ...prolog.terms.types import Functor, Term, Trail, Values, atom, deref
from ...prolog.terms.unification import unify
from ...serialization.field_types import COUNT
from ...serialization.state_fields import StateFields, StateOwner, field
from ..clock.clock import Clock
from ..dispatch.dispatcher import Dispatcher
from ..dispatch.listeners import TERM
from ..language.called_predicates import calls_in_goals
from ..language.event_declarations import STRICTLY, UNDECLARED, DeclaredEvents
from ..language.pattern_parser import no_place
from ..language.pattern_tree import RuleDefinition
from ..language.rule_head_parser import WATERMARK_DELAY, Property, has_timeout, is_absolute_alarm, is_rule
from ..matches.match_types import NetworkOptions, options_with_property
from ..matches.watermarks import Watermarks, delay_setting
from ..network.event_rule import EventRule
from ..network.goal_evaluation import ConditionState, TimedNode
from ..network.stream_node import StreamNode
from ..program.event_file_checker import FileChecker
from ..program.event_file_loader import EventFileLoader
from ..provenance.event_log import EventLog
from ..provenance.explanation_terms import Justifier
from ..provenance.lineage import LineageTracker
from ..provenance.occurrences import Occurrence
from .event_flags import MAX_WATERMARK_DELAY, Flags
from .event_language_predicates import define_predicates
from .timer_service import NodeTimers, RuleAlarm, Timers

if TYPE_CHECKING:
    from os import PathLike

_UNLABELED = atom("unlabeled")

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


def label_of(rule: EventRule) -> Term:
    """Return the label of a rule."""
    return _UNLABELED if rule.label is None else rule.label


def _remove_from_group(groups: _RuleGroups, key: Hashable, rule: EventRule) -> None:
    """Remove a rule from the group of a key, and an empty group from the index."""
    del groups[key][rule]
    if not groups[key]:
        del groups[key]


log = logging.getLogger("retalis")

_NETWORK_FLAGS = frozenset(
    ("event_consumption_policy", "out_of_order", "revision_flag", "etalis_justification", "garbage_control")
    + ("garbage_window", "garbage_window_step", "state_ttl", "max_keys")
)
"""Flags that change the options of network nodes."""


class RuleBase(StateOwner):
    """The event rules of a program.

    Args:
        logic: compiles goals and stores clauses.
        dispatcher: dispatches events to the rules and receives derived events.
        clock: provides the time and alarms.
        files: files of the program.
        max_stored: maximum number of partial matches of a rule (the oldest are dropped) and of alarms (further ones
            are dropped).
        future: maximum time in ns by which a timestamp may be ahead of the clock and still advance windows.
        on_error: called with each error of a rule or goal while events are processed; by default it is logged.
        on_warning: called with each warning; by default it is logged.
        is_external_event: returns whether events of a functor come from outside the program without a declaration.

    Attributes:
        on_reset: called if a goal drops partial matches, with True if stored events are dropped, too.
        warn_singletons: whether to warn of variables that occur only once in a clause.
        flags: the flags of ``set_etalis_flag/2``.
        declared_events: declared events.
        options: network options derived from the flags.
        key_bounds: limits for keyed state derived from the flags.
        tracker: the lineage of events, if a flag requires it.
        watermarks: lags of the topics, and the watermarks that timeouts wait for.
        serial: serial number of the newest rule; rules fire in the order of their serial numbers.
        fired_by_deleted_rules: number of complete matches of deleted rules.
        failed_retraction_count: number of events ``rev(E)`` without an event E.
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
        max_stored: int = 1_000_000,
        future: int = 10 * SECOND,
        on_error: Callable[[RetalisError], None] = lambda error: log.error("%s", error),
        on_warning: Callable[[RetalisError], None] = lambda error: log.warning("%s", error),
        is_external_event: Callable[[Functor], bool] = lambda key: False,
    ):
        self.logic = logic
        self.dispatcher = dispatcher
        self.clock = clock
        self.max_stored = max_stored
        self.future = future
        self.on_error = on_error
        self.warn_singletons = False
        self.failed_retraction_count = 0
        self.fired_by_deleted_rules = 0
        self.on_reset: CallbackList[Callable[[bool], None]] = CallbackList()
        self.on_warning = on_warning
        self.condition_state = ConditionState()
        self._rule_index = RuleIndex()
        self.watermarks = Watermarks(lambda: (rule.definition for rule in self._rule_index))
        self.flags = Flags(self._apply_flag)
        self.declared_events = DeclaredEvents(logic, self._requires_declarations, is_external_event)
        self.options: NetworkOptions = self.flags.network_options()
        self.key_bounds = self.flags.key_bounds()
        self.tracker = LineageTracker(self)
        self.justifier = Justifier(self, self.tracker)
        self.event_log = EventLog(self)
        self.node_timers = NodeTimers(self)
        self.watermarks.on_shorter_delay(self.node_timers.reschedule)
        self.files = files
        self.loader = EventFileLoader(self)
        self._properties: Dict[Hashable, List[Property]] = {}
        self._is_ahead_reported = False
        self._far_ahead_count = 0
        self.serial = 0
        self.timers = Timers(self)
        define_predicates(self)

    def warn_of_singletons(self) -> None:
        """Warn of variables that occur only once in a clause that is loaded from now on."""
        self.warn_singletons = True

    # ---- loading -------------------------------------------------------------------------------------

    def load_text(self, text: str, source: str = "text", folder: Optional[Path] = None) -> None:
        """Load the text of an event file.

        Raises:
            ProgramErrors: all errors; nothing of the text is active.
        """
        self.loader.load_text(text, source, folder)

    def load_file(self, path: Union[str, "PathLike[str]"]) -> None:
        """Load an event file of the program and allow its goals to read files in the same folder later.

        Raises:
            ProgramErrors: all errors; nothing of the file is active.
            PrologError: if the file does not exist or the name is invalid.
            UsageError: if the file cannot be read.
        """
        with self.files.loading():
            resolved = self.files.resolve(path)
            self.files.sandbox.add_program_folder(resolved.parent)
            self.loader.load_file(resolved)

    def load_terms(self, terms: Sequence[Tuple[Term, Optional[Place]]]) -> None:
        """Load terms like the contents of an event file.

        Raises:
            ProgramErrors: all errors; nothing is active.
        """
        self.loader.load_terms(terms)

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
        return EventRule(self, definition, self.serial, self._rule_title(definition))

    def activate(self, rule: EventRule) -> None:
        """Activate a rule, so that it receives events."""
        self._rule_index.add(rule)
        self.watermarks.note_changed_rules()
        if has_timeout(rule.definition.head):
            self.watermarks.is_observing = True
        self._configure(rule)

    def insert(self, term: Term) -> bool:
        """Add a term as a rule or, if it is not a rule, as a clause; return whether it is a rule.

        Raises:
            ProgramErrors: if the rule is invalid.
        """
        # The term is copied, because backtracking over the goal that inserts it undoes its bindings.
        term = copy(term)
        self.loader.load_terms([(term, None)])
        return is_rule(term)

    def delete(self, term: Term) -> bool:
        """Delete all rules with a label, or the first rule that is equal to a term, with their partial matches.

        Returns:
            Whether a rule was deleted.
        """
        term = deref(term)
        if is_rule(term):
            rules = self._rules_equal_to(term)[:1]
        else:
            rules = self._rule_index.find_by_label(term)
        for rule in rules:
            self.remove(rule)
        return bool(rules)

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
        self.watermarks.note_changed_rules()
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

    def _rules_equal_to(self, term: Term) -> List[EventRule]:
        checker = FileChecker()
        checker.check_term(copy(term), no_place, None)
        if not checker.rules:
            return []
        # The label is part of the identity only if the given term has one.
        definition = checker.rules[0]
        candidates = self._rule_index.find_equal(definition.key)
        return [rule for rule in candidates if definition.label is None or label_of(rule) is definition.label]

    def warn_unknown_calls(self, conditions: Term, caller: str) -> None:
        """Warn of unknown predicates in the conditions of a memory or subscription."""
        self.loader.record_calls(calls_in_goals(conditions, caller))

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

    def _rule_title(self, definition: RuleDefinition) -> str:
        show = self.logic.brief
        head = "(no head)"
        # Variables of a rule that was added at run time have no names; numbered ones would differ in each message.
        if definition.head is not None:
            unnamed = dict.fromkeys(variables(definition.head), "_")
            head = show(definition.head, {**unnamed, **definition.names}, is_constructed=True)
        label = "" if definition.label is None else f"{show(definition.label)}: "
        return f"rule {label}{head}"

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
        options = self.options
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
                self.watermarks.configure(node.watermark, bool(delay_values), setting)
        windows = times.get("window", []) + times.get("event_rule_window", [])
        rule.configure(options, min(windows) if windows else None, self.flags.garbage_control(times))

    def _apply_flag(self, name: str) -> None:
        if name in _NETWORK_FLAGS:
            self.options = self.flags.network_options()
            self.key_bounds = self.flags.key_bounds()
            self.tracker.configure()
            # Options are compiled into the nodes, so a change reconfigures all rules.
            for rule in self.rules:
                self._configure(rule)
        elif name in (WATERMARK_DELAY, MAX_WATERMARK_DELAY):
            self.watermarks.set_default(
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

    def compute_max_timestamp(self) -> int:
        """Return the latest timestamp that may advance the windows of a rule: ``future`` ns after the present time.

        The time of a pinned clock is constant while the time of its alarms advances, so the later one of both counts.
        """
        return max(self.clock.now(), self.clock.reached()) + self.future

    def clear(self) -> None:
        """Remove all partial matches and stored events after time went back; timers start again."""
        self.node_timers.clear()
        self.watermarks.clear()
        for rule in self.rules:
            rule.clear()
        self.tracker.clear()
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
        self.tracker.clear()
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

    # ---- alarms and reports --------------------------------------------------------------------------

    def set_alarm(
        self, rule: EventRule, term: Term, start: int, instant: int, token: Optional[Occurrence] = None
    ) -> None:
        """Emit an event when the clock reaches an instant."""
        if len(self.clock.alarms) >= self.max_stored:
            rule.dropped_alarm_count += 1
            count = rule.dropped_alarm_count
            text = f": more than {self.max_stored} alarms are set; {count} have been dropped so far"
            self._warn_rarely(rule, "dropped alarms", text, lambda: rule.dropped_alarm_count)
            return
        self.clock.call_at(instant, RuleAlarm(self, rule, term, start, instant, token))

    def alarm_time(self) -> int:
        """Return the present time for alarms; while an alarm is processed, its instant."""
        alarm_instant = self.clock.ringing
        return self.clock.reached() if alarm_instant is None else alarm_instant

    def set_node_alarm(self, node: TimedNode, instant: int) -> None:
        """Call ``on_alarm`` of a node when the clock reaches an instant."""
        self.node_timers.add(node, instant)

    def report_late(self, rule: EventRule, reason: str) -> None:
        """Report that a match was too late to be used."""
        rule.late_count += 1
        text = f": {reason}; {rule.late_count} so far"
        self._warn_rarely(rule, "late", text, lambda: rule.late_count)

    def report_ahead(self, rule: EventRule, end: int) -> None:
        """Report that a match is too far ahead of the clock to advance the time of a rule or operator.

        Args:
            rule: the rule.
            end: end of the match in ns.
        """
        # Before its first time, a clock that no event moves is behind all events.
        if not self.clock.is_set:
            return
        count = rule.ahead_count = rule.ahead_count + 1
        # The description takes 50 µs, and most occurrences are not logged.
        if not self._is_ahead_reported and count & (count - 1) == 0:
            text = (
                f": {self.describe_ahead(end)}: it does not advance the time of the rule, and time windows and "
                f"debounce ignore it; {rule.ahead_count} so far"
            )
            self._warn_rarely(rule, "ahead", text, lambda: rule.ahead_count)

    def describe_ahead(self, end: int) -> str:
        """Return a description of the present event, which ends ahead of the clock, for reports."""
        current = self.dispatcher.current
        event = "an event" if current is None else f"event {self.logic.brief(current[0])}"
        return f"{event} is {format_distance(end - self.compute_max_timestamp() + self.future)} ahead of the clock"

    def report_far_ahead(
        self, describe: Callable[[], str], dispatch: Callable[[], object] = lambda: None
    ) -> None:
        """Report an event that is, or has been, far ahead of the clock; one warning covers all rules.

        Args:
            describe: returns the text of the warning.
            dispatch: dispatches the event.
        """
        count = self._far_ahead_count = self._far_ahead_count + 1
        if count & (count - 1) == 0:
            self.on_warning(RecurringWarning(describe(), None, "far ahead", lambda: self._far_ahead_count))
        self._is_ahead_reported = True
        try:
            dispatch()
        finally:
            self._is_ahead_reported = False

    def report_past_alarm(self, rule: EventRule, head: Term, alarm: Optional[Tuple[Term, int, int]]) -> None:
        """Report an alarm for a past instant; ``alarm`` is None if the instant precedes the event's own start."""
        if not is_absolute_alarm(head) or (alarm is not None and alarm[2] >= self.clock.now()):
            return
        rule.past_alarm_count += 1
        consequence = "it is an ordinary event" if alarm is None else "it fires at once"
        text = f": the instant of its alarm is in the past, so {consequence}; {rule.past_alarm_count} so far"
        self._warn_rarely(rule, "past alarms", text, lambda: rule.past_alarm_count)

    def report_nothing_retracted(self, term: Term, rule: Optional[EventRule]) -> None:
        """Report an event ``rev(E)`` without an event E to retract, at the occurrences 1, 2, 4, 8 and so on."""
        self.failed_retraction_count += 1
        occurrence_count = self.failed_retraction_count
        if occurrence_count & (occurrence_count - 1) == 0:
            prefix = "" if rule is None else f"{rule.name}: "
            text = (
                f"{prefix}rev retracts nothing: no event {self.logic.brief(term)} that still holds is known"
            )
            place = None if rule is None else rule.place
            self.on_warning(
                RecurringWarning(
                    f"{text}; {occurrence_count} so far",
                    place,
                    "nothing retracted",
                    lambda: self.failed_retraction_count,
                )
            )

    def report_rule_error(self, rule: EventRule, error: RetalisError, subject: str = "") -> None:
        """Report an error that prevented a rule from firing.

        Args:
            rule: the rule.
            error: the error.
            subject: the subject of the error if no event is being dispatched.
        """
        rule.metrics.error_count += 1
        context = self.dispatcher.current
        if context is not None:
            subject = f"event {self.logic.brief(context[TERM])}"
        context_text = f", at {subject}" if subject else ""
        self.on_error(RuleError(f"{rule.name}{context_text}: {error.message}", rule.place))

    def report_result_error(self, rule: EventRule, key_values: Values, error: RuleError) -> None:
        """Report an error that prevented a result of a window; it names the key if the clock has ended the window."""
        keys = ", ".join([self.logic.brief(value) for value in key_values])
        self.report_rule_error(rule, error, f"key {keys}" if keys else "")

    def report_goal_error(self, rule: EventRule, goal: Term, error: RetalisError) -> None:
        """Report an error of a goal of a rule."""
        # Only the first goals over a limit are reported one by one; the others are counted, see `Budget`.
        if record_caught_error(error):
            goal_text = self.logic.brief(goal, names=rule.definition.names)
            self.report_rule_error(rule, RuleError(f"goal {goal_text}: {error.message}"))

    def report_dropped(self, rule: EventRule, max_runs: int = 0) -> None:
        """Report that partial matches of a rule were dropped, or more than ``max_runs`` runs from one start."""
        text = (
            f" has more than {self.max_stored} partial matches; "
            f"{rule.dropped_count} of the oldest have been dropped so far"
        )
        if max_runs:
            text = (
                f" has more than {max_runs} ways to take its steps from one start; "
                f"{rule.dropped_count} have been dropped so far"
            )
        self._warn_rarely(rule, "dropped", text, lambda: rule.dropped_count)

    def report_dropped_keys(self, rule: EventRule) -> None:
        """Report that keys of a rule were dropped."""
        text = (
            f" has more than {self.key_bounds.max_keys} keys; {rule.dropped_count} of the least recently used have "
            "been dropped so far; flag max_keys sets the number, property(ttl, SECONDS) of a label ends idle keys"
        )
        self._warn_rarely(rule, "dropped keys", text, lambda: rule.dropped_count)

    def _warn_rarely(
        self, rule: EventRule, category: str, text: str, count_occurrences: Callable[[], int]
    ) -> None:
        """Log a warning at the occurrences 1, 2, 4, 8 and so on."""
        count = count_occurrences()
        if count & (count - 1) == 0:
            self.on_warning(
                RecurringWarning(
                    f"{rule.name}{text}", rule.place, (rule.name, rule.place, category), count_occurrences
                )
            )
