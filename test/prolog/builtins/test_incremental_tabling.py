"""Incremental tables: correct answers after any change."""

import random
import shutil
from pathlib import Path
from types import ModuleType
from typing import Any, List

import pytest
from nightly_round_numbers import round_numbers
from prolog.goal_answers import NEVER, answers, first, prolog
from script_modules import load_script

from retalis import Limits
from retalis.prolog.builtins.tabling import Table, tables_of
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.system.prolog_system import PrologSystem

PROGRAM = """
:- dynamic edge/2 as incremental.
:- dynamic([node/1, runs/1], [incremental(true)]).
:- dynamic other/1.
:- table path/2 as incremental.
path(X, Y) :- edge(X, Y).
path(X, Y) :- path(X, Z), edge(Z, Y).
:- table (count/1, alone/1) as incremental, unreached/1 as incremental.
count(N) :- assertz(runs(1)), findall(X-Y, path(X, Y), L), length(L, N).
alone(X) :- node(X), \\+ edge(X, _), \\+ edge(_, X).
unreached(X) :- node(X), \\+ path(a, X).
:- table cost(_, _, min) as incremental.
cost(X, Y, 1) :- edge(X, Y).
cost(X, Y, C) :- cost(X, Z, B), edge(Z, Y), C is B + 1.
:- table even/1 as incremental, odd/1 as incremental.
even(X) :- node(X), X == a.
even(Y) :- odd(X), edge(X, Y).
odd(Y) :- even(X), edge(X, Y).
:- table plain/1.
plain(X) :- node(X).
:- table (over/1, stored/1, listed/1) as incremental.
over(X) :- plain(X).
stored(X) :- other(X).
listed(N) :- findall(X, clause(node(X), true), L), length(L, N).
edge(a, b).
edge(b, c).
node(a).
node(b).
node(c).
other(1).
"""


@pytest.fixture(params=[0, NEVER])
def logic(request: pytest.FixtureRequest) -> PrologSystem:
    system = prolog(PROGRAM, request.param)
    system.limits = Limits(inferences=5_000_000)
    return system


def values(logic: Any, goal: str) -> List[Any]:
    """Return the sorted values of X in the solutions of a goal."""
    return sorted(answer["X"] for answer in answers(logic, goal, 100))


def test_change_reaches_tables_that_read_it(logic: PrologSystem) -> None:
    assert values(logic, "path(a, X)") == ["b", "c"]
    assert first(logic, "count(N)") == "3"
    assert answers(logic, "assertz(edge(c, d))") == [{}]
    assert values(logic, "path(a, X)") == ["b", "c", "d"]
    assert first(logic, "count(N)") == "6"
    assert answers(logic, "retract(edge(b, c))") == [{}]
    assert values(logic, "path(a, X)") == ["b"]
    assert first(logic, "count(N)") == "2"
    assert answers(logic, "retractall(edge(_, _))") == [{}]
    assert values(logic, "path(a, X)") == []
    assert answers(logic, "asserta(edge(a, a))") == [{}]
    assert values(logic, "path(a, X)") == ["a"]
    assert answers(logic, "assertz((edge(X, Y) :- member(X-Y, [a-z, z-y])))") != []
    assert values(logic, "path(a, X)") == ["a", "y", "z"]
    assert logic.machine.choices == [] == logic.machine.trail


def test_only_changes_of_read_facts_reevaluate() -> None:
    logic = prolog(PROGRAM.replace("[node/1, runs/1]", "[node/1]").replace("other/1.", "other/1, runs/1."))
    for _ in range(3):
        assert first(logic, "count(N)") == "3"
    assert answers(logic, "assertz(node(d)), assertz(other(2))") == [{}]
    assert first(logic, "count(N)") == "3"
    assert first(logic, "aggregate_all(count, runs(_), N)") == "1"
    assert first(logic, "assertz(edge(c, a)), count(N)") == "9"
    assert first(logic, "count(N)") == "9"
    assert first(logic, "aggregate_all(count, runs(_), N)") == "2"


def test_negated_and_collected_facts_are_read(logic: PrologSystem) -> None:
    assert values(logic, "alone(X)") == []
    assert values(logic, "unreached(X)") == ["a"]
    assert answers(logic, "assertz(node(d))") == [{}]
    assert values(logic, "alone(X)") == ["d"]
    assert values(logic, "unreached(X)") == ["a", "d"]
    assert answers(logic, "assertz(edge(c, d))") == [{}]
    assert values(logic, "alone(X)") == []
    assert values(logic, "unreached(X)") == ["a"]


