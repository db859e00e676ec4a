"""Meta-calls: limits, distinct solutions, blocking goals and traced ports."""

from typing import Any, List

import pytest
from prolog.support import answers, first, prolog

from retalis import Limits, PrologError
from retalis.prolog.syntax.term_reader import read_term


@pytest.fixture
def logic() -> Any:
    return prolog("count(0) :- !.\ncount(N) :- M is N - 1, count(M).")


@pytest.mark.parametrize(
    ("goal", "values"),
    [
        ("call_with_inference_limit(true, 10000, R)", ["!"]),
        ("call_with_inference_limit(member(_, [1,2]), 10000, R)", ["true", "!"]),
        ("call_with_inference_limit(count(100), 10000, R)", ["!"]),
        ("call_with_inference_limit(count(100000), 10000, R)", ["inference_limit_exceeded"]),
        (
            "length(L, 50000), maplist(=(a), L), call_with_inference_limit(meta_predicate(L), 10000, R)",
            ["inference_limit_exceeded"],
        ),
        (
            "H is 1 << 1_000_000, call_with_inference_limit(randset(5, H, _), 50000, R)",
            ["inference_limit_exceeded"],
        ),
        ("call_with_inference_limit(fail, 10000, R)", []),
        ("call_with_inference_limit(throw(x), 10000, R)", ["x"]),
        (
            "call_with_inference_limit(call_with_inference_limit(count(100000), 10000, R), 1000000, _)",
            ["inference_limit_exceeded"],
        ),
        (
            "call_with_inference_limit(call_with_inference_limit(count(100000), 1000000, _), 10000, R)",
            ["inference_limit_exceeded"],
        ),
        ("call_with_inference_limit(true, 1000, _), once(count(100000)), R = on", ["on"]),
        ("call_with_inference_limit(a, _, R)", ["instantiation_error"]),
        ("findall(L, findnsols(2, X, member(X, [a,b,c]), L), R)", ["[[a,b],[c]]"]),
        ("findall(L, findnsols(2, X, (member(X, [a,b]) ; fail), L), R)", ["[[a,b],[]]"]),
        ("findall(L, findnsols(2, X, fail, L), R)", ["[[]]"]),
        ("findnsols(2, X, member(X, [a,b,c]), R, [z])", ["[a,b,z]", "[c,z]"]),
        ("aggregate_all(count, X, member(X, [a,b,a]), R)", ["2"]),
        ("aggregate_all(sum(Y), X, member(X-Y, [a-1,b-1,a-1]), R)", ["2"]),
        ("aggregate_all(bag(Y), X, member(X-Y, [b-1,b-3,a-1]), R)", ["[1,1,3]"]),
        ("aggregate_all(max(Y), X, member(X-Y, [b-1,b-3,a-1]), R)", ["3"]),
        ("aggregate_all(nonsense, X, true, R)", ["domain_error(aggregate_template,nonsense)"]),
    ],
)
def test_meta_call_has_results(logic: Any, goal: str, values: Any) -> None:
    solutions = answers(logic, goal)
    shown = [answer["R"] if isinstance(answer, dict) else answer for answer in solutions]
    assert shown == values
    assert logic.machine.budget.ceilings == {}


def nested_goal(step: Any, innermost: str) -> str:
    """Return a goal that binds G to a term that nests ``step`` 3000 times around ``innermost``."""
    return f"numlist(1, 3000, _L), foldl([_, A, {step}]>>true, _L, {innermost}, G)"


@pytest.mark.parametrize(
    ("goal", "expected"),
    [
        ("dif(a, b)", [{}]),
        ("dif(a, a)", []),
        ("dif(f(X, a), f(X, b))", [{"X": "A"}]),
        ("dif(f(X), f(X))", []),
        ("dif(X, a)", ["instantiation_error"]),
        ("dif(f(X), f(Y))", ["instantiation_error"]),
        ("X = 1, freeze(X, Y = 2)", [{"X": "1", "Y": "2"}]),
        ("freeze(X, true)", ["instantiation_error"]),
        ("when(ground(f(a)), X = 1)", [{"X": "1"}]),
        ("when((nonvar(a), ground(b)), X = 1)", [{"X": "1"}]),
        ("when((nonvar(X) ; nonvar(b)), X = 1)", [{"X": "1"}]),
        ("when(?=(X, X), X = 1)", [{"X": "1"}]),
        ("when(nonvar(X), true)", ["instantiation_error"]),
        ("when(X, true)", ["instantiation_error"]),
        ("when(foo, true)", ["domain_error(when_condition,foo)"]),
    ],
)
def test_blocking_goals_run_or_are_errors(logic: Any, goal: str, expected: Any) -> None:
    assert answers(logic, goal) == expected


@pytest.mark.parametrize(
    "condition", ["(A, nonvar(a))", "(nonvar(a), A)", "(A ; nonvar(a))", "(nonvar(_) ; A)"]
)
def test_deep_condition_of_when_is_checked(logic: Any, condition: str) -> None:
    assert answers(logic, f"{nested_goal(condition, 'nonvar(a)')}, when(G, X = 1)")[0]["X"] == "1"


@pytest.mark.parametrize("step", ["\\+ A", "(A -> true)", "((A, _) , true)"])
def test_goal_beyond_depth_limit_is_an_error(logic: Any, step: str) -> None:
    answer = first(logic, f"{nested_goal(step, 'true')}, catch(G, error(E, _), true)")
    assert answer["E"] == "resource_error(term_size)"
    assert logic.machine.choices == []


