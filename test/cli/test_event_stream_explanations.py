"""Option ``--explain`` of command ``events``: reasons of events that happened, and of those that did not."""

from typing import Any, List

import pytest

RULES = "alarm(X) <- smoke(X) seq heat(X) where X \\= lab.\n"


def explanation_lines(run_events: Any, event: str, rules: str, stream: str) -> List[Any]:
    """Return the lines of the explanation of an event."""
    status, lines, error = run_events("--explain", event, rules=rules, stream=stream)
    assert error == ""
    assert status == 0
    return [line[2:] for line in lines if line.startswith("% ")]


STREAM = (
    "event(smoke(hall),[1,1]).\nevent(heat(hall),[2,2]).\nevent(smoke(lab),[3,3]).\nevent(heat(lab),[4,4]).\n"
)
TWO_RULES = RULES + "evacuate(X) do true <- alarm(X) fnot drill.\n"


def test_explanation_reaches_input_events(run_events: Any) -> None:
    lines = explanation_lines(run_events, "evacuate(hall)", TWO_RULES, STREAM)
    assert lines[0] == "evacuate(hall) happened"
    assert [line.split(" by ")[0].rstrip() for line in lines[1:]] == [
        "  evacuate(hall) [1,2]",
        "    alarm(hall) [1,2]",
        "      smoke(hall) at 1 came from outside",
        "      heat(hall) at 2 came from outside",
    ]
    assert lines[1].endswith("rules.txt:2)")


def test_patterns_and_intervals_are_explained(run_events: Any) -> None:
    assert explanation_lines(run_events, "alarm(X)", RULES, STREAM)[1].startswith(
        "  alarm(hall) [1,2] by rule"
    )
    assert explanation_lines(run_events, "event(alarm(X),[1,2])", RULES, STREAM)[0].endswith(" happened")
    lines = explanation_lines(run_events, "event(alarm(X),[1,3])", RULES, STREAM)
    assert lines[0].endswith("did not happen")
    assert "    - but no match has that interval" in lines


def test_requested_interval_is_relative_if_times_are(run_events: Any) -> None:
    stream = "event(x(1),[1000,1000]).\nevent(x(2),[1005,1005]).\nevent(x(3),[990,1006.5]).\n"
    requests = [
        "event(y(2),[5,5])",
        "event(y(2),[5.0,5.0])",
        "event(y(3),[0,6.5])",
        "event(y(2),[1005,1005])",
    ]
    options = [option for request in requests for option in ("--explain", request)]
    lines = run_events("--times=relative", *options, rules="y(V) <- x(V).\n", stream=stream)[1]
    results = [line.split(" ", 2)[2] for line in lines if line.startswith("% event")]
    assert results == ["happened", "happened", "happened", "did not happen"]


@pytest.mark.parametrize(
    ("rule", "reason"),
    [
        ("x <- smoke(hall) seq gas.", "- gas: did not happen"),
        (
            "x <- heat(hall) seq smoke(hall).",
            "- seq: none of the first ended before one of the second started",
        ),
        ("x <- smoke(A) during heat(A).", "- during: none of the first lies within one of the second"),
        ("x <- smoke(hall) and heat(lab) where fail.", "- where fail: false "),
        ("x <- (smoke(hall) seq heat(lab)) within 2.", "- within 2: all took longer"),
        ("x <- (smoke(hall) seq heat(lab)) cnot smoke(lab).", "- cnot: ruled out by what must not happen"),
        ("x <- heat(hall) fnot smoke(_).", "- cnot or fnot: ruled out by what must not happen"),
        ("x <- smoke(A) equals heat(A).", "- equals: no two of them have the same interval"),
        ("x <- gas or oil.", "- or: no branch matched"),
        ("x <- smoke(garage) seq heat(hall) star_times.", "- star_times: it did not start"),
        ("x <- heat(lab) seq aggregate(max(X),smoke(X),_).", "- max: nothing was collected"),
        ("x <- heat(lab) check (t1(S), S = 9).", "- check t1(S),S = 9: false at 4"),
        ("x <- smoke(hall) do fail.", "- but other matches consumed the events"),
        (
            "l([property(window, 2)]) : x <- smoke(hall) and heat(lab).",
            "- but all matches exceed the window of the rule's label, 2 seconds",
        ),
        (
            "x <- y(9). y(N) <- smoke(hall) seq aggregate(count,heat(_),N).",
            "- count: other results: 0 at 1; 1 [1,2]; 2 [1,4]",
        ),
        ("x <- y. y <- smoke(hall) where fail.", "- where fail: false "),
    ],
)
def test_missing_event_has_reason(run_events: Any, rule: str, reason: str) -> None:
    lines = explanation_lines(run_events, "x", rule + "\n", STREAM)
    assert lines[0] == "x did not happen"
    assert any(line.lstrip().startswith(reason) for line in lines), lines


def test_unknown_event_is_explained(run_events: Any) -> None:
    lines = explanation_lines(run_events, "flood(hall)", RULES, STREAM)
    assert lines[1].strip() == "no rule has such a head, and no such event came from outside"


def test_recursive_rule_is_explained_once(run_events: Any) -> None:
    lines = explanation_lines(run_events, "x", "x <- x seq y.\n", STREAM)
    assert sum("rule x" in line for line in lines) == 1


def test_explanation_does_not_change_events(run_events: Any) -> None:
    events = run_events(rules=TWO_RULES, stream=STREAM)[1]
    lines = run_events("--explain", "alarm(_)", rules=TWO_RULES, stream=STREAM)[1]
    assert len(events) == 6
    assert [line for line in lines if not line.startswith("%")] == events


@pytest.mark.parametrize("event", ["X", "3", "event(a,[1])", "event(a,[1,b])", "a(b"])
def test_explanation_of_non_event_is_an_error(run_events: Any, event: str) -> None:
    status, lines, error = run_events("--explain", event, stream=STREAM)
    assert (status, len(lines)) == (1, 4)
    assert error.startswith("error: ")


def test_retracted_event_is_explained(run_events: Any) -> None:
    rules = ":- set_etalis_flag(revision_flag, on).\n" + RULES
    stream = STREAM + "event(rev(smoke(hall)),[9,9]).\n"
    lines = explanation_lines(run_events, "alarm(hall)", rules, stream)
    assert lines[0].endswith("did not happen")
    assert "  alarm(hall) [1,2] was retracted" in lines
    assert explanation_lines(run_events, "rev(alarm(_))", rules, stream)[1:] == [
        "  rev(alarm(hall)) at 9 retracts",
        "    alarm(hall) [1,2]",
    ]


def test_events_of_queries_and_goals_are_explained(run_events: Any) -> None:
    rules = "synchronized(pose(X), true, []) <- b(X).\nnull do new_event(made(X), [1,1]) <- pose(X).\n"
    lines = explanation_lines(run_events, "made(3)", rules, "event(b(3),[2,2]).\n")
    texts = [line.split(" by")[0].strip() for line in lines[1:]]
    assert texts[:2] == ["made(3) at 1", "pose(3) at 2 was released"]
    assert texts[-1] == "b(3) at 2 came from outside"


def test_explanation_has_variable_names_of_rule(run_events: Any) -> None:
    lines = explanation_lines(run_events, "x(_)", "x(Y) <- z(X) seq smoke(Y) where Y = X.\n", STREAM)
    assert lines[1].startswith("  rule x(Y) <- z(X) seq smoke(Y) where Y = X (")
    assert [line.strip().split(":")[0] for line in lines[2:]] == [
        "? where Y = X",
        "- seq",
        "- z(X)",
        "+ smoke(Y)",
    ]
