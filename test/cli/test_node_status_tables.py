"""Tables of the commands ``list`` and ``watch``."""

import pytest

from retalis.cli.node_status_tables import format_list, format_status

LISTED = {
    "node": "/a",
    "now": 1795367020.25,
    "work": "event b",
    "work_time": 75.0,
    "work_goal": "",
    "work_place": "",
    "taken": 30,
    "fired": 2,
    "queued": 4,
    "dropped": 0,
    "errors": 1,
    "warnings": 0,
    "alarms": 5,
}


def test_list_begins_with_summary() -> None:
    assert format_list(LISTED) == [
        "node      /a",
        "time      1795367020.25",
        "work      busy for 1m15s with event b",
        "events    30 received, 4 queued, 0 dropped",
        "firings   2",
        "problems  1 error, 0 warnings",
        "alarms    5",
    ]
    assert format_list({**LISTED, "now": None}, has_engine=False) == ["node  /a", "time  -"]


def test_state_of_forwarding_is_one_line() -> None:
    state = "connected to mqtt://fleet:1883 for 5 min 2 s, 3 events queued"
    record = {**LISTED, "forwarding": state}
    assert format_list(record)[-1] == f"forwarding  {state}"
    # A narrow terminal wraps it.
    lines = format_status(record, record, 1.0, 60)[-2:]
    assert lines == ["forwarding  connected to mqtt://fleet:1883 for 5 min 2 s, 3", "events queued"]


def test_list_names_published_and_subscribed_topics() -> None:
    tables = {
        "subscriptions": [{"topic": "alarms", "sent": 3}],
        "inputs": [{"topic": "/tf", "lag": 0.000012}],
        "memories": [{"id": "m", "size": 10}, {"id": "long", "size": 2}],
        "more_memories": 7,
        "more_rules": 2,
        "more_inputs": 0,
    }
    assert format_list({**LISTED, **tables})[7:] == [
        "rules: 2",
        "",
        "memories",
        "  id    size",
        "  m     10",
        "  long  2",
        "  and 7 more",
        "",
        "published topics",
        "  topic   sent",
        "  alarms  3",
        "",
        "subscribed topics",
        "  topic  lag",
        "  /tf    0.000012",
    ]


def test_list_of_rules_begins_with_names() -> None:
    lines = format_list({**LISTED, "rules": [{"label": "", "text": "a<-b", "name": "a"}]})
    assert lines[-2:] == ["  name  label  text", "  a            a<-b"]


def test_list_shortens_values_to_one_line() -> None:
    for value, text in (
        ("a\nb" + "c" * 100, "a b" + "c" * 54 + "..."),
        ("/x" * 100 + "/rules.txt:12:1", "..." + ("/x" * 100 + "/rules.txt:12:1")[-57:]),
        ([1, 2], "1; 2"),
        ([{"id": "a", "behind": 1.5}], "id a, behind 1.5"),
        (None, "-"),
        (7.0, "7"),
    ):
        assert format_list({"node": "/a", "inputs": [{"value": value}]}, False)[-1] == f"  {text}"


NODE = {"node": "/a", "now": 100.0, "work": "", "taken": 0, "fired": 0, "queued": 0, "errors": 0}
RULE = {
    "label": "",
    "text": "a <- b",
    "place": "/x/rules.txt:1:1",
    "fired": 2,
    "last_fired": 75.0,
    "name": "a",
}
RULE = {**RULE, "errors": 0, "waiting": 0, "dropped": 0}


def test_status_has_rates_and_ages() -> None:
    after = {**NODE, "now": 110.0, "taken": 30, "fired": 5, "rules": [{**RULE, "fired": 7}]}
    assert format_status({**NODE, "rules": [RULE]}, after, 10.0, 80) == [
        "/a  active  3.0 events/s  0.5 firings/s",
        "",
        "rules",
        "  rule  place        firings/s  last",
        "  a     rules.txt:1  0.5        35s",
    ]