def test_moded_table_follows_changes_both_ways(logic: PrologSystem) -> None:
    assert first(logic, "cost(a, c, X)") == "2"
    assert first(logic, "assertz(edge(a, c)), cost(a, c, X)") == "1"
    assert first(logic, "retract(edge(a, c)), cost(a, c, X)") == "2"
    assert first(logic, "retract(edge(b, c)), (cost(a, c, X) -> true ; X = none)") == "none"


def test_mutually_recursive_tables_follow_changes(logic: PrologSystem) -> None:
    assert values(logic, "even(X)") == ["a", "c"]
    assert values(logic, "odd(X)") == ["b"]
    assert answers(logic, "assertz(edge(c, a))") == [{}]
    assert values(logic, "odd(X)") == ["a", "b", "c"]
    assert values(logic, "even(X)") == ["a", "b", "c"]
    assert answers(logic, "retract(edge(a, b))") == [{}]
    assert values(logic, "even(X)") == ["a"]
    assert values(logic, "odd(X)") == []


def test_tables_ignore_changes_of_opaque_facts(logic: PrologSystem) -> None:
    assert values(logic, "plain(X)") == values(logic, "over(X)") == ["a", "b", "c"]
    assert values(logic, "stored(X)") == ["1"]
    assert answers(logic, "assertz(node(d)), assertz(other(2))") == [{}]
    assert values(logic, "plain(X)") == values(logic, "over(X)") == ["a", "b", "c"]
    assert values(logic, "stored(X)") == ["1"]
    assert answers(logic, "abolish_all_tables") == [{}]
    assert values(logic, "plain(X)") == values(logic, "over(X)") == ["a", "b", "c", "d"]
    assert values(logic, "stored(X)") == ["1", "2"]


@pytest.mark.parametrize(
    "reads",
    [
        "findall(X, clause(fact(X), true), L)",
        "findall(N, (predicate_property(fact(_), number_of_clauses(N)), N > 0), L)",
        "findall(N, nth_clause(fact(_), N, _), L)",
        "findall(yes, current_predicate(fact/1), L)",
        "findall(X, call(fact, X), L)",
        "findall(X, (fact(X) ; fail), L)",
        "findall(X, (X = 1, fact(X)), L)",
        "(fact(1) -> L = [1] ; L = [])",
        "(\\+ fact(1) -> L = [] ; L = [1])",
        "(catch(known(1), _, fail) -> L = [1] ; L = [])",
        "findall(X, known(X), L)",
        "(forall(member(X, [1]), fact(X)) -> L = [1] ; L = [])",
    ],
)
@pytest.mark.parametrize("compile_after", [0, 2, NEVER])
def test_any_read_of_facts_is_recorded(reads: str, compile_after: Any) -> None:
    program = f"""
    :- dynamic fact/1 as incremental.
    known(X) :- fact(X).
    :- table t/1 as incremental.
    t(L) :- {reads}.
    """
    logic = prolog(program, compile_after)
    for _ in range(6):
        assert first(logic, "t(L)") == "[]"
        assert first(logic, "assertz(fact(1)), t(L)") in ("[1]", "[yes]")
        assert first(logic, "retract(fact(1)), t(L)") == "[]"


def test_table_depends_on_reads_of_complete_table(logic: PrologSystem) -> None:
    clause = "size(_N) :- findall(_X-_Y, path(_X, _Y), _L), length(_L, _N)"
    assert answers(logic, f"table(size/1 as incremental), assertz(({clause}))") == [{}]
    assert answers(logic, "findall(_X, path(_X, _), _)") == [{}]
    assert first(logic, "size(N)") == "3"
    assert first(logic, "assertz(edge(c, d)), size(N)") == "6"


def test_change_during_evaluation_outdates_table() -> None:
    def version_of(part: Any) -> str:
        return "off"

    table = Table(True)
    table.add_reads({(version_of, None): "off"})
    assert not table.is_outdated
    table.add_reads({(version_of, None): "on"})
    assert table.is_outdated


