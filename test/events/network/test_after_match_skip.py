"""After-match skip strategies of rules."""

from typing import Any, List, Tuple

import pytest
from asserting_accessors import required
from events.program_runner import ProgramRunner, format_events, outputs_of

from retalis import Engine

PAST, NEXT, KEEP = "skip_past_last", "skip_to_next", "keep"


def rule(after_match: Any, text: str, policy: str = "recent") -> str:
    return f"r([property(after_match,{after_match}),property(policy,{policy})]) : {text}"


@pytest.mark.parametrize(
    ("strategy", "repeated", "pairs", "runs"),
    [
        (KEEP, "c@1-2 c@2-3 c@3-4", "c(1)@1-3 c(2)@2-3 c(1)@1-4 c(2)@2-4", "c@1-1 c@1-2 c@3-3"),
        (PAST, "c@1-2 c@3-4", "c(1)@1-3", "c@1-1 c@3-3"),
        (NEXT, "c@1-2 c@2-3 c@3-4", "c(1)@1-3 c(2)@2-3", "c@1-1 c@3-3"),
    ],
)
def test_strategies_skip_starts(strategy: str, repeated: str, pairs: str, runs: str) -> None:
    assert outputs_of(rule(strategy, "c <- a ntimes 2."), "a@1 a@2 a@3 a@4") == repeated
    assert outputs_of(rule(strategy, "c(X) <- a(X) seq b.", "unrestricted"), "a(1)@1 a(2)@2 b@3 b@4") == pairs
    assert outputs_of(rule(strategy, "c <- a seq b star_times."), "a@1 b@2 a@3") == runs


def test_late_event_before_end_of_match_is_skipped() -> None:
    rules = rule(PAST, "c(X) <- a(X) and b.")
    assert outputs_of(rules, "a(1)@1 b@5 a(2)@3 a(3)@6 b@4 b@5.5") == "c(1)@1-5 c(3)@5.5-6"


def test_first_match_of_start_is_emitted() -> None:
    rules = rule(NEXT, "c(X) <- a(X) seq b.", "unrestricted")
    assert outputs_of(rules, "a(1)@1 a(2)@1 b@2 b@3 a(3)@1 b@4") == "c(1)@1-2 c(3)@1-4"


def test_starts_at_same_instant_are_one_start() -> None:
    assert outputs_of(rule(NEXT, "c(X) <- a(X) seq b(X)."), "a(1)@1 a(2)@1 b(1)@2 b(2)@3") == "c(1)@1-2"


def test_partners_of_skipped_match_are_consumed() -> None:
    rules = rule(PAST, "c(X,Y) <- (a(X) seq b event_multiply member(Y, [1, 2])) and d(Y).")
    assert outputs_of(rules, "d(2)@1 d(1)@1 a(0)@2 b@3") == "c(0,1)@1-3"


def test_goals_are_called_for_emitted_matches_only() -> None:
    rules = rule(PAST, "c(X) do assertz(called(X)) <- a(X) seq b.", "unrestricted") + " :- dynamic called/1."
    program = ProgramRunner(rules)
    assert program.feed("a(1)@1 a(2)@2 b@3") == "c(1)@1-3"
    assert [answer["X"] for answer in program.engine.query("called(X)")] == [1]


def test_match_with_failed_goal_skips_nothing() -> None:
    rules = rule(PAST, "c(X) do X > 1 <- a(X) seq b.", "unrestricted")
    assert outputs_of(rules, "a(1)@1 a(2)@2 a(3)@2 b@3") == "c(2)@2-3"


def test_all_results_of_event_multiply_are_emitted() -> None:
    rules = rule(PAST, "c(X,Y) do Y < 3 <- a(X) seq b event_multiply member(Y, [1, 2, 3]).", "unrestricted")
    assert outputs_of(rules, "a(1)@1 a(2)@2 b@3") == "c(1,1)@1-3 c(1,2)@1-3"


def test_match_beyond_window_skips_nothing() -> None:
    rules = "r([property(after_match,skip_past_last),property(window,2)]) : c <- a. "
    assert outputs_of(rules, "a@1-9 a@2-4 a@3-4 a@5") == "c@2-4 c@5-5"


def test_negated_pattern_is_not_skipped() -> None:
    rules = rule(PAST, "c(X) <- (a(X) seq b(X)) cnot (d seq e).")
    assert outputs_of(rules, "a(1)@1 b(1)@9 d@2 e@3 a(2)@1 a(3)@10 d@11 e@12 b(3)@13 a(4)@14 b(4)@15") == (
        "c(1)@1-9 c(4)@14-15"
    )


