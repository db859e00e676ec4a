"""Consumption policies, windows, labels and flags."""

from enum import Enum
from typing import Any, List, cast

import pytest
from events.program_runner import ProgramRunner, format_events, outputs_of

from retalis import Engine, UsageError
from retalis.events.matches.network_options import ConsumptionPolicy, check_policy

DISTINCT_EVENTS = "a(1)@1 a(2)@2 b@3 b@4"
EQUAL_EVENTS = "a@1 a@2 b@3 b@4"


@pytest.mark.parametrize(
    ("policy", "different", "identical"),
    [
        ("recent", "c(2)@2-3 c(1)@1-4", "d@2-3"),
        ("recent_2", "c(2)@2-3 c(1)@1-4", "d@2-3 d@1-4"),
        ("chronological", "c(1)@1-3 c(2)@2-4", "d@1-3 d@2-4"),
        ("chronological_2", "c(1)@1-3 c(2)@2-4", "d@1-3 d@2-4"),
        ("unrestricted", "c(1)@1-3 c(2)@2-3 c(1)@1-4 c(2)@2-4", "d@1-3 d@2-3 d@1-4 d@2-4"),
    ],
)
@pytest.mark.parametrize("operator", ["seq", "and"])
def test_policy_selects_partners_of_joins(policy: str, operator: str, different: str, identical: str) -> None:
    assert outputs_of(f"c(X) <- a(X) {operator} b.", DISTINCT_EVENTS, policy) == different
    assert outputs_of(f"d <- a {operator} b.", EQUAL_EVENTS, policy) == identical


@pytest.mark.parametrize(
    ("policy", "expected"),
    [
        ("recent", "c(1)@1-1 c(2)@2-2 c(2)@2-3"),
        ("chronological", "c(1)@1-1 c(2)@2-2 c(1)@1-3"),
        ("unrestricted", "c(1)@1-1 c(2)@2-2 c(1)@1-3 c(2)@2-3"),
    ],
)
def test_policy_selects_starts_of_runs(policy: str, expected: str) -> None:
    assert outputs_of("c(X) <- a(X) seq b star_times.", "a(1)@1 a(2)@2 b@3", policy) == expected


def test_policy_applies_to_stored_matches() -> None:
    program = ProgramRunner("c(X) <- a(X) seq b.")
    program.feed("a(1)@1 a(2)@2")
    program.set("event_consumption_policy", "unrestricted")
    assert program.feed("b@3 b@4") == "c(1)@1-3 c(2)@2-3 c(1)@1-4 c(2)@2-4"


def test_rule_has_own_policy() -> None:
    rules = "r([property(policy,{})]) : c(X) <- a(X) seq b. d(X) <- a(X) seq b."
    own = {"chronological": "c(1)@1-3 d(2)@2-3", "unrestricted": "c(1)@1-3 c(2)@2-3 d(2)@2-3"}
    for policy, expected in own.items():
        assert outputs_of(rules.format(policy), "a(1)@1 a(2)@2 b@3") == expected
    assert outputs_of(rules.format("recent"), "a(1)@1 a(2)@2 b@3", "chronological") == "c(2)@2-3 d(1)@1-3"


def test_rule_has_own_out_of_order_property() -> None:
    rules = "r([property(out_of_order,{})]) : c <- a seq b. d <- a seq b."
    assert outputs_of(rules.format("on"), "b@5 a@2") == "c@2-5"
    assert outputs_of(rules.format("off"), "b@5 a@2", flags=["out_of_order"]) == "d@2-5"


def test_negated_event_is_kept_for_late_first_side() -> None:
    rules = "r([property(window,3),property(out_of_order,on)]) : c <- (a seq b) cnot d."
    assert outputs_of(rules, "d@1 b@2 b@4 a@0") == ""


def test_last_policy_applies_immediately() -> None:
    program = ProgramRunner("r([property(policy,chronological)]) : c(X) <- a(X) seq b.")
    program.feed("a(1)@1 a(2)@2")
    program.engine.load(rules="event_rule_property(r, policy, unrestricted).")
    assert program.feed("b@3") == "c(1)@1-3 c(2)@2-3"
    program.engine.load(rules="event_rule_property(r, policy, chronological).")
    assert program.feed("b@4") == "c(1)@1-4"
    program.set("event_consumption_policy", "unrestricted")
    assert program.feed("b@5") == "c(2)@2-5"