def test_trace_prints_ports(logic: Any) -> None:
    lines: List[Any] = []
    logic.error_output = lines.append
    assert answers(logic, "trace(p(X)), X > 1, p(_)", 1) == [{"X": "2"}]
    assert [" ".join(line.split()[:3]) for line in lines][1:] == [
        "Exit: (1) p(1)",
        "Redo: (1) p(1)",
        "Call: (2) p(1)",
        "Exit: (2) p(1)",
        "Exit: (1) p(2)",
    ]


def test_error_ends_tracing(logic: Any) -> None:
    lines: List[Any] = []
    logic.error_output = lines.append
    assert answers(logic, "catch(trace(throw(x)), x, true)") == [{}]
    assert first(logic, "p(X)") == "1"
    assert [line.split()[0] for line in lines] == ["Call:", "Exception:"]


def test_loading_library_uses_no_inferences(logic: Any) -> None:
    logic.limits = Limits(inferences=2000)
    assert answers(logic, "append([1], [2], L), list_to_assoc([], _)") == [{"L": "[1,2]"}]


@pytest.mark.parametrize(
    ("goal", "expected"),
    [
        ("read_term(user_input, X, [])", [{"X": "end_of_file"}]),
        ("read(user_input, X)", [{"X": "end_of_file"}]),
        ("get_char(X)", [{"X": "end_of_file"}]),
        ("peek_code(user_input, X)", [{"X": "-1"}]),
        ("get_char(user_output, _)", ["permission_error(input,stream,user_output)"]),
        ("get_char(s, _)", ["existence_error(stream,s)"]),
        ("get_char(_, _)", ["instantiation_error"]),
        ("at_end_of_stream(user_input)", [{}]),
        ("current_output(S), write(S, '')", [{"S": "user_output"}]),
        ("char_conversion(a, bc)", ["representation_error(character)"]),
        ("current_char_conversion(X, b)", [{"X": "b"}]),
    ],
)
def test_standard_input_is_empty(logic: Any, goal: str, expected: Any) -> None:
    assert answers(logic, goal) == expected


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
def test_must_be_accepts_unusual_types(logic: Any, goal: str, expected: Any) -> None:
    assert answers(logic, goal) == expected


def test_caret_outside_bagof_calls_goal(logic: Any) -> None:
    assert answers(logic, "X^member(X, [1,2])") == [{"X": "1"}, {"X": "2"}]
    assert answers(logic, "_^G") == ["instantiation_error"]


def test_distinct_solutions_occur_once(logic: Any) -> None:
    assert answers(logic, "distinct(X, member(X-_, [1-a,1-b,2-c]))") == [{"X": "1"}, {"X": "2"}]
    assert answers(logic, "distinct(member(X, [b,b,a]))") == [{"X": "b"}, {"X": "a"}]


@pytest.mark.parametrize(
    ("goal", "values"),
    [
        ("maplist([X,Y]>>(Y is X * 2), [1,2], L)", ["[2,4]"]),
        ("N = 3, maplist([X,Y]>>(Y is X * N), [1,2], L)", ["[3,6]"]),
        ("maplist([X-Y,Y]>>true, [1-a,2-b], L)", ["[a,b]"]),
        ("maplist([X,X]>>true, [1,2], L)", ["[1,2]"]),
        ("maplist([X]>>(X = f(Z)), [A,B]), A == B", []),
        ("maplist(Z/[X]>>(X = f(Z)), [A,B]), A == B, Z = 1, L = A", ["f(1)"]),
        ("call([X]>>plus(X), 1, 2, L)", ["3"]),
        ("call([X,Y]>>(Y = X), L, 1)", ["1"]),
        ("maplist(X/[X]>>true, [1,1]), L = X", ["1"]),
    ],
)
def test_lambda_shares_free_variables_only(logic: Any, goal: str, values: Any) -> None:
    solutions = answers(logic, goal)
    assert [solution["L"] if isinstance(solution, dict) else solution for solution in solutions] == values


@pytest.mark.parametrize(
    "goal", ["dif(X, a)", "freeze(X, true)", "when(ground(f(X)), true)", "dif(f(X), f(Y))"]
)
def test_error_of_blocking_goal_names_alternative(goal: str) -> None:
    logic = prolog()
    with pytest.raises(PrologError) as error:
        logic.once(read_term(goal, logic.operators).term)
    name = goal[: goal.index("(")]
    assert f"(in {name}/2): goals cannot wait for a variable" in error.value.message
    assert "use_swi" in error.value.message


@pytest.mark.parametrize(
    ("goal", "is_current"),
    [("succ/2", True), ("(=)/2", True), ("no_such/2", False), ("p/1", True), ("p/2", False)],
)
def test_current_predicate_includes_builtins_by_flag(goal: str, is_current: bool) -> None:
    logic = prolog("p(1). :- dynamic(p/2).")
    assert logic.once(read_term(f"current_predicate({goal})", logic.operators).term) == is_current
    assert logic.once(read_term("current_predicate(succ/N)", logic.operators).term) is False
    assert logic.once(read_term("set_prolog_flag(iso, true)", logic.operators).term)
    assert logic.once(read_term(f"current_predicate({goal})", logic.operators).term) == (goal == "p/1")
