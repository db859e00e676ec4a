"""Results of the oracle for each operator and policy, compared with results computed by hand.

The expected texts list the derived events in order.
"""

from dataclasses import replace
from fractions import Fraction
from typing import Any, Dict

import pytest
from oracle.evaluator import run
from oracle.goal_evaluator import GoalError, number
from oracle.matches import POLICIES, Match
from oracle.pattern_classes import Awaited, Leaf
from oracle.rule_notation import brief, rule, stream
from oracle.stream_operators import seconds_of

from retalis import Operators, Var, atom
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.terms.timestamps import SECOND


def fired(
    pattern: str,
    events: str,
    head: str = "out",
    policy: str = "recent",
    out_of_order: bool = False,
    expiry: bool = True,
    **options: Any,
) -> str:
    derived = run(
        [rule(head, pattern, **options)],
        stream(events),
        policy=policy,
        out_of_order=out_of_order,
        expiry=expiry,
    )
    name = head.split("(")[0]
    return brief(event for event in derived if event[0].split("(")[0] == name)


TABLE = [
    # one event
    ("a", "a@1-3 b@2", "out@1-3"),
    # seq: ended before the other started
    ("seq(a,b)", "a@1-3 b@4-5", "out@1-5"),
    ("seq(a,b)", "a@1-3 b@3-5", ""),
    ("seq(a,b)", "b@5 a@1", ""),
    ("seq(seq(a,b),c)", "a@1 b@2 c@3", "out@1-3"),
    ("seq(a,seq(b,c))", "b@1 a@2 c@3", ""),
    # and: any order, any times
    ("and(a,b)", "a@5-9 b@1-3", "out@1-9"),
    ("and(a,b)", "b@1-3 a@5-9", "out@1-9"),
    # par: they overlap
    ("par(a,b)", "a@1-3 b@2-5", "out@1-5"),
    ("par(a,b)", "b@2-5 a@1-3", "out@1-5"),
    ("par(a,b)", "a@1-3 b@3-5", ""),
    ("par(a,b)", "a@1 b@1", ""),
    # or: either
    ("or(a,b)", "a@1 b@2-3", "out@1 out@2-3"),
    ("or(a,a)", "a@1", "out@1 out@1"),
    # Allen's relations
    ("equals(a,b)", "b@1-2 a@1-2 a@1-3", "out@1-2"),
    ("meets(a,b)", "a@1-3 b@3-5", "out@1-5"),
    ("meets(a,b)", "b@3-5 a@1-3", "out@1-5"),
    ("meets(a,b)", "a@1-2 b@3-5", ""),
    ("meets(a,a)", "a@1", ""),
    ("during(a,b)", "a@2-3 b@1-4", "out@1-4"),
    ("during(a,b)", "a@1-4 b@1-4", "out@1-4"),
    ("during(a,b)", "a@1-5 b@1-4", ""),
    ("starts(a,b)", "b@1-4 a@1-3", "out@1-4"),
    ("starts(a,b)", "a@1-4 b@1-4", ""),
    ("finishes(a,b)", "a@3-4 b@1-4", "out@1-4"),
    ("finishes(a,b)", "a@1-4 b@1-4", ""),
    # conditions
    ("where(a(X),<(X,2))", "a(1)@1 a(2)@2", "out@1"),
    ("within(a,2)", "a@1-2 a@1-3", "out@1-2"),
    ("within(seq(a,b),3)", "a@1 b@3 a@4 b@7", "out@1-3"),
    ("check(a,','(t1(S),','(t2(E),<(S,E))))", "a@1-2 a@3", "out@1-2"),
    ("do(a(X),>(X,1))", "a(1)@1 a(2)@2", "out@2"),
    # negation: nothing wholly between
    ("cnot(seq(a,b),c)", "a@1 c@2 b@3", ""),
    ("cnot(seq(a,b),c)", "a@1 c@1 b@3", "out@1-3"),
    ("cnot(seq(a,b),c)", "a@1 c@2-9 b@5", "out@1-5"),
    ("cnot(seq(a,b),c)", "a@1 c@9 b@5", "out@1-5"),
    ("cnot(where(seq(a,b),true),c)", "a@1 c@2 b@3", ""),
    # a list of one character is the character's code
    ("where(seq(b,aggregate(list(X),a(X),L)),=<(L,120))", "b@1 a(x)@2 b@3 a(y)@4", "out@1-2"),
    ("cnot(seq(seq(a,b),e),c)", "a@1 c@2 b@3 e@4", "out@1-4"),
    ("cnot(seq(seq(a,b),e),c)", "a@1 b@3 c@4 e@5", ""),
    ("cnot(and(a,b),c)", "c@2 a@2 b@3", "out@2-3"),
    ("cnot(and(a,b),c)", "c@1 a@2 b@3", ""),
    ("fnot(b,a)", "b@1 a@2-3 b@3 b@4", "out@1 out@3"),
    # repetition
    ("seq(a,star_times(b))", "a@1 b@2 b@2 b@3", "out@1 out@1-2 out@1-3"),
    ("seq(a,star_times(b))", "a@5 b@2", "out@5"),
    ("ntimes(b,3)", "b@1 b@2 b@3 b@4", "out@1-3 out@2-4"),
    ("seq(a,ntimes(b,2))", "a@1 b@2 b@3", "out@1-3"),
]


