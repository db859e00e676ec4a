"""Goals of a stream operator that emit events for it, reset it or change its flags."""

from functools import partial
from typing import Any, List, Tuple

import pytest
from recording_reports import RecordingReports

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


def load_engine(rules: str) -> Tuple[Any, ...]:
    """Return an engine, its derived events, and its reports."""
    reports = RecordingReports()
    engine, derived = Engine(reports=reports), []
    engine.load(rules=rules)
    engine.on_event(
        lambda term, start, end: (
            None if engine.show(term).startswith(("a(", "tick")) else derived.append(engine.show(term))
        )
    )
    return engine, derived, reports


EVENT, RESET, FLAG = "event(a(9),[2,2])", "reset_db", "set_etalis_flag(revision_flag,on)"


@pytest.mark.parametrize(
    ("window", "goal", "outputs"),
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
        ("session(5)", "event(a(9),[17,17])", "w([3,2,1]) w([9])"),
        ("session(5)", RESET, "w([3,2,1])"),
    ],
)
def test_goal_of_fold_is_deferred_until_event_is_added(window: str, goal: str, outputs: str) -> None:
    engine, derived, reports = load_engine(FOLD.format(window=window, goal=goal))
    for number in (1, 2, 3):
        engine.event(f"a({number})", number)
    engine.event("tick", 4 if "every(4)" in window else 7)
    engine.event("tick", 40)
    assert " ".join(derived) == outputs
    assert reports.messages == []


@pytest.mark.parametrize(
    ("goal", "outputs"),
    [
        (
            EVENT,
            "w([1,2,9]) w([9,3,4])",
        ),  # two partial matches evaluate the goal: one continues, another would begin
        (RESET, "w([3,4,5])"),
        (FLAG, "w([1,2,3])"),
        (f"{RESET}, {EVENT}", "w([9,3,4])"),
    ],
)
def test_condition_of_row_pattern_is_deferred(goal: str, outputs: str) -> None:
    engine, derived, reports = load_engine(
        f"w(S) <- aggregate(list(X), a(X), S, steps([s(3) where (X =\\= 2 ; {goal})]))."
    )
    for number in range(1, 6):
        engine.event(f"a({number})", number)
    assert " ".join(derived) == outputs
    assert reports.messages == []


@pytest.mark.parametrize("goal", ["del_event_rule(own)", "reset_etalis"])
def test_self_deleted_rule_emits_earlier_matches(goal: str) -> None:
    engine, derived, _ = load_engine("own : " + FOLD.format(window="last(10)", goal=goal).lstrip())
    for number in (1, 2, 3):
        engine.event(f"a({number})", number)
    assert derived == ["w([1])", "w([2,1])"]
    assert engine.rules.rules == []


def test_endless_chain_of_events_is_stopped() -> None:
    rules = "w(S) <- aggregate(fold(none, step, same, X), a(X), S, last(1, events)).\n"
    engine, derived, reports = load_engine(
        rules + "none(0). same(S, S). step(X, _, X) :- Y is X + 1, event(a(Y), [1,1])."
    )
    engine.dispatcher.max_depth = 30
    engine.dispatcher._max_chain_length = 31  # noqa: SLF001
    engine.event("a(1)", 1)
    assert len(derived) < 200
    assert any("derived one from another" in report for report in reports.messages)
    engine.event("tick", 2)


def test_condition_of_absent_event_emits_events() -> None:
    rules = (
        "lost(X) <- a(X) seq absent((b(Y) where note(X, Y)), 5).\nnote(X, Y) :- event(a(X), [3,3]), Y > X.\n"
    )
    engine, derived, _ = load_engine(rules)
    engine.event("a(1)", 1)
    engine.event("b(2)", 2)
    engine.event("tick", 20)
    assert derived == ["b(2)", "lost(1)"]


def test_deferred_work_runs_in_order() -> None:
    dispatcher = Dispatcher()
    queue = ReentrancyQueue(dispatcher)
    executed: List[int] = []
    end_frame: Any = ("end",)

    def work(number: int, frame: Any) -> Any:
        executed.append(number)
        return frame

    assert queue.prepend_deferred_work(end_frame) is end_frame
    for number in (1, 2):
        queue.defer(partial(work, number))
    frame = queue.prepend_deferred_work(end_frame)
    while frame is not end_frame:
        frame = frame[0].run(frame)
    assert executed == [1, 2]
    queue.defer(lambda frame: frame)
    with pytest.raises(KeyboardInterrupt):
        queue.run_operator(_interrupt)
    assert not queue.is_running


def _interrupt() -> None:
    raise KeyboardInterrupt
