"""Explanations of events and missing events for rules with stream operators."""

import pytest
from asserting_accessors import compound

from retalis import Engine

FLAGS = ":- set_etalis_flag(etalis_justification, on).\n"


def explanation_of(rules: str, stream: str, event: str) -> str:
    """Return the explanation of an event after a stream, events as ``term@end``."""
    engine = Engine()
    engine.load(rules=FLAGS + rules)
    for item in stream.split():
        term, end = item.rsplit("@", 1)
        engine.event(term, int(end))
    (answer, *_) = engine.query(f"justify_event({event}, _, E), (E = [J] -> true ; J = E)")
    _, _, _, body = compound(answer["J"])
    return engine.show(body)


def leaf(event: str, instant: int) -> str:
    return f"justification(unlabeled,head({event},[{instant},{instant}]),default)"


STREAM = "in(1)@1 in(2)@2 tick@20"
FIRST, SECOND = leaf("in(1)", 1), leaf("in(2)", 2)
EXPLANATIONS = {
    "a window": (
        "w(N) <- aggregate(count, in(_), N, last(5)).",
        "w(2)",
        f"windowf(count,[{FIRST},{SECOND}],last(5.0))",
    ),
    "several kinds": (
        "w(N) <- aggregate([count, rate], in(_), [N, _], every(5)).",
        "w(2)",
        f"windowf([count,rate],[{FIRST},{SECOND}],every(5.0))",
    ),
    "events by number": (
        "w(N) <- aggregate(count, in(_), N, every(2, events)).",
        "w(2)",
        f"windowf(count,[{FIRST},{SECOND}],every(2,events))",
    ),
    "the newest": (
        "w(N) <- aggregate(count, in(_), N, last(1, events)).",
        "w(1)",
        f"windowf(count,[{FIRST}],last(1,events))",
    ),
    "from the first": (
        "w(N) <- aggregate(count, in(_), N, running(every(5, first))).",
        "w(2)",
        f"windowf(count,[{FIRST},{SECOND}],running(every(5.0,first)))",
    ),
    "one that hops": (
        "w(N) <- aggregate(count, in(_), N, last(4, every(2))).",
        "w(2)",
        f"windowf(count,[{FIRST},{SECOND}],last(4.0,every(2.0)))",
    ),
    "an instant": ("w(X) <- at_end(in(X) where X > 0) where X < 2.", "w(1)", f"at_endf({FIRST})"),
    "a throttle": ("w(X) <- in(X) with throttle(5).", "w(1)", f"withf({FIRST},throttle(5.0))"),
    "a change": ("w(X) <- in(X) with change(1, [2, b]).", "w(1)", f"withf({FIRST},change(1,[2,b]))"),
    "a debounce": ("w(X) <- in(X) with debounce(5).", "w(2)", f"withf({SECOND},debounce(5.0))"),
    "an absence": ("w(X) <- in(X) seq absent(no, 2).", "w(2)", f"absentf({SECOND},no,2.0)"),
    "a sequence of them": (
        "w(X) <- (in(X) with throttle(5)) seq aggregate(count, in(_), _, last(1, events)).",
        "w(1)",
        f"seqf(withf({FIRST},throttle(5.0)),windowf(count,[{SECOND}],last(1,events)))",
    ),
}


@pytest.mark.parametrize("name", EXPLANATIONS)
def test_event_is_explained_by_sources(name: str) -> None:
    rules, event, expected = EXPLANATIONS[name]
    assert explanation_of(rules, STREAM, event) == expected


@pytest.mark.parametrize(
    ("pattern", "missing"),
    [
        ("aggregate(avg(7), never, _, last(5))", "windowf(avg(7),never,last(5.0))"),
        ("never with burst(5)", "withf(never,burst(5.0))"),
        ("at_start(never)", "at_startf(never)"),
        ("never seq absent(in(1), 5)", "absentf(never,in(1),5.0)"),
        ("in(1) seq absent(no seq in(2), 5)", "absentf(in(1),seqf(no,in(2)),5.0)"),
    ],
)
def test_missing_event_is_explained(pattern: str, missing: str) -> None:
    explanation = explanation_of(f"w <- ({pattern}) where fail.", STREAM, "w")
    assert f"head(wheref({missing},fail)," in explanation
