"""Row patterns in rules: matches, limits and errors."""

from typing import Any, List

import pytest
from asserting_accessors import place_of
from events.program_runner import ProgramRunner, format_events, outputs_of

from retalis import ProgramErrors, StreamClock
from retalis.prolog.terms.timestamps import from_seconds
from retalis.prolog.terms.types import functor_name

RISING = "up(M) <- aggregate(count, r(M,V), _, steps([low where V < 3, high where V >= 3]))."
STARS = "s(L) <- aggregate(list(X), e(X), L, steps([{}]))."


@pytest.mark.parametrize(
    ("steps", "expected"),
    [
        ("a(2) where X < 5", "s([1,2])@0-1 s([3,4])@2-3 s([1,2])@5-6"),
        ("a(1, many) where X < 4", "s([1,2,3])@0-3"),
        ("a(1, many, reluctant), b where X > 3", "s([1,2,3,4])@0-3"),
        ("a, b(0, 1) where X = 9", "s([1])@0-1 s([2])@1-2 s([3])@2-3 s([4,9])@3-4 s([1])@5-6 s([2])@6-7"),
        ("a where X = 1, later(b) where X > 3", "s([1,4])@0-3"),
        ("later(a(1, many, until(X > 3)))", "s([1,2,3])@0-3"),
        ("a(3) where X > prev(X)", "s([1,2,3])@0-2"),
        ("a(2, many) where (X > prev(X), X - first(X) < 3)", "s([1,2,3])@0-3 s([1,2])@5-7"),
        ("a where X = 9, b(2) where X < first(a, X)", "s([9,1,2])@4-6"),
        ("a(2), b where X > last(a, X)", "s([1,2,3])@0-2 s([9,1,2])@4-6"),
    ],
)
def test_row_pattern_matches_stream(steps: str, expected: str) -> None:
    stream = [1, 2, 3, 4, 9, 1, 2, 0]
    assert (
        outputs_of(STARS.format(steps), " ".join(f"e({x})@{second}" for second, x in enumerate(stream)))
        == expected
    )


def test_each_key_has_own_row_pattern() -> None:
    assert outputs_of(RISING, "r(a,1)@1 r(b,5)@2 r(a,4)@3 r(b,1)@4 r(b,3)@5") == "up(a)@1-3 up(b)@4-5"


def test_row_pattern_may_be_nested() -> None:
    rule = "both(M) <- aggregate(count, r(M,V), _, steps([low where V < 3, high where V >= 3])) seq ok(M)."
    assert outputs_of(rule, "r(a,1)@1 ok(a)@2 r(a,4)@3 ok(b)@4 ok(a)@5") == "both(a)@1-5"
    rule = "two(L) <- aggregate(list(A+B), (p(A) seq q(B)), L, steps([one(2)]))."
    assert outputs_of(rule, "p(1)@1 q(2)@2 p(3)@3 q(4)@4") == "two([+(1,2),+(3,4)])@1-4"


@pytest.mark.parametrize("flag", ["revision_flag", "etalis_justification"])
@pytest.mark.parametrize("policy", ["recent", "chronological", "unrestricted"])
def test_flags_and_policies_keep_row_pattern_matches(flag: str, policy: str) -> None:
    assert outputs_of(RISING, "r(a,1)@1 r(a,4)@3", policy, [flag]) == "up(a)@1-3"


def test_retraction_of_deciding_event_retracts_match() -> None:
    program = ProgramRunner(STARS.format("a(1, many) where X < 3"), ["revision_flag"])
    assert program.feed("e(1)@1 e(2)@2 e(7)@3") == "s([1,2])@1-3"
    assert program.feed("rev(e(7))@3") == "rev(s([1,2]))@3-3"
    assert program.feed("e(8)@4") == "s([1,2])@1-4"


def test_skipped_events_are_not_stored() -> None:
    program = ProgramRunner(STARS.format("a, later(b) where X > 5"))
    program.feed(" ".join(f"e(1)@{second}" for second in range(50)))
    (rule,) = program.engine.rules.rules
    assert rule.match_count == 1
    assert program.feed("e(6)@50") == "s([1,6])@0-50"


