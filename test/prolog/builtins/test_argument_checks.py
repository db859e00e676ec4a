"""Wrong and partial arguments of built-ins."""

from typing import Any

import pytest
from prolog.goal_answers import answers, prolog

ERRORS = {
    "X is getbit(5, -1)": "domain_error(not_less_than_zero,-1)",
    "X is powm(2, 3, 0)": "domain_error(not_less_than_one,0)",
    "X is a + foo(1)": "type_error(evaluable,foo/1)",
    "X is rem(inf, 3)": "evaluation_error(float_overflow)",
    'format("~c", [-1])': "format_argument_type(c,-1)",
    'format("~s", [1])': "format_argument_type(s,1)",
    'format("~z", [a])': "existence_error(format_character,z)",
    "must_be(between(1, a), 3)": "type_error(integer,a)",
    "must_be(list(integer), a)": "type_error(list(integer),a)",
    "subtract([a|b], [], X)": "existence_error(matching_rule,lists:subtract(b,[],A))",
    "sum_list([1,2|b], X)": "existence_error(matching_rule,lists:sum_list(b,3,A))",
    "ord_union([a], b, X)": "existence_error(matching_rule,ordsets:union2(b,a,[],A))",
    "put_assoc(a, foo, 1, X)": "existence_error(matching_rule,assoc:insert(foo,a,1,A,B))",
    "get_assoc(a, foo, X)": "type_error(btree,foo)",
    "atom_codes(X, [0'a, b])": "type_error(character_code,b)",
    "memberchk(a, [b|c])": "type_error(list,c)",
    "sort(2, @<, [f(x)], X)": "existence_error(argument,2,f(x))",
    "upcase_atom(a, f(x))": "type_error(atom,f(x))",
    "char_type(a, foo)": "type_error(char_type,foo)",
    "aggregate_all(foo, true, X)": "domain_error(aggregate_template,foo)",
    "'$arg'(a, f(x), X)": "type_error(integer,a)",
    "stamp_date_time(1.0Inf, X, 'UTC')": "domain_error(time_stamp,1.0Inf)",
    "date_time_stamp(date(2000.5,1,1,0,0,0,0,-,-), X)": "type_error(integer,2000.5)",
    "'$within'(true, a, X)": "type_error(inference_limit,a)",
    "'$within'(true, '$inference_limit'(a), X)": "type_error(integer,a)",
}


@pytest.mark.parametrize("goal", ERRORS)
def test_wrong_argument_is_an_error(goal: str) -> None:
    assert answers(prolog(), goal) == [ERRORS[goal]]


ANSWERS = {
    "nth0(I, [a|T], x)": [{"I": "1", "T": "[x|A]"}, {"I": "2", "T": "[A,x|B]"}],
    "sort([X, Y, X], L)": [{"X": "A", "Y": "A", "L": "[A,B]"}],
    "string_code(I, ab, C)": [{"I": "1", "C": "97"}, {"I": "2", "C": "98"}],
    "aggregate_all(r(count, max(X)), member(X, [1,3,2]), R)": [{"X": "A", "R": "r(3,3)"}],
    "list_to_assoc([b-1, a-2], A), is_assoc(A)": [{"A": "t(b,1,<,t(a,2,-,t,t),t)"}],
    "ord_subtract([a|T], [a], R)": [{"T": "A", "R": "A"}],
    'format(codes(Cs, T), "~w", [a])': [{"Cs": "[97|A]", "T": "A"}],
    "month_days(2, 200000, D)": [{"D": "29"}],
    "month_days(11, 0, D)": [{"D": "30"}],
}


@pytest.mark.parametrize("goal", ANSWERS)
def test_partial_argument_is_completed(goal: str) -> None:
    assert answers(prolog(), goal, len(ANSWERS[goal])) == ANSWERS[goal]


def test_index_is_no_tail_of_its_list() -> None:
    """A list whose tail is the index cannot be a list, since the index is a number."""
    logic = prolog()
    assert answers(logic, "nth0(X, X, a)") == []
    assert answers(logic, "nth1(I, [a|I], z)") == []
    assert answers(logic, "nth1(I, [a|I], E)") == [{"I": "1", "E": "a"}]
    assert answers(logic, "nth0(X, X, a, R)") == []
    assert answers(logic, "nth1(I, [a|I], z, R)") == []
    assert answers(logic, "nth0(I, [I, b|T], E, [1|R])", 4) == [{"I": "1", "T": "A", "E": "b", "R": "A"}]


def test_integers_and_floats_compare_exactly() -> None:
    """Numbers are compared without rounding; 2**53 + 1 and 10**30 + 1 are not representable as floats."""
    logic = prolog("test(A, B) :- A > B.")
    for whole, near in (
        ("9007199254740993", "9007199254740992.0"),
        ("-9007199254740991", "-9007199254740992.0"),
    ):
        assert answers(logic, f"{whole} > {near}, test({whole}, {near})") == [{}]
        assert (
            answers(logic, f"X = {whole}, Y = {near}, X > Y, Y < X, X =\\= Y, \\+ X =:= Y, R = yes")[0]["R"]
            == "yes"
        )
        assert answers(logic, f"compare(O, {whole}, {near})") == [{"O": ">"}]
        assert answers(logic, f"msort([{whole}, {near}], [_, {whole}])") == [{}]
        assert answers(logic, f"{whole} is max({whole}, {near}), {near} is min({whole}, {near})") == [{}]
    assert answers(logic, "X is 10 ** 30 + 1, Y is 1.0e30, X < Y, compare(<, X, Y), R = yes")[0]["R"] == "yes"


@pytest.mark.parametrize(
    ("goal", "expected"),
    [
        ("must_be(encoding, utf8)", [{}]),
        ("must_be(encoding, foo)", ["type_error(encoding,foo)"]),
        ("must_be(stream, user_output)", [{}]),
        ("must_be(stream, a)", ["type_error(stream,a)"]),
        ("must_be(dict, a)", ["type_error(dict,a)"]),
        ("must_be(list_of, [a])", ["existence_error(type,list_of)"]),
        ("must_be(list(a, b), [a])", ["existence_error(type,list(a,b))"]),
        ("must_be(stream, _)", ["instantiation_error"]),
    ],
)
def test_must_be_accepts_unusual_types(goal: str, expected: Any) -> None:
    assert answers(prolog(), goal) == expected
