"""Checks of times: intervals that cannot meet, spans of time, limits that no match can satisfy, and timers.

`find_impossible_pairs` computes which events are always instants (messages, and heads of rules on single instants),
and evaluates the comparisons of each operator for a small set of intervals that represents all possible orders.
`find_unreachable_limits` computes the shortest interval that a match of each part of a pattern can have.
"""

from itertools import combinations_with_replacement
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Sequence, Set, Tuple

from ...foundation.displayed_text import format_duration, format_number
from ...foundation.errors import RuleError
from ...foundation.ros_name_checks import strip_slashes
from ...prolog.terms.term_traversal import term_key
from ...prolog.terms.types import Atom, Functor, Var, deref, functor, functor_of
from ..language.called_predicates import Subgoal, conjunctions
from ..language.event_operators import OPERATOR_NAMES, PAIR_OPERATORS
from ..language.pattern_tree import (
    AbsencePattern,
    ActionPattern,
    ConditionPattern,
    EventPattern,
    InstantPattern,
    OrPattern,
    PairPattern,
    Pattern,
    RatePattern,
    RepeatedPattern,
    WindowPattern,
    WithinPattern,
    children,
    walk,
)
from ..language.rule_heads import event_raised_by
from ..language.timer_schedules import TIMER, schedule_error
from ..streams.rate_operators import RATE_OPERATORS
from .program_model import ProgramModel, SourceRule, Subterm, operator_place, subterms, wrap_term

SECONDS_PER_DAY = 86_400
_UNIT_HINT = "spans are in seconds"
_NEW_EVENT_INTERVAL = functor("new_event", 3)


_SAMPLE_INSTANTS = [(instant, instant) for instant in range(3)]
_SAMPLE_INTERVALS = list(combinations_with_replacement(range(5), 2))


def find_impossible_pairs(program: ProgramModel) -> Iterator[RuleError]:
    """Yield joins whose operands can never have the required intervals, because one operand is always an instant."""
    instants = _InstantEvents(program)
    for rule in program.rules:
        for node in walk(rule.definition.pattern, negated=True):
            if isinstance(node, PairPattern) and node.operator in PAIR_OPERATORS:
                left_is_instant, right_is_instant = (
                    instants.is_instant(node.left),
                    instants.is_instant(node.right),
                )
                if (left_is_instant or right_is_instant) and not _can_match(
                    node.operator, left_is_instant, right_is_instant
                ):
                    instant_sides = (
                        "both sides are instants"
                        if left_is_instant and right_is_instant
                        else f"the {'left' if left_is_instant else 'right'} side is an instant"
                    )
                    requirement = _REQUIREMENTS.get(node.operator, "asks for intervals")
                    yield RuleError(
                        f"{node.operator} never matches here: {instant_sides}, and "
                        f"{PAIR_OPERATORS[node.operator].name} {requirement}",
                        operator_place(rule, node.operator),
                    )


_REQUIREMENTS = {
    "par": "asks for two that overlap by more than an instant: write and, or seq",
    "starts": "asks for two that start together and end one after the other",
    "finishes": "asks for two that end together and started one after the other",
}


def _can_match(operator: str, left_is_instant: bool, right_is_instant: bool) -> bool:
    """Return whether the comparisons of an operator hold for some intervals; an instant starts and ends together."""
    comparisons = PAIR_OPERATORS[operator].comparisons
    # The comparisons depend on the order of four end points only, and five values for intervals and three
    # for instants are enough for every order.
    for s1, e1 in _SAMPLE_INSTANTS if left_is_instant else _SAMPLE_INTERVALS:
        for s2, e2 in _SAMPLE_INSTANTS if right_is_instant else _SAMPLE_INTERVALS:
            values = {"s1": s1, "e1": e1, "s2": s2, "e2": e2}
            if all(_comparison_holds(comparison, values) for comparison in comparisons):
                return True
    return False


def _comparison_holds(comparison: str, values: Dict[str, int]) -> bool:
    left_name, sign, right_name = comparison.split()
    left_value, right_value = values[left_name], values[right_name]
    return {"<": left_value < right_value, "<=": left_value <= right_value, "==": left_value == right_value}[
        sign
    ]


