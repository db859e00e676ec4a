"""Built-ins without recorded answers of SWI-Prolog: grammars, tables, timestamps, poses, messages."""

import math
import random
from typing import Any, List

import pytest
from prolog.support import answers, first, prolog

PROGRAM = r"""
:- table path/2, conn/2, fib/2.
edge(a,b). edge(b,c). edge(c,a). edge(c,d).
path(X,Y) :- path(X,Z), edge(Z,Y).
path(X,Y) :- edge(X,Y).
conn(X,Y) :- conn(Y,X).
conn(X,Y) :- edge(X,Y).
fib(0,0). fib(1,1).
fib(N,F) :- N > 1, A is N-1, B is N-2, fib(A,X), fib(B,Y), F is X+Y.
:- table even/1, odd/1.
even(0). even(N) :- odd(M), M < 10, N is M+1.
odd(N) :- even(M), M < 10, N is M+1.
:- table broken/1.
broken(X) :- broken(Y), X is Y + foo.
broken(1).
greeting --> [hello], name_of(_), !, {true}.
name_of(world) --> [world].
anbn --> [].
anbn --> [a], anbn, [b].
digits([D|T]) --> digit(D), digits(T).
digits([D]) --> digit(D).
digit(D) --> [D], { code_type(D, digit) }.
laid(X) :- ( X > 1 -> foo, bar ; X = 2, \+ baz -> true ; qux ).
"""


def test_tabled_predicates_have_all_answers() -> None:
    logic = prolog(PROGRAM)
    assert sorted(answer["X"] for answer in answers(logic, "path(a, X)")) == ["a", "b", "c", "d"]
    assert sorted(answer["X"] for answer in answers(logic, "path(X, d)")) == ["a", "b", "c"]
    assert sorted(answer["X"] for answer in answers(logic, "conn(b, X)")) == ["a", "c"]
    assert first(logic, "fib(100, F)") == "354224848179261915075"
    assert [answer["X"] for answer in answers(logic, "even(X)")] == ["0", "2", "4", "6", "8", "10"]
    assert answers(logic, "broken(X)") == ["type_error(evaluable,foo/0)"]
    assert answers(logic, "broken(X)") == ["type_error(evaluable,foo/0)"]
    assert logic.state["tables"].active == []
    assert answers(logic, "assertz(edge(d, e)), path(a, X), X == e") == []
    assert answers(logic, "abolish_all_tables, path(a, X), X == e") == [{"X": "e"}]


def test_phrase_parses_lists() -> None:
    logic = prolog(PROGRAM)
    assert answers(logic, "phrase(greeting, [hello,world])") == [{}]
    assert answers(logic, "phrase(greeting, [hello,moon])") == []
    assert answers(logic, "phrase(anbn, [a,a,b,b])") == [{}]
    assert first(logic, "phrase(digits(_), `12a`, R)") == "[97]"
    assert answers(logic, "phrase(anbn, x)") == ["type_error(list,x)"]
    assert answers(logic, "phrase(_, [])") == ["instantiation_error"]
    assert answers(logic, 'phrase(("ab", \\+ [0\'d], [X]), `abc`)') == [{"X": "99"}]


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


def test_capture_of_output_ends_with_its_goal() -> None:
    logic = prolog()
    written: List[Any] = []
    logic.output = written.append
    assert first(logic, "with_output_to(string(S), (write(a), print('B c')))") == "\"a'B c'\""
    assert answers(logic, "catch(with_output_to(string(_), throw(x)), x, true), write(hi)") == [{}]
    assert answers(logic, "with_output_to(atom(_), fail)") == []
    assert answers(logic, "write(ho)") == [{}]
    assert "".join(written) == "hiho"


FORMATS = [
    (
        "~w and ~q: ~d ~2f ~e ~a",
        "[f(x),'A b',12,3.14159,2.5,abc]",
        "f(x) and 'A b': 12 3.14 2.500000e+00 abc",
    ),
    ("~t~w~10||~w~t~10+|", "[right,left]", "     right|left     |"),
    ("~`-t~30|", "[]", "-" * 30),
    ("~t~d~6|~t~d~12|", "[1,22]", "     1    22"),
    ("~t~s~t~11|", "[[0'a,0'b,0'c]]", "    abc    "),
    ("~D ~2d ~8r ~16R ~c~c", "[1234567,314,64,255,104,105]", "1,234,567 3.14 100 FF hi"),
    ("~*c~i~w~~", "[3,0'x,skipped,y]", "xxxy~"),
]


