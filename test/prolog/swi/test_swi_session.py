"""Goals in SWI-Prolog: solutions, cuts, errors, limits, threads, and callbacks."""

import gc
from pathlib import Path
from typing import Any, Dict, List

import pytest
from asserting_accessors import compound
from checked_threads import CheckedThread

from retalis import Limits, PrologError, RetalisError, Var, deref, functor
from retalis.prolog.machine.resource_limits import LimitError
from retalis.prolog.swi.swi_session import start


def shown(engine: Any, goal: str) -> List[Dict[Any, Any]]:
    """Return the solutions of a goal, as text."""
    return [
        {name: engine.show(deref(term)) for name, term in solution.items()} for solution in engine.query(goal)
    ]


def values(engine: Any, goal: str, name: str = "X") -> List[Any]:
    return [solution[name] for solution in shown(engine, goal)]


@pytest.mark.parametrize(
    ("goal", "expected"),
    [
        ("inc(3, X)", ["4"]),
        ("inc(3, 4), X = yes", ["yes"]),
        ("inc(3, 5)", []),
        ("upto(3, X)", ["1", "2", "3"]),
        ("upto(0, X)", []),
        ("upto(3, 2), X = yes", ["yes"]),
        ("upto(3, X), X > 1", ["2", "3"]),
        ("upto(2, A), upto(2, B), X = A/B", ["1/1", "1/2", "2/1", "2/2"]),
        ("upto(3, X), !", ["1"]),
        ("upto(3, A), upto(A, B), X = A/B, B > 1, !", ["2/2"]),
        ("once(upto(3, X))", ["1"]),
        ("findall(A, upto(5, A), X)", ["[1,2,3,4,5]"]),
        ("findnsols(2, A, upto(5, A), X)", ["[1,2]", "[3,4]", "[5]"]),
        ("(upto(3, X), X > 2 -> true ; X = none)", ["3"]),
        ("\\+ upto(3, 7), X = yes", ["yes"]),
        ("forall(upto(3, A), upto(5, A)), X = yes", ["yes"]),
        ("both(f(A, B), f(1, X)), X = B, B = 2", ["2"]),
        ("half_open(X, Y), Y = f(1, 2, 2)", ["1"]),
        ("fd(A, B), X = A-B", ["1-2", "1-3", "2-3"]),
        ("count(1, X)", ["40"]),
        ("near(a, A), both(A, X)", ["b", "c"]),
    ],
)
def test_goal_has_all_solutions(engine: Any, goal: str, expected: List[str]) -> None:
    assert values(engine, goal) == expected


def test_shared_variables_stay_shared(engine: Any) -> None:
    (answer,) = engine.query("half_open(X, Y)")
    x, y = answer["X"], compound(answer["Y"])
    assert deref(y[1]) is deref(x)
    assert deref(y[2]) is deref(y[3])
    (answer,) = engine.query("both(X, Y), both(Y, Z)")
    assert deref(answer["X"]) is deref(answer["Y"]) is deref(answer["Z"])


def test_rule_calls_swi_predicate(program: Any) -> None:
    engine = program("next_one(Y) <- number(X) where inc(X, Y).\nbig <- number(X) where upto(X, 5).\n")
    outputs: List[Any] = []
    engine.on_event(lambda term, start, end: outputs.append(engine.show(term)))
    engine.event("number(4)", 1)
    engine.event("number(7)", 2)
    assert outputs == ["number(4)", "next_one(5)", "number(7)", "next_one(8)", "big"]


def test_synchronized_query_calls_swi_predicate(program: Any) -> None:
    engine = program(
        "synchronized(answer(Y), lookup(T, Y), [[m, T]]) <- ask(T).\n"
        "lookup(T, Y) :- prev(m, number(X), _, _, T), inc(X, Y).\n"
    )
    engine.load(goals="memorize(number(X), [], number(X), m, 10)")
    outputs: List[Any] = []
    engine.on_event(lambda term, start, end: outputs.append(engine.show(term)))
    engine.event("number(6)", 1)
    engine.event("ask([2, 0])", 2)
    engine.event("number(8)", 3)
    assert "answer(7)" in outputs