def test_number_of_starts_is_not_limited() -> None:
    """The limit of alternative matches applies to each start, not to all starts together."""
    program = ProgramRunner("o(N) <- aggregate(count, a(T), N, steps([p(101) where T > 0, n where T < 0])).")
    program.feed(" ".join(f"a(1)@{second}" for second in range(201)))
    assert program.feed("a(-1)@201") == "o(102)@100-201"
    assert program.warnings == []


def test_starts_with_navigation_are_not_limited() -> None:
    steps = "a(1, many) where (X >= first(X), X < 1000), b where X =:= first(a, X) + 1000"
    program = ProgramRunner(STARS.format(steps))
    program.feed(" ".join(f"e({x})@{x}" for x in range(150)))
    assert program.feed("e(1147)@150") == "s([147,148,149,1147])@147-150"
    assert program.warnings == []


AMBIGUOUS_STEPS = (
    "a(1, many) where X >= 0, b(1, many) where X >= 0, c where X =:= first(b, X), later(d) where X = 500"
)
"""The variable b may begin at each event after the first, and c refers to its first event."""


def test_alternatives_of_start_are_limited() -> None:
    program = ProgramRunner(STARS.format(AMBIGUOUS_STEPS))
    program.feed(" ".join(f"e({second})@{second}" for second in range(100)))
    assert program.warnings == []
    program.feed(" ".join(f"e({second})@{second}" for second in range(100, 150)))
    assert "more than 100 ways to take its steps from one start; 1 have been" in str(program.warnings[0])
    (rule,) = program.engine.rules.rules
    assert rule.match_count == 150
    # the alternative in which b begins with 10 exceeds the limit, and the one in which it begins with 140 does not
    assert program.feed("e(10)@150 e(500)@151 e(-1)@152") == ""
    program.feed(" ".join(f"e({second})@{second + 200}" for second in range(150)))
    assert program.feed("e(140)@350 e(-1)@351 e(500)@352").endswith(",149,140,500])@200-352")


def test_partial_matches_are_limited() -> None:
    """The elements and the alternatives of each start count."""
    program = ProgramRunner(STARS.format(AMBIGUOUS_STEPS))
    program.engine.rules.network.limit_stored(50)
    (rule,) = program.engine.rules.rules
    for second in range(120):
        program.feed(f"e({second})@{second}")
        assert rule.match_count <= 50
    assert rule.dropped_count
    assert "has more than 50 partial matches" in str(program.warnings[0])


def test_dropped_start_is_no_use_of_its_key() -> None:
    """Key a has no new element for 8 s, so its old state is dropped, and the new one is kept."""
    rule = (
        "l([property(window, 8)]) : s(K, L) <- aggregate(list(X), e(K, X), L, "
        "steps([a where X > 0, later(b) where X > 1], [after_match(skip_to_next)]))."
    )
    program = ProgramRunner(rule)
    program.engine.rules.network.limit_stored(2)
    program.feed("e(a,1)@1 e(a,1)@2 e(b,1)@3")
    assert program.feed("e(a,1)@10.5 e(a,2)@11") == "s(a,[1,2])@10.5-11"


@pytest.mark.parametrize("window", ["{}", "timed_out({}, 900)"])
def test_overlapping_matches_are_limited(window: str) -> None:
    steps = "steps([a(1, many) where X < 900, b where X > 900], [after_match(skip_to_next)])"
    rule = f"s(L) <- aggregate(list(X), e(X), L, {window.format(steps)})."
    program = ProgramRunner(rule, clock=StreamClock())
    program.engine.rules.network.limit_stored(50)
    (event_rule,) = program.engine.rules.rules
    for second in range(120):
        assert program.feed(f"e({second})@{second}") == ""
        assert event_rule.match_count <= 50
    assert event_rule.dropped_count == 70
    assert "has more than 50 partial matches" in str(program.warnings[0])


