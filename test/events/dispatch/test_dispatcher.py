"""Dispatch: order, constants, depth, and isolation of errors."""

from typing import Any, Dict, List, Tuple

import pytest
from events.program_runner import ProgramRunner, outputs_of, term_text
from hypothesis import given, settings
from hypothesis import strategies as st
from reachable_objects import count_entries, reachable
from recording_reports import RecordingReports

from retalis import Engine, Settings, String, UsageError, Var, atom, functor, make_list
from retalis.events.dispatch.dispatcher import Dispatcher
from retalis.events.dispatch.listeners import TERM, Listener, ListenerPhase
from retalis.prolog.terms.term_traversal import copy, variables
from retalis.prolog.terms.types import NIL, Lazy
from retalis.prolog.terms.unification import undo, unify

A, B, F = functor("a", 1), functor("b", 2), functor("f", 1)


class Done:
    @staticmethod
    def run(frame: Any) -> None:
        raise AssertionError


DONE = (Done(),)


class Recorder:
    def __init__(self) -> None:
        self.dispatcher = Dispatcher()
        self.calls: List[Any] = []

    def listen(self, name: str, pattern: Any, phase: Any = ListenerPhase.RULES) -> Listener:
        def action(term: Any, values: Any, start: Any, end: Any, frame: Any) -> Any:
            self.calls.append((name, values))
            return frame

        return self.dispatcher.listen(phase, pattern, action)

    def send(self, term: Any) -> Any:
        self.calls = []
        frame = self.dispatcher.dispatch(term, 1, 1, DONE)
        while frame is not DONE:
            frame = frame[0].run(frame)
        return self.calls


def test_phases_and_listeners_are_ordered() -> None:
    recorder = Recorder()
    recorder.listen("rule", (A, Var()))
    recorder.listen("memory", (A, Var()), ListenerPhase.MEMORIES)
    recorder.listen("subscription 1", (A, Var()), ListenerPhase.SUBSCRIPTIONS)
    recorder.listen("any", Var(), ListenerPhase.SUBSCRIPTIONS)
    assert [name for name, _ in recorder.send((A, 1))] == ["subscription 1", "any", "memory", "rule"]


def test_constants_choose_listeners() -> None:
    recorder = Recorder()
    x, y = atom("x"), atom("y")
    patterns = {
        "x": (B, x, Var()),
        "y": (B, y, Var()),
        "x1": (B, x, 1),
        "nested": (B, (F, x), Var()),
        "open": (B, Var(), Var()),
        "float": (B, 1.0, Var()),
    }
    for name, pattern in patterns.items():
        recorder.listen(name, pattern)

    def names(term: Tuple[Any, ...]) -> List[Any]:
        return [name for name, _ in recorder.send(term)]

    assert names((B, x, 1)) == ["x", "x1", "open"]
    assert names((B, x, 1.0)) == ["x", "open"]
    assert names((B, 1, 1)) == ["open"]
    assert names((B, 1.0, 1)) == ["open", "float"]
    assert names((B, (F, x), 1)) == ["nested", "open"]
    assert names((B, (F, y), 1)) == ["open"]
    assert names((B, Lazy(F, lambda source: (F, x), None), 1)) == ["nested", "open"]
    assert set(names((B, Var(), 1))) == set(patterns)


def test_unread_lazy_value_is_not_created() -> None:
    recorder = Recorder()
    recorder.listen("all", (B, Var(), 1))
    lazy = Lazy(F, lambda source: pytest.fail("created"), None)
    assert recorder.send((B, lazy, 1)) == [("all", (lazy,))]


def test_list_pattern_binds_first_and_rest() -> None:
    recorder = Recorder()
    first, rest = Var(), Var()
    recorder.listen("list", (A, make_list([first], rest)))
    assert recorder.send((A, make_list([1]))) == [("list", (1, NIL))]
    assert recorder.send((A, NIL)) == []


def test_removed_listeners_are_not_called() -> None:
    recorder = Recorder()
    listener = recorder.listen("a", (A, Var()))
    other = recorder.listen("other", (A, Var()))
    recorder.dispatcher.remove(listener)
    recorder.dispatcher.remove(listener)
    assert [name for name, _ in recorder.send((A, 1))] == ["other"]
    recorder.dispatcher.remove(other)
    assert reachable(recorder.dispatcher, Listener) == []
    assert recorder.send((A, 1)) == []


@pytest.mark.parametrize("term", [1, 2.5, Var()])
def test_dispatch_refuses_other_terms(term: Any) -> None:
    with pytest.raises(UsageError):
        Dispatcher().dispatch(term, 1, 1, DONE)


