"""Modules: local names, and goals in the context of another module."""

from typing import Any, List

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from parsing import read_clauses
from prolog.goal_answers import answers, first, prolog

from retalis.prolog.database.predicate import NEVER_COMPILE
from retalis.prolog.system.prolog_snapshot import (
    restore_program,
    restore_values,
    snapshot_program,
    snapshot_values,
)
from retalis.prolog.system.prolog_system import PrologSystem


def load(logic: Any, *texts: Any) -> Any:
    """Load files in order."""
    problems: List[Any] = []
    for text in texts:
        with logic.database.modules.loading_file():
            for read in read_clauses(text, logic.operators, "file.pl"):
                logic.load([(read.term, read.place)], lambda message, place: problems.append(message))
    assert problems == []
    return logic


UTIL = """
:- module(util, [double_all/2, count/1, bump/0, each/2, greet//1, top/1, kinds/1, lambda/2, inside/1, sorted/2]).
:- dynamic total/1.
:- meta_predicate each(1, ?).
total(0).
helper(X, Y) :- Y is X * 2.
double_all(L, M) :- maplist(helper, L, M).
count(N) :- total(N).
bump :- retract(total(N)), M is N + 1, assertz(total(M)).
each(G, L) :- forall(member(X, L), call(G, X)).
greet(X) --> hello, name(X).
hello --> [hello].
name(X) --> [X], { known(X) }.
known(ann).
top(X) :- G = helper(1), call(G, X).
kinds(L) :- findall(X-Y, (helper(1, X), total(Y)), L).
lambda(L, M) :- maplist([X, Y]>>(helper(X, Z), Y is Z + 1), L, M).
inside(L) :- G = X^known(X), setof(Y, (\\+ \\+ known(Y), G = _, known(Y)), L).
sorted(L, M) :- predsort(order, L, M).
order(O, A, B) :- compare(O, B, A).
"""

MINE = """
helper(mine, mine).
total(mine).
known(bob).
order(<, _, _).
ok(X) :- X > 0.
"""


@pytest.fixture(params=[0, NEVER_COMPILE], ids=["compiled", "interpreted"])
def both(request: pytest.FixtureRequest) -> Any:
    return load(PrologSystem(compile_after=request.param), UTIL.replace("\\\\", "\\"), MINE)


@pytest.mark.parametrize(
    ("goal", "expected"),
    [
        ("double_all([1, 2], X)", "[2,4]"),
        ("helper(mine, X)", "mine"),
        ("total(X)", "mine"),
        ("bump, bump, count(X)", "2"),
        ("phrase(greet(X), [hello, ann])", "ann"),
        ("phrase(util:greet(X), [hello, ann])", "ann"),
        ("phrase(util:name(X), [ann])", "ann"),
        ("top(X)", "2"),
        ("kinds(X)", "[2-0]"),
        ("lambda([1], X)", "[3]"),
        ("inside(X)", "[ann]"),
        ("sorted([1, 2, 3], X)", "[3,2,1]"),
        ("util:helper(4, X)", "8"),
        ("util:(helper(4, Y), X = Y)", {"X": "8", "Y": "8"}),
        ("call(util:helper, 4, X)", "8"),
        ("call(util:helper(4), X)", "8"),
        ("maplist(util:helper, [1], X)", "[2]"),
        ("findall(Y, util:total(Y), X)", {"Y": "A", "X": "[0]"}),
        ("M = util, G = total(X), M:G", {"M": "util", "G": "total(0)", "X": "0"}),
        ("util:util:total(X)", "0"),
        ("user:total(X)", "mine"),
        ("nowhere:total(X)", "mine"),
        ("assertz(util:total(9)), findall(Y, util:total(Y), X)", {"Y": "A", "X": "[0,9]"}),
        ("retract(util:total(X))", "0"),
        ("retractall(util:total(_)), \\+ util:total(_), total(X)", "mine"),
        ("clause(util:count(N), X)", {"N": "A", "X": "'util:total'(A)"}),
        ("clause(util:name(_, _, _), X)", "A=[B|C],known(B),C=D"),
        ("predicate_property(util:total(_), number_of_clauses(X))", "1"),
        ("predicate_property(total(_), number_of_clauses(X))", "1"),
        ("strip_module(util:a, M, X)", {"M": "util", "X": "a"}),
        ("current_module(util), X = yes", "yes"),
        (
            "catch(util:nope(1), error(existence_error(procedure, X), _), true)",
            "util:nope/1",
        ),
    ],
)
def test_names_are_local_to_modules(both: Any, goal: str, expected: Any) -> None:
    assert first(both, goal) == expected