class _InstantEvents:
    """Events that are always instants: messages, and heads of rules with one such event, except alarms."""

    def __init__(self, program: ProgramModel):
        self._program = program
        self._rules_by_event: Dict[Functor, List[SourceRule]] = {}
        self._functors_in_goals: Set[Functor] = set()
        for rule in program.rules:
            key = None if rule.definition.head is None else functor_of(event_raised_by(rule.definition.head))
            if key is not None:
                self._rules_by_event.setdefault(key, []).append(rule)
        for subterm in program.all_subterms():
            term = subterm.term
            if (
                term.__class__ is tuple
                and term[0].name in ("new_event", "event", "input_event")
                and len(term) > 1
            ):
                key = functor_of(term[1])
                # ``new_event/3`` sets an interval; a goal with a variable may raise any event.
                if key is not None and term[0] is not _NEW_EVENT_INTERVAL:
                    self._functors_in_goals.add(key)
                elif key is None:
                    self._functors_in_goals.add(_ANY_EVENT)

        self._instant_functors = self._find_instant_heads()

    def is_instant(self, pattern: Pattern) -> bool:
        """Return whether each match of a pattern is an instant."""
        events = alternative_events(pattern)
        return events is not None and all(
            key in self._instant_functors or self.is_message(key) for key in events
        )

    def is_message(self, key: Functor) -> bool:
        return key not in self._rules_by_event and is_message(self._program, key)

    def _find_instant_heads(self) -> Set[Functor]:
        """Return the functors of heads that are always instants, also through chains of rules."""
        missing_instants: Dict[Functor, Set[Functor]] = {}
        dependents: Dict[Functor, List[Functor]] = {}
        for key, rules in self._rules_by_event.items():
            required = (
                None
                if key in self._functors_in_goals or _ANY_EVENT in self._functors_in_goals
                else _events_that_must_be_instants(rules)
            )
            if required is not None:
                missing_instants[key] = {
                    required_key for required_key in required if not self.is_message(required_key)
                }
                for required_key in missing_instants[key]:
                    dependents.setdefault(required_key, []).append(key)
        instants: Set[Functor] = set()
        # A worklist instead of recursion: rules can form chains of any length.
        ready = [key for key, required in missing_instants.items() if not required]
        while ready:
            instant = ready.pop()
            instants.add(instant)
            for key in dependents.get(instant, ()):
                missing_instants[key].discard(instant)
                if not missing_instants[key]:
                    ready.append(key)
        return instants


def is_message(program: ProgramModel, key: Functor) -> bool:
    """Return whether events of a functor are messages of a subscribed topic."""
    type_name = program.type_of(key.name)
    topics = (*program.topics.subscribed, *program.directly_subscribed)
    return type_name is not None and any(topic_type == type_name for _, topic_type in topics)


def _events_that_must_be_instants(rules: List[SourceRule]) -> Optional[Set[Functor]]:
    """Return the events that must be instants for the heads of rules to be instants, or None if they never are."""
    required: Set[Functor] = set()
    for rule in rules:
        head: Any = rule.definition.head
        events = alternative_events(rule.definition.pattern) if event_raised_by(head) is deref(head) else None
        if events is None:
            return None
        required.update(events)
    return required


def alternative_events(pattern: Pattern) -> Optional[Set[Functor]]:
    """Return the functors of the events that each match a pattern alone.

    Returns:
        None if a match consists of several events, or if any event matches.
    """
    events: Set[Functor] = set()
    stack: List[Pattern] = [pattern]
    while stack:
        node = stack.pop()
        key = functor_of(node.term) if isinstance(node, EventPattern) else None
        if key is not None:
            events.add(key)
        elif isinstance(node, (OrPattern, ConditionPattern, WithinPattern, ActionPattern)):
            stack += children(node)
        else:
            return None
    return events


_ANY_EVENT = functor("$any", 0)


