"""Explanations of events as terms: why an event occurred, and why one did not occur.

`Justifier` answers ``justify_event/3`` and ``justification_edge/2`` from the derivation graph of `LineageTracker`.
Why-provenance is the tree of an occurrence: the rule that raised it, its match described with the operators of the
pattern, and recursively the events of that match. Why-not provenance is found for each rule whose head unifies with
the missing event: its pattern with the events that are remembered, and for each absent event the same again.
"""

from typing import (
    TYPE_CHECKING,
    Any,
    Callable,
    Dict,
    Hashable,
    Iterator,
    List,
    Optional,
    Sequence,
    Set,
    Tuple,
    Union,
)

from ...prolog.terms import timestamps
from ...prolog.terms.list_terms import make_list
from ...prolog.terms.term_traversal import copy, resolve, variant_key
from ...prolog.terms.timestamps import interval_term
from ...prolog.terms.types import Term, Trail, Var, atom, functor
from ...prolog.terms.unification import undo, unify
from ..language.pattern_tree import (
    AbsencePattern,
    ActionPattern,
    AggregatePattern,
    ConditionPattern,
    EventPattern,
    KleenePattern,
    NotPattern,
    OrPattern,
    PairPattern,
    Pattern,
    RatePattern,
    RepeatedPattern,
    WindowPattern,
    WithinPattern,
)
from ..language.stream_parser import rate_operator_term, window_term
from ..matches.partial_matches import ComputedValues, PartialMatch, RepetitionChain
from ..matches.shared_run_buffer import repetitions
from .event_log import Occurrence
from .lineage import LineageTracker

if TYPE_CHECKING:
    from ..network.event_rule import EventRule
    from ..rules.rule_base import RuleBase


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


_Streamed = Union[WindowPattern, RatePattern, AbsencePattern]
Show = Callable[[Occurrence], Term]
"""Returns the representation of an event within the term of a match."""


class Justifier:
    """Explanations from the events that the tracker remembers."""

    def __init__(self, rules: "RuleBase", tracker: LineageTracker):
        self._rules = rules
        self._tracker = tracker

    def edges(self) -> Iterator[Tuple[Term, Term]]:
        """Yield ``event(H,I)`` and ``clause_body(Label,Body)`` for each remembered event that a rule raised."""
        for occurrence in self._tracker.all():
            if occurrence.rule is not None and occurrence.match is not None:
                body = describe(occurrence.rule.definition.pattern, occurrence.match, _as_event)
                yield _as_event(occurrence), (_CLAUSE_BODY, _label(occurrence.rule), body)

    def explanations(self, event: Term, interval: Term) -> Iterator[Tuple[Term, Term, Term]]:
        """Yield event, interval and explanation for each occurrence, or one why-not explanation if there is none."""
        has_occurrence = False
        for occurrence in self._tracker.all():
            shown = interval_term(occurrence.start, occurrence.end)
            if _unifies((event, occurrence.term), (interval, shown)):
                has_occurrence = True
                yield occurrence.term, shown, self._why(occurrence)
        if not has_occurrence:
            yield (
                event,
                interval,
                make_list(_MissingEventExplainer(self._rules, self._tracker).why_not(event, interval)),
            )

    def _why(self, root: Occurrence) -> Term:
        """Return the derivation tree of an occurrence."""
        done: Dict[int, Term] = {}
        stack = [root]
        # Post-order with an explicit stack: chains of derived events can be longer than the recursion limit. The
        # graph is acyclic, because an event is derived from earlier ones only.
        while stack:
            occurrence = stack[-1]
            pending = [source for source in occurrence.sources() if id(source) not in done]
            if pending:
                stack += pending
                continue
            stack.pop()
            # An input event has no rule: it is a leaf of the tree.
            label: Term = _UNLABELED
            body: Term = _DEFAULT
            if occurrence.rule is not None and occurrence.match is not None:
                label = _label(occurrence.rule)
                body = describe(
                    occurrence.rule.definition.pattern, occurrence.match, lambda source: done[id(source)]
                )
            head = (_HEAD, occurrence.term, interval_term(occurrence.start, occurrence.end))
            done[id(occurrence)] = (_JUSTIFICATION, label, head, body)
        return done[id(root)]