@pytest.mark.parametrize(
    ("goal", "message"),
    [
        ("bad(oh)", r"Unhandled exception: my_ball\(oh,\"text\",_\w+\)"),
        ("hard(_)", "Arguments are not sufficiently instantiated"),
        ("inc(a, _)", "Type error: `evaluable' expected, found `a/0'"),
        ("third(_)", "a rational number of SWI-Prolog cannot be converted to a term: '1r3'"),
        ("stream(_)", "a stream, a clause or another handle"),
        ("swi_dict(_)", "a dict of SWI-Prolog cannot be converted to a term"),
        ("constrained(_)", "has constraints in SWI-Prolog"),
        ("curious(_)", "a compound term without arguments"),
        ("cyclic(_)", "term_size"),
    ],
)
def test_errors_and_unsupported_terms_are_errors(engine: Any, goal: str, message: str) -> None:
    with pytest.raises(PrologError, match=message):
        engine.query(goal)
    # The session can be used after the error.
    assert values(engine, "inc(1, X)") == ["2"]


def test_error_of_swi_is_caught_by_its_term(engine: Any) -> None:
    (answer,) = shown(engine, "catch(bad(1), my_ball(A, B, _), true)")
    assert (answer["A"], answer["B"]) == ("1", '"text"')
    assert values(engine, "catch((upto(3, A), A > 1, bad(A)), my_ball(X, _, _), true)") == ["2"]


def test_cut_and_error_run_cleanup_in_swi(engine: Any) -> None:
    assert engine.call("forgets")
    engine.query("marks(X, cut), !")
    assert engine.call("noted(cut)")
    engine.query("catch((marks(X, thrown), throw(oh)), oh, true)")
    assert engine.call("noted(thrown)")
    assert len(engine.query("marks(X, Y), X = 2, Y = dropped", most=1)) == 1
    # The variable is bound here only, so the cleanup in SWI-Prolog sees it unbound.
    assert engine.call("noted(X), var(X)")
    assert engine.call("forgets")


def test_halt_does_not_end_process(engine: Any) -> None:
    assert not engine.call("halts")
    assert values(engine, "inc(1, X)") == ["2"]


@pytest.mark.slow
@pytest.mark.parametrize("goal", ["forever", "stubborn", "retrying", "sleeps", "upto(3, X), forever"])
def test_endless_goal_exceeds_seconds(program: Any, goal: str) -> None:
    engine = program(seconds=0.1)
    with pytest.raises(LimitError, match="seconds"):
        engine.query(goal)
    engine.logic.limits = Limits()
    assert values(engine, "inc(1, X)") == ["2"]


@pytest.mark.parametrize("goal", ["forever", "upto(3, X), forever"])
def test_endless_goal_exceeds_inferences(program: Any, goal: str) -> None:
    engine = program(inferences=50_000)
    with pytest.raises(PrologError, match="inferences"):
        engine.query(goal)
    assert values(engine, "findall(A, upto(3, A), X)") == ["[1,2,3]"]


@pytest.mark.slow
def test_catching_goal_exceeds_inferences(program: Any) -> None:
    with pytest.raises(PrologError, match="inferences"):
        program(inferences=50_000).query("retrying")


@pytest.mark.slow
def test_growing_goal_exceeds_memory(program: Any) -> None:
    with pytest.raises(PrologError, match="memory"):
        program(megabytes=50).query("piles")
    assert program().call("forgets")


@pytest.mark.parametrize(
    ("goal", "expected"),
    [
        ("call_with_time_limit(0.05, forever)", "time_limit_exceeded"),
        ("call_with_inference_limit(forever, 1000, R), throw(R)", "inference_limit_exceeded"),
    ],
)
def test_limits_of_calls_end_swi_goal(engine: Any, goal: str, expected: str) -> None:
    assert values(engine, f"catch(({goal}), X, true)") == [expected]


def test_exceeded_limit_is_caught_once(program: Any) -> None:
    engine = program(seconds=0.05)
    assert values(engine, "catch(forever, error(X, _), true)") == ["resource_error(seconds)"]
    with pytest.raises(LimitError):
        engine.query("catch(forever, _, true), forever")


def test_swi_goal_calls_program(engine: Any) -> None:
    assert values(engine, "asks(near(a, _), X)") == ["[near(a,b),near(a,c)]"]
    assert values(engine, "asks(upto(3, _), X)") == ["[upto(3,1),upto(3,2),upto(3,3)]"]
    assert values(engine, "asks(asks(near(a, A), L), X)")[0].endswith("[near(a,b),near(a,c)])]")


