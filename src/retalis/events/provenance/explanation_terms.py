"""Explanations of events as terms: why an event occurred, and why one did not occur.

`Justifier` answers ``justify_event/3`` and ``justification_edge/2`` from the lineage graph of `LineageTracker`.
Why-provenance is the tree of an occurrence: the rule that raised it, its match described with the operators of the
pattern, and recursively the events of that match. Why-not provenance is found for each rule whose head unifies with
the missing event: its pattern with the remembered events that match parts of it; parts without such an event are
explained recursively.
"""

from typing import (
    Any,
    Callable,
    Dict,
    Hashable,
    Iterable,
    Iterator,
    List,
    Optional,
    Sequence,
    Set,
    Tuple,
    Union,
)

from ...prolog.terms.list_terms import make_list
from ...prolog.terms.term_traversal import copy, resolve, variant_key
from ...prolog.terms.timestamps import interval_term, to_seconds
from ...prolog.terms.types import Term, Trail, Var, atom, functor
from ...prolog.terms.unification import undo, unify
from ..language.pattern_tree import (
    AbsencePattern,
    ActionPattern,
    AggregatePattern,
    ConditionPattern,
    EventPattern,
    InstantPattern,
    KleenePattern,
    NegationScope,
    NotPattern,
    NotPrecededPattern,
    OrPattern,
    PairPattern,
    Pattern,
    RatePattern,
    RepeatedPattern,
    WindowPattern,
    WithinPattern,
)
from ..language.stream_parser import NOT_PRECEDED, rate_operator_term, timeout_term, window_term
from ..matches.match_types import ComputedValues, PartialMatch, RepetitionChain
from ..network.event_rule import EventRule
from ..network.lineage_graph import Occurrence
from ..network.lineage_tracker import LineageTracker
from ..network.repetition_runs import repetitions

_EVENT = functor("event", 2)
_CLAUSE_BODY = functor("clause_body", 2)
_JUSTIFICATION = functor("justification", 3)
_HEAD = functor("head", 2)
_DEFAULT = atom("default")
_FAILED = atom("failed")
_FAILED_BODY = functor("failed", 1)
_UNLABELED = atom("unlabeled")
_MAX_RULES_EXPLAINED = 500
"""Maximum number of rules in a why-not explanation."""
_MAX_SHOWN_REPETITIONS = 100
"""Maximum number of repetitions of a pattern in an explanation."""


_StreamPattern = Union[WindowPattern, RatePattern, AbsencePattern, NotPrecededPattern]
EventFormatter = Callable[[Occurrence], Term]
"""Returns the term that represents an event within the term of a match."""


class Justifier:
    """Explanations of events that the tracker remembers, and of events that did not occur."""

    def __init__(self, rules: Iterable[EventRule], tracker: LineageTracker):
        self._rules = rules
        self._tracker = tracker

    def edges(self) -> Iterator[Tuple[Term, Term]]:
        """Yield ``event(H,I)`` and ``clause_body(Label,Body)`` for each remembered event that a rule raised."""
        for occurrence in self._tracker.remembered_events():
            if occurrence.rule is not None and occurrence.match is not None:
                body = describe_match(occurrence.rule.definition.pattern, occurrence.match, _event_term)
                yield _event_term(occurrence), (_CLAUSE_BODY, label_of(occurrence.rule), body)

    def explanations(self, event: Term, interval: Term) -> Iterator[Tuple[Term, Term, Term]]:
        """Yield event, interval and explanation for each occurrence, or one why-not explanation if there is none."""
        has_occurrence = False
        for occurrence in self._tracker.remembered_events():
            occurrence_interval = interval_term(occurrence.start, occurrence.end)
            if _can_unify((event, occurrence.term), (interval, occurrence_interval)):
                has_occurrence = True
                yield occurrence.term, occurrence_interval, self._derivation_tree(occurrence)
        if not has_occurrence:
            yield (
                event,
                interval,
                make_list(_MissingEventExplainer(self._rules, self._tracker).explain(event, interval)),
            )

    def _derivation_tree(self, root: Occurrence) -> Term:
        trees_by_id: Dict[int, Term] = {}
        stack = [root]
        # Post-order with an explicit stack: chains of derived events can be longer than the recursion limit. The
        # graph is acyclic, because an event is derived from earlier ones only.
        while stack:
            occurrence = stack[-1]
            pending = [source for source in occurrence.sources() if id(source) not in trees_by_id]
            if pending:
                stack += pending
                continue
            stack.pop()
            # An input event has no rule: it is a leaf of the tree.
            label: Term = _UNLABELED
            body: Term = _DEFAULT
            if occurrence.rule is not None and occurrence.match is not None:
                label = label_of(occurrence.rule)
                body = describe_match(
                    occurrence.rule.definition.pattern,
                    occurrence.match,
                    lambda source: trees_by_id[id(source)],
                )
            head = (_HEAD, occurrence.term, interval_term(occurrence.start, occurrence.end))
            trees_by_id[id(occurrence)] = (_JUSTIFICATION, label, head, body)
        return trees_by_id[id(root)]


