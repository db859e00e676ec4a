"""Syntax tree of patterns, and functions on it.

A rule is parsed into a `RuleDefinition` whose pattern is a tree of named tuples, one class per operator. The tree is
immutable and independent of the network that is compiled from it. State files contain the text of rules, not the
tree.
"""

from enum import Enum
from types import MappingProxyType
from typing import Any, Dict, FrozenSet, Hashable, List, Mapping, NamedTuple, Optional, Set, Tuple, Union

from ...foundation.source_places import Place
from ...prolog.terms.term_traversal import rebuild, variables, variant_key
from ...prolog.terms.types import Functor, Term, Var, functor
from ..streams.row_pattern_automaton import RowPatternSkip, StepGroup

Pattern = Union[
    "EventPattern",
    "PairPattern",
    "RepeatedPattern",
    "OrPattern",
    "NotPattern",
    "KleenePattern",
    "AggregatePattern",
    "ConditionPattern",
    "WithinPattern",
    "ActionPattern",
    "WindowPattern",
    "RatePattern",
    "AbsencePattern",
    "NotPrecededPattern",
    "InstantPattern",
]


class EventPattern(NamedTuple):
    """Event that unifies with a term."""

    term: Term


class PairPattern(NamedTuple):
    """Two patterns that are joined by an operator of `PAIR_OPERATORS`."""

    operator: str
    left: "Pattern"
    right: "Pattern"


class RepeatedPattern(NamedTuple):
    """Pattern that is repeated in sequence; the variables ``fresh_vars`` are fresh in each repetition."""

    pattern: "Pattern"
    times: int
    fresh_vars: Tuple[Var, ...]

    def as_sequence(self) -> "Pattern":
        """Return the equivalent sequence of patterns."""
        result: Pattern = self.pattern
        for _ in range(self.times - 1):
            # Variables ``_`` are independent in each repetition; all others are shared and join the repetitions.
            renaming = {var: Var() for var in self.fresh_vars}
            repetition = substitute_variables(self.pattern, renaming) if renaming else self.pattern
            result = PairPattern(SEQ, result, repetition)
        return result

    def repeats_single_events(self) -> bool:
        """Return whether each repetition is one event, and each event has at most one match."""
        nodes = walk(self.pattern)
        if not all(
            isinstance(node, (EventPattern, OrPattern, ConditionPattern, WithinPattern)) for node in nodes
        ):
            return False
        terms = [node.term for node in nodes if isinstance(node, EventPattern)]
        keys = {term[0] if term.__class__ is tuple else term for term in terms}
        return len(terms) == 1 or (len(keys) == len(terms) and not any(key.__class__ is Var for key in keys))


class OrPattern(NamedTuple):
    """Alternatives (``or``)."""

    branches: "Tuple[Pattern, ...]"


class NegationScope(Enum):
    """Places where a negated pattern must not match; the values are the operators."""

    BEFORE = "fnot"
    BETWEEN = "cnot"
    OVERLAP = "without"


class NotPattern(NamedTuple):
    """Pattern that matches if no match of another one lies in a scope.

    The scope is any time before the match of the pattern, the gap of a sequence, or any overlap with the match.
    """

    pattern: "Pattern"
    negated: "Pattern"
    scope: NegationScope


class KleenePattern(NamedTuple):
    """Pattern that is followed by any number of repetitions of another one."""

    first: "Pattern"
    repeated: "Pattern"


class AggregatePattern(NamedTuple):
    """Pattern that is followed by any number of repetitions of another one, which are aggregated into a result.

    Attributes:
        kind: name of the aggregate function.
        setting: the arguments of the function before the aggregated term: a number, names of predicates, or None.
        value: the aggregated term; None if the function has none.
        collected: the repeated pattern.
    """

    first: "Pattern"
    kind: str
    setting: Any
    value: Optional[Term]
    collected: "Pattern"
    result: Term


