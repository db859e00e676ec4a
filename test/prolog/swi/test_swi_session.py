"""Goals in SWI-Prolog: solutions, cuts, errors, limits, threads, and callbacks."""

import gc
import threading

import pytest

from retalis import Limits, PrologError, RetalisError, Var, deref, functor
from retalis.prolog.machine.resource_limits import LimitError


def shown(engine, goal):
    """Return the solutions of a goal, as text."""
    return [{name: engine.show(deref(term)) for name, term in one.items()} for one in engine.query(goal)]


def values(engine, goal, name="X"):
    return [one[name] for one in shown(engine, goal)]


@pytest.mark.parametrize(
    ("goal", "found"),
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
def test_solutions(engine, goal, found):
    assert values(engine, goal) == found


def test_variables_stay_what_they_are(engine):
    (found,) = engine.query("half_open(X, Y)")
    x, y = found["X"], deref(found["Y"])
    assert deref(y[1]) is deref(x)
    assert deref(y[2]) is deref(y[3])
    (found,) = engine.query("both(X, Y), both(Y, Z)")
    assert deref(found["X"]) is deref(found["Y"]) is deref(found["Z"])


def test_a_rule_asks(program):
    engine = program("next_one(Y) <- number(X) where inc(X, Y).\nbig <- number(X) where upto(X, 5).\n")
    said = []
    engine.on_event(lambda term, start, end: said.append(engine.show(term)))
    engine.event("number(4)", 1)
    engine.event("number(7)", 2)
    assert said == ["number(4)", "next_one(5)", "number(7)", "next_one(8)", "big"]


def test_a_synchronized_query_asks(program):
    engine = program(
        "synchronized(found(Y), lookup(T, Y), [[m, T]]) <- ask(T).\n"
        "lookup(T, Y) :- prev(m, number(X), _, _, T), inc(X, Y).\n"
    )
    engine.load(goals="memorize(number(X), [], number(X), m, 10)")
    said = []
    engine.on_event(lambda term, start, end: said.append(engine.show(term)))
    engine.event("number(6)", 1)
    engine.event("ask([2, 0])", 2)
    engine.event("number(8)", 3)
    assert "found(7)" in said


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
def test_errors(engine, goal, message):
    with pytest.raises(PrologError, match=message):
        engine.query(goal)
    assert values(engine, "inc(1, X)") == ["2"]


def test_errors_are_caught_by_their_terms(engine):
    (found,) = shown(engine, "catch(bad(1), my_ball(A, B, _), true)")
    assert (found["A"], found["B"]) == ("1", '"text"')
    assert values(engine, "catch((upto(3, A), A > 1, bad(A)), my_ball(X, _, _), true)") == ["2"]


def test_solutions_that_nobody_wants_are_cleaned_up(engine):
    engine.query("marks(X, cut), !")
    assert engine.call("noted(cut)")
    engine.query("catch((marks(X, thrown), throw(oh)), oh, true)")
    assert engine.call("noted(thrown)")
    solutions = engine.query("marks(X, Y), X = 2, Y = dropped", most=1)
    assert len(solutions) == 1


def test_halt_ends_nothing(engine):
    assert not engine.call("halts")
    assert values(engine, "inc(1, X)") == ["2"]


@pytest.mark.slow
@pytest.mark.parametrize("goal", ["forever", "stubborn", "retrying", "sleeps", "upto(3, X), forever"])
def test_what_hangs_is_ended(program, goal):
    engine = program(seconds=0.1)
    with pytest.raises(LimitError, match="seconds"):
        engine.query(goal)
    engine.logic.limits = Limits()
    assert values(engine, "inc(1, X)") == ["2"]


@pytest.mark.parametrize("goal", ["forever", "upto(3, X), forever"])
def test_inferences_are_limited(program, goal):
    engine = program(inferences=50_000)
    with pytest.raises(PrologError, match="inferences"):
        engine.query(goal)
    assert values(engine, "findall(A, upto(3, A), X)") == ["[1,2,3]"]


@pytest.mark.slow
def test_inferences_are_limited_for_who_catches_that(program):
    with pytest.raises(PrologError, match="inferences"):
        program(inferences=50_000).query("retrying")


@pytest.mark.slow
def test_memory_is_limited(program):
    with pytest.raises(PrologError, match="memory"):
        program(megabytes=50).query("piles")
    assert program().call("forgets")


@pytest.mark.parametrize(
    ("goal", "found"),
    [
        ("call_with_time_limit(0.05, forever)", "time_limit_exceeded"),
        ("call_with_inference_limit(forever, 1000, R), throw(R)", "inference_limit_exceeded"),
    ],
)
def test_limits_of_calls_hold(engine, goal, found):
    assert values(engine, f"catch(({goal}), X, true)") == [found]


def test_a_limit_is_caught_once(program):
    engine = program(seconds=0.05)
    assert values(engine, "catch(forever, error(X, _), true)") == ["resource_error(seconds)"]
    with pytest.raises(LimitError):
        engine.query("catch(forever, _, true), forever")


def test_it_asks_back(engine):
    assert values(engine, "asks(near(a, _), X)") == ["[near(a,b),near(a,c)]"]
    assert values(engine, "asks(upto(3, _), X)") == ["[upto(3,1),upto(3,2),upto(3,3)]"]
    assert values(engine, "asks(asks(near(a, A), L), X)")[0].endswith("[near(a,b),near(a,c)])]")


def test_its_errors_come_back(engine):
    with pytest.raises(PrologError, match="Unknown procedure: farther/1"):
        engine.query("asks(farther(a), X)")
    assert values(engine, "asks_safely(throw(oh(1)), X)") == ["oh(1)"]
    assert values(engine, "asks_safely(forever_not_there, error(X, _))")[0].startswith("existence_error")


def test_limits_hold_for_what_it_asks_back(program):
    engine = program("turning :- turning.\n", seconds=0.05)
    with pytest.raises(LimitError, match="seconds"):
        engine.query("asks(turning, X)")
    engine.logic.limits = Limits()
    assert values(engine, "inc(1, X)") == ["2"]


def test_it_reads_memories(folder, program):
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
    for at in (1, 2, 3):
        engine.event(f"number({at}0)", at)
    assert values(engine, "newest([2, 0], X)") == ["20"]
    assert values(engine, "between_them([2, 0], [3, 0], X)") == ["20"]
    assert values(engine, "all(X)") == ["[30,20,10]"]


def test_threads_take_turns(engine):
    found, faults = [], []

    def ask():
        try:
            found.append(values(engine, "upto(2, A), inc(A, X)"))
        except RetalisError as error:
            faults.append(error)

    threads = [threading.Thread(target=ask) for _ in range(10)]
    for one in threads:
        one.start()
    for one in threads:
        one.join()
    assert (found, faults) == ([["2", "3"]] * 10, [])


def test_threads_have_stacks_of_their_own(engine):
    """What looks how much of the C stack is left, as tabling does, works in each thread, also in those before."""
    found = []
    deeper = [threading.Thread(target=lambda: found.append(values(engine, "count(2, X)"))) for _ in range(4)]
    found.append(values(engine, "count(1, X)"))
    for one in deeper:
        one.start()
        one.join()
    found.append(values(engine, "reach(39, X)"))
    assert sorted(found.pop()) == ["40", "41"]
    assert found == [["40"], *[["39"]] * 4]


def test_solutions_belong_to_a_thread(program):
    logic = program().logic
    solutions = logic.solutions((functor("upto", 2), 3, Var()))
    next(solutions)
    faults = []

    def go_on():
        with pytest.raises(RetalisError, match="by the thread that requested the first one"):
            next(solutions)
        faults.append(True)

    other = threading.Thread(target=go_on)
    other.start()
    other.join()
    solutions.close()
    assert faults == [True]
    assert logic.once((functor("inc", 2), 1, 2))


def test_solutions_are_given_up_in_another_thread(engine):
    def ask():
        assert len(engine.query("upto(1000, X), upto(1000, Y)", most=3)) == 3

    one = threading.Thread(target=ask)
    one.start()
    one.join()
    assert values(engine, "upto(2, X)") == ["1", "2"]


def test_engines_come_and_go(program):
    for number in range(5):
        engine = program(f"own({number}).\n")
        assert values(engine, "upto(3, X), own(_), !") == ["1"]
    del engine
    gc.collect()


def test_many_goals_stay_open_at_once(program):
    engine = program("deep(0, []).\ndeep(N, [X|L]) :- N > 0, upto(2, X), M is N - 1, deep(M, L).\n")
    assert values(engine, "deep(300, L), !, length(L, X)") == ["300"]
    assert values(engine, "findall(L, deep(4, L), A), length(A, X)") == ["16"]
