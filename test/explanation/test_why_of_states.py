"""Explanations of open and missing states, of operators with deadlines, and of unknown names."""

from typing import Any, List

import pytest

from retalis import Engine, PrologError, explain, record_origins

STATE = ":- state(docked(R), from(dock(R)), until(undock(R))).\n"


def explanation_lines(rules: str, events: Any, pattern: str, origin: Any = None) -> List[Any]:
    """Return the lines of an explanation."""
    engine = Engine()
    record_origins(engine)
    engine.load(rules=rules)
    for event, end in events:
        engine.event(event, end)
    return [text for line in explain(engine, pattern, origin=origin).lines for text in line.indented()]


@pytest.mark.parametrize(
    ("rule", "lines"),
    [
        ("w(X) <- in(X) with throttle(2).", ["in(1) at 1 came from outside"]),
        ("w(X) <- in(X) seq absent(no, 2).", ["in(1) at 1 came from outside"]),
        (
            "w(X) <- (in(X) seq next) with throttle(2).",
            ["in(1) at 1 came from outside", "next at 2 came from outside"],
        ),
    ],
)
def test_sources_of_operator_are_shown_once(rule: str, lines: List[str]) -> None:
    events = [("in(1)", 1), ("next", 2), ("tick", 10)]
    assert [line.strip() for line in explanation_lines(rule, events, "w(1)")[1:]] == lines


def test_open_state_shows_start_and_event() -> None:
    events = [("dock(a)", 5), ("dock(b)", 7)]
    assert explanation_lines(STATE, events, "docked(b)") == [
        "state docked(b) is open since 7: it becomes an event when it ends",
        "  dock(b) at 7 came from outside",
    ]
    relative = explanation_lines(STATE, events, "docked(b)", origin=5 * 10**9)
    assert relative[0] == "state docked(b) is open since 2 s: it becomes an event when it ends"


def test_states_that_held_are_shown_below_event() -> None:
    rules = f"{STATE}ok(R) <- ping(R) where true, holds(docked(R))."
    events = [
        ("dock(a)", 1),
        ("dock(b)", 2),
        ("ping(a)", 3),
        ("undock(a)", 4),
        ("dock(a)", 5),
        ("ping(a)", 6),
    ]
    lines = explanation_lines(rules, events, "ok(a)")
    assert [line for line in lines if "ok(a)" not in line] == [
        "  state docked(a) held since 1",
        "    dock(a) at 1 came from outside",
        "  ping(a) at 3 came from outside",
        "  state docked(a) held since 5",
        "    dock(a) at 5 came from outside",
        "  ping(a) at 6 came from outside",
    ]


def test_omitted_states_are_counted() -> None:
    events = [*((f"dock({robot})", robot) for robot in range(12)), ("ping", 20)]
    lines = explanation_lines(f"{STATE}ok <- ping where holds(docked(_)).", events, "ok")
    assert lines[1:3] == ["  ... and 2 older states", "  state docked(2) held since 2"]


@pytest.mark.parametrize(
    "pattern",
    [
        "aggregate(count, a, 120, last(500))",
        "aggregate(duration(true), a, 119.0, held(last(500)))",
        "aggregate(count, a, 120, every(120, events))",
        "aggregate(count, a, 120, steps([a(120)]))",
    ],
)
def test_omitted_events_of_window_are_counted(pattern: str) -> None:
    lines = explanation_lines(f"w <- {pattern}.", [("a", second) for second in range(120)], "w")
    assert lines[1] == "  ... and 20 older matches of the window"


def test_missing_state_shows_missing_event() -> None:
    rules = f"{STATE}dock(R) <- near(R) seq touched(R)."
    assert explanation_lines(rules, [("near(a)", 1)], "docked(a)") == [
        "state docked(a) is not open: dock(a), which begins it, did not happen",
        "  rule dock(a) <- near(a) seq touched(a) (text:2)",
        "    - seq: one side is missing",
        "      + near(a): at 1",
        "      - touched(a): did not happen",
    ]


def test_open_state_is_shown_below_rule() -> None:
    lines = explanation_lines(
        f"{STATE}left(R) <- docked(R) seq bye(R).", [("dock(a)", 1), ("bye(a)", 2)], "left(a)"
    )
    assert "      state docked(a) is open since 1: it becomes an event when it ends" in lines


def test_mutual_states_end_explanation() -> None:
    rules = ":- state(p, from(q), until(x)).\n:- state(q, from(p), until(x)).\n"
    assert explanation_lines(rules, [], "p") == [
        "state p is not open: q, which begins it, did not happen",
        "  state q is not open: p, which begins it, did not happen",
    ]


def test_unknown_name_suggests_similar_event() -> None:
    rules = "alarm(R) <- smoke(R) seq heat(R)."
    for name, similar in (("alrm(_)", "alarm"), ("smokee(_)", "smoke"), ("gust", "gusts")):
        (line, *_) = explanation_lines(rules, [("gusts", 1)], name)
        assert line.endswith(f"no such event came from outside; did you mean {similar}?"), line
    assert "did you mean" not in explanation_lines(rules, [], "zzz")[0]


def test_unknown_state_suggests_similar_state() -> None:
    engine = Engine()
    engine.load(rules=STATE)
    with pytest.raises(PrologError, match=r"Unknown state: dokced/1: did you mean docked/1\?"):
        engine.query("holds(dokced(_))")
    with pytest.raises(PrologError, match=r"Unknown state: zzz/1 \(in holds/1\)$"):
        engine.query("holds(zzz(_))")
