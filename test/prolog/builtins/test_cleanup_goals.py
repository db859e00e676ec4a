"""Cleanup of goals after their last answer, an error or failure."""

from prolog.goal_answers import answers, first, prolog


def test_cleanup_runs_after_last_answer_error_and_failure() -> None:
    logic = prolog()
    assert answers(
        logic, "setup_call_cleanup(true, member(X, [1,2]), nb_setval(c, X)), X = 2, nb_getval(c, V)"
    ) == [{"X": "2", "V": "2"}]
    assert (
        first(logic, "catch(setup_call_cleanup(true, throw(x), nb_setval(d, 1)), x, true), nb_getval(d, V)")
        == "1"
    )
    assert answers(logic, "\\+ call_cleanup(fail, nb_setval(e, 1)), nb_getval(e, V)") == [{"V": "1"}]
