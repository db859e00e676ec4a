"""The patterns of rules, read from terms and checked on the way."""

from typing import Any, Callable, Dict, FrozenSet, List, Optional, Tuple

from ...foundation import Place, RuleError
from ...prolog.terms import Atom, String, Term, Var, deref, from_seconds, functor
from .calls import Subgoal, asking_interval, calls
from .meant import doubt
from .operators import OPERATORS
from .pattern import (
    MOST_TIMES,
    SEQ,
    Absent,
    Action,
    Aggregate,
    Condition,
    Either,
    Occurs,
    Pair,
    Repeated,
    Star,
    Within,
    bound_by,
    with_others,
)

Spot = Callable[..., Optional[Place]]
"""Gives the place of a compound term: that of its functor, or with a number that of an argument."""
_GOAL_OPERATORS = {"where": (True, False), "check": (True, True), "timestamp": (True, True)}
_GOALS_AS_PATTERN = frozenset((functor("prolog", 1), functor("query", 1), functor("db", 1)))
_AGGREGATES = {"count": 0, "sum": 1, "min": 1, "max": 1, "avg": 1, "list": 1}


def _spellings() -> Dict[Any, str]:
    names = [
        *OPERATORS,
        "or",
        "cnot",
        "fnot",
        "not",
        "ntimes",
        "where",
        "check",
        "timestamp",
        "event_multiply",
        "do",
    ]
    table = {}
    for name in names:
        title = "_".join(part.capitalize() for part in name.split("_"))
        for spelling in (name, name.capitalize(), title, name.upper()):
            table[functor(spelling, 2)] = name
    table[functor("within", 2)] = "within"
    for spelling, name in (("*", "seq"), ("#", "par"), ("/\\", "and"), ("\\/", "or")):
        table[functor(spelling, 2)] = name
    return table


SPELLINGS = _spellings()
STAR_TIMES = functor("star_times", 1)
AGGREGATE = functor("aggregate", 3)
ARROWS = frozenset(functor(name, 2) for name in ("<-", "iff", "IFF"))
_NOT_INSIDE = (
    "P cnot R where P is not a sequence means that no R ended before P started (write fnot); for no R between "
    "two events write (P seq Q) cnot R"
)