def test_later_declaration_reaches_compiled_code() -> None:
    logic = prolog(
        ":- dynamic fact/1.\nfact(1). known(X) :- fact(X).\n:- table t/1 as incremental.\nt(X) :- known(X)."
    )
    for _ in range(3):
        assert answers(logic, "known(1)") == [{}]
    assert values(logic, "t(X)") == ["1"]
    assert answers(logic, "dynamic(fact/1 as incremental)") == [{}]
    assert values(logic, "assertz(fact(2)), t(X)") == ["1", "2"]
    assert values(logic, "assertz(fact(3)), t(X)") == ["1", "2", "3"]


def test_indexed_facts_outdate_tables() -> None:
    logic = prolog(":- dynamic f/2 as incremental.\n:- table t/2 as incremental.\nt(X, Y) :- f(X, Y).")
    assert answers(logic, "forall(between(1, 200, _I), assertz(f(_I, _I)))") == [{}]
    for number in range(1, 60):
        assert values(logic, f"t({number}, X)") == [str(number)]
    assert answers(logic, "retract(f(7, _)), assertz(f(8, new))") == [{}]
    assert values(logic, "t(7, X)") == []
    assert values(logic, "t(8, X)") == ["8", "new"]


def test_evaluation_that_changes_its_facts_is_repeated() -> None:
    program = """
    :- dynamic q/1 as incremental.
    :- table a/1 as incremental.
    a(X) :- q(X).
    a(new) :- \\+ q(9), assertz(q(9)).
    """
    logic = prolog(program)
    assert values(logic, "a(X)") == ["new"]
    assert values(logic, "a(X)") == ["9"]
    assert values(logic, "a(X)") == ["9"]


def test_change_between_answers_keeps_remaining_ones(logic: PrologSystem) -> None:
    goal = "findall(X, (path(a, X), retractall(edge(_, _))), X)"
    assert first(logic, goal) in ("[b,c]", "[c,b]")
    assert values(logic, "path(a, X)") == []


def test_failed_evaluation_leaves_no_answers() -> None:
    program = """
    :- dynamic q/1 as incremental.
    :- table (a/1, b/1) as incremental.
    a(X) :- b(X).
    b(X) :- a(X).
    b(X) :- q(X), ( X == 2 -> throw(two) ; true ).
    """
    logic = prolog(program)
    assert answers(logic, "assertz(q(1)), assertz(q(2)), a(X)") == ["two"]
    assert values(logic, "retract(q(1)), retract(q(2)), assertz(q(3)), a(X)") == ["3"]
    assert values(logic, "b(X)") == ["3"]


ROUNDS = """
:- dynamic (q/1, way/1) as incremental.
:- dynamic rounds/1, ends/0.
:- table (a/1, b/1, c/1) as incremental.
a(X) :- q(X).
a(X) :- findall(Y, b(Y), L), member(X, L).
a(99).
a(_) :- retract(rounds(N)), M is N + 1, assertz(rounds(M)), M >= 2, ends, throw(ended).
b(X) :- a(X).
b(X) :- way(on), retract(way(on)), c(X).
c(X) :- b(X).
c(X) :- q(Y), X is Y + 10.
rounds(0).
"""


@pytest.mark.parametrize(("ends", "expected"), [("true", "[{}]"), ("assertz(ends)", "['ended']")])
def test_outdated_answers_of_rounds_are_dropped(ends: str, expected: str) -> None:
    logic = prolog(ROUNDS)
    start = f"{ends}, assertz(q(1)), assertz(way(on)), findall(_X, a(_X), _)"
    assert str(answers(logic, start)) == expected
    assert first(logic, "rounds(N), retractall(ends)") == "2"
    assert values(logic, "retract(q(1)), assertz(q(2)), c(X)") == ["12", "2", "99"]
    assert values(logic, "a(X)") == ["2", "99"]


def test_abolished_predicate_outdates_table() -> None:
    logic = prolog(":- dynamic q/1 as incremental.\n:- table t/1 as incremental.\nt(X) :- q(X).\nt(0).")
    assert values(logic, "assertz(q(1)), t(X)") == ["0", "1"]
    assert answers(logic, "abolish(q/1), t(_)") == ["existence_error(procedure,q/1)"]
    assert values(logic, "dynamic(q/1), t(X)") == ["0"]
    assert values(logic, "assertz(q(2)), t(X)") == ["0", "2"]