class _MissingEventExplainer:
    """Why-not explanation; the number of visited rules is limited."""

    def __init__(self, rules: "RuleBase", tracker: LineageTracker):
        self._rules = rules
        self._tracker = tracker
        self._open: Set[Hashable] = set()
        self._rules_left = _MAX_RULES_EXPLAINED

    def why_not(self, event: Term, interval: Term) -> List[Term]:
        """Return one explanation for each rule that could have raised an event."""
        key = variant_key(event)
        explanations = []
        if key not in self._open:
            # Rules may be recursive: an event is not explained again within its own explanation.
            self._open.add(key)
            for rule in self._rules.rules:
                explained = self._for_rule(rule, event, interval)
                if explained is not None:
                    explanations.append(explained)
            self._open.discard(key)
        return explanations or [(_JUSTIFICATION, _UNLABELED, (_HEAD, event, interval), _FAILED)]

    def _for_rule(self, rule: "EventRule", event: Term, interval: Term) -> Optional[Term]:
        head = rule.definition.head
        if head is None or not self._rules_left:
            return None
        trail: Trail = []
        try:
            if not unify(head, event, trail):
                return None
            self._rules_left -= 1
            body = self._pattern(rule.definition.pattern)
            # Resolved while the head is unified: `undo` below removes the bindings.
            shown = (_HEAD, resolve(event), interval)
            return (_JUSTIFICATION, _label(rule), shown, copy((_FAILED_BODY, body)))
        finally:
            undo(trail, 0)

    def _pattern(self, pattern: Pattern) -> Term:
        if isinstance(pattern, EventPattern):
            return self._event(pattern.term)
        if isinstance(pattern, RepeatedPattern):
            pattern = _expanded(pattern)
        name, parts = _parts(pattern)
        operands = [part.term if isinstance(part, _Quoted) else self._pattern(part) for part in parts]
        shown = functor(name, len(parts))(*[_as_term(part) for part in parts])
        return (
            _JUSTIFICATION,
            _UNLABELED,
            (_HEAD, shown, make_list([Var(), Var()])),
            functor(name, len(operands))(*operands),
        )

    def _event(self, term: Term) -> Term:
        term = resolve(term)
        for occurrence in self._tracker.all():
            if _unifies((term, occurrence.term)):
                shown = interval_term(occurrence.start, occurrence.end)
                return (_JUSTIFICATION, _UNLABELED, (_HEAD, occurrence.term, shown), _DEFAULT)
        return self.why_not(term, make_list([Var(), Var()]))[0]


def describe(pattern: Pattern, match: PartialMatch, show: Show) -> Term:
    """Return the term of a match: its events, represented by ``show``, below the names of the operators."""
    # These operators have no operands in an explanation: their match is that of the pattern below them.
    while isinstance(pattern, (ConditionPattern, WithinPattern)) or (
        isinstance(pattern, NotPattern) and pattern.inside
    ):
        pattern = pattern.pattern
    if isinstance(pattern, EventPattern):
        while match.parts is not None:
            part = match.parts[0]
            assert isinstance(part, PartialMatch)
            match = part
        return show(match.event) if isinstance(match.event, Occurrence) else match.term
    parts: Sequence[Any] = match.parts or ()
    if isinstance(pattern, NotPattern):
        return describe(pattern.pattern, match, show)
    if isinstance(pattern, ActionPattern):
        return describe(pattern.pattern, parts[0] if _is_wrapped(parts) else match, show)
    while _is_wrapped(parts):
        match = parts[0]
        parts = match.parts or ()
    if isinstance(pattern, OrPattern):
        return describe(pattern.branches[parts[0]], parts[1], show)
    if isinstance(pattern, RepeatedPattern):
        return _describe_repeated(pattern, match, show)
    if isinstance(pattern, PairPattern):
        left = describe(pattern.left, parts[0], show)
        return functor(f"{pattern.operator}f", 2)(left, describe(pattern.right, parts[1], show))
    return _describe_run(pattern, parts, show)


def _describe_repeated(pattern: RepeatedPattern, match: PartialMatch, show: Show) -> Term:
    """Return the term of repetitions, as that of the equivalent sequence."""
    first, *later = repetitions(match, pattern.times)
    shown = describe(pattern.pattern, first, show)
    for repetition in later:
        shown = functor("seqf", 2)(shown, describe(pattern.pattern, repetition, show))
    return shown


def _is_wrapped(parts: Sequence[Any]) -> bool:
    """Return whether the parts are those of a condition or action around a match."""
    return (
        bool(parts)
        and isinstance(parts[0], PartialMatch)
        and (len(parts) == 1 or parts[1].__class__ is ComputedValues)
    )


def _describe_run(pattern: Any, parts: Sequence[Any], show: Show) -> Term:
    """Return the term of a match with any number of repetitions, or of a stream operator."""
    if isinstance(pattern, (WindowPattern, RatePattern, AbsencePattern)):
        return _describe_stream(pattern, parts, show)
    first = describe(pattern.first, parts[0], show)
    # Repetitions are recorded only while lineage is tracked; otherwise the match shows its first event only.
    tracked_matches = [part for part in parts if part.__class__ is RepetitionChain]
    repetition_parts = list(tracked_matches[0].matches) if tracked_matches else []
    if isinstance(pattern, KleenePattern):
        repeated = [describe(pattern.repeated, repetition, show) for repetition in repetition_parts]
        return functor("seqf", 2)(first, functor("star_timesf", 1)(make_list(repeated)))
    kind = atom(pattern.kind) if pattern.value is None else functor(pattern.kind, 1)(copy(pattern.value))
    if not repetition_parts:
        return functor("aggregate", 2)(kind, first)
    # The original system lists aggregated events from the newest to the oldest.
    newest_first = [
        describe(pattern.collected, repetition, show) for repetition in reversed(repetition_parts)
    ]
    return functor("aggregate", 2 + len(newest_first))(kind, *newest_first, first)


