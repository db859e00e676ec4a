"""Resource limits: runaway goals end with an error, and the engine continues."""

import pickle
from itertools import islice
from typing import Any, List

import pytest
from prolog.goal_answers import first, prolog
from recording_reports import RecordingReports

from retalis import Engine, Limits, PrologError, Settings, UsageError, Var, atom, functor
from retalis.foundation.interrupts import Interrupt, postpone
from retalis.foundation.limit_checks import check_limits
from retalis.prolog.syntax.term_writer import writeq

PROGRAM = """
loop :- loop.
ping(X) :- pong(X).
pong(X) :- ping(X).
count(N) :- M is N + 1, count(M).
deep(N, s(R)) :- M is N + 1, deep(M, R).
left(X) :- left(Y), X = f(Y).
grow(L) :- grow([1,2,3|L]).
double(L) :- append(L, L, M), double(M).
store(N) :- assertz(kept(N)), M is N + 1, store(M).
choose :- choose.
choose :- true.
branch(N) :- M is N + 1, ( branch(M) ; true ).
all :- findall(X, repeat, _), write(X).
again :- catch(loop, _, again).
"""

RUNAWAY = [
    "loop",
    "ping(1)",
    "count(0)",
    "repeat, fail",
    "between(1, inf, X), fail",
    "choose",
    "branch(0)",
    "left(X)",
    "deep(0, X)",
    "grow([])",
    "all",
    "forall(repeat, true)",
    "\\+ (repeat, fail)",
    "again",
    "catch(loop, _, loop)",
    "maplist([X]>>loop, [1])",
    "aggregate_all(count, repeat, N)",
]


def formal(error: Any) -> str:
    return writeq(error.term[1])


@pytest.fixture
def engine() -> Engine:
    loaded_engine = Engine(settings=Settings(limits=Limits(seconds=0.3, inferences=400_000, megabytes=300)))
    loaded_engine.load(rules=PROGRAM)
    return loaded_engine


@pytest.mark.slow
@pytest.mark.parametrize("goal", RUNAWAY)
def test_runaway_goal_exceeds_limit(engine: Engine, goal: str) -> None:
    with pytest.raises(PrologError) as caught:
        engine.query(goal)
    assert formal(caught.value).startswith("resource_error")
    assert engine.call("X = 1")


def test_growing_steps_exceed_limit(engine: Engine) -> None:
    with pytest.raises(PrologError) as caught:
        engine.query("double([1])")
    assert formal(caught.value).startswith("resource_error")
    assert engine.call("X = 1")


@pytest.mark.parametrize(
    ("goal", "error"),
    [
        ("numlist(1, 100000000000, L)", "resource_error"),
        ("length(L, 100000000000)", "resource_error"),
        ("functor(T, f, 100000000000)", "resource_error"),
        ("format('~*c', [100000000000, 0'x])", "resource_error"),
        ("tab(100000000000)", "resource_error"),
        ("X is 2 ** (2 ** 60)", "resource_error"),
        ("X is 1 << (1 << 60)", "resource_error"),
        ("X is 7 ^ (7 ^ (7 ^ 7))", "resource_error"),
        ("shell(ls)", "existence_error(procedure"),
        ("shell('ls', S)", "existence_error(procedure"),
        ("system(ls)", "existence_error(procedure"),
        ("exec(ls)", "existence_error(procedure"),
        ("process_create(path(ls), [], [])", "existence_error(procedure"),
        ("tcp_socket(S)", "existence_error(procedure"),
        ("http_open('http://localhost', S, [])", "existence_error(procedure"),
        ("python_call(os, system)", "existence_error(procedure"),
        ("load_foreign_library(x)", "existence_error(procedure"),
        ("delete_file('/tmp/x')", "existence_error(procedure"),
        ("open('/etc/passwd', read, S)", "permission_error"),
        ("see('/etc/passwd')", "permission_error"),
        ("tell('/tmp/x')", "permission_error"),
        ("getenv('HOME', X)", "permission_error"),
        ("use_foreign(os)", "permission_error"),
        ("halt", "permission_error"),
    ],
)
def test_large_step_or_access_to_system_is_refused(engine: Engine, goal: str, error: str) -> None:
    with pytest.raises(PrologError) as caught:
        engine.query(goal)
    assert formal(caught.value).startswith(error)


