"""Why-not provenance of events: the rules and states that could have raised an event, and what they lack."""

from typing import TYPE_CHECKING, Any, Dict, List, NamedTuple, Optional, Sequence, Tuple, Union

from ..engine.loaded_items import LoadedProgram
from ..events.checks.program_model import MIN_SIMILARITY
from ..events.knowledge.event_states import DeclaredState, OpenState
from ..events.language.pattern_tree import AggregatePattern, RatePattern, WindowPattern, walk
from ..events.matches.match_policies import AfterMatchSkipStrategy
from ..events.network.event_rule import EventRule
from ..events.network.lineage_graph import Occurrence
from ..foundation.displayed_text import format_number
from ..foundation.similar_names import did_you_mean
from ..prolog.terms import timestamps
from ..prolog.terms.term_traversal import copy
from ..prolog.terms.types import Term, Trail, Var, deref, functor, functor_name
from ..prolog.terms.unification import may_unify, undo, unify
from .explanation_lines import MAX_LINES_OF_A_KIND, ExplanationLine, ExplanationTexts
from .why_not_matched import PartResult, WhyNotMatched
from .why_not_published import WhyNotPublished

if TYPE_CHECKING:
    from .event_and_output_explanations import DerivationTrees

EventSource = Union[EventRule, DeclaredState]
"""Part of a program that raises events."""


class RequestedInterval(NamedTuple):
    """Interval of the event that is explained, in nanoseconds since the epoch.

    Attributes:
        start: start time.
        end: end time.
        earliest: an earlier stamp counts as this one, as in relative times that are printed.
    """

    start: int
    end: int
    earliest: int = -timestamps.MAX_TIMESTAMP

    def equals(self, start: int, end: int) -> bool:
        """Return whether an event has the interval."""
        return self[:2] == (max(start, self.earliest), max(end, self.earliest))


_COMMA_FUNCTOR = functor(",", 2)
_ALARM_FUNCTORS = frozenset((functor("exceptionAlarm", 2), functor("exceptionAlarmAbsoluteDatime", 2)))


