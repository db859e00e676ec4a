"""Row patterns, compared with the exhaustive search of the oracle."""

from random import Random
from typing import Any, List, Tuple, cast

import pytest
from hypothesis import given
from hypothesis import settings as example_settings
from hypothesis import strategies as st
from oracle.pattern_classes import Leaf, Rule, Windowed
from oracle.row_pattern_matches import PAST_LAST, STAMPS, decided_matches, steps_of, timed_out_match
from oracle.rule_notation import write_rule
from oracle.strategies import Generator
from recording_reports import RecordingReports

from retalis import Engine, Var, atom, functor, make_list
from retalis.events.streams.row_pattern_states import CompletedMatch, PartitionState
from retalis.prolog.terms.timestamps import SECOND

KEY, VALUE, RESULT, STARTS = Var(), Var(), Var(), Var()
READING, OUTPUT_EVENT = functor("reading", 2), functor("match", 3)


def rule_of(steps: Any, skip: str = PAST_LAST) -> str:
    """Return the rule that emits the values of each match with their key and their starts."""
    values, results = make_list([VALUE, atom("t1")]), make_list([RESULT, STARTS])
    window = Windowed(
        kinds="list list",
        collected=Leaf(READING(KEY, VALUE)),
        values=values,
        results=results,
        window="steps",
        span=0,
        step=0,
        steps=steps,
        skip=skip,
    )
    return write_rule(Rule(OUTPUT_EVENT(KEY, RESULT, STARTS), window))


def start_of(position: int, value: int) -> int:
    """Return the start of a reading; it ends at its position."""
    return position - value % 2


def expected_outputs(steps: Any, readings: Any, skip: str = PAST_LAST) -> Any:
    """Return the outputs at each reading by the oracle."""
    outputs: List[Any] = []
    for end in range(1, len(readings) + 1):
        key = readings[end - 1][0]
        items = [
            {VALUE: value, STAMPS["t1"]: start_of(position, value), STAMPS["t2"]: position}
            for position, (other, value) in enumerate(readings[:end])
            if other == key
        ]
        for match in decided_matches(steps, items, skip):
            columns = [
                ",".join(str(items[position][var]) for position, _ in match) for var in (VALUE, STAMPS["t1"])
            ]
            outputs.append(f"match({key},[{columns[0]}],[{columns[1]}])")
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
        engine.event(f"reading({key},{value})", start_of(position, value), position)
    return [event for event in events if event.startswith("match")]


def timeouts_of_rule(rule: Any, readings: Any, restore_before: Any = None) -> Any:
    """Return the timed-out matches of a rule with their ends in seconds; see `outputs_of_rule`."""
    events: List[Any] = []

    def record_events(engine: Engine) -> Any:
        engine.on_event(lambda term, start, end: events.append((engine.show(term), end / SECOND)))
        return engine

    engine = record_events(Engine())
    engine.load(rules=rule)
    for position, (key, value) in enumerate(readings):
        if position == restore_before:
            engine = record_events(Engine.restore(engine.snapshot()))
        engine.event(f"reading({key},{value})", start_of(position, value), position)
    engine.event("end", 100)
    return sorted(event for event in events if event[0].startswith("match"))


def expected_timeouts(steps: Any, readings: Any, span: int) -> Any:
    """Return the timed-out matches of all starts by the oracle."""
    names = [step.name for step in steps_of(steps)]
    outputs: List[Any] = []
    for begin, (key, first_value) in enumerate(readings):
        deadline = start_of(begin, first_value) + span
        positions = [
            position
            for position, (other, _) in enumerate(readings)
            if other == key and begin <= position < deadline
        ]
        items = [
            {
                VALUE: readings[position][1],
                STAMPS["t1"]: start_of(position, readings[position][1]),
                STAMPS["t2"]: position,
            }
            for position in positions
        ]
        match = timed_out_match(steps, items, 0)
        if match is not None:
            columns = [
                ",".join(str(items[place][VALUE]) for place, _ in match),
                ",".join(names[step] for _, step in match),
            ]
            outputs.append((f"match({key},[{columns[0]}],[{columns[1]}])", deadline))
    return sorted(outputs)


