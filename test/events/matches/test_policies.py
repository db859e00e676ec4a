"""Consumption policies, windows, labels and flags."""

from enum import Enum

import pytest
from events.stream_programs import Program, fired, show

from retalis import Engine, UsageError
from retalis.events.matches.match_types import ConsumptionPolicy, check_policy

STREAM = "a(1)@1 a(2)@2 b@3 b@4"
TWICE = "a@1 a@2 b@3 b@4"


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
def test_policy(policy, operator, different, identical):
    assert fired(f"c(X) <- a(X) {operator} b.", STREAM, policy) == different
    assert fired(f"d <- a {operator} b.", TWICE, policy) == identical


@pytest.mark.parametrize(
    ("policy", "wanted"),
    [
        ("recent", "c(1)@1-1 c(2)@2-2 c(2)@2-3"),
        ("chronological", "c(1)@1-1 c(2)@2-2 c(1)@1-3"),
        ("unrestricted", "c(1)@1-1 c(2)@2-2 c(1)@1-3 c(2)@2-3"),
    ],
)
def test_policy_of_runs(policy, wanted):
    assert fired("c(X) <- a(X) seq b star_times.", "a(1)@1 a(2)@2 b@3", policy) == wanted


def test_a_policy_holds_at_once_for_what_waits_already():
    program = Program("c(X) <- a(X) seq b.")
    program.feed("a(1)@1 a(2)@2")
    program.set("event_consumption_policy", "unrestricted")
    assert program.feed("b@3 b@4") == "c(1)@1-3 c(2)@2-3 c(1)@1-4 c(2)@2-4"


def test_a_rule_has_a_policy_of_its_own():
    rules = "r([property(policy,{})]) : c(X) <- a(X) seq b. d(X) <- a(X) seq b."
    own = {"chronological": "c(1)@1-3 d(2)@2-3", "unrestricted": "c(1)@1-3 c(2)@2-3 d(2)@2-3"}
    for policy, wanted in own.items():
        assert fired(rules.format(policy), "a(1)@1 a(2)@2 b@3") == wanted
    assert fired(rules.format("recent"), "a(1)@1 a(2)@2 b@3", "chronological") == "c(2)@2-3 d(1)@1-3"


def test_a_rule_takes_late_first_sides_by_itself():
    rules = "r([property(out_of_order,{})]) : c <- a seq b. d <- a seq b."
    assert fired(rules.format("on"), "b@5 a@2") == "c@2-5"
    assert fired(rules.format("off"), "b@5 a@2", flags=["out_of_order"]) == "d@2-5"


def test_what_must_not_happen_is_kept_for_late_first_sides_of_a_rule():
    rules = "r([property(window,3),property(out_of_order,on)]) : c <- (a seq b) cnot d."
    assert fired(rules, "d@1 b@2 b@4 a@0") == ""


def test_the_policy_of_a_rule_changes_at_once_and_what_was_said_last_holds():
    program = Program("r([property(policy,chronological)]) : c(X) <- a(X) seq b.")
    program.feed("a(1)@1 a(2)@2")
    program.engine.load(rules="event_rule_property(r, policy, unrestricted).")
    assert program.feed("b@3") == "c(1)@1-3 c(2)@2-3"
    program.engine.load(rules="event_rule_property(r, policy, chronological).")
    assert program.feed("b@4") == "c(1)@1-4"
    program.set("event_consumption_policy", "unrestricted")
    assert program.feed("b@5") == "c(2)@2-5"


def test_what_a_rule_says_of_itself_is_kept():
    rules = "r([property(policy,chronological),property(out_of_order,on)]) : c(X) <- a(X) seq b."
    program = Program(rules)
    program.feed("a(2)@2 a(1)@1")
    engine = Engine.restore(program.engine.snapshot())
    seen = []
    engine.on_event(lambda *event: seen.append(event))
    for term, stamp in (("b", 3), ("b", 4), ("b", 9), ("a(8)", 8)):
        engine.event(term, stamp, stamp)
    assert show(one for one in seen if one[0].__class__ is tuple and one[0][0].name == "c") == (
        "c(2)@2-3 c(1)@1-4 c(8)@8-9"
    )


