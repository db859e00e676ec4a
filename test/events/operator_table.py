"""Definitions of the operators as data, written by hand from the language reference.

`test_operator_table` uses the examples, the oracle the definitions of pairs, and the fuzzer the names.
Times are seconds. Every pattern binds X; the streams that fire do so with X = 1.
"""

from typing import Any, Callable, NamedTuple, Tuple

Event = Tuple[str, float, float]


class Row(NamedTuple):
    """One operator.

    Attributes:
        pattern: the pattern, whose variable X joins its parts.
        fires: a stream for which it fires.
        results: the intervals of the results, in order.
        never: a stream for which it does not fire.
        late: the events of `fires` with a late first side, where the pattern has two sides.
        either: whether the sides may arrive in either order.
        waits: whether the last event completes a partial match.
        back: number of results that the retraction of the first event retracts; -1: all.
        tick: an event that moves the clock of the rule and matches no pattern.
        expires: whether partial matches have expired after that event.
    """

    pattern: str
    fires: Tuple[Event, ...]
    results: Tuple[Tuple[float, float], ...]
    never: Tuple[Event, ...]
    late: Tuple[Event, ...] = ()
    either: bool = True
    waits: bool = True
    back: int = -1
    tick: str = "a(9)"
    expires: bool = False

    @property
    def derived(self) -> int:
        """Number of results that the retraction of the first event retracts."""
        return len(self.results) if self.back < 0 else self.back


class Pair(NamedTuple):
    """An operator between two patterns, as functions of their matches ``p`` and ``q``.

    Attributes:
        fits: returns whether the pair matches.
        interval: returns the interval of the result.
        either: whether the sides may arrive in either order.
    """

    fits: Callable[[Any, Any], bool]
    interval: Callable[[Any, Any], Tuple[Any, Any]]
    either: bool = True


def hull(p: Any, q: Any) -> Tuple[Any, ...]:
    return min(p.start, q.start), max(p.end, q.end)


def first_to_second(p: Any, q: Any) -> Tuple[Any, ...]:
    return p.start, q.end


def second(p: Any, q: Any) -> Tuple[Any, ...]:
    return q.start, q.end


PAIRS = {
    "seq": Pair(lambda p, q: p.end < q.start, first_to_second, False),
    "and": Pair(lambda p, q: True, hull),
    "par": Pair(lambda p, q: max(p.start, q.start) < min(p.end, q.end), hull),
    "equals": Pair(lambda p, q: p.start == q.start and p.end == q.end, second),
    "meets": Pair(lambda p, q: p.end == q.start, first_to_second),
    "during": Pair(lambda p, q: q.start <= p.start and p.end <= q.end, second),
    "starts": Pair(lambda p, q: p.start == q.start and p.end < q.end, second),
    "finishes": Pair(lambda p, q: p.end == q.end and q.start < p.start, second),
    "forall_seq": Pair(lambda p, q: p.end < q.start, first_to_second, False),
}
EITHER_ORDER = tuple(name for name, operator in PAIRS.items() if operator.either)
INSTANTS = ("at_end", "at_start")
AGGREGATES = (
    "count",
    "sum",
    "min",
    "max",
    "avg",
    "stddev",
    "median",
    "quantile",
    "first",
    "last",
    "list",
    "distinct",
    "count_distinct",
    "changes",
    "rate",
    "fold",
)
VALUELESS_AGGREGATES = ("count", "rate")
AGGREGATES_WITH_SETTINGS = ("quantile", "fold")


def pair(
    operator: str,
    first: Tuple[Any, ...],
    second: Tuple[Any, ...],
    result: Tuple[Any, ...],
    never: Tuple[Any, ...],
) -> Row:
    """Return the row of an operator between a(X) and b(X)."""
    left, right = ("a(1)", *first), ("b(1)", *second)
    either = PAIRS[operator].either
    return Row(f"a(X) {operator} b(X)", (left, right), (result,), never, (right, left), either)