def _describe_stream(pattern: _Streamed, parts: Sequence[Any], show: Show) -> Term:
    if isinstance(pattern, WindowPattern):
        tracked_matches: List[Any] = [part for part in parts if part.__class__ is RepetitionChain]
        repetition_parts = tracked_matches[0].match.parts if tracked_matches else ()
        shown = [describe(pattern.collected, part, show) for part in repetition_parts]
        return functor("windowf", 3)(_kinds(pattern), make_list(shown), window_term(pattern.window))
    first = describe(pattern.pattern, parts[0], show)
    if isinstance(pattern, RatePattern):
        return functor("withf", 2)(first, copy(rate_operator_term(pattern)))
    return functor("absentf", 3)(first, copy(_as_term(pattern.negated)), timestamps.to_seconds(pattern.span))


def _kinds(pattern: WindowPattern) -> Term:
    """Return the measures of a window: a list, or the only one."""
    kinds = []
    measured = zip(pattern.kinds, pattern.settings, pattern.values, pattern.scopes)
    for name, setting, value, scope in measured:
        settings = () if setting is None else setting if setting.__class__ is tuple else (setting,)
        args = settings if value is None else (*settings, copy(value))
        kind = functor(name, len(args))(*args) if args else atom(name)
        of_step = None if scope is None else atom(pattern.window.steps[scope].name)
        kinds.append(kind if of_step is None else functor("of", 2)(of_step, kind))
    return kinds[0] if len(kinds) == 1 else make_list(kinds)


def _parts(pattern: Pattern) -> "Tuple[str, List[Union[Pattern, _Quoted]]]":
    """Return name and operands of a pattern in an explanation."""
    if isinstance(pattern, PairPattern):
        return f"{pattern.operator}f", [pattern.left, pattern.right]
    if isinstance(pattern, OrPattern):
        return "orf", list(pattern.branches)
    if isinstance(pattern, NotPattern):
        return "cnotf" if pattern.inside else "fnotf", [pattern.pattern, _Quoted(_as_term(pattern.negated))]
    if isinstance(pattern, KleenePattern):
        return "star_timesf", [pattern.first, _Quoted(_as_term(pattern.repeated))]
    if isinstance(pattern, AggregatePattern):
        return "aggregatef", [pattern.first, _Quoted(_as_term(pattern.collected))]
    if isinstance(pattern, WithinPattern):
        return "withinf", [pattern.pattern, _Quoted((pattern.span + 1) / 1e9)]
    if isinstance(pattern, (ConditionPattern, ActionPattern)):
        return _parts_with_goal(pattern)
    assert isinstance(pattern, (WindowPattern, RatePattern, AbsencePattern))
    return _stream_parts(pattern)


def _parts_with_goal(
    pattern: Union[ConditionPattern, ActionPattern],
) -> "Tuple[str, List[Union[Pattern, _Quoted]]]":
    name = "dof" if isinstance(pattern, ActionPattern) else "checkf" if pattern.timed else "wheref"
    return name, [pattern.pattern, _Quoted(resolve(pattern.goal))]


def _stream_parts(
    pattern: _Streamed,
) -> "Tuple[str, List[Union[Pattern, _Quoted]]]":
    if isinstance(pattern, WindowPattern):
        window = _Quoted(window_term(pattern.window))
        return "windowf", [_Quoted(_kinds(pattern)), pattern.collected, window]
    if isinstance(pattern, RatePattern):
        return "withf", [pattern.pattern, _Quoted(resolve(rate_operator_term(pattern)))]
    return "absentf", [
        pattern.pattern,
        _Quoted(_as_term(pattern.negated)),
        _Quoted(timestamps.to_seconds(pattern.span)),
    ]


def _expanded(part: RepeatedPattern) -> Pattern:
    """Return the equivalent sequence of repetitions, up to a maximum length."""
    return part._replace(times=min(part.times, _MAX_SHOWN_REPETITIONS)).as_sequence()


class _Quoted:
    """Part of an explanation that is inserted unchanged."""

    def __init__(self, term: Term):
        self.term = term


def _as_term(part: "Union[Pattern, _Quoted]") -> Term:
    if isinstance(part, _Quoted):
        return part.term
    if isinstance(part, EventPattern):
        return resolve(part.term)
    if isinstance(part, RepeatedPattern):
        part = _expanded(part)
    name, parts = _parts(part)
    return functor(name, len(parts))(*[_as_term(operand) for operand in parts])


def _as_event(occurrence: Occurrence) -> Term:
    return (_EVENT, occurrence.term, interval_term(occurrence.start, occurrence.end))


def _label(rule: Optional["EventRule"]) -> Term:
    return _UNLABELED if rule is None or rule.label is None else rule.label


def _unifies(*pairs: Tuple[Term, Term]) -> bool:
    trail: Trail = []
    result = all(unify(copy(left), right, trail) for left, right in pairs)
    undo(trail, 0)
    return result
