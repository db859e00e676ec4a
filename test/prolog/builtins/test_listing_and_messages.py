"""Listing of clauses, and messages."""

import logging
from typing import Any, List

import pytest
from prolog.goal_answers import answers, first, prolog

from retalis.prolog.builtins.listing_and_messages import MAX_LOGGED_CHARACTERS

PROGRAM = r"""
laid(X) :- ( X > 1 -> foo, bar ; X = 2, \+ baz -> true ; qux ).
"""


def test_listing_lays_out_clauses() -> None:
    logic = prolog(PROGRAM)
    written: List[Any] = []
    logic.output = written.append
    assert answers(logic, "listing(laid/1), portray_clause(foo(_, X, X))") == [{"X": "A"}]
    assert "".join(written) == (
        "laid(A) :-\n    (   A>1\n    ->  foo,\n        bar\n    ;   A=2,\n        \\+ baz\n    ->  true\n"
        "    ;   qux\n    ).\n\nfoo(_, A, A).\n"
    )


def test_negated_conjunction_is_in_parentheses() -> None:
    logic = prolog()
    written: List[Any] = []
    logic.output = written.append
    assert answers(logic, "portray_clause((p :- \\+ (a, b), c))") == [{}]
    assert "".join(written) == "p :-\n    \\+ (   a,\n        b\n    ),\n    c.\n"


def test_tabled_predicates_are_listed() -> None:
    logic = prolog(
        ":- table path/2.\npath(X, Y) :- edge(X, Y).\npath(X, Y) :- path(X, Z), edge(Z, Y).\nedge(1, 2)."
    )
    written: List[Any] = []
    logic.output = written.append
    clauses = "path(A, B) :-\n    edge(A, B).\npath(A, B) :-\n    path(A, C),\n    edge(C, B).\n\n"
    assert answers(logic, "listing(path/2)")
    assert "".join(written) == f":- table path/2.\n\n{clauses}"
    written.clear()
    assert answers(logic, "listing")
    assert "".join(written).count("path(A, B) :-") == 2
    assert answers(logic, "predicate_property(path(_, _), number_of_clauses(N))") == [{"N": "2"}]
    assert first(logic, "nth_clause(path(_, _), 2, (H :- _)), H = path(A, A)") == {"H": "path(A,A)", "A": "A"}


def test_messages_are_sent_by_kind(monkeypatch: pytest.MonkeyPatch) -> None:
    logic = prolog()
    messages: List[Any] = []
    monkeypatch.setattr(logic, "message", lambda kind, text: messages.append((kind, text)))
    assert answers(logic, 'print_message(warning, format("low: ~w", [3])), print_message(silent, x)') == [{}]
    assert messages == [("warning", "Warning: low: 3\n")]
    assert answers(logic, "assertion(1 > 2)") == ["assertion_error(fail,user:(1>2))"]


@pytest.mark.parametrize(
    ("name", "level"),
    [
        ("log_debug", logging.DEBUG),
        ("log_info", logging.INFO),
        ("log_warn", logging.WARNING),
        ("log_error", logging.ERROR),
    ],
)
def test_goal_logs_with_level(name: str, level: int, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.DEBUG, "retalis.goals")
    assert answers(prolog(), f"{name}('~w %d at ~1f', [room, 2.5])") == [{}]
    assert caplog.record_tuples == [("retalis.goals", level, "room %d at 2.5")]


def test_long_logged_text_is_shortened(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "retalis.goals")
    assert answers(prolog(), "log_info('~*c', [10000, 0'x])") == [{}]
    assert caplog.messages == ["x" * MAX_LOGGED_CHARACTERS + "..."]
