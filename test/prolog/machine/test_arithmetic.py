"""Arithmetic with timestamps: exact to the nanosecond in all forms, interpreted and compiled."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from prolog.support import NEVER, answers, first, prolog

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
WAYS = [prolog(PROGRAM), prolog(PROGRAM, compile_after=NEVER)]


def forms(instant):
    """Return all terms that name an instant."""
    year, month, day, hour, minute, second, rest = timestamps.datime_fields(instant)
    found = [
        f"datime({year},{month},{day},{hour},{minute},{second},{rest})",
        f"datime({year},{month},{day},{hour},{minute},{float(second)},{rest})",
        "[{},{}]".format(*timestamps.to_parts(instant)),
    ]
    if not rest:
        found.append(f"datime({year},{month},{day},{hour},{minute},{second})")
    return found


def one(goal):
    """Return the only answer that there is, by every way."""
    found = {str(first(logic, goal)) for logic in WAYS}
    assert len(found) == 1
    return found.pop()


def pairs():
    whole = st.integers(0, 4_000_000_000).map(lambda seconds: seconds * SECOND)
    instants = st.one_of(whole, st.integers(0, 4_000_000_000 * SECOND))
    near = st.tuples(instants, st.integers(-3, 3)).map(lambda drawn: (drawn[0], max(0, sum(drawn))))
    return st.one_of(st.tuples(instants, instants), near)


@settings(max_examples=60, derandomize=True, deadline=None)
@given(pairs(), st.randoms(use_true_random=False))
def test_stamps_subtract_and_compare_to_the_nanosecond(pair, pick):
    left, right = pair
    one_form, other_form = pick.choice(forms(left)), pick.choice(forms(right))
    difference = write_term((left - right) / SECOND)
    assert one(f"minus({one_form}, {other_form}, X)") == difference
    assert float(one(f"datime_minus_datime({one_form}, {other_form}, X)")) == float(difference)
    assert one(f"order({one_form}, {other_form}, X)") == (
        "<" if left < right else ">" if left > right else "="
    )
    assert one(f"longest({one_form}, {other_form}, X)") == write_term(abs(left - right) / SECOND)


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
def test_a_stamp_is_a_number(goal, value):
    assert one(goal) == value


def test_what_a_program_gets_is_an_ordinary_number():
    logic = prolog("both(A, X) :- X is A, Y is max(A, 0), foo(X) = foo(Y), X == Y.")
    assert answers(logic, "both([5,5], X), X == 5.000000005, atom_number(A, X)") == [
        {"X": "5.000000005", "A": "'5.000000005'"}
    ]