class _MissingEventExplainer:
    """Why-not explanation of one event, with a limit for the number of visited rules."""

    def __init__(self, rules: Iterable[EventRule], tracker: LineageTracker):
        self._rules = rules
        self._tracker = tracker
        self._keys_in_progress: Set[Hashable] = set()
        self._rules_left = _MAX_RULES_EXPLAINED

    def explain(self, event: Term, interval: Term) -> List[Term]:
        """Return one explanation for each rule that could have raised an event."""
        key = variant_key(event)
        explanations = []
        if key not in self._keys_in_progress:
            # Rules may be recursive: an event is not explained again within its own explanation.
            self._keys_in_progress.add(key)
            for rule in self._rules:
                explained = self._explain_rule(rule, event, interval)
                if explained is not None:
                    explanations.append(explained)
            self._keys_in_progress.discard(key)
        return explanations or [(_JUSTIFICATION, _UNLABELED, (_HEAD, event, interval), _FAILED)]

    def _explain_rule(self, rule: EventRule, event: Term, interval: Term) -> Optional[Term]:
        head = rule.definition.head
        if head is None or not self._rules_left:
            return None
        trail: Trail = []
        try:
            if not unify(head, event, trail):
                return None
            self._rules_left -= 1
            body = self._explain_pattern(rule.definition.pattern)
            # Resolved while the head is unified: `undo` below removes the bindings.
            head_term = (_HEAD, resolve(event), interval)
            return (_JUSTIFICATION, label_of(rule), head_term, copy((_FAILED_BODY, body)))
        finally:
            undo(trail, 0)

    def _explain_pattern(self, pattern: Pattern) -> Term:
        if isinstance(pattern, EventPattern):
            return self._explain_event(pattern.term)
        if isinstance(pattern, RepeatedPattern):
            pattern = _expand_repetitions(pattern)
        name, operands = _name_and_operands(pattern)
        operand_explanations = [
            operand.term if isinstance(operand, _QuotedTerm) else self._explain_pattern(operand)
            for operand in operands
        ]
        head_event = functor(name, len(operands))(*[_pattern_term(operand) for operand in operands])
        return (
            _JUSTIFICATION,
            _UNLABELED,
            (_HEAD, head_event, make_list([Var(), Var()])),
            functor(name, len(operand_explanations))(*operand_explanations),
        )

    def _explain_event(self, term: Term) -> Term:
        term = resolve(term)
        for occurrence in self._tracker.remembered_events():
            if _can_unify((term, occurrence.term)):
                head = (_HEAD, occurrence.term, interval_term(occurrence.start, occurrence.end))
                return (_JUSTIFICATION, _UNLABELED, head, _DEFAULT)
        return self.explain(term, make_list([Var(), Var()]))[0]


def describe_match(pattern: Pattern, match: PartialMatch, format_event: EventFormatter) -> Term:
    """Return the term of a match: its events, represented by ``format_event``, below the names of the operators."""
    # These operators have no operands in an explanation: their match is that of the pattern below them.
    while isinstance(pattern, (ConditionPattern, WithinPattern)) or (
        isinstance(pattern, NotPattern) and pattern.scope is not NegationScope.BEFORE
    ):
        pattern = pattern.pattern
    if isinstance(pattern, EventPattern):
        while match.parts is not None:
            part = match.parts[0]
            assert isinstance(part, PartialMatch)
            match = part
        return format_event(match.event) if isinstance(match.event, Occurrence) else match.term
    parts: Sequence[Any] = match.parts or ()
    if isinstance(pattern, (NotPattern, InstantPattern)):
        # The match of an instant wraps one of its pattern, as that of a condition does.
        described = describe_match(pattern.pattern, match, format_event)
        return described if isinstance(pattern, NotPattern) else functor(f"{pattern.operator}f", 1)(described)
    if isinstance(pattern, ActionPattern):
        return describe_match(pattern.pattern, parts[0] if _is_wrapped(parts) else match, format_event)
    while _is_wrapped(parts):
        match = parts[0]
        parts = match.parts or ()
    if isinstance(pattern, OrPattern):
        return describe_match(pattern.branches[parts[0]], parts[1], format_event)
    if isinstance(pattern, RepeatedPattern):
        return _describe_repeated(pattern, match, format_event)
    if isinstance(pattern, PairPattern):
        left = describe_match(pattern.left, parts[0], format_event)
        return functor(f"{pattern.operator}f", 2)(left, describe_match(pattern.right, parts[1], format_event))
    return _describe_repetitions(pattern, parts, format_event)