def timeout_rule_of(steps: Any, span: int) -> str:
    """Return the rule that emits the values and step names of each timed-out match with their key."""
    values, results = make_list([VALUE, atom("step")]), make_list([RESULT, STARTS])
    window = Windowed(
        kinds="list list",
        collected=Leaf(READING(KEY, VALUE)),
        values=values,
        results=results,
        window="steps",
        span=span,
        step=0,
        steps=steps,
        skip="skip_to_next",
    )
    return write_rule(Rule(OUTPUT_EVENT(KEY, RESULT, STARTS), window))


READINGS = st.lists(st.tuples(st.sampled_from("aab"), st.integers(0, 3)), max_size=14)


def draw_steps(seed: int) -> Tuple[Any, str]:
    """Return steps, and where the next match begins, as the oracle draws them."""
    generator = Generator(Random(seed).choice)
    steps = generator.steps([VALUE], are_numbers=True)
    return generator.grouped(steps), generator.skip(steps)


STEPS = st.integers(0, 10**6).map(draw_steps)


@pytest.mark.slow
@example_settings(max_examples=40)
@given(STEPS, READINGS, st.integers(0, 14))
def test_outputs_equal_those_of_exhaustive_search(drawn: Any, readings: Any, restore_before: int) -> None:
    steps, skip = drawn
    rule = rule_of(steps, skip)
    expected = expected_outputs(steps, readings, skip)
    assert outputs_of_rule(rule, readings) == expected, rule
    assert outputs_of_rule(rule, readings, restore_before) == expected, rule


@pytest.mark.slow
@example_settings(max_examples=40)
@given(STEPS, READINGS, st.integers(2, 6), st.integers(0, 14))
def test_timeouts_equal_those_of_exhaustive_search(
    drawn: Any, readings: Any, span: int, restore_before: int
) -> None:
    rule = timeout_rule_of(drawn[0], span)
    expected = expected_timeouts(drawn[0], readings, span)
    assert timeouts_of_rule(rule, readings) == expected, rule
    assert timeouts_of_rule(rule, readings, restore_before) == expected, rule


def test_postponed_matches_are_restored() -> None:
    """Several partial matches begin at the same reading; later readings decide between them."""
    steps = "p where V == 0, later(y(0, 1, until(V == 8))) where V == 9, later(z(0, 1, until(V == 7))) where V == 6"
    rule = f"match(K, L) <- aggregate(list(V), reading(K, V), L, steps([{steps}]))."
    readings = [("a", value) for value in [0, 0, 0, 9, 1, 8, 8, 2, 0, 1, 7, 7]]
    assert (
        outputs_of_rule(rule, readings, restore_before=9)
        == outputs_of_rule(rule, readings)
        == ["match(a,[0,9])"]
    )


WAITING = (
    "p where V == 0, later(y(0, 1, until(V == 8))) where V == 9, later(z(0, 1, until(V == 7))) where V == 6"
)


def pattern_operator(engine: Any) -> Any:
    """Return the operator of the only rule of an engine."""
    (rule,) = engine.rules.rules
    return next(node.stream for node in rule.nodes if hasattr(node, "stream"))


class CountedOrder(int):
    """Order of an element that counts its comparisons."""

    comparison_count = 0

    def __lt__(self, other: int) -> bool:
        CountedOrder.comparison_count += 1
        return int(self) < int(other)

    def __ge__(self, other: int) -> bool:
        return not self < other


def test_time_to_replace_waiting_matches_is_linear(monkeypatch: pytest.MonkeyPatch) -> None:
    """If matches may overlap, one element may replace those of all starts."""
    partition = PartitionState([])
    orders = [CountedOrder(order) for order in range(200)]
    matches: List[Any] = [CompletedMatch(cast("Any", None), order) for order in orders]
    partition.replace_completed(orders, matches, drops_later=False)
    monkeypatch.setattr(CountedOrder, "comparison_count", 0)
    partition.replace_completed(orders[50:], matches[50:], drops_later=False)
    assert list(partition.completed) == matches
    assert CountedOrder.comparison_count < 400