@pytest.mark.parametrize(
    ("limits", "resource", "goal"),
    [
        (Limits(seconds=0.2), "seconds", "loop"),
        (Limits(inferences=100_000), "inferences", "loop"),
        (Limits(megabytes=20), "memory", "grow([])"),
    ],
)
def test_single_limit_ends_goal(limits: Any, resource: str, goal: str) -> None:
    engine = Engine(settings=Settings(limits=limits))
    engine.load(rules=PROGRAM)
    with pytest.raises(PrologError) as caught:
        engine.query(goal)
    assert formal(caught.value) == f"resource_error({resource})"


def test_program_catches_exceeded_limit(engine: Engine) -> None:
    (answer,) = engine.query("catch(loop, error(resource_error(R), _), true)")
    assert engine.show(answer["R"]) in ("seconds", "inferences")


def test_new_budget_needs_no_check() -> None:
    for limits in (Limits(), Limits(seconds=1.0)):
        budget = Engine(settings=Settings(limits=limits)).logic.machine.budget
        assert not budget.limited
        assert not budget.needs_check


@pytest.mark.parametrize(
    "goal", ["numlist(1, 1000000, L), msort(L, M), M = [X|_]", "length(L, 3000000), X = L"]
)
def test_inline_goals_of_rules_are_limited(goal: str) -> None:
    reports = RecordingReports()
    engine = Engine(settings=Settings(limits=Limits(inferences=2000)), reports=reports)
    engine.load(rules=f"answer(X) do ({goal}) <- e.")
    engine.event("e", 1)
    assert ["resource" in error or "inferences" in error for error in reports.texts] == [True]


CALLERS = "loop :- loop.\ncount(0).\ncount(N) :- N > 0, M is N - 1, count(M).\n"


@pytest.mark.parametrize("operator", ["where", "do"])
@pytest.mark.parametrize(
    ("goal", "kind", "result"),
    [
        ("catch(call_with_time_limit(0.1, new_event(in, [1,1])), R, true)", "time", "time_limit_exceeded"),
        (
            "call_with_inference_limit(new_event(in, [1,1]), 10000, R)",
            "inference",
            "inference_limit_exceeded",
        ),
    ],
)
def test_rule_goal_exceeds_limit_of_caller(
    operator: str, goal: str, kind: str, result: str, caplog: pytest.LogCaptureFixture
) -> None:
    engine = Engine()
    engine.load(rules=f"{CALLERS}out <- in {operator} loop.\nseen <- in.")
    events: List[Any] = []
    engine.on_event(lambda term, start, end: events.append(engine.show(term)))
    (answer,) = engine.query(goal)
    assert engine.show(answer["R"]) == result
    assert events == ["in", "seen"]
    assert f"goal loop: the {kind} limit of a calling goal has been reached" in caplog.text


def test_limit_set_by_rule_goal_is_its_own(caplog: pytest.LogCaptureFixture) -> None:
    engine = Engine()
    engine.load(rules=f"{CALLERS}out <- in where call_with_time_limit(0.05, loop).")
    assert engine.call("call_with_time_limit(10, new_event(in, [1,1]))")
    assert "Unhandled exception: time_limit_exceeded" in caplog.text


def test_inferences_of_caller_count_for_rule_goals(caplog: pytest.LogCaptureFixture) -> None:
    engine = Engine(settings=Settings(limits=Limits(inferences=100_000)))
    engine.load(rules=f"{CALLERS}out <- in where (count(45000), \\+ fail).")
    assert engine.call("count(45000), new_event(in, [1,1])")
    assert caplog.text == ""
    assert engine.call("count(85000), new_event(in, [1,1])")
    assert caplog.text.count("Not enough resources: inferences") == 1


def test_second_limit_is_final_after_rule_goal() -> None:
    engine = Engine(settings=Settings(limits=Limits(inferences=100_000)))
    engine.load(rules=f"{CALLERS}out <- in where (count(10), \\+ fail).")
    with pytest.raises(PrologError, match="inferences"):
        engine.call("catch(loop, _, true), new_event(in, [1,1]), catch(loop, _, true)")


