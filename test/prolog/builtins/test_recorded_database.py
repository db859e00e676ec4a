"""The recorded database."""

import pytest
from prolog.support import answers, first, prolog

from retalis.prolog.builtins import recorded_database


@pytest.fixture
def logic():
    return prolog()


def test_records_stand_in_order(logic):
    assert first(logic, "recordz(k, b), recordz(k, c), recorda(k, a), findall(X, recorded(k, X), L)") == {
        "X": "A",
        "L": "[a,b,c]",
    }


@pytest.mark.parametrize(
    ("goal", "count"),
    [
        ("recordz(f(1), a), recorded(f(2), _)", 1),
        ("recordz(f(1), a), recorded(f(1, 2), _)", 0),
        ("recordz(1, a), recorded(1, _)", 1),
        ("recordz(1, a), recorded(1.0, _)", 0),
        ("recordz(1.5, a), recorded(1.5, _)", 1),
        ('recordz("s", a), recorded("s", _)', 1),
        ("recordz(k, a), recordz(l, b), recorded(_, _)", 2),
        ("recordz(k, a, _R), erase(_R), recorded(k, _)", 0),
        ("recordz(k, a, _R), recordz(k, b), recorded(_, _, _R)", 1),
        ("recordz(k, a, _R), erase(_R), instance(_R, _)", 0),
        ("recordz(k, f(_X)), recorded(k, f(1)), recorded(k, f(2))", 1),
        ("recordz(k, a), recordz(k(1), a), current_key(_)", 2),
    ],
)
def test_records_are_found_by_key(logic, goal, count):
    assert len(answers(logic, goal)) == count


@pytest.mark.parametrize(
    ("goal", "error"),
    [
        ("recorda(_, a)", "instantiation_error"),
        ("recordz(k, a, r)", "uninstantiation_error(r)"),
        ("erase(_)", "instantiation_error"),
        ("erase(r)", "type_error(db_reference,r)"),
        ("recorda(k, a, _R), erase(_R), erase(_R)", "existence_error(db_reference,'$record'(1))"),
        ("recorded(k, _, r)", "type_error(db_reference,r)"),
    ],
)
def test_errors(logic, goal, error):
    assert answers(logic, goal) == [error]


def test_who_enumerates_does_not_see_what_is_added_or_erased_meanwhile(logic):
    goal = "recordz(k, 1), recordz(k, 2), findall(X, (recorded(k, X), recordz(k, 3)), L)"
    assert first(logic, goal) == {"X": "A", "L": "[1,2]"}
    goal = "recordz(m, 1), recordz(m, 2, R), findall(X, (recorded(m, X), (X =:= 1 -> erase(R) ; true)), L)"
    assert first(logic, goal)["L"] == "[1,2]"
    assert first(logic, "findall(X, recorded(m, X), L)") == {"X": "A", "L": "[1]"}


def test_keys_whose_records_are_erased_are_gone(logic):
    assert first(logic, "recordz(k, 1), recordz(k, 2), forall(recorded(k, _, R), erase(R))") is not None
    assert answers(logic, "recorded(_, _)") == []
    assert answers(logic, "current_key(_)") == []
    goal = "recorda(k, 1, A), recordz(k, 2, B), recorda(k, 0), erase(A), erase(B), recordz(k, 3)"
    assert first(logic, f"{goal}, findall(X, recorded(k, X), L)")["L"] == "[0,3]"


@pytest.mark.parametrize("add", ["recorda", "recordz"])
def test_a_record_is_added_found_and_erased_without_walking_over_the_others(logic, monkeypatch, add):
    looked = []

    class Noting(recorded_database.RecordedTerm):
        @property
        def number(self):
            looked.append(self)
            return self.own

        @number.setter
        def number(self, value):
            self.own = value

    monkeypatch.setattr(recorded_database, "RecordedTerm", Noting)
    found = []
    for size in (10, 1000):
        assert first(logic, f"forall(between(1, {size}, N), {add}(k, N))") is not None
        looked.clear()
        assert first(logic, f"{add}(k, x, R), once(recorded(k, _)), erase(R)") is not None
        found.append(len(looked))
    assert found[0] == found[1]
