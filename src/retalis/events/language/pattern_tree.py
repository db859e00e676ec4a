"""Patterns of rules as trees.

How often variables stand in a rule.

What a rule says, read and checked.
"""

from types import MappingProxyType
from typing import Any, Dict, FrozenSet, Hashable, List, Mapping, NamedTuple, Optional, Set, Tuple, Union

from ...foundation.errors import Place
from ...prolog.terms.term_traversal import rebuild, variables, variant_key
from ...prolog.terms.types import Functor, Term, Var, functor

Pattern = Union[
    "Occurs",
    "Pair",
    "Repeated",
    "Either",
    "Absent",
    "Star",
    "Aggregate",
    "Condition",
    "Within",
    "Action",
    "Windowed",
    "Shaped",
    "Awaited",
]


class Occurs(NamedTuple):
    """An event that unifies with a term."""

    term: Term


class Pair(NamedTuple):
    """Two patterns joined by an operator of `OPERATORS`."""

    operator: str
    left: "Pattern"
    right: "Pattern"


class Repeated(NamedTuple):
    """A pattern several times in sequence; ``own`` are the variables that are fresh in each repetition."""

    pattern: "Pattern"
    times: int
    own: Tuple[Var, ...]

    def written_out(self) -> "Pattern":
        """Return the same as a sequence of patterns."""
        result: Pattern = self.pattern
        for _ in range(self.times - 1):
            fresh = {var: Var() for var in self.own}
            result = Pair(SEQ, result, with_others(self.pattern, fresh) if fresh else self.pattern)
        return result

    def is_of_single_events(self) -> bool:
        """Tell whether each repetition is one event, and of each event there is one match at most."""
        parts = walk(self.pattern)
        if not all(isinstance(part, (Occurs, Either, Condition, Within)) for part in parts):
            return False
        terms = [part.term for part in parts if isinstance(part, Occurs)]
        kinds = {term[0] if term.__class__ is tuple else term for term in terms}
        return len(terms) == 1 or (
            len(kinds) == len(terms) and not any(one.__class__ is Var for one in kinds)
        )


class Either(NamedTuple):
    """One of several patterns (``or``)."""

    branches: "Tuple[Pattern, ...]"


class Absent(NamedTuple):
    """A pattern, and no event of another one: between the sides of a sequence (``inside``), or ever before."""

    pattern: "Pattern"
    negated: "Pattern"
    inside: bool


class Star(NamedTuple):
    """A pattern, then another one any number of times."""

    first: "Pattern"
    repeated: "Pattern"


class Aggregate(NamedTuple):
    """A pattern, then another one any number of times, collected into a result."""

    first: "Pattern"
    kind: str
    value: Optional[Term]
    collected: "Pattern"
    result: Term


class Condition(NamedTuple):
    """A pattern and a goal that has to have a solution; ``timed`` gives the goal ``t1/1`` and ``t2/1``."""

    pattern: "Pattern"
    goal: Term
    timed: bool


class Within(NamedTuple):
    """A pattern that takes no longer than ``span`` nanoseconds."""

    pattern: "Pattern"
    span: int


class Action(NamedTuple):
    """A pattern and a goal to call: once (``do``), or for all of its solutions (``every``)."""

    pattern: "Pattern"
    goal: Term
    every: bool


class StepForm(NamedTuple):
    """A step of a window of steps: so many matches of its pattern for which a condition holds.

    Attributes:
        name: its name.
        least: how many, at least.
        most: how many, at most; None for any number.
        reluctant: whether it takes as few as it can, not as many.
        later: whether matches that fit no step are passed over before each of its own.
        goal: the condition, or None; it may look back by ``prev/1`` and the like.
        until: what holds for a match that ends it, or None.
    """

    name: str
    least: int
    most: Optional[int]
    reluctant: bool
    later: bool
    goal: Optional[Term]
    until: Optional[Term]

    @property
    def goals(self) -> List[Term]:
        """What it asks of matches."""
        return [goal for goal in (self.goal, self.until) if goal is not None]


class WindowForm(NamedTuple):
    """Which matches are measured together, and when the result is given on.

    Attributes:
        kind: ``last`` for those of the last ``span`` ns, ``newest`` for the last ``most``, ``every`` for windows of
            ``span`` ns one after the other, ``first`` for such that begin with a match, ``batch`` for ``most`` at
            a time, ``steps`` for those that take steps.
        span: how long, in ns.
        step: for ``every``, from one window's start to the next one's, in ns.
        most: how many.
        running: whether it is given on at each match, not only at a window's end.
        steps: the steps.
        looked_at: the variables of the pattern that the conditions of steps look at.
    """

    kind: str
    span: int = 0
    step: int = 0
    most: int = 0
    running: bool = False
    steps: Tuple[StepForm, ...] = ()
    looked_at: Tuple[Var, ...] = ()

    @property
    def goals(self) -> List[Term]:
        """What its steps ask of matches."""
        return [goal for step in self.steps for goal in step.goals]


