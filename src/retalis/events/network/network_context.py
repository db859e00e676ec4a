"""Context of the event rules, which the nodes of all rules share.

The nodes read the limits, set alarms, record the lineage of events, and report problems here. A problem is reported
at its occurrences 1, 2, 4, 8 and so on, so that a rule that fails at each event does not flood the log.
"""

from typing import TYPE_CHECKING, Callable, Iterable, Optional, Tuple

from ...foundation.errors import RecurringWarning, RetalisError, RuleError
from ...prolog.machine.resource_limits import record_caught_error
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms.timestamps import SECOND, format_distance
from ...prolog.terms.types import Term, Values
from ..clock.clock import Clock
from ..dispatch.dispatcher import Dispatcher
from ..dispatch.listeners import TERM
from ..language.pattern_tree import RuleDefinition
from ..language.rule_heads import is_absolute_alarm
from ..matches.match_policies import NetworkOptions
from ..matches.match_types import PartialMatch, event_matches
from ..matches.watermarks import Watermarks
from ..streams.stream_operators import KeyBounds
from .goal_evaluation import ConditionState, TimedNode
from .lineage_graph import Occurrence
from .lineage_tracker import LineageTracker
from .node_timers import NodeTimers, RuleAlarm

if TYPE_CHECKING:
    from .event_rule import EventRule