def test_changed_clauses_of_table_outdate_it() -> None:
    logic = prolog(":- table t/1 as incremental.\n:- dynamic t/1.\nt(1).")
    assert values(logic, "t(X)") == ["1"]
    assert values(logic, "assertz(t(2)), t(X)") == ["1", "2"]
    assert values(logic, "retract(t(1)), t(X)") == ["2"]
    assert values(logic, "clause(t(X), true)") == ["2"]
    other = prolog(":- dynamic t/1 as incremental.\nt(1).\n:- table t/1 as (incremental, dynamic).")
    assert values(other, "t(X)") == ["1"]
    assert values(other, "retractall(t(_)), assertz(t(3)), t(X)") == ["3"]


def test_later_declaration_changes_options() -> None:
    logic = prolog(":- dynamic q/1 as incremental.\n:- table t/1.\nt(X) :- q(X).")
    assert values(logic, "assertz(q(1)), t(X)") == ["1"]
    assert values(logic, "assertz(q(2)), t(X)") == ["1"]
    assert values(logic, "table(t/1 as incremental), t(X)") == ["1", "2"]
    assert values(logic, "table(t/1), assertz(q(3)), t(X)") == ["1", "2", "3"]
    assert values(logic, "table(t/1 as opaque), t(X)") == ["1", "2", "3"]
    assert values(logic, "assertz(q(4)), t(X)") == ["1", "2", "3"]


def test_properties_and_listing_show_options(logic: PrologSystem) -> None:
    def properties(goal: str) -> List[Any]:
        return [
            name
            for name in values(logic, f"predicate_property({goal}, X)")
            if "tabled" in name or "incr" in name
        ]

    assert properties("path(_, _)") == ["incremental", "tabled", "tabled(incremental)", "tabled(variant)"]
    assert properties("plain(_)") == ["tabled", "tabled(variant)"]
    assert properties("edge(_, _)") == ["incremental"]
    assert properties("other(_)") == []
    texts: List[Any] = []
    logic.output = texts.append
    assert answers(logic, "listing([plain/1, edge/2])") == [{}]
    listed = "".join(texts)
    assert ":- table plain/1.\n" in listed
    assert ":- dynamic edge/2 as incremental.\n" in listed


@pytest.mark.parametrize(
    ("goal", "error"),
    [
        ("table(t/1 as foo)", "domain_error(table_option,foo)"),
        ("table(t/1 as [incremental])", "domain_error(table_option,[incremental])"),
        ("table(t/1 as max_answers)", "domain_error(table_option,max_answers)"),
        ("table(t/1 as incremental(yes))", "domain_error(table_option,incremental(yes))"),
        ("table(t/1 as _)", "instantiation_error"),
        ("table(t/1 as 1)", "type_error(callable,1)"),
        ("dynamic(t/1 as foo)", "domain_error(predicate_option,foo)"),
        ("dynamic(t/1 as thread(local))", "domain_error(predicate_option,thread(local))"),
        ("dynamic(t/1 as _)", "instantiation_error"),
        ("dynamic(t/1, [])", "type_error(list,t/1)"),
        ("dynamic([t/1], foo)", "type_error(list,foo)"),
        ("dynamic([t/1], [incremental(foo)])", "type_error(boolean,foo)"),
        ("dynamic([t/1], [incremental(_)])", "instantiation_error"),
        ("dynamic([t/1], [_])", "instantiation_error"),
        ("dynamic([_], [])", "instantiation_error"),
        ("dynamic([t], [])", "type_error(predicate_indicator,t)"),
    ],
)
def test_unknown_option_is_refused(goal: str, error: str) -> None:
    assert answers(prolog(), goal) == [error]


@pytest.mark.parametrize(
    "option", ["subsumptive", "shared", "monotonic", "lazy", "max_answers(3)", "subgoal_abstract(2)"]
)
def test_option_without_effect_gives_warning(option: str, monkeypatch: pytest.MonkeyPatch) -> None:
    logic, messages = prolog(), []
    monkeypatch.setattr(logic, "message", lambda kind, text: messages.append((kind, text)))
    assert answers(logic, f"table(t/1 as (incremental, {option}))") == [{}]
    assert [kind for kind, _ in messages] == ["warning"]
    assert f"table t/1 as {option}: the option has no effect" in messages[0][1]
    assert answers(logic, "predicate_property(t(_), incremental)") == [{}]


def test_effective_and_default_options_give_no_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    logic, messages = prolog(), []
    monkeypatch.setattr(logic, "message", lambda kind, text: messages.append(text))
    table = "table(t/1 as (variant, incremental, dynamic)), table(u/1 as opaque)"
    goal = f"{table}, dynamic(v/1 as (opaque, abstract(0))), assertz(t(1)), t(X)"
    assert answers(logic, goal) == [{"X": "1"}]
    assert messages == []


