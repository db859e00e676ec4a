"""Patterns of event rules as plain data.

A pattern is one of the classes below; their fields are terms (`retalis.prolog.terms`), seconds, or patterns.
Nodes compare by identity: the same pattern written at two places of a rule is two nodes.
"""

from collections import Counter
from dataclasses import dataclass, fields, replace
from typing import Any, Dict, Iterable, Iterator, List, Optional, Tuple

from retalis import Term, Var
from retalis.prolog.terms.term_traversal import rebuild, variables
from retalis.prolog.terms.types import NIL


@dataclass(frozen=True, eq=False)
class Pattern:
    """Any pattern."""


@dataclass(frozen=True, eq=False)
class Leaf(Pattern):
    """An event that unifies with ``term``."""

    term: Term


@dataclass(frozen=True, eq=False)
class Both(Pattern):
    """``left kind right`` for the operators of `PAIRS`."""

    kind: str
    left: Pattern
    right: Pattern


@dataclass(frozen=True, eq=False)
class Or(Pattern):
    """``left or right``."""

    left: Pattern
    right: Pattern


@dataclass(frozen=True, eq=False)
class Where(Pattern):
    """``pattern where goal``."""

    pattern: Pattern
    goal: Term


@dataclass(frozen=True, eq=False)
class Prolog(Where):
    """``pattern seq prolog(goal)``, or with ``before`` in the opposite order; equivalent to `Where`."""

    before: bool = False
    name: str = "prolog"


@dataclass(frozen=True, eq=False)
class Check(Pattern):
    """``pattern check goal``."""

    pattern: Pattern
    goal: Term


@dataclass(frozen=True, eq=False)
class Within(Pattern):
    """``pattern within seconds``."""

    pattern: Pattern
    seconds: Any


@dataclass(frozen=True, eq=False)
class Do(Pattern):
    """``pattern do goal``."""

    pattern: Pattern
    goal: Term


@dataclass(frozen=True, eq=False)
class Multiply(Pattern):
    """``pattern event_multiply goal``."""

    pattern: Pattern
    goal: Term


@dataclass(frozen=True, eq=False)
class Cnot(Pattern):
    """``pattern cnot absent``."""

    pattern: Pattern
    absent: Pattern


@dataclass(frozen=True, eq=False)
class Fnot(Pattern):
    """``pattern fnot absent``."""

    pattern: Pattern
    absent: Pattern


@dataclass(frozen=True, eq=False)
class Without(Pattern):
    """``pattern without absent``."""

    pattern: Pattern
    absent: Pattern


@dataclass(frozen=True, eq=False)
class Instant(Pattern):
    """``at_end(pattern)`` or ``at_start(pattern)``."""

    pattern: Pattern
    name: str


@dataclass(frozen=True, eq=False)
class Star(Pattern):
    """``first seq (repeated star_times)``."""

    first: Pattern
    repeated: Pattern


@dataclass(frozen=True, eq=False)
class Ntimes(Pattern):
    """``pattern ntimes times``; the variables ``own`` occur once in the rule and are written ``_``."""

    pattern: Pattern
    times: int
    own: Tuple[Var, ...] = ()


@dataclass(frozen=True, eq=False)
class Aggregate(Pattern):
    """``first seq aggregate(kind(value), repeated, result)``; ``value`` is None for count."""

    first: Pattern
    kind: str
    value: Optional[Term]
    repeated: Pattern
    result: Term


@dataclass(frozen=True, eq=False)
class Windowed(Pattern):
    """``aggregate(kinds, collected, results, window)``; kinds are words, values and results lists of terms.

    The window is a name in `WINDOWS`, which defines the meaning of span and step, or ``steps``. A word may end with
    the number of its step, as in ``max@1``. So may the strategy after a match of steps.
    """

    kinds: str
    collected: Pattern
    values: Term
    results: Term
    window: str
    span: Any
    step: Any = 0
    steps: Term = NIL
    skip: str = "skip_past_last"