class ConditionPattern(NamedTuple):
    """Pattern with a goal that must have a solution; if ``timed``, the goal can call ``t1/1`` and ``t2/1``."""

    pattern: "Pattern"
    goal: Term
    timed: bool


class WithinPattern(NamedTuple):
    """Pattern whose matches take ``span`` nanoseconds at most."""

    pattern: "Pattern"
    span: int


class ActionPattern(NamedTuple):
    """Pattern with a goal that is called once per match (``do``), or for all of its solutions (``every``)."""

    pattern: "Pattern"
    goal: Term
    every: bool


class RowPatternStep(NamedTuple):
    """Step of a row pattern: a pattern variable of MATCH_RECOGNIZE with its quantifier and its condition.

    Attributes:
        min_count: minimum number of rows.
        max_count: maximum number of rows; None for no limit.
        reluctant: whether the quantifier is reluctant, that is, prefers fewer rows.
        skips_rows: whether rows that fit no step may be skipped before each row of this one.
        goal: the condition of a row, or None; it can navigate with ``prev/1``, ``first`` and ``last``.
        until: condition of a row that ends the step, or None.
    """

    name: str
    min_count: int
    max_count: Optional[int]
    reluctant: bool
    skips_rows: bool
    goal: Optional[Term]
    until: Optional[Term]

    @property
    def goals(self) -> List[Term]:
        """The conditions of the step."""
        return [goal for goal in (self.goal, self.until) if goal is not None]


DURATION = "duration"
"""Name of the aggregate that measures a goal."""


class WindowSpec(NamedTuple):
    """Window: the matches that are aggregated together, and the times at which a result is emitted.

    Attributes:
        kind: ``last`` for a sliding window of ``span`` ns, ``newest`` for a sliding window of ``max_count`` matches,
            ``every`` for windows of ``span`` ns that start every ``step`` ns, ``first`` for windows that start with
            a match, ``batch`` for tumbling windows of ``max_count`` matches, ``session`` for windows that end ``gap``
            ns after their last match, ``steps`` for row patterns, ``held`` for values that last until the next match.
        span: length in ns; for ``steps``, ns after which a match that is not complete is emitted in place of complete
            ones; 0 if complete ones are.
        step: for ``every`` and ``held``, ns from one start to the next one; 0 if each match emits a result.
        max_count: number of matches.
        gap: for ``session``, ns without a match that end a window.
        max_length: for ``session``, maximum length of a window in ns, and for ``held``, maximum time in ns for which
            a value lasts; None for no maximum.
        running: whether each match emits a result, not only the end of a window.
        structure: their order; None if they follow each other.
        navigated_vars: the variables of the pattern that conditions of steps use.
        skip: where the next match of a row pattern begins; None if that is not stated.
    """

    kind: str
    span: int = 0
    step: int = 0
    max_count: int = 0
    gap: int = 0
    max_length: Optional[int] = None
    running: bool = False
    steps: Tuple[RowPatternStep, ...] = ()
    navigated_vars: Tuple[Var, ...] = ()
    skip: Optional[RowPatternSkip] = None
    structure: Optional[StepGroup] = None

    @property
    def max_duration(self) -> Optional[int]:
        """Longest time in ns from the start of a window to its result; None for no bound."""
        if self.kind == "session":
            return None if self.max_length is None else self.max_length + self.gap
        return self.span or None

    @property
    def goals(self) -> List[Term]:
        """The conditions of all steps."""
        return [goal for step in self.steps for goal in step.goals]