@pytest.mark.slow
def test_outdated_tables_are_dropped() -> None:
    logic = prolog(":- dynamic q/1 as incremental.\n:- table t/2 as incremental.\nt(N, X) :- q(X), X < N.")
    assert answers(
        logic, "forall(between(1, 4000, _N), (retractall(q(_)), assertz(q(_N)), t(_N, _) ; true))"
    ) == [{}]
    assert len(tables_of(logic.machine).by_call) < 2100


# Random programs

_GOALS = (
    "f({0}, {1})",
    "f({0}, {1})",
    "g({1}), {0} = {1}",
    "{2}({0}, {1})",
    "{2}({0}, {1})",
    "\\+ {2}({0}, {0}), {0} = {1}",
    "g({0}), ( {2}({0}, {1}) -> true ; {1} = {0} )",
    "findall({0}-{1}, {2}({0}, {1}), L{1}), sort(L{1}, M{1}), member({0}-{1}, M{1})",
    "aggregate_all(count, {2}(_, _), C{1}), C{1} > 1, g({0}), {1} = {0}",
    "forall(g(X{1}), {2}(X{1}, _)), f({0}, {1})",
    "call({2}, {0}, {1})",
    "catch({2}({0}, {1}), _, fail)",
    "clause(f({0}, {1}), true)",
)
_MONOTONE = (0, 2, 3, 4, 10)
"""Monotone goals, which may call a table that depends on the caller: more answers never refute others."""