def _describe_repeated(pattern: RepeatedPattern, match: PartialMatch, format_event: EventFormatter) -> Term:
    """Return the term of repetitions, as that of the equivalent sequence."""
    first, *later = repetitions(match, pattern.times)
    sequence = describe_match(pattern.pattern, first, format_event)
    for repetition in later:
        sequence = functor("seqf", 2)(sequence, describe_match(pattern.pattern, repetition, format_event))
    return sequence


def _is_wrapped(parts: Sequence[Any]) -> bool:
    """Return whether the parts are those of a condition or action around a match."""
    return (
        bool(parts)
        and isinstance(parts[0], PartialMatch)
        and (len(parts) == 1 or parts[1].__class__ is ComputedValues)
    )


def _describe_repetitions(pattern: Any, parts: Sequence[Any], format_event: EventFormatter) -> Term:
    """Return the term of a match of a Kleene pattern, of an aggregate, or of a stream operator."""
    if isinstance(pattern, (WindowPattern, RatePattern, AbsencePattern, NotPrecededPattern)):
        return _describe_stream(pattern, parts, format_event)
    first = describe_match(pattern.first, parts[0], format_event)
    # Repetitions are recorded only while lineage is tracked; otherwise the match shows its first event only.
    tracked_matches = [part for part in parts if part.__class__ is RepetitionChain]
    repetition_parts = list(tracked_matches[0].matches) if tracked_matches else []
    if isinstance(pattern, KleenePattern):
        repeated = [
            describe_match(pattern.repeated, repetition, format_event) for repetition in repetition_parts
        ]
        return functor("seqf", 2)(first, functor("star_timesf", 1)(make_list(repeated)))
    kind = atom(pattern.kind) if pattern.value is None else functor(pattern.kind, 1)(copy(pattern.value))
    if not repetition_parts:
        return functor("aggregate", 2)(kind, first)
    # The original system lists aggregated events from the newest to the oldest.
    newest_first = [
        describe_match(pattern.collected, repetition, format_event)
        for repetition in reversed(repetition_parts)
    ]
    return functor("aggregate", 2 + len(newest_first))(kind, *newest_first, first)


def _describe_stream(pattern: _StreamPattern, parts: Sequence[Any], format_event: EventFormatter) -> Term:
    if isinstance(pattern, WindowPattern):
        tracked_matches: List[Any] = [part for part in parts if part.__class__ is RepetitionChain]
        repetition_parts = tracked_matches[0].match.parts if tracked_matches else ()
        matches = [describe_match(pattern.collected, part, format_event) for part in repetition_parts]
        return functor("windowf", 3)(_measures_term(pattern), make_list(matches), window_term(pattern.window))
    first = describe_match(pattern.pattern, parts[0], format_event)
    if isinstance(pattern, RatePattern):
        return functor("withf", 2)(first, copy(rate_operator_term(pattern)))
    if isinstance(pattern, NotPrecededPattern):
        return functor("withf", 2)(first, copy(_not_preceded_term(pattern)))
    return functor("absentf", 3)(first, copy(_pattern_term(pattern.negated)), copy(timeout_term(pattern)))


def _not_preceded_term(pattern: NotPrecededPattern) -> Term:
    return NOT_PRECEDED(_pattern_term(pattern.negated), to_seconds(pattern.span))


