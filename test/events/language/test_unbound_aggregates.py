"""Errors in aggregates whose collected values are never bound."""

import pytest
from events.load_problems import errors_of, warnings_of


@pytest.mark.parametrize(
    ("aggregate", "part"),
    [
        ("aggregate(sum(Y), b(X), N)", "Y never gets a value: neither what sum collects"),
        ("aggregate(max(X + Y), b(X), N)", "Y never gets a value"),
        ("aggregate(avg(_), b(X), N)", "a variable never gets a value"),
        ("aggregate(min(foo), b(X), N)", "min needs numbers"),
        ('aggregate(min("b"), b(X), N)', "min needs numbers"),
        ("aggregate(sum(f(X)), b(X), N)", "sum needs numbers"),
        ("aggregate(sum(Y), b(X) cnot c(Y), N)", "Y never gets a value"),
    ],
)
def test_aggregate_without_values_is_refused(aggregate: str, part: str) -> None:
    (error,) = errors_of(f"out(N) <- a seq {aggregate}.")
    assert error[:2] == (1, 27)
    assert part in error[2]


@pytest.mark.parametrize("aggregate", ["max(foo)", 'min("b")', "quantile(0.5, f(X))", "[count, stddev(foo)]"])
def test_window_of_other_terms_is_refused(aggregate: str) -> None:
    (error,) = errors_of(f"out(N) <- aggregate({aggregate}, b(X), N, last(10)).")
    assert "needs numbers or arithmetic expressions" in error[2]


def test_later_condition_binds_no_collected_variable() -> None:
    ((_, column, _),) = errors_of("out(N) <- c(Y) and (a seq aggregate(sum(Y), b, N)) where Y > 1.")
    assert column == 37


@pytest.mark.parametrize(
    ("aggregate", "column", "part"),
    [
        ("aggregate(count, b(N), N)", 40, "N is both a collected value and the result of count"),
        ("aggregate(sum(N), b(N), N)", 41, "N is both a collected value and the result of sum"),
        ("aggregate(list(Y), b(X), N)", 27, "Y never gets a value"),
    ],
)
def test_suspicious_aggregate_is_reported(aggregate: str, column: int, part: str) -> None:
    ((_, actual_column, message),) = warnings_of(f"out(N) <- s seq {aggregate}.")
    assert part in message
    assert actual_column == column


@pytest.mark.parametrize(
    "rule",
    [
        "out(N) <- a(Y) seq aggregate(sum(Y), b, N).",
        "out(N) <- (a where Y = 3) seq aggregate(sum(Y * X), b(X), N).",
        "out(N) <- a seq aggregate(sum(Y), (b(X) where Y is X * 2), N).",
        "out(N) <- a seq aggregate(sum(1), b, N).",
        "out(N) <- a seq aggregate(sum(pi * abs(X)), b(X), N).",
        "out(N) <- a seq aggregate(list(f(X)), b(X), N).",
        "out <- limit(N) seq aggregate(count, hit, N).",
        "out <- limit(N) seq aggregate(count, hit(N), N).",
        "out <- a seq aggregate(count, hit, 3).",
    ],
)
def test_valid_aggregates_have_no_warnings(rule: str) -> None:
    assert warnings_of(rule) == []
