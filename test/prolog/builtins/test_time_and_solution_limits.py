"""Limits of the time and of the solutions of goals."""

from prolog.goal_answers import answers, prolog


def test_time_limit_ends_goal_and_its_alarm() -> None:
    logic = prolog()
    assert answers(logic, "call_with_time_limit(0.02, (repeat, fail))") == ["time_limit_exceeded"]
    assert answers(logic, "call_with_time_limit(5, member(X, [1,2]))") == [{"X": "1"}]
    assert logic.machine.budget.alarms == [] == logic.machine.choices


def test_solutions_are_limited() -> None:
    logic = prolog()
    assert [answer["X"] for answer in answers(logic, "limit(2, member(X, [a,b,c]))")] == ["a", "b"]
    assert [answer["X"] for answer in answers(logic, "offset(1, member(X, [a,b,c]))")] == ["b", "c"]
    assert answers(logic, "call_nth(member(X, [a,b,c]), 2)") == [{"X": "b"}]
