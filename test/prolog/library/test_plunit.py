"""Tests of programs: units, what their options expect, and what is reported."""

import pytest
from prolog.support import answers, prolog

UNITS = """
:- begin_tests(passing).
test(add) :- X is 1 + 2, X =:= 3.
test(equal, X == 3) :- X is 1 + 2.
test(no, fail) :- 1 =:= 2.
test(wrong, error(type_error(_, _))) :- atom_length(f(x), _).
test(ball, throws(mine)) :- throw(mine).
test(several, all(X == [1, 2])) :- member(X, [1, 2]).
test(same, set(X == [1, 2])) :- member(X, [2, 1, 2]).
test(many, nondet) :- member(_, [1, 2]).
test(each, [forall(member(X, [1, 2])), true(Y =:= X * 2)]) :- Y is X + X.
test(around, [setup(nb_setval(k, 1)), cleanup(nb_setval(k, 2)), X == 1]) :- nb_getval(k, X).
test(later, blocked(why)) :- fail.
test(never, condition(fail)) :- fail.
:- end_tests(passing).
:- begin_tests(failing, [setup(nb_setval(q, 1))]).
test(equal, X == 4) :- X is 1 + 2.
test(no, fail).
test(plain) :- fail.
test(ball, throws(mine)) :- throw(other).
test(raised) :- throw(oops).
test(several, all(X == [1, 3])) :- member(X, [1, 2]).
:- end_tests(failing).
:- begin_tests(open).
test(choice) :- member(_, [1, 2]).
:- end_tests(open).
"""


@pytest.fixture
def tested():
    logic = prolog(UNITS, 1 << 60)  # what runs once is not worth compiling
    written = []
    logic.error_output = written.append

    def run(goal):
        found = bool(answers(logic, goal))
        text = "".join(written)
        written.clear()
        return found, text

    return run


def test_a_unit_that_passes(tested):
    found, text = tested("run_tests(passing)")
    assert found
    assert text == "% PL-Unit: passing ........... passed\n% 1 tests are blocked\n% All 11 tests passed\n"


def test_what_fails_is_named_with_its_line(tested):
    found, text = tested("run_tests(failing)")
    assert not found
    assert text.endswith("% 6 tests failed\n% 0 tests passed\n")
    for line in (
        "ERROR: program.pl:17:\n\ttest equal: wrong answer: 3==4 does not hold",
        "ERROR: program.pl:18:\n\ttest no: must fail, but succeeded",
        "ERROR: program.pl:19:\n\ttest plain: failed",
        "ERROR: program.pl:20:\n\ttest ball: must raise mine, but raised other",
        "ERROR: program.pl:21:\n\ttest raised: raised oops",
        "ERROR: program.pl:22:\n\ttest several: expected the solutions [1,3], found [1,2]",
    ):
        assert line in text


def test_choice_points_are_a_warning(tested):
    found, text = tested("run_tests(open)")
    assert found
    assert "Warning: program.pl:25:\n\ttest choice: succeeded with choicepoint" in text


def test_one_test_of_a_unit(tested):
    assert tested("run_tests(passing:add)") == (True, "% PL-Unit: passing:add . passed\n% test passed\n")


def test_all_units(tested):
    found, text = tested("run_tests")
    assert not found
    assert "% 6 tests failed\n% 12 tests passed\n" in text


def test_units_end_as_they_begin():
    logic = prolog()
    assert answers(logic, "end_tests(u)") == ["context_error(end_tests,u)"]
    assert answers(logic, "begin_tests(u), begin_tests(v)") == ["permission_error(begin,test_unit,v)"]
    assert answers(logic, "run_tests(w)") == ["existence_error(unit_test,w)"]


def test_a_unit_that_is_read_again_takes_the_place_of_the_first():
    logic = prolog(":- begin_tests(u). test(a) :- fail. :- end_tests(u). :- begin_tests(u). :- end_tests(u).")
    logic.error_output = lambda text: None
    assert answers(logic, "run_tests") == [{}]