ROWS = {
    "seq": pair("seq", (1, 2), (3, 5), (1, 5), (("a(1)", 1, 3), ("b(1)", 3, 5))),
    "forall_seq": pair("forall_seq", (1, 2), (3, 5), (1, 5), (("a(1)", 1, 3), ("b(1)", 3, 5))),
    "and": pair("and", (4, 5), (1, 2), (1, 5), (("a(1)", 1, 2), ("b(2)", 1, 2))),
    "par": pair("par", (1, 4), (3, 6), (1, 6), (("a(1)", 1, 3), ("b(1)", 3, 6))),
    "equals": pair("equals", (1, 4), (1, 4), (1, 4), (("a(1)", 1, 4), ("b(1)", 1, 4.001))),
    "meets": pair("meets", (1, 3), (3, 6), (1, 6), (("a(1)", 1, 3), ("b(1)", 3.001, 6))),
    "during": pair("during", (1, 4), (1, 6), (1, 6), (("a(1)", 0.9, 4), ("b(1)", 1, 6))),
    "starts": pair("starts", (1, 4), (1, 6), (1, 6), (("a(1)", 1, 6), ("b(1)", 1, 6))),
    "finishes": pair("finishes", (3, 6), (1, 6), (1, 6), (("a(1)", 1, 6), ("b(1)", 1, 6))),
    "or": Row(
        "a(X) or b(X)",
        (("a(1)", 1, 3), ("b(1)", 4, 6)),
        ((1, 3), (4, 6)),
        (("c(1)", 1, 3),),
        waits=False,
        back=1,
    ),
    "where": Row("a(X) where X < 5", (("a(1)", 1, 3),), ((1, 3),), (("a(7)", 1, 3),), waits=False),
    "within": Row(
        "(a(X) seq b(X)) within 4.5",
        (("a(1)", 1, 2), ("b(1)", 3, 5)),
        ((1, 5),),
        (("a(1)", 1, 2), ("b(1)", 3, 5.5)),
        (("b(1)", 3, 5), ("a(1)", 1, 2)),
        False,
        expires=True,
    ),
    "check": Row(
        "a(X) check (t1(S), t2(E), E - S < 3)", (("a(1)", 1, 3),), ((1, 3),), (("a(1)", 1, 4),), waits=False
    ),
    "timestamp": Row("a(X) timestamp t1(1)", (("a(1)", 1, 3),), ((1, 3),), (("a(1)", 2, 3),), waits=False),
    "event_multiply": Row(
        "a(L) event_multiply member(X, L)",
        (("a([1,1])", 1, 3),),
        ((1, 3), (1, 3)),
        (("a([])", 1, 3),),
        waits=False,
    ),
    "do": Row("a(X) do X < 5", (("a(1)", 1, 3),), ((1, 3),), (("a(7)", 1, 3),), waits=False),
    "seq prolog": Row("a(X) seq prolog(X < 5)", (("a(1)", 1, 3),), ((1, 3),), (("a(7)", 1, 3),), waits=False),
    "prolog seq": Row("db(true) seq a(X)", (("a(1)", 1, 3),), ((1, 3),), (("b(1)", 1, 3),), waits=False),
    "cnot": Row(
        "(a(X) seq b(X)) cnot c(X)",
        (("a(1)", 1, 2), ("c(2)", 2.5, 2.6), ("c(1)", 2, 2.5), ("b(1)", 3, 5)),
        ((1, 5),),
        (("a(1)", 1, 2), ("c(1)", 2.1, 2.9), ("b(1)", 3, 5)),
        (("b(1)", 3, 5), ("a(1)", 1, 2)),
        False,
    ),
    "without": Row(
        "(a(X) seq b(X)) without c(X)",
        (("a(1)", 1, 2), ("c(2)", 2.5, 2.6), ("c(1)", 0.5, 1), ("b(1)", 3, 5)),
        ((1, 5),),
        (("a(1)", 1, 2), ("c(1)", 0.5, 1.1), ("b(1)", 3, 5)),
        (("b(1)", 3, 5), ("a(1)", 1, 2)),
        False,
    ),
    "cnot one": Row(
        "a(X) cnot c(X)",
        (("a(1)", 1, 3), ("c(1)", 4, 5)),
        ((1, 3),),
        (("c(1)", 0.5, 0.9), ("a(1)", 1, 3)),
        waits=False,
    ),
    "fnot": Row(
        "a(X) fnot c(X)",
        (("a(1)", 1, 3), ("c(1)", 4, 5)),
        ((1, 3),),
        (("c(1)", 0.5, 0.9), ("a(1)", 1, 3)),
        waits=False,
    ),
    "star_times": Row(
        "a(X) seq (b(X) star_times)",
        (("a(1)", 1, 2), ("b(1)", 3, 4), ("b(1)", 5, 6)),
        ((1, 2), (1, 4), (1, 6)),
        (("b(1)", 3, 4), ("b(1)", 5, 6)),
    ),
    "ntimes": Row(
        "a(X) ntimes 2",
        (("a(1)", 1, 2), ("a(1)", 3, 5)),
        ((1, 5),),
        (("a(1)", 1, 3), ("a(1)", 3, 5), ("a(2)", 6, 7)),
    ),
    "count": Row(
        "a(X) seq aggregate(count, b(X), _)",
        (("a(1)", 1, 2), ("b(1)", 3, 4), ("b(1)", 5, 6)),
        ((1, 2), (1, 4), (1, 6)),
        (("b(1)", 3, 4),),
    ),
    "sum": Row(
        "a(X) seq aggregate(sum(V), b(X, V), _)",
        (("a(1)", 1, 2), ("b(1,4)", 3, 4)),
        ((1, 2), (1, 4)),
        (("b(1,4)", 3, 4),),
    ),
    "list": Row(
        "a(X) seq aggregate(list(V), b(X, V), _)",
        (("a(1)", 1, 2), ("b(1,4)", 3, 4)),
        ((1, 2), (1, 4)),
        (("b(1,4)", 3, 4),),
    ),
    "max": Row(
        "a(X) seq aggregate(max(V), b(X, V), _)",
        (("a(1)", 1, 2), ("b(1,4)", 3, 4), ("b(1,3)", 5, 6)),
        ((1, 4), (1, 6)),
        (("a(1)", 1, 2), ("b(1,4)", 2, 4)),
    ),
    "min": Row(
        "a(X) seq aggregate(min(V), b(X, V), _)",
        (("a(1)", 1, 2), ("b(1,4)", 3, 4)),
        ((1, 4),),
        (("a(1)", 1, 2), ("b(2,4)", 3, 4)),
    ),
    "avg": Row(
        "a(X) seq aggregate(avg(V), b(X, V), _)",
        (("a(1)", 1, 2), ("b(1,4)", 3, 4)),
        ((1, 4),),
        (("a(1)", 1, 2), ("c(1,4)", 3, 4)),
    ),
    "stddev": Row(
        "a(X) seq aggregate(stddev(V), b(X, V), _)",
        (("a(1)", 1, 2), ("b(1,4)", 3, 4), ("b(1,3)", 5, 6)),
        ((1, 6),),
        (("a(1)", 1, 2), ("b(1,4)", 3, 4)),
    ),
    "median": Row(
        "a(X) seq aggregate(median(V), b(X, V), _)",
        (("a(1)", 1, 2), ("b(1,4)", 3, 4)),
        ((1, 4),),
        (("a(1)", 1, 2), ("b(2,4)", 3, 4)),
    ),
    "quantile": Row(
        "a(X) seq aggregate(quantile(0.9, V), b(X, V), _)",
        (("a(1)", 1, 2), ("b(1,4)", 3, 4)),
        ((1, 4),),
        (("a(1)", 1, 2), ("b(2,4)", 3, 4)),
    ),
    "first": Row(
        "a(X) seq aggregate(first(V), b(X, V), _)",
        (("a(1)", 1, 2), ("b(1,4)", 3, 4)),
        ((1, 4),),
        (("a(1)", 1, 2), ("b(1,4)", 2, 4)),
    ),
    "last": Row(
        "a(X) seq aggregate(last(V), b(X, V), _)",
        (("a(1)", 1, 2), ("b(1,4)", 3, 4)),
        ((1, 4),),
        (("a(1)", 1, 2), ("b(1,4)", 2, 4)),
    ),
    "distinct": Row(
        "a(X) seq aggregate(distinct(V), b(X, V), _)",
        (("a(1)", 1, 2), ("b(1,4)", 3, 4)),
        ((1, 2), (1, 4)),
        (("b(1,4)", 3, 4),),
    ),
    "count_distinct": Row(
        "a(X) seq aggregate(count_distinct(V), b(X, V), _)",
        (("a(1)", 1, 2), ("b(1,4)", 3, 4)),
        ((1, 2), (1, 4)),
        (("b(1,4)", 3, 4),),
    ),
    "changes": Row(
        "a(X) seq aggregate(changes(V), b(X, V), _)",
        (("a(1)", 1, 2), ("b(1,4)", 3, 4)),
        ((1, 2), (1, 4)),
        (("b(1,4)", 3, 4),),
    ),
    "rate": Row(
        "a(X) seq aggregate(rate, b(X, V), _)",
        (("a(1)", 1, 2), ("b(1,4)", 3, 4)),
        ((1, 4),),
        (("a(1)", 1, 2), ("b(2,4)", 3, 4)),
    ),
    "at_end": Row(
        "at_end(a(X)) seq b(X)",
        (("a(1)", 1, 2), ("b(1)", 3, 5)),
        ((2, 5),),
        (("a(1)", 1, 3), ("b(1)", 3, 5)),
        (("b(1)", 3, 5), ("a(1)", 1, 2)),
        False,
    ),
    "at_start": Row(
        "at_start(a(X)) meets b(X)",
        (("a(1)", 3, 4), ("b(1)", 3, 6)),
        ((3, 6),),
        (("a(1)", 2, 3), ("b(1)", 3, 6)),
        (("b(1)", 3, 6), ("a(1)", 3, 4)),
    ),
    "subpattern": Row(
        "(s(X) <- a(X) seq b(X)) seq c(X)",
        (("a(1)", 1, 2), ("b(1)", 3, 4), ("c(1)", 5, 6)),
        ((1, 6),),
        (("a(1)", 1, 2), ("b(1)", 2, 4), ("c(1)", 5, 6)),
        tick="c(9)",
    ),
}

