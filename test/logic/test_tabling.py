"""Tabled predicates end where plain ones recurse for ever, with all answers and each once."""

import random

import pytest
from logic.support import answers, first, prolog

from retalis.logic import Limits
from retalis.syntax import read_term

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
def logic():
    made = prolog(PROGRAM)
    made.limits = Limits(inferences=5_000_000)
    return made


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
        ("findall(_T, (member(_T, ['1', '1+1*(1+1)', '(1)*1', '1+', '', '2']), reads(_T)), L)", None),
    ],
)
def test_recursion_ends(logic, goal, value):
    found = first(logic, goal)
    found = found["L"] if isinstance(found, dict) else found
    assert found == (value or "['1','1+1*(1+1)','(1)*1']")


def test_a_cut_leaves_no_half_table(logic):
    assert first(logic, "once(path(a, X))") == "b"
    assert len(answers(logic, "path(a, X)")) == 4


def test_an_error_leaves_no_half_table():
    logic = prolog(":- table r/1.\nr(X) :- r(Y), X is Y + 1, (X > 2 -> throw(big) ; true).\nr(1).")
    for _ in range(2):
        assert answers(logic, "r(X)") == ["big"]
    assert logic.machine.choices == []


def test_what_a_caught_error_ended_is_not_looked_for_again_and_again():
    logic = prolog(
        ":- table p/1, c/1.\np(X) :- p(Y), X is Y + 1, X < 3.\np(0).\np(9) :- catch(c(_), _, true).\n"
        "c(1).\nc(_) :- p(_), throw(oops)."
    )
    logic.limits = Limits(inferences=100_000)
    assert first(logic, "findall(_X, p(_X), _L), msort(_L, L)") == "[0,1,2,9]"
    assert answers(logic, "c(_)") == ["oops"]


@pytest.mark.parametrize(
    ("clauses", "call", "found"),
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
def test_calls_and_answers_with_terms_of_all_kinds(clauses, call, found):
    logic = prolog(f":- table p/0, p/1, p/2.\n{clauses}")
    for _ in range(2):  # evaluated, and from the table
        assert first(logic, f"term_to_atom(_G, `{call}`), findall(_G, _G, L)") == found


@pytest.mark.parametrize("seed", range(30))
def test_closure_of_a_random_graph(seed):
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
def test_an_interrupt_leaves_no_half_table(run):
    logic = prolog(":- table r/1.\nr(X) :- r(Y), waits, X is Y + 1, X < 4.\nr(1).")
    interrupts = [KeyboardInterrupt]

    def waits(machine):
        if interrupts:
            raise interrupts.pop()
        return True

    logic.define("waits", 0, waits)
    with pytest.raises(KeyboardInterrupt):
        run(logic, read_term("r(X)", logic.operators).term)
    assert [answer["X"] for answer in answers(logic, "r(X)")] == ["1", "2", "3"]


def test_a_call_with_a_cyclic_argument_ends():
    logic = prolog(":- table p/1.\np(_).")
    logic.limits = Limits(inferences=100_000)
    assert answers(logic, "X = f(Y, X), p(X)") == ["resource_error(inferences)"]