def test_error_of_callback_is_raised(engine: Any) -> None:
    with pytest.raises(PrologError, match="Unknown procedure: farther/1"):
        engine.query("asks(farther(a), X)")
    assert values(engine, "asks_safely(throw(oh(1)), X)") == ["oh(1)"]
    assert values(engine, "asks_safely(forever_not_there, error(X, _))")[0].startswith("existence_error")


def test_callback_exceeds_limit(program: Any) -> None:
    engine = program("turning :- turning.\n", seconds=0.05)
    with pytest.raises(LimitError, match="seconds"):
        engine.query("asks(turning, X)")
    engine.logic.limits = Limits()
    assert values(engine, "inc(1, X)") == ["2"]


def test_swi_goal_reads_memories(folder: Path, program: Any) -> None:
    (folder / "reading.pl").write_text(
        ":- module(reading, [newest/2, between_them/3, all/1]).\n"
        "newest(At, X) :- prev(m, number(X), _, _, At).\n"
        "between_them(Low, High, X) :- next(m, number(X), _, _, Low, High).\n"
        "all(L) :- findall(X, access_mem(m, number(X), _), L).\n"
    )
    engine = program()
    engine.load(
        rules=":- use_swi('reading.pl').", goals="memorize(number(X), [], number(X), m, 10)", folder=folder
    )
    for time in (1, 2, 3):
        engine.event(f"number({time}0)", time)
    assert values(engine, "newest([2, 0], X)") == ["20"]
    assert values(engine, "between_them([2, 0], [3, 0], X)") == ["20"]
    assert values(engine, "all(X)") == ["[30,20,10]"]


def test_threads_query_in_turn(engine: Any) -> None:
    results: List[Any] = []
    threads = [
        CheckedThread(lambda: results.append(values(engine, "upto(2, A), inc(A, X)"))) for _ in range(10)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.end()
    assert results == [["2", "3"]] * 10


def test_tabling_works_in_each_thread(engine: Any) -> None:
    """Tabling measures the free part of the C stack, which differs between threads."""
    results: List[Any] = []
    deeper = [CheckedThread(lambda: results.append(values(engine, "count(2, X)"))) for _ in range(4)]
    results.append(values(engine, "count(1, X)"))
    for thread in deeper:
        thread.start()
        thread.end()
    results.append(values(engine, "reach(39, X)"))
    assert sorted(results.pop()) == ["40", "41"]
    assert results == [["40"], *[["39"]] * 4]


def test_solutions_of_other_thread_are_refused(program: Any) -> None:
    logic = program().logic
    solutions = logic.solutions((functor("upto", 2), 3, Var()))
    next(solutions)

    def continue_in_thread() -> None:
        with pytest.raises(RetalisError, match="by the thread that requested the first one"):
            next(solutions)

    thread = CheckedThread(continue_in_thread)
    thread.start()
    try:
        thread.end()
    finally:
        solutions.close()
    assert logic.once((functor("inc", 2), 1, 2))


def test_unfinished_solutions_of_thread_are_closed(engine: Any) -> None:
    def query() -> None:
        assert len(engine.query("upto(1000, X), upto(1000, Y)", most=3)) == 3

    thread = CheckedThread(query)
    thread.start()
    thread.end()
    assert values(engine, "upto(2, X)") == ["1", "2"]


def test_new_engines_reuse_swi(program: Any) -> None:
    runtime = start()
    assert program().call("forgets")
    gc.collect()
    engine_count = len(runtime.engines)
    for number in range(5):
        engine = program(f"own({number}).\n")
        assert values(engine, "upto(3, _), own(X), !") == [str(number)]
        # The clauses of the file are those of the first engine.
        assert values(engine, "noted(X)") == [str(earlier) for earlier in range(number)]
        engine.query(f"marks(_, {number}), !")
    assert engine.call("forgets")
    assert start() is runtime
    del engine
    gc.collect()
    assert len(runtime.engines) == engine_count


def test_many_open_goals_keep_their_solutions(program: Any) -> None:
    engine = program("deep(0, []).\ndeep(N, [X|L]) :- N > 0, upto(2, X), M is N - 1, deep(M, L).\n")
    assert values(engine, "deep(300, L), !, length(L, X)") == ["300"]
    assert values(engine, "findall(L, deep(4, L), A), length(A, X)") == ["16"]