@pytest.mark.parametrize(("form", "arguments", "text"), FORMATS)
def test_format_directives_are_expanded(form: Any, arguments: Any, text: Any) -> None:
    result = first(prolog(), f'format(atom(A), "{form}", {arguments})')
    assert result.strip("'").replace("\\'", "'") == text


def test_listing_lays_out_clauses() -> None:
    logic = prolog(PROGRAM)
    written: List[Any] = []
    logic.output = written.append
    assert answers(logic, "listing(laid/1), portray_clause(foo(_, X, X))") == [{"X": "A"}]
    assert "".join(written) == (
        "laid(A) :-\n    (   A>1\n    ->  foo,\n        bar\n    ;   A=2,\n        \\+ baz\n    ->  true\n"
        "    ;   qux\n    ).\n\nfoo(_, A, A).\n"
    )


def test_negated_conjunction_is_in_parentheses() -> None:
    logic = prolog()
    written: List[Any] = []
    logic.output = written.append
    assert answers(logic, "portray_clause((p :- \\+ (a, b), c))") == [{}]
    assert "".join(written) == "p :-\n    \\+ (   a,\n        b\n    ),\n    c.\n"


def test_messages_are_sent_by_kind() -> None:
    logic = prolog()
    messages: List[Any] = []
    logic.message = lambda kind, text: messages.append((kind, text))
    assert answers(logic, 'print_message(warning, format("low: ~w", [3])), print_message(silent, x)') == [{}]
    assert messages == [("warning", "Warning: low: 3\n")]
    assert answers(logic, "assertion(1 > 2)") == ["assertion_error(fail,user:(1>2))"]


TIMESTAMPS = [
    ("convert_to_datime([10,5], X)", "datime(1970,1,1,0,0,10.0,5)"),
    (
        "datime_interpolate(datime(2001,1,1,23,59,58,0),datime(2001,1,2,0,0,2,0),datime(2001,1,2,0,0,0,0),X)",
        "0.5",
    ),
    ("datime_interpolate(3, 3, 3, X)", "1"),
    ("datime_minus_datime(datime(2001,1,1,0,0,10),datime(2001,1,1,0,0,4),X)", "6"),
    ("datime_minus_datime(datime(2001,1,2,1,0,0,0),datime(2001,1,1,0,0,0,0),X)", "90000.0"),
    ("datime_minus_datime(datime(2001,3,1,0,0,0),datime(2001,2,28,0,0,0),X)", "86400"),
    ("datime_minus_datime(7,2.5,X)", "4.5"),
    ("datime_minus_datime(datime(2001,1,1,0,0,10),datime(2001,1,1,0,0,4,0),X)", "6.0"),
    ("datime_minus_datime([5,1],datime(1970,1,1,0,0,5,0),X)", "1.0e-9"),
    ("datime_minus_datime(datime(2026,11,22,0,0,0.0,300000000),datime(2026,11,22,0,0,0,200000000),X)", "0.1"),
    ("datime_plus_sec(datime(2001,2,28,23,59,59),1,X)", "datime(2001,3,1,0,0,0)"),
    ("datime_plus_sec(datime(2001,1,1,0,0,59),0.5,X)", "datime(2001,1,1,0,0,59.5)"),
    ("datime_plus_sec(datime(2001,1,1,0,0,10),-15,X)", "datime(2000,12,31,23,59,55)"),
    ("datime_minus_sec(datime(2001,3,1,0,0,0),1,X)", "datime(2001,2,28,23,59,59)"),
    ("datime_plus_sec(datime(2026,12,31,23,59,59,900000000),0.2,X)", "datime(2027,1,1,0,0,0,100000000)"),
    ("datime_plus_sec(datime(2026,12,31,23,59,59.0,900000000),0.2,X)", "datime(2027,1,1,0,0,0.0,100000000)"),
    ("datime_minus_sec(datime(2027,1,1,0,0,0,100000000),0.2,X)", "datime(2026,12,31,23,59,59,900000000)"),
    ("datime_plus_sec([5,900000000],0.2,X)", "[6,100000000]"),
    ("datime_plus_sec(5,2,X)", "7"),
    ("datime_minus_sec(5.5,2,X)", "3.5"),
    ("datime_plus_sec(datime(9999,12,31,23,59,59,0),1,X)", "evaluation_error(undefined)"),
    ("datime_plus_sec(foo,1,X)", "type_error(datime,foo)"),
    ("datime_plus_sec(1,foo,X)", "type_error(number,foo)"),
    ("addSec_Datime(5,datime(2001,1,1,0,0,10),X)", "datime(2001,1,1,0,0,15)"),
    ("month_days(2, 2000, X)", "29"),
    ("absoluteTime(datime(2001,1,1,1,0,5,0), X)", "3605"),
    ("stamp_date_time(0, X, 'UTC')", "date(1970,1,1,0,0,0.0,0,'UTC',-)"),
    ("date_time_stamp(date(2001,2,3,4,5,6.5,0,-,-), X)", "981173106.5"),
    ("parse_time('2001-02-03T04:05:06+01:00', X)", "981169506.0"),
    ("format_time(atom(X), '%Y-%m-%d %H:%M:%S.%3f', 1.5)", "'1970-01-01 00:00:01.500'"),
    ("convert_to_datime(x, X)", "type_error('[Sec,NSec]',x)"),
    ("datime_interpolate([1,0], [2,0], datime(1970,1,1,0,0,1,500000000), X)", "0.5"),
    ("datime_interpolate(a, 1, 2, X)", "type_error(datime,a)"),
    ("datime_interpolate([1,b], 1, 2, X)", "type_error(datime,[1,b])"),
]