@pytest.mark.parametrize(
    ("steps", "expected"),
    [
        # y may follow, although the match ends before y could match an event
        ("later(x(1, 2, until(X =:= 9))) where X > 0, y(0, 1, reluctant) where X < 0", "s([1])@0-1"),
        ("later(x(1, 2, until(X =:= 9))) where X > 0, later(y(0, 1, reluctant)) where X < 0", "s([1])@0-1"),
        ("later(x(1, 2, until(X =:= 9))) where X > 0, y(0, 1, reluctant) where X < -5", "s([1,3])@0-2"),
        (
            "later(x(1, 2, until(X =:= 9))) where X > 0, y(0, 1) where X =:= 7, z(0, 1, reluctant) where X < 0",
            "s([1])@0-1",
        ),
    ],
)
def test_trailing_reluctant_variable_may_follow(steps: str, expected: str) -> None:
    assert outputs_of(STARS.format(steps), "e(1)@0 e(-2)@1 e(3)@2") == expected


def test_variable_without_later_follows_directly() -> None:
    steps = "later(x(1, 2, until(X =:= 9))) where X > 0, {} where X < 0"
    stream = "e(1)@0 e(0)@1 e(-2)@2 e(3)@3"
    assert outputs_of(STARS.format(steps.format("y(0, 1, reluctant)")), stream) == "s([1,3])@0-3"
    assert outputs_of(STARS.format(steps.format("later(y(0, 1, reluctant))")), stream) == "s([1])@0-2"


def test_error_of_condition_refuses_event() -> None:
    program = ProgramRunner("s(L) <- aggregate(list(X), e(X), L, steps([a, b where X > prev(X)])).")
    assert program.feed("e(1)@1 e(x)@2 e(2)@3") == "s([1,2])@1-3"
    assert ["the condition of the step b: " in str(error) for error in program.errors] == [True]


def test_error_in_until_is_reported() -> None:
    program = ProgramRunner("s(L) <- aggregate(list(X), e(X), L, steps([a(1, many, until(X > nine))])).")
    assert program.feed("e(1)@1") == ""
    assert ["until of the step a: " in str(error) for error in program.errors] == [True]


def test_parts_of_condition_share_variables() -> None:
    steps = "a(2, many) where (X > 1, span(N), X < 9, X - first(X) < N)"
    stream = "e(1)@1 e(2)@2 e(5)@3 e(6)@4 e(9)@5"
    assert outputs_of("span(4).\n" + STARS.format(steps), stream) == "s([2,5])@2-4"


def test_condition_with_outer_pattern_is_refused() -> None:
    with pytest.raises(ProgramErrors, match="a condition of a step uses a pattern to the left"):
        ProgramRunner("s(L) <- x(Y) seq aggregate(list(X), e(X), L, steps([a where X > Y])).")


@pytest.mark.parametrize(
    "steps", ["a(1, many)", "a where X = 1, b(0, many), c where X = 2", "later(a(2, many))"]
)
def test_endless_variable_is_refused(steps: str) -> None:
    with pytest.raises(ProgramErrors, match="nothing ends the step"):
        ProgramRunner(STARS.format(steps))


def test_preferred_alternatives_replace_certain_match() -> None:
    program = ProgramRunner(STARS.format(AMBIGUOUS_STEPS))
    program.feed(" ".join(f"e({x})@{x}" for x in range(101)) + " e(1)@200 e(-1)@300")
    assert program.warnings
    assert program.feed("e(5)@301 e(6)@302 e(6)@303 e(500)@304 e(-2)@305") == "s([5,6,6,500])@301-305"


OVERLAPS = "s(L) <- aggregate(list(X), e(X), L, steps([{}], [after_match({})]))."


@pytest.mark.parametrize(
    ("steps", "strategy", "expected"),
    [
        ("a(2) where X < 4", "skip_past_last", "s([1,2])@0-1 s([1,2])@5-6"),
        ("a(2) where X < 4", "skip_to_next", "s([1,2])@0-1 s([2,3])@1-2 s([1,2])@5-6 s([2,0])@6-7"),
        ("a, b(2) where X > prev(X)", "skip_to_last(b)", "s([1,2,3])@0-2 s([3,4,9])@2-4"),
        ("a(3) where X > prev(X)", "skip_to_last(a)", "s([1,2,3])@0-2 s([3,4,9])@2-4"),
        (
            "a, b(2) where X > prev(X)",
            "skip_to_first(b)",
            "s([1,2,3])@0-2 s([2,3,4])@1-3 s([3,4,9])@2-4",
        ),
        # the step b has no event in the matches [1,2], so the next match begins after the last one
        (
            "a where X < 5, b(0, 1) where X > 8, c where X < 3",
            "skip_to_first(b)",
            "s([1,2])@0-1 s([4,9,1])@3-5 s([1,2])@5-6",
        ),
    ],
)
def test_next_match_begins_by_strategy(steps: str, strategy: str, expected: str) -> None:
    stream = " ".join(f"e({x})@{second}" for second, x in enumerate([1, 2, 3, 4, 9, 1, 2, 0]))
    assert outputs_of(OVERLAPS.format(steps, strategy), stream) == expected


