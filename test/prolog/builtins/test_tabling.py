"""Tabling: termination of left recursion, with all answers and without duplicates."""

import random
from collections import Counter
from typing import Any, Dict

import pytest
from prolog.goal_answers import answers, first, prolog

from retalis import Limits
from retalis.prolog.builtins.tabling import tables_of
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.system.prolog_system import PrologSystem

PROGRAM = """
:- table path/2, even/1, odd/1, fib/2, p/1, q/1, expr/2, term/2, factor/2.
edge(a, b). edge(b, c). edge(c, a). edge(c, d).
path(X, Y) :- path(X, Z), edge(Z, Y).
path(X, Y) :- edge(X, Y).
even(0).
even(N) :- odd(M), N is M + 1, N < 20.
odd(N) :- even(M), N is M + 1, N < 20.
fib(0, 0).
fib(1, 1).
fib(N, F) :- N > 1, A is N - 1, B is N - 2, fib(A, X), fib(B, Y), F is X + Y.
p(X) :- q(X).
p(1).
q(X) :- p(Y), X is Y * 2, X < 100.
q(3).
expr --> expr, "+", term.
expr --> term.
term --> term, "*", factor.
term --> factor.
factor --> "(", expr, ")".
factor --> "1".
reads(T) :- atom_codes(T, Codes), phrase(expr, Codes).
"""


@pytest.fixture
def logic() -> PrologSystem:
    system = prolog(PROGRAM)
    system.limits = Limits(inferences=5_000_000)
    return system


@pytest.mark.parametrize(
    ("goal", "value"),
    [
        ("findall(Y, path(a, Y), _L), msort(_L, L)", "[a,b,c,d]"),
        ("findall(_X-_Y, path(_X, _Y), _L), length(_L, L)", "12"),
        ("findall(Y, path(d, Y), L)", "[]"),
        ("findall(X, even(X), L)", "[0,2,4,6,8,10,12,14,16,18]"),
        ("findall(X, odd(X), L)", "[1,3,5,7,9,11,13,15,17,19]"),
        ("fib(200, L)", "280571172992510140037611932413038677189525"),
        ("findall(X, p(X), _L), msort(_L, L)", "[1,2,3,4,6,8,12,16,24,32,48,64,96]"),
        (
            "findall(_T, (member(_T, ['1', '1+1*(1+1)', '(1)*1', '1+', '', '2']), reads(_T)), L)",
            "['1','1+1*(1+1)','(1)*1']",
        ),
    ],
)
def test_left_recursion_has_all_answers(logic: PrologSystem, goal: str, value: str) -> None:
    result = first(logic, goal)
    result = result["L"] if isinstance(result, dict) else result
    assert result == value


def test_repeated_declaration_tables_once() -> None:
    logic = prolog(":- table p/1.\np(1).\n:- table p/1.\np(2).")
    assert answers(logic, "p(X)") == [{"X": "1"}, {"X": "2"}]


def test_cut_keeps_table_complete(logic: PrologSystem) -> None:
    assert first(logic, "once(path(a, X))") == "b"
    assert len(answers(logic, "path(a, X)")) == 4


@pytest.mark.parametrize(
    ("program", "goal", "error"),
    [
        (":- table r/1.\nr(X) :- r(Y), X is Y + 1, (X > 2 -> throw(big) ; true).\nr(1).", "r(X)", "big"),
        (":- table n(_, lattice(n)).\nn(a, 1).\nn(a, 2).\nn(_, _, _) :- throw(worse).", "n(a, X)", "worse"),
    ],
)
def test_error_drops_incomplete_table(program: str, goal: str, error: str) -> None:
    logic = prolog(program)
    for _ in range(2):
        assert answers(logic, goal) == [error]
    assert logic.machine.choices == []


def test_failed_table_is_not_repeated_endlessly() -> None:
    logic = prolog(
        ":- table p/1, c/1.\np(X) :- p(Y), X is Y + 1, X < 3.\np(0).\np(9) :- catch(c(_), _, true).\n"
        "c(1).\nc(_) :- p(_), throw(oops)."
    )
    logic.limits = Limits(inferences=100_000)
    assert first(logic, "findall(_X, p(_X), _L), msort(_L, L)") == "[0,1,2,9]"
    assert answers(logic, "c(_)") == ["oops"]


