"""Fused windows compared with plain nodes, on random streams."""

import sys
from typing import Any, List, Tuple

import pytest
from events.fused.fused_path_plugin import PATHS
from hypothesis import example, given
from hypothesis import settings as example_settings
from hypothesis import strategies as st
from recording_reports import RecordingReports

from retalis import Engine, Settings, String, atom, functor, make_list
from retalis.events.fused.fused_window import compile_fused_window
from retalis.events.network import stream_node
from retalis.events.streams.running_statistics import ExactSum
from retalis.prolog.terms.timestamps import SECOND

AGGREGATES = st.lists(
    st.sampled_from(["count", "sum(X)", "avg(X)", "min(X)", "max(Y)", "avg(Y)"]), min_size=1, max_size=3
)
NUMBERS = st.one_of(
    st.integers(-3, 3),
    st.sampled_from([0.5, -0.0, 0.1, 1e-300, 1e300, 1e308, float("inf"), 2**70, 5e-324, float("nan")]),
    st.sampled_from([atom("none"), atom("e"), String("b"), (functor("+", 2), 1, 2.5)]),
    st.sampled_from([make_list([1, 2.5, 3]), make_list([4, 5, 6]), make_list([1.5] * 5)]),
)
KEYS = st.sampled_from([1, 1.0, atom("a"), atom("1"), functor("f", 1)(2)])
STEPS = st.sampled_from([0, 0, 1, 1, 2, 3, -1, -6, 40])
EVENTS = st.lists(st.tuples(KEYS, NUMBERS, NUMBERS, STEPS, st.sampled_from([0, 0, 0, 1, 6])), max_size=40)
X = functor("x", 3)


def rule(aggregates: Any, grouped: Any, limit: str) -> str:
    results = [f"R{number}" for number in range(len(aggregates))]
    head = ", ".join([*(["K"] if grouped else []), *results])
    window = f"aggregate([{', '.join(aggregates)}], x(K, X, Y), [{', '.join(results)}], last(5))"
    return f"out({head}) <- {window}{limit}."


def window_of(rules: Any) -> Any:
    [event_rule] = rules.rules
    [stream_node_of_rule] = [node for node in event_rule.nodes if isinstance(node, stream_node.StreamNode)]
    return stream_node_of_rule


def run_program(text: Any, events: Any, max_stored: int) -> Tuple[Any, ...]:
    """Return events, reports, the final state and its size."""
    outputs: List[Any] = []
    reports = RecordingReports()
    engine = Engine(None, Settings(), reports)
    engine.on_event(lambda term, start, end: outputs.append((engine.show(term), start, end)))
    engine.load(rules=text)
    rules = engine.rules
    rules.network.limit_stored(max_stored)
    now = 1000
    for key, x, y, step, length in events:
        now += step
        engine.event_at(X(key, x, y), (now - length) * SECOND, now * SECOND)
    [event_rule] = rules.rules
    state = window_of(rules).snapshot()["stream"]
    elements = [
        [
            (element.start, element.end, str(element.values), element.order)
            for element in keyed_window.elements
        ]
        for keyed_window in state.pop("keyed_windows")
    ]
    return (
        outputs,
        reports.records,
        (state, elements),
        event_rule.match_count,
        event_rule.metrics.firing_count,
        event_rule.dropped_count,
    )


@pytest.mark.slow
@example_settings(max_examples=25)
@given(
    AGGREGATES,
    st.booleans(),
    st.sampled_from(["", " within 3"]),
    EVENTS,
    st.sampled_from([3, 1000]),
)
@example(["avg(X)"], True, "", [(1, 0.5, 0, 1, 0)] * 9 + [(1, 0.1, 0, 1, 0)] * 9, 1000)
@example(["sum(X)"], True, "", [(1, 1e308, 0, 1, 0)] * 4 + [(1, 2, 0, 1, 0)] * 9, 1000)
def test_fused_window_equals_plain_nodes(
    aggregates: Any, grouped: bool, limit: Any, events: Any, max_stored: Any
) -> None:
    text = rule(aggregates, grouped, limit)
    fused = run_program(text, events, max_stored)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(*PATHS["windows"])
        assert run_program(text, events, max_stored) == fused


@pytest.mark.fused
def test_most_elements_use_fused_path(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a hundred elements in order, the plain node processes few, the first ones among them."""
    plain_calls: List[Any] = []

    def counting(form: Any, limit: Any, node: Any, plain: Any, *others: Any) -> Any:
        def counted(*arguments: Any) -> Any:
            plain_calls.append(arguments)
            return plain(*arguments)

        return compile_fused_window(form, limit, node, counted, *others)

    monkeypatch.setattr(stream_node, "compile_fused_window", counting)
    text = rule(["count", "sum(X)", "avg(X)", "min(X)", "max(Y)"], True, "")
    outputs = run_program(text, [(atom("ab"[number % 2]), 0.5, number, 1, 0) for number in range(100)], 1000)[
        0
    ]
    assert len(outputs) == 200
    assert len(plain_calls) < 15


def test_element_has_no_match_of_replaced_one() -> None:
    engine = Engine()
    engine.load(rules="out(N) <- aggregate([count], a(X), [N], last(5)).")
    engine.event("a(0)", 0)
    engine.call("set_etalis_flag(revision_flag, on)")
    engine.event("a(1)", 1)
    engine.call("set_etalis_flag(revision_flag, off)")
    # The element of a(1) leaves at 6.
    for instant in range(2, 8):
        engine.event(f"a({instant})", instant)
    assert {element.match for element in window_of(engine.rules).stream.queue} == {None}
    engine.call("set_etalis_flag(revision_flag, on)")
    engine.event("a(8)", 8)
    [explanation] = engine.query("justify_event(out(5), [4, 8], Why)")
    assert "a(8)" in engine.show(explanation["Why"])
    assert "a(1)" not in engine.show(explanation["Why"])


def test_first_event_of_key_uses_plain_node() -> None:
    engine = Engine()
    engine.load(rules="out(K, N) <- aggregate([count], a(K), [N], last(5)).")
    exceptions: List[Any] = []
    engine.on_event(lambda term, start, end: exceptions.append(sys.exc_info()[0]))
    engine.event("a(1)", 0)
    engine.event("a(2)", 1)
    assert exceptions == [None] * 4


def test_scale_beyond_floats_has_no_factor() -> None:
    total = ExactSum()
    total.add_multiple(5e-324, 1)
    assert total.scale == 1074
    assert total.factor != total.factor
