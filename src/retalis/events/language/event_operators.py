"""Table of event operators: the only list of the operators of the event language.

This module registers the syntax of the operators with the Prolog reader (`EventSyntax`). The compiler of patterns
takes their meaning from the table; explanations take the reason why a pair did not match. A further operator between
two patterns needs one more entry here.

``comparisons`` define when the intervals of a pair match. They are Python expressions over ``s1, e1, s2, e2``, the
start and end of the left and the right side, with the relations of Allen's interval algebra (CACM 26, 1983). They are
inserted into the code that is generated for each join node, and determine the range of an interval index in which
partners are searched.
"""

from enum import Enum
from typing import Dict, NamedTuple, Optional, Tuple

from ...foundation.displayed_text import format_count
from ...prolog.syntax.operators import EVENT_SYNTAX
from ...prolog.terms.types import Functor, functor


class OperatorKind(Enum):
    """Kinds of event operators; the values describe the arguments."""

    RULE = "an arrow or a label"
    ACTION = "a pattern, and a goal to call"
    CONDITION = "a pattern, and a goal that has to have a solution"
    LIMIT = "a pattern, and how long it may take"
    ALTERNATIVES = "one of two patterns"
    PAIR = "two patterns, and how their intervals lie"
    ABSENCE = "a pattern, and another that must not happen"
    UNSUPPORTED = "none, but looks like one"
    REPETITION = "a pattern, and how often"
    RUN = "a pattern any number of times"
    AGGREGATE = "a pattern any number of times, collected into a result"
    WINDOW = "a pattern whose matches in a window are measured together"
    RATE = "a pattern, and which of its matches go on"
    TIMEOUT = "a pattern that must not happen for some time"
    ABSENCE_BEFORE = "a pattern that must not have happened shortly before"
    INSTANT = "a pattern, of whose matches only one instant counts"


class PatternTableRow(NamedTuple):
    """A row of the table of patterns in the documentation.

    Attributes:
        matched: the condition under which it matches.
        interval: the interval of the match.
    """

    notation: str
    matched: str
    interval: str


class PatternReading(NamedTuple):
    """The words of a notation in readings of rules.

    The words contain the variables of the notation, which are replaced by the operands; ``N seconds`` by a duration.
    ``R is K`` is replaced by the results and the words of their aggregates, a list S of steps by a line for each.

    Attributes:
        words: the words, beginning with the condition under which the pattern matches.
    """

    notation: str
    words: str


class EventOperator(NamedTuple):
    """An operator of the event language.

    Attributes:
        name: canonical name; the capitalised and the upper-case spellings are equivalent.
        priority: 1 to 1200; 0 for operators in functional notation only.
        type: the type, as in ``op/3``.
        patterns: for each argument in functional notation, whether it is a pattern.
        signs: further names within patterns; elsewhere they are Prolog's operators.
        functors: spellings that are valid in functional notation, too; None for all.
        alias_of: the operator for which it is another name.
        allows_event_name: whether events may have its name, with another number of arguments and in heads.
        allows_fact_name: whether a fact may have its name; otherwise the fact was meant as a rule.
        has_interval_predicates: whether ``t1/1`` and ``t2/1`` are defined within its goal.
        calls_for_all_solutions: whether its goal is called for all of its solutions.
        comparisons: conditions on the intervals of a pair; all must hold.
        start: start of the result of a pair.
        end: end of the result of a pair.
        completes_in_any_order: whether the sides may arrive in either order; otherwise only the right side completes
            a pair (a late left side does under ``out_of_order``).
        can_share_event: whether a single event could be both sides if nothing excluded it.
        joins_all_left: whether a right side matches all left sides that fit, under every consumption policy.
        no_match_text: explanation if no pair matches.
        notation: the notation, for operators in functional notation only.
        confused_words: words that are no operators, but are often used in place of this one.
        advice: what to write in place of these words.
        readings: words for readings of rules, for notations that are not in ``table_rows``, or whose words there
            refer to another row. `PatternReading` describes the words.
    """

    name: str
    kind: OperatorKind
    priority: int = 0
    type: str = "yfx"
    patterns: Tuple[bool, ...] = (True, True)
    signs: Tuple[str, ...] = ()
    functors: Optional[Tuple[str, ...]] = None
    alias_of: str = ""
    allows_event_name: bool = True
    allows_fact_name: bool = True
    has_interval_predicates: bool = False
    calls_for_all_solutions: bool = False
    comparisons: Tuple[str, ...] = ()
    start: str = "s1 if s1 <= s2 else s2"
    end: str = "e1 if e1 >= e2 else e2"
    completes_in_any_order: bool = True
    can_share_event: bool = True
    joins_all_left: bool = False
    no_match_text: str = "no pair fits"
    notation: str = ""
    confused_words: Tuple[str, ...] = ()
    advice: str = ""
    table_rows: Tuple[PatternTableRow, ...] = ()
    readings: Tuple[PatternReading, ...] = ()

    @property
    def canonical_name(self) -> str:
        """Name of the operator that this name denotes."""
        return self.alias_of or self.name

    @property
    def spellings(self) -> Tuple[str, ...]:
        """All spellings."""
        if self.functors is not None and self.name not in self.functors and not self.priority:
            return self.functors
        return (self.name, self.name.capitalize(), self.name.title(), self.name.upper())

    @property
    def keys(self) -> Tuple[Functor, ...]:
        """Functors of the terms that it builds, and of those that denote it in functional notation."""
        names = self.spellings if self.functors is None else self.functors
        return tuple([functor(name, len(self.patterns)) for name in (*names, *self.signs)])

    @property
    def interval_condition(self) -> str:
        """The condition on the intervals of a pair, as an expression."""
        return " and ".join(self.comparisons) or "True"