def test_awaited_pattern_is_not_skipped() -> None:
    rules = rule(PAST, "c(X) <- a(X) fnot (d ntimes 3).")
    assert outputs_of(rules, "d@1 d@2 a(1)@3-5 d@4 a(2)@6") == "c(1)@3-5"


def test_event_on_both_sides_is_skipped() -> None:
    assert (
        outputs_of(rule(PAST, "c(X,Y) <- a(X) and a(Y)."), "a(1)@1 a(2)@2 a(3)@3 a(4)@4")
        == "c(1,2)@1-2 c(3,4)@3-4"
    )


@pytest.mark.parametrize("flags", [(), ("revision_flag",), ("etalis_justification",)])
def test_recursive_rule_skips_starts(flags: Tuple[Any, ...]) -> None:
    rules = rule(NEXT, "a(Y) <- a(X) seq b where (X < 3, Y is X + 1).", "unrestricted")
    assert outputs_of(rules, "a(1)@1 a(2)@1 b@2 b@3", flags=flags) == "a(2)@1-2 a(3)@1-3"


def test_strategy_applies_immediately() -> None:
    program = ProgramRunner("r : c(X) do true <- a(X) seq b.", policy="unrestricted")
    assert program.feed("a(1)@1 a(2)@2 b@3") == "c(1)@1-3 c(2)@2-3"
    program.engine.load(rules="event_rule_property(r, after_match, skip_to_next).")
    assert program.feed("b@4 b@5") == "c(1)@1-4 c(2)@2-4"
    program.feed("a(6)@6 a(7)@7")
    program.engine.load(rules="event_rule_property(r, after_match, skip_past_last).")
    assert program.feed("b@8 b@9") == "c(6)@6-8"
    program.feed("a(10)@10 a(11)@11")
    program.engine.load(rules="event_rule_property(r, after_match, keep).")
    assert program.feed("b@12 a(8)@8 b@13") == "c(10)@10-12 c(11)@11-12 c(10)@10-13 c(11)@11-13 c(8)@8-13"


@pytest.mark.parametrize("strategy", [PAST, NEXT])
def test_skipped_starts_are_restored(strategy: str) -> None:
    program = ProgramRunner(rule(strategy, "c(X) <- a(X) seq b.", "unrestricted"))
    program.feed("a(1)@1 a(2)@4 b@3")
    engine = Engine.restore(program.engine.snapshot())
    events: List[Any] = []
    engine.on_event(lambda *event: events.append(event))
    for term, second in (("a(3)", 2), ("b", 5), ("b", 6)):
        engine.event(term, second, second)
    assert format_events(
        event for event in events if event[0].__class__ is tuple and event[0][0].name == "c"
    ) == ("c(2)@4-5" if strategy == PAST else "c(2)@4-5 c(3)@2-5")


def test_timestamp_far_ahead_does_not_stop_rule() -> None:
    program = ProgramRunner(rule(PAST, "c <- a seq b."), clock=None)
    far = 10_000_000
    assert program.feed(f"a@1 b@{far} a@1000011 b@1000012") == f"c@1-{far} c@1000011-1000012"


@pytest.mark.parametrize("strategy", [PAST, NEXT])
def test_skip_state_stays_small(strategy: str) -> None:
    program = ProgramRunner(rule(strategy, "c <- a(X) seq b(X)."))
    (event_rule,) = program.engine.rules.rules
    for number in range(3000):
        program.engine.event(f"a({number})", 5000 - number, 5000 - number)
        program.engine.event(f"b({number})", 5000 + number, 5000 + number)
    assert required(event_rule.skip_state).entry_count <= 2 * event_rule.stored_match_count + 1002


def test_clear_forgets_skipped_starts() -> None:
    program = ProgramRunner(rule(PAST, "c <- a seq b."))
    assert program.feed("a@1 b@9") == "c@1-9"
    program.engine.rules.clear()
    assert program.feed("a@2 b@3") == "c@2-3"


def test_skipped_match_is_not_emitted_by_retraction() -> None:
    rules = rule(PAST, "c(X) <- (a(X) fnot d(X)) and b.")
    stream = "d(1)@0 a(1)@1 a(2)@2 b@3 b@9 rev(d(1))@10 a(3)@11"
    assert outputs_of(rules, stream, flags=["revision_flag"]) == "c(2)@2-3 c(3)@9-11"


def test_skipped_result_is_not_emitted_again() -> None:
    rules = rule(PAST, "c(N) <- (a seq aggregate(count, e(_), N) where N > 0) and b.")
    stream = "a@1 e(1)@2 e(2)@3 b@4 b@9 rev(e(1))@10 a@11 e(3)@12"
    assert outputs_of(rules, stream, flags=["revision_flag"]) == "c(2)@1-4 rev(c(2))@10-10 c(1)@9-12"
