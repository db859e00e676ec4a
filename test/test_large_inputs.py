"""Patterns, terms, clauses and goals of thousands of parts: read and run in time that grows with their length.

What is measured is the code that is made for them, not seconds: where Python's compiler is given more and more of it,
time grows faster than its length does.
"""

import re

import pytest

from retalis import Engine, ProgramErrors
from retalis.events.dispatch import matcher_compiler
from retalis.foundation import codegen
from retalis.prolog.database import clause_index, compiled_goal


def slots(count):
    return f"ev({','.join(f'X{at}' for at in range(count))})"


def items(count):
    return f"ev([{','.join(f'X{at}' for at in range(count))}])"


def constants(count):
    return f"ev([{','.join(map(str, range(count)))}])"


def nested(count):
    return "ev(" + "f(a," * count + "X" + ")" * (count + 1)


def left(count):
    return "ev(" + "f(" * count + "X" + ",a)" * count + ")"


PATTERNS = {"slots": slots, "items": items, "constants": constants, "nested": nested, "left": left}
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
def code(monkeypatch):
    """Return the lengths of the sources that are compiled, in a list."""
    lengths = []
    define = codegen.define

    def counted(source, names, title):
        lengths.append(len(source))
        return define(source, names, title)

    monkeypatch.setattr(codegen, "define", counted)
    return lengths


@pytest.mark.slow
@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("program", PROGRAMS)
def test_the_code_for_a_large_term_does_not_grow_faster_than_it(code, program, pattern):
    rules, goal = PROGRAMS[program]
    made = {}
    for count in (2000, 4000):
        del code[:]
        term = PATTERNS[pattern](count)
        engine = Engine()
        engine.load(rules=rules.format(term) + "\n", goals=goal and goal.format(term))
        engine.event("a", 1)
        made[count] = sum(code)
    assert made[4000] < 2.2 * made[2000] + 1000
    assert made[4000] < 100 * 4000


@pytest.mark.slow
@pytest.mark.parametrize("pattern", PATTERNS)
def test_large_patterns_match(pattern):
    term = PATTERNS[pattern](2000)
    engine = Engine()
    engine.load(
        rules=f"o <- {term}.\nboth <- {term} seq {term}.\n",
        goals="subscribe(o, [], _, t, s)\nsubscribe(both, [], _, t, s2)",
    )
    seen = []
    engine.on_output(lambda found, topic, name: seen.append(engine.show(found)))
    event = term.replace("X", "x")
    engine.event(event, 1)
    engine.event(event.replace("ev(", "other("), 2)
    engine.event("ev(nothing)", 2)
    engine.event(event, 3)
    assert seen == ["o", "o", "both"]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["body", "head", "argument", "unify", "either"])
def test_large_clauses_are_right_when_they_are_called_often(code, kind):
    text = {
        "body": "q(1) :- " + ",".join(f"X{at} = f(X{at + 1})" for at in range(1000)) + ".",
        "head": f"q({constants(2000)}) :- true, p.\nq(1) :- q({constants(2000)}).",
        "argument": f"q(1) :- p, r({items(2000)}).\nr(ev([1,1|_])).",
        "unify": f"q(1) :- Y = {items(2000)}, r(Y).\nr(ev([1,1|_])).",
        "either": "q(1) :- " + " ; ".join(["p, fail"] * 1000) + " ; p.",
    }[kind]
    engine = Engine()
    engine.load(rules=f"p.\n{text}\n")
    for _ in range(40):
        assert engine.query("q(Y)") == [{"Y": 1}] if kind != "head" else len(engine.query("q(Y)")) == 2
        assert not engine.call("q(2)")
    assert max(code, default=0) < 50_000


def run(text, goals, events):
    engine = Engine()
    engine.load(rules=text, goals=goals)
    seen = []
    engine.on_output(lambda term, topic, name: seen.append(engine.show(term)))
    for at, event in enumerate(events):
        engine.event(event, at)
    found = [str(engine.query(goal)) for goal in ("r(X)", "s(X, Y)", "t([1,2,3], N)")]
    return [re.sub("_G[0-9]+", "_", one) for one in (*seen, *found)]


def test_what_is_run_without_code_of_its_own_does_the_same(monkeypatch):
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
    compiled = run(text, goals_text, events)
    for module in (matcher_compiler, clause_index, compiled_goal):
        monkeypatch.setattr(module, "MAX_TERM_ARGUMENTS", 0)
    assert run(text, goals_text, events) == compiled
    assert len(compiled) > 8


@pytest.mark.slow
def test_grammar_rules_nested_deeply():
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
    for text, reads in (("[a,b]", True), ("[b,c]", True), ("[d]", True), ("[b]", False), ("[a]", False)):
        assert engine.call(f"phrase(s, {text})") is reads


def test_patterns_nested_too_deeply_are_errors():
    for pattern in (
        "a seq (" * 5000 + "b" + ")" * 5000,
        " and ".join(["a"] * 5000),
        "(" * 5000 + "a" + " where (p))" * 5000,
    ):
        with pytest.raises(ProgramErrors, match="too deep"):
            Engine().load(rules=f"o <- {pattern}.\n")


def test_an_index_does_not_hold_each_clause_with_a_variable_under_each_key():
    engine = Engine()
    engine.load(rules="".join(f"f({at}, a).\nf(_, {at}).\n" for at in range(2000)))
    assert len(engine.query("f(7, a)")) == 1
    predicate = next(one for one in engine.logic.database.predicates.values() if str(one.functor) == "f/2")
    assert 0 < len(predicate.indexes) < 20 * 4000
