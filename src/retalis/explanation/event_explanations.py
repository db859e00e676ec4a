"""Explanations of events: why an event happened, or why it did not (why- and why-not provenance).

If the event happened, its lineage is shown as a tree: the rule that fired it, and recursively the events that
matched. If it did not, each rule whose head unifies with the event is evaluated by `WhyNot` over the recorded events,
and missing events are explained recursively. `WhyNotSent` explains in the same way why subscriptions did not publish.

The engine must record lineage (flag ``etalis_justification``, `record_origins`). An explanation takes time that grows
with the number of recorded events, so callers that serve others set a limit.
"""

from contextlib import closing
from time import monotonic
from typing import Any, Callable, Dict, Iterator, List, NamedTuple, Optional, Sequence, Set, Tuple, Union

from ..engine.engine import Engine
from ..engine.loaded_items import LoadedProgram
from ..events.checks.program_model import MIN_SIMILARITY
from ..events.knowledge.event_states import DeclaredState, OpenState
from ..events.knowledge.subscriptions import Subscription, SubscriptionKey
from ..events.language.pattern_tree import AggregatePattern, RatePattern, WindowPattern, walk
from ..events.language.stream_parser import subscription_event
from ..events.matches.network_options import AfterMatchSkipStrategy
from ..events.network.event_rule import EventRule
from ..events.network.lineage_graph import Occurrence
from ..foundation.cancellation import check_limits, set_limit_check
from ..foundation.errors import RetalisError, UsageError, format_count
from ..foundation.similar_names import did_you_mean
from ..prolog.syntax.term_reader import read_term
from ..prolog.system.prolog_system import PrologSystem
from ..prolog.terms import timestamps
from ..prolog.terms.list_terms import list_items
from ..prolog.terms.term_traversal import copy
from ..prolog.terms.types import Atom, Term, Trail, Var, atom, deref, functor, functor_name
from ..prolog.terms.unification import undo, unify
from .why_not import PartResult, TimeFormat, WhyNot, names_of_bound_variables, show_term

_COMMA_FUNCTOR = functor(",", 2)
_MAX_SUBSCRIPTIONS = 20
"""Maximum number of subscriptions in an explanation."""


class _SubscriptionCopy(NamedTuple):
    """A subscription with variables of its own.

    Attributes:
        description: id and topic, for the explanation.
        event: pattern of the events that it selects.
        conditions: list of goals.
        template: the message that it publishes.
    """

    description: str
    event: Term
    conditions: Term
    template: Term