def test_rejected_partners_stay():
    assert fired("c(X) <- a(X) seq b(Y) where X < Y.", "a(1)@1 a(9)@2 b(5)@3 b(10)@4") == "c(1)@1-3 c(9)@2-4"


def test_identical_rules_each_fire():
    assert fired("c <- a seq b. c <- a seq b.", "a@1 b@2") == "c@1-2 c@1-2"


@pytest.mark.parametrize("name", ["window", "event_rule_window"])
def test_window(name):
    rules = f"r([property({name},2)]) : c <- a seq b."
    assert fired(rules, "a@1 b@3 a@4 b@6.000000001") == "c@1-3"


def test_window_as_a_fact_and_of_rules_without_label():
    assert fired("event_rule_property(unlabeled,window,2). c <- a and b.", "a@1 b@9 a@10") == "c@9-10"


def test_a_window_removes_what_is_too_old_by_the_clock_of_the_rule():
    program = Program("r([property(window,2)]) : c(X) <- a(X) seq b(X).")
    program.feed(" ".join(f"a({i})@{i}" for i in range(100)))
    assert program.engine.rules.match_count == 3


def test_within_removes_below_it_too():
    program = Program("c <- ((a(X) and b(X)) seq d) within 5.")
    program.feed(" ".join(f"a({i})@{i}" for i in range(100)))
    assert program.engine.rules.match_count == 5


def test_stamps_far_ahead_do_not_move_the_clock_of_a_rule():
    program = Program("r([property(window,2)]) : c(X) <- a(X) seq b.")
    assert program.feed("a(1)@1 a(2)@9000000 b@2") == "c(1)@1-2"


def test_cap():
    program = Program("c(X) <- a(X) seq b.", policy="chronological")
    program.engine.rules.max_stored = 3
    program.feed(" ".join(f"a({i})@{i}" for i in range(10)))
    assert program.engine.rules.match_count == 3
    assert program.feed("b@20") == "c(7)@7-20"
    assert "partial matches" in str(program.warnings[0])


def test_out_of_order():
    rules, stream = "c <- a seq b.", "b@2 a@1"
    assert fired(rules, stream) == ""
    assert fired(rules, stream, flags=["out_of_order"]) == "c@1-2"
    assert fired("c <- (a seq b) cnot d.", "d@2 b@3 a@1", flags=["out_of_order"]) == ""
    assert fired("c(X) <- a(X) forall_seq b.", "b@3 a(1)@1", flags=["out_of_order"]) == "c(1)@1-3"
    assert fired("c <- a seq b seq d.", "d@3 b@2 a@1", flags=["out_of_order"]) == "c@1-3"
    assert fired("c <- a forall_seq a.", "a@33 a@29-31", flags=["out_of_order"]) == "c@29-33"


@pytest.mark.parametrize(
    ("policy", "wanted"),
    [
        ("recent", "n(0)@3-3 n(1)@3-4 n(2)@3-6 n(0)@1-1 n(1)@1-6 n(2)@1-8"),
        ("recent_2", "n(0)@3-3 n(1)@3-4 n(2)@3-6 n(0)@1-1 n(1)@1-2 n(2)@1-6 n(3)@1-8"),
        ("chronological", "n(0)@3-3 n(1)@3-4 n(2)@3-6 n(0)@1-1 n(1)@1-2 n(2)@1-6 n(3)@3-8"),
        ("unrestricted", "n(0)@3-3 n(1)@3-4 n(2)@3-6 n(0)@1-1 n(1)@1-2 n(2)@1-4 n(3)@1-6 n(3)@3-8 n(4)@1-8"),
    ],
)
def test_a_late_start_takes_earlier_repetitions(policy, wanted):
    rules, stream = "n(N) <- a seq aggregate(count, b, N).", "b@2 b@4 a@3 b@6 a@1 b@8"
    assert fired(rules, stream, policy, ["out_of_order"]) == wanted
    assert "n(1)@3-4" not in fired(rules, stream, policy)


