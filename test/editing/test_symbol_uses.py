"""Uses of symbols in rules, goals and topics: kinds, arities and definitions."""

from typing import List

import pytest

from retalis.editing.symbol_uses import (
    SymbolKind,
    clauses_of_goals,
    clauses_of_rules,
    event_types_in_topics,
    uses_in_clause,
    uses_in_topics,
)


def uses_in(text: str, is_goal_file: bool = False) -> List[str]:
    """Return the symbols of a text in their order: kind, name and arity, and ``!`` after a definition."""
    clauses = clauses_of_goals(text, "goals") if is_goal_file else clauses_of_rules(text, "rules")
    uses = [use for clause in clauses for use in uses_in_clause(clause)]
    for use in uses:
        assert text[use.start : use.end].strip("'") == use.symbol.name
    marks = {
        SymbolKind.FUNCTOR: "",
        SymbolKind.MEMORY: "memory ",
        SymbolKind.LABEL: "label ",
        SymbolKind.TOPIC: "topic ",
    }
    return [f"{marks[use.symbol.kind]}{use.symbol}{'!' if use.is_definition else ''}" for use in uses]


@pytest.mark.parametrize(
    ("clause", "expected"),
    [
        ("a(X) <- b(X, Y) seq 'c d'.", ["a/1!", "b/2", "c d/0"]),
        ("a do g(1) <- b.", ["a/0!", "g/1", "b/0"]),
        ("b(X) do g(X).", ["b/1", "g/1"]),
        ("my_label : a <- b.", ["label my_label!", "a/0!", "b/0"]),
        ("l([property(ttl, 3)]) : a <- b.", ["label l!", "a/0!", "b/0"]),
        ("p(X) :- q(X), \\+ r([s, t(X)]).", ["p/1!", "q/1", "r/1", "s/0", "t/1"]),
        ("p(1).", ["p/1!"]),
        (":- dynamic f/2.", ["f/2"]),
        (
            "synchronized(a(X), q(X), [[m, T]]) <- b(T).",
            ["synchronized/3!", "a/1!", "q/1", "memory m", "b/1"],
        ),
        ("exceptionAlarm(a, 3) <- b.", ["exceptionAlarm/2!", "a/0!", "b/0"]),
        ("p :- new_event(a(1), 2, 3).", ["p/0!", "new_event/3", "a/1!"]),
        ("p :- maplist(q(1), L), call(r, 1, 2).", ["p/0!", "maplist/2", "q/2", "call/3", "r/2"]),
        ("p :- prev(m, r(X), _, _, 3).", ["p/0!", "prev/5", "memory m", "r/1"]),
        ("a <- my_pkg__0__Msg{x: {y: c(1)}}.", ["a/0!", "my_pkg__0__Msg", "c/1"]),
        (":- state(on, from(a), until(b)).", ["state/3", "on/0!", "from/1", "a/0", "until/1", "b/0"]),
    ],
)
def test_symbols_of_clause(clause: str, expected: List[str]) -> None:
    assert uses_in(f"{clause}\n") == expected


def test_clauses_with_errors_are_skipped() -> None:
    assert uses_in("a(1).\nb(.\nc <- d.\n") == ["a/1!", "c/0!", "d/0"]


def test_symbols_of_goals() -> None:
    text = "% goals\nmemorize(a(X), [], a(X), m, 5)\n\nsubscribe(a(_), [], _, alarms, s)\n"
    assert uses_in(text, is_goal_file=True) == [
        *("memorize/5", "a/1", "a/1", "memory m!"),
        *("subscribe/5", "a/1", "topic alarms", "s/0"),
    ]


TOPICS = """<publish_subscribe>
  <!-- <subscribe_to name="no" msg_type="no/No"/> -->
  <subscribe_to name="left" msg_type='std_msgs/Bool' event="bumper"/>
  <subscribe_to name="hot" msg_type="sensor_msgs/Temperature"/>
  <publish_to name="alarms" msg_type="std_msgs/String"/>
  <publish_to name="broken
"""


def test_symbols_of_topics() -> None:
    uses = [(str(use.symbol), use.symbol.kind.name, use.is_definition) for use in uses_in_topics(TOPICS)]
    assert uses == [
        ("left", "TOPIC", True),
        ("std_msgs__0__Bool", "FUNCTOR", False),
        ("bumper", "FUNCTOR", True),
        ("hot", "TOPIC", True),
        ("sensor_msgs__0__Temperature", "FUNCTOR", True),
        ("alarms", "TOPIC", True),
        ("std_msgs__0__String", "FUNCTOR", False),
    ]
    assert [TOPICS[use.start : use.end] for use in uses_in_topics(TOPICS)][:3] == [
        "left",
        "std_msgs/Bool",
        "bumper",
    ]
    assert event_types_in_topics(TOPICS) == {"bumper": "std_msgs/Bool"}


OBSERVED = """<publish_subscribe>
  <observe_action name="go" action_type="lab/action/Go" event="drive"/>
  <observe_service name="dock" srv_type="std_srvs/SetBool"/>
  <observe_service name="lamp" srv_type="std_srvs/SetBool" event="light"/>
</publish_subscribe>
"""


def test_symbols_of_observed_actions_and_services() -> None:
    uses = [use for use in uses_in_topics(OBSERVED) if use.is_definition]
    kinds = ("goal", "cancel", "feedback", "status", "result")
    assert [(str(use.symbol), OBSERVED[use.start : use.end]) for use in uses] == [
        *((f"go/{kind}", "go") for kind in kinds),
        *((f"drive__{kind}", "drive") for kind in kinds),
        ("dock/_service_event", "dock"),
        ("std_srvs__0__SetBool_Event", "std_srvs/SetBool"),
        ("lamp/_service_event", "lamp"),
        ("light", "light"),
    ]
    assert all(str(use.symbol).endswith(use.suffix) for use in uses)
    assert event_types_in_topics(OBSERVED) == {
        **{f"drive__{kind}": f"lab/Go__{kind}" for kind in kinds},
        "light": "std_srvs/SetBool_Event",
    }
