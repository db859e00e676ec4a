"""Arithmetic with timestamps: exact to the nanosecond in all forms, interpreted and compiled."""

import random
from typing import Any, List

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from prolog.goal_answers import NEVER, answers, first, prolog

from retalis.prolog.syntax.term_writer import write_term
from retalis.prolog.terms import timestamps
from retalis.prolog.terms.timestamps import SECOND

PROGRAM = """
minus(A, B, X) :- X is A - B.
order(A, B, '<') :- A < B.
order(A, B, '=') :- A =:= B.
order(A, B, '>') :- A > B.
value(A, X) :- X is A.
later(A, B, N) :- A - B > N.
longest(A, B, X) :- X is max(A, B) - min(A, B).
greatest(A, B, X) :- X is max(A, B).
"""
SYSTEMS = [prolog(PROGRAM), prolog(PROGRAM, compile_after=NEVER)]


def forms(instant: Any) -> List[str]:
    """Return all terms that denote an instant (ns)."""
    year, month, day, hour, minute, second, rest = timestamps.datime_fields(instant)
    terms = [
        f"datime({year},{month},{day},{hour},{minute},{second},{rest})",
        f"datime({year},{month},{day},{hour},{minute},{float(second)},{rest})",
        "[{},{}]".format(*timestamps.to_parts(instant)),
    ]
    if not rest:
        terms.append(f"datime({year},{month},{day},{hour},{minute},{second})")
    return terms


def common_answer(goal: str) -> str:
    """Return the first answer to a goal, which is the same interpreted and compiled."""
    results = {str(first(logic, goal)) for logic in SYSTEMS}
    assert len(results) == 1
    return results.pop()


def timestamp_pairs() -> Any:
    whole = st.integers(0, 4_000_000_000).map(lambda seconds: seconds * SECOND)
    instants = st.one_of(whole, st.integers(0, 4_000_000_000 * SECOND))
    near = st.tuples(instants, st.integers(-3, 3)).map(lambda pair: (pair[0], max(0, sum(pair))))
    return st.one_of(st.tuples(instants, instants), near)


@settings(max_examples=60, derandomize=True, deadline=None)
@given(timestamp_pairs(), st.randoms(use_true_random=False))
def test_timestamps_are_exact_to_nanosecond(pair: Any, random: random.Random) -> None:
    left, right = pair
    left_form, right_form = random.choice(forms(left)), random.choice(forms(right))
    difference = write_term((left - right) / SECOND)
    assert common_answer(f"minus({left_form}, {right_form}, X)") == difference
    assert float(common_answer(f"datime_minus_datime({left_form}, {right_form}, X)")) == float(difference)
    assert common_answer(f"order({left_form}, {right_form}, X)") == (
        "<" if left < right else ">" if left > right else "="
    )
    assert common_answer(f"longest({left_form}, {right_form}, X)") == write_term(abs(left - right) / SECOND)


@pytest.mark.parametrize(
    ("goal", "value"),
    [
        ("value(datime(1970,1,1,0,1,0), X)", "60"),
        ("value(datime(1970,1,1,0,1,0,500000000), X)", "60.5"),
        ("value([60,500000000], X)", "60.5"),
        ("value([0'a], X)", "97"),
        ("minus(datime(1970,1,1,0,1,0), 5, X)", "55"),
        ("minus([60,0], 5, X)", "55"),
        ("minus(datime(1970,1,1,0,1,0), 5.5, X)", "54.5"),
        ("minus(100, [60,250000000], X)", "39.75"),
        ("minus(1700000011.25, [1700000000,250000000], X)", "11.0"),
        ("minus(7, 2, X)", "5"),
        ("greatest([60,1], 5, X), float(X)", "60.000000001"),
        ("greatest([60,0], 5, X), integer(X)", "60"),
        ("order([60,0], 60.0, X)", "="),
        ("later(datime(2026,11,22,0,0,10,1), datime(2026,11,22,0,0,0,0), 10), X = yes", "yes"),
        ("later(datime(2026,11,22,0,0,10,0), datime(2026,11,22,0,0,0,0), 10), X = yes", "None"),
        ("_T = datime(1970,1,1,0,2,0), X is _T / 60", "2"),
        ("_T = datime(1970,1,1,0,2,0), X is _T mod 50", "20"),
        ("_T = datime(1970,1,1,0,2,0), X is truncate(_T) + numerator(_T) + eval(_T) + (+ _T) * 2", "600"),
        ("_T = [1,500000000], X is _T mod 2", "type_error(integer,1.5)"),
        ("X is [1,500000000|_]", "type_error([],[1,500000000|A])"),
        ("X is [1,1000000000]", "type_error([],[1,1000000000])"),
        ("X is [1,2,3]", "type_error([],[1,2,3])"),
        ("X is datime(2026,13,1,0,0,0)", "domain_error(datime,datime(2026,13,1,0,0,0))"),
        ("_T = [1,0], X is inf - _T", "evaluation_error(float_overflow)"),
    ],
)
def test_timestamp_evaluates_to_number(goal: str, value: str) -> None:
    assert common_answer(goal) == value


def test_evaluated_timestamp_is_ordinary_number() -> None:
    logic = prolog("both(A, X) :- X is A, Y is max(A, 0), foo(X) = foo(Y), X == Y.")
    assert answers(logic, "both([5,5], X), X == 5.000000005, atom_number(A, X)") == [
        {"X": "5.000000005", "A": "'5.000000005'"}
    ]