class Windowed(NamedTuple):
    """The matches of a pattern that are in a window, measured together.

    Attributes:
        collected: the pattern.
        kinds: the names of the measures.
        settings: what each of them is set to, a term or a tuple of terms; None for most.
        values: what each of them is of; None where it is of no value.
        results: a term for the result of each measure; with ``listed`` one for the list of all of them.
        listed: see there.
        window: the window.
        scopes: for each measure the step that it looks at, or None for all.
    """

    collected: "Pattern"
    kinds: Tuple[str, ...]
    settings: Tuple[Any, ...]
    values: Tuple[Optional[Term], ...]
    results: Tuple[Term, ...]
    listed: bool
    window: WindowForm
    scopes: Tuple[Optional[int], ...]


class Shaped(NamedTuple):
    """A pattern, of whose matches some go on: ``by`` says which are looked at together.

    Attributes:
        pattern: the pattern.
        shape: which ones: the name of a shape.
        span: so many ns; 0 where it is about no time.
        value: what has to change, or None.
        by: terms; matches for which they are the same are looked at together.
    """

    pattern: "Pattern"
    shape: str
    span: int
    value: Optional[Term]
    by: Tuple[Term, ...]


class Awaited(NamedTuple):
    """A pattern, and no match of another one wholly within ``span`` ns after it."""

    pattern: "Pattern"
    negated: "Pattern"
    span: int


PATTERNS = (
    Occurs,
    Pair,
    Repeated,
    Either,
    Absent,
    Star,
    Aggregate,
    Condition,
    Within,
    Action,
    Windowed,
    Shaped,
    Awaited,
)
"""All kinds of patterns."""
SEQ = "seq"
MAX_REPETITIONS = 10_000
"""How many repetitions ``ntimes`` takes at most."""
MAX_COMPOSED_REPETITIONS = 1_000
"""The same where a repetition is more than one event: it is written out as a sequence then."""


def with_others(part: Pattern, fresh: Mapping[Var, Var]) -> Any:
    """Return a pattern with other variables in the place of some."""

    def renamed(found: Any) -> Any:
        if isinstance(found, (*PATTERNS, WindowForm, StepForm)):
            return found.__class__(*map(renamed, found))
        if found.__class__ is tuple and (not found or found[0].__class__ is not Functor):
            return tuple(map(renamed, found))  # the branches of an ``or``, the variables of repetitions
        return rebuild(found, lambda var: fresh.get(var, var)) if found.__class__ in (tuple, Var) else found

    return renamed(part)


def bound_by(pattern: Pattern, negated: bool = False) -> List[Var]:
    """Return the variables that a match of a pattern may give values to, from left to right; or all of them."""
    found: Dict[Var, None] = {}
    for part in walk(pattern, negated):
        for term in own_terms(part):
            for var in variables(term):
                found.setdefault(var)
    return list(found)


def surely_bound_by(pattern: Pattern, conditions: bool = True, empty: bool = False) -> Set[Var]:
    """Return the variables that every match of a pattern gives values to.

    Args:
        pattern: the pattern.
        conditions: whether those count that conditions give values to.
        empty: whether matches of aggregates that have no repetitions yet count too.
    """
    if isinstance(pattern, Either):
        branches = [surely_bound_by(branch, conditions, empty) for branch in pattern.branches]
        return set.intersection(*branches)
    if isinstance(pattern, Star) or (empty and isinstance(pattern, Aggregate)):
        return surely_bound_by(pattern.first, conditions, empty)
    counts = conditions or not isinstance(pattern, Condition)
    found = {var for term in own_terms(pattern) for var in variables(term)} if counts else set()
    for child in children(pattern, False):
        found |= surely_bound_by(child, conditions, empty)
    return found


def own_terms(part: Pattern) -> List[Term]:
    """Return the terms that stand at one node of a pattern itself."""
    if isinstance(part, Occurs):
        return [part.term]
    if isinstance(part, (Condition, Action)):
        return [part.goal]
    if isinstance(part, Aggregate):
        return [part.result] if part.value is None else [part.value, part.result]
    if isinstance(part, Windowed):
        measured = [value for value in part.values if value is not None]
        return [*measured, *part.window.looked_at, *part.results]
    if isinstance(part, Shaped):
        return [*part.by] if part.value is None else [part.value, *part.by]
    return []


def walk(pattern: Pattern, negated: bool = False) -> List[Pattern]:
    """Return the nodes of a pattern from left to right, what it negates only if asked for."""
    found: List[Pattern] = []
    stack = [pattern]
    while stack:
        part = stack.pop()
        found.append(part)
        stack.extend(reversed(children(part, negated)))
    return found