class WhyNotHappened:
    """Explanations of events that did not happen; each missing event is explained once.

    Args:
        program: the program of the engine.
        occurrences: the recorded events.
        reference_time: see `TimeFormat`.
        texts: formats events and rules.
        derivations: explains the events with which open states began.
        why_not_published: evaluates subscriptions.
    """

    def __init__(
        self,
        program: LoadedProgram,
        occurrences: Sequence[Occurrence],
        reference_time: Optional[int],
        texts: ExplanationTexts,
        derivations: "DerivationTrees",
        why_not_published: WhyNotPublished,
    ):
        self._program = program
        self._occurrences = occurrences
        self._reference_time = reference_time
        self._texts = texts
        self._derivations = derivations
        self._why_not_published = why_not_published
        self._has_explanation: Dict[str, bool] = {}
        """For each missing event: whether it has an explanation above; False while it is being explained."""

    def explain(self, event: Term, interval: Optional[RequestedInterval]) -> List[ExplanationLine]:
        """Return what rules, states and subscriptions lack for the event of a request, and hints.

        Args:
            event: the event, which did not happen.
            interval: its interval; None if any.
        """
        # A part of a rule can be the requested event again.
        if interval is None:
            self._has_explanation[self._texts.format_term(event)] = False
        lines = self._explain_sources(event, interval, ())
        lines += self._explain_messages(event)
        if not lines:
            name = functor_name(deref(event))
            # The name itself occurs, for example, with another number of arguments, or in events of goals.
            hint = did_you_mean(name, set(self._collect_event_names()) - {name}, MIN_SIMILARITY)
            text = f"no rule has such a head, and no such event came from outside{hint}"
            lines.append(ExplanationLine(text, []))
        return lines + self._find_retracted(event) + self._find_events_with_name(event)

    def _explain_sources(
        self, event: Term, interval: Optional[RequestedInterval], ancestors: Tuple[EventSource, ...]
    ) -> List[ExplanationLine]:
        """Return the missing parts for each rule and declared state that could have raised an event.

        Args:
            event: the event, which did not happen.
            interval: its interval; None if any.
            ancestors: rules and states in whose explanation the event is missing, outermost first.
        """
        lines = []
        for rule in self._program.rules.rules:
            head = rule.definition.head
            # Ancestors are skipped: a recursive rule would explain its event by itself forever.
            if head is None or rule in ancestors:
                continue
            trail: Trail = []
            # The variables of the loaded rule are bound, so a time limit must not end this without `undo`.
            try:
                if unify(event_of_head(head), copy(event), trail):
                    lines.append(self._explain_rule(rule, interval, ancestors))
            finally:
                undo(trail, 0)
        return lines + self._explain_states(event, ancestors)

    def _explain_once(
        self, event: Term, ancestors: Tuple[EventSource, ...]
    ) -> Tuple[str, List[ExplanationLine]]:
        """Return the lines about a missing event, and the end of the text of the line that they belong to.

        Alternative rules that share missing events would make the tree grow exponentially, so each event is explained
        once. The text refers to that explanation afterwards.
        """
        key = self._texts.format_term(event)
        if key in self._has_explanation:
            return (", see above" if self._has_explanation[key] else ""), []
        self._has_explanation[key] = False
        lines = self._explain_sources(event, None, ancestors)
        self._has_explanation[key] = bool(lines)
        return "", lines

    # Rules

    def _explain_rule(
        self, rule: EventRule, interval: Optional[RequestedInterval], ancestors: Tuple[EventSource, ...]
    ) -> ExplanationLine:
        """Return why a rule, whose head is unified with the missing event, did not fire."""
        why_not_matched = WhyNotMatched(self._program.logic, self._occurrences, rule, self._reference_time)
        part = why_not_matched.evaluate(rule.definition.pattern)
        line = ExplanationLine(self._texts.format_rule(rule), [self._explain_part(part, (*ancestors, rule))])
        if part.matches:
            line.below.append(ExplanationLine(f"- but {_explain_no_firing(rule, part, interval)}", []))
        return line

    def _explain_part(self, part: PartResult, ancestors: Tuple[EventSource, ...]) -> ExplanationLine:
        """Return the line of a part of a pattern; a missing event is explained below it."""
        below = [self._explain_part(inner, ancestors) for inner in part.parts]
        reference = ""
        if part.event is not None and not part.matches:
            reference, lines = self._explain_once(part.event, ancestors)
            below += lines
        return ExplanationLine(f"{part.symbol} {part.text}{reference}", below)

    # States

    def _explain_states(self, event: Term, ancestors: Tuple[EventSource, ...]) -> List[ExplanationLine]:
        """Return which declared states are open for an event at the end of a state, or why none has begun."""
        lines: List[ExplanationLine] = []
        for declaration in self._program.knowledge.states.declarations_with_functor_of(event):
            # Two states can begin with the ends of each other.
            if declaration in ancestors:
                continue
            open_lines = [
                self._explain_open_state(state)
                for state in declaration.open.values()
                if state.start is not None and may_unify(state.term, event)
            ]
            lines += open_lines[-MAX_LINES_OF_A_KIND:] or self._explain_closed_state(
                declaration, event, ancestors
            )
        return lines

    def _explain_open_state(self, state: OpenState) -> ExplanationLine:
        # `openings` omits those whose events were retracted, so the first one is valid.
        _, beginning = state.openings[0]
        since = self._texts.format_instant(state.start or 0)
        return ExplanationLine(
            f"state {self._texts.format_term(state.term)} is open since {since}: it becomes an event when it ends",
            [] if beginning is None else [self._derivations.explain(beginning, 1)],
        )

    def _explain_closed_state(
        self, declaration: DeclaredState, event: Term, ancestors: Tuple[EventSource, ...]
    ) -> List[ExplanationLine]:
        """Return why a declared state is not open, if it can become the event; an empty list otherwise."""
        # Copied together, so that both share variables. Only those of the copies are bound: nothing has to be undone.
        pair: Any = copy((_COMMA_FUNCTOR, declaration.form.state, declaration.form.begin_event))
        _, state_term, begin_event = pair
        if not unify(state_term, copy(event), []):
            return []
        text = f"state {self._texts.format_term(state_term)} is not open"
        beginnings = [
            occurrence for occurrence in self._occurrences if may_unify(occurrence.term, begin_event)
        ]
        if beginnings:
            newest = self._texts.format_event(beginnings[-1])
            return [ExplanationLine(f"{text}, though {newest} begins it", [])]
        reference, below = self._explain_once(begin_event, (*ancestors, declaration))
        begin_text = self._texts.format_term(begin_event)
        return [ExplanationLine(f"{text}: {begin_text}, which begins it, did not happen{reference}", below)]

    # Subscriptions

    def _explain_messages(self, message: Term) -> List[ExplanationLine]:
        """Return the subscriptions that publish such messages, and the reasons for their events."""
        lines = []
        for text, subscription in self._why_not_published.find_publishing(message):
            reasons = list(self._why_not_published.explain_events(subscription, self._occurrences))
            below = [
                ExplanationLine(f"{self._texts.format_event(occurrence)}: {reason or 'sent'}", [])
                for occurrence, reason in reasons[-MAX_LINES_OF_A_KIND:]
            ]
            lines.append(ExplanationLine(text, below or [ExplanationLine("no such event happened", [])]))
        return lines

    # Hints

    def _collect_event_names(self) -> List[str]:
        """Return the names of the events that the program receives or raises, or that happened."""
        heads = [rule.definition.head for rule in self._program.rules.rules]
        raised = [event_of_head(head) for head in heads if head is not None]
        terms = [*raised, *(occurrence.term for occurrence in self._occurrences)]
        listened_names = self._program.rules.dispatcher.listened_names()
        return [*listened_names, *(functor_name(deref(term)) for term in terms)]

    def _find_retracted(self, event: Term) -> List[ExplanationLine]:
        """Return matching events that happened and were retracted."""
        retracted = [
            occurrence
            for revision in self._occurrences
            for occurrence in revision.retracts or ()
            if may_unify(occurrence.term, event)
        ]
        return [
            ExplanationLine(f"{self._texts.format_event(occurrence)} was retracted", [])
            for occurrence in retracted[-MAX_LINES_OF_A_KIND:]
        ]

    def _find_events_with_name(self, event: Term) -> List[ExplanationLine]:
        name = functor_name(deref(event))
        texts: Dict[str, None] = {}
        for occurrence in self._occurrences:
            if functor_name(deref(occurrence.term)) == name:
                texts.setdefault(self._texts.format_event(occurrence))
        if not texts:
            return []
        below = [ExplanationLine(text, []) for text in list(texts)[-MAX_LINES_OF_A_KIND:]]
        return [ExplanationLine(f"{len(texts)} of this name happened", below)]


