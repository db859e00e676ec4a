"""Errors in aggregates that collect nothing."""

import pytest
from events.load_messages import errors_of, warnings_of


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
def test_refused(aggregate, part):
    (found,) = errors_of(f"out(N) <- a seq {aggregate}.")
    assert found[:2] == (1, 27)
    assert part in found[2]


@pytest.mark.parametrize("kind", ["max(foo)", 'min("b")', "quantile(0.5, f(X))", "[count, stddev(foo)]"])
def test_a_window_of_what_is_never_a_number_is_refused(kind):
    (found,) = errors_of(f"out(N) <- aggregate({kind}, b(X), N, last(10)).")
    assert "needs numbers or arithmetic expressions" in found[2]


def test_what_comes_later_gives_no_value():
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
def test_warned_of(aggregate, column, part):
    ((_, at, message),) = warnings_of(f"out(N) <- s seq {aggregate}.")
    assert part in message
    assert at == column


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
def test_what_may_be_meant_is_not_warned_of(rule):
    assert warnings_of(rule) == []
