"""Fused joins compared with plain nodes, on random streams."""

import random
import re
from unittest.mock import patch

import pytest
from events.fused.fused_path_plugin import PATHS

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


def stream(source, late):
    """Return events: terms, starts and ends; their ends rise, but for some."""
    found = []
    now = 1000
    for _ in range(source.randint(1, 40)):
        now += source.choice((0, 0, 1, 1, 2, 7))
        value = Var() if source.random() < 0.03 else source.choice(KEYS)
        term = source.choice(KINDS)(value, source.choice((0, 1, 2, 2.0, 3)))
        end = now - (source.choice((0, 0, 0, 1, 5)) if late else 0)
        found.append((term, end - source.choice((0, 0, 0, 1, 3)), end))
    return found


def run(text, goals, events, cap, cut, change, posted):
    """Return what fires and is reported, and what is known at last.

    Args:
        text: the rules.
        goals: called first.
        events: the stream.
        cap: how many matches may wait.
        cut: where what waits is mended, as after an interrupt, and put back as a snapshot has it.
        change: a goal that is called there.
        posted: whether events of an instant are posted, and may be served by fused actions.
    """
    found, reports = [], []

    class Told:
        def __getattr__(self, name):
            return lambda *told: reports.append((name, [str(one) for one in told]))

    engine = Engine(None, Settings(), Told())
    engine.load(goals=goals, rules=text)
    for arity in (0, 1, 2, 3):
        pattern = functor("out", arity)(*(Var() for _ in range(arity))) if arity else atom("out")
        engine.dispatcher.listen(
            ListenerPhase.SUBSCRIPTIONS,
            pattern,
            lambda term, values, start, end, frame: found.append(shown(engine, term, start, end)) or frame,
        )
    engine.rules.max_stored = cap
    for at, (term, start, end) in enumerate(events):
        if at == cut:
            for rule in engine.rules.rules:
                rule.repair()
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
    return found, reports, [known(engine, rule) for rule in engine.rules.rules]


def shown(engine, term, start, end):
    """Return an event as it is compared: variables have any names."""
    return re.sub(r"_G\d+", "_", engine.show(term)), start, end


def known(engine, rule):
    """Return what a rule knows, as it is compared."""
    waiting = [
        (*shown(engine, (functor("values", len(one.values)), *one.values), one.start, one.end), order, place)
        for one, place, order in zip(*rule.snapshot().arrivals)
    ]
    return (
        waiting,
        rule.stored_match_count,
        rule.clock,
        rule.order,
        rule.dropped_count,
        rule.metrics.firing_count,
        rule.metrics.error_count,
    )


def compare(seed):
    """Compare both ways for what is drawn from a seed."""
    source = random.Random(seed)
    goals = f"set_etalis_flag(event_consumption_policy, {source.choice(POLICIES)})"
    if source.random() < 0.2:
        goals += ", set_etalis_flag(out_of_order, on)"
    if source.random() < 0.1:
        goals += ", set_etalis_flag(garbage_control, general), set_etalis_flag(garbage_window, 5)"
    change = source.choice(("", "", f"set_etalis_flag(event_consumption_policy, {source.choice(POLICIES)})"))
    cap, cut = source.choice((10**6, 10**6, 3)), source.choice((99, 5, 10))
    text = source.choice(RULES)
    events = stream(source, source.random() < 0.3)
    posted = source.random() < 0.7
    quick = run(text, goals, events, cap, cut, change, posted)
    with patch.object(*PATHS["sides"]), patch.object(*PATHS["negations"]):
        plain = run(text, goals, events, cap, cut, change, posted)
    assert quick == plain, (seed, text, goals, change, posted)


@pytest.mark.parametrize("part", range(3))
def test_it_gives_and_knows_what_the_plain_way_does(part):
    for seed in range(part * 5, part * 5 + 5):
        compare(seed)


@pytest.mark.slow
@pytest.mark.parametrize("part", range(10))
def test_many_streams(part):
    for seed in range(1000 + part * 100, 1100 + part * 100):
        compare(seed)


@pytest.mark.parametrize("cap", [10**6, 50])
def test_what_has_left_is_not_held_until_its_time_is_over(cap):
    engine = Engine(StreamClock(10**6 * SECOND))
    engine.load(rules="out(K) <- (a(K) seq b(K)) within 100000.")
    engine.rules.max_stored = cap
    [rule] = engine.rules.rules
    left, right = functor("a", 1), functor("b", 1)
    for key in range(4000):
        engine.event_at(left(key), 2 * key, 2 * key)
        if cap > 50:
            engine.event_at(right(key), 2 * key + 1, 2 * key + 1)
    assert rule.stored_match_count == (0 if cap > 50 else cap)
    assert len(rule.expiration_queue) < 1200


@pytest.mark.fused
def test_what_only_one_side_of_a_rule_takes_has_a_fused_action():
    engine = Engine()
    engine.load(
        rules="out(K) <- (a(K) seq b(K)) cnot c(K). out(K) <- d(K) seq d(K). out(K) <- e(K, 1) seq f(K)."
    )
    ones = {name: functor(name, 1) for name in "abcdf"}
    for made in ones.values():
        engine.post(made(1), 1)
    engine.post(functor("e", 2)(1, 1), 2)
    assert {key.name for key in engine.dispatcher.fused_actions} == {"a", "b", "c", "f"}
