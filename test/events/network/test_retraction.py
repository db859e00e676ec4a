"""Retraction of events, and of the events that were derived from them."""

from typing import Any, Tuple

import pytest
from events.program_runner import ProgramRunner, outputs_of

from retalis.events.matches import consumption_policy


def outputs_with_revision(rules: Any, stream: str, policy: Any = None) -> Any:
    return outputs_of(rules, stream, policy, ["revision_flag"])


@pytest.mark.parametrize(
    ("rules", "stream", "expected"),
    [
        ("c <- a.", "a@1 rev(a)@2 rev(a)@3", "c@1-1 rev(c)@2-2"),
        ("c <- a. d <- c.", "a@1 rev(a)@2", "c@1-1 d@1-1 rev(c)@2-2 rev(d)@2-2"),
        ("c <- a and b.", "a@1 b@2 rev(b)@3 b@4", "c@1-2 rev(c)@3-3"),
        ("c <- a seq b.", "a@1 rev(a)@2 b@3", ""),
        ("c(X) <- a(X) seq b.", "a(1)@1 a(2)@2 rev(a(2))@3 b@4", "c(1)@1-4"),
        ("c <- (a seq b) cnot d.", "a@1 d@2 b@3 rev(d)@4 b@5", "c@1-3"),
        ("c <- a fnot d.", "d@1 a@2 rev(d)@3", "c@2-2"),
        # One second operand completes all first ones.
        ("c(X) <- (a(X) forall_seq b) without d.", "a(1)@1 a(2)@2 d@3 b@4 rev(d)@5 b@6", "c(1)@1-4 c(2)@2-4"),
        (
            "c(X) <- a(X) forall_seq (b fnot (d where X > 0)).",
            "a(1)@1 a(2)@2 d@3 b@4 rev(d)@5",
            "c(1)@1-4 c(2)@2-4",
        ),
        (
            "c(N) <- s seq aggregate(count, a(_), N).",
            "s@1 a(1)@2 a(2)@3 rev(a(1))@4",
            "c(0)@1-1 c(1)@1-2 c(2)@1-3 rev(c(1))@4-4 rev(c(2))@4-4 c(1)@1-3",
        ),
        (
            "c(L) <- s seq aggregate(list(X), a(X), L).",
            "s@1 a(1)@2 a(2)@3 a(3)@4 a(4)@5 rev(a(2))@6 a(5)@7",
            "c([])@1-1 c([1])@1-2 c([1,2])@1-3 c([1,2,3])@1-4 c([1,2,3,4])@1-5 rev(c([1,2]))@6-6 "
            "rev(c([1,2,3]))@6-6 rev(c([1,2,3,4]))@6-6 c([1,3])@1-4 c([1,3,4])@1-5 c([1,3,4,5])@1-7",
        ),
        (
            "c(L) <- s seq aggregate(list(X), a(X,_), L) seq d.",
            "s@1 a(1,x)@2 a(2,x)@3 a(2,y)@4 rev(a(2,x))@6 d@7",
            "c([1,2])@1-7",
        ),
        ("c <- a seq b star_times.", "a@1 b@2 rev(a)@3 b@4", "c@1-1 c@1-2 rev(c)@3-3 rev(c)@3-3"),
        (
            "c(X) <- a seq b(X) star_times.",
            "a@1 b(1)@2 b(1)@3 b(1)@4 rev(b(1))@5 b(2)@6",
            "c(A)@1-1 c(1)@1-2 c(1)@1-3 c(1)@1-4 rev(c(1))@5-5 rev(c(1))@5-5 rev(c(1))@5-5 c(2)@1-6",
        ),
        ("c <- (a(X) fnot d) and a(Y).", "a(1)@1 d@2 a(2)@3 rev(d)@4", "c@1-3"),
        (
            "m <- d. c <- m and (b fnot m).",
            "d@11 b@18 d@10-28 rev(d)@30",
            "m@11-11 m@10-28 rev(m)@30-30 rev(m)@30-30",
        ),
        ("c do new_event(m,[5,5]) <- a.", "a@1 rev(a)@2", "m@5-5 c@1-1 rev(m)@2-2 rev(c)@2-2"),
        ("c(X) <- a(X) or b(X).", "a(1)@1 b(1)@2 rev(b(1))@3", "c(1)@1-1 c(1)@2-2 rev(c(1))@3-3"),
        ("c(X) <- (a(X) seq d) cnot b.", "a(0)@15-20 a(1)@13-23 b@23 b@24 d@25 rev(b)@30", "c(1)@13-25"),
        ("c <- a(X) fnot b(Y).", "b(1)@1 a(0)@9 b(2)@5 rev(b(1))@20", ""),
        ("c <- ((e or a(X)) seq f(X)) cnot b.", "b@3 e@2 f(1)@4 rev(b)@5 f(2)@6", "c@2-4"),
        (
            "c(X) <- a(X) fnot (a(_) fnot a(_)).",
            "a(2)@5 a(1)@9 a(0)@7 rev(a(2))@10",
            "c(2)@5-5 rev(c(2))@10-10 c(0)@7-7",
        ),
    ],
)
def test_retraction_retracts_derived_events(rules: str, stream: str, expected: str) -> None:
    assert outputs_with_revision(rules, stream) == expected


