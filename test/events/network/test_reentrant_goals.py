"""Goals of a stream operator that emit events for it, reset it or change its flags."""

import pytest

from retalis import Engine
from retalis.events.dispatch.dispatcher import Dispatcher
from retalis.events.network.stream_node import ReentrancyQueue

FOLD = """
w(S) <- aggregate(fold(none, step, same, X), a(X), S, {window}).
:- dynamic done/0.
none([]).
step(X, S, [X|S]) :- ( X =:= 2, \\+ done -> assertz(done), {goal} ; true ).
same(S, S).
"""


def run(rules):
    """Return an engine, what happens in it but for its input, and what it reports."""
    engine, seen, reports = Engine(), [], []
    own = engine.rules
    own.on_error = own.on_warning = lambda error: reports.append(error.message)
    engine.load(rules=rules)
    engine.on_event(
        lambda term, start, end: (
            None if engine.show(term).startswith(("a(", "tick")) else seen.append(engine.show(term))
        )
    )
    return engine, seen, reports


EVENT, RESET, FLAG = "event(a(9),[2,2])", "reset_db", "set_etalis_flag(revision_flag,on)"


@pytest.mark.parametrize(
    ("window", "goal", "said"),
    [
        ("last(10)", EVENT, "w([1]) w([2,1]) w([9,2,1]) w([3,9,2,1])"),
        ("last(10)", RESET, "w([1]) w([2,1]) w([3])"),
        ("last(10)", FLAG, "w([1]) w([2,1]) w([3,2,1])"),
        ("last(10)", f"reset_db, {EVENT}", "w([1]) w([2,1]) w([9]) w([3,9])"),
        ("last(10)", f"{FLAG}, {EVENT}", "w([1]) w([2,1]) w([9,2,1]) w([3,9,2,1])"),
        ("last(2, events)", EVENT, "w([1]) w([2,1]) w([9,2]) w([3,9])"),
        ("every(2, events)", EVENT, "w([2,1]) w([3,9])"),
        ("every(2, events)", RESET, "w([2,1])"),
        ("running(every(2, events))", EVENT, "w([1]) w([2,1]) w([9]) w([3,9])"),
        ("running(every(5))", RESET, "w([1]) w([2,1]) w([3])"),
        ("every(5)", "event(a(9),[6,6])", "w([3,2,1]) w([9])"),
        ("every(5)", RESET, "w([3,2,1])"),
        ("every(5, first)", "event(a(9),[17,17])", "w([3,2,1]) w([9])"),
        ("last(8, every(4))", RESET, "w([3,2,1])"),
    ],
)
def test_what_goals_of_a_fold_do_to_its_window_waits_until_the_event_is_taken(window, goal, said):
    engine, seen, reports = run(FOLD.format(window=window, goal=goal))
    for number in (1, 2, 3):
        engine.event(f"a({number})", number)
    engine.event("tick", 4 if "every(4)" in window else 7)
    engine.event("tick", 40)
    assert " ".join(seen) == said
    assert reports == []


@pytest.mark.parametrize(
    ("goal", "said"),
    [
        (EVENT, "w([1,2,9]) w([9,3,4])"),  # two ways ask: one goes on, in another the match would begin
        (RESET, "w([3,4,5])"),
        (FLAG, "w([1,2,3])"),
        (f"{RESET}, {EVENT}", "w([9,3,4])"),
    ],
)
def test_what_a_condition_of_a_step_does_to_its_window_waits_until_the_event_is_taken(goal, said):
    engine, seen, reports = run(
        f"w(S) <- aggregate(list(X), a(X), S, steps([s(3) where (X =\\= 2 ; {goal})]))."
    )
    for number in range(1, 6):
        engine.event(f"a({number})", number)
    assert " ".join(seen) == said
    assert reports == []


@pytest.mark.parametrize("goal", ["del_event_rule(own)", "reset_etalis"])
def test_a_rule_that_is_taken_out_by_its_own_goal_says_what_it_had_found(goal):
    engine, seen, _ = run("own : " + FOLD.format(window="last(10)", goal=goal).lstrip())
    for number in (1, 2, 3):
        engine.event(f"a({number})", number)
    assert seen == ["w([1])", "w([2,1])"]
    assert engine.rules.rules == []


def test_a_chain_of_events_that_makes_itself_anew_ends():
    rules = "w(S) <- aggregate(fold(none, step, same, X), a(X), S, last(1, events)).\n"
    engine, seen, reports = run(
        rules + "none(0). same(S, S). step(X, _, X) :- Y is X + 1, event(a(Y), [1,1])."
    )
    engine.dispatcher.max_depth = 30
    engine.dispatcher._max_chain_length = 31  # noqa: SLF001
    engine.event("a(1)", 1)
    assert len(seen) < 200
    assert any("derived one from another" in report for report in reports)
    engine.event("tick", 2)


def test_conditions_of_what_is_absent_make_their_events_afterwards():
    rules = (
        "lost(X) <- a(X) seq absent((b(Y) where note(X, Y)), 5).\nnote(X, Y) :- event(a(X), [3,3]), Y > X.\n"
    )
    engine, seen, _ = run(rules)
    engine.event("a(1)", 1)
    engine.event("b(2)", 2)
    engine.event("tick", 20)
    assert seen == ["b(2)", "lost(1)"]


def test_what_was_put_off_is_done_in_order_and_forgotten_after_an_interrupt():
    dispatcher = Dispatcher()
    postponing, done, end = ReentrancyQueue(dispatcher), [], ("end",)
    assert postponing.prepend_deferred_work(end) is end
    for number in (1, 2):
        postponing.defer(lambda frame, number=number: done.append(number) or frame)
    frame = postponing.prepend_deferred_work(end)
    while frame is not end:
        frame = frame[0].run(frame)
    assert done == [1, 2]
    postponing.defer(lambda frame: frame)
    with pytest.raises(KeyboardInterrupt):
        postponing.run_operator(_interrupt)
    assert not postponing.is_running
    postponing.clear()
    assert postponing.prepend_deferred_work(end) is end


def _interrupt():
    raise KeyboardInterrupt