@pytest.mark.parametrize(("goal", "value"), TIMESTAMPS)
def test_timestamp_predicate_has_value(goal: Any, value: Any) -> None:
    assert first(prolog(), goal) == value


def test_timestamps_compare_by_instant() -> None:
    logic = prolog()
    assert answers(logic, "less_datime(datime(2001,1,1,0,0,1), datime(2001,1,1,0,0,2,0))") == [{}]
    assert answers(logic, "equal_datime(datime(1970,1,1,0,0,1.5,0), 1.5)") == [{}]
    assert answers(logic, "between_datime(datime(2001,1,1,0,0,1,0),datime(2001,1,1,0,0,1,0),3)") == []
    assert answers(logic, "between_datime(1, 1, 3)") == [{}]


def quaternion_about(axis: Any, angle: float) -> Any:
    size = math.sqrt(sum(value * value for value in axis))
    return [value / size * math.sin(angle / 2) for value in axis] + [math.cos(angle / 2)]


def rotation(q: Any) -> List[List[Any]]:
    x, y, z, w = q
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]


def numbers(text: str) -> Any:
    return eval(text)  # a list of lists of floats, as Python writes it too


def test_pose_product_rotates_second_translation() -> None:
    rng = random.Random(1)
    logic = prolog()
    for _ in range(20):
        v1, v2 = ([rng.uniform(-1, 1) for _ in range(3)] for _ in range(2))
        q1, q2 = (
            quaternion_about([rng.uniform(-1, 1) for _ in range(3)], rng.uniform(0, 6)) for _ in range(2)
        )
        position, quaternion = numbers(first(logic, f"mul_quaternion({v1},{q1},{v2},{q2},X)"))
        expected = [a + sum(r * b for r, b in zip(row, v2)) for a, row in zip(v1, rotation(q1))]
        assert position == pytest.approx(expected)
        chained = numbers(first(logic, f"transform_quaternion([[{v1},{q1}],[{v2},{q2}]],X)"))
        assert chained == [position, quaternion]
        tag, matrix = numbers(
            first(logic, f"transform([['Q',[{v1},{q1}]],[{v2},{q2}]],X)").replace("'M'", "0")
        )
        assert tag == 0
        assert [row[3] for row in matrix[:3]] == pytest.approx(position)
        moved = numbers(first(logic, f"tf_point({v1},['Q',[{position},{quaternion}]],X)"))
        assert moved == pytest.approx(numbers(first(logic, f"transform_point({v1},{matrix},X)")))