class WhyNotSent:
    """Why-not provenance of subscriptions: why they did not select events that happened.

    Args:
        logic: evaluates conditions.
        subscriptions: subscriptions of the program, with their topics and ids.
        show: returns the text of a term.
    """

    def __init__(
        self,
        logic: PrologSystem,
        subscriptions: Sequence[Tuple[SubscriptionKey, Subscription]],
        show: Callable[[Term], str],
    ):
        self._logic = logic
        self._subscriptions = subscriptions
        self._show = show

    def explain_rejections(self, event: Term) -> Iterator[str]:
        """Yield a reason for each subscription that has the functor of an event and does not select it.

        At most `_MAX_SUBSCRIPTIONS` reasons are yielded.
        """
        count = 0
        for subscription in self._copy_subscriptions():
            if _get_functor(subscription.event) != _get_functor(event):
                continue
            reason = self._explain_rejection(subscription, event)
            if reason:
                count += 1
                yield f"{subscription.description} does not select it: {reason}"
            if count == _MAX_SUBSCRIPTIONS:
                return

    def find_publishing(self, message: Term) -> Iterator[Tuple[str, _SubscriptionCopy]]:
        """Yield the subscriptions whose template unifies with a message, each with a text about it."""
        count = 0
        for subscription in self._copy_subscriptions():
            template = deref(subscription.template)
            if _get_functor(template) is None or _get_functor(template) != _get_functor(message):
                continue
            # Only tested, not bound: the subscription is used with its own variables afterwards.
            if _unifies(template, message) and count < _MAX_SUBSCRIPTIONS:
                count += 1
                yield (
                    f"{subscription.description} publishes it for {self._show(subscription.event)}",
                    subscription,
                )

    def explain_events(
        self, subscription: _SubscriptionCopy, occurrences: Sequence[Occurrence]
    ) -> Iterator[Tuple[Occurrence, str]]:
        """Yield the events with the functor of a subscription, and the reason if it did not select them, or ""."""
        for occurrence in occurrences:
            if _get_functor(occurrence.term) == _get_functor(subscription.event):
                yield occurrence, self._explain_rejection(subscription, occurrence.term)

    def _copy_subscriptions(self) -> Iterator[_SubscriptionCopy]:
        for (topic, _), subscription in self._subscriptions:
            definition: Any = copy(subscription.definition)
            _, event, conditions, template, *_ = definition
            description = f"subscription {self._show(subscription.id)} of topic {topic}"
            yield _SubscriptionCopy(description, subscription_event(event), conditions, template)

    def _explain_rejection(self, subscription: _SubscriptionCopy, event: Term) -> str:
        """Return the reason why a subscription does not select an event, or "" if it does."""
        check_limits(1)
        # Copied together, so that both share variables. Bindings of one event must not affect the next one.
        pair: Any = copy((_COMMA_FUNCTOR, subscription.event, subscription.conditions))
        _, pattern, conditions = pair
        trail: Trail = []
        try:
            if not unify(pattern, copy(event), trail):
                return f"it selects {self._show(pattern)}"
            goals = list_items(conditions) or []
            goal_texts = [self._show(goal) for goal in goals]
            # The first condition without a solution is the reason: conditions are tested with all those before it.
            for count in range(1, len(goals) + 1):
                reason = self._test_conditions(goals[:count], goals[count:], goal_texts)
                if reason is not None:
                    return f"its condition {goal_texts[count - 1]} {reason}"
            return ""
        finally:
            undo(trail, 0)

    def _test_conditions(
        self, goals: Sequence[Term], later_goals: Sequence[Term], goal_texts: List[str]
    ) -> Optional[str]:
        """Return None if the goals have a solution, otherwise the reason why not.

        With a solution, the texts of ``later_goals``, the last ones of ``goal_texts``, are replaced by texts with the
        values of the solution.
        """
        conjunction = goals[-1]
        for goal in reversed(goals[:-1]):
            conjunction = (_COMMA_FUNCTOR, goal, conjunction)
        try:
            # Closed after the first solution, which undoes its bindings and runs cleanup goals.
            with closing(self._logic.solutions(conjunction)) as solutions:
                for _ in solutions:
                    goal_texts[len(goals) :] = [self._show(goal) for goal in later_goals]
                    return None
        except RetalisError as error:
            return f"ends with an error: {error.message}"
        return "is false"


def _get_functor(term: Any) -> Any:
    """Return the functor of a term, or None for other terms."""
    term = deref(term)
    return term[0] if term.__class__ is tuple else getattr(term, "functor", None)


_EVENT_FUNCTOR = functor("event", 2)
_MAX_SHOWN_OCCURRENCES = 10
_MAX_EXPLANATION_DEPTH = 50
"""Maximum length of a chain of derived events that is shown."""

_EventSource = Union[EventRule, DeclaredState]
"""Part of a program that raises events."""


class ExplanationLine(NamedTuple):
    """A line of an explanation, and the lines below it.

    >>> ExplanationLine("the alarm", [ExplanationLine("the smoke", [])]).below[0].text
    'the smoke'
    """

    text: str
    below: List["ExplanationLine"]

    def indented(self, depth: int = 0) -> Iterator[str]:
        """Yield the line and all lines below it as text, indented by two spaces per level.

        >>> for line in ExplanationLine("the alarm", [ExplanationLine("the smoke", [])]).indented():
        ...     print(line)
        the alarm
          the smoke
        """
        yield "  " * depth + self.text
        for line in self.below:
            yield from line.indented(depth + 1)


class Explanation(NamedTuple):
    """Result of `explain`.

    >>> engine = Engine()
    >>> record_origins(engine)
    >>> engine.load(rules="alarm(X) <- smoke(X) seq heat(X).", source="mine")
    >>> engine.event("smoke(kitchen)", 1)
    >>> isinstance(explain(engine, "alarm(kitchen)"), Explanation)
    True

    Attributes:
        happened: whether the event happened.
        lines: if it happened, a tree for each occurrence; otherwise a tree for each rule that could have fired it,
            and hints such as retracted events.
    """

    happened: bool
    lines: List[ExplanationLine]