class NetworkContext:
    """Parts of the engine, limits and reports that the nodes of all rules share.

    Args:
        logic: compiles and runs goals.
        dispatcher: dispatches events to the rules and receives derived events.
        clock: provides the time and alarms.
        definitions: returns the definitions of the active rules.
        options: network options derived from the flags.
        key_bounds: limits for keyed state derived from the flags.
        on_error: called with each error of a rule or goal while events are processed.
        on_warning: called with each warning.

    Attributes:
        max_stored: maximum number of partial matches of a rule (the oldest are dropped) and of alarms (further ones
            are dropped). A rule reads it when it is created.
        future: maximum time in ns by which a timestamp may be ahead of the clock and still advance windows.
        tracker: the lineage of events, if a flag requires it.
        watermarks: lags of the topics, and the watermarks that timeouts wait for.
        failed_retraction_count: number of events ``rev(E)`` without an event E.
    """

    def __init__(
        self,
        logic: PrologSystem,
        dispatcher: Dispatcher,
        clock: Clock,
        definitions: Callable[[], Iterable[RuleDefinition]],
        options: NetworkOptions,
        key_bounds: KeyBounds,
        on_error: Callable[[RetalisError], None],
        on_warning: Callable[[RetalisError], None],
    ):
        self.logic = logic
        self.dispatcher = dispatcher
        self.clock = clock
        self.options = options
        self.key_bounds = key_bounds
        self.max_stored = 1_000_000
        self.future = 10 * SECOND
        self.on_error = on_error
        self.on_warning = on_warning
        self.condition_state = ConditionState()
        self.watermarks = Watermarks(definitions)
        self.node_timers = NodeTimers(clock, dispatcher, logic.machine)
        self.watermarks.on_shorter_delay(self.node_timers.reschedule)
        self.tracker = LineageTracker(dispatcher, logic.machine.budget, self.report_nothing_retracted)
        self.failed_retraction_count = 0
        self._is_ahead_reported = False
        self._far_ahead_count = 0

    def configure(self, options: NetworkOptions, key_bounds: KeyBounds, executes_retractions: bool) -> None:
        """Apply changed flags; rules are configured by `EventRule.configure`."""
        self.options = options
        self.key_bounds = key_bounds
        self.tracker.configure(options.tracks_events, executes_retractions)

    def limit_stored(self, max_stored: int) -> None:
        """Set the maximum number of partial matches of each rule that is created later, and of alarms."""
        self.max_stored = max_stored

    def restore_failed_retraction_count(self, count: int) -> None:
        """Set the number of events ``rev(E)`` without an event E to that of a snapshot."""
        self.failed_retraction_count = count

    def compute_max_timestamp(self) -> int:
        """Return the latest timestamp that may advance the windows of a rule: ``future`` ns after the present time.

        The time of a pinned clock is constant while the time of its alarms advances, so the later one of both counts.
        """
        return max(self.clock.now(), self.clock.reached()) + self.future

    def set_alarm(
        self, rule: "EventRule", term: Term, start: int, instant: int, token: Optional[Occurrence] = None
    ) -> None:
        """Emit an event when the clock reaches an instant."""
        if len(self.clock.alarms) >= self.max_stored:
            rule.dropped_alarm_count += 1
            count = rule.dropped_alarm_count
            text = f": more than {self.max_stored} alarms are set; {count} have been dropped so far"
            self._warn_rarely(rule, "dropped alarms", text, lambda: rule.dropped_alarm_count)
            return
        self.clock.call_at(instant, RuleAlarm(rule, term, start, instant, token))

    def alarm_time(self) -> int:
        """Return the present time for alarms; while an alarm is processed, its instant."""
        alarm_instant = self.clock.ringing
        return self.clock.reached() if alarm_instant is None else alarm_instant

    def set_node_alarm(self, node: TimedNode, instant: int) -> None:
        """Call ``on_alarm`` of a node when the clock reaches an instant."""
        self.node_timers.add(node, instant)

    def report_late(self, rule: "EventRule", reason: str) -> None:
        """Report that a match was too late to be used."""
        rule.late_count += 1
        text = f": {reason}; {rule.late_count} so far"
        self._warn_rarely(rule, "late", text, lambda: rule.late_count)

    def report_ahead(self, rule: "EventRule", end: int) -> None:
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
        """Report an event that is, or has been, far ahead of the clock; one warning covers all rules."""
        count = self._far_ahead_count = self._far_ahead_count + 1
        if count & (count - 1) == 0:
            self.on_warning(RecurringWarning(describe(), None, "far ahead", lambda: self._far_ahead_count))
        self._is_ahead_reported = True
        try:
            dispatch()
        finally:
            self._is_ahead_reported = False

    def report_past_alarm(
        self, rule: "EventRule", head: Term, alarm: Optional[Tuple[Term, int, int]]
    ) -> None:
        """Report an alarm for a past instant; ``alarm`` is None if the instant precedes the event's own start."""
        if not is_absolute_alarm(head) or (alarm is not None and alarm[2] >= self.clock.now()):
            return
        rule.past_alarm_count += 1
        consequence = "it is an ordinary event" if alarm is None else "it fires at once"
        text = f": the instant of its alarm is in the past, so {consequence}; {rule.past_alarm_count} so far"
        self._warn_rarely(rule, "past alarms", text, lambda: rule.past_alarm_count)

    def report_nothing_retracted(self, term: Term, rule: Optional["EventRule"]) -> None:
        """Report an event ``rev(E)`` without an event E to retract, at the occurrences 1, 2, 4, 8 and so on."""
        self.failed_retraction_count += 1
        occurrence_count = self.failed_retraction_count
        if occurrence_count & (occurrence_count - 1) == 0:
            prefix = "" if rule is None else f"rule {rule.name}: "
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

    def report_rule_error(self, rule: "EventRule", error: RetalisError, subject: str = "") -> None:
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
        self.on_error(RuleError(f"rule {rule.name}{context_text}: {error.message}", rule.place))

    def report_result_error(self, rule: "EventRule", key_values: Values, error: RuleError) -> None:
        """Report an error that prevented a result of a window; it names the key if the clock has ended the window."""
        keys = ", ".join([self.logic.brief(value) for value in key_values])
        self.report_rule_error(rule, error, f"key {keys}" if keys else "")

    def report_goal_error(self, rule: "EventRule", goal: Term, error: RetalisError) -> None:
        """Report an error of a goal of a rule."""
        # Only the first goals over a limit are reported one by one; the others are counted, see `Budget`.
        if record_caught_error(error):
            goal_text = self.logic.brief(goal, names=rule.definition.names)
            self.report_rule_error(rule, RuleError(f"goal {goal_text}: {error.message}"))

    def report_dropped(
        self, rule: "EventRule", max_runs: int = 0, excluding: Optional[PartialMatch] = None
    ) -> None:
        """Report that partial matches of a rule were dropped, or more than ``max_runs`` runs from one start.

        Args:
            rule: the rule.
            max_runs: maximum number of runs; 0 if the limit of partial matches was exceeded.
            excluding: the dropped match, if it belongs to a negated pattern.
        """
        # The description takes longer than a drop, and most drops are not logged.
        if rule.dropped_count & (rule.dropped_count - 1):
            return
        text = (
            f" has more than {self.max_stored} partial matches; "
            f"{rule.dropped_count} of the oldest have been dropped so far"
        )
        if excluding is not None:
            terms = [match.term for match in event_matches(excluding) if match.term is not None]
            event = f" {self.logic.brief(terms[-1])}" if terms else ""
            text += f", and the last one is a negated event{event}: results that it excludes may be emitted"
        if max_runs:
            text = (
                f" has more than {max_runs} ways to take its steps from one start; "
                f"{rule.dropped_count} have been dropped so far"
            )
        self._warn_rarely(rule, "dropped", text, lambda: rule.dropped_count)

    def report_endless_skip(self, rule: "EventRule") -> None:
        """Report that the next match of a row pattern would begin at the first event of a match."""
        text = (
            ": after_match of steps leads to the first event of the match, where the same match would be found "
            "without end; the next match begins at the event after it"
        )
        self._warn_rarely(rule, "endless skip", text, lambda: 1)

    def report_dropped_keys(self, rule: "EventRule") -> None:
        """Report that keys of a rule were dropped."""
        text = (
            f" has more than {self.key_bounds.max_keys} keys; {rule.dropped_count} of the least recently used have "
            "been dropped so far; flag max_keys sets the number, property(ttl, SECONDS) of a label ends idle keys"
        )
        self._warn_rarely(rule, "dropped keys", text, lambda: rule.dropped_count)

    def _warn_rarely(
        self, rule: "EventRule", category: str, text: str, count_occurrences: Callable[[], int]
    ) -> None:
        """Log a warning at the occurrences 1, 2, 4, 8 and so on."""
        count = count_occurrences()
        if count & (count - 1) == 0:
            self.on_warning(
                RecurringWarning(
                    f"rule {rule.name}{text}",
                    rule.place,
                    (rule.name, rule.place, category),
                    count_occurrences,
                )
            )
