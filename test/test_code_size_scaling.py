"""Patterns, terms, clauses and goals of thousands of parts: the time to read and run them is linear.

The tests measure the length of the generated code instead of seconds, because the time of Python's compiler grows
with it.
"""

import re
from typing import Any, Dict, List

import pytest

from retalis import Engine, ProgramErrors
from retalis.events.dispatch import matcher_compiler
from retalis.foundation import codegen
from retalis.prolog.database import clause_index, compiled_goal


def slots(count: Any) -> str:
    return f"ev({','.join(f'X{number}' for number in range(count))})"


def items(count: int) -> str:
    return f"ev([{','.join(f'X{number}' for number in range(count))}])"


def constants(count: int) -> str:
    return f"ev([{','.join(map(str, range(count)))}])"


def nested(count: Any) -> str:
    return "ev(" + "f(a," * count + "X" + ")" * (count + 1)


def nested_left(count: Any) -> str:
    return "ev(" + "f(" * count + "X" + ",a)" * count + ")"


PATTERNS = {"slots": slots, "items": items, "constants": constants, "nested": nested, "left": nested_left}
PROGRAMS = {
    "pattern": ("o <- {0}.", None),
    "sequence": ("o <- a seq {0}.", None),
    "head": ("{0} <- a.", None),
    "condition": ("o(Z) <- a where (Z = {0}).", None),
    "action": ("o do assert({0}) <- a.", None),
    "fact": ("{0}.", None),
    "clause": ("h({0}) :- q({0}).", None),
    "goal": ("p.", "T = {0}, copy_term(T, C), T = C"),
    "memory": ("p.", "memorize({0}, [], _, m, 10)"),
    "subscription": ("p.", "subscribe({0}, [], _, t, s)"),
    "conditions": ("p.", "subscribe(a(Z), [Z \\= {0}], _, t, s)"),
}