def test_properties_of_rule_are_restored() -> None:
    rules = "r([property(policy,chronological),property(out_of_order,on)]) : c(X) <- a(X) seq b."
    program = ProgramRunner(rules)
    program.feed("a(2)@2 a(1)@1")
    engine = Engine.restore(program.engine.snapshot())
    events: List[Any] = []
    engine.on_event(lambda *event: events.append(event))
    for term, second in (("b", 3), ("b", 4), ("b", 9), ("a(8)", 8)):
        engine.event(term, second, second)
    assert format_events(
        event for event in events if event[0].__class__ is tuple and event[0][0].name == "c"
    ) == ("c(2)@2-3 c(1)@1-4 c(8)@8-9")


def test_rejected_partners_are_kept() -> None:
    assert (
        outputs_of("c(X) <- a(X) seq b(Y) where X < Y.", "a(1)@1 a(9)@2 b(5)@3 b(10)@4")
        == "c(1)@1-3 c(9)@2-4"
    )


def test_identical_rules_both_emit() -> None:
    assert outputs_of("c <- a seq b. c <- a seq b.", "a@1 b@2") == "c@1-2 c@1-2"


@pytest.mark.parametrize("property_name", ["window", "event_rule_window"])
def test_window_property_limits_matches(property_name: str) -> None:
    rules = f"r([property({property_name},2)]) : c <- a seq b."
    assert outputs_of(rules, "a@1 b@3 a@4 b@6.000000001") == "c@1-3"


def test_window_applies_to_unlabeled_rules() -> None:
    assert outputs_of("event_rule_property(unlabeled,window,2). c <- a and b.", "a@1 b@9 a@10") == "c@9-10"


def test_window_removes_old_matches() -> None:
    program = ProgramRunner("r([property(window,2)]) : c(X) <- a(X) seq b(X).")
    program.feed(" ".join(f"a({i})@{i}" for i in range(100)))
    assert program.engine.rules.match_count == 3


def test_within_removes_inner_matches() -> None:
    program = ProgramRunner("c <- ((a(X) and b(X)) seq d) within 5.")
    program.feed(" ".join(f"a({i})@{i}" for i in range(100)))
    assert program.engine.rules.match_count == 5


def test_timestamp_far_ahead_does_not_advance_rule() -> None:
    program = ProgramRunner("r([property(window,2)]) : c(X) <- a(X) seq b.")
    assert program.feed("a(1)@1 a(2)@9000000 b@2") == "c(1)@1-2"


def test_match_limit_drops_oldest() -> None:
    program = ProgramRunner(policy="chronological")
    program.engine.rules.network.limit_stored(3)
    program.engine.load(rules="c(X) <- a(X) seq b.")
    program.feed(" ".join(f"a({i})@{i}" for i in range(10)))
    assert program.engine.rules.match_count == 3
    assert program.feed("b@20") == "c(7)@7-20"
    assert "partial matches" in str(program.warnings[0])


@pytest.mark.parametrize(
    ("rule", "stream", "expected"),
    [
        ("c <- a seq b.", "b@2 a@1", "c@1-2"),
        ("c <- (a seq b) cnot d.", "d@2 b@3 a@1", ""),
        ("c(X) <- a(X) forall_seq b.", "b@3 a(1)@1", "c(1)@1-3"),
        ("c <- a seq b seq d.", "d@3 b@2 a@1", "c@1-3"),
        ("c <- a forall_seq a.", "a@33 a@29-31", "c@29-33"),
    ],
)
def test_out_of_order_flag_accepts_late_events(rule: str, stream: str, expected: str) -> None:
    assert outputs_of(rule, stream) == ""
    assert outputs_of(rule, stream, flags=["out_of_order"]) == expected


@pytest.mark.parametrize(
    ("policy", "expected"),
    [
        ("recent", "n(0)@3-3 n(1)@3-4 n(2)@3-6 n(0)@1-1 n(1)@1-6 n(2)@1-8"),
        ("recent_2", "n(0)@3-3 n(1)@3-4 n(2)@3-6 n(0)@1-1 n(1)@1-2 n(2)@1-6 n(3)@1-8"),
        ("chronological", "n(0)@3-3 n(1)@3-4 n(2)@3-6 n(0)@1-1 n(1)@1-2 n(2)@1-6 n(3)@3-8"),
        ("unrestricted", "n(0)@3-3 n(1)@3-4 n(2)@3-6 n(0)@1-1 n(1)@1-2 n(2)@1-4 n(3)@1-6 n(3)@3-8 n(4)@1-8"),
    ],
)
def test_late_start_includes_earlier_repetitions(policy: str, expected: str) -> None:
    rules, stream = "n(N) <- a seq aggregate(count, b, N).", "b@2 b@4 a@3 b@6 a@1 b@8"
    assert outputs_of(rules, stream, policy, ["out_of_order"]) == expected
    assert "n(1)@3-4" not in outputs_of(rules, stream, policy)


