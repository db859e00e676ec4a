"""Each operator: condition and interval of its matches."""

import pytest
from events.program_runner import ProgramRunner, outputs_of

CASES = [
    # pattern, stream, derived events
    ("a seq b", "a@1 b@2", "c@1-2"),
    ("a seq b", "a@1-2 b@2-3", ""),
    ("a seq b", "b@2 a@1", ""),
    ("a and b", "b@5-6 a@1-2", "c@1-6"),
    ("a par b", "a@1-3 b@2-4", "c@1-4"),
    ("a par b", "b@2-4 a@1-3", "c@1-4"),
    ("a par b", "a@1-2 b@2-4", ""),
    ("a or b", "b@2 a@1-4", "c@2-2 c@1-4"),
    ("a equals b", "b@1-2 a@1-2", "c@1-2"),
    ("a equals b", "b@1-2 a@1-3", ""),
    ("a meets b", "b@2-3 a@1-2", "c@1-3"),
    ("a meets b", "a@1-2 b@2.5-3", ""),
    ("a during b", "b@1-4 a@2-3", "c@1-4"),
    ("a during b", "a@1-4 b@1-4", "c@1-4"),
    ("a during b", "a@1-5 b@1-4", ""),
    ("a starts b", "a@1-2 b@1-4", "c@1-4"),
    ("a starts b", "a@1-4 b@1-4", ""),
    ("a finishes b", "b@1-4 a@2-4", "c@1-4"),
    ("a finishes b", "a@1-4 b@1-4", ""),
    ("a where true", "a@1-2", "c@1-2"),
    ("a where fail", "a@1-2", ""),
    ("a do true", "a@1-2", "c@1-2"),
    ("a do fail", "a@1-2", ""),
    ("a check (t1(S), t2(E), S < E)", "a@1-1 a@1-2", "c@1-2"),
    ("a timestamp (t1(S), t2(E), S < E)", "a@1-1 a@1-2", "c@1-2"),
    ("a event_multiply member(_, [x,y])", "a@1", "c@1-1 c@1-1"),
    ("a seq prolog(true)", "a@1-2", "c@1-2"),
    ("prolog(fail) seq a", "a@1-2", ""),
    ("query(true) seq a", "a@1", "c@1-1"),
    ("(a seq b) cnot d", "a@1 b@3", "c@1-3"),
    ("(a seq b) cnot d", "a@1 d@2 b@3", ""),
    ("(a seq b) cnot d", "a@1 d@1-2 b@3", "c@1-3"),
    ("(a seq b) cnot d", "a@1 d@2-3 b@3", "c@1-3"),
    ("(a seq b) cnot d", "d@2 a@1 b@3", ""),
    ("(a seq b where true) cnot d", "a@1 d@2 b@3", ""),
    ("a cnot d", "d@1 a@2 a@0.5", "c@0.5-0.5"),
    ("a fnot d", "a@1 d@1 a@1 a@2", "c@1-1 c@1-1"),
    ("a seq b star_times", "a@1 b@2 b@3 b@2.5", "c@1-1 c@1-2 c@1-3"),
    ("(a seq b star_times) seq d", "a@1 b@2 d@3", "c@1-3"),
    ("a ntimes 2", "a@1 a@2 a@3", "c@1-2 c@2-3"),
    ("a ntimes 1", "a@1", "c@1-1"),
    ("a seq (b ntimes 2)", "a@1 b@2 b@3", "c@1-3"),
    ("at_end(a)", "a@1-2", "c@2-2"),
    ("at_start(a)", "a@1-2", "c@1-1"),
    ("at_end(a seq b)", "a@1 b@2-3", "c@3-3"),
    ("at_start(a seq b)", "a@1-2 b@3", "c@1-1"),
    ("at_end(at_start(a))", "a@1-2", "c@1-1"),
    ("at_end(a) seq b", "a@1-2 b@3", "c@2-3"),
    ("at_start(a) seq b", "a@1-4 b@2-5", "c@1-5"),
    ("at_start(a) seq b", "b@2 a@1-4", ""),
    ("at_end(a) meets b", "a@1-2 b@2-3", "c@2-3"),
    ("at_end(a) and at_start(a)", "a@1-2", ""),
    ("at_end(a) and at_start(a)", "a@1-2 a@3-4", "c@2-3"),
    ("at_start(a) starts a", "a@1-2", ""),
    ("at_end(a seq b) within 1", "a@1 b@9", "c@9-9"),
    ("(at_end(a seq b) seq d) within 3", "a@1 b@9 d@11", "c@9-11"),
    ("at_end(a) check (t1(S), t2(E), S =:= E)", "a@1-2", "c@2-2"),
    ("at_end(a check (t1(S), t2(E), S < E))", "a@1-2 a@3", "c@2-2"),
    ("at_end(a do fail)", "a@1-2", ""),
    ("at_end(a * b)", "a@1 b@2-3", "c@3-3"),
    ("a fnot at_end(d)", "d@1-2 a@1.5 a@3", "c@1.5-1.5"),
    ("(a seq b) cnot at_end(d)", "a@1 d@0-2 b@3", ""),
    ("(a seq at_end(b)) cnot at_start(b)", "a@1 b@2-3", ""),
    ("(a seq at_end(b)) cnot at_start(b)", "a@2 b@1-3", "c@2-3"),
    ("(a seq at_end(b)) cnot at_start(d seq b)", "a@1 d@2 b@3", ""),
    ("(a and at_end(b)) fnot at_start(b)", "a@4 b@2-5", ""),
    ("(at_end(b) or a) fnot at_start(b)", "b@2-5", ""),
    ("(at_end(a seq b)) fnot at_start(b)", "a@1 b@2-5", ""),
    ("at_end(a or b) ntimes 2", "a@1-2 b@2-4", "c@2-4"),
    ("at_start(a) seq (b star_times)", "a@1-3 b@2", "c@1-1 c@1-2"),
    ("at_start(a) seq (at_end(a) star_times)", "a@1-2", "c@1-1"),
    ("aggregate(count, at_end(a), N, last(3))", "a@1-9 a@10-11", "c@9-9 c@9-11"),
    ("a forall_seq b", "a@1 a@2 b@3 b@4", "c@1-3 c@2-3"),
    ("a seq b within 2", "a@1 b@2.5 a@3 b@5", "c@1-2.5"),
    ("(a and b) within 2", "b@1 a@2.9", "c@1-2.9"),
    ("a within 1", "a@1-2 a@1-1.9", "c@1-1.9"),
    ("(a seq b within 5) seq d", "a@1 b@2 d@9", "c@1-9"),
    ("a and a", "a@1 a@2 a@3", "c@1-2 c@2-3"),
    ("a equals a", "a@1 a@1", "c@1-1"),
    ("(a seq b) and b", "a@1 b@2", "c@1-2"),
    ("a seq (b seq d)", "a@1 b@2 d@3", "c@1-3"),
    ("a seq (b or d)", "a@1 d@2", "c@1-2"),
    ("(d or (a and d)) fnot b", "a@1 d@2", "c@2-2 c@1-2"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("pattern", "stream", "expected"), CASES)
def test_operator_has_condition_and_interval(pattern: str, stream: str, expected: str) -> None:
    assert outputs_of(f"c <- {pattern}.", stream) == expected


@pytest.mark.parametrize(
    ("aggregate", "expected"),
    [
        ("count", "r(0)@1-1 r(1)@1-2 r(2)@1-3"),
        ("sum(X)", "r(0)@1-1 r(4)@1-2 r(6)@1-3"),
        ("min(X)", "r(4)@1-2 r(2)@1-3"),
        ("max(X)", "r(4)@1-2 r(4)@1-3"),
        ("avg(X)", "r(4)@1-2 r(3)@1-3"),
        ("list(X)", "r([])@1-1 r([4])@1-2 r([4,2])@1-3"),
    ],
)
def test_aggregate_has_result_for_each_repetition(aggregate: str, expected: str) -> None:
    assert (
        outputs_of(f"r(N) <- s seq aggregate({aggregate}, a(X), N).", "a(9)@0 s@1 a(4)@2 a(2)@3") == expected
    )


def test_average_may_be_float() -> None:
    assert (
        outputs_of("r(N) <- s seq aggregate(avg(X), a(X), N).", "s@1 a(1)@2 a(2)@3") == "r(1)@1-2 r(1.5)@1-3"
    )


def test_condition_filters_results() -> None:
    assert (
        outputs_of("r(N) <- s seq aggregate(count, a, N) where N > 1.", "s@1 a@2 a@3 a@4")
        == "r(2)@1-3 r(3)@1-4"
    )


def test_value_that_is_no_number_is_reported() -> None:
    program = ProgramRunner("r(N) <- s seq aggregate(sum(X), a(X), N).")
    assert program.feed("s@1 a(x)@2 a(3)@3") == "r(0)@1-1 r(3)@1-3"
    (error,) = program.errors
    assert error.message == "rule r(N), at event a(x): aggregate sum: the value is 'x': expected a number"


@pytest.mark.parametrize(
    ("rule", "stream", "expected"),
    [
        ("c(X,Y) <- a(X) seq b(Y) where X < Y", "a(1)@1 a(5)@2 b(3)@3", "c(1,3)@1-3"),
        ("c(X) <- a(X) seq (b(Y) where Y > X)", "a(2)@1 b(1)@2 b(3)@3", "c(2)@1-3"),
        ("c(X,Z) <- a(X) where Z is X * 2", "a(3)@1", "c(3,6)@1-1"),
        ("c(X) <- a(X, _) and b(_, X)", "a(1,2)@1 b(2,3)@2 b(9,1)@3", "c(1)@1-3"),
        ('c(X) <- a(f(X, 1.5, "s"))', 'a(f(1,1.5,"s"))@1 a(f(1,1,"s"))@2', "c(1)@1-1"),
        ("c(X) <- a(X, X)", "a(1,2)@1 a(2,2)@2 a(2,2.0)@3", "c(2)@2-2"),
        ("c(X) <- a(X) or b(_)", "b(1)@1 a(2)@2", "c(A)@1-1 c(2)@2-2"),
        ("c(X,Y) <- (a(X) or b(Y)) seq d(X)", "b(1)@1 d(2)@2", "c(2,1)@1-2"),
        ("c(X) <- a(X) seq b(X)", "a(Z)@1 b(7)@2", "c(7)@1-2"),
        ("c(X) <- a(X) seq b(X)", "a(f(Z))@1 b(f(7))@2 b(8)@3", "c(f(7))@1-2"),
        (
            "c(X,L) <- a(X) seq (s seq aggregate(list(Y), b(Y) where Y > X, L))",
            "a(1)@1 a(4)@1 s@2 b(2)@3 b(5)@4",
            "c(4,[])@1-2 c(1,[2])@1-3",
        ),
        (
            "c(X,W) <- a(X) seq (s seq (b(Y) where W is Y - X) star_times)",
            "a(1)@1 a(2)@1 a(3)@1 a(4)@1 s@2 b(5)@3 b(5)@4 b(6)@5",
            "c(4,A)@1-2 c(3,2)@1-3 c(2,3)@1-4",
        ),
        (
            "c(X) <- a(X) seq (s seq (p seq aggregate(max(Y), b(Y) where Y > X, _)) star_times)",
            "a(1)@1 a(2)@1 a(3)@1 a(4)@1 s@2 p@3 b(5)@4 p@5 b(2)@6 p@7 b(0)@8",
            "c(4)@1-2 c(3)@1-4 c(1)@1-6",
        ),
        (
            "c(X) <- a(X) seq (s seq ((b(Y) where Z is Y - X) where Z > X) star_times)",
            "a(1)@1 a(2)@1 a(3)@1 s@2 b(5)@3 b(4)@4",
            "c(3)@1-2 c(2)@1-3 c(1)@1-4",
        ),
        (
            "c(X,N) <- a(X) seq (s seq aggregate(count, b cnot d(X), N))",
            "a(1)@1 a(2)@1 s@2 d(2)@3 b@4 b@5",
            "c(2,0)@1-2 c(1,1)@1-4",
        ),
        (
            "c(X) <- a(X) seq (((b(Y) where Y > X) seq d(Z)) where Z > X)",
            "a(1)@1 a(5)@1 b(3)@3 d(9)@4 b(6)@5 d(4)@6 b(4)@7 d(3)@8",
            "c(1)@1-4",
        ),
        # a condition binds variables of the negated pattern
        (
            "c(X,N) <- (prolog(N is X + 1) seq (a(X) seq d)) cnot b(N)",
            "a(1)@1 b(1)@2 d@3 a(1)@4 b(2)@5 d@6",
            "c(1,2)@1-3",
        ),
        (
            "c(X) <- e(Z) seq (((a(X) seq d) where N is X + Z) cnot (b(Y) where Y =:= N))",
            "e(1)@1 a(1)@2 b(2)@3 d@4 a(1)@5 b(1)@6 d@7",
            "c(1)@1-7",
        ),
        # a condition may be decidable before its pattern is joined with the one on the left
        ("c(X) <- a(X) and ((b(Y) where Y >= X) and d(X))", "b(0)@1 d(1)@2 b(1)@3 a(1)@4", "c(1)@2-4"),
        (
            "c(X,Z) <- a(X) seq ((d(X) or e) seq (b(Y) where (Y > X, Z = Y)))",
            "a(1)@1 a(5)@1 e@2 b(3)@3 d(5)@4 b(3)@5 b(6)@6",
            "c(1,3)@1-3 c(5,6)@1-6",
        ),
        (
            "c(X,N) <- a(X) seq ((s(Y) where Y > X) seq aggregate(count, b(X), N))",
            "a(1)@1 a(5)@1 s(3)@2 b(5)@3 b(1)@4",
            "c(1,0)@1-2",
        ),
        ("c(X,Y) <- a(X) seq b(Y) star_times", "a(1)@1 b(2)@2 b(3)@3", "c(1,A)@1-1 c(1,2)@1-2"),
        ("c(X) <- a(X) seq b(_) star_times", "a(1)@1 b(2)@2 b(3)@3", "c(1)@1-1 c(1)@1-2 c(1)@1-3"),
        ("c(K) <- (a(K) seq b(K)) cnot d(K)", "a(1)@1 a(2)@1 d(1)@2 b(1)@3 b(2)@3", "c(2)@1-3"),
        ("c(K) <- (a(K) seq b) cnot (d(X) where X > K)", "a(1)@1 d(1)@2 b@3 a(2)@4 d(3)@5 b@6", "c(1)@1-3"),
        ("c(K) <- a(K) seq (b fnot d(K))", "d(1)@1 a(1)@2 a(2)@2 b@3 b@4", "c(2)@2-3"),
        ("c(X) do Y is X + 1, c2(Y) <- a(X). c2(_)", "a(1)@1", "c(1)@1-1"),
    ],
)
def test_variables_are_bound_across_patterns(rule: str, stream: str, expected: str) -> None:
    assert outputs_of(f"{rule}.", stream) == expected


def test_nested_rule_emits_its_own_event() -> None:
    assert outputs_of("c <- a seq (s(X) <- b(X) seq d).", "a@1 b(5)@2 d@3") == "s(5)@2-3 c@1-3"


@pytest.mark.parametrize("spelling", ["seq", "'seq'", "'Seq'", "'SEQ'", "*"])
def test_operator_spellings_are_equivalent(spelling: str) -> None:
    assert outputs_of(f"c <- a {spelling} b.", "a@1 b@2") == "c@1-2"


@pytest.mark.parametrize(
    ("rules", "stream", "expected"),
    [
        ("c(V,L) <- s seq aggregate(list(V), a(_), L).", "s@1 a(0)@2 a(1)@3", "c(A,[A,A])@1-3"),
        ("c(V,L) <- (s seq aggregate(list(f(V)), a(_), L)) where V = 5.", "s@1 a(0)@2", "c(5,[f(5)])@1-2"),
        ("c(V,L) <- (s seq aggregate(list(V), a(_), L)) seq e(V).", "s@1 a(0)@2 e(7)@4", "c(7,[7])@1-4"),
        ("c(L) <- s seq aggregate(list(V), a(_), L).", "s@1 a(0)@2 a(1)@3", "c([A,B])@1-3"),
    ],
)
def test_unbound_variable_of_repetition_is_shared(rules: str, stream: str, expected: str) -> None:
    assert outputs_of(rules, stream, "unrestricted").split(" ")[-1] == expected