def random_rules(rng: Any, names: Any) -> Any:
    """Return rules for pairs of predicates, which call each other, and those of earlier pairs in any way."""
    rules: List[Any] = []
    for index, name in enumerate(names):
        below, peers = names[: index // 2 * 2], names[index // 2 * 2 :][:2]
        rules.append(f"{name}(X0, X1) :- {rng.choice(('f(X0, X1)', 'f(X1, X0)', 'g(X0), X1 = X0'))}.")
        for _ in range(rng.randrange(1, 4)):
            size = rng.randrange(1, 4)
            goals: List[Any] = []
            for step in range(size):
                if below and rng.random() < 0.6:
                    kind, other = rng.randrange(len(_GOALS)), rng.choice(below)
                else:
                    kind, other = rng.choice(_MONOTONE), rng.choice(peers)
                goals.append(_GOALS[kind].format(f"X{step}", f"X{step + 1}", other))
            # bound values make negation and arithmetic safe
            known = "".join(f"g(X{step}), " for step in range(size + 1))
            rules.append(f"{name}(X0, X{size}) :- {known}{', '.join(goals)}.")
    return rules


def random_changes(rng: Any) -> Any:
    """Return a goal that changes the facts."""
    x, y = rng.randrange(4), rng.randrange(4)
    return rng.choice(
        (
            f"assertz(f({x}, {y}))",
            f"assertz(f({x}, {y}))",
            f"asserta(g({x}))",
            f"ignore(retract(f({x}, {y})))",
            f"ignore(retract(f({x}, _)))",
            f"retractall(g({x}))",
            f"retractall(f({x}, _))",
            f"forall(retract(f(_, {y})), true)",
            f"assertz((f({x}, Y) :- g(Y)))",
            f"ignore(retract((f({x}, _) :- _)))",
        )
    )


_FACTS = [
    ":- dynamic f/2 as incremental.",
    ":- dynamic([g/1], [incremental(true)]).",
    "f(0, 1).",
    "f(1, 2).",
    "g(1).",
]
_NAMES = ("p", "q", "r", "s")


def sorted_answers(name: str, suffix: str = "") -> str:
    """Return a goal that binds S to the sorted answers of a predicate."""
    return f"aggregate_all(set(X-Y), {name}(X, Y), S{suffix})"


def solutions(logic: Any, goal: Any) -> List[Any]:
    """Return the values of S for each solution of a goal, or an error."""
    return [answer.get("S") if isinstance(answer, dict) else answer for answer in answers(logic, goal)]


@pytest.mark.parametrize("seed", round_numbers(10, 40))
def test_incremental_tables_equal_fresh_ones(seed: int) -> None:
    rng = random.Random(seed)
    rules = random_rules(rng, _NAMES)
    tables = ", ".join(f"{name}/2" for name in _NAMES)
    head = f":- discontiguous {tables}."
    compile_after = rng.choice((0, 12, NEVER))
    compared = 0
    incremental = prolog(
        "\n".join([*_FACTS, f":- table ({tables}) as incremental.", head, *rules]), compile_after
    )
    fresh = prolog("\n".join([*_FACTS, f":- table {tables}.", head, *rules]), compile_after)
    for logic in (incremental, fresh):
        logic.limits = Limits(inferences=20_000_000)
    for _ in range(25):
        if rng.random() < 0.6:
            goal = random_changes(rng)
        else:
            name = rng.choice(_NAMES)
            goal = rng.choice((sorted_answers(name), f"aggregate_all(set(Y), {name}(1, Y), S)"))
            assert answers(fresh, "abolish_all_tables") == [{}]
        expected = solutions(fresh, goal)
        assert solutions(incremental, goal) == expected, (goal, rules)
        compared += expected not in ([], [None], ["[]"])
    assert compared > 0
    assert incremental.machine.choices == [] == incremental.machine.trail


@pytest.mark.parametrize("seed", round_numbers(10, 40))
def test_incremental_tables_equal_untabled_predicates(seed: int) -> None:
    rng = random.Random(seed)
    rules: List[Any] = []
    for index, name in enumerate(_NAMES):  # each predicate calls only earlier ones
        rules += random_rules(rng, (*_NAMES[:index], name))[-3:] if index else ["p(X, Y) :- f(X, Y)."]
        rules = [rule for rule in rules if not rule.startswith(name) or f" {name}(" not in rule]
    rules = [rule for rule in rules if not _calls_itself_or_later(rule)]
    rules += [f"{name}(X, Y) :- f(Y, X)." for name in _NAMES]
    tables = ", ".join(f"{name}/2" for name in _NAMES)
    head = f":- discontiguous {tables}."
    tabled = prolog("\n".join([*_FACTS, f":- table ({tables}) as incremental.", head, *rules]))
    plain = prolog("\n".join([*_FACTS, head, *rules]))
    for _ in range(25):
        goal = random_changes(rng) if rng.random() < 0.6 else sorted_answers(rng.choice(_NAMES))
        tabled_answers, plain_answers = (
            [{key: answer[key] for key in answer if key == "S"} for answer in answers(logic, goal)]
            for logic in (tabled, plain)
        )
        assert tabled_answers == plain_answers, (goal, rules)


def _calls_itself_or_later(rule: str) -> bool:
    own, body = rule.split(" :- ")
    later = _NAMES[_NAMES.index(own[0]) :]
    return any(f"{name}(X" in body or f"{name}(_" in body or f"({name}," in body for name in later)


def load_neighbor(name: str) -> ModuleType:
    """Return a module of the folder above, which is not a package."""
    return load_script(Path(__file__).parents[1] / f"{name}.py")


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("swipl") is None, reason="SWI-Prolog is not installed")
@pytest.mark.parametrize("seed", round_numbers(1, 4))
def test_incremental_tables_equal_those_of_swi_prolog(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    # Restores the search path, to which the modules add their folder.
    monkeypatch.syspath_prepend(Path(__file__).parents[1])
    swi_comparison, swipl = load_neighbor("swi_comparison"), load_neighbor("swipl")
    rng = random.Random(seed)
    tables = ", ".join(f"{name}/2" for name in _NAMES)
    head = [f":- discontiguous {tables}.", f":- table ({tables}) as incremental."]
    program = "\n".join([*_FACTS, *head, *random_rules(rng, _NAMES)])
    scripts: List[Any] = []
    for _ in range(40):
        steps = [
            random_changes(rng) if rng.random() < 0.5 else sorted_answers(rng.choice(_NAMES), str(step))
            for step in range(12)
        ]
        scripts.append(", ".join([*steps, sorted_answers("s", "last")]))
    swi_answers = swi_comparison.ask(scripts, f"{swipl.PROGRAM}\n{program}\n")
    compared = 0
    for script, expected in zip(scripts, swi_answers):
        if expected in ("limit", "lost"):
            continue
        logic = prolog(program)
        answer = swi_comparison.solutions(logic, read_term(script, logic.operators).term)
        assert swi_comparison.plain(answer) == swi_comparison.plain(expected), (script, program)
        compared += 1
    assert compared > len(scripts) // 2