def test_event_that_ends_before_its_start_is_refused() -> None:
    with pytest.raises(UsageError, match="end before"):
        Dispatcher().dispatch(atom("a"), 2, 1, DONE)


def test_events_are_derived_depth_first() -> None:
    rules = "b <- a. c <- b. d <- a."
    assert outputs_of(rules, "a@1") == "b@1-1 c@1-1 d@1-1"


def test_error_of_goal_affects_its_rule_only() -> None:
    program = ProgramRunner("b <- a where no_such_goal. c do no_such_goal <- a. d <- a.")
    assert program.feed("a@1") == "d@1-1"
    assert len(program.errors) == 2
    assert "no_such_goal" in str(program.errors[0])
    assert "at event a" in str(program.errors[0])
    assert program.errors[0].place is not None


@pytest.mark.parametrize(
    "rule", ["a <- a.", "null do new_event(a,[1,1]) <- a.", "n <- a where new_event(a,[1,1])."]
)
def test_endless_chain_is_error_of_its_rule(rule: str) -> None:
    program = ProgramRunner(f"{rule} b <- c.")
    program.feed("a@1")
    assert program.errors
    assert program.feed("c@1") == "b@1-1"


def test_alarms_in_the_past_count_for_endless_chain() -> None:
    head = "exceptionAlarmAbsoluteDatime(b,datime(1970,1,1,0,0,0,0))"
    program = ProgramRunner(f"{head} <- {head}. c <- {head}.")
    assert program.feed(f"{head}@1").endswith("c@1-1")
    assert "1000 events" in str(program.errors[0])


def test_state_is_bounded_for_new_event_names() -> None:
    recorder = Recorder()
    recorder.listen("any", Var())
    for number in range(20_005):
        assert recorder.send(atom(f"kind{number}"))
    assert count_entries(recorder.dispatcher) <= 11_000


def test_events_with_variables_match_by_unification() -> None:
    assert outputs_of("c(X,Y) <- a(f(X), Y).", "a(Z,Z)@1") == "c(A,f(A))@1-1"
    assert outputs_of("c(X) <- a(X) where X = 3.", "a(Z)@1 a(4)@2") == "c(3)@1-1"
    assert outputs_of("c(X) do X = 3 <- a(X).", "a(Z)@1 a(4)@2") == "c(3)@1-1"


def test_rule_deleted_during_dispatch_gets_event() -> None:
    program = ProgramRunner("one do del_event_rule(two) <- a. two : b <- a.")
    assert program.feed("a@1 a@2") == "one@1-1 b@1-1 one@2-2"
    program = ProgramRunner("one do (ins_event_rule(c <- a), del_event_rule(c <- a)) <- a.")
    assert program.feed("a@1") == "one@1-1"


def test_deleted_subscription_gets_current_event() -> None:
    program = ProgramRunner()
    names: List[Any] = []
    program.engine.on_output(lambda term, topic, name: names.append(name))
    program.engine.call("subscribe(a, [delete_subscription(t, 2)], _, t, 1)")
    program.engine.call("subscribe(a, [], _, t, 2)")
    program.feed("a@1 a@2")
    assert names == [1, 2, 1]


def test_memory_deleted_during_dispatch_stays_deleted() -> None:
    program = ProgramRunner()
    program.engine.call("memorize(a, [delete_memory(2)], _, 1, 5)")
    program.engine.call("memorize(a, [], _, 2, 5)")
    assert "memory_updated(2" not in program.feed("a@1 a@2")
    assert not program.engine.call("access_mem(2, _, _)")
    assert program.engine.call("memory_size(1, 5)")


def test_added_memory_gets_later_events() -> None:
    program = ProgramRunner()
    program.engine.call("subscribe(a(1), [memorize(a(X), [], _, m, 5)], _, t, 1)")
    program.feed("a(1)@1")
    assert not program.engine.call("access_mem(m, _, _)")
    program.feed("a(2)@2")
    assert program.engine.query("access_mem(m, a(X), _)") == [{"X": 2}]


@pytest.mark.parametrize("depth", [3, 5, 6, 9])
def test_listeners_are_called_up_to_depth_limit(depth: int) -> None:
    dispatcher = Dispatcher(max_depth=depth)
    calls: List[Any] = []

    def record(term: Any, values: Any, start: Any, end: Any, frame: Any) -> Any:
        calls.append((term, values, start, end))
        return frame

    def derive(functor: Any, increment: int) -> Any:
        return lambda term, values, start, end, frame: dispatcher.dispatch(
            (functor, values[0] + increment), start, end, frame
        )

    dispatcher.listen(ListenerPhase.RULES, (A, Var()), derive(F, 0))
    dispatcher.listen(ListenerPhase.RULES, (A, Var()), derive(A, 1))
    dispatcher.listen(ListenerPhase.SUBSCRIPTIONS, (F, Var()), record)
    dispatcher.listen(ListenerPhase.SUBSCRIPTIONS, (F, 1), record)

    def run_frames() -> None:
        frame = dispatcher.dispatch((A, 1), 5, 6, DONE)
        while frame is not DONE:
            frame = frame[0].run(frame)

    with pytest.raises(UsageError, match=f"more than {depth} events"):
        run_frames()
    assert calls[:2] == [((F, 1), (1,), 5, 6), ((F, 1), (), 5, 6)]
    assert calls[2:] == [((F, number), (number,), 5, 6) for number in range(2, depth + 1)]


