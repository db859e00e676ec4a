"""Robustness of signal temporal logic by held values, compared with rtamt.

rtamt is no requirement of the package. To run this module: ``pip install rtamt==0.4.10``, then
``pytest -m nightly test/events/streams/test_rtamt_agreement.py``.
"""

import random
from typing import Any, Dict, List, Sequence, Tuple

import pytest

from retalis import Engine
from retalis.prolog.terms.timestamps import SECOND

rtamt = pytest.importorskip("rtamt")
pytestmark = pytest.mark.nightly

CASES = 300
Signal = List[Tuple[float, float]]
"""Times in seconds, and the values that last from them on."""


def random_signal(generator: random.Random, fraction: float) -> Signal:
    """Return a signal from 0 s on whose values begin a fraction of a second after full ones."""
    times = sorted(generator.sample(range(1, 40), generator.randrange(1, 20)))
    return [(time + fraction if time else 0.0, generator.uniform(-5, 5)) for time in [0, *times]]


def rtamt_values(formula: str, signals: Dict[str, Signal], times: Sequence[float]) -> List[float]:
    """Return the robustness of a formula at some times, in dense time."""
    monitor = rtamt.StlDenseTimeSpecification()
    for name in signals:
        monitor.declare_var(name, "float")
    monitor.spec = formula
    monitor.parse()
    end = max(signal[-1][0] for signal in signals.values()) + 100
    traces = [
        [name, [[time, value] for time, value in [*signal, (end, signal[-1][1])]]]
        for name, signal in signals.items()
    ]
    robustness = monitor.evaluate(*traces)
    return [next(value for start, value in reversed(robustness) if start <= time) for time in times]


def retalis_values(rules: str, signals: Dict[str, Signal], until: float) -> List[Tuple[float, float]]:
    """Return the times and values of the events ``out(Value)`` of a program."""
    engine = Engine()
    engine.load(rules=rules)
    outputs: List[Tuple[float, float]] = []

    def record(term: Any, start: int, end: int) -> None:
        if term[0].name == "out":
            outputs.append((end / SECOND, term[1]))

    engine.on_event(record)
    samples = [(time, name, value) for name, signal in signals.items() for time, value in signal]
    for time, name, value in sorted(samples):
        engine.event(f"{name}({value!r})", time, time)
    engine.event("stop(0)", until, until)
    return outputs


@pytest.mark.parametrize(("operator", "kind"), [("once", "max"), ("historically", "min")])
def test_bound_of_past_is_that_of_rtamt_at_each_sample(operator: str, kind: str) -> None:
    for seed in range(CASES):
        generator = random.Random(seed)
        signal, span = random_signal(generator, 0.25), generator.choice((0.5, 1, 3, 7.5))
        outputs = retalis_values(
            f"out(R) <- aggregate({kind}(X), x(X), R, held(last({span}))).", {"x": signal}, 50
        )
        times = [time for time, _ in outputs]
        assert times == [time for time, _ in signal]
        expected = rtamt_values(f"{operator}[0:{span}](x)", {"x": signal}, times)
        assert [value for _, value in outputs] == expected, seed


@pytest.mark.parametrize(("operator", "kind"), [("once", "max"), ("historically", "min")])
def test_delayed_bound_of_past_is_that_of_rtamt_at_each_second(operator: str, kind: str) -> None:
    for seed in range(CASES):
        generator = random.Random(seed)
        signal, delay, span = (
            random_signal(generator, 0.25),
            generator.choice((0, 2)),
            generator.choice((1, 3, 8)),
        )
        rule = f"out(R) <- aggregate({kind}(X), x(X), R, held(last({span}, every(1))))."
        outputs = [(time + delay, value) for time, value in retalis_values(rule, {"x": signal}, 50)]
        assert len(outputs) == 50
        formula = f"{operator}[{delay}:{delay + span}](x)"
        expected = rtamt_values(formula, {"x": signal}, [time for time, _ in outputs])
        assert [value for _, value in outputs] == expected, seed


RESPONSE = """
requested(R) <- aggregate(first(X), req(X), R, held(last(5, every(1)))).
granted(G) <- aggregate(max(X), gnt(X), G, held(last(5, every(1)))).
out(M) <- requested(R) equals granted(G) where M is max(3 - R, G - 3).
"""
FORMULA = "(req >= 3) implies (eventually[0:5](gnt >= 3))"


def check_response(signals: Dict[str, Signal]) -> List[Tuple[float, float]]:
    """Compare the robustness of a bounded response; it is known five seconds after its time."""
    outputs = [(time - 5, value) for time, value in retalis_values(RESPONSE, signals, 50) if time >= 5]
    expected = rtamt_values(FORMULA, signals, [time for time, _ in outputs])
    assert [value for _, value in outputs] == expected
    return outputs


def test_bounded_response_of_examples_is_that_of_rtamt() -> None:
    requests: Signal = [(0, 0.0), (3, 6.0), (5, 0.0), (11, 0.0)]
    grants: Signal = [(0, 0.0), (7.25, 6.0), (9.25, 0.0), (11, 0.0)]
    outputs = dict(check_response({"req": requests, "gnt": grants}))
    assert (outputs[2], outputs[3], outputs[4], outputs[5]) == (3, 3, 3, 3)
    late_grants: Signal = [(0, 0.0), (9.25, 6.0), (11, 0.0)]
    assert dict(check_response({"req": requests, "gnt": late_grants}))[3] == -3


def test_bounded_response_is_that_of_rtamt_at_each_second() -> None:
    for seed in range(CASES):
        generator = random.Random(seed)
        check_response({"req": random_signal(generator, 0.25), "gnt": random_signal(generator, 0.5)})
