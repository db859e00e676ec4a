"""Explanations of events and outputs: why one happened, or why it did not (why- and why-not provenance).

If the event happened, its lineage is shown as a tree (`DerivationTrees`): the rule that fired it, and recursively the
events that matched. If it did not, each rule whose head unifies with the event is evaluated over the recorded events
(`why_not_matched`), and missing events are explained recursively (`why_not_happened`). Subscriptions that did not
publish are explained in the same way (`why_not_published`). An output is explained by the event that its subscription
selects, with the values of the output.

The engine must record lineage (flag ``etalis_justification``, `record_origins`). An explanation takes time that grows
with the number of recorded events, so callers that serve others set a limit.
"""

from time import monotonic
from typing import Any, Callable, Dict, Iterator, List, NamedTuple, Optional, Sequence, Set, Tuple, Union

from ..engine.engine import Engine
from ..engine.loaded_items import LoadedProgram
from ..events.knowledge.event_states import DeclaredState, StateRegistry
from ..events.language.pattern_tree import ConditionPattern, walk
from ..events.language.state_parser import queried_state
from ..events.language.stream_parser import subscription_event
from ..events.network.lineage_graph import Occurrence
from ..foundation.displayed_text import format_count
from ..foundation.errors import RetalisError, UsageError
from ..foundation.limit_checks import check_limits, set_limit_check
from ..foundation.ros_name_checks import strip_slashes
from ..prolog.syntax.term_reader import read_term
from ..prolog.terms import timestamps
from ..prolog.terms.list_terms import conjuncts, list_items
from ..prolog.terms.term_traversal import copy, is_ground
from ..prolog.terms.types import Atom, Term, Trail, Var, atom, deref, functor, functor_name
from ..prolog.terms.unification import may_unify, undo, unify
from .explanation_lines import MAX_LINES_OF_A_KIND, Explanation, ExplanationLine, ExplanationTexts
from .why_not_happened import RequestedInterval, WhyNotHappened, event_of_head
from .why_not_published import WhyNotPublished

MAX_DEPTH = 50
"""Maximum length of a chain of derived events that is shown."""

MAX_EXPLAINED_SUBSCRIPTIONS = 2
"""Maximum number of subscriptions in the explanation of an output."""

_EVENT_FUNCTOR = functor("event", 2)


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
            specify the interval as well. With ``origin``, numbers are seconds relative to it, as in the lines.
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
            return _explain_request(engine.program, term, origin)
        # Unification and conditions call `check_limits` in between, which calls the function that is registered here.
        previous = set_limit_check(_create_time_check(monotonic() + seconds, seconds))
        try:
            return _explain_request(engine.program, term, origin)
        finally:
            set_limit_check(previous)

    # Executed between events: the recorded events do not change meanwhile.
    return engine.do(create_explanation)


MAX_BRIEF_LINES = 12
"""Maximum number of lines of a brief explanation."""

MAX_BRIEF_SECONDS = 5.0
"""Limit in seconds for a brief explanation."""


def explain_briefly(engine: Engine, event: Term, origin: int) -> List[str]:
    """Return the first lines of the explanation of an event for a report, or the reason why there is none.

    Args:
        engine: see `explain`.
        event: the event.
        origin: time to which the times in the lines are relative, in nanoseconds since the epoch.
    """
    try:
        explanation = explain(engine, event, MAX_BRIEF_SECONDS, origin)
    except RetalisError as error:
        return [error.message]
    lines = [line for tree in explanation.lines for line in tree.indented()]
    return lines if len(lines) <= MAX_BRIEF_LINES else [*lines[:MAX_BRIEF_LINES], "..."]


def event_request(term: Term, start: int, end: int) -> Term:
    """Return the request for `explain` of the event with an interval, in nanoseconds since the epoch."""
    # Without the forms of the stamps: numbers could be read as relative times.
    return (_EVENT_FUNCTOR, term, timestamps.interval_term(int(start), int(end)))