@pytest.mark.parametrize(
    ("pattern", "stream"),
    [
        ("(a without c) without r", "r@2-3 a@1-5 c@2-7"),
        ("(((a without c) without d) without b) without r", "r@2-3 a@1-5 c@2-7"),
        ("(a fnot c) fnot r", "r@2-3 a@4-5 c@2-3"),
        ("(a without c) fnot r", "r@2-3 a@4-6 c@2-8"),
        ("(a fnot c) without r", "r@2-5 a@4-6 c@2-3"),
        ("((a seq b) without c) fnot r", "r@0 a@1 b@3 c@2-4"),
        ("((a seq b) cnot c) fnot r", "r@0 a@1 b@4 c@2-3"),
        ("(((b during a) fnot c) without d) fnot r", "r@0 b@3-4 a@2-5 c@1"),
        ("((a without c) or b) without r", "r@2-3 a@1-5 c@2-7"),
        ("at_end(a fnot c) without r", "r@2-9 a@1-5 c@0"),
        ("((a fnot c) where X = 1) without r(X)", "r(1)@2-5 a@4-6 c@2-3"),
        ("((a fnot c) event_multiply true) without r", "r@2-5 a@4-6 c@2-3"),
    ],
)
def test_retried_match_is_tested_by_inner_negations(pattern: str, stream: str) -> None:
    """The retraction of r tries the match again, which c suppresses until it is retracted, too."""
    program = ProgramRunner(f"o <- {pattern}.", ["revision_flag"])
    assert program.feed(f"{stream} {'rev(r(1))' if 'r(1)' in stream else 'rev(r)'}@20") == ""
    assert program.feed("rev(c)@21").startswith("o@")


def test_operand_is_not_tested_by_its_negation_again() -> None:
    assert outputs_with_revision(
        "o <- ((a without c) seq b) without r.", "a@1-5 r@2-4 b@6 c@2-7 rev(r)@8"
    ) == ("o@1-6")


@pytest.mark.parametrize("goal", ["memorize(c, [{}], _, m, 5)", "subscribe(c, [{}], _, out, s)"])
def test_events_of_memories_are_not_retracted(goal: str) -> None:
    """The rule's goal is over by then."""
    program = ProgramRunner("c do new_event(m,[5,5]) <- a.", ["revision_flag"])
    program.engine.load(goals=goal.format("new_event(x,[6,6])"))
    program.feed("a@1")
    assert program.feed("rev(a)@2") == "rev(m)@2-2 rev(c)@2-2"


@pytest.mark.parametrize("last", ["fail", "X is foo"])
def test_later_event_is_independent_of_failed_goal(last: str) -> None:
    program = ProgramRunner(f"c do (new_event(m,[5,5]), {last}) <- a. d <- b.", ["revision_flag"])
    assert program.feed("a@1 b@2") == "m@5-5 d@2-2"
    assert program.feed("rev(a)@3") == "rev(m)@3-3"


@pytest.mark.parametrize("flags", [(), ("revision_flag",)])
def test_event_derived_from_first_side_is_no_partner(flags: Tuple[Any, ...]) -> None:
    rules = "null_event do new_event(y,[9,9]) <- x. c <- (x cnot z) seq y."
    assert outputs_of(rules, "x@2 y@12", flags=flags) == "y@9-9 null_event@2-2 c@2-12"


def test_rev_is_plain_event_without_flag() -> None:
    assert outputs_of("c <- a. d <- rev(a).", "a@1 rev(a)@2") == "c@1-1 d@2-2"


def test_justification_alone_retracts_nothing() -> None:
    assert outputs_of("c <- a.", "a@1 rev(a)@2", flags=["etalis_justification"]) == "c@1-1"


