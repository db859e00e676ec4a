"""Fused joins compared with plain nodes, on random streams."""

import random
import re
from typing import Any, List, Tuple
from unittest.mock import patch

import pytest
from events.fused.fused_path_plugin import PATHS
from nightly_round_numbers import round_numbers
from recording_reports import RecordingReports

from retalis import Engine, Settings, StreamClock, Var, atom, functor
from retalis.events.dispatch.listeners import ListenerPhase
from retalis.prolog.terms.term_traversal import is_ground
from retalis.prolog.terms.timestamps import SECOND

POLICIES = ("recent", "recent_2", "chronological", "chronological_2", "unrestricted")
RULES = (
    "out(K, X, Y) <- a(K, X) seq b(K, Y).",
    "out(K, X) <- (a(K, X) seq b(K, _)) within 4.",
    "out(X, Y) <- (a(_, X) and b(_, Y)) within 3.",
    "out(K, X) <- a(K, X) par b(X, K).",
    "out(X, Y) <- (a(K, X) seq b(K, Y)) within 5 where X < Y.",
    "out(X, Z) <- a(K, X) seq b(K, Y) where (Z is X + Y, Z > 3).",
    "out(K) <- ((a(K, X) seq b(K, Y)) cnot c(K, _)) within 6.",
    "out(X, Y) <- ((a(_, X) seq b(_, Y)) cnot c(X, _)) where Y > 1.",
    "out(K) <- ((a(K, 1) seq b(K, Y)) cnot c(K, Y)) within 4.",
    "out(X, Y, Z) <- (a(K, X) seq b(K, Y) seq c(K, Z)) within 6.",
    "out(X, Z) <- (a(K, X) and (b(K, 2) and c(K, Z))) within 6.",
    "out(K, X) <- a(K, X) during b(K, _).",
    "out(X) <- a(K, X) seq ((b(K, _) and c(K, _)) check (t1(S), t2(E), E - S > X)).",
    "out(X, Z) <- (a(K, X) and b(K, Y)) check (t1(S), t2(E), Z is E - S, Z >= Y).",
    "out(X, Y) <- a(K, X) forall_seq b(K, Y).",
    "out(X) <- (a(K, X) or c(K, X)) seq b(K, X).",
    "out(K) <- do(true, a(K, X) seq b(K, _)).",
    "out(K, X, Y) <- (a(K, X) equals b(K, Y)) within 2. out(K) <- a(K, _) meets c(K, _).",
    "mid(K, X) <- a(K, X) seq b(K, _). out(K, Y) <- mid(K, X) and c(K, Y).",
    "out(f(K, g(X)), c, New) <- (a(K, X) seq b(K, _)) within 4.",
    "out <- a(K, _) and b(K, _). out(c) <- a(K, _) meets b(K, _).",
    "b(K, X) <- a(K, X) seq c(K, _). out(K, Y) <- b(K, X) seq a(K, Y).",
    "nobody(K) <- a(K, _) seq b(K, _). out(K) <- (c(K, X) seq c(K, Y)) where X < Y.",
)
KEYS = (1, 1, 1, 1, 2, 2, 2, 1.0, atom("k"), functor("f", 1)(2))
KINDS = [functor(name, 2) for name in "abc"]


def random_events(generator: Any, has_late_events: bool) -> Any:
    """Return events as terms, starts and ends; most ends ascend."""
    events: List[Any] = []
    now = 1000
    for _ in range(generator.randint(1, 40)):
        now += generator.choice((0, 0, 1, 1, 2, 7))
        value = Var() if generator.random() < 0.03 else generator.choice(KEYS)
        term = generator.choice(KINDS)(value, generator.choice((0, 1, 2, 2.0, 3)))
        end = now - (generator.choice((0, 0, 0, 1, 5)) if has_late_events else 0)
        events.append((term, end - generator.choice((0, 0, 0, 1, 3)), end))
    return events