def record_origins(engine: Engine) -> None:
    """Enable the recording of event lineage; call this before anything is loaded.

    >>> engine = Engine()
    >>> record_origins(engine)
    >>> engine.load(rules="alarm(X) <- smoke(X) seq heat(X).", source="mine")
    >>> engine.event("smoke(kitchen)", 1)
    >>> print(explain(engine, "smoke(_)").lines[0].text)
    smoke(kitchen) at 1 came from outside
    """
    engine.program.rules.flags.set_default("etalis_justification", atom("on"))


def records_origins(engine: Engine) -> bool:
    """Return whether an engine records the lineage of events (`record_origins`).

    >>> engine = Engine()
    >>> record_origins(engine)
    >>> records_origins(engine)
    True
    """
    return engine.program.rules.flags.is_on("etalis_justification")


def explain(
    engine: Engine, asked: Union[str, Term], seconds: Optional[float] = None, origin: Optional[int] = None
) -> Explanation:
    """Explain why an event happened, or what was missing for it.

    A line about a part of a pattern begins with ``+`` if the part matched, ``-`` if it did not, and ``?`` if it was
    never tested.

    >>> engine = Engine()
    >>> record_origins(engine)
    >>> engine.load(rules="alarm(X) <- smoke(X) seq heat(X).", source="mine")
    >>> engine.event("smoke(kitchen)", 1)
    >>> why = explain(engine, "alarm(kitchen)")
    >>> why.happened
    False
    >>> for line in why.lines[0].indented():
    ...     print(line)
    rule alarm(kitchen) <- smoke(kitchen) seq heat(kitchen) (mine:1)
      - seq: one side is missing
        + smoke(kitchen): at 1
        - heat(kitchen): did not happen

    Args:
        engine: engine that has run with the flag ``etalis_justification`` (`record_origins`).
        asked: the event as a term or its text, with variables for unknown arguments; or ``event(TERM,[T1,T2])`` to
            specify the interval as well.
        seconds: time limit in seconds, during which the engine processes no events; None for no limit.
        origin: show times in seconds relative to this time, in nanoseconds since the epoch; None for absolute times.

    Raises:
        UsageError: if ``asked`` is not an event, or the time limit is exceeded.
        SyntaxFault: if the text is not a term.
    """
    # Parsed outside the engine, so that syntax errors do not interrupt it.
    term = read_term(asked, engine.operators, "explain").term if isinstance(asked, str) else asked

    def create_explanation() -> Explanation:
        if seconds is None:
            return _Explainer(engine.program, origin).explain(term)
        # Unification and conditions call `check_limits` in between, which calls the function that is registered here.
        previous = set_limit_check(_create_time_check(monotonic() + seconds, seconds))
        try:
            return _Explainer(engine.program, origin).explain(term)
        finally:
            set_limit_check(previous)

    # Executed between events: the recorded events do not change meanwhile.
    return engine.do(create_explanation)


def _create_time_check(end: float, seconds: float) -> Callable[[int, int], None]:
    """Return a function for `set_limit_check` that raises an error after the time limit."""

    def check_time(work: int, size: int) -> None:
        if monotonic() > end:
            raise UsageError(f"no explanation within {seconds:g} s: there are too many recorded events")

    return check_time