IN_ORDER = ["recent", "recent_2", "chronological", "unrestricted"]


@pytest.mark.slow
@pytest.mark.parametrize("policy", IN_ORDER)
@pytest.mark.parametrize(
    ("rules", "stream", "expected"),
    [
        ("o <- ((a seq b) cnot c) seq d.", "a@1 c@2 b@3 d@4 rev(c)@5", "o@1-4"),
        ("o <- (a fnot c) seq d.", "c@1 a@3 d@4 rev(c)@5", "o@3-4"),
        ("o <- (a fnot c) forall_seq d.", "c@1 a@3 d@4 d@5 rev(c)@6", "o@3-4"),
        ("o <- ((a fnot c) seq d) seq b.", "c@1 a@3 d@4 b@5 rev(c)@6", "o@3-5"),
        ("o <- (a fnot c) seq (d fnot c).", "c@1 a@3 d@4 rev(c)@5", "o@3-4"),
        ("o(X) <- (a fnot c) seq (d(X) where X > 1).", "c@1 a@3 d(1)@4 d(2)@5 rev(c)@6", "o(2)@3-5"),
        ("o <- (a fnot c) seq (d star_times).", "c@1 a@3 d@4 d@5 rev(c)@6", "o@3-3 o@3-4 o@3-5"),
        (
            "o(N) <- (a fnot c) seq aggregate(sum(X), d(X), N).",
            "c@1 a@3 d(4)@4 rev(c)@6",
            "o(0)@3-3 o(4)@3-4",
        ),
        (
            "o(Y) <- s(Y) seq ((b fnot c(Y)) star_times).",
            "c(1)@1 s(1)@2 b@3 rev(c(1))@4",
            "o(1)@2-2 o(1)@2-3",
        ),
        # An event before a side that becomes valid again was late for it, and stays so.
        ("o <- (a fnot c) seq d.", "c@1 d@4 a@3 rev(c)@5", ""),
        ("o <- b seq (a fnot c).", "c@1 a@3 b@2 rev(c)@5", ""),
        ("o <- a seq ((d fnot c) star_times).", "c@1 d@3 a@2 rev(c)@5", "o@2-2"),
        # A partner of a match that holds is consumed; a partner that was retained is tried first.
        ("o <- (a fnot c) seq (d seq e).", "c@1 a@2 d@3 rev(c)@4 e@5", "o@2-5"),
    ],
)
def test_restored_side_of_sequence_has_partners(rules: str, stream: str, expected: str, policy: str) -> None:
    assert outputs_with_revision(rules, stream, policy) == expected


def test_consumed_second_side_is_not_reused() -> None:
    rules = "o(X) <- (a(X) fnot c(X)) seq d."
    assert outputs_with_revision(rules, "c(1)@1 a(1)@2 a(2)@3 d@4 rev(c(1))@5", "recent") == "o(2)@3-4"
    stream = "c(1)@1 a(1)@2 a(2)@3 d@4 d@5 rev(c(1))@6"
    assert outputs_with_revision(rules, stream, "recent") == "o(2)@3-4 o(1)@2-5"
    assert outputs_with_revision(rules, stream + " d@7", "recent") == "o(2)@3-4 o(1)@2-5"


def test_new_result_of_run_replaces_old_one() -> None:
    rules = "o(S) <- (s seq aggregate(max(V), a(V), S)) seq e."
    stream = "s@1 a(5)@2 a(2)@3 e@4 rev(a(5))@5"
    assert outputs_with_revision(rules, stream, "recent") == "o(5)@1-4 rev(o(5))@5-5 o(2)@1-4"
    assert (
        outputs_with_revision(rules, stream + " rev(a(2))@6", "recent")
        == "o(5)@1-4 rev(o(5))@5-5 o(2)@1-4 rev(o(2))@6-6"
    )


def test_second_sides_are_retained_only_if_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(consumption_policy, "MAX_RETAINED_MATCHES", 20)
    for rules, max_matches in [
        ("o <- a seq d.", 0),
        ("o <- a seq (d fnot c).", 0),
        ("o <- (a fnot c) seq d.", 20),
        ("o <- (a fnot c) seq (d star_times).", 20),
        ("o <- ((a fnot c) seq d) within 5.", 6),
    ]:
        program = ProgramRunner(rules, ["revision_flag"])
        program.feed(" ".join(f"d@{number}" for number in range(100)))
        assert program.engine.rules.match_count <= max_matches
        assert ProgramRunner(rules, ["etalis_justification"]).feed("d@1 d@2") == ""