def run_program(
    text: Any, goals: Any, events: Any, max_stored: Any, restore_before: Any, change: Any, posted: Any
) -> Tuple[Any, ...]:
    """Return the outputs, the reports, and the final states of all rules.

    Args:
        text: the rules.
        goals: goals to call first.
        events: the stream.
        max_stored: limit of the number of stored matches.
        restore_before: position before which the matches are restored from a snapshot.
        change: a goal to call at this position.
        posted: whether events of an instant are posted, so that fused actions may process them.
    """
    outputs: List[Any] = []
    reports = RecordingReports()
    engine = Engine(None, Settings(), reports)
    engine.rules.network.limit_stored(max_stored)
    engine.load(goals=goals, rules=text)

    def record_output(term: Any, values: Any, start: Any, end: Any, frame: Any) -> Any:
        outputs.append(event_text(engine, term, start, end))
        return frame

    for arity in (0, 1, 2, 3):
        pattern = functor("out", arity)(*(Var() for _ in range(arity))) if arity else atom("out")
        engine.dispatcher.listen(ListenerPhase.SUBSCRIPTIONS, pattern, record_output)
    for position, (term, start, end) in enumerate(events):
        if position == restore_before:
            if change:
                engine.load(goals=change)
            if not change:
                states = [rule.snapshot() for rule in engine.rules.rules]
                for rule, state in zip(engine.rules.rules, states):
                    rule.clear_matches()
                    rule.restore(state)
        if posted and start == end and is_ground(term):
            engine.post(term, end * SECOND)
        else:
            engine.event_at(term, start * SECOND, end * SECOND)
        assert engine.dispatcher.current is None
    return outputs, reports.records, [rule_state(engine, rule) for rule in engine.rules.rules]


def event_text(engine: Any, term: Any, start: Any, end: Any) -> Tuple[Any, ...]:
    """Return the text of an event with uniform names of variables, and its interval."""
    return re.sub(r"_G\d+", "_", engine.show(term)), start, end


def rule_state(engine: Any, rule: Any) -> Tuple[Any, ...]:
    """Return the state of a rule, with uniform names of variables."""
    matches = [
        (
            *event_text(
                engine, (functor("values", len(match.values)), *match.values), match.start, match.end
            ),
            order,
            node_position,
        )
        for match, node_position, order in zip(*rule.stored_arrivals)
    ]
    return (
        matches,
        rule.stored_match_count,
        rule.clock,
        rule.order,
        rule.dropped_count,
        rule.metrics.firing_count,
        rule.metrics.error_count,
    )


def compare(seed: Any) -> None:
    """Compare fused and plain nodes for a program and a stream drawn from a seed."""
    generator = random.Random(seed)
    goals = f"set_etalis_flag(event_consumption_policy, {generator.choice(POLICIES)})"
    if generator.random() < 0.2:
        goals += ", set_etalis_flag(out_of_order, on)"
    if generator.random() < 0.1:
        goals += ", set_etalis_flag(garbage_control, general), set_etalis_flag(garbage_window, 5)"
    change = generator.choice(
        ("", "", f"set_etalis_flag(event_consumption_policy, {generator.choice(POLICIES)})")
    )
    max_stored, restore_before = generator.choice((10**6, 10**6, 3)), generator.choice((99, 5, 10))
    text = generator.choice(RULES)
    events = random_events(generator, generator.random() < 0.3)
    posted = generator.random() < 0.7
    fused = run_program(text, goals, events, max_stored, restore_before, change, posted)
    with patch.object(*PATHS["sides"]), patch.object(*PATHS["negations"]):
        plain = run_program(text, goals, events, max_stored, restore_before, change, posted)
    assert fused == plain, (seed, text, goals, change, posted)


@pytest.mark.parametrize("batch", range(3))
def test_fused_join_equals_plain_nodes(batch: int) -> None:
    for seed in range(batch * 5, batch * 5 + 5):
        compare(seed)


@pytest.mark.slow
@pytest.mark.parametrize("batch", round_numbers(1, 20))
def test_fused_join_equals_plain_nodes_on_many_streams(batch: Any) -> None:
    for seed in range(1000 + batch * 50, 1050 + batch * 50):
        compare(seed)


@pytest.mark.parametrize("max_stored", [10**6, 50])
def test_removed_matches_leave_expiration_queue(max_stored: int) -> None:
    engine = Engine(StreamClock(10**6 * SECOND))
    engine.rules.network.limit_stored(max_stored)
    engine.load(rules="out(K) <- (a(K) seq b(K)) within 100000.")
    [rule] = engine.rules.rules
    left, right = functor("a", 1), functor("b", 1)
    for key in range(4000):
        engine.event_at(left(key), 2 * key, 2 * key)
        if max_stored > 50:
            engine.event_at(right(key), 2 * key + 1, 2 * key + 1)
    assert rule.stored_match_count == (0 if max_stored > 50 else max_stored)
    assert len(rule.expiration_queue) < 1200


@pytest.mark.fused
def test_event_of_one_side_has_fused_action() -> None:
    engine = Engine()
    engine.load(
        rules="out(K) <- (a(K) seq b(K)) cnot c(K). out(K) <- d(K) seq d(K). out(K) <- e(K, 1) seq f(K)."
    )
    functors = {name: functor(name, 1) for name in "abcdf"}
    for event_functor in functors.values():
        engine.post(event_functor(1), 1)
    engine.post(functor("e", 2)(1, 1), 2)
    assert {key.name for key in engine.dispatcher.fused_actions} == {"a", "b", "c", "f"}