# ---- competing partners -----------------------------------------------------------------------------

CONTESTS = {
    # operator: intervals of a(1), a(2), a(1); of b(1), b(2), b(3); whether the result begins with a
    "seq": (((1, 2), (2, 3), (3, 4)), ((5, 6), (6, 7), (7, 8)), True),
    "and": (((1, 2), (2, 3), (3, 4)), ((5, 6), (6, 7), (7, 8)), True),
    "par": (((1, 10), (2, 11), (3, 12)), ((4, 13), (5, 14), (6, 15)), True),
    "equals": (((1, 2), (1, 2), (1, 2)), ((1, 2), (1, 2), (1, 2)), True),
    "meets": (((1, 5), (2, 5), (3, 5)), ((5, 7), (5, 8), (5, 9)), True),
    "during": (((3, 4), (4, 5), (5, 6)), ((1, 9), (2, 10), (3, 11)), False),
    "starts": (((1, 2), (1, 3), (1, 4)), ((1, 5), (1, 6), (1, 7)), False),
    "finishes": (((5, 9), (6, 9), (7, 9)), ((1, 9), (2, 9), (3, 9)), False),
}

TAKEN = {
    # policy: pairs of the numbers of a and b
    "recent": ((3, 1), (2, 2)),  # the third a replaces the first
    "recent_2": ((3, 1), (2, 2), (1, 3)),
    "chronological": ((1, 1), (2, 2), (3, 3)),
    "chronological_2": ((1, 1), (2, 2), (3, 3)),
    "unrestricted": tuple((a, b) for b in (1, 2, 3) for a in (1, 2, 3)),
}

EXTENDED = {
    # policy: numbers of the first events whose repetition is extended
    "recent": (3,),
    "recent_2": (3,),
    "chronological": (1,),
    "chronological_2": (1,),
    "unrestricted": (1, 2, 3),
}