class _Explainer:
    """Creates the explanation of one call of `explain`.

    Args:
        program: the program of the engine.
        reference_time: as ``origin`` of `explain`.
    """

    def __init__(self, program: LoadedProgram, reference_time: Optional[int]):
        self._program = program
        self._reference_time = reference_time
        self._occurrences = self._program.rules.network.tracker.remembered_events()
        self._times = TimeFormat(self._show, reference_time, self._occurrences)
        self._why_not_sent = WhyNotSent(
            self._program.logic, self._program.knowledge.subscriptions.items(), self._show
        )
        self._expanded_ids: Set[int] = set()
        """Ids of the occurrences whose causes have been shown."""
        self._has_explanation: Dict[str, bool] = {}
        """For each missing event: whether it has an explanation above; False while it is being explained."""
        self._causes_by_id: Optional[Dict[int, List[Occurrence]]] = None

    def explain(self, request: Term) -> Explanation:
        """Return the explanation of a request; see ``asked`` of `explain`."""
        term, interval = _parse_request(request)
        occurrences = self._find_occurrences(term, interval)
        if not occurrences:
            # A part of a rule can be the asked event again.
            if interval is None:
                self._has_explanation[self._show(term)] = False
            return Explanation(False, self._explain_missing(term, interval, ()))
        lines = [
            self._explain_occurrence(occurrence, 0) for occurrence in occurrences[:_MAX_SHOWN_OCCURRENCES]
        ]
        # An event that happened can still be missing on a topic.
        for occurrence, line in zip(occurrences, lines):
            line.below.extend(
                ExplanationLine(text, []) for text in self._why_not_sent.explain_rejections(occurrence.term)
            )
        if len(occurrences) > _MAX_SHOWN_OCCURRENCES:
            lines.append(
                ExplanationLine(
                    f"and {format_count(len(occurrences) - _MAX_SHOWN_OCCURRENCES, 'more time')}", []
                )
            )
        return Explanation(True, lines)

    def _find_occurrences(self, term: Term, interval: Optional[Tuple[int, int]]) -> List[Occurrence]:
        """Return the recorded occurrences of an event."""
        # One event, as the dashboard asks for it, is found by its term in an index. The search below takes a second
        # if 100,000 events are recorded.
        candidates: Sequence[Occurrence] = (
            () if interval is None else self._program.rules.network.tracker.occurrences_of(term)
        ) or [occurrence for occurrence in self._occurrences if _unifies(occurrence.term, term)]
        if interval is None:
            return list(candidates)
        return [occurrence for occurrence in candidates if _has_interval(occurrence, interval)]

    def _causes_of(self, occurrence: Occurrence) -> List[Occurrence]:
        """Return the occurrences from which an occurrence without a match was derived."""
        if self._causes_by_id is None:
            # Occurrences only refer to what they were derived into, so the opposite direction is built once.
            self._causes_by_id = {}
            for cause in self._occurrences:
                for derived in cause.derived:
                    if derived.match is None:
                        self._causes_by_id.setdefault(id(derived), []).append(cause)
        return self._causes_by_id.get(id(occurrence), [])

    def _explain_occurrence(self, occurrence: Occurrence, depth: int) -> ExplanationLine:
        """Return the explanation of an occurrence.

        A subtree that was shown before is replaced by "see above", one that is too deep by "...".
        """
        text = self._format_event(occurrence)
        if occurrence.retracts is not None:
            return ExplanationLine(
                f"{text} retracts",
                [ExplanationLine(self._format_event(retracted), []) for retracted in occurrence.retracts],
            )
        source_occurrences = occurrence.sources() or self._causes_of(occurrence)
        if occurrence.match is None and not source_occurrences:
            origin = (
                "came from outside"
                if occurrence.rule is None
                else f"by {self._format_rule(occurrence.rule)}: what it came from is no longer recorded"
            )
            return ExplanationLine(f"{text} {origin}", [])
        # Shared causes would make the tree grow exponentially, so each occurrence is expanded once.
        if id(occurrence) in self._expanded_ids or depth > _MAX_EXPLANATION_DEPTH:
            return ExplanationLine(
                f"{text}, see above" if depth <= _MAX_EXPLANATION_DEPTH else f"{text} ...", []
            )
        self._expanded_ids.add(id(occurrence))
        sources = [self._explain_occurrence(source, depth + 1) for source in source_occurrences]
        if occurrence.rule is None:
            verb = "has ended; it began and ended with" if self._is_state(occurrence) else "was released by"
            return ExplanationLine(f"{text} {verb}", sources)
        return ExplanationLine(f"{text} by {self._format_rule(occurrence.rule)}", sources)

    def _is_state(self, occurrence: Occurrence) -> bool:
        return bool(self._program.knowledge.states.declarations_with_functor_of(occurrence.term))

    def _explain_missing(
        self, term: Term, interval: Optional[Tuple[int, int]], above: Tuple[_EventSource, ...]
    ) -> List[ExplanationLine]:
        """Return the missing parts for each rule and declared state that could have raised the event.

        Args:
            term: the event, which did not happen.
            interval: its interval; None if any.
            above: rules and states in whose explanation the event is missing, outermost first; () for the
                event of the request.
        """
        lines = []
        for rule in self._program.rules.rules:
            head = rule.definition.head
            # Rules above are skipped: a recursive rule would explain its event by itself forever.
            if head is None or rule in above:
                continue
            trail: Trail = []
            # The variables of the loaded rule are bound, so a time limit must not end this without `undo`.
            try:
                if unify(_get_head_event(head), copy(term), trail):
                    lines.append(self._explain_rule(rule, interval, above))
            finally:
                undo(trail, 0)
        lines += self._explain_states(term, above)
        if not above:
            lines += self._explain_missing_messages(term)
            if not lines:
                hint = did_you_mean(functor_name(deref(term)), self._collect_event_names(), MIN_SIMILARITY)
                lines.append(
                    ExplanationLine(f"no rule has such a head, and no such event came from outside{hint}", [])
                )
            lines += self._find_retracted(term) + self._find_events_with_name(term)
        return lines

    def _explain_missing_once(
        self, term: Term, above: Tuple[_EventSource, ...]
    ) -> Tuple[str, List[ExplanationLine]]:
        """Return the lines about a missing event, and the end of the text of the line that they belong to.

        Alternative rules that share missing events would make the tree grow exponentially, so each event is explained
        once. The text refers to that explanation afterwards.
        """
        key = self._show(term)
        if key in self._has_explanation:
            return (", see above" if self._has_explanation[key] else ""), []
        self._has_explanation[key] = False
        lines = self._explain_missing(term, None, above)
        self._has_explanation[key] = bool(lines)
        return "", lines

    def _explain_rule(
        self, rule: EventRule, interval: Optional[Tuple[int, int]], above: Tuple[_EventSource, ...]
    ) -> ExplanationLine:
        """Return why a rule, whose head is unified with the missing event, did not fire."""
        why_not = WhyNot(self._program.logic, self._occurrences, rule, self._reference_time)
        part = why_not.evaluate(rule.definition.pattern)
        line = ExplanationLine(self._format_rule(rule), [self._explain_part(part, (*above, rule))])
        if part.matches:
            line.below.append(ExplanationLine(f"- but {_explain_no_firing(rule, part, interval)}", []))
        return line

    def _explain_states(self, term: Term, above: Tuple[_EventSource, ...]) -> List[ExplanationLine]:
        """Return which declared states are open for an event at the end of a state, or why none has begun."""
        lines = []
        for declaration in self._program.knowledge.states.declarations_with_functor_of(term):
            # Two states can begin with the ends of each other.
            if declaration in above:
                continue
            open_lines = [
                self._explain_open_state(state)
                for state in declaration.open.values()
                if state.start is not None and _unifies(state.term, term)
            ]
            if open_lines:
                lines += open_lines[-_MAX_SHOWN_OCCURRENCES:]
                continue
            pair: Any = copy((_COMMA_FUNCTOR, declaration.form.state, declaration.form.begin_event))
            _, state_term, begin_event = pair
            # Only variables of the copies are bound, so no binding has to be undone.
            if unify(state_term, copy(term), []):
                begin_occurrences = self._find_occurrences(begin_event, None)
                text = f"state {self._show(state_term)} is not open"
                below: List[ExplanationLine] = []
                if begin_occurrences:
                    text += f", though {self._format_event(begin_occurrences[-1])} begins it"
                else:
                    reference, below = self._explain_missing_once(begin_event, (*above, declaration))
                    text += f": {self._show(begin_event)}, which begins it, did not happen{reference}"
                lines.append(ExplanationLine(text, below))
        return lines

    def _explain_open_state(self, state: OpenState) -> ExplanationLine:
        # `openings` omits those whose events were retracted, so the first one is valid.
        start = state.start or 0
        _, beginning = state.openings[0]
        since = self._times.format_instant(start)
        return ExplanationLine(
            f"state {self._show(state.term)} is open since {since}: it becomes an event when it ends",
            [] if beginning is None else [self._explain_occurrence(beginning, 1)],
        )

    def _collect_event_names(self) -> List[str]:
        """Return the names of the events that the program receives or raises, or that happened."""
        heads = [
            rule.definition.head for rule in self._program.rules.rules if rule.definition.head is not None
        ]
        terms = [*map(_get_head_event, heads), *(occurrence.term for occurrence in self._occurrences)]
        listened_names = self._program.rules.dispatcher.listened_names()
        return [*listened_names, *(functor_name(deref(term)) for term in terms)]

    def _explain_missing_messages(self, term: Term) -> List[ExplanationLine]:
        """Return the subscriptions that publish such messages, and the reasons for their events."""
        lines = []
        for text, subscription in self._why_not_sent.find_publishing(term):
            reasons = list(self._why_not_sent.explain_events(subscription, self._occurrences))[
                -_MAX_SHOWN_OCCURRENCES:
            ]
            below = [
                ExplanationLine(f"{self._format_event(occurrence)}: {reason or 'sent'}", [])
                for occurrence, reason in reasons
            ]
            lines.append(ExplanationLine(text, below or [ExplanationLine("no such event happened", [])]))
        return lines

    def _explain_part(self, part: PartResult, above: Tuple[_EventSource, ...]) -> ExplanationLine:
        """Return the line of a part of a pattern; a missing event is explained below it."""
        below = [self._explain_part(inner, above) for inner in part.parts]
        reference = ""
        if part.event is not None and not part.matches:
            reference, lines = self._explain_missing_once(part.event, above)
            below += lines
        return ExplanationLine(f"{part.symbol} {part.text}{reference}", below)

    def _find_retracted(self, term: Term) -> List[ExplanationLine]:
        """Return matching events that happened and were retracted."""
        retracted = [
            occurrence
            for revision in self._occurrences
            for occurrence in revision.retracts or ()
            if _unifies(occurrence.term, term)
        ]
        return [
            ExplanationLine(f"{self._format_event(occurrence)} was retracted", [])
            for occurrence in retracted[-_MAX_SHOWN_OCCURRENCES:]
        ]

    def _find_events_with_name(self, term: Term) -> List[ExplanationLine]:
        """Return events of the same name that happened."""
        name = functor_name(deref(term))
        texts: Dict[str, None] = {}
        for occurrence in self._occurrences:
            if functor_name(deref(occurrence.term)) == name:
                texts.setdefault(self._format_event(occurrence))
        if not texts:
            return []
        shown = list(texts)[-_MAX_SHOWN_OCCURRENCES:]
        return [
            ExplanationLine(
                f"{len(texts)} of this name happened", [ExplanationLine(text, []) for text in shown]
            )
        ]

    def _format_rule(self, rule: EventRule) -> str:
        place = "" if rule.place is None else f" ({rule.place.source}:{rule.place.line})"
        label = "" if rule.label is None else f"{self._show(rule.label)}: "
        names = rule.definition.names
        text = show_term(
            rule.definition.term, self._program.logic.operators, names_of_bound_variables(names), names
        )
        return f"rule {label}{text}{place}"

    def _format_event(self, occurrence: Occurrence) -> str:
        return (
            f"{self._show(occurrence.term)} {self._times.format_interval(occurrence.start, occurrence.end)}"
        )

    def _show(self, term: Term) -> str:
        return show_term(term, self._program.logic.operators, {})