def _explain_no_firing(rule: EventRule, part: PartResult, interval: Optional[RequestedInterval]) -> str:
    """Return why a rule did not fire although all parts of its pattern matched."""
    has_window = any(isinstance(subpattern, WindowPattern) for subpattern in walk(rule.definition.pattern))
    has_interval = interval is None or any(interval.equals(match.start, match.end) for match in part.matches)
    if not has_window and not has_interval:
        return "no match has that interval"
    if rule.window is not None and all(match.end - match.start > rule.window for match in part.matches):
        seconds = format_number(timestamps.to_seconds(rule.window))
        return f"all matches exceed the window of the rule's label, {seconds} seconds"
    return _describe_likely_reasons(rule)


def _describe_likely_reasons(rule: EventRule) -> str:
    """Return possible reasons why a rule did not fire, depending on the operators in its pattern."""
    aggregate_results: List[Term] = []
    rate_operators: List[str] = []
    for part in walk(rule.definition.pattern):
        if isinstance(part, AggregatePattern):
            aggregate_results.append(part.result)
        elif isinstance(part, RatePattern):
            rate_operators.append(part.operator)
    # The explained event fixes the result of an aggregate, and the rule has computed other ones.
    if any(deref(result).__class__ is not Var for result in aggregate_results):
        return "the aggregate had other results, or other matches consumed the events"
    if rate_operators:
        return (
            f"{rate_operators[0]} dropped it because of earlier events, or other matches consumed the events"
        )
    strategy = rule.options.after_match
    skipped = (
        "" if strategy is AfterMatchSkipStrategy.KEEP else f"an earlier match skipped it ({strategy.value}), "
    )
    return (
        f"{skipped}other matches consumed the events, the events arrived in another order, the window had ended, or "
        "a goal after do failed"
    )


def event_of_head(head: Term) -> Term:
    """Return the event of a rule's head; an alarm has it as first argument."""
    if head.__class__ is tuple and head[0] in _ALARM_FUNCTORS:
        alarm_event: Term = head[1]
        return alarm_event
    return head