@pytest.mark.parametrize(
    ("clauses", "call", "expected"),
    [
        ("p :- p.\np.", "(p, p)", "[(p,p)]"),
        ("p :- p.", "p", "[]"),
        ("p(A, A).\np(1, 2).", "p(X, Y)", "[p(A,A),p(1,2)]"),
        ("p(A, A).\np(1, 2).", "p(X, X)", "[p(A,A)]"),
        ("p(A, A).\np(1, 2).", "p(1, X)", "[p(1,1),p(1,2)]"),
        ("p(A, f(B, A, B)).", "(p(1, f(X, Y, Z)), X = 2)", "[(p(1,f(2,1,2)),2=2)]"),
        ("p(A, f(B, A, B)).", "(p(X, f(X, Y, Z)), Z = 3)", "[(p(3,f(3,3,3)),3=3)]"),
        (
            "p(1).\np(1.0).\np(\"1\").\np('1').\np(0.0).\np(-0.0).\np([X|X]).\np([a]).\np(1).",
            "p(X)",
            "[p(1),p(1.0),p(\"1\"),p('1'),p(0.0),p(-0.0),p([A|A]),p([a])]",
        ),
        ("p(1).\np(1.0).", "(p(1), p(1.0), p(1))", "[(p(1),p(1.0),p(1))]"),
        ("p(1).", "p(1.0)", "[]"),
    ],
)
def test_answers_of_tables_keep_terms(clauses: str, call: str, expected: str) -> None:
    logic = prolog(f":- table p/0, p/1, p/2.\n{clauses}")
    for _ in range(2):  # evaluated, and from the table
        assert first(logic, f"term_to_atom(_G, `{call}`), findall(_G, _G, L)") == expected


@pytest.mark.parametrize("seed", range(30))
def test_closure_of_random_graph_is_complete(seed: int) -> None:
    """Symmetry and transitivity of the same predicate: many calls depend on each other."""
    rng = random.Random(seed)
    nodes = range(rng.randrange(3, 7))
    edges = {(rng.choice(nodes), rng.choice(nodes)) for _ in range(rng.randrange(1, 8))}
    rules = ["c(X, Y) :- c(Y, X).", "c(X, Z) :- c(X, Y), c(Y, Z).", *[f"c({x}, {y})." for x, y in edges]]
    rng.shuffle(rules)
    logic = prolog(":- table c/2.\n" + "\n".join(rules), rng.choice([0, 1 << 60]))
    logic.limits = Limits(inferences=20_000_000)
    linked = set(edges)
    while True:
        more = linked | {(y, x) for x, y in linked}
        more |= {(x, z) for x, y in more for other, z in more if other == y}
        if more == linked:
            break
        linked = more
    start = rng.choice(nodes)
    expected = sorted(y for x, y in linked if x == start)
    assert sorted(int(answer["Y"]) for answer in answers(logic, f"c({start}, Y)")) == expected
    assert len(answers(logic, "c(X, Y)", 1000)) == len(linked)


@pytest.mark.parametrize(
    "run", [lambda logic, goal: logic.once(goal), lambda logic, goal: next(logic.solutions(goal))]
)
def test_interrupt_drops_incomplete_table(run: Any) -> None:
    logic = prolog(":- table r/1.\nr(X) :- r(Y), waits, X is Y + 1, X < 4.\nr(1).")
    interrupts = [KeyboardInterrupt]

    def waits(machine: Any) -> bool:
        if interrupts:
            raise interrupts.pop()
        return True

    logic.define("waits", 0, waits)
    with pytest.raises(KeyboardInterrupt):
        run(logic, read_term("r(X)", logic.operators).term)
    assert [answer["X"] for answer in answers(logic, "r(X)")] == ["1", "2", "3"]


def test_cyclic_argument_is_refused() -> None:
    logic = prolog(":- table p/1.\np(_).")
    logic.limits = Limits(inferences=100_000)
    assert answers(logic, "X = f(Y, X), p(X)") == ["resource_error(term_size)"]