def find_unlikely_spans(program: ProgramModel) -> Iterator[RuleError]:
    """Yield unlikely time spans: more than a day, and for properties also zero."""
    for rule in program.rules:
        for subterm in subterms(wrap_term(rule.definition.term), 1, rule.place_of):
            term = subterm.term
            if term.__class__ is tuple and OPERATOR_NAMES.get(term[0]) == "within" and len(term) == 3:
                problem = _explain_long_span(deref(term[2]))
                if problem:
                    yield RuleError(f"within {problem}", rule.place_of(term, 2))
    labels = {
        term_key(rule.definition.label): rule for rule in program.rules if rule.definition.label is not None
    }
    for key, properties in program.rule_base.all_properties().items():
        for prop in properties:
            problem = ""
            if prop.is_known and prop.word_value is None and "step" not in prop.name:
                problem = (
                    "0: nothing but instants is ever matched"
                    if prop.numeric_value == 0
                    else _explain_long_span(prop.numeric_value)
                )
                # A time to live may be long, and 0 turns it off.
                problem = "" if prop.name == "ttl" else problem
            if problem:
                rule_of_label = labels.get(key)
                yield RuleError(
                    f"{prop.name} {problem}",
                    None if rule_of_label is None else rule_of_label.definition.place,
                )


def _explain_long_span(span: Any) -> str:
    if span.__class__ not in (int, float) or not span > SECONDS_PER_DAY:
        return ""
    return f"{span} is {span / SECONDS_PER_DAY:.3g} days: {_UNIT_HINT}"


class _SpanNotation(NamedTuple):
    """Position of a span in the arguments of a term, and functor names of terms that contain it; () for any."""

    position: int
    parents: Tuple[str, ...]


TIMED_OPERATORS = tuple(name for name, operator in RATE_OPERATORS.items() if operator.takes_seconds)
"""Names of the rate operators whose first argument is a number of seconds."""

_SPANS = {
    **dict.fromkeys(("within", "absent", "exceptionAlarm"), _SpanNotation(2, ())),
    **dict.fromkeys(TIMED_OPERATORS, _SpanNotation(1, ("with",))),
    **dict.fromkeys(
        ("last", "every", "first"), _SpanNotation(1, ("aggregate", "last", "running", "held", "timer"))
    ),
    "after": _SpanNotation(1, ("timer",)),
    "session": _SpanNotation(1, ("aggregate",)),
    "max": _SpanNotation(1, ("session", "held")),
}
"""Names of terms with a span in seconds."""


class _RecordedPeriod(NamedTuple):
    """Topic of a bag with the mean time between two of its messages in seconds."""

    topic: str
    seconds: float


def find_likely_milliseconds(program: ProgramModel) -> Iterator[RuleError]:
    """Yield spans that were probably written in milliseconds.

    Without a bag, these are numbers of at least 500 that are round in decimal notation but are no whole minutes. With
    a bag, also smaller and rounder ones, if that many milliseconds are at least the period of a topic of the rule.
    """
    periods = _periods_by_rule(program)
    for rule in program.rules:
        rule_term = Subterm(None, wrap_term(rule.definition.term), 1, rule.place_of)
        yield from _find_milliseconds_in(rule_term, periods.get(id(rule.definition)))
    for goal in program.goals:
        yield from _find_milliseconds_in(Subterm(None, goal.parent, goal.position, goal.place_of), None)


def _find_milliseconds_in(source: Subterm, fastest: Optional[_RecordedPeriod]) -> Iterator[RuleError]:
    for subterm in subterms(source.parent, source.position, source.place_of):
        span = _span_of(subterm)
        if span is None or not 0 < span <= SECONDS_PER_DAY:
            continue
        rate = ""
        if fastest is not None and _may_be_milliseconds_of(span, fastest.seconds):
            rate = f"; in the bag, a message of {fastest.topic} arrives every {fastest.seconds:.2g} s"
        if rate or _may_be_milliseconds(span):
            yield RuleError(
                f"{span} is {_format_minutes(span)}, because {_UNIT_HINT}{rate}: for milliseconds write "
                f"{format_number(span / 1000)}",
                subterm.place_of(subterm.term, _SPANS[subterm.term[0].name].position),
            )


def _span_of(subterm: Subterm) -> Any:
    """Return the number of seconds that a term such as ``within(P, 5)`` or ``last(5)`` has, or None."""
    term = subterm.term
    notation = _SPANS.get(term[0].name) if term.__class__ is tuple else None
    if notation is None or len(term) <= notation.position:
        return None
    if notation.parents and subterm.parent[0].name not in notation.parents:
        return None
    # ``last(5, events)`` counts events.
    if any(isinstance(argument, Atom) and argument.name == "events" for argument in map(deref, term[1:])):
        return None
    span = deref(term[notation.position])
    return span if span.__class__ in (int, float) else None