def test_overlapping_match_waits_for_same_start_only() -> None:
    """The greedy step d may continue the first match, while the second one is complete."""
    rule = OVERLAPS.format("a where X < 3, b(1, 4) where X > 5", "skip_to_next")
    assert outputs_of(rule, "e(1)@0 e(7)@1 e(2)@2 e(8)@3 e(9)@4 e(0)@5") == "s([1,7])@0-2 s([2,8,9])@2-5"


def test_skip_to_first_event_of_match_is_reported_once() -> None:
    program = ProgramRunner(OVERLAPS.format("a(0, 1) where X = 1, b where X > 1", "skip_to_first(b)"))
    assert program.feed("e(1)@0 e(2)@1 e(3)@2") == "s([1,2])@0-1 s([2])@1-1 s([3])@2-2"
    assert ["leads to the first event of the match" in str(warning) for warning in program.warnings] == [True]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("[after_match(skip_to_first(a))]", "would begin at the first event of the match, without end"),
        ("[after_match(skip_to_last(a))]", "would begin at the first event of the match, without end"),
        ("[after_match(skip_to_last(c))]", "unknown step; the steps are a, b"),
        ("[after_match(skip_to_frist(b))]", r"skip_to_last\(Step\); did you mean skip_to_first\?"),
        ("[after_match(skip_to_last)]", "after_match of steps needs one of skip_past_last"),
        ("[after_match(skip_to_next), after_match(skip_to_next)]", "two options are after_match"),
        ("[skip_to_next]", "the option of steps is"),
        ("skip_to_next", "steps needs a list of options"),
    ],
)
def test_invalid_option_of_steps_is_refused(options: str, message: str) -> None:
    with pytest.raises(ProgramErrors, match=message):
        ProgramRunner(f"s(L) <- aggregate(list(X), e(X), L, steps([a, b where X > 1], {options})).")


@pytest.mark.parametrize(
    ("steps", "expected"),
    [
        ("a(1, many) where avg(X) < 3", "s([1,2,3,4])@0-4 s([1,2,0,8])@5-9"),
        # the event that would exceed the sum ends the step
        ("a(1, many, until(sum(X) > 6))", "s([1,2,3])@0-3 s([4])@3-4 s([1,2,0])@5-8"),
        ("a(1, many) where (count(a) < 3, X < 9)", "s([1,2])@0-2 s([3,4])@2-4 s([1,2])@5-7 s([0,8])@7-9"),
        (
            "a(1, many) where count(match) =< 2, b where X > max(a, X)",
            "s([1,2,3])@0-2 s([4,9])@3-5 s([1,2])@5-7 s([0,8,90])@7-9",
        ),
        ("a(2) where X < 9, b where X > 2 * avg(a, X)", "s([3,4,9])@2-4 s([2,0,8])@6-8"),
        ("a(2), b where X < min(match, X) + 1", "s([4,9,1])@3-5"),
        ("a(3, many) where X > prev(X, 2)", "s([1,2,3,4,9])@0-5"),
        ("a(3, many) where stddev(X) < 1.1", "s([1,2,3])@0-3 s([1,2,0])@5-8"),
        ("a(1, many) where avg(X * 2) < 6", "s([1,2,3,4])@0-4 s([1,2,0,8])@5-9"),
        ("a(1, many, until(sum(X - 1) > 3))", "s([1,2,3])@0-3 s([4])@3-4 s([1,2,0])@5-8"),
        ("a(2), b where X > max(a, 2 * X) + 1", "s([2,0,8])@6-8"),
        ("a(2), b where X > 2 + max(match, X / 2)", "s([3,4,9])@2-4 s([2,0,8])@6-8"),
        ("a(1, many) where max(t2) - min(t1) < 3", "s([1,2,3])@0-3 s([4,9,1])@3-6 s([2,0,8])@6-9"),
        ("a(1, many) where sum(t2 - t1 + 1) =< 3", "s([1,2,3])@0-3 s([4,9,1])@3-6 s([2,0,8])@6-9"),
    ],
)
def test_condition_uses_aggregates_and_distant_events(steps: str, expected: str) -> None:
    stream = " ".join(f"e({x})@{second}" for second, x in enumerate([1, 2, 3, 4, 9, 1, 2, 0, 8]))
    outputs = outputs_of(STARS.format(steps), f"{stream} e(90)@9")
    assert outputs == expected