def test_general_garbage_control_removes_matches() -> None:
    flags = [("garbage_window", 2), ("garbage_window_step", 1), ("garbage_control", "general")]
    rules = "c(X) <- a(X) seq b(X). f(X) <- e fnot g(X). s(N) <- i(X) seq aggregate(count, j(X), N)."
    stream = " ".join(f"a({i})@{i} g({i})@{i} i({i})@{i}" for i in range(50))
    program, collecting_program = ProgramRunner(rules), ProgramRunner(rules, flags)
    program.feed(stream)
    collecting_program.feed(stream)
    assert program.engine.rules.match_count == 101
    assert collecting_program.engine.rules.match_count < 10


def test_garbage_control_keeps_active_runs() -> None:
    flags = [("garbage_window", 10), ("garbage_window_step", 1), ("garbage_control", "general")]
    program = ProgramRunner("s(N) <- i seq aggregate(count, j, N). t <- i seq j star_times.", flags)
    assert program.feed("i@1 j@8") == "s(0)@1-1 t@1-1 s(1)@1-8 t@1-8"
    assert program.feed("j@17 j@26") == "s(2)@1-17 t@1-17 s(3)@1-26 t@1-26"
    assert program.feed("j@38") == ""
    assert program.engine.rules.match_count == 0


def test_pattern_garbage_control_uses_windows() -> None:
    rules = (
        "r([property(window,50), property(window_step,1)]) : c(X) <- a(X) seq b(X). d(X) <- a(X) seq e(X)."
    )
    program = ProgramRunner(rules, [("garbage_control", "pattern")])
    program.feed(" ".join(f"a({i})@{i}" for i in range(200)))
    assert [rule.stored_match_count for rule in program.engine.rules.rules] == [51, 200]


@pytest.mark.parametrize("goal", ["set_etalis_flag(foo,on)", "set_etalis_flag(out_of_order,maybe)"])
def test_invalid_flag_is_refused(goal: str) -> None:
    with pytest.raises(Exception, match="etalis_flag"):
        ProgramRunner().engine.call(goal)


def test_rule_sharing_changes_no_output() -> None:
    rules = "p <- a seq b. p <- z. q <- a seq b seq d."
    assert outputs_of(rules, "z@0 a@1 b@2 d@3", flags=["rule_sharing"]) == outputs_of(
        rules, "z@0 a@1 b@2 d@3"
    )


def test_late_first_side_consumes_no_second_side() -> None:
    rule, flags = "c(X) <- a forall_seq b(X).", ["out_of_order"]
    assert (
        outputs_of(rule, "b(1)@5 b(2)@6 a@2 a@3", "unrestricted", flags)
        == "c(1)@2-5 c(2)@2-6 c(1)@3-5 c(2)@3-6"
    )
    assert outputs_of(rule, "b(1)@5 b(2)@6 a@2 a@3", "chronological", flags) == "c(1)@2-5 c(2)@3-6"


class PolicyWithoutJoin(Enum):
    """A policy that prefers the newest partner and consumes none."""

    NEWEST = "newest_of_all"

    prefers_newest = property(lambda self: True)
    consumes_partners = replaces_identical = property(lambda self: False)


@pytest.mark.parametrize("policy", ConsumptionPolicy)
def test_policy_with_join_is_accepted(policy: ConsumptionPolicy) -> None:
    check_policy(policy)


def test_policy_without_join_is_refused() -> None:
    with pytest.raises(UsageError, match="policy newest_of_all: the network has no join"):
        check_policy(cast("ConsumptionPolicy", PolicyWithoutJoin.NEWEST))


def test_refused_policy_leaves_rule_unchanged() -> None:
    engine = Engine()
    engine.load("c(X) <- a(X) seq b(X).")
    (rule,) = engine.rules.rules
    options = rule.options
    with pytest.raises(UsageError, match="no join"):
        rule.configure(
            options._replace(policy=cast("ConsumptionPolicy", PolicyWithoutJoin.NEWEST)), None, None
        )
    assert rule.options is options
