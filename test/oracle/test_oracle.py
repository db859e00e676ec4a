"""Rules of the oracle that no recorded scenario decides, with results computed by hand.

The expected texts list the derived events in order.
"""

from dataclasses import replace
from fractions import Fraction
from typing import Any, Dict

import pytest
from oracle.evaluator import run
from oracle.goal_evaluator import GoalError, number
from oracle.matches import Match
from oracle.pattern_classes import Awaited, Leaf
from oracle.rule_notation import brief, rule, stream
from oracle.stream_operators import seconds_of

from retalis import Operators, Var, atom
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.terms.timestamps import SECOND


def fired(pattern: str, events: str, head: str = "out", policy: str = "recent", **options: Any) -> str:
    derived = run([rule(head, pattern, **options)], stream(events), policy=policy)
    name = head.split("(")[0]
    return brief(event for event in derived if event[0].split("(")[0] == name)


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