class WindowPattern(NamedTuple):
    """Aggregation of the matches of a pattern that are in a window.

    Attributes:
        kinds: names of the measures.
        settings: setting of each measure: a term, a tuple of terms, or None.
        values: aggregated value of each measure; None for measures without a value.
        results: term for the result of each measure; if ``is_listed``, one term for the list of all results.
        is_listed: whether the results are unified as one list.
        scopes: for each measure the number of the step that it is restricted to, or None.
    """

    collected: "Pattern"
    kinds: Tuple[str, ...]
    settings: Tuple[Any, ...]
    values: Tuple[Optional[Term], ...]
    results: Tuple[Term, ...]
    is_listed: bool
    window: WindowSpec
    scopes: Tuple[Optional[int], ...]

    @property
    def goals(self) -> List[Term]:
        """The goals of measures and the conditions of steps."""
        measured_goals = [
            value for kind, value in zip(self.kinds, self.values) if kind == DURATION and value is not None
        ]
        return [*measured_goals, *self.window.goals]


class RatePattern(NamedTuple):
    """Pattern whose matches pass a rate operator (throttle, burst, debounce, change), keyed by ``keys``.

    Attributes:
        operator: name of the operator.
        span: time in ns; 0 if the operator has none.
        value: the value that must change, or None.
        keys: key terms; matches with equal keys share one state of the operator.
    """

    pattern: "Pattern"
    operator: str
    span: int
    value: Optional[Term]
    keys: Tuple[Term, ...]


class AbsencePattern(NamedTuple):
    """Pattern that matches if no match of another one lies within ``span`` ns after it.

    Attributes:
        negated: the other pattern.
        span: the time in ns, or a variable that a match of the pattern binds to the time in seconds.
    """

    pattern: "Pattern"
    negated: "Pattern"
    span: Union[int, Var]


class NotPrecededPattern(NamedTuple):
    """Pattern that matches if no match of another one has ended within ``span`` ns before its start."""

    pattern: "Pattern"
    negated: "Pattern"
    span: int


class InstantPattern(NamedTuple):
    """Pattern whose matches are reduced to one instant: their end (``at_end``) or their start."""

    pattern: "Pattern"
    at_end: bool

    @property
    def operator(self) -> str:
        """Name of the operator."""
        return AT_END if self.at_end else AT_START


PATTERNS = (
    EventPattern,
    PairPattern,
    RepeatedPattern,
    OrPattern,
    NotPattern,
    KleenePattern,
    AggregatePattern,
    ConditionPattern,
    WithinPattern,
    ActionPattern,
    WindowPattern,
    RatePattern,
    AbsencePattern,
    NotPrecededPattern,
    InstantPattern,
)
"""All classes of pattern nodes."""
SEQ = "seq"
AT_END = "at_end"
AT_START = "at_start"
MAX_REPETITIONS = 10_000
"""Maximum for ``ntimes``."""
MAX_COMPOSED_REPETITIONS = 1_000
"""Maximum for ``ntimes`` of a pattern of several events, which is expanded into a sequence."""


def substitute_variables(part: Pattern, renaming: Mapping[Var, Var]) -> Any:
    """Return a pattern in which some variables are replaced by others."""

    def rename(value: Any) -> Any:
        if isinstance(value, (*PATTERNS, WindowSpec, RowPatternStep)):
            return value.__class__(*map(rename, value))
        # Terms are tuples that begin with a functor; any other tuple is a field with several patterns or variables.
        if value.__class__ is tuple and (not value or value[0].__class__ is not Functor):
            # Fields with several values: branches of ``or``, variables of repetitions.
            return tuple(map(rename, value))
        return (
            rebuild(value, lambda var: renaming.get(var, var)) if value.__class__ in (tuple, Var) else value
        )

    return rename(part)


def bound_by(pattern: Pattern, negated: bool = False) -> List[Var]:
    """Return the variables that a match may bind, from left to right, optionally with negated patterns."""
    bound: Dict[Var, None] = {}
    for node in walk(pattern, negated):
        for term in own_terms(node):
            for var in variables(term):
                bound.setdefault(var)
    return list(bound)