_GOAL = (True, False)


def _interval_condition_reading(name: str) -> PatternReading:
    return PatternReading(
        f"P {name} G", "P happened, and goal G, in which t1 and t2 are its start and end, has a solution"
    )


EVENT_OPERATORS: Tuple[EventOperator, ...] = (
    EventOperator("rule:", OperatorKind.RULE, 1200, "xfy", (False, True), functors=("rule:",)),
    EventOperator(
        "<-",
        OperatorKind.RULE,
        1200,
        "xfy",
        (False, True),
        readings=(PatternReading("S <- Q", "Q happened, which emits S"),),
    ),
    EventOperator(
        "iff", OperatorKind.RULE, 1200, "xfy", (False, True), functors=("iff", "IFF"), alias_of="<-"
    ),
    EventOperator(
        "do",
        OperatorKind.ACTION,
        1124,
        patterns=_GOAL,
        table_rows=(
            PatternTableRow("`P do G`", "P happened, and G, which is called once, succeeded", "that of P"),
        ),
    ),
    EventOperator(
        "with",
        OperatorKind.RATE,
        1065,
        patterns=_GOAL,
        table_rows=(
            PatternTableRow("`P with throttle(N)`", "P happened, at most once in N seconds", "that of P"),
            PatternTableRow(
                "`P with burst(N)`", "P happened, and no other P ended in the N seconds before", "that of P"
            ),
            PatternTableRow(
                "`P with debounce(N)`", "P happened, and no other P for N seconds after it", "[s,e+N]"
            ),
            PatternTableRow(
                "`P with change(X)`", "P happened, and X differs from the X of the previous P", "that of P"
            ),
            PatternTableRow(
                "`P with change_after_first(X)`",
                "P happened, and the previous P had another X",
                "that of P",
            ),
            PatternTableRow(
                "`P with not_preceded(Q,N)`",
                "P happened, and no Q ended in the N seconds before P started",
                "that of P",
            ),
        ),
        readings=(
            PatternReading("P with throttle(N, K)", "P happened, at most once in N seconds for each K"),
            PatternReading(
                "P with burst(N, K)",
                "P happened, and no other P with the same K ended in the N seconds before",
            ),
            PatternReading(
                "P with debounce(N, K)", "P happened, and no other P with the same K for N seconds after it"
            ),
            PatternReading(
                "P with change(X, K)",
                "P happened, and X differs from the X of the previous P with the same K",
            ),
            PatternReading(
                "P with change_after_first(X, K)",
                "P happened, and the previous P with the same K had another X",
            ),
        ),
    ),
    EventOperator(
        "where",
        OperatorKind.CONDITION,
        1060,
        patterns=_GOAL,
        table_rows=(PatternTableRow("`P where G`", "P happened, and goal G has a solution", "that of P"),),
    ),
    EventOperator(
        "within",
        OperatorKind.LIMIT,
        1055,
        "xfy",
        patterns=_GOAL,
        functors=("within",),
        table_rows=(PatternTableRow("`P within N`", "P happened and took less than N seconds", "that of P"),),
    ),
    EventOperator(
        "or",
        OperatorKind.ALTERNATIVES,
        1053,
        signs=("\\/",),
        allows_event_name=False,
        table_rows=(PatternTableRow("`P or Q`", "P or Q happened", "that of P or Q"),),
    ),
    EventOperator(
        "check",
        OperatorKind.CONDITION,
        1050,
        patterns=_GOAL,
        has_interval_predicates=True,
        table_rows=(
            PatternTableRow(
                "`P check G`, `P timestamp G`", "as `where`, with `t1(S)` and `t2(E)` inside G", "that of P"
            ),
        ),
        readings=(_interval_condition_reading("check"),),
    ),
    EventOperator(
        "timestamp",
        OperatorKind.CONDITION,
        1050,
        patterns=_GOAL,
        has_interval_predicates=True,
        readings=(_interval_condition_reading("timestamp"),),
    ),
    EventOperator(
        "event_multiply",
        OperatorKind.ACTION,
        1050,
        patterns=_GOAL,
        allows_event_name=False,
        allows_fact_name=False,
        calls_for_all_solutions=True,
        table_rows=(
            PatternTableRow(
                "`P event_multiply G`", "P happened; one match for each solution of G", "that of P"
            ),
        ),
    ),
    EventOperator(
        "par",
        OperatorKind.PAIR,
        1045,
        signs=("#",),
        comparisons=("s1 < e2", "s2 < e1", "s1 < e1", "s2 < e2"),
        no_match_text="no two of them overlap",
        table_rows=(
            PatternTableRow(
                "`P par Q`", "P and Q overlap by more than an instant", "from the first start to the last end"
            ),
        ),
    ),
    EventOperator(
        "and",
        OperatorKind.PAIR,
        1040,
        signs=("/\\",),
        allows_event_name=False,
        table_rows=(
            PatternTableRow(
                "`P and Q`", "P and Q happened, in any order", "from the first start to the last end"
            ),
        ),
    ),
    EventOperator(
        "cnot",
        OperatorKind.ABSENCE,
        1031,
        allows_event_name=False,
        allows_fact_name=False,
        table_rows=(
            PatternTableRow(
                "`(P seq Q) cnot R`", "P happened, then Q, and no R entirely between them", "[s1,e2]"
            ),
            PatternTableRow(
                "`P cnot R`, `P fnot R`", "P happened, and no R ended before P started", "that of P"
            ),
        ),
    ),
    EventOperator("fnot", OperatorKind.ABSENCE, 1031, allows_event_name=False, allows_fact_name=False),
    EventOperator(
        "without",
        OperatorKind.ABSENCE,
        1031,
        allows_event_name=False,
        allows_fact_name=False,
        table_rows=(
            PatternTableRow(
                "`P without R`", "P happened, and no R overlaps it: no sR < e1 with s1 < eR", "that of P"
            ),
        ),
        readings=(PatternReading("P without R", "P happened, and no R overlaps it"),),
    ),
    EventOperator("not", OperatorKind.UNSUPPORTED, 1031),
    EventOperator(
        "seq",
        OperatorKind.PAIR,
        1025,
        signs=("*",),
        allows_event_name=False,
        allows_fact_name=False,
        comparisons=("e1 < s2",),
        start="s1",
        end="e2",
        completes_in_any_order=False,
        can_share_event=False,
        no_match_text="none of the first ended before one of the second started",
        confused_words=("before", "after", "then", "followed_by"),
        advice='to say that one event ends before another starts, write "seq", the earlier one first',
        table_rows=(PatternTableRow("`P seq Q`", "P ended before Q started: e1 < s2", "[s1,e2]"),),
        readings=tuple(
            PatternReading(notation.format(name), "P happened, and goal G has a solution")
            for name in ("prolog", "query", "db")
            for notation in ("P seq {}(G)", "{}(G) seq P")
        ),
    ),
    EventOperator(
        "forall_seq",
        OperatorKind.PAIR,
        1025,
        allows_event_name=False,
        allows_fact_name=False,
        comparisons=("e1 < s2",),
        start="s1",
        end="e2",
        completes_in_any_order=False,
        can_share_event=False,
        joins_all_left=True,
        no_match_text="none of the first ended before one of the second started",
        table_rows=(PatternTableRow("`P forall_seq Q`", "as `seq`, once for each waiting P", "[s1,e2]"),),
        readings=(PatternReading("P forall_seq Q", "P ended before Q started, once for each waiting P"),),
    ),
    EventOperator(
        "equals",
        OperatorKind.PAIR,
        1025,
        comparisons=("s1 == s2", "e1 == e2"),
        start="s1",
        end="e1",
        no_match_text="no two of them have the same interval",
        table_rows=(PatternTableRow("`P equals Q`", "P and Q have the same interval", "that interval"),),
    ),
    EventOperator(
        "meets",
        OperatorKind.PAIR,
        1025,
        comparisons=("e1 == s2",),
        start="s1",
        end="e2",
        no_match_text="none of the first ended when one of the second started",
        table_rows=(PatternTableRow("`P meets Q`", "Q starts when P ends: e1 = s2", "[s1,e2]"),),
    ),
    EventOperator(
        "during",
        OperatorKind.PAIR,
        1025,
        comparisons=("s2 <= s1", "e1 <= e2"),
        start="s2",
        end="e2",
        no_match_text="none of the first lies within one of the second",
        table_rows=(PatternTableRow("`P during Q`", "P lies within Q, ends included", "that of Q"),),
    ),
    EventOperator(
        "starts",
        OperatorKind.PAIR,
        1025,
        comparisons=("s1 == s2", "e1 < e2"),
        start="s2",
        end="e2",
        can_share_event=False,
        no_match_text="none of the first starts with one of the second and ends before it",
        table_rows=(
            PatternTableRow("`P starts Q`", "P and Q start together, and P ends first", "that of Q"),
        ),
    ),
    EventOperator(
        "finishes",
        OperatorKind.PAIR,
        1025,
        comparisons=("e1 == e2", "s2 < s1"),
        start="s2",
        end="e2",
        can_share_event=False,
        no_match_text="none of the first ends with one of the second and starts after it",
        table_rows=(
            PatternTableRow("`P finishes Q`", "P and Q end together, and P started later", "that of Q"),
        ),
    ),
    EventOperator(
        "ntimes",
        OperatorKind.REPETITION,
        1025,
        patterns=_GOAL,
        allows_event_name=False,
        allows_fact_name=False,
        table_rows=(
            PatternTableRow(
                "`Q ntimes N`", "Q happened N times in sequence", "from the first start to the last end"
            ),
        ),
    ),
    EventOperator(
        "star_times",
        OperatorKind.RUN,
        200,
        "xf",
        patterns=(True,),
        functors=("star_times",),
        allows_event_name=False,
        table_rows=(
            PatternTableRow(
                "`P seq (Q star_times)`", "P happened, and again at each later Q", "[s1, end of the last Q]"
            ),
        ),
    ),
    EventOperator(
        "aggregate",
        OperatorKind.AGGREGATE,
        patterns=(False, True, False),
        functors=("aggregate",),
        allows_event_name=False,
        notation="aggregate(Kind, Pattern, Result)",
        table_rows=(
            PatternTableRow(
                "`P seq aggregate(K,Q,R)`",
                "as `star_times`; R is computed from the Q so far",
                "[s1, end of the last Q]",
            ),
        ),
        readings=(
            PatternReading("P seq aggregate(K,Q,R)", "P happened, and again at each later Q; R is K since P"),
        ),
    ),
    EventOperator(
        "aggregate_over",
        OperatorKind.WINDOW,
        patterns=(False, True, False, False),
        functors=("aggregate",),
        notation="aggregate(Kind, Pattern, Result, Window)",
        table_rows=(
            PatternTableRow(
                "`aggregate(K,Q,R,W)`",
                "Q happened, or window W ended; R is computed from the Q in W",
                "that of these Q, or of W",
            ),
        ),
        readings=(
            PatternReading("aggregate(K,Q,R,last(N))", "Q happened; R is K in the last N seconds"),
            PatternReading("aggregate(K,Q,R,last(N,events))", "Q happened; R is K in the last N of them"),
            PatternReading(
                "aggregate(K,Q,R,every(N))",
                "Q happened in a period of N seconds, counted from 1970, that has ended; R is K in this period",
            ),
            PatternReading(
                "aggregate(K,Q,R,every(N,first))",
                "N seconds passed after a first Q; R is K in this time",
            ),
            PatternReading(
                "aggregate(K,Q,R,every(N,events))",
                "Q happened N times; R is K in them, and a new count begins",
            ),
            PatternReading(
                "aggregate(K,Q,R,last(N,every(M)))",
                "Q happened in the last N seconds, checked every M seconds; R is K in this time",
            ),
            PatternReading(
                "aggregate(K,Q,R,running(every(N)))",
                "Q happened; R is K so far in the current period of N seconds, counted from 1970",
            ),
            PatternReading(
                "aggregate(K,Q,R,running(every(N,first)))",
                "Q happened; R is K so far in the N seconds that a first Q has begun",
            ),
            PatternReading(
                "aggregate(K,Q,R,running(every(N,events)))",
                "Q happened; R is K so far in the current group of N of them",
            ),
            PatternReading(
                "aggregate(K,Q,R,session(N))",
                "no Q happened for N seconds; R is K since the last such pause",
            ),
            PatternReading(
                "aggregate(K,Q,R,session(N,max(M)))",
                "no Q happened for N seconds, or M seconds passed after the first of them; R is K in them",
            ),
            PatternReading(
                "aggregate(K,Q,R,held(last(N)))",
                "Q happened; R is K in the last N seconds, in which each Q lasts until the next one",
            ),
            PatternReading(
                "aggregate(K,Q,R,held(last(N),max(M)))",
                "Q happened; R is K in the last N seconds, in which each Q lasts until the next one, at most "
                "M seconds",
            ),
            PatternReading(
                "aggregate(K,Q,R,held(every(N)))",
                "a period of N seconds, counted from 1970, has ended; R is K in this period, in which each Q lasts "
                "until the next one",
            ),
            PatternReading(
                "aggregate(K,Q,R,held(every(N),max(M)))",
                "a period of N seconds, counted from 1970, has ended; R is K in this period, in which each Q lasts "
                "until the next one, at most M seconds",
            ),
            PatternReading(
                "aggregate(K,Q,R,held(last(N,every(M))))",
                "Q lasted in the last N seconds, checked every M seconds; R is K in this time, in which each Q lasts "
                "until the next one",
            ),
            PatternReading(
                "aggregate(K,Q,R,held(last(N,every(M)),max(L)))",
                "Q lasted in the last N seconds, checked every M seconds; R is K in this time, in which each Q lasts "
                "until the next one, at most L seconds",
            ),
            PatternReading("aggregate(K,Q,R,steps(S))", "Q happened in these steps; R is K in them"),
            PatternReading("aggregate(K,Q,R,steps(S,O))", "Q happened in these steps; R is K in them"),
            PatternReading(
                "aggregate(K,Q,R,timed_out(steps(S),N))",
                "Q began these steps, and did not complete them within N seconds; R is K in them so far",
            ),
            PatternReading(
                "aggregate(K,Q,R,timed_out(steps(S,O),N))",
                "Q began these steps, and did not complete them within N seconds; R is K in them so far",
            ),
        ),
    ),
    EventOperator(
        "absent",
        OperatorKind.TIMEOUT,
        patterns=(True, False),
        notation="absent(Pattern, Seconds)",
        table_rows=(
            PatternTableRow(
                "`P seq absent(Q,N)`", "N seconds passed after P ended, with no Q in between", "[s1,e1+N]"
            ),
        ),
    ),
    EventOperator(
        "not_preceded",
        OperatorKind.ABSENCE_BEFORE,
        patterns=(True, False),
        functors=("not_preceded",),
        allows_event_name=False,
        allows_fact_name=False,
        notation="not_preceded(Pattern, Seconds)",
        readings=(
            PatternReading(
                "P with not_preceded(Q, N)", "P happened, and no Q ended in the N seconds before P started"
            ),
        ),
    ),
    EventOperator(
        "at_end",
        OperatorKind.INSTANT,
        patterns=(True,),
        functors=("at_end",),
        allows_event_name=False,
        allows_fact_name=False,
        notation="at_end(Pattern)",
        table_rows=(PatternTableRow("`at_end(P)`", "P happened", "[e,e], the instant of its end"),),
        readings=(PatternReading("at_end(P)", "P happened; only the instant of its end counts"),),
    ),
    EventOperator(
        "at_start",
        OperatorKind.INSTANT,
        patterns=(True,),
        functors=("at_start",),
        allows_event_name=False,
        allows_fact_name=False,
        notation="at_start(Pattern)",
        table_rows=(PatternTableRow("`at_start(P)`", "P happened", "[s,s], the instant of its start"),),
        readings=(PatternReading("at_start(P)", "P happened; only the instant of its start counts"),),
    ),
)
"""All event operators, the highest priority first, as ``current_op/3`` lists them."""