@dataclass(frozen=True, eq=False)
class Shaped(Pattern):
    """``pattern with shape(seconds, by)``, or with a list of the observed value in place of seconds."""

    pattern: Pattern
    shape: str
    seconds: Any
    value: Term
    by: Term


@dataclass(frozen=True, eq=False)
class Awaited(Pattern):
    """``pattern seq absent(absent, seconds)``; the seconds are a number or a variable of ``pattern``."""

    pattern: Pattern
    absent: Pattern
    seconds: Any


@dataclass(frozen=True, eq=False)
class Preceded(Pattern):
    """``pattern with not_preceded(absent, seconds)``."""

    pattern: Pattern
    absent: Pattern
    seconds: Any


@dataclass(frozen=True, eq=False)
class Sub(Pattern):
    """``(head <- pattern)`` inside a pattern."""

    head: Term
    pattern: Pattern


@dataclass(frozen=True, eq=False)
class Rule:
    """``head <- pattern``, with a label that may have a window in seconds and properties that override flags."""

    head: Term
    pattern: Pattern
    label: Optional[str] = None
    window: Any = None
    do: Optional[Term] = None
    """The goal of ``head do goal <- pattern``."""
    policy: Optional[str] = None
    """Its consumption policy; None for that of the flag."""
    out_of_order: Optional[bool] = None
    """Whether it accepts late first sides; None if the flag decides."""
    after_match: str = "keep"
    """After-match skip strategy of a fired match: keep, skip_past_last or skip_to_next."""

    def has_properties(self) -> bool:
        """Return whether its label has properties."""
        settings = self.window, self.policy, self.out_of_order
        return self.after_match != "keep" or any(value is not None for value in settings)

    def policy_by(self, flag: str) -> str:
        """Return its consumption policy. Labels: a property overrides the flag."""
        return flag if self.policy is None else self.policy

    def late_by(self, flag: bool) -> bool:
        """Return whether it accepts late first sides. Labels: a property overrides the flag."""
        return flag if self.out_of_order is None else self.out_of_order


NO_PROPERTIES: Dict[str, Any] = {"policy": None, "out_of_order": None, "after_match": "keep"}
"""Properties of a rule that override no flag."""
WINDOWS = {
    "last": "last({0})",
    "newest": "last({0},events)",
    "batch": "every({0},events)",
    "running_batch": "running(every({0},events))",
    "first": "every({0},first)",
    "running_first": "running(every({0},first))",
    "running": "running(every({0}))",
    "every": "last({0},every({1}))",
    "session": "session({0})",
    "bounded_session": "session({0},max({1}))",
    "held": "held(last({0},every({1})))",
    "bounded_held": "held(last({0},every({1})),max({0}))",
    "held_last": "held(last({0}))",
    "bounded_held_last": "held(last({0}),max({1}))",
}
"""Notation of windows with their span and step."""
HELD = ("held", "bounded_held", "held_last", "bounded_held_last")
"""Windows of values that last until the next one."""
HELD_KINDS = ("avg", "min", "max", "first", "last", "duration")
"""Aggregates of these windows."""
STREAMED = (Windowed, Shaped, Awaited, Preceded)
CONDITIONS = (Where, Check, Within, Without)
NEGATIONS = (Cnot, Fnot, Without)


def parts(node: Pattern) -> List[Any]:
    """Return the parts of a pattern from left to right: patterns, terms and numbers."""
    if isinstance(node, Prolog) and node.before:
        return [node.goal, node.pattern]
    return [getattr(node, field.name) for field in fields(node) if field.name != "own"]


def children(node: Pattern) -> List[Pattern]:
    """Return the patterns directly below a pattern."""
    return [part for part in parts(node) if isinstance(part, Pattern)]


def walk(node: Pattern) -> Iterator[Pattern]:
    """Yield a pattern and all patterns below it."""
    yield node
    for child in children(node):
        yield from walk(child)


