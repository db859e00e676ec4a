"""Fused windows compared with plain nodes, on random streams."""

import sys

import pytest
from events.fused.fused_path_plugin import PATHS
from hypothesis import example, given
from hypothesis import settings as example_settings
from hypothesis import strategies as st

from retalis import Engine, Settings, String, atom, functor, make_list
from retalis.events.network import stream_node
from retalis.events.streams.running_statistics import ExactSum
from retalis.prolog.terms.timestamps import SECOND

KINDS = st.lists(
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


def rule(kinds, grouped, limit):
    results = [f"R{at}" for at in range(len(kinds))]
    head = ", ".join([*(["K"] if grouped else []), *results])
    window = f"aggregate([{', '.join(kinds)}], x(K, X, Y), [{', '.join(results)}], last(5))"
    return f"out({head}) <- {window}{limit}."


def window_of(rules):
    [made] = rules.rules
    [found] = [node for node, _, _ in made.nodes if isinstance(node, stream_node.StreamNode)]
    return found


def run(text, events, cap, cut):
    """Return all events and reports, what is known at last and how much is held; the state is put back at a cut."""
    found = []
    reports = []

    class Told:
        def __getattr__(self, name):
            return lambda *told: reports.append((name, [str(one) for one in told]))

    engine = Engine(None, Settings(), Told())
    engine.on_event(lambda term, start, end: found.append((engine.show(term), start, end)))
    engine.load(rules=text)
    rules = engine.rules
    rules.max_stored = cap
    now = 1000
    for at, (key, x, y, step, length) in enumerate(events):
        now += step
        if at == cut:
            [made] = rules.rules
            node = made.root
            node.repair()
        engine.event_at(X(key, x, y), (now - length) * SECOND, now * SECOND)
    [made] = rules.rules
    clock, following, late, order, groups = window_of(rules).snapshot()[0]
    items = [[(one.start, one.end, str(one.values), one.order) for one in members] for _, members in groups]
    return (
        found,
        reports,
        (clock, following, late, order, items),
        made.match_count,
        made.metrics.firing_count,
        made.dropped_count,
    )


@pytest.mark.slow
@example_settings(max_examples=25)
@given(
    KINDS,
    st.booleans(),
    st.sampled_from(["", " within 3"]),
    EVENTS,
    st.sampled_from([3, 1000]),
    st.integers(0, 40),
)
@example(["avg(X)"], True, "", [(1, 0.5, 0, 1, 0)] * 9 + [(1, 0.1, 0, 1, 0)] * 9, 1000, 99)
@example(["sum(X)"], True, "", [(1, 1e308, 0, 1, 0)] * 4 + [(1, 2, 0, 1, 0)] * 9, 1000, 99)
def test_both_ways_give_and_know_the_same(kinds, grouped, limit, events, cap, cut):
    text = rule(kinds, grouped, limit)
    fused = run(text, events, cap, cut)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(*PATHS["windows"])
        assert run(text, events, cap, cut) == fused


@pytest.mark.fused
def test_what_is_common_is_fused(monkeypatch):
    """Of a hundred items in order few go the plain way, those of the beginning among them."""
    plainly = []
    taken = stream_node.compile_fused_window

    def counting(form, limit, node, plain, *others):
        def counted(*arguments):
            plainly.append(arguments)
            return plain(*arguments)

        return taken(form, limit, node, counted, *others)

    monkeypatch.setattr(stream_node, "compile_fused_window", counting)
    text = rule(["count", "sum(X)", "avg(X)", "min(X)", "max(Y)"], True, "")
    found = run(text, [(atom("ab"[at % 2]), 0.5, at, 1, 0) for at in range(100)], 1000, 999)[0]
    assert len(found) == 200 and len(plainly) < 15  # what begins a group, and what asks how far time may go


def test_an_element_does_not_get_the_match_of_the_one_that_it_replaces():
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
    assert "a(8)" in engine.show(explanation["Why"]) and "a(1)" not in engine.show(explanation["Why"])


def test_the_first_event_of_a_key_is_processed_outside_of_exception_handlers():
    engine = Engine()
    engine.load(rules="out(K, N) <- aggregate([count], a(K), [N], last(5)).")
    handled = []
    engine.on_event(lambda term, start, end: handled.append(sys.exc_info()[0]))
    engine.event("a(1)", 0)
    engine.event("a(2)", 1)
    assert handled == [None] * 4


def test_a_power_of_two_beyond_floats_is_no_factor():
    found = ExactSum()
    found.add_multiple(5e-324, 1)
    assert found.scale == 1074 and found.factor != found.factor