def test_aggregate_without_value_skips_condition() -> None:
    steps = "a(0, 1) where X > 100, b where X > avg(a, X), c where X > 100 + count(a)"
    assert outputs_of(STARS.format(steps), "e(1)@0 e(101)@1") == "s([1,101])@0-1"


def test_value_that_cannot_be_aggregated_refuses_event() -> None:
    program = ProgramRunner(STARS.format("a(1, many) where avg(X) < 3"))
    assert program.feed("e(1)@1 e(x)@2 e(9)@3") == "s([1])@1-3"
    (error,) = program.errors
    assert "at event e(x): aggregate avg: the value is 'x': expected a number" in str(error)


def test_expression_without_value_refuses_event_of_its_step_only() -> None:
    program = ProgramRunner(STARS.format("a where X == on, b(1, many) where avg(b, 2 * X) < 9"))
    assert program.feed("e(on)@1 e(1)@2 e(x)@3 e(3)@4 e(90)@5") == "s([on,1,3])@1-5"
    (error,) = program.errors
    assert "at event e(x): aggregate avg: the value is '2*x': expected a number" in str(error)


@pytest.mark.parametrize(
    ("condition", "message"),
    [
        ("X > prev(X, 0)", r"prev\(X, N\) needs a number of events from 1 to 100"),
        ("X > prev(X, 101)", r"prev\(X, N\) needs a number of events from 1 to 100"),
        ("X > avg(c, X)", "unknown step; the steps are a, b"),
        ("count(c) > 1", "unknown step; the steps are a, b"),
        ("X > avg(Y)", "avg needs an expression of variables that the pattern binds"),
        ("X > avg(X * Y)", "avg needs an expression of variables that the pattern binds"),
        ("X > avg(foo)", "avg needs an expression of variables that the pattern binds"),
        ("X > sum(X - prev(X))", "prev cannot be in the expression of sum"),
        ("X > sum(a, X + avg(X))", "avg cannot be in the expression of sum"),
        (
            "X > median(X)",
            "median is no aggregate of conditions of steps: expected count, sum, avg",
        ),
        ("X > quantile(0.5, X)", "quantile is no aggregate of conditions of steps"),
    ],
)
def test_invalid_navigation_is_refused(condition: str, message: str) -> None:
    with pytest.raises(ProgramErrors, match=message):
        ProgramRunner(STARS.format(f"a, b where {condition}"))


def test_largest_of_two_numbers_is_no_aggregate() -> None:
    assert outputs_of(STARS.format("a, b where X >= max(e, 4)"), "e(1)@0 e(3)@1 e(4)@2") == "s([3,4])@1-2"


STAMPED = "s(D) <- aggregate([{}], e(X), [S, E], steps([{}])) where D is E - S."


