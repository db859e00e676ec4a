"""A few of the interrupts that ``python3 -m interrupts`` makes, always the same but for those by real signals."""

import contextlib
from itertools import count

import pytest
from parsing import parse_term

from retalis import Engine, StreamClock, atom, functor
from retalis.events.knowledge.memory import Memory

from .__main__ import Campaign
from .idle_engine_checks import faults
from .injection import AtBytecode, Interrupt


@pytest.mark.slow
@pytest.mark.parametrize(
    ("way", "number"), [("bytecode", 60), ("signal", 40), ("limit", 80), ("limited", 20)], ids=str
)
def test_an_engine_that_was_interrupted_answers_as_one_that_was_not(way, number):
    campaign = Campaign(way, 1)
    campaign.run(number)
    assert sum(campaign.outcomes.values()) == number
    assert campaign.outcomes["interrupted"] + campaign.outcomes["ended with an error"] > 0


def interrupted(engine, work, prepare=lambda: None):
    """Interrupt a piece of work at each of its bytecodes, one after the other; yield after each."""
    at = 0
    while True:
        at += 1
        prepare()
        with contextlib.suppress(Interrupt), AtBytecode(at) as injected:
            work()
        if injected.where is None:
            return
        assert faults(engine) == [], injected.where
        yield injected.where


@pytest.mark.slow
def test_an_event_that_is_interrupted_anywhere_is_recorded_whole_or_not_at_all():
    engine = Engine(StreamClock(0))
    engine.load(goals="memorize(a(_), [], _, m, 2)")
    counts = []
    event = functor("a", 1)(1)
    for _ in interrupted(engine, lambda: engine.event_at(event, 1, 1)):
        memory = engine.knowledge.memories.find(atom("m")).memory
        assert len(memory.ends) == len(memory.records)
        counts.append(memory.added_count)
    assert {new - old for old, new in zip(counts, counts[1:])} == {0, 1}


@pytest.mark.slow
@pytest.mark.parametrize("number", [1, 2], ids=["one", "together"])
def test_a_post_that_is_interrupted_anywhere_leaves_the_engine_to_others(number):
    engine = Engine(StreamClock(0))
    engine.load(rules="b(X) <- a(X).")
    seen = []
    engine.on_event(lambda term, start, end: seen.append(term))
    messages = [(functor("a", 1)(1), None), (functor("a", 1)(2), 1_000_000_000)][:number]

    def post():
        if number == 1:
            engine.post(*messages[0])
        else:
            engine.post_each(messages)

    for _ in interrupted(engine, post):
        del seen[:]
        post()
        assert len(seen) == 2 * number


@pytest.mark.slow
@pytest.mark.parametrize("last", ["a", "b", "c"])
def test_a_side_of_a_pair_that_is_interrupted_anywhere_leaves_its_rule_in_order(last):
    engine = Engine(StreamClock(0))
    engine.load(rules="out(K) <- ((a(K) seq b(K)) cnot c(K)) within 5.")
    [rule] = engine.rules.rules
    instants = count(1_000_000_000, 1_000_000_000)
    seen = []
    engine.on_output(lambda term, topic, name: seen.append(term))
    engine.load(goals="subscribe(out(_), [], _, t, i)")

    def post(kind):
        engine.post(functor(kind, 1)(1), next(instants))

    def begin():
        rule.clear_matches()
        del seen[:]
        if last != "a":
            post("a")

    for _ in interrupted(engine, lambda: post(last), begin):
        fired = len(seen)
        waits = len(rule.snapshot().arrivals[0])
        assert (fired, waits) in {
            "a": [(0, 0), (0, 1)],
            "b": [(0, 0), (0, 1), (1, 0)],
            "c": [(0, 1), (0, 2)],
        }[last]
        if last == "a":
            post("b")
            assert len(seen) == waits
    assert "a" in {key.name for key in engine.dispatcher.fused_actions}


@pytest.mark.slow
def test_a_query_that_is_interrupted_anywhere_leaves_nothing_to_be_done_behind_it():
    engine = Engine(StreamClock(0))
    goal = parse_term("call_with_inference_limit(true, 1000, R)")
    assert sum(1 for _ in interrupted(engine, lambda: engine.query(goal))) > 1000


def test_a_memory_that_is_cut_when_an_interrupt_comes_counts_what_it_took():
    memory = Memory(1)
    while len(memory.ends) < memory.trim_length - 1:
        memory.add((atom("a"), 1, 1))
    added = memory.added_count
    at = 0
    where = True
    while where is not None:
        at += 1
        again = Memory(1)
        for _ in range(added):
            again.add((atom("a"), 1, 1))
        with contextlib.suppress(Interrupt), AtBytecode(at) as injected:
            again.add((atom("a"), 1, 1))
        where = injected.where
        again.repair()
        assert again.added_count in (added, added + 1)
        assert len(again.ends) == len(again.records)


def test_solutions_that_are_closed_long_after_an_interrupt_disturb_no_other_goal():
    engine = Engine(StreamClock(0))
    kept = []

    def keep(machine, term):
        solutions = machine.solutions((machine.logic.control.code, atom("repeat"), 0, machine.done))
        next(solutions)
        kept.append(solutions)
        raise KeyboardInterrupt

    engine.logic.define("keep", 1, keep)
    engine.logic.define("close", 0, lambda machine: kept.pop().close() or True)
    with pytest.raises(KeyboardInterrupt):
        engine.call("keep(1)")
    assert faults(engine) == []
    assert len(engine.query("member(X, [1,2,3]), ( X =:= 1 -> close ; true )")) == 3


def test_a_goal_that_is_called_leaves_nothing_on_the_trail():
    engine = Engine(StreamClock(0))
    term = functor("=", 2)(functor("f", 1)(1), parse_term("f(X)"))
    assert engine.call(term)
    assert engine.show(term) == "f(1)=f(1)"
    assert faults(engine) == []