def test_interpolation_of_poses_is_spherical() -> None:
    logic = prolog()
    axis = [1, 2, 3]
    for fraction in (0, 0.25, 0.5, 1):
        q1, q2 = quaternion_about(axis, 0.2), [-value for value in quaternion_about(axis, 1.2)]
        position, quaternion = numbers(
            first(logic, f"interpolate_quaternion([0,0,0],{q1},[4,8,12],{q2},[{fraction}],X)")
        )
        assert position == pytest.approx([4 * (1 - fraction), 8 * (1 - fraction), 12 * (1 - fraction)])
        assert quaternion == pytest.approx(quaternion_about(axis, 0.2 + (1 - fraction)))
    q = quaternion_about(axis, 0.3)
    assert numbers(first(logic, f"interpolate_quaternion([1,1,1],{q},[1,1,1],{q},[0.3],X)"))[1] == q


@pytest.mark.parametrize("angle", [1e-12, 1e-9, 1e-8, 2e-8, 1e-7, 1e-5, 1e-3, 3.0, 3.14159])
def test_interpolation_is_exact_for_any_angle(angle: float) -> None:
    q1, q2 = quaternion_about([1, -2, 0.5], 0.2), quaternion_about([1, -2, 0.5], 0.2 + angle)
    goal = f"interpolate_quaternion([0,0,0],{q1},[0,0,0],{q2},[0.25],X)"
    expected = quaternion_about([1, -2, 0.5], 0.2 + 0.75 * angle)
    assert numbers(first(prolog(), goal))[1] == pytest.approx(expected, abs=3e-16)


@pytest.mark.parametrize(
    ("goal", "error"),
    [
        ("transform_quaternion([[a]], X)", "type_error(pose,[a])"),
        ("transform_quaternion(_, X)", "instantiation_error"),
        ("mul_quaternion([1,2], [0,0,0,1], [0,0,0], [0,0,0,1], X)", "type_error(position,[1,2])"),
        ("mul_quaternion([1,2,a], [0,0,0,1], [0,0,0], [0,0,0,1], X)", "type_error(number,a)"),
        ("mul_quaternion([1,2,3], [0,0,0,0], [0,0,0], [0,0,0,1], X)", "domain_error(quaternion,[0,0,0,0])"),
        ("tf_point([0,0,0], ['X',1], X)", "domain_error(transform,['X',1])"),
    ],
)
def test_malformed_pose_is_an_error(goal: str, error: str) -> None:
    assert answers(prolog(), goal) == [error]


def test_empty_pose_product_is_identity() -> None:
    assert first(prolog(), "transform_quaternion([], X)") == "[[0.0,0.0,0.0],[0.0,0.0,0.0,1.0]]"


def test_tabled_predicates_are_listed() -> None:
    logic = prolog(
        ":- table path/2.\npath(X, Y) :- edge(X, Y).\npath(X, Y) :- path(X, Z), edge(Z, Y).\nedge(1, 2)."
    )
    written: List[Any] = []
    logic.output = written.append
    clauses = "path(A, B) :-\n    edge(A, B).\npath(A, B) :-\n    path(A, C),\n    edge(C, B).\n\n"
    assert answers(logic, "listing(path/2)")
    assert "".join(written) == f":- table path/2.\n\n{clauses}"
    written.clear()
    assert answers(logic, "listing")
    assert "".join(written).count("path(A, B) :-") == 2
    assert answers(logic, "predicate_property(path(_, _), number_of_clauses(N))") == [{"N": "2"}]
    assert first(logic, "nth_clause(path(_, _), 2, (H :- _)), H = path(A, A)") == {"H": "path(A,A)", "A": "A"}


def test_retract_enumerates_clauses_of_call_time() -> None:
    logic = prolog(":- dynamic(insect/1). insect(ant). insect(bee).")
    written: List[Any] = []
    logic.output = written.append
    assert answers(logic, "retract(insect(I)), write(I), retract(insect(bee)), fail") == []
    assert "".join(written) == "antbee"
    assert answers(logic, "insect(X)") == []