def always_bound_by(pattern: Pattern, conditions: bool = True, empty: bool = False) -> Set[Var]:
    """Return the variables that every match of a pattern binds.

    Args:
        pattern: the pattern.
        conditions: whether variables that conditions bind are included.
        empty: whether matches of aggregates without any repetition are considered too.
    """
    if isinstance(pattern, OrPattern):
        branches = [always_bound_by(branch, conditions, empty) for branch in pattern.branches]
        # A match has one branch only, so a variable is bound for certain only if all branches bind it.
        return set.intersection(*branches)
    if isinstance(pattern, KleenePattern) or (empty and isinstance(pattern, AggregatePattern)):
        # Zero repetitions are a match as well, and bind nothing.
        return always_bound_by(pattern.first, conditions, empty)
    # The key of a stored match may need the variables before the condition is solved and binds them.
    is_counted = conditions or not isinstance(pattern, ConditionPattern)
    bound = {var for term in own_terms(pattern) for var in variables(term)} if is_counted else set()
    for child in children(pattern, False):
        bound |= always_bound_by(child, conditions, empty)
    return bound


def own_terms(node: Pattern) -> List[Term]:
    """Return the terms of one node, without those of its children."""
    if isinstance(node, EventPattern):
        return [node.term]
    if isinstance(node, (ConditionPattern, ActionPattern)):
        return [node.goal]
    if isinstance(node, AggregatePattern):
        return [node.result] if node.value is None else [node.value, node.result]
    if isinstance(node, WindowPattern):
        measured = [value for value in node.values if value is not None]
        return [*measured, *node.window.navigated_vars, *node.results]
    if isinstance(node, RatePattern):
        return [*node.keys] if node.value is None else [node.value, *node.keys]
    if isinstance(node, AbsencePattern) and isinstance(node.span, Var):
        return [node.span]
    return []


def walk(pattern: Pattern, negated: bool = False) -> List[Pattern]:
    """Return the nodes of a pattern from left to right; with ``negated`` also those of negated patterns."""
    nodes: List[Pattern] = []
    # A stack, no recursion: a sequence of thousands of events is nested that deep.
    stack = [pattern]
    while stack:
        node = stack.pop()
        nodes.append(node)
        stack.extend(reversed(children(node, negated)))
    return nodes


def children(node: Pattern, negated: bool = True) -> Tuple[Pattern, ...]:
    """Return the children of a node, from left to right; with ``negated`` also a negated pattern."""
    if isinstance(node, PairPattern):
        return (node.left, node.right)
    if isinstance(node, OrPattern):
        return node.branches
    if isinstance(node, (NotPattern, AbsencePattern, NotPrecededPattern)):
        return (node.pattern, node.negated) if negated else (node.pattern,)
    if isinstance(node, KleenePattern):
        return (node.first, node.repeated)
    if isinstance(node, AggregatePattern):
        return (node.first, node.collected)
    if isinstance(node, WindowPattern):
        return (node.collected,)
    if isinstance(
        node,
        (RepeatedPattern, ConditionPattern, WithinPattern, ActionPattern, RatePattern, InstantPattern),
    ):
        return (node.pattern,)
    return ()


def rule_key(head: Optional[Term], pattern: Pattern) -> Hashable:
    """Return a key that is equal for rules that differ only in names of variables and spellings of operators."""
    return variant_key(
        (functor("<-", 2), functor("none", 0) if head is None else head, _pattern_key_term(pattern))
    )


def _pattern_key_term(pattern: Pattern) -> Term:
    terms: List[Term] = []
    for node in walk(pattern, True):
        name, numbers = _distinguishing_name_and_numbers(node)
        terms.append((functor(name, 0), *numbers, *own_terms(node), *_step_conditions(node)))
    return (functor("pattern", 0), *terms)


def _step_conditions(node: Pattern) -> List[Term]:
    steps = node.window.steps if isinstance(node, WindowPattern) else ()
    # A missing condition has a placeholder, so that a ``where`` never stands at the position of an ``until``.
    none = functor("none", 1)(0)
    return [none if goal is None else goal for step in steps for goal in (step.goal, step.until)]