@pytest.mark.parametrize(("pattern", "events", "expected"), TABLE)
@pytest.mark.parametrize("policy", POLICIES)
def test_pattern_has_computed_matches(pattern: str, events: str, expected: str, policy: Any) -> None:
    if policy == "unrestricted" and pattern.startswith("ntimes"):
        expected = "out@1-3 out@1-4 out@1-4 out@2-4"  # every three in order
    assert fired(pattern, events, policy=policy) == expected


POLICY_CASES = {
    "a(1)@1 a(2)@2 b(3)@3 b(4)@4": {
        "recent": "out(2,3)@2-3 out(1,4)@1-4",
        "recent_2": "out(2,3)@2-3 out(1,4)@1-4",
        "chronological": "out(1,3)@1-3 out(2,4)@2-4",
        "chronological_2": "out(1,3)@1-3 out(2,4)@2-4",
        "unrestricted": "out(1,3)@1-3 out(2,3)@2-3 out(1,4)@1-4 out(2,4)@2-4",
    },
    # identical terms: only recent replaces
    "a(1)@1 a(1)@2 b(3)@3 b(4)@4": {
        "recent": "out(1,3)@2-3",
        "recent_2": "out(1,3)@2-3 out(1,4)@1-4",
        "chronological": "out(1,3)@1-3 out(1,4)@2-4",
        "chronological_2": "out(1,3)@1-3 out(1,4)@2-4",
        "unrestricted": "out(1,3)@1-3 out(1,3)@2-3 out(1,4)@1-4 out(1,4)@2-4",
    },
    # newest and oldest by arrival, not by stamp
    "a(2)@2 a(1)@1 b(3)@3": {
        "recent": "out(1,3)@1-3",
        "recent_2": "out(1,3)@1-3",
        "chronological": "out(2,3)@2-3",
        "chronological_2": "out(2,3)@2-3",
        "unrestricted": "out(2,3)@2-3 out(1,3)@1-3",
    },
}


@pytest.mark.parametrize("events", POLICY_CASES)
@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("operator", ["seq", "and"])
def test_policy_selects_partners(events: str, policy: Any, operator: str) -> None:
    assert fired(f"{operator}(a(X),b(Y))", events, "out(X,Y)", policy) == POLICY_CASES[events][policy]


@pytest.mark.parametrize(
    ("policy", "expected"),
    [
        ("recent", "out(1,2)@1-2 out(2,3)@2-3"),
        ("chronological", "out(1,2)@1-2 out(2,3)@2-3"),
        ("unrestricted", "out(1,2)@1-2 out(2,1)@1-2 out(1,3)@1-3 out(2,3)@2-3 out(3,1)@1-3 out(3,2)@2-3"),
    ],
)
def test_event_matches_either_side(policy: str, expected: str) -> None:
    assert fired("and(a(X),a(Y))", "a(1)@1 a(2)@2 a(3)@3", "out(X,Y)", policy) == expected


def test_rejected_partners_are_not_consumed() -> None:
    assert fired("where(seq(a(X),b(Y)),<(X,Y))", "a(1)@1 a(9)@2 b(3)@3 b(10)@4", "out(X,Y)") == (
        "out(1,3)@1-3 out(9,10)@2-4"
    )