def test_closure_is_called_in_module_of_caller(both: Any) -> None:
    assert answers(both, "each(ok, [1, 2])") == [{}]
    assert answers(both, "util:each(ok, [0])") == []
    load(both, ":- module(other, [try/1]).\nok(X) :- X == own.\ntry(L) :- each(ok, L).")
    assert answers(both, "try([own])") == [{}]
    assert answers(both, "try([1])") == []


def test_listing_shows_clauses_of_named_module(both: Any) -> None:
    output: List[Any] = []
    both.output = output.append
    assert answers(both, "listing(helper/2), listing(top), listing(util:total/1)")
    text = "".join(output)
    assert "helper(A, B) :-\n    B is A*2." not in text  # helper/2 is the program's
    assert "top(A) :-\n    B=helper(1),\n    call(B, A)." in text
    assert ":- dynamic total/1.\n\ntotal(0)." in text


def test_clause_in_own_module_has_unqualified_body(both: Any) -> None:
    load(both, ":- module(meta, [solve/1]).\nsolve(true).\nsolve((A, B)) :- solve(A), solve(B).\n"
         "solve(G) :- G \\= true, G \\= (_, _), clause(G, B), solve(B).\n"
         "p(X) :- q(X), r(X).\nq(1).\nq(2).\nr(2).\nall(L) :- findall(X, solve(p(X)), L).\n")  # fmt: skip
    assert first(both, "meta:all(X)") == "[2]"


def test_equal_names_of_two_modules_are_separate() -> None:
    logic = load(
        prolog(),
        ":- module(one, [one/1]).\n:- dynamic seen/1.\none(X) :- part(X), \\+ seen(X), assertz(seen(X)).\npart(1).",
        ":- module(two, [two/1]).\n:- dynamic seen/1.\n"
        "two(X) :- part(X), \\+ seen(X), assertz(seen(X)).\npart(1).\npart(2).",
    )
    assert [first(logic, "one(X)"), first(logic, "one(X)"), first(logic, "two(X)")] == ["1", None, "1"]
    assert answers(logic, "one:seen(X)") == answers(logic, "two:seen(X)") == [{"X": "1"}]


def test_second_export_of_name_gives_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    logic, warnings = prolog(), []
    monkeypatch.setattr(logic, "message", lambda kind, text: warnings.append(text))
    load(
        logic,
        ":- module(one, [p/1]).\np(one).",
        ":- module(two, [p/1, go/1]).\np(two).\ngo(X) :- p(X).",
    )
    assert warnings == [
        "Warning: no permission to import two:p/1 into user: already imported from one; two:p(...) calls it\n"
    ]
    modules = logic.database.modules
    for name, used in (("three", ["two"]), ("four", ["one", "two"])):
        with modules.loading_file():
            modules.begin_module(name, [])
            for exporter in used:
                modules.import_exports(exporter)
            for read in read_clauses("ask(X) :- p(X).", logic.operators):
                logic.add_clause(read.term)
    assert "into four: already imported from one" in warnings.pop()
    assert len(warnings) == 1
    restored = PrologSystem()
    restore_program(restored, snapshot_program(logic))
    restore_values(restored, snapshot_values(logic))
    for system in (logic, restored):
        goals = ("p(X)", "one:p(X)", "two:p(X)", "go(X)", "three:ask(X)", "four:ask(X)")
        assert [answers(system, goal) for goal in goals] == [
            [{"X": module}] for module in ("one", "one", "two", "two", "two", "one")
        ]


def test_module_redefines_builtin_for_itself() -> None:
    logic = load(
        prolog("own(X) :- print(X)."), ":- module(m, [say/1]).\nprint(X) :- X = shouted.\nsay(X) :- print(X)."
    )
    assert first(logic, "say(X)") == "shouted"
    output: List[Any] = []
    logic.output = output.append
    assert answers(logic, "own(hello)") == [{}]
    assert output == ["hello"]


def test_missing_predicate_is_called_in_program() -> None:
    logic = load(prolog("base(1)."), ":- module(m, [ask/1]).\nask(X) :- base(X).\n")
    assert first(logic, "ask(X)") == "1"
    load(logic, "base(2).")
    assert answers(logic, "ask(X)") == [{"X": "1"}, {"X": "2"}]
    load(logic, "m:base(own).")
    assert answers(logic, "ask(X)") == [{"X": "own"}]


def test_qualified_clauses_are_added_to_module() -> None:
    logic = load(
        prolog(":- dynamic hook/1. :- multifile hook/1."),
        ":- module(m, []).\nuser:hook(X) :- own(X).\nown(m).\n:- dynamic there/1.\n",
        "m:there(1).\nm:there(X) :- mine(X).\nmine(2).",
    )
    assert answers(logic, "hook(X)") == [{"X": "m"}]
    assert answers(logic, "m:there(X)") == [{"X": "1"}, {"X": "2"}]