MODED = """
:- table path(_, _, min), a(_, first), b(_, last), c(index, max), d(+, -), p(_, po(better/2)), n(_, lattice(n)).
:- table w(_, lattice(shorter/3)), two(_, min, max), front(min, _), m:q(min, lattice(user:shorter(_, _, _))).
edge(a, b, 1). edge(b, c, 2). edge(a, c, 5). edge(c, a, 1).
path(X, Y, C) :- edge(X, Y, C).
path(X, Y, C) :- path(X, Z, A), edge(Z, Y, B), C is A + B.
v(a, 3). v(a, x). v(a, 1). v(b, 2). v(a, 4). v(a, 1).
a(X, Y) :- v(X, Y).
b(X, Y) :- v(X, Y).
b(X, Y) :- b(_, _), v(X, Y).
c(X, Y) :- v(X, Y).
d(X, Y) :- v(X, Y).
p(X, Y) :- v(X, Y).
better(A, B) :- A @< B.
n(X, Y) :- v(X, Y).
n(_, new, _) :- fail.
n(1, _, _) :- throw(worse).
w(X, [X]).
w(X, [X|T]) :- edge(X, Y, _), w(Y, T).
w(z, [a, b, c]). w(z, [A|A]). w(z, [a, b]).
shorter(A, B, C) :- ( is_list(A), is_list(B), length(A, N), length(B, M), M < N -> C = B ; C = A ).
two(X, Y, Z) :- v(X, Y), v(X, Z).
front(Y, X) :- v(X, Y).
q(1, []).
"""


@pytest.mark.parametrize(
    ("call", "expected"),
    [
        ("path(a, X, Y)", "[path(a,a,4),path(a,b,1),path(a,c,3)]"),
        ("path(X, c, Y)", "[path(a,c,3),path(b,c,2),path(c,c,4)]"),
        ("path(a, c, 3)", "error(uninstantiation_error(3),context(path/3,A))"),
        ("path(X, X, Y)", "[path(a,a,4),path(b,b,4),path(c,c,4)]"),
        ("path(X, Y, Y)", "[]"),
        ("a(X, Y)", "[a(a,3),a(b,2)]"),
        ("b(X, Y)", "[b(a,1),b(b,2)]"),
        ("c(X, Y)", "[c(a,x),c(b,2)]"),
        ("d(X, Y)", "[d(a,3),d(b,2)]"),
        ("p(X, Y)", "[p(a,1),p(b,2)]"),
        ("n(b, Y)", "[n(b,2)]"),
        ("n(a, Y)", "[n(a,3)]"),
        ("w(a, Y)", "[w(a,[a])]"),
        ("w(X, [Y|Z])", "error(uninstantiation_error([A|B]),context(w/2,C))"),
        ("w(z, Y)", "[w(z,[z])]"),
        ("two(X, Y, Z)", "[two(a,1,x),two(b,2,2)]"),
        ("two(X, 1, Z)", "error(uninstantiation_error(1),context(two/3,A))"),
        ("front(Y, X)", "[front(1,a),front(2,b)]"),
        ("q(X, Y)", "[q(1,[])]"),
    ],
)
def test_modes_keep_best_answer(call: str, expected: str) -> None:
    """The answers are those of SWI-Prolog, where a recursive table with `last` does not terminate."""
    logic = prolog(MODED)
    logic.limits = Limits(inferences=1_000_000)
    goal = f"term_to_atom(_G, `{call}`), catch((findall(_G, _G, _L), msort(_L, L)), L, true)"
    for _ in range(2):
        assert first(logic, goal) == expected


@pytest.mark.parametrize(
    ("spec", "error"),
    [
        ("p(_, bar)", "domain_error(tabled_mode,bar)"),
        ("p(1, _)", "domain_error(tabled_mode,1)"),
        ("p(sum)", "domain_error(tabled_mode,sum)"),
        ("p(_, lattice(x/2))", "domain_error(lattice_arity,2)"),
        ("p(_, lattice(f(_, _)))", "domain_error(lattice_arity,2)"),
        ("p(_, po(x/3))", "domain_error(po_arity,3)"),
        ("p(_, po(1))", "type_error(atom,1)"),
        ("p(_, lattice(_))", "instantiation_error"),
    ],
)
def test_unknown_mode_is_refused(spec: str, error: str) -> None:
    assert answers(prolog(), f"table({spec})") == [error]


_GOALS = (
    "{0}({1}, {2})",
    "{0}({1}, {2})",
    "edge({1}, {2})",
    "(\\+ once({0}({1}, {2})) -> fail ; {0}({1}, {2}))",
    "findall({1}-{2}, {0}({1}, {2}), L), member({1}-{2}, L)",
    "catch({0}({1}, {2}), _, true)",
    "(fail ; {0}({1}, {2}))",
    "({0}({1}, {2}) *-> true ; fail)",
    "{0}({1}, {2}), \\+ \\+ {0}({1}, {2})",
    "call({0}, {1}, {2})",
)