def _parse_request(request: Term) -> Tuple[Term, Optional[Tuple[int, int]]]:
    """Return the event of a request, and its interval in ns or None; see ``asked`` of `explain`."""
    request = deref(request)
    if request.__class__ is tuple and request[0] is _EVENT_FUNCTOR:
        stamps = list_items(request[2])
        if stamps is not None and len(stamps) == 2:
            return deref(request[1]), (timestamps.from_term(stamps[0]), timestamps.from_term(stamps[1]))
        raise UsageError("expected event(TERM,[T1,T2])")
    if request.__class__ not in (Atom, tuple):
        type_name = "a variable" if request.__class__ is Var else "a number or string"
        raise UsageError(f"expected an event to explain, not {type_name}")
    return request, None


def _explain_no_firing(rule: EventRule, part: PartResult, interval: Optional[Tuple[int, int]]) -> str:
    """Return why a rule did not fire although all parts of its pattern matched."""
    has_window = any(isinstance(subpattern, WindowPattern) for subpattern in walk(rule.definition.pattern))
    has_interval = any((match.start, match.end) == interval for match in part.matches)
    if interval is not None and not has_window and not has_interval:
        return "no match has that interval"
    if rule.window is not None and all(match.end - match.start > rule.window for match in part.matches):
        return f"all matches exceed the window of the rule's label, {timestamps.to_seconds(rule.window):g} seconds"
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


def _get_head_event(head: Term) -> Term:
    """Return the event of a rule's head; an alarm has it as first argument."""
    if head.__class__ is tuple and head[0] in _ALARM_FUNCTORS:
        alarm_event: Term = head[1]
        return alarm_event
    return head


_ALARM_FUNCTORS = frozenset((functor("exceptionAlarm", 2), functor("exceptionAlarmAbsoluteDatime", 2)))


def _unifies(first: Term, second: Term) -> bool:
    """Return whether two terms without common variables unify; their variables stay unbound."""
    # Only variables of the copies are bound, so no binding has to be undone.
    return bool(unify(copy(first), copy(second), []))


def _has_interval(occurrence: Occurrence, interval: Tuple[int, int]) -> bool:
    return bool((occurrence.start, occurrence.end) == interval)