def test_invalid_export_leaves_module_defined() -> None:
    logic = PrologSystem()
    problems: List[Any] = []
    with logic.database.modules.loading_file():
        for read in read_clauses(":- module(m, [p/1, q(x)]).\np(X) :- own(X).\nown(1).\n", logic.operators):
            logic.load([(read.term, read.place)], lambda message, place: problems.append(message))
    assert len(problems) == 1
    assert "predicate_indicator" in problems[0]
    assert first(logic, "p(X)") == "1"
    assert answers(logic, "own(X)")[0].startswith("existence_error")


def test_exported_operators_are_declared() -> None:
    logic = load(prolog(), ":- module(m, [op(700, xfx, ===>), (===>)/2]).\na ===> b.\n")
    assert first(logic, "a ===> X") == "b"


def test_assert_of_imported_name_changes_its_module() -> None:
    logic = load(prolog(), ":- module(store, [fact/1]).\n:- dynamic fact/1.\n")
    modules = logic.database.modules
    with modules.loading_file():
        modules.begin_module("user_of_it", [])
        modules.import_exports("store")
        for read in read_clauses("add(X) :- assertz(fact(X)).", logic.operators):
            logic.add_clause(read.term)
    assert first(logic, "user_of_it:add(1), fact(X)") == "1"


@pytest.mark.parametrize(
    ("goal", "error"),
    [
        ("module(m, [])", "permission_error(load,module,m)"),
        ("module(m, x)", "type_error(list,x)"),
        ("module(m, _)", "instantiation_error"),
        ("module(1, [])", "type_error(atom,1)"),
        ("M:true", "instantiation_error"),
        ("m:M", "instantiation_error"),
        ("meta_predicate(_)", "instantiation_error"),
    ],
)
def test_invalid_modules_and_names_are_refused(goal: str, error: str) -> None:
    assert answers(prolog(), goal) == [error]


def test_restored_modules_have_same_answers(both: Any) -> None:
    assert answers(both, "bump") == [{}]
    restored = PrologSystem()
    restore_program(restored, snapshot_program(both))
    restore_values(restored, snapshot_values(both))
    for goal, expected in (
        ("count(X)", "1"),
        ("double_all([1], X)", "[2]"),
        ("util:helper(1, X)", "2"),
        ("total(X)", "mine"),
        ("phrase(greet(X), [hello, ann])", "ann"),
    ):
        assert first(restored, goal) == first(both, goal) == expected
    assert answers(restored, "each(ok, [1])") == [{}]


# Any two modules with the same names give the answers that each gives alone.

NAMES = ["a", "b", "c"]
VALUES = st.integers(0, 3)
FORMS = [
    "{0}(X)",
    "\\+ {0}({1}), X = {1}",
    "once({0}(X))",
    "findall(X, {0}(X), L), member(X, L)",
    "call({0}, X)",
    "G = {0}, call(G, X)",
    "G = {0}(X), G",
    "forall({0}(Y), Y > {1}), X = {1}",
    "({0}(X) -> true ; X = {1})",
    "bagof(Y, Z^({0}(Y), Z = Y), L), member(X, L)",
    "assertz(d({1})), {0}(Y), d(X), X > Y",
    "G = d({1}), assertz(G), retract(d(X))",
    "X = {1}",
]


@st.composite
def programs(draw: Any) -> str:
    lines: List[Any] = []
    for index, name in enumerate(NAMES):
        lines += [f"{name}({value})." for value in draw(st.lists(VALUES, min_size=1, max_size=3))]
        if index + 1 < len(NAMES):  # calls of later predicates only terminate
            called = st.sampled_from(NAMES[index + 1 :])
            for form in draw(st.lists(st.sampled_from(FORMS), max_size=2)):
                lines.append(f"{name}(X) :- {form.format(draw(called), draw(VALUES))}.")
    return "\n".join(lines)


@pytest.mark.slow
@settings(max_examples=12)
@given(programs(), programs())
def test_modules_with_same_names_are_independent(first_text: Any, second_text: Any) -> None:
    def load_program(name: str, text: Any) -> Any:
        return load(prolog(), f":- dynamic d/1.\n{text}\ngo_{name}(L) :- findall(X, a(X), L).")

    expected = [
        first(load_program("one", first_text), "go_one(X)"),
        first(load_program("two", second_text), "go_two(X)"),
    ]
    logic = load(
        prolog(),
        *(
            f":- module({name}, [go_{name}/1]).\n{text}\ngo_{name}(L) :- findall(X, a(X), L)."
            for name, text in (("one", first_text), ("two", second_text))
        ),
    )
    assert [first(logic, "go_one(X)"), first(logic, "go_two(X)")] == expected