def closure(rules: Any, edges: Any) -> Any:
    """Return all answers of rules ``(name, [(kind, name)])`` along a chain of variables, bottom up."""
    pairs_by_name: Dict[Any, Any] = {name: set() for name in "pqr"}
    while True:
        before = {name: len(pairs) for name, pairs in pairs_by_name.items()}
        for name, goals in rules:
            pairs = None
            for kind, other in goals:
                step = edges if _GOALS[kind].startswith("edge") else pairs_by_name[other]
                pairs = set(step) if pairs is None else {(x, z) for x, y in pairs for w, z in step if y == w}
            pairs_by_name[name] |= pairs
        if before == {name: len(pairs) for name, pairs in pairs_by_name.items()}:
            return pairs_by_name


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(60))
def test_mutually_recursive_tables_are_complete(seed: int) -> None:
    rng = random.Random(seed)
    edges = {(rng.randrange(5), rng.randrange(5)) for _ in range(rng.randrange(1, 8))}
    rules = [("p", [(2, "p")])]
    for _ in range(rng.randrange(2, 7)):
        goals = [(rng.randrange(len(_GOALS)), rng.choice("pqr")) for _ in range(rng.randrange(1, 4))]
        rules.append((rng.choice("pqr"), goals))
    rng.shuffle(rules)
    texts = [":- table p/2, q/2, r/2.", ":- discontiguous p/2, q/2, r/2."]
    for name, goals in rules:
        body = [
            _GOALS[kind].format(other, f"X{index}", f"X{index + 1}").replace("L", f"L{index}")
            for index, (kind, other) in enumerate(goals)
        ]
        texts.append(f"{name}(X0, X{len(goals)}) :- {', '.join(body)}.")
    texts += [f"{name}(_, _) :- fail." for name in "pqr"]
    texts += [f"edge({x}, {y})." for x, y in sorted(edges)]
    logic = prolog("\n".join(texts), rng.choice([0, 12, 1 << 60]))
    logic.limits = Limits(inferences=20_000_000)
    expected = closure(rules, edges)
    for name in rng.sample("pqr", 3):
        call = rng.choice([f"{name}(X, Y)", f"member(X, [0,1,2,3,4]), {name}(X, Y)"])
        pairs = [(int(answer["X"]), int(answer["Y"])) for answer in answers(logic, call, 1000)]
        assert len(pairs) == len(set(pairs))
        assert set(pairs) == expected[name], texts
    assert logic.machine.choices == [] == logic.machine.trail


@pytest.mark.parametrize(
    "rules",
    [
        "p(X, Y) :- p(X, Z), edge(Z, Y).\np(X, Y) :- edge(X, Y).",
        "p(X, Y) :- edge(X, Y).\np(X, Y) :- p(X, Z), edge(Z, Y).",
        "p(X, Y) :- q(X, Z), edge(Z, Y).\np(X, X).\nq(X, Y) :- p(X, Z), edge(Z, Y).\nq(X, Y) :- edge(X, Y).",
        "p(X, Y) :- r(X, Y, _).\nr(X, Y, D) :- r(X, Z, E), edge(Z, Y), D is E + 1.\nr(X, X, 0).",
    ],
)
def test_table_takes_linear_number_of_steps(rules: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def steps(size: int) -> int:
        edges = "".join(f"edge({number}, {number + 1}).\n" for number in range(size))
        logic = prolog(f":- table p/2, q/2, r(_, _, min).\n{rules}\n{edges}")
        counter: Counter[Any] = Counter()
        tables = tables_of(logic.machine)
        monkeypatch.setattr(tables, "bind_answer", counted(tables.bind_answer, counter))
        assert int(first(logic, "aggregate_all(count, p(0, _), N)")) >= size // 2
        return counter["calls"]

    assert 0 < steps(800) < 2.5 * steps(400)


def counted(function: Any, counter: Any) -> Any:
    def call(*args: Any) -> Any:
        counter["calls"] += 1
        return function(*args)

    return call


TABLED_PREDICATES = r"""
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
"""


def test_tabled_predicates_have_all_answers() -> None:
    logic = prolog(TABLED_PREDICATES)
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