def pattern_variables(node: Pattern) -> List[Var]:
    """Return the variables of a pattern, those of its goals included, from left to right."""
    result: List[Var] = []
    for part in parts(node):
        if isinstance(part, Pattern):
            result += pattern_variables(part)
        elif not isinstance(part, (str, bool)) and part is not None:
            result += variables(part)
    return list(dict.fromkeys(result))


def expand(node: Pattern) -> Pattern:
    """Return a pattern with every ``Q ntimes N`` expanded to a sequence."""
    changed: Dict[Any, Any] = {}
    for field in fields(node):
        part = getattr(node, field.name)
        if isinstance(part, Pattern):
            changed[field.name] = expand(part)
    if not isinstance(node, Ntimes):
        return replace(node, **changed)
    # "ntimes N is exactly Q seq ... seq Q, named variables shared, each _ fresh in each repetition"
    result = expand(node.pattern)
    for _ in range(node.times - 1):
        copies = {var: Var() for var in node.own}
        result = Both("seq", result, expand(renamed(node.pattern, copies)))
    return result


def renamed(node: Pattern, replacements: Dict[Var, Var]) -> Pattern:
    """Return a pattern with some variables replaced by others."""

    def changed(part: Any) -> Any:
        if isinstance(part, Pattern):
            return renamed(part, replacements)
        if part.__class__ is tuple and (not part or part[0].__class__ is Var):
            return tuple([replacements.get(var, var) for var in part])
        return (
            part
            if isinstance(part, (str, bool)) or part is None
            else rebuild(part, lambda v: replacements.get(v, v))
        )

    return replace(node, **{field.name: changed(getattr(node, field.name)) for field in fields(node)})


def with_own(rule: Rule) -> Rule:
    """Return a rule in which variables that occur only once, within an ``ntimes``, are written ``_``."""
    terms = [rule.head, *([] if rule.do is None else [rule.do])]
    counts = Counter(_occurrences((*terms, *_terms(rule.pattern))))

    def marked(node: Pattern) -> Pattern:
        changes: Dict[str, Any] = {
            field.name: marked(getattr(node, field.name))
            for field in fields(node)
            if isinstance(getattr(node, field.name), Pattern)
        }
        if isinstance(node, Ntimes):
            inside = pattern_variables(node)
            changes["own"] = tuple([var for var in inside if counts[var] == 1])
        return replace(node, **changes)

    return replace(rule, pattern=marked(rule.pattern))


def _terms(node: Pattern) -> List[Term]:
    """Return the terms in a pattern."""
    return [
        part
        for descendant in walk(node)
        for part in parts(descendant)
        if part is not None and not isinstance(part, (str, bool, Pattern))
    ]


def _occurrences(terms: Iterable[Term]) -> Iterator[Var]:
    """Yield every occurrence of a variable."""
    stack = list(terms)
    while stack:
        term = stack.pop()
        if term.__class__ is Var:
            yield term
        elif term.__class__ is tuple:
            stack += term[1:]


def take_out_subpatterns(rules: List[Rule]) -> List[Rule]:
    """Return the rules with S for each ``(S <- Q)``, and ``S <- Q`` as rules of their own after them."""
    extra: List[Rule] = []

    def plain(node: Pattern) -> Pattern:
        if isinstance(node, Sub):
            extra.append(Rule(node.head, plain(node.pattern)))
            return Leaf(node.head)
        changed = {
            field.name: plain(getattr(node, field.name))
            for field in fields(node)
            if isinstance(getattr(node, field.name), Pattern)
        }
        return replace(node, **changed)

    return [replace(rule, pattern=plain(rule.pattern)) for rule in rules] + extra


def strip(node: Pattern) -> Tuple[Pattern, List[Pattern]]:
    """Return the nearest operator (or leaf) at or below a pattern, and the conditions above it, lowest first.

    "A condition (where, within, check, without) belongs to the nearest operator below it, looking through other
    conditions."
    """
    conditions: List[Pattern] = []
    while isinstance(node, CONDITIONS):
        conditions.insert(0, node)
        node = node.pattern
    return node, conditions