def test_garbage_control_general():
    flags = [("garbage_window", 2), ("garbage_window_step", 1), ("garbage_control", "general")]
    rules = "c(X) <- a(X) seq b(X). f(X) <- e fnot g(X). s(N) <- i(X) seq aggregate(count, j(X), N)."
    stream = " ".join(f"a({i})@{i} g({i})@{i} i({i})@{i}" for i in range(50))
    kept, collected = Program(rules), Program(rules, flags)
    kept.feed(stream)
    collected.feed(stream)
    assert kept.engine.rules.match_count == 101
    assert collected.engine.rules.match_count < 10


def test_garbage_control_counts_a_run_from_its_last_repetition():
    flags = [("garbage_window", 10), ("garbage_window_step", 1), ("garbage_control", "general")]
    program = Program("s(N) <- i seq aggregate(count, j, N). t <- i seq j star_times.", flags)
    assert program.feed("i@1 j@8") == "s(0)@1-1 t@1-1 s(1)@1-8 t@1-8"
    assert program.feed("j@17 j@26") == "s(2)@1-17 t@1-17 s(3)@1-26 t@1-26"
    assert program.feed("j@38") == ""
    assert program.engine.rules.match_count == 0


def test_garbage_control_pattern():
    rules = (
        "r([property(window,50), property(window_step,1)]) : c(X) <- a(X) seq b(X). d(X) <- a(X) seq e(X)."
    )
    program = Program(rules, [("garbage_control", "pattern")])
    program.feed(" ".join(f"a({i})@{i}" for i in range(200)))
    assert [rule.stored_match_count for rule in program.engine.rules.rules] == [51, 200]


@pytest.mark.parametrize("goal", ["set_etalis_flag(foo,on)", "set_etalis_flag(out_of_order,maybe)"])
def test_flags_are_checked(goal):
    with pytest.raises(Exception, match="etalis_flag"):
        Program().engine.call(goal)


def test_rule_sharing_changes_nothing():
    rules = "p <- a seq b. p <- z. q <- a seq b seq d."
    assert fired(rules, "z@0 a@1 b@2 d@3", flags=["rule_sharing"]) == fired(rules, "z@0 a@1 b@2 d@3")


def test_a_late_first_side_leaves_the_second_sides_to_others():
    rule, flags = "c(X) <- a forall_seq b(X).", ["out_of_order"]
    assert (
        fired(rule, "b(1)@5 b(2)@6 a@2 a@3", "unrestricted", flags) == "c(1)@2-5 c(2)@2-6 c(1)@3-5 c(2)@3-6"
    )
    assert fired(rule, "b(1)@5 b(2)@6 a@2 a@3", "chronological", flags) == "c(1)@2-5 c(2)@3-6"


class NewestOfAll(Enum):
    """A policy that prefers the newest partner and consumes none."""

    NEWEST = "newest_of_all"

    prefers_newest = property(lambda self: True)
    consumes_partners = replaces_identical = property(lambda self: False)


def test_a_policy_without_a_join_is_refused():
    for policy in ConsumptionPolicy:
        check_policy(policy)
    with pytest.raises(UsageError, match="policy newest_of_all: the network has no join"):
        check_policy(NewestOfAll.NEWEST)


def test_a_rule_refuses_such_a_policy_and_stays_as_it_is():
    engine = Engine()
    engine.load("c(X) <- a(X) seq b(X).")
    (rule,) = engine.rules.rules
    options = rule.options
    with pytest.raises(UsageError, match="no join"):
        rule.configure(options._replace(policy=NewestOfAll.NEWEST), None, None)
    assert rule.options is options