def _create_time_check(end: float, seconds: float) -> Callable[[int, int], None]:
    """Return a function for `set_limit_check` that raises an error after the time limit."""

    def check_time(work: int, size: int) -> None:
        if monotonic() > end:
            raise UsageError(f"no explanation within {seconds:g} s: there are too many recorded events")

    return check_time


class DerivationTrees:
    """Why-provenance: derivation trees of the occurrences of one explanation; each is expanded once.

    Args:
        occurrences: the recorded events.
        states: the declared states of the program, whose ends are events without a rule.
        texts: formats events and rules.
    """

    def __init__(self, occurrences: Sequence[Occurrence], states: StateRegistry, texts: ExplanationTexts):
        self._occurrences = occurrences
        self._states = states
        self._texts = texts
        self._expanded_ids: Set[int] = set()
        """Ids of the occurrences whose causes have been shown."""
        self._causes_by_id: Optional[Dict[int, List[Occurrence]]] = None

    def explain(self, occurrence: Occurrence, depth: int = 0) -> ExplanationLine:
        """Return the derivation tree of an occurrence.

        A subtree that was shown before is replaced by "see above", one that is too deep by "...".
        """
        text = self._texts.format_event(occurrence)
        if occurrence.retracts is not None:
            retracted = [
                ExplanationLine(self._texts.format_event(event), []) for event in occurrence.retracts
            ]
            return ExplanationLine(f"{text} retracts", retracted)
        causes = occurrence.sources() or self._causes_of(occurrence)
        if occurrence.match is None and not causes:
            return ExplanationLine(f"{text} {self._describe_missing_causes(occurrence)}", [])
        if depth > MAX_DEPTH:
            return ExplanationLine(f"{text} ...", [])
        # Shared causes would make the tree grow exponentially, so each occurrence is expanded once.
        if id(occurrence) in self._expanded_ids:
            return ExplanationLine(f"{text}, see above", [])
        self._expanded_ids.add(id(occurrence))
        # The states come first, because a window can have many events.
        below = self._explain_states(occurrence, depth + 1)
        omitted_count = occurrence.omitted_source_count()
        if omitted_count:
            omitted_text = (
                f"... and {format_count(omitted_count, 'older match', 'older matches')} of the window"
            )
            below.append(ExplanationLine(omitted_text, []))
        below += [self.explain(cause, depth + 1) for cause in causes]
        return ExplanationLine(f"{text} {self._describe_derivation(occurrence)}", below)

    def _explain_states(self, occurrence: Occurrence, depth: int) -> List[ExplanationLine]:
        """Return the states that held for the conditions ``holds`` of the rule that fired an event."""
        held_states = []
        for state in _queried_states(occurrence):
            for declaration in self._states.declarations_with_functor_of(state):
                for held in _states_at(declaration, occurrence.end):
                    check_limits(1)
                    if may_unify(held.term, state):
                        held_states.append(held)
        shown_states = held_states[-MAX_LINES_OF_A_KIND:]
        lines = []
        if len(held_states) > len(shown_states):
            count = len(held_states) - len(shown_states)
            lines.append(ExplanationLine(f"... and {format_count(count, 'older state')}", []))
        for held in shown_states:
            since = self._texts.format_instant(held.start)
            text = f"state {self._texts.format_term(held.term)} held since {since}"
            begin = self._find_begin_event(held)
            below = [] if begin is None else [self.explain(begin, depth + 1)]
            lines.append(ExplanationLine(text, below))
        return lines

    def _find_begin_event(self, state: "_HeldState") -> Optional[Occurrence]:
        if state.begin_event is not None or state.end_event is None:
            return state.begin_event
        causes = self._causes_of(state.end_event)
        return next((cause for cause in causes if cause.end == state.start), None)

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

    def _describe_missing_causes(self, occurrence: Occurrence) -> str:
        if occurrence.rule is None:
            return "came from outside"
        return f"by {self._texts.format_rule(occurrence.rule)}: what it came from is no longer recorded"

    def _describe_derivation(self, occurrence: Occurrence) -> str:
        if occurrence.rule is not None:
            return f"by {self._texts.format_rule(occurrence.rule)}"
        is_state = bool(self._states.declarations_with_functor_of(occurrence.term))
        return "has ended; it began and ended with" if is_state else "was released by"