EVENT_OPERATORS_BY_NAME: Dict[str, EventOperator] = {operator.name: operator for operator in EVENT_OPERATORS}

PAIR_OPERATORS: Dict[str, EventOperator] = {
    operator.name: operator for operator in EVENT_OPERATORS if operator.kind is OperatorKind.PAIR
}
"""Operators between two patterns, by name."""

_RUN_OPERATOR_KINDS = (OperatorKind.RUN, OperatorKind.AGGREGATE, OperatorKind.TIMEOUT)

OPERATOR_NAMES: Dict[Functor, str] = {
    key: operator.name
    for operator in EVENT_OPERATORS
    if operator.kind not in (OperatorKind.RULE, OperatorKind.ABSENCE_BEFORE, *_RUN_OPERATOR_KINDS)
    for key in operator.keys
}
"""Names of the operators that terms denote within a pattern, by the functors of the terms."""

RUN_OPERATORS: Dict[Functor, EventOperator] = {
    key: operator
    for operator in EVENT_OPERATORS
    if operator.kind in _RUN_OPERATOR_KINDS
    for key in operator.keys
}
"""Operators that terms denote as the right side of a sequence, and only there, by the functors of the terms."""

ARROWS = frozenset(
    key for operator in EVENT_OPERATORS if operator.canonical_name == "<-" for key in operator.keys
)
"""Functors of rules with a head and a pattern."""

