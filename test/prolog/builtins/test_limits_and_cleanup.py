"""Limits of the time and the solutions of goals, with their cleanup."""

from prolog.support import answers, first, prolog


def test_cleanup_and_limits_of_solutions_hold() -> None:
    logic = prolog()
    assert answers(
        logic, "setup_call_cleanup(true, member(X, [1,2]), nb_setval(c, X)), X = 2, nb_getval(c, V)"
    ) == [{"X": "2", "V": "2"}]
    assert (
        first(logic, "catch(setup_call_cleanup(true, throw(x), nb_setval(d, 1)), x, true), nb_getval(d, V)")
        == "1"
    )
    assert answers(logic, "\\+ call_cleanup(fail, nb_setval(e, 1)), nb_getval(e, V)") == [{"V": "1"}]
    assert answers(logic, "call_with_time_limit(0.02, (repeat, fail))") == ["time_limit_exceeded"]
    assert answers(logic, "call_with_time_limit(5, member(X, [1,2]))") == [{"X": "1"}]
    assert logic.machine.budget.alarms == [] == logic.machine.choices
    assert [answer["X"] for answer in answers(logic, "limit(2, member(X, [a,b,c]))")] == ["a", "b"]
    assert [answer["X"] for answer in answers(logic, "offset(1, member(X, [a,b,c]))")] == ["b", "c"]
    assert answers(logic, "call_nth(member(X, [a,b,c]), 2)") == [{"X": "b"}]