@pytest.mark.parametrize(
    ("kinds", "steps", "expected"),
    [
        ("first(t1), last(t2)", "a(2) where X < 5", "s(2)@0-2"),
        ("of(a, last(t2)), of(b, first(t1))", "a(2), b where X > 5", "s(2)@0-5"),
        ("min(t1), max(t2 + 1)", "a(2) where X < 5", "s(3)@0-2"),
        ("first(t1), last(t2)", "a where X < 5, later(b) where (t2(E), E - first(a, t1) > 3)", "s(5)@0-5"),
        ("first(t1), last(t2)", "a(1, many) where (t1(S), S - prev(t2) < 1, X < 9)", "s(2)@0-5 s(0)@6-8"),
        ("first(t1), last(t2)", "a, b where (t1(S), S - prev(t2) > 1)", "s(4)@1-5"),
        ("first(t1), last(t2)", "a(1, many, until((t2(E), E - first(match, t1) > 2)))", "s(2)@0-5 s(2)@4-8"),
    ],
)
def test_steps_use_stamps_of_events(kinds: str, steps: str, expected: str) -> None:
    stream = "e(1)@0-1 e(2)@1-2 e(9)@4-5 e(8)@6-6 e(7)@7-8"
    assert outputs_of(STAMPED.format(kinds, steps), stream) == expected


@pytest.mark.parametrize(
    ("steps", "expected"),
    [
        ("group([a where X < 5, b where X > prev(X)], 2)", "s([1,2,3,4])@0-3"),
        ("group([a where X < 5, b where X > 1], 1, many)", "s([1,2,3,4])@0-4 s([1,2])@6-9"),
        (
            "group([a where X < 5, b where X > 1], 1, many, reluctant)",
            "s([1,2])@0-1 s([3,4])@2-3 s([1,2])@6-7",
        ),
        # the count of a step begins again in each repetition
        ("group([a(1, 2) where X < 5], 2, 3), b where X > 8", "s([1,2,3,4,9])@0-4"),
        ("group([a(2) where X < 4], 1, many), b where X > 3", "s([2,3,4])@1-3"),
        ("(a where X > 8) or (b where X > 3), c", "s([4,9])@3-4 s([9,1])@5-6"),
        ("[a where X =:= 1, b] or c(3), d where X =:= 4", "s([1,2,3,4])@0-3"),
        ("permute([a where X > 8, b(2) where X < 5])", "s([3,4,9])@2-4 s([9,1,2])@5-7"),
        ("permute([a, b where X > prev(X), c where X > 8])", "s([3,4,9])@2-4 s([9,1,2])@5-7"),
        (
            "group([a where X < 4], 0, 1), b where (X > first(a, X), X < 4)",
            "s([1,2])@0-1 s([3])@2-3 s([1,2])@6-7 s([0])@8-9",
        ),
        ("a where X < 4, group([later(b where X > 8), later(c where X < 3)], 1)", "s([1,9,1])@0-6"),
        ("a, (b where X > 8) or [c where X > 3, d(2) where X > 8]", "s([3,4,9,9])@2-5"),
    ],
)
def test_groups_of_steps_match_stream(steps: str, expected: str) -> None:
    stream = " ".join(f"e({x})@{second}" for second, x in enumerate([1, 2, 3, 4, 9, 9, 1, 2, 0, 0]))
    assert outputs_of(STARS.format(steps), stream) == expected


@pytest.mark.parametrize(
    ("steps", "message"),
    [
        ("group([], 2)", "a group of steps needs a list of steps"),
        ("group([a], 2, 1)", "a group is .* where N is not larger than M"),
        ("group([a], 1, many)", "nothing ends the group"),
        ("group([a(0, 1) where X > 1], 1, many)", "needs a step with a minimum above 0"),
        ("group([a], 1, until(X > 1))", "until belongs to a step, not to a group"),
        ("group([a], 0, 1)", "at least one step must have a minimum above 0"),
        ("a, group([later(b)], 0, 1)", "nothing ends the step b"),
        ("permute([a, b(0, 1)])", "each step of permute needs a minimum above 0"),
        ("group([a, permute([b, c, d, e, f])], 20)", "which have at most 1000 places"),
        ("(a or b), a", "two steps are called a"),
    ],
)
def test_invalid_group_is_refused(steps: str, message: str) -> None:
    with pytest.raises(ProgramErrors, match=message):
        ProgramRunner(STARS.format(steps))