def test_memory_for_element_is_independent_of_matches() -> None:
    """A partial match that lists all earlier ones, and copies the list for each element, fails here."""
    tracemalloc = pytest.importorskip("tracemalloc")
    peaks: List[Any] = []
    for waiting_count in (10, 800):
        engine = Engine()
        engine.load(rules=f"match(L) <- aggregate(list(V), reading(V), L, steps([{WAITING}])).")
        for position in range(waiting_count):
            engine.event("reading(0)", position)
        tracemalloc.start()
        engine.event("reading(0)", waiting_count)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert len(pattern_operator(engine)) == waiting_count + 1
    assert peaks[1] < 2 * peaks[0]


@pytest.mark.parametrize(
    "steps",
    [
        "[a(1, many) where V < 2, b where V > 2], [after_match(skip_to_next)]",
        "[group([a where V =:= 0, b where V =:= 1], 1, many), c where V > 2], [after_match(skip_to_next)]",
        "[a(1, many) where avg(V) < 2, b where V > 2], [after_match(skip_to_first(b))]",
        "[a(1, many) where V < 2], [after_match(skip_to_next)]",
    ],
)
def test_snapshot_grows_with_elements_and_states(steps: str) -> None:
    """A snapshot in which each partial match lists its elements grows with the square of the elements."""
    sizes, rule = [], f"found(L) <- aggregate(list(V), reading(V), L, steps({steps}))."
    for count in (20, 40, 80):
        engine = Engine()
        engine.load(rules=rule)
        for position in range(count):
            engine.event(f"reading({position % 2})", position)
        sizes.append(len(engine.snapshot()))
    assert sizes[2] - sizes[1] < 2.5 * (sizes[1] - sizes[0])


def test_nodes_of_dropped_elements_are_released() -> None:
    """Each match shares the nodes of the one before, so no node of an earlier match would ever be freed."""
    engine, events = Engine(), []
    engine.load(
        rules="w([property(event_rule_window, 9)]) : found(L) <- aggregate(list(V), reading(V), L, "
        "steps([a(1, many) where V < 2, b where V > 2], [after_match(skip_to_next)]))."
    )
    engine.on_event(lambda term, *interval: events.append(engine.show(term)))
    for position in range(100):
        engine.event(f"reading({position % 2})", position)
    (partition,) = pattern_operator(engine).states.values()
    nodes = set()
    for node, _ in partition.matches():
        while node is not None and node not in nodes:
            nodes.add(node)
            node = node.previous
    assert len(partition.elements) == 10
    assert 10 <= len(nodes) <= 22
    engine.event("reading(3)", 100)
    assert events[-9] == "found([1,0,1,0,1,0,1,0,1,3])"


@pytest.mark.parametrize(
    ("aggregate", "result"), [("avg(V)", "2"), ("max(V)", "2"), ("median(V)", "2.0"), ("sum(V * 1)", "4")]
)
def test_aggregate_of_variable_checks_its_values_only(aggregate: str, result: str) -> None:
    """Values of other variables are not checked; a wrong value of the variable is not matched, and reported."""
    reports = RecordingReports()
    engine, events = Engine(reports=reports), []
    engine.load(
        rules=f"match(A) <- aggregate(of(b, {aggregate}), reading(V), A, steps([a where V == go, b(2)]))."
    )
    engine.on_event(lambda term, *interval: events.append(engine.show(term)))
    for second, value in enumerate(["go", "2", "off", "2"]):
        engine.event(f"reading({value})", second)
    assert events[-1] == f"match({result})"
    name, value = aggregate.partition("(")[0], "off*1" if "*" in aggregate else "off"
    assert [report.partition(": ")[2] for report in reports.messages] == [
        f"aggregate {name}: the value is '{value}': expected a number"
    ]
