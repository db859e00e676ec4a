"""Undefined predicates, which are kept only as long as something refers to them."""

from prolog.support import answers, prolog


def test_a_predicate_that_is_defined_after_it_was_put_aside_is_the_one_that_clauses_call():
    logic = prolog("p :- foo, true.")
    for _ in range(300):
        assert (
            answers(logic, "catch(p, error(existence_error(_, _), _), R = undefined)")[0]["R"] == "undefined"
        )
    logic.database.demote_undefined()
    assert answers(logic, "assertz(foo), p, R = defined")[0]["R"] == "defined"
