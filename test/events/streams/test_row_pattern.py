"""Row patterns, compared with the exhaustive search of the oracle."""

from random import Random
from typing import Any, List

import pytest
from hypothesis import given
from hypothesis import settings as example_settings
from hypothesis import strategies as st
from oracle.patterns import Leaf, Rule, Windowed
from oracle.row_pattern_matches import steps_of, whole_matches
from oracle.rule_notation import write_rule
from oracle.strategies import Generator
from recording_reports import RecordingReports

from retalis import Engine, Var, functor, make_list

KEY, VALUE, RESULT = Var(), Var(), Var()
READING, OUTPUT_EVENT = functor("reading", 2), functor("found", 2)


def rule_of(steps: Any) -> str:
    """Return the rule that emits the values of each match with their key."""
    window = Windowed(
        "list", Leaf(READING(KEY, VALUE)), make_list([VALUE]), make_list([RESULT]), "steps", 0, 0, steps
    )
    return write_rule(Rule(OUTPUT_EVENT(KEY, RESULT), window))


def expected_outputs(steps: Any, readings: Any) -> Any:
    """Return the outputs at each reading by the oracle."""
    outputs: List[Any] = []
    for end in range(1, len(readings) + 1):
        key = readings[end - 1][0]
        values = [value for other, value in readings[:end] if other == key]
        items = [{VALUE: value} for value in values]
        earlier_count = len(whole_matches(steps_of(steps), items[:-1]))
        for match in whole_matches(steps_of(steps), items)[earlier_count:]:
            outputs.append(f"found({key},[{','.join(str(values[position]) for position, _ in match)}])")
    return outputs


def outputs_of_rule(rule: Any, readings: Any, restore_before: Any = None) -> List[Any]:
    """Return the outputs of a rule; the engine is restored before the reading at position ``restore_before``."""
    events: List[Any] = []

    def record_events(engine: Engine) -> Any:
        engine.on_event(lambda term, *interval: events.append(engine.show(term)))
        return engine

    engine = record_events(Engine())
    engine.load(rules=rule)
    for position, (key, value) in enumerate(readings):
        if position == restore_before:
            engine = record_events(Engine.restore(engine.snapshot()))
        engine.event(f"reading({key},{value})", position, position)
    return [event for event in events if event.startswith("found")]


READINGS = st.lists(st.tuples(st.sampled_from("aab"), st.integers(0, 3)), max_size=14)
STEPS = st.integers(0, 10**6).map(
    lambda seed: make_list(Generator(Random(seed).choice).steps([VALUE]))  # drawn as the oracle draws them
)


@pytest.mark.slow
@example_settings(max_examples=40)
@given(STEPS, READINGS, st.integers(0, 14))
def test_outputs_equal_those_of_exhaustive_search(steps: Any, readings: Any, restore_before: int) -> None:
    rule = rule_of(steps)
    assert outputs_of_rule(rule, readings) == expected_outputs(steps, readings), rule
    assert outputs_of_rule(rule, readings, restore_before) == expected_outputs(steps, readings), rule


def test_postponed_matches_are_restored() -> None:
    """Several partial matches begin at the same reading; later readings decide between them."""
    steps = "p where V == 0, later(y(0, 1, until(V == 8))) where V == 9, later(z(0, 1, until(V == 7))) where V == 6"
    rule = f"found(K, L) <- aggregate(list(V), reading(K, V), L, steps([{steps}]))."
    readings = [("a", value) for value in [0, 0, 0, 9, 1, 8, 8, 2, 0, 1, 7, 7]]
    assert (
        outputs_of_rule(rule, readings, restore_before=9)
        == outputs_of_rule(rule, readings)
        == ["found(a,[0,9])"]
    )


WAITING = (
    "p where V == 0, later(y(0, 1, until(V == 8))) where V == 9, later(z(0, 1, until(V == 7))) where V == 6"
)


def pattern_operator(engine: Any) -> Any:
    """Return the operator of the only rule of an engine."""
    (rule,) = engine.rules.rules
    return next(node.stream for node in rule.nodes if hasattr(node, "stream"))


def test_memory_for_element_is_independent_of_matches() -> None:
    """A partial match that lists all earlier ones, and copies the list for each element, fails here."""
    tracemalloc = pytest.importorskip("tracemalloc")
    peaks: List[Any] = []
    for waiting_count in (10, 800):
        engine = Engine()
        engine.load(rules=f"found(L) <- aggregate(list(V), reading(V), L, steps([{WAITING}])).")
        for position in range(waiting_count):
            engine.event("reading(0)", position)
        tracemalloc.start()
        engine.event("reading(0)", waiting_count)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert len(pattern_operator(engine)) == waiting_count + 1
    assert peaks[1] < 2 * peaks[0]


@pytest.mark.parametrize(
    ("aggregate", "result"), [("avg(V)", "2"), ("max(V)", "2"), ("median(V)", "2.0"), ("sum(V * 1)", "4")]
)
def test_aggregate_of_variable_checks_its_values_only(aggregate: str, result: str) -> None:
    """Values of other variables are not checked; a wrong value of the variable is not matched, and reported."""
    reports = RecordingReports()
    engine, events = Engine(reports=reports), []
    engine.load(
        rules=f"found(A) <- aggregate(of(b, {aggregate}), reading(V), A, steps([a where V == go, b(2)]))."
    )
    engine.on_event(lambda term, *interval: events.append(engine.show(term)))
    for second, value in enumerate(["go", "2", "off", "2"]):
        engine.event(f"reading({value})", second)
    assert events[-1] == f"found({result})"
    name, value = aggregate.partition("(")[0], "off*1" if "*" in aggregate else "off"
    assert [report.partition(": ")[2] for report in reports.messages] == [
        f"aggregate {name}: the value is '{value}': expected a number"
    ]