def _measures_term(pattern: WindowPattern) -> Term:
    """Return the measures of a window: a list, or the only one."""
    measures = []
    measured = zip(pattern.kinds, pattern.settings, pattern.values, pattern.scopes)
    for name, setting, value, scope in measured:
        settings = () if setting is None else setting if setting.__class__ is tuple else (setting,)
        args = settings if value is None else (*settings, copy(value))
        measure = functor(name, len(args))(*args) if args else atom(name)
        step_name = None if scope is None else atom(pattern.window.steps[scope].name)
        measures.append(measure if step_name is None else functor("of", 2)(step_name, measure))
    return measures[0] if len(measures) == 1 else make_list(measures)


def _name_and_operands(pattern: Pattern) -> "Tuple[str, List[Union[Pattern, _QuotedTerm]]]":
    if isinstance(pattern, PairPattern):
        return f"{pattern.operator}f", [pattern.left, pattern.right]
    if isinstance(pattern, InstantPattern):
        return f"{pattern.operator}f", [pattern.pattern]
    if isinstance(pattern, OrPattern):
        return "orf", list(pattern.branches)
    if isinstance(pattern, NotPattern):
        return f"{pattern.scope.value}f", [
            pattern.pattern,
            _QuotedTerm(_pattern_term(pattern.negated)),
        ]
    if isinstance(pattern, KleenePattern):
        return "star_timesf", [pattern.first, _QuotedTerm(_pattern_term(pattern.repeated))]
    if isinstance(pattern, AggregatePattern):
        return "aggregatef", [pattern.first, _QuotedTerm(_pattern_term(pattern.collected))]
    if isinstance(pattern, WithinPattern):
        # The parser subtracts 1 ns from the time, because a match has to be shorter.
        return "withinf", [pattern.pattern, _QuotedTerm((pattern.span + 1) / 1e9)]
    if isinstance(pattern, (ConditionPattern, ActionPattern)):
        return _name_and_operands_with_goal(pattern)
    assert isinstance(pattern, (WindowPattern, RatePattern, AbsencePattern, NotPrecededPattern))
    return _name_and_operands_of_stream(pattern)


def _name_and_operands_with_goal(
    pattern: Union[ConditionPattern, ActionPattern],
) -> "Tuple[str, List[Union[Pattern, _QuotedTerm]]]":
    name = "dof" if isinstance(pattern, ActionPattern) else "checkf" if pattern.timed else "wheref"
    return name, [pattern.pattern, _QuotedTerm(resolve(pattern.goal))]


def _name_and_operands_of_stream(
    pattern: _StreamPattern,
) -> "Tuple[str, List[Union[Pattern, _QuotedTerm]]]":
    if isinstance(pattern, WindowPattern):
        window = _QuotedTerm(window_term(pattern.window))
        return "windowf", [_QuotedTerm(_measures_term(pattern)), pattern.collected, window]
    if isinstance(pattern, RatePattern):
        return "withf", [pattern.pattern, _QuotedTerm(resolve(rate_operator_term(pattern)))]
    if isinstance(pattern, NotPrecededPattern):
        return "withf", [pattern.pattern, _QuotedTerm(_not_preceded_term(pattern))]
    return "absentf", [
        pattern.pattern,
        _QuotedTerm(_pattern_term(pattern.negated)),
        _QuotedTerm(resolve(timeout_term(pattern))),
    ]


def _expand_repetitions(part: RepeatedPattern) -> Pattern:
    """Return the sequence that a repetition is short for, up to a maximum length."""
    return part._replace(times=min(part.times, _MAX_SHOWN_REPETITIONS)).as_sequence()


class _QuotedTerm:
    """Operand that is a term, not a pattern: an explanation contains it unchanged."""

    def __init__(self, term: Term):
        self.term = term


def _pattern_term(part: "Union[Pattern, _QuotedTerm]") -> Term:
    if isinstance(part, _QuotedTerm):
        return part.term
    if isinstance(part, EventPattern):
        return resolve(part.term)
    if isinstance(part, RepeatedPattern):
        part = _expand_repetitions(part)
    name, parts = _name_and_operands(part)
    return functor(name, len(parts))(*[_pattern_term(operand) for operand in parts])


def _event_term(occurrence: Occurrence) -> Term:
    return (_EVENT, occurrence.term, interval_term(occurrence.start, occurrence.end))


def label_of(rule: Optional[EventRule]) -> Term:
    """Return the label of a rule."""
    return _UNLABELED if rule is None or rule.label is None else rule.label


def _can_unify(*pairs: Tuple[Term, Term]) -> bool:
    trail: Trail = []
    try:
        return all(unify(copy(left), right, trail) for left, right in pairs)
    finally:
        undo(trail, 0)
