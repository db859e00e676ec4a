"""Meta-calls with limits, portions, blocking goals and ports."""

import pytest
from prolog.support import answers, first, prolog

from retalis import Limits, PrologError
from retalis.prolog.syntax.term_reader import read_term


@pytest.fixture
def logic():
    return prolog("count(0) :- !.\ncount(N) :- M is N - 1, count(M).\np(1).\np(2) :- p(1).")


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
def test_result(logic, goal, values):
    found = answers(logic, goal)
    shown = [answer["R"] if isinstance(answer, dict) else answer for answer in found]
    assert shown == values
    assert logic.machine.budget.ceilings == {}


def deep(around, inmost):
    """Return a goal that makes G a term in which one is around the other 3000 times."""
    return f"numlist(1, 3000, _L), foldl([_, A, {around}]>>true, _L, {inmost}, G)"


@pytest.mark.parametrize(
    ("goal", "found"),
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
def test_goals_that_would_have_to_wait(logic, goal, found):
    assert answers(logic, goal) == found


@pytest.mark.parametrize("joined", ["(A, nonvar(a))", "(nonvar(a), A)", "(A ; nonvar(a))", "(nonvar(_) ; A)"])
def test_a_condition_may_be_deep(logic, joined):
    assert answers(logic, f"{deep(joined, 'nonvar(a)')}, when(G, X = 1)")[0]["X"] == "1"


@pytest.mark.parametrize("around", ["\\+ A", "(A -> true)", "((A, _) , true)"])
def test_a_goal_that_is_too_deep_is_an_error(logic, around):
    found = first(logic, f"{deep(around, 'true')}, catch(G, error(E, _), true)")
    assert found["E"] == "resource_error(term_size)"
    assert logic.machine.choices == []


def test_ports(logic):
    lines = []
    logic.error_output = lines.append
    assert answers(logic, "trace(p(X)), X > 1, p(_)", 1) == [{"X": "2"}]
    assert [" ".join(line.split()[:3]) for line in lines][1:] == [
        "Exit: (1) p(1)",
        "Redo: (1) p(1)",
        "Call: (2) p(1)",
        "Exit: (2) p(1)",
        "Exit: (1) p(2)",
    ]


def test_tracing_ends_with_an_error(logic):
    lines = []
    logic.error_output = lines.append
    assert answers(logic, "catch(trace(throw(x)), x, true)") == [{}]
    assert first(logic, "p(X)") == "1"
    assert [line.split()[0] for line in lines] == ["Call:", "Exception:"]


def test_the_library_is_loaded_at_no_cost(logic):
    logic.limits = Limits(inferences=2000)
    assert answers(logic, "append([1], [2], L), list_to_assoc([], _)") == [{"L": "[1,2]"}]


@pytest.mark.parametrize(
    ("goal", "found"),
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
def test_there_is_no_input(logic, goal, found):
    assert answers(logic, goal) == found


@pytest.mark.parametrize(
    ("goal", "found"),
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
def test_types_of_what_is_hardly_there(logic, goal, found):
    assert answers(logic, goal) == found


def test_a_variable_before_a_goal_is_one_like_all_others(logic):
    assert answers(logic, "X^member(X, [1,2])") == [{"X": "1"}, {"X": "2"}]
    assert answers(logic, "_^G") == ["instantiation_error"]


def test_solutions_that_are_distinct(logic):
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
def test_lambda(logic, goal, values):
    found = answers(logic, goal)
    assert [one["L"] if isinstance(one, dict) else one for one in found] == values


@pytest.mark.parametrize(
    "goal", ["dif(X, a)", "freeze(X, true)", "when(ground(f(X)), true)", "dif(f(X), f(Y))"]
)
def test_a_goal_that_would_wait_says_what_can(goal):
    logic = prolog()
    with pytest.raises(PrologError) as caught:
        logic.once(read_term(goal, logic.operators).term)
    name = goal[: goal.index("(")]
    assert f"(in {name}/2): goals cannot wait for a variable" in caught.value.message
    assert "use_swi" in caught.value.message


@pytest.mark.parametrize(
    ("goal", "there"),
    [("succ/2", True), ("(=)/2", True), ("no_such/2", False), ("p/1", True), ("p/2", False)],
)
def test_a_predicate_of_the_system_is_one_where_it_is_named(goal, there):
    logic = prolog("p(1). :- dynamic(p/2).")
    assert logic.once(read_term(f"current_predicate({goal})", logic.operators).term) == there
    assert logic.once(read_term("current_predicate(succ/N)", logic.operators).term) is False
    assert logic.once(read_term("set_prolog_flag(iso, true)", logic.operators).term)
    assert logic.once(read_term(f"current_predicate({goal})", logic.operators).term) == (goal == "p/1")