def _may_be_milliseconds(span: float) -> bool:
    return span >= 500 and span % 100 == 0 and span % 60 != 0


def _may_be_milliseconds_of(span: float, period: float) -> bool:
    """Return whether a span may be in milliseconds, given the period of an event in seconds."""
    is_round = span % 50 == 0 and (span % 60 != 0 or span % 1000 == 0)
    return span >= 100 and is_round and span / 1000 >= period


def _format_minutes(seconds: float) -> str:
    return f"{seconds / 3600:.2g} hours" if seconds >= 7200 else f"{seconds / 60:.3g} minutes"


def _periods_by_rule(program: ProgramModel) -> Dict[int, _RecordedPeriod]:
    """Return the most frequent topic of a bag whose messages a rule awaits, directly or by events of other rules.

    The keys are identities of rule definitions.
    """
    rules_by_event: Dict[Functor, List[SourceRule]] = {}
    for rule in program.rules:
        for node in walk(rule.definition.pattern, negated=True):
            key = functor_of(node.term) if isinstance(node, EventPattern) else None
            if key is not None:
                rules_by_event.setdefault(key, []).append(rule)
    result: Dict[int, _RecordedPeriod] = {}
    # The fastest topic is first, so the first period that reaches a rule is the shortest one.
    for message, recorded in sorted(_periods_by_message(program).items(), key=lambda item: item[1].seconds):
        events = [message]
        while events:
            for rule in rules_by_event.get(events.pop(), ()):
                if id(rule.definition) not in result:
                    result[id(rule.definition)] = recorded
                    head = event_raised_by(rule.definition.head)
                    head_key = None if head is None else functor_of(head)
                    events += [] if head_key is None else [head_key]
    return result


def _periods_by_message(program: ProgramModel) -> Dict[Functor, _RecordedPeriod]:
    """Return the topics of bags by the events of their messages; of several topics with one event, the fastest."""
    recorded = {strip_slashes(topic.topic): topic.period for topic in program.recorded_topics}
    periods: Dict[Functor, _RecordedPeriod] = {}
    for topic in program.topics.subscribed:
        definition = program.definition(topic.type)
        seconds = recorded.get(strip_slashes(topic.topic))
        if definition is not None and seconds is not None:
            key = functor(program.topics.functor_name_of(topic), len(definition.fields))
            if key not in periods or seconds < periods[key].seconds:
                periods[key] = _RecordedPeriod(topic.topic, seconds)
    return periods


def find_unreachable_limits(program: ProgramModel) -> Iterator[RuleError]:
    """Yield limits of the interval of a match that no match satisfies: each one takes longer, or is too short."""
    properties = program.rule_base.all_properties()
    for rule in program.rules:
        # A node precedes those below it.
        nodes = walk(rule.definition.pattern, negated=True)
        shortest: Dict[int, int] = {}
        for node in reversed(nodes):
            shortest[id(node)] = _shortest_interval(
                node, [shortest[id(child)] for child in children(node, False)]
            )
        for node in nodes:
            if isinstance(node, WithinPattern) and shortest[id(node)] > node.span:
                length, limit = (
                    format_duration(shortest[id(node)] / 10**9),
                    format_duration((node.span + 1) / 10**9),
                )
                yield RuleError(
                    f"within never matches here: each match takes at least {length}, and within allows less than "
                    f"{limit}",
                    operator_place(rule, "within"),
                )
            if isinstance(node, ConditionPattern) and node.timed:
                yield from _find_unreachable_spans(program, rule, node)
        label = rule.definition.label
        for prop in () if label is None else properties.get(term_key(label), ()):
            length_in_seconds = shortest[id(rule.definition.pattern)] / 10**9
            if prop.name in _INTERVAL_PROPERTIES and length_in_seconds > prop.numeric_value:
                yield RuleError(
                    f"{prop.name} {prop.numeric_value} never matches: each match takes at least "
                    f"{format_duration(length_in_seconds)}",
                    rule.definition.place,
                )


