"""Unbound variables of matches: postponed conditions, and identity of matches."""

from typing import Any

import pytest
from oracle.comparison import answer, difference
from oracle.matches import POLICIES
from oracle.rule_notation import brief, rule, stream
from oracle.strategies import Case

from retalis.prolog.terms.timestamps import SECOND

DISTINCT_MATCHES = [
    ("seq(seq(seq(d,star_times(b(V))),b(V)),star_times(a))", "d@8-16 b(1)@19-25 b(1)@30-32"),
    ("seq(and(seq(seq(d,star_times(b(V))),b(V)),d),e)", "d@1 b(1)@2 b(1)@3 e@4 e@5 d@6 e@7"),
    ("seq(where(and(seq(d,star_times(b(V))),c),=(V,1)),star_times(e))", "d@1 c@2 b(1)@3 c@4 e@5 c@6 e@7"),
    ("seq(seq(or(a(X),c),star_times(b(X))),and(d(X),e))", "c@1 b(1)@2 d(1)@3 c@4 b(2)@5 d(1)@6 e@7 e@8"),
    (
        "seq(seq(a(X),where(seq(d,star_times(a(X))),is(Y,+(X,1)))),star_times(a(2)))",
        "a(0)@12-13 d@22 a(0)@26-28 d@28",
    ),
]
POSTPONED_CONDITIONS = [
    ("and(b(X),where(seq(s,aggregate(count,a(X),_)),>(X,0)))", "s@1 b(1)@2 a(0)@3 a(1)@4 b(1)@5 b(0)@6"),
    ("and(b(X),where(seq(s,star_times(a(X))),>(X,0)))", "s@1 b(1)@2 a(0)@3 a(1)@4 b(1)@5 b(0)@6"),
    ("and(b(X),where(and(or(a(X),c),d),>(X,0)))", "a(0)@1 c@2 d@3 b(1)@4 d@5 b(1)@6 d@7 b(1)@8"),
    ("seq(b(X),seq(where(or(a(X),c),is(Y,+(X,1))),a(Y)))", "b(1)@1 c@2 a(2)@3 a(3)@4 a(4)@5"),
    (
        "seq(b(X),cnot(seq(where(seq(s,aggregate(count,a(X),_)),>(X,0)),e),q))",
        "b(1)@0 s@1 b(1)@2 e@3 a(1)@4 e@5",
    ),
    ("seq(b(X),seq(where(fnot(seq(s,aggregate(count,a(X),_)),q),>(X,0)),e))", "b(1)@0 s@1 b(1)@2 e@3"),
    ("seq(b(X),where(check(seq(s,aggregate(count,a(X),N)),t2(T)),>(+(X,N),0)))", "b(0)@0 s@1 a(0)@2 a(0)@3"),
    (
        "seq(b(X),seq(where(event_multiply(seq(s,aggregate(count,a(X),_)),member(Z,[1,2])),>(X,0)),e))",
        "b(1)@0 s@1 b(1)@2 e@3",
    ),
    ("seq(seq(b,star_times(c(X))),aggregate(max(X),where(d,member(X,[1,2])),_))", "b@1 d@2 c(1)@3 d@4"),
    *[
        (
            f"{operator}(b(X),where({inner}(or(a(X),c),d),>(X,0)))",
            "b(1)@0-4 a(0)@1-3 c@1-3 d@1-4 d@1-3 d@5 b(1)@5 d@3-6",
        )
        for operator in ("seq", "and", "par", "meets", "during", "starts", "finishes", "equals")
        for inner in ("seq", "and", "par", "starts", "forall_seq")
    ],
]


@pytest.mark.slow
@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize(("pattern", "events"), [*DISTINCT_MATCHES, *POSTPONED_CONDITIONS])
def test_open_variables_equal_oracle(pattern: Any, events: Any, policy: Any) -> None:
    case = Case((rule("out(X)" if "X" in pattern else "out", pattern),), policy, False, tuple(stream(events)))
    assert difference(case) is None


def test_condition_of_empty_aggregate_is_postponed() -> None:
    rule_with_condition = rule("o(X)", POSTPONED_CONDITIONS[0][0])
    case = Case((rule_with_condition,), "recent", False, tuple(stream("s@1 b(1)@2")))
    assert difference(case) is None
    events = [(term, start // SECOND, end // SECOND) for term, start, end in answer(case)]
    assert brief(events) == "s@1 b(1)@2 o(1)@1-2"