def _distinguishing_name_and_numbers(node: Pattern) -> Tuple[str, Tuple[int, ...]]:
    """Return a name and numbers that distinguish a node from others with the same terms."""
    if isinstance(node, (PairPattern, InstantPattern)):
        return node.operator, ()
    if isinstance(node, AggregatePattern):
        return node.kind if node.setting is None else f"{node.kind} {node.setting!r}", ()
    if isinstance(node, RatePattern):
        return node.operator, (node.span,)
    if isinstance(node, WindowPattern):
        settings = " ".join(map(repr, node.settings))
        name = f"{node.window.kind} {' '.join(node.kinds)} {settings}"
        # Only the plain fields of steps: their conditions are terms, and compared as such.
        plain_parts = (
            *(step[:5] for step in node.window.steps),
            *node.scopes,
            node.window.skip,
            node.window.structure,
        )
        name += "".join(map(repr, plain_parts))
        window = node.window
        lengths = window.span, window.step, window.max_count, window.gap, window.max_length or 0
        return name, (*lengths, int(window.running), int(node.is_listed))
    return type(node).__name__, _distinguishing_numbers(node)


def _distinguishing_numbers(node: Pattern) -> Tuple[int, ...]:
    if isinstance(node, RepeatedPattern):
        return (node.times,)
    if isinstance(node, OrPattern):
        return (len(node.branches),)
    if isinstance(node, NotPattern):
        return (_SCOPE_NUMBERS[node.scope],)
    if isinstance(node, (WithinPattern, NotPrecededPattern)):
        return (node.span,)
    if isinstance(node, AbsencePattern):
        return () if isinstance(node.span, Var) else (node.span,)
    if isinstance(node, ConditionPattern):
        return (int(node.timed),)
    return (int(node.every),) if isinstance(node, ActionPattern) else ()


_SCOPE_NUMBERS = {NegationScope.BEFORE: 0, NegationScope.BETWEEN: 1, NegationScope.OVERLAP: 2}


def _variable_occurrences(term: Term) -> List[Var]:
    all_occurrences: List[Var] = []
    stack = [term]
    while stack:
        item = stack.pop()
        if item.__class__ is tuple:
            stack.extend(item[1:])
        elif item.__class__ is Var:
            # Bound variables are followed, so that two variables that were unified count as one.
            if item.ref is None:
                all_occurrences.append(item)
            else:
                stack.append(item.ref)
    return all_occurrences


def occurrences(terms: List[Term], pattern: Optional[Pattern]) -> Dict[Var, int]:
    """Count the occurrences of each variable in a rule."""
    counts: Dict[Var, int] = {}
    nodes = [] if pattern is None else walk(pattern, True)
    for term in [*terms, *(term for node in nodes for term in own_terms(node))]:
        for var in _variable_occurrences(term):
            counts[var] = counts.get(var, 0) + 1
    return counts


class RuleDefinition(NamedTuple):
    """Parsed rule.

    Attributes:
        term: the rule as it is written, without its label.
        head: the event that it raises; None for a pattern that only calls a goal.
        pattern: the pattern, including the goals of the head.
        label: the label, or None.
        place: position in the source.
        names: names of the variables.
    """

    term: Term
    head: Optional[Term]
    pattern: Pattern
    label: Optional[Term]
    place: Optional[Place]
    names: Mapping[Var, str] = MappingProxyType({})

    @property
    def key(self) -> Hashable:
        """Key that is equal for rules that differ only in names of variables, spellings and labels."""
        return rule_key(self.head, self.pattern)

    @property
    def unused(self) -> FrozenSet[Var]:
        """Variables with one occurrence; none if parts of the rule are repeated."""
        # A variable with one occurrence in a repeated part still joins the events of the repetitions.
        if any(
            isinstance(node, (RepeatedPattern, KleenePattern, AggregatePattern, WindowPattern))
            for node in walk(self.pattern, negated=True)
        ):
            return frozenset()
        counts = occurrences([self.term], None)
        return frozenset(var for var, count in counts.items() if count == 1)