class PatternReader:
    """Turns the body of one rule into a pattern.

    Args:
        place: gives the place of a subterm in the rule's text, or None.
        warn: takes what is not an error but probably a mistake.
        anonymous: the variables ``_``: they stand once in the rule and have no name.

    Attributes:
        place: what gives the places.
        inner: the rules defined by the way, ``(S <- Q)`` inside a pattern.
        goals: what the goals call.
        untimed: calls of ``t1/1`` and ``t2/1`` that a goal cannot do without, where these do not hold.
        aggregates: the aggregates, each with its term.
    """

    def __init__(
        self, place: Spot, warn: Callable[[RuleError], None], anonymous: FrozenSet[Var] = frozenset()
    ):
        self.place = place
        self._warn = warn
        self._anonymous = anonymous
        self.inner: List[Term] = []
        self.goals: List[Subgoal] = []
        self.untimed: List[Subgoal] = []
        self.aggregates: List[Tuple[Aggregate, Term]] = []

    def read(self, parent: Term, number: int) -> Any:
        """Return the pattern that an argument of a term is.

        Raises:
            RuleError: for what cannot fire.
        """
        term = deref(parent[number])  # type: ignore[index]
        if term.__class__ is not tuple:
            return self._event(parent, number)
        head = term[0]
        if head in ARROWS:
            self.inner.append(term)
            return self._event(term, 1)
        name = SPELLINGS.get(head)
        if name is None:
            if head is STAR_TIMES:
                raise self._error("star_times can only be the right side of a seq", term)
            if head is AGGREGATE:
                raise self._error("an aggregate can only be the right side of a seq", term)
            return self._event(parent, number)
        if name == SEQ:
            return self._sequence(term)
        if name in OPERATORS:
            return Pair(name, self._operand(term, 1, name), self._operand(term, 2, name))
        if name == "or":
            return self._alternatives(term)
        if name == "not":
            raise self._error("there is no operator not; use cnot or fnot for the absence of an event", term)
        if name in ("cnot", "fnot"):
            return self._absence(name, term)
        if name == "ntimes":
            return self._repetition(term)
        if name == "within":
            return Within(self._operand(term, 1, name), self._span(term) - 1)
        pattern = self._operand(term, 1, name)
        goal = self.goal(term, 2, name)
        if name in _GOAL_OPERATORS:
            return Condition(pattern, goal, _GOAL_OPERATORS[name][1])
        return Action(pattern, goal, name == "event_multiply")

    def _operand(self, parent: Term, number: int, operator: str) -> Any:
        term = deref(parent[number])  # type: ignore[index]
        if term.__class__ is tuple and term[0] in _GOALS_AS_PATTERN:
            raise self._error(f"{term[0].name}(Goal) can only stand beside seq, not beside {operator}", term)
        return self.read(parent, number)

    def _event(self, parent: Term, number: int) -> Occurs:
        term = deref(parent[number])  # type: ignore[index]
        if term.__class__ not in (tuple, Atom, Var):
            kind = "a string" if term.__class__ is String else "a number"
            message = f"an event is an atom or a compound term, not {kind}"
            raise self._error(message, parent, number)
        doubted = doubt(term)
        if doubted is not None:
            self._warn(self._error(doubted, *((parent, number) if term.__class__ is Atom else (term, 0))))
        return Occurs(term)

    def _sequence(self, term: Term) -> Any:
        left, right = deref(term[1]), deref(term[2])
        left_goal = self._called(left)
        right_goal = self._called(right)
        if left_goal is not None and right_goal is not None:
            raise self._error("a sequence of two goals does not wait for any event", term)
        if right_goal is not None:
            return Condition(self.read(term, 1), right_goal, False)
        if left_goal is not None:
            return Condition(self.read(term, 2), left_goal, False)
        first = self.read(term, 1)
        if right.__class__ is tuple and right[0] is STAR_TIMES:
            return Star(first, self._operand(right, 1, "star_times"))
        if right.__class__ is tuple and right[0] is AGGREGATE:
            return self._aggregate(first, right)
        return Pair(SEQ, first, self.read(term, 2))

    def _called(self, term: Term) -> Optional[Term]:
        if term.__class__ is tuple and term[0] in _GOALS_AS_PATTERN:
            return self.goal(term, 1, term[0].name)
        return None

    def _aggregate(self, first: Any, term: Term) -> Aggregate:
        kind = deref(term[1])
        name = kind.name if kind.__class__ is Atom else kind[0].name if kind.__class__ is tuple else ""
        arity = len(kind) - 1 if kind.__class__ is tuple else 0
        if _AGGREGATES.get(name) != arity:
            known = "count, sum(X), min(X), max(X), avg(X), list(X)"
            raise self._error(
                f"there is no such aggregate; the aggregates are {known}", kind if arity else term
            )
        collected = self._operand(term, 2, "aggregate")
        found = Aggregate(first, name, deref(kind[1]) if arity else None, collected, deref(term[3]))
        self.aggregates.append((found, term))
        return found

    def _alternatives(self, term: Term) -> Either:
        branches: List[Any] = []
        pending = [(term, 2), (term, 1)]
        while pending:
            parent, number = pending.pop()
            one = deref(parent[number])  # type: ignore[index]
            if one.__class__ is tuple and SPELLINGS.get(one[0]) == "or":
                pending += [(one, 2), (one, 1)]
            else:
                branches.append(self._operand(parent, number, "or"))
        return Either(tuple(branches))

    def _absence(self, name: str, term: Term) -> Absent:
        pattern = self._operand(term, 1, name)
        negated = self._operand(term, 2, name)
        inside = name == "cnot" and _is_sequence(pattern)
        if name == "cnot" and not inside:
            self._warn(self._error(_NOT_INSIDE, term))
        return Absent(pattern, negated, inside)

    def _repetition(self, term: Term) -> Any:
        times = deref(term[2])
        if times.__class__ is not int or times < 1:
            raise self._error("ntimes needs a positive integer", term, 2)
        if times > MOST_TIMES:
            raise self._error(f"ntimes takes at most {MOST_TIMES} repetitions", term, 2)
        pattern = self._operand(term, 1, "ntimes")
        if times == 1:
            return pattern
        own = tuple([var for var in bound_by(pattern, True) if var in self._anonymous])
        fresh = {var: Var() for var in own}
        self._anonymous |= set(fresh.values())
        last = with_others(pattern, fresh) if fresh else pattern
        return Pair(SEQ, pattern if times == 2 else Repeated(pattern, times - 1, own), last)

    def _span(self, term: Any) -> int:
        span = deref(term[2])
        if span.__class__ not in (int, float) or not span > 0 or span == float("inf"):
            raise self._error("within needs a positive number of seconds", term, 2)
        return from_seconds(span)

    def goal(self, parent: Term, number: int, operator: str) -> Term:
        """Return the goal that an argument of a term is.

        Raises:
            RuleError: where it, or a part of it, cannot be called.
        """
        for call in calls(parent, number):
            if call.term.__class__ not in (tuple, Atom, Var):
                raise self._error(f"{operator} needs a goal", call.parent, call.number)
            self.goals.append(call)
        if operator not in _GOAL_OPERATORS or not _GOAL_OPERATORS[operator][1]:
            self.untimed += asking_interval(parent, number)
        return deref(parent[number])  # type: ignore[index]

    def _error(self, message: str, term: Term, number: int = 0) -> RuleError:
        return RuleError(message, self.place(term, number))


def _is_sequence(pattern: Any) -> bool:
    """Tell whether a pattern is a sequence, looking through conditions."""
    while isinstance(pattern, (Condition, Within)):
        pattern = pattern.pattern
    return isinstance(pattern, Pair) and pattern.operator == SEQ