def test_status_shows_problems_and_hides_zeros() -> None:
    (head,) = format_status(NODE, {**NODE, "inputs": [], "more_rules": 0, "waiting": []}, 1.0, 80)
    assert head == "/a  idle  0.0 events/s  0.0 firings/s"
    busy = {
        "work": "event a",
        "work_time": 75.0,
        "work_goal": "goal g",
        "work_place": "",
        "errors": 2,
        "more_rules": 3,
    }
    rows = [RULE, {**RULE, "label": "second", "name": "second", "errors": 2}]
    lines = format_status(NODE, {**NODE, **busy, "rules": rows}, 1.0, 100)
    assert lines[0] == (
        "/a  busy for 1m15s with event a: goal g  0.0 events/s  0.0 firings/s  errors 2  3 more rules"
    )
    assert [line.split() for line in lines[3:]] == [
        ["rule", "place", "firings/s", "last", "errors"],
        ["a", "rules.txt:1", "-", "25s", "0"],
        ["second", "rules.txt:1", "-", "25s", "2"],
    ]


def test_status_has_columns_for_late_and_ahead() -> None:
    subscription = {"topic": "alarms", "id": "a", "event": "fire", "sent": 0}
    counts = {"late": 3, "ahead": 2}
    after = {**NODE, "rules": [{**RULE, **counts}], "subscriptions": [{**subscription, **counts}]}
    headings = [line.split() for line in format_status(NODE, after, 1.0, 100) if "late" in line]
    assert [(heading.count("late"), heading.count("ahead")) for heading in headings] == [(1, 1), (1, 1)]


def test_status_without_time_has_no_ages() -> None:
    lines = format_status(NODE, {**NODE, "now": None, "rules": [RULE]}, 1.0, 80)
    assert lines[-1].split()[-1] == "-"


def test_status_is_idle_without_events() -> None:
    assert format_status(NODE, NODE, 1.0, 80)[0].startswith("/a  idle  0.0 events/s")
    assert format_status(NODE, {**NODE, "taken": 1}, 1.0, 80)[0].startswith("/a  active  1.0 events/s")


def test_restarted_node_has_no_negative_rate() -> None:
    assert "0.0 events/s" in format_status({**NODE, "taken": 100}, {**NODE, "taken": 5}, 1.0, 80)[0]


def test_status_of_interface_has_no_engine() -> None:
    row = {"topic": "/tf", "type": "tf/tfMessage", "publishers": 0, "messages": 9, "age": 7200.0, "lag": 0.25}
    row = {**row, "dropped": 1, "refused": 2}
    status = {**NODE, "inputs": [row]}
    assert [line.split() for line in format_status(status, status, 1.0, 80, has_engine=False)] == [
        ["/a"],
        [],
        ["inputs"],
        ["topic", "type", "messages/s", "last", "lag", "publishers", "lost"],
        ["/tf", "tf/tfMessage", "0.0", "2h00m", "250ms", "0", "3"],
    ]


def test_status_fits_terminal() -> None:
    long = "long" * 20
    memory = {
        "id": long,
        "event": long,
        "records": 10**6,
        "size": 10**6,
        "added": 5,
        "newest": 1.0,
        "oldest": 1.0,
    }
    waits = {"id": "odom", "behind": 0.5}
    topic = {"topic": f"/robot/{long}", "type": long, "publishers": 3, "messages": 5, "age": 1e6, "lag": 1e6}
    status = {
        **NODE,
        **{f"more_{name}": 1 for name in ("rules", "memories", "subscriptions", "waiting", "inputs")},
        "rules": [{**RULE, "text": long, "errors": 10**9, "waiting": 10**6, "dropped": 10**6}],
        "memories": [memory],
        "subscriptions": [
            {"topic": long, "id": long, "event": long, "sent": 5, "late": 10**6, "dropped": 10**6}
        ],
        "waiting": [{"event": long, "since": 5.0, "memories": [waits] * 5, "left_out": 3}],
        "inputs": [{**topic, "dropped": 10**6, "refused": 0}],
    }
    lines = format_status(status, status, 1.0, 80)
    assert max(map(len, lines)) <= 80
    text = "\n".join(lines)
    for head in (
        "dropped",
        "added/s",
        "oldest",
        "sent/s",
        "waits for",
        "publishers",
        "lost",
    ):
        assert head in text
    assert "..." + long[-5:] in text  # the end of a topic is shown


@pytest.mark.parametrize(
    ("seconds", "age"),
    [
        (0.04, "0.0s"),
        (9.94, "9.9s"),
        (59.4, "59s"),
        (59.6, "1m00s"),
        (3599.4, "59m59s"),
        (3600, "1h00m"),
        (90_000, "1d01h"),
    ],
)
def test_ages_are_short(seconds: float, age: str) -> None:
    lines = format_status(NODE, {**NODE, "rules": [{**RULE, "last_fired": 100.0 - seconds}]}, 1.0, 80)
    assert lines[-1].split()[-1] == age