RESERVED_EVENT_ARITIES = {
    operator.name: len(operator.patterns) for operator in EVENT_OPERATORS if not operator.allows_event_name
}
"""Names that events cannot have with this number of arguments; with another number, they are events."""

FUNCTIONAL_FORMS = tuple(
    (name, len(operator.patterns), operator.notation)
    for operator in EVENT_OPERATORS
    if operator.notation
    for name in operator.functors or (operator.name,)
)
"""Name, number of arguments and notation of the operators in functional notation only."""


def _build_notations() -> Dict[str, str]:
    texts: Dict[str, str] = {}
    for name, count, notation in FUNCTIONAL_FORMS:
        arity_text = (
            f"{texts[name]}, or {count}" if name in texts else f"takes {format_count(count, 'argument')}"
        )
        texts[name] = f"{arity_text}: {notation}"
    return texts


NOTATIONS = _build_notations()
"""Notation of the operators in functional notation only, in words, by name."""

RESERVED_FACT_FUNCTORS = frozenset(
    key for operator in EVENT_OPERATORS if not operator.allows_fact_name for key in operator.keys[:1]
)
"""Functors of facts that were meant as rules, because no fact can have the name."""


def names_of_kind(kind: OperatorKind, **attributes: bool) -> Tuple[str, ...]:
    """Return the names of the operators of a kind with certain attributes, in the order of the table."""
    return tuple(
        [
            operator.name
            for operator in EVENT_OPERATORS
            if operator.kind is kind
            and all(getattr(operator, attribute) == value for attribute, value in attributes.items())
        ]
    )


EVENT_SYNTAX.register(
    [(operator.priority, operator.type, operator.name) for operator in EVENT_OPERATORS if operator.priority],
    canonical={
        spelling: operator.canonical_name
        for operator in EVENT_OPERATORS
        if operator.priority
        for spelling in operator.spellings
    },
    signs={sign: operator.name for operator in EVENT_OPERATORS for sign in operator.signs},
    arrows=frozenset(
        operator.canonical_name for operator in EVENT_OPERATORS if operator.kind is OperatorKind.RULE
    ),
    goal_right=frozenset(
        functor(operator.name, 2)
        for operator in EVENT_OPERATORS
        if operator.kind in (OperatorKind.ACTION, OperatorKind.CONDITION, OperatorKind.LIMIT)
    ),
    pattern_arguments={
        functor(operator.name, len(operator.patterns)): operator.patterns
        for operator in EVENT_OPERATORS
        if operator.kind is not OperatorKind.RULE or operator.name == "<-"
    },
    joining=[
        operator.name
        for operator in EVENT_OPERATORS
        if operator.kind in (OperatorKind.ALTERNATIVES, OperatorKind.PAIR)
    ],
    advice={word: operator.advice for operator in EVENT_OPERATORS for word in operator.confused_words},
)
