"""Row patterns, compared with the exhaustive search of the oracle."""

from random import Random

import pytest
from hypothesis import given
from hypothesis import settings as example_settings
from hypothesis import strategies as st
from oracle.patterns import Leaf, Rule, Windowed
from oracle.row_pattern_matches import steps_of, whole_matches
from oracle.rule_notation import write_rule
from oracle.strategies import Generator

from retalis import Engine, Var, functor, make_list

KEY, VALUE, RESULT = Var(), Var(), Var()
READING, FOUND = functor("reading", 2), functor("found", 2)


def rule_of(steps):
    """Return the rule that gives the values of each match with their key."""
    window = Windowed(
        "list", Leaf(READING(KEY, VALUE)), make_list([VALUE]), make_list([RESULT]), "steps", 0, 0, steps
    )
    return write_rule(Rule(FOUND(KEY, RESULT), window))


def expected(steps, readings):
    """Return what is found at each reading, by the oracle."""
    found = []
    for end in range(1, len(readings) + 1):
        key = readings[end - 1][0]
        values = [value for other, value in readings[:end] if other == key]
        items = [{VALUE: value} for value in values]
        told = len(whole_matches(steps_of(steps), items[:-1]))
        for match in whole_matches(steps_of(steps), items)[told:]:
            found.append(f"found({key},[{','.join(str(values[place]) for place, _ in match)}])")
    return found


def fired(rule, readings, cut=None):
    """Return what a rule finds; with ``cut`` another engine goes on after so many readings."""
    seen = []

    def listening(engine):
        engine.on_event(lambda term, *interval: seen.append(engine.show(term)))
        return engine

    engine = listening(Engine())
    engine.load(rules=rule)
    for at, (key, value) in enumerate(readings):
        if at == cut:
            engine = listening(Engine.restore(engine.snapshot()))
        engine.event(f"reading({key},{value})", at, at)
    return [one for one in seen if one.startswith("found")]


READINGS = st.lists(st.tuples(st.sampled_from("aab"), st.integers(0, 3)), max_size=14)
STEPS = st.integers(0, 10**6).map(
    lambda seed: make_list(Generator(Random(seed).choice).steps([VALUE]))  # drawn as the oracle draws them
)


@pytest.mark.slow
@example_settings(max_examples=40)
@given(STEPS, READINGS, st.integers(0, 14))
def test_as_all_ways_tried_in_their_order(steps, readings, cut):
    rule = rule_of(steps)
    assert fired(rule, readings) == expected(steps, readings), rule
    assert fired(rule, readings, cut) == expected(steps, readings), rule


def test_matches_that_wait_for_one_that_is_preferred_go_on_waiting_in_another_engine():
    """Several ways hold the first of them, and are told apart by what comes."""
    steps = "p where V == 0, later(y(0, 1, until(V == 8))) where V == 9, later(z(0, 1, until(V == 7))) where V == 6"
    rule = f"found(K, L) <- aggregate(list(V), reading(K, V), L, steps([{steps}]))."
    readings = [("a", value) for value in [0, 0, 0, 9, 1, 8, 8, 2, 0, 1, 7, 7]]
    assert fired(rule, readings, cut=9) == fired(rule, readings) == ["found(a,[0,9])"]


WAITING = (
    "p where V == 0, later(y(0, 1, until(V == 8))) where V == 9, later(z(0, 1, until(V == 7))) where V == 6"
)


def stepped(engine):
    """Return the operator of the only rule of an engine."""
    (rule,) = engine.rules.rules
    return next(node.stream for node, _, _ in rule.nodes if hasattr(node, "stream"))


def test_an_item_takes_as_much_memory_however_many_matches_wait():
    """Each way knew all matches that wait before it, and copied them for each that came."""
    tracemalloc = pytest.importorskip("tracemalloc")
    taken = []
    for number in (10, 800):
        engine = Engine()
        engine.load(rules=f"found(L) <- aggregate(list(V), reading(V), L, steps([{WAITING}])).")
        for at in range(number):
            engine.event("reading(0)", at)
        tracemalloc.start()
        engine.event("reading(0)", number)
        taken.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert len(stepped(engine)) == number + 1
    assert taken[1] < 2 * taken[0]


def test_what_an_interrupt_leaves_between_ways_and_what_waits_is_found_anew():
    engine, whole = [Engine(), Engine()]
    seen = {}
    for one in (engine, whole):
        one.load(rules=f"found(L) <- aggregate(list(V), reading(V), L, steps([{WAITING}])).")
        seen[one] = found = []
        one.on_event(lambda term, *_, one=one, found=found: found.append(one.show(term)))
        for at in range(5):
            one.event("reading(0)", at)
    (group,) = stepped(engine).states.values()
    group.completed.popleft()
    engine.rules.repair()
    for one in (engine, whole):
        for at, value in enumerate([8, 7, 7], 5):
            one.event(f"reading({value})", at)
    assert seen[engine] == seen[whole]
    assert seen[whole].count("found([0])") == 5


@pytest.mark.parametrize(
    ("kind", "result"), [("avg(V)", "2"), ("max(V)", "2"), ("median(V)", "2.0"), ("sum(V * 1)", "4")]
)
def test_a_measure_of_one_step_asks_that_step_alone_for_numbers(kind, result):
    """What another step takes may be anything; what the step itself would take is left out and reported."""
    engine, seen, reports = Engine(), [], []
    engine.rules.on_error = lambda error: reports.append(error.message)
    engine.load(rules=f"found(A) <- aggregate(of(b, {kind}), reading(V), A, steps([a where V == go, b(2)])).")
    engine.on_event(lambda term, *interval: seen.append(engine.show(term)))
    for at, value in enumerate(["go", "2", "off", "2"]):
        engine.event(f"reading({value})", at)
    assert seen[-1] == f"found({result})"
    name, value = kind.partition("(")[0], "off*1" if "*" in kind else "off"
    assert [one.partition(": ")[2] for one in reports] == [
        f"aggregate {name}: the value is '{value}': expected a number"
    ]