@pytest.mark.parametrize("depth", [1, 3, 4, 5, 6, 1000])
def test_depth_limit_applies_to_derived_events(depth: int) -> None:
    reports = RecordingReports()
    engine = Engine(settings=Settings(max_depth=depth), reports=reports)
    events: List[Any] = []
    engine.on_event(lambda term, start, end: events.append(term))
    engine.load(rules=f"n(Y) <- n(X) where (X < {depth + 1}, Y is X + 1).")
    engine.event(f"n({1})", 1)
    assert (len(events), reports.texts) == (depth + 1, [])
    engine.event(f"n({0})", 2)
    assert len(events) == 2 * (depth + 1)
    (error,) = reports.texts
    assert f"more than {depth} events were derived" in error


LEAVES = st.sampled_from([atom("x"), atom("y"), 1, 1, 2, 1.0, String("x"), "X", "X", "Y", "Z"])
TERMS = st.recursive(
    LEAVES, lambda inner: st.tuples(st.just(F), inner) | st.tuples(st.just(B), inner, inner), max_leaves=6
)
EVENTS = st.tuples(st.just(B), TERMS, TERMS) | st.tuples(st.just(A), TERMS) | st.just(atom("x"))
LISTENERS = st.tuples(EVENTS | st.just("X"), st.sampled_from(ListenerPhase))


def with_variables(term: Any, variables_by_name: Any) -> Any:
    """Return a term with variables in place of their names."""
    if isinstance(term, str):
        return variables_by_name.setdefault(term, Var())
    return (
        (term[0], *[with_variables(argument, variables_by_name) for argument in term[1:]])
        if term.__class__ is tuple
        else term
    )


def matched_values(pattern: Any, term: Any) -> Any:
    """Return the text of the values of a pattern's variables, None if the event does not match."""
    copies: Dict[Any, Any] = {}
    trail: List[Any] = []
    order = variables(pattern)
    if not unify(copy(pattern, copies), term, trail):
        undo(trail, 0)
        return None
    text = term_text((functor("values", len(order)), *[copies[var] for var in order])) if order else "values"
    undo(trail, 0)
    return text


@pytest.mark.slow
@settings(deadline=None, derandomize=True, max_examples=150)
@given(st.lists(LISTENERS, max_size=8), st.lists(EVENTS, min_size=1, max_size=6), st.data())
def test_event_reaches_unifying_listeners_in_order(
    listeners: List[Any], events: List[Any], data: st.DataObject
) -> None:
    dispatcher = Dispatcher()
    calls: List[Any] = []
    active_listeners: List[Any] = []

    def listen(number: Any, pattern: Any, phase: Any) -> None:
        def action(term: Any, values: Any, start: Any, end: Any, continuation: Any) -> Any:
            text = term_text((functor("values", len(values)), *values)) if values else "values"
            calls.append((number, text, start, end))
            assert dispatcher.current[TERM] is term
            return continuation

        listener = dispatcher.listen(phase, pattern, action)
        active_listeners.append((phase, number, pattern, listener))

    for number, (pattern, *rest) in enumerate(listeners):
        listen(number, with_variables(pattern, {}), *rest)
    for instant, event in enumerate(events):
        removes = bool(active_listeners) and data.draw(st.booleans())
        if removes:
            dispatcher.remove(active_listeners.pop(data.draw(st.integers(0, len(active_listeners) - 1)))[-1])
        term = with_variables(event, {})
        del calls[:]
        frame = dispatcher.dispatch(term, instant, instant + 1, DONE)
        while frame is not DONE:
            frame = frame[0].run(frame)
        expected = [
            (number, matched_values(pattern, term), instant, instant + 1)
            for _, number, pattern, _ in sorted(active_listeners, key=lambda entry: entry[:2])
        ]
        assert calls == [call for call in expected if call[1] is not None]
        assert dispatcher.current is None
    for *_, listener in active_listeners:
        dispatcher.remove(listener)
    assert reachable(dispatcher, Listener) == []