@pytest.mark.parametrize(
    ("steps", "part", "message"),
    [
        ("a, b where X > prev(Y)", "prev(Y)", "prev needs a variable that the pattern binds"),
        ("a, b where X > prev(X + 1)", "prev(X + 1)", "prev needs a variable that the pattern binds"),
        ("a, b where X > 2 + avg(a, Y * 2)", "avg(a", "avg needs an expression of variables"),
        ("a, b where X > first(top, X)", "top", "unknown step; the steps are a, b"),
        ("start, b where X > first(strat, X)", "strat", "the steps are start, b; did you mean start?"),
        ("a, group([b, c], 2, 1)", "group", "a group is group(Steps), group(Steps, N)"),
        ("a, group(b, 2)", "group", "a group is group(Steps), group(Steps, N)"),
        ("a, (b or c) where X > 1", "where", "where and later belong to a step, not to a group"),
        ("a, b, [after_match(skip_to_next)]", "after_match", "options follow the list of steps"),
        ("a, later([b, c])", "later", "where and later belong to a step, not to a group"),
    ],
)
def test_invalid_step_is_reported_at_its_place(steps: str, part: str, message: str) -> None:
    text = STARS.format(steps)
    with pytest.raises(ProgramErrors) as raised:
        ProgramRunner(text)
    (error,) = raised.value.errors
    assert message in str(error)
    assert place_of(error).column == text.index(part) + 1


def test_predicate_may_have_name_of_navigation() -> None:
    program = ProgramRunner(STARS.format("a, b where last([X, 3], 3)"))
    assert program.feed("e(1)@1 e(2)@2") == "s([1,2])@1-2"


def test_deeply_nested_groups_are_refused() -> None:
    with pytest.raises(ProgramErrors, match="groups of steps are nested too deeply"):
        ProgramRunner(STARS.format("[" * 1000 + "a" + "]" * 1000))


def test_skip_to_step_of_repeated_group_is_accepted() -> None:
    rule = OVERLAPS.format("group([a where X < 5], 2)", "skip_to_last(a)")
    assert outputs_of(rule, "e(1)@0 e(2)@1 e(3)@2") == "s([1,2])@0-1 s([2,3])@1-2"


TIMEOUTS = "s(L, N) <- aggregate([list(X), list(step)], e(X), [L, N], timed_out(steps([{}]{}), 5))."


def timeouts_of(program: ProgramRunner, stream: str) -> str:
    """Return the events ``s`` that a program derives, those of alarms included."""
    derived: List[Any] = []
    clock: Any = program.engine.clock
    for item in stream.split():
        clock.move_to(from_seconds(float(item.rpartition("@")[2])))
        derived += program.events
        program.feed(item)
        derived += program.events
        program.events.clear()
    return format_events([event for event in derived if functor_name(event[0]) == "s"])


def timeout_runner(rule: str, flags: Any = ()) -> ProgramRunner:
    """Return a runner of a program whose clock follows its events."""
    return ProgramRunner(rule, flags, clock=StreamClock())


@pytest.mark.parametrize(
    ("steps", "stream", "expected"),
    [
        ("a, b where X > 5", "e(1)@1 e(9)@3 x@9", ""),
        ("a, b where X > 5", "e(1)@1 x@9", "s([1],[a])@1-6"),
        ("a, b where X > 5", "e(1)@1 e(2)@3 x@9", "s([2],[a])@3-8"),
        ("a where X < 5, later(b where X > 5)", "e(1)@1 e(2)@4 e(3)@5 x@20", "s([1],[a])@1-6"),
        # an event at the deadline comes too late
        ("a, b where X > 5", "e(1)@1 e(9)@6 x@20", "s([1],[a])@1-6 s([9],[a])@6-11"),
        # the match is complete, and waits for a further event of the last step
        ("a, b(1, many) where X > 5", "e(1)@1 e(9)@3 x@9", ""),
        (
            "a, later(b(2) where X > 5), later(c where X < 0)",
            "e(1)@1 e(9)@2 e(3)@3 x@9",
            "s([1,9],[a,b])@1-6",
        ),
    ],
)
def test_incomplete_match_times_out(steps: str, stream: str, expected: str) -> None:
    assert timeouts_of(timeout_runner(TIMEOUTS.format(steps, "")), stream) == expected