class _HeldState(NamedTuple):
    """A state that held at an instant.

    Attributes:
        term: the state.
        start: the instant since which it held, in ns.
        begin_event: the event with which it began; None if it is unknown.
        end_event: the event that the state became when it ended; None if it is open, or if the event is unknown.
    """

    term: Term
    start: int
    begin_event: Optional[Occurrence]
    end_event: Optional[Occurrence]


def _states_at(declaration: DeclaredState, instant: int) -> Iterator[_HeldState]:
    """Yield the states of a declaration that held at an instant in ns, oldest first."""
    for past in declaration.past:
        if past.start <= instant <= past.end and not past.retracted:
            yield _HeldState(past.term, past.start, None, past.token)
    for state in declaration.open.values():
        start = state.start
        if start is not None and start <= instant:
            yield _HeldState(state.term, start, state.openings[0][1], None)


def _queried_states(occurrence: Occurrence) -> List[Term]:
    """Return the states that the conditions of a rule query, with the values of the event that it has fired."""
    rule = occurrence.rule
    if rule is None or rule.definition.head is None:
        return []
    states: List[Term] = []
    trail: Trail = []
    try:
        unify(event_of_head(rule.definition.head), copy(occurrence.term), trail)
        for part in walk(rule.definition.pattern):
            if isinstance(part, ConditionPattern):
                # `holds_at` queries another instant.
                states += [
                    copy(goal[1])  # type: ignore[index]
                    for goal in conjuncts(part.goal)
                    if queried_state(goal) and functor_name(goal) == "holds"
                ]
    finally:
        undo(trail, 0)
    return states


def _explain_request(program: LoadedProgram, request: Term, reference_time: Optional[int]) -> Explanation:
    """Return the explanation of a request; see ``asked`` and ``origin`` of `explain`."""
    event, interval = _parse_request(request, reference_time)
    recorded = program.rules.network.tracker.remembered_events()
    texts = ExplanationTexts(program.logic.operators, reference_time, recorded)
    subscriptions = program.knowledge.subscriptions.items()
    why_not_published = WhyNotPublished(program.logic, subscriptions, texts.format_term)
    derivations = DerivationTrees(recorded, program.knowledge.states, texts)
    occurrences = _find_occurrences(program, recorded, event, interval)
    if not occurrences:
        why_not_happened = WhyNotHappened(
            program, recorded, reference_time, texts, derivations, why_not_published
        )
        return Explanation(False, why_not_happened.explain(event, interval))
    shown = occurrences[:MAX_LINES_OF_A_KIND]
    lines = [derivations.explain(occurrence) for occurrence in shown]
    # An event that happened can still be missing on a topic.
    for occurrence, line in zip(shown, lines):
        rejections = why_not_published.explain_rejections(occurrence.term)
        line.below.extend(ExplanationLine(text, []) for text in rejections)
    if len(occurrences) > len(shown):
        text = f"and {format_count(len(occurrences) - len(shown), 'more time')}"
        lines.append(ExplanationLine(text, []))
    return Explanation(True, lines)


def _find_occurrences(
    program: LoadedProgram, recorded: Sequence[Occurrence], event: Term, interval: Optional[RequestedInterval]
) -> List[Occurrence]:
    """Return the recorded occurrences of an event, those with an interval if there is one."""
    # One event, as the dashboard asks for it, is found by its term in an index. The search below takes a second if
    # 100,000 events are recorded.
    indexed: Sequence[Occurrence] = (
        () if interval is None else program.rules.network.tracker.occurrences_of(event)
    )
    candidates = indexed or [occurrence for occurrence in recorded if may_unify(occurrence.term, event)]
    return [
        occurrence
        for occurrence in candidates
        if interval is None or interval.equals(occurrence.start, occurrence.end)
    ]