def _find_unreachable_spans(
    program: ProgramModel, rule: SourceRule, node: ConditionPattern
) -> Iterator[RuleError]:
    """Yield conditions such as ``E - S >= 30`` that require a longer interval than a match can have."""
    longest = _longest_interval(node.pattern)
    if longest is None:
        return
    # The first group has the goals that must hold; the others are parts of alternatives and negations.
    goals = next(conjunctions(wrap_term(node.goal), 1))
    starts, ends = _times_of(_T1, goals), _times_of(_T2, goals)
    for goal in goals:
        term: Any = goal.term
        if term.__class__ is not tuple or term[0] not in _LOWER_BOUNDS:
            continue
        span, seconds = (deref(term[position]) for position in _LOWER_BOUNDS[term[0]])
        is_duration = (
            span.__class__ is tuple
            and span[0] is _MINUS
            and deref(span[1]).__class__ is Var
            and deref(span[1]) in ends
            and deref(span[2]).__class__ is Var
            and deref(span[2]) in starts
        )
        if is_duration and isinstance(seconds, (int, float)) and seconds * 10**9 > longest:
            yield RuleError(
                f"{program.brief(term, program.names_in(rule))} never holds: each match takes less than "
                f"{format_duration((longest + 1) / 10**9)}",
                rule.place_of(goal.parent, goal.position),
            )


def _times_of(predicate: Functor, goals: Sequence[Subgoal]) -> Set[Var]:
    """Return the variables that ``t1/1`` or ``t2/1`` binds."""
    terms: List[Any] = [goal.term for goal in goals]
    times = [deref(term[1]) for term in terms if term.__class__ is tuple and term[0] is predicate]
    return {time for time in times if isinstance(time, Var)}


_T1, _T2, _MINUS = functor("t1", 1), functor("t2", 1), functor("-", 2)
_LOWER_BOUNDS = {
    functor(">", 2): (1, 2),
    functor(">=", 2): (1, 2),
    functor("<", 2): (2, 1),
    functor("=<", 2): (2, 1),
}
"""Comparisons, each with the positions of the value and of its lower bound."""


def _longest_interval(pattern: Pattern) -> Optional[int]:
    """Return the length in ns that the interval of a match has at most, or None if it is not known."""
    while isinstance(pattern, ConditionPattern):
        pattern = pattern.pattern
    if isinstance(pattern, WithinPattern):
        return pattern.span
    if isinstance(pattern, WindowPattern) and pattern.window.kind == "last":
        # The first match in the window began less than its span before the end of the last one.
        return pattern.window.span - 1
    return None


_INTERVAL_PROPERTIES = ("window", "event_rule_window")
"""Properties of labels that limit the interval of a match."""


def _shortest_interval(node: Pattern, lengths: Sequence[int]) -> int:
    """Return the length in ns that the interval of a match has at least, given those of its parts."""
    if isinstance(node, InstantPattern):
        return 0
    if isinstance(node, OrPattern):
        return min(lengths)
    if isinstance(node, WindowPattern):
        # The other windows begin with their first match and end with their last one.
        window = node.window
        has_own_interval = window.kind in ("every", "first", "steps") or (
            window.kind == "held" and window.step
        )
        return window.span if has_own_interval and not window.running else 0
    if isinstance(node, PairPattern):
        # In a sequence, the intervals follow each other; otherwise that of a pair contains both.
        follow_each_other = "e1 < s2" in PAIR_OPERATORS[node.operator].comparisons
        return sum(lengths) if follow_each_other else max(lengths)
    if isinstance(node, RepeatedPattern):
        return node.times * lengths[0]
    # There may be no repetition, so only the first part is certain.
    length = lengths[0] if lengths else 0
    if isinstance(node, AbsencePattern):
        return length + (node.span if isinstance(node.span, int) else 0)
    if isinstance(node, RatePattern) and RATE_OPERATORS[node.operator].is_delayed:
        return length + node.span
    return length


def find_invalid_timers(program: ProgramModel) -> Iterator[RuleError]:
    """Yield goals that set a timer with an invalid schedule."""
    if not program.logic.is_system_predicate(TIMER):
        return
    for subterm in program.calls():
        problem = schedule_error(subterm.term[2]) if subterm.key is TIMER else None
        if problem is not None:
            text = f"timer/2: {problem}, found {program.brief(subterm.term[2])}"
            yield RuleError(text, subterm.place_of(subterm.term, 2))
