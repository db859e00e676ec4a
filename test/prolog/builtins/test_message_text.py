"""Predicate ``message_text/2``: texts of messages with and without double quotes inside."""

import pytest

from retalis import Engine, atom


@pytest.mark.parametrize(
    ("goal", "variable", "expected"),
    [
        ("message_text('\"hall\"', T)", "T", "hall"),
        ("message_text('\"\"', T)", "T", ""),
        ('message_text(\'"a"b"\', T)', "T", 'a"b'),
        ("message_text(Q, hall)", "Q", '"hall"'),
        ('message_text(Q, "two words")', "Q", '"two words"'),
        ("message_text(Q, 12)", "Q", '"12"'),
    ],
)
def test_text_is_converted(goal: str, variable: str, expected: str) -> None:
    (answer,) = Engine().query(goal)
    assert answer[variable] is atom(expected)


@pytest.mark.parametrize(
    ("goal", "holds"),
    [
        ("message_text('\"hall\"', hall)", True),
        ('message_text(\'"hall"\', "hall")', True),
        ("message_text('\"hall\"', kitchen)", False),
        ("catch(message_text(hall, _), error(type_error(message_text, hall), _), true)", True),
        ("catch(message_text('\"', _), error(type_error(message_text, '\"'), _), true)", True),
        ("catch(message_text(_, _), error(instantiation_error, _), true)", True),
        ("catch(message_text(_, f(x)), error(type_error(_, _), _), true)", True),
    ],
)
def test_bound_texts_are_compared(goal: str, holds: bool) -> None:
    assert bool(Engine().query(goal)) is holds