def test_each_start_times_out_with_overlaps() -> None:
    rule = TIMEOUTS.format("a where X < 5, later(b where X > 5)", ", [after_match(skip_to_next)]")
    assert timeouts_of(timeout_runner(rule), "e(1)@1 e(2)@4 e(8)@7 x@20") == "s([1],[a])@1-6"
    assert timeouts_of(timeout_runner(rule), "e(1)@1 e(2)@4 x@20") == "s([1],[a])@1-6 s([2],[a])@4-9"


def test_timeouts_at_one_instant_are_in_order_of_starts() -> None:
    """The deadline of a failed match of key k precedes that of key m."""
    rule = "s(K, N) <- aggregate(list(X), e(K, X), N, timed_out(steps([a where X < 5, b where X > 5]), 5))."
    stream = "e(k,1)@1 e(m,2)@1 e(k,3)@1 x@20"
    assert timeouts_of(timeout_runner(rule), stream) == "s(m,[2])@1-6 s(k,[3])@1-6"


def test_timeouts_of_keys_are_separate() -> None:
    rule = "s(K) <- aggregate(count, e(K, X), _, timed_out(steps([a, b where X > 5]), 5))."
    assert timeouts_of(timeout_runner(rule), "e(k,1)@1 e(m,1)@2 e(k,9)@3 x@20") == "s(m)@2-7"


def test_match_of_idle_key_times_out() -> None:
    """Events of key m do not end the state of key k before its deadline."""
    rule = (
        "l([property(ttl, 2)]) : "
        "s(K) <- aggregate(count, e(K, X), _, timed_out(steps([a, later(b) where X > 5]), 5))."
    )
    assert timeouts_of(timeout_runner(rule), "e(k,1)@1 e(m,1)@4 x@20") == "s(k)@1-6 s(m)@4-9"


def test_event_without_alarm_before_it_times_out_match_of_its_key() -> None:
    """With a delay of the watermark, events after the deadline arrive before the alarm."""
    program = timeout_runner(TIMEOUTS.format("a, b where X > 5", ""), [("watermark_delay", "3")])
    assert timeouts_of(program, "e(1)@1 e(9)@7") == "s([1],[a])@1-6"
    assert timeouts_of(program, "x@20") == "s([9],[a])@7-12"


def test_deadlines_of_failed_matches_are_removed() -> None:
    program = timeout_runner(TIMEOUTS.format("a where X < 5, b where X > 5", ""))
    timeouts_of(program, " ".join(f"e(1)@1.{number:04}" for number in range(400)))
    (rule,) = program.engine.rules.rules
    (deadlines,) = [
        sequence
        for node in rule.nodes
        if hasattr(node, "stream")
        for sequence in vars(node.stream).values()
        if sequence.__class__ is list and sequence and sequence[0].__class__ is tuple
    ]
    assert 1 <= len(deadlines) <= 2 * rule.match_count + 64


@pytest.mark.parametrize("flag", ["revision_flag", "etalis_justification"])
def test_flags_keep_timeouts(flag: str) -> None:
    assert (
        timeouts_of(timeout_runner(TIMEOUTS.format("a, b where X > 5", ""), [flag]), "e(1)@1 x@9")
        == "s([1],[a])@1-6"
    )


def test_retraction_of_completing_event_times_out_match() -> None:
    program = timeout_runner(TIMEOUTS.format("a where X < 5, b where X > 5", ""), ["revision_flag"])
    assert timeouts_of(program, "e(1)@1 e(9)@3") == ""
    assert timeouts_of(program, "rev(e(9))@3 x@9") == "s([1],[a])@1-6"


@pytest.mark.parametrize(
    ("window", "message"),
    [
        ("timed_out(steps([a, b]), 0)", "timed_out needs a positive number of seconds"),
        ("timed_out(last(5), 5)", r"timed_out needs steps\(...\) and a number of seconds"),
        ("timed_out(steps([a, b]))", r"or timed_out\(steps\(...\), Seconds\)"),
    ],
)
def test_invalid_timeout_is_refused(window: str, message: str) -> None:
    with pytest.raises(ProgramErrors, match=message):
        ProgramRunner(f"s(L) <- aggregate(list(X), e(X), L, {window}).")