def _parse_request(request: Term, reference_time: Optional[int]) -> Tuple[Term, Optional[RequestedInterval]]:
    """Return the event of a request, and its interval or None; see ``asked`` and ``origin`` of `explain`."""
    request = deref(request)
    if request.__class__ is tuple and request[0] is _EVENT_FUNCTOR:
        stamps = list_items(request[2])
        if stamps is not None and len(stamps) == 2:
            start, end = map(timestamps.from_term, stamps)
            if reference_time is None or not all(deref(stamp).__class__ in (int, float) for stamp in stamps):
                return deref(request[1]), RequestedInterval(start, end)
            interval = RequestedInterval(start + reference_time, end + reference_time, reference_time)
            return deref(request[1]), interval
        raise UsageError("expected event(TERM,[T1,T2])")
    if request.__class__ not in (Atom, tuple):
        type_name = "a variable" if request.__class__ is Var else "a number or string"
        raise UsageError(f"expected an event to explain, not {type_name}")
    return request, None


class ExplainedOutput(NamedTuple):
    """An output that was published, or that was expected.

    Attributes:
        topic: its topic; None for any.
        term: its term, with variables for parts of any value; None for any.
        time: its time in nanoseconds since the epoch; None if it is unknown.
    """

    topic: Optional[str]
    term: Optional[Term]
    time: Optional[int]


class _SelectedEvent(NamedTuple):
    """Event of a subscription, as request of an explanation.

    Attributes:
        text: the subscription, and the pattern that it selects with the values of the output.
        request: the event nearest to the time of the output, with its interval; the pattern if there is none.
    """

    text: str
    request: Term


def explain_output_briefly(engine: Engine, output: ExplainedOutput, origin: int) -> List[str]:
    """Return the first lines of the explanation of an output, for a report.

    Args:
        engine: engine that has run with the recording of lineage (`record_origins`).
        output: the output.
        origin: time to which the times in the lines are relative, in nanoseconds since the epoch.
    """
    # Executed between events: the recorded events do not change meanwhile.
    selected_events = engine.do(lambda: list(_find_selected_events(engine, output)))
    lines = []
    for selected in selected_events[:MAX_EXPLAINED_SUBSCRIPTIONS]:
        lines.append(selected.text)
        lines += [f"  {line}" for line in explain_briefly(engine, selected.request, origin)]
    if lines:
        return lines
    topic = "" if output.topic is None else f" of topic {output.topic}"
    return [f"no subscription{topic} publishes such a term"]


def _find_selected_events(engine: Engine, output: ExplainedOutput) -> Iterator[_SelectedEvent]:
    """Yield the event of each subscription that can publish an output."""
    program = engine.program
    occurrences = program.rules.network.tracker.remembered_events()
    for (topic, _), subscription in program.knowledge.subscriptions.items():
        if output.topic is not None and strip_slashes(topic) != strip_slashes(output.topic):
            continue
        # A copy, whose variables are bound to the values of the output.
        definition: Any = copy(subscription.definition)
        _, pattern, _, template, *_ = definition
        event = subscription_event(pattern)
        # Without a template, the event itself is published.
        published = event if deref(template).__class__ is Var else template
        if output.term is not None and not unify(published, copy(output.term), []):
            continue
        candidates = [occurrence for occurrence in occurrences if may_unify(occurrence.term, event)]
        request, note = copy(event), ""
        if candidates:
            nearest = min(candidates, key=lambda event: _distance(event, output.time))
            request = event_request(nearest.term, nearest.start, nearest.end)
            # An output is published at the end of its event, or later if its rate is limited.
            if output.time is not None and nearest.end != output.time:
                note = ", which ended at another time" if is_ground(event) else "; the nearest event is"
        name = program.logic.brief(subscription.id)
        text = f"subscription {name} of topic {topic} publishes it for {program.logic.brief(event)}{note}"
        yield _SelectedEvent(text, request)


def _distance(event: Occurrence, time: Optional[int]) -> int:
    """Return the time between the end of an event and an output; the first event is the nearest without time."""
    return 0 if time is None else abs(event.end - time)