def children(part: Pattern, negated: bool = True) -> Tuple[Pattern, ...]:
    """Return the patterns directly below a node, from left to right."""
    if isinstance(part, Pair):
        return (part.left, part.right)
    if isinstance(part, Either):
        return part.branches
    if isinstance(part, (Absent, Awaited)):
        return (part.pattern, part.negated) if negated else (part.pattern,)
    if isinstance(part, Star):
        return (part.first, part.repeated)
    if isinstance(part, Aggregate):
        return (part.first, part.collected)
    if isinstance(part, Windowed):
        return (part.collected,)
    if isinstance(part, (Repeated, Condition, Within, Action, Shaped)):
        return (part.pattern,)
    return ()


def same_rule_key(head: Optional[Term], pattern: Pattern) -> Hashable:
    """Return a key: equal for rules that are the same but for the names of variables and spellings."""
    return variant_key((functor("<-", 2), functor("none", 0) if head is None else head, _as_term(pattern)))


def _as_term(pattern: Pattern) -> Term:
    parts: List[Term] = []
    for part in walk(pattern, True):
        kind, marks = _marked(part)
        parts.append((functor(kind, 0), *marks, *own_terms(part), *_conditions_of_steps(part)))
    return (functor("pattern", 0), *parts)


def _conditions_of_steps(part: Pattern) -> List[Term]:
    steps = part.window.steps if isinstance(part, Windowed) else ()
    none = functor("none", 1)(0)
    return [none if goal is None else goal for one in steps for goal in (one.goal, one.until)]


def _marked(part: Pattern) -> Tuple[str, Tuple[int, ...]]:
    """Return a name and numbers that tell a part from others with the same terms."""
    if isinstance(part, Pair):
        return part.operator, ()
    if isinstance(part, Aggregate):
        return part.kind, ()
    if isinstance(part, Shaped):
        return part.shape, (part.span,)
    if isinstance(part, Windowed):
        settings = " ".join(map(repr, part.settings))
        kind = f"{part.window.kind} {' '.join(part.kinds)} {settings}"
        kind += "".join(map(repr, (*(one[:5] for one in part.window.steps), *part.scopes)))
        return kind, (*part.window[1:4], int(part.window.running), int(part.listed))
    return type(part).__name__, _numbers(part)


def _numbers(part: Pattern) -> Tuple[int, ...]:
    if isinstance(part, Repeated):
        return (part.times,)
    if isinstance(part, Either):
        return (len(part.branches),)
    if isinstance(part, Absent):
        return (int(part.inside),)
    if isinstance(part, (Within, Awaited)):
        return (part.span,)
    if isinstance(part, Condition):
        return (int(part.timed),)
    return (int(part.every),) if isinstance(part, Action) else ()


def _each_variable(term: Term) -> List[Var]:
    """Return every occurrence of a variable in a term."""
    found: List[Var] = []
    stack = [term]
    while stack:
        item = stack.pop()
        if item.__class__ is tuple:
            stack.extend(item[1:])
        elif item.__class__ is Var:
            if item.ref is None:
                found.append(item)
            else:
                stack.append(item.ref)
    return found


def occurrences(terms: List[Term], pattern: Optional[Pattern]) -> Dict[Var, int]:
    """Count how often each variable stands in a rule."""
    counts: Dict[Var, int] = {}
    parts = [] if pattern is None else walk(pattern, True)
    for term in [*terms, *(term for part in parts for term in own_terms(part))]:
        for var in _each_variable(term):
            counts[var] = counts.get(var, 0) + 1
    return counts


class RuleDefinition(NamedTuple):
    """What a rule says.

    Attributes:
        term: the rule as it was written, without its label.
        head: the event that it fires; None for a pattern that only calls a goal.
        pattern: its pattern, the goals of the head included.
        label: its label, or None.
        place: where it stands.
        names: of its variables.
    """

    term: Term
    head: Optional[Term]
    pattern: Pattern
    label: Optional[Term]
    place: Optional[Place]
    names: Mapping[Var, str] = MappingProxyType({})

    @property
    def key(self) -> Hashable:
        """Equal for rules that are the same but for the names of variables, spellings and labels."""
        return same_rule_key(self.head, self.pattern)

    @property
    def unused(self) -> FrozenSet[Var]:
        """The variables that stand in one place of the rule only, where each place is matched once."""
        if any(
            isinstance(part, (Repeated, Star, Aggregate, Windowed))
            for part in walk(self.pattern, negated=True)
        ):
            return frozenset()
        counts = occurrences([self.term], None)
        return frozenset(var for var, number in counts.items() if number == 1)
