"""Windows of rules and patterns: matches beyond them, and removal of old partial matches."""

import pytest
from events.program_runner import ProgramRunner, outputs_of


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