@pytest.fixture
def code_lengths(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return a list to which the length of each compiled source is added."""
    lengths: List[Any] = []
    define = codegen.define

    def count(source: Any, names: Any, title: Any) -> Dict[str, Any]:
        lengths.append(len(source))
        return define(source, names, title)

    monkeypatch.setattr(codegen, "define", count)
    return lengths


@pytest.mark.slow
@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("program", PROGRAMS)
def test_length_of_code_is_linear(code_lengths: Any, program: str, pattern: str) -> None:
    rules, goal = PROGRAMS[program]
    total_lengths: Dict[Any, Any] = {}
    for count in (2000, 4000):
        del code_lengths[:]
        term = PATTERNS[pattern](count)
        engine = Engine()
        engine.load(rules=rules.format(term) + "\n", goals=goal.format(term) if goal else "")
        engine.event("a", 1)
        total_lengths[count] = sum(code_lengths)
    assert total_lengths[4000] < 2.2 * total_lengths[2000] + 1000
    assert total_lengths[4000] < 100 * 4000


@pytest.mark.slow
@pytest.mark.parametrize("pattern", PATTERNS)
def test_large_pattern_matches(pattern: str) -> None:
    term = PATTERNS[pattern](2000)
    engine = Engine()
    engine.load(
        rules=f"o <- {term}.\nboth <- {term} seq {term}.\n",
        goals="subscribe(o, [], _, t, s)\nsubscribe(both, [], _, t, s2)",
    )
    outputs: List[Any] = []
    engine.on_output(lambda output, topic, name: outputs.append(engine.show(output)))
    event = term.replace("X", "x")
    engine.event(event, 1)
    engine.event(event.replace("ev(", "other("), 2)
    engine.event("ev(nothing)", 2)
    engine.event(event, 3)
    assert outputs == ["o", "o", "both"]


@pytest.mark.slow
@pytest.mark.parametrize("form", ["body", "head", "argument", "unify", "either"])
def test_large_clause_has_answers_in_each_call(code_lengths: Any, form: str) -> None:
    text = {
        "body": "q(1) :- " + ",".join(f"X{number} = f(X{number + 1})" for number in range(1000)) + ".",
        "head": f"q({constants(2000)}) :- true, p.\nq(1) :- q({constants(2000)}).",
        "argument": f"q(1) :- p, r({items(2000)}).\nr(ev([1,1|_])).",
        "unify": f"q(1) :- Y = {items(2000)}, r(Y).\nr(ev([1,1|_])).",
        "either": "q(1) :- " + " ; ".join(["p, fail"] * 1000) + " ; p.",
    }[form]
    engine = Engine()
    engine.load(rules=f"p.\n{text}\n")
    for _ in range(40):
        assert engine.query("q(Y)") == [{"Y": 1}] if form != "head" else len(engine.query("q(Y)")) == 2
        assert not engine.call("q(2)")
    assert max(code_lengths, default=0) < 50_000


def run(text: Any, goals: Any, events: Any) -> List[Any]:
    engine = Engine()
    engine.load(rules=text, goals=goals)
    outputs: List[Any] = []
    engine.on_output(lambda term, topic, name: outputs.append(engine.show(term)))
    for second, event in enumerate(events):
        engine.event(event, second)
    answers = [str(engine.query(goal)) for goal in ("r(X)", "s(X, Y)", "t([1,2,3], N)")]
    return [re.sub("_G[0-9]+", "_", text) for text in (*outputs, *answers)]


def test_terms_without_code_have_same_results(monkeypatch: pytest.MonkeyPatch) -> None:
    text = """
        o(X, Y) <- a(X, f(Z)) seq b(Z, Y) where (Y > 1 ; X == c, \\+ Y = 1).
        twice(X) <- a(X, f(X)).
        open(Y) do assert(r(Y)) <- b(Y, _).
        s(X, Y) :- member(X, [1,2,3]), ( X > 1 -> Y = big ; Y = small ), \\+ X = 2.
        s(X, _) :- X = 9, !.
        t([], 0).
        t([_|T], N) :- t(T, M), N is M + 1.
        :- dynamic r/1.
    """
    goals_text = (
        "subscribe(o(_,_), [], _, t, s1)\nsubscribe(twice(_), [], _, t, s2)\nsubscribe(open(_), [], _, t, s3)"
    )
    events = [
        "a(c, f(1))",
        "b(1, 2)",
        "b(1, 1)",
        "a(5, f(5))",
        "b(5, 7)",
        "a(X, f(_))",
        "b(_, 3)",
        "a(1.0, f(1))",
    ]
    expected = run(text, goals_text, events)
    for module in (matcher_compiler, clause_index, compiled_goal):
        monkeypatch.setattr(module, "MAX_TERM_ARGUMENTS", 0)
    assert len(expected) > 8
    assert run(text, goals_text, events) == expected


@pytest.mark.slow
def test_deep_grammar_rule_is_loaded() -> None:
    for body in (
        "(a;" * 5000 + "b" + ")" * 5000,
        "\\+ " * 5000 + "a",
        ";".join(["a"] * 5000),
        "{p}," * 5000 + "a",
    ):
        engine = Engine()
        engine.load(rules=f"s --> {body}.\na --> [a].\nb --> [b].\np.\n")
    engine = Engine()
    engine.load(
        rules="s --> (a, b ; \\+ a, b -> [c], {p} ; call(q, 1)), !.\na --> [a].\nb --> [b].\np.\nq(1, [d|T], T).\n"
    )
    for text, is_accepted in (
        ("[a,b]", True),
        ("[b,c]", True),
        ("[d]", True),
        ("[b]", False),
        ("[a]", False),
    ):
        assert engine.call(f"phrase(s, {text})") is is_accepted


def test_pattern_beyond_depth_limit_is_an_error() -> None:
    for pattern in (
        "a seq (" * 5000 + "b" + ")" * 5000,
        " and ".join(["a"] * 5000),
        "(" * 5000 + "a" + " where (p))" * 5000,
    ):
        with pytest.raises(ProgramErrors, match="too deep"):
            Engine().load(rules=f"o <- {pattern}.\n")


def test_index_stores_variable_clauses_once() -> None:
    engine = Engine()
    engine.load(rules="".join(f"f({number}, a).\nf(_, {number}).\n" for number in range(2000)))
    assert len(engine.query("f(7, a)")) == 1
    predicate = next(
        predicate
        for predicate in engine.logic.database.predicates.values()
        if str(predicate.functor) == "f/2"
    )
    assert 0 < len(predicate.indexes) < 20 * 4000