def interrupt(machine: Any, *arguments: Any) -> bool:
    postpone(Interrupt())
    return True


def test_interrupt_removes_limits_of_calls() -> None:
    engine = Engine()
    budget = engine.logic.machine.budget
    engine.logic.define("interrupt", 0, interrupt)
    for call in ("call_with_time_limit(60, {})", "call_with_inference_limit({}, 10000, _)"):
        with pytest.raises(Interrupt):
            engine.call(call.format("(interrupt, repeat, fail)"))
        assert not budget.alarms
        assert not budget.ceilings


@pytest.mark.parametrize("limits", [Limits(), Limits(inferences=1000)])
def test_interrupt_undoes_bindings(limits: Any) -> None:
    engine = Engine(settings=Settings(limits=limits))
    engine.logic.define("interrupt", 1, interrupt)
    engine.load(rules="b <- a(X) where (Y = f(X, Z), Z = 3, interrupt(Y), repeat, fail).")
    with pytest.raises(Interrupt):
        engine.event("a(1)", 1)
    assert not engine.logic.machine.trail


def test_limit_in_function_does_not_repeat_call() -> None:
    logic = prolog("p(X, Y) :- q(X, Y).\nq(X, Y) :- long(X, Y).")
    calls: List[Any] = []

    def long(value: Any) -> Any:
        calls.append(value)
        check_limits(1_000_000)
        return value

    logic.define_function("long", 2, long)
    logic.limits = Limits(inferences=10_000)
    x, y = Var(), Var()
    goal = logic.compile_goal((functor("p", 2), x, y), [x], [y])
    for number in (1, 2):
        with pytest.raises(PrologError, match="inferences"):
            goal.first_solution((number,))
    assert calls == [1, 2]
    assert first(logic, "catch(p(3, _), error(resource_error(inferences), _), true)") == {}


def test_work_between_solutions_counts_with_query() -> None:
    logic = prolog("work(0) :- !.\nwork(N) :- M is N - 1, work(M).\nmany :- repeat, work(6000).")
    logic.limits = Limits(inferences=20_000)
    solutions = logic.solutions(functor("call", 1)(atom("many")))
    next(solutions)
    with pytest.raises(PrologError, match="inferences"):
        list(islice((logic.once(functor("work", 1)(6000)) for _ in solutions), 3))
    solutions.close()
    assert not logic.machine.budget.running
    assert logic.once(functor("work", 1)(6000))


def test_limits_accept_integers_and_floats() -> None:
    inferences: Any = 1e6
    limits = Limits(seconds=1, inferences=inferences, megabytes=200.0)
    assert tuple(limits) == (1.0, 1_000_000, 200.0, 1.0)
    assert isinstance(limits.inferences, int)
    assert limits._replace(seconds=None) == Limits(None, 1_000_000, 200)
    assert pickle.loads(pickle.dumps(limits)) == limits


@pytest.mark.parametrize("name", Limits._fields)
@pytest.mark.parametrize(
    "value", [True, "1", -1, -0.5, float("nan"), float("inf"), 10**400, [1], 1 + 0j], ids=repr
)
def test_invalid_limits_are_refused(name: Any, value: Any) -> None:
    with pytest.raises(UsageError, match=f"^{name}: expected a (whole )?number from 0 to 1e"):
        Limits(**{name: value})
    with pytest.raises(UsageError, match=f"^{name}: "):
        Limits()._replace(**{name: value})


def test_fractional_inferences_are_refused() -> None:
    with pytest.raises(UsageError, match="^inferences: expected a whole number from 0 to 1e.20, found 1.5$"):
        Limits(inferences=1.5)  # type: ignore[arg-type]


@pytest.mark.slow
def test_fractional_megabytes_end_event(caplog: pytest.LogCaptureFixture) -> None:
    engine = Engine(settings=Settings(limits=Limits(seconds=60.0, megabytes=5.0)))
    engine.load(rules=PROGRAM + "null_event do grow([]) <- in.")
    engine.event("in", 1)
    assert caplog.text.count("Not enough resources: memory") == 1