def test_inner_operator_selects_partner_first() -> None:
    pattern = "where(seq(seq(a(X),b(Y)),c),<(X,Y))"
    assert fired(pattern, "a(1)@1 a(9)@2 b(3)@3 c@4") == ""


def test_condition_may_use_left_variables() -> None:
    pattern = "seq(a(X),where(b(Y),<(X,Y)))"
    assert fired(pattern, "a(5)@1 a(1)@2 b(3)@3 b(9)@4", "out(X,Y)") == "out(1,3)@2-3 out(5,9)@1-4"


def test_partners_rejected_by_do_are_consumed() -> None:
    pattern = "do(seq(a(X),b(Y)),<(X,Y))"
    assert fired(pattern, "a(1)@1 a(9)@2 b(3)@3 b(4)@4", "out(X,Y)") == "out(1,4)@1-4"


def test_event_multiply_repeats_event() -> None:
    pattern = "event_multiply(a,member(X,[1,2]))"
    assert fired(pattern, "a@1", "out(X)") == "out(1)@1 out(2)@1"


def test_forall_seq_matches_all_partners() -> None:
    for policy in POLICIES:
        assert fired("forall_seq(a,b)", "a@1 a@2 b@3 b@4", policy=policy) == "out@1-3 out@2-3"


def test_event_of_cnot_excludes_all_matches() -> None:
    for policy in POLICIES:
        assert fired("cnot(seq(a(X),b),c)", "a(1)@1 a(2)@2 c@3 b@4 b@5", policy=policy) == ""
    assert fired("cnot(seq(a(X),b(X)),c(X))", "a(1)@1 a(2)@2 c(1)@3 b(1)@4 b(2)@5", "out(X)") == "out(2)@2-5"


@pytest.mark.parametrize(
    ("policy", "expected"),
    [
        ("recent", "out(1,A)@1 out(1,2)@1-2 out(4,A)@4 out(4,5)@4-5 out(1,2)@1-6"),
        ("chronological", "out(1,A)@1 out(1,2)@1-2 out(4,A)@4 out(4,5)@4-5 out(1,2)@1-6"),
        ("unrestricted", "out(1,A)@1 out(1,2)@1-2 out(4,A)@4 out(4,5)@4-5 out(1,2)@1-6"),
    ],
)
def test_repetition_shares_variables(policy: str, expected: str) -> None:
    events = "a(1)@1 b(2)@2 a(4)@4 b(5)@5 b(2)@6"
    assert fired("seq(a(X),star_times(b(Y)))", events, "out(X,Y)", policy) == expected


def test_repetition_renames_anonymous_variables() -> None:
    assert fired("seq(a,star_times(b(_)))", "a@1 b(1)@2 b(2)@3") == "out@1 out@1-2 out@1-3"


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ("count", "out(0)@1 out(1)@1-2 out(2)@1-3"),
        ("sum(X)", "out(0)@1 out(5)@1-2 out(8)@1-3"),
        ("list(X)", "out([])@1 out([5])@1-2 out([5,3])@1-3"),
        ("min(X)", "out(5)@1-2 out(3)@1-3"),
        ("max(X)", "out(5)@1-2 out(5)@1-3"),
        ("avg(X)", "out(5)@1-2 out(4)@1-3"),
    ],
)
def test_aggregate_has_value_per_event(kind: str, expected: str) -> None:
    assert fired(f"seq(s,aggregate({kind},a(X),R))", "a(9)@1 s@1 a(5)@2 a(3)@3", "out(R)") == expected


def test_rejected_aggregate_continues() -> None:
    pattern = "where(seq(s,aggregate(count,a,N)),>(N,1))"
    assert fired(pattern, "s@1 a@2 a@3 a@4", "out(N)") == "out(2)@1-3 out(3)@1-4"


@pytest.mark.parametrize(
    ("expression", "value"),
    [("[7]", 7), ("[1, 1] + 1", 2.000000001), ("[2, 0]", 2), ("max([1, 500000000], 1)", 1.5), ("-[3]", -3)],
)
def test_character_and_timestamp_lists_are_numbers(expression: str, value: float) -> None:
    assert number(read_term(expression, Operators.prolog()).term, {}) == value


@pytest.mark.parametrize("expression", ["[1, 1, 1]", "[1, 1000000000]", "[1, -1]", "[]", "[a, 1]"])
def test_other_lists_are_no_numbers(expression: str) -> None:
    with pytest.raises(GoalError):
        number(read_term(expression, Operators.prolog()).term, {})