@pytest.mark.parametrize(
    ("options", "term"),
    [
        ("[]", '"ab"'),
        ("[double_quotes(atom)]", "ab"),
        ("[double_quotes(codes)]", "[97,98]"),
        ("[double_quotes(chars), other(x)]", "[a,b]"),
        ("[double_quotes(none)]", "domain_error(double_quotes,none)"),
    ],
)
def test_double_quotes_option_changes_read_term(options: str, term: str) -> None:
    assert first(prolog(), f"read_term_from_atom('\"ab\"', T, {options})") == term


@pytest.mark.parametrize(
    ("form", "text"), [("~I", "1_234_567"), ("~2I", "1_23_45_67"), ("x~Iy", "x1_234_567y")]
)
def test_digits_are_grouped(form: str, text: str) -> None:
    assert first(prolog(), f"format(atom(A), '{form}', [1234567])") == f"'{text}'".strip(
        "'" if text[0] == "x" else ""
    )


@pytest.mark.parametrize(
    ("form", "text"), [("a~Nb", "a\nb"), ("a~n~Nb", "a\nb"), ("~Na", "a"), ("a~N~n~Nb", "a\n\nb")]
)
def test_newline_directive_ends_started_line(form: str, text: str) -> None:
    logic = prolog()
    written: List[Any] = []
    logic.output = written.append
    assert answers(logic, f"format('{form}', [])") == [{}]
    assert "".join(written) == text


@pytest.mark.parametrize(
    ("goal", "expected"),
    [
        ("term_string(f('A b', \"s\"), S, [quoted(false)])", {"S": '"f(A b,s)"'}),
        ("term_string(f('A b', \"s\"), S, [])", {"S": '"f(\'A b\',\\"s\\")"'}),
        ("term_string(1 + a, S, [ignore_ops(true)])", {"S": '"+(1,a)"'}),
        ("X = f(A), term_string(X, S, [variable_names(['Left' = A])])", {"S": '"f(Left)"'}),
        ("term_string(_, \"p(X, Y)\", [variable_names(['X' = 1, 'Y' = Z])]), Z = 2", {"Z": "2"}),
        ('term_string(X, "\\"s\\"", [double_quotes(atom)])', {"X": "s"}),
        ('term_string(X, "s", [2])', "type_error(option,2)"),
        ("term_string(X, S, Options)", "instantiation_error"),
    ],
)
def test_term_string_uses_options(goal: str, expected: Any) -> None:
    solution = answers(prolog(), goal)[0]
    if isinstance(expected, dict):
        solution = {name: solution[name] for name in expected}
    assert solution == expected


@pytest.mark.parametrize("text", ["' 12'", "'\\n12'", '" 12"', "'12 '", "'+ 12'"])
def test_atom_number_fails_for_white_space(text: str) -> None:
    assert answers(prolog(), f"atom_number({text}, X)") == []


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ("3, 30, Root, Remainder", [{"Root": "3", "Remainder": "3"}]),
        ("3, -30, Root, Remainder", [{"Root": "-3", "Remainder": "-3"}]),
        ("1, -7, Root, Remainder", [{"Root": "-7", "Remainder": "0"}]),
        ("2, 0, Root, Remainder", [{"Root": "0", "Remainder": "0"}]),
        ("2, 10 ** 40, Root, Remainder", ["type_error(integer,10**40)"]),
        ("2, 5, 3, _", []),
        ("2, -30, Root, Remainder", ["evaluation_error(undefined)"]),
        ("0, 30, Root, Remainder", ["domain_error(not_less_than_one,0)"]),
        ("Degree, 30, Root, Remainder", ["instantiation_error"]),
    ],
)
def test_nth_integer_root_and_remainder(arguments: str, expected: Any) -> None:
    assert answers(prolog(), f"nth_integer_root_and_remainder({arguments})") == expected


def test_root_of_huge_integer_is_exact_or_refused() -> None:
    logic = prolog()
    goal = "X is 7 ** 5000 + 12345, nth_integer_root_and_remainder(D, X, R, M), X =:= R ** D + M, X < (R + 1) ** D"
    for degree in (2, 3, 7, 1000):
        assert len(answers(logic, f"D = {degree}, {goal}")) == 1
    assert answers(logic, "X is 3 ** 500000, nth_integer_root_and_remainder(2, X, R, M)") == [
        "resource_error(integer_size)"
    ]