def test_window_limits_duration() -> None:
    assert fired("and(a(X),b)", "a(1)@1 b@9 a(3)@10", "out(X)", label="r", window=2) == "out(3)@9-10"
    assert fired("a", "a@1-3 a@1-4", label="r", window=2) == "out@1-3"


def test_late_events_match_out_of_order() -> None:
    events = "b(1)@5 a(1)@2 a(2)@3 b(2)@9 a(3)@8"
    assert fired("seq(a(X),b(Y))", events, "out(X,Y)") == "out(2,2)@3-9"
    assert (
        fired("seq(a(X),b(Y))", events, "out(X,Y)", out_of_order=True)
        == "out(1,1)@2-5 out(2,2)@3-9 out(3,2)@8-9"
    )
    assert fired("seq(seq(a,b),c)", "c@9 b@5 a@1", out_of_order=True) == "out@1-9"


@pytest.mark.parametrize(
    ("after_match", "pairs", "repeated", "results", "again"),
    [
        (
            "keep",
            "out(1)@1-3 out(2)@2-3 out(1)@1-4 out(2)@2-4",
            "out@1-2 out@2-3 out@3-4",
            "out@1 out@1-2",
            "2-8 3-9",
        ),
        ("skip_past_last", "out(1)@1-3", "out@1-2 out@3-4", "out@1", "2-8"),
        ("skip_to_next", "out(1)@1-3 out(2)@2-3", "out@1-2 out@2-3 out@3-4", "out@1", "2-8 3-9"),
    ],
)
def test_after_match_strategy_skips_events(
    after_match: str, pairs: str, repeated: str, results: str, again: str
) -> None:
    skipping: Dict[str, Any] = {"after_match": after_match}
    several = fired("seq(a(X),b)", "a(1)@1 a(2)@2 b@3 b@4", "out(X)", "unrestricted", **skipping)
    assert several == pairs
    assert fired("ntimes(a,2)", "a@1 a@2 a@3 a@4", **skipping) == repeated
    assert fired("seq(a,star_times(b))", "a@1 b@2", **skipping) == results
    late = " ".join(f"out@{interval}" for interval in again.split())
    assert fired("and(a,b)", "a@2 b@8 b@3 a@9", **skipping) == late


def test_skipped_match_consumes_partners() -> None:
    pattern = "and(event_multiply(seq(a,b),member(X,[1,2])),c(X))"
    assert fired(pattern, "c(2)@1 c(1)@1 a@2 b@3", "out(X)", after_match="skip_past_last") == "out(1)@1-3"


def test_rule_uses_its_own_policy() -> None:
    own = rule("out(X)", "seq(a(X),b)", label="r", out_of_order=True)
    derived = run(
        [replace(own, policy="chronological")], stream("a(1)@1 a(2)@2 b@3 b@9 a(4)@8"), policy="recent"
    )
    assert brief(event for event in derived if "out" in event[0]) == "out(1)@1-3 out(2)@2-9 out(4)@8-9"


def test_time_of_absence_is_a_whole_number_of_nanoseconds() -> None:
    seconds = Var()
    absence = Awaited(Leaf(atom("a")), Leaf(atom("b")), seconds)

    def time_of(value: Any) -> Any:
        return seconds_of(absence, Match(0, 0, {seconds: value}, (), frozenset(), ()))

    assert time_of(1 / 3) == Fraction(333_333_333, SECOND)
    assert time_of(1.5) == Fraction(3, 2)
    assert time_of(1e-12) is time_of(-1) is time_of(atom("x")) is None


def test_derived_events_match_other_rules() -> None:
    rules = [rule("mid(X)", "seq(a(X),b)"), rule("out(X)", "mid(X)"), rule("other", "b")]
    derived = brief(run(rules, stream("a(1)@1 b@2")))
    assert derived == "a(1)@1 b@2 mid(1)@1-2 out(1)@1-2 other@2"


def test_subpattern_emits_event() -> None:
    rules = [rule("out", "or(<-(sub,seq(a,b)),z)"), rule("last", "sub"), rule("first", "seq(a,b)")]
    assert brief(run(rules, stream("a@1 b@2"))) == "a@1 b@2 first@1-2 sub@1-2 out@1-2 last@1-2"
