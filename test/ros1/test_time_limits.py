"""Endless goals in a node with default parameters: they are reported and aborted."""

from pathlib import Path
from typing import Any

import pytest

RULES = """
loop :- loop.
busy :- get_time(Now), End is Now + 2, repeat, get_time(Later), Later > End, !.
null_event do loop <- endless.
null_event do (busy, writeln('it was busy'), flush_output) <- long.
null_event do (writeln('it goes on'), flush_output) <- short.
null_event do (write(X), nl, write(user_error, X), nl(user_error)) <- say(X).
null_event do (repeat, writeln('it floods'), fail) <- flood.
"""
INITIAL_GOALS = "compile_event_file('rules.txt')\nbusy\nwriteln('it has started')\nflush_output\n"
WARNING = "has taken"
ERROR = "Not enough resources: seconds"


@pytest.fixture
def start(devel: Any, tmp_path: Path) -> Any:
    """Return a function that starts a node with a program whose initial goal takes two seconds."""
    (tmp_path / "pub_sub.xml").write_text("<publish_subscribe/>")
    (tmp_path / "rules.txt").write_text(RULES)
    (tmp_path / "goalPredicates.txt").write_text(INITIAL_GOALS)
    devel.start_master()

    def start(*parameters: Any) -> None:
        devel.start(devel.executable("retalis_node"), f"_program:={tmp_path}", *parameters)
        devel.expect(lambda nodes, services: "/add_memory" in services)

    return start


def test_endless_event_is_reported_and_ended(devel: Any, start: Any) -> None:
    start()
    devel.post_events("endless")
    devel.expect_printed("goal loop is running at event endless; event(endless) has taken")
    assert ERROR not in devel.printed()
    devel.expect_printed(ERROR)
    devel.post_events("short")
    devel.expect_printed("it goes on")


def test_initial_goals_have_no_limit_of_events(devel: Any, start: Any) -> None:
    start("_max_seconds:=0.5")
    assert "it has started" in devel.printed()
    assert ERROR not in devel.printed()
    devel.post_events("long")
    devel.expect_printed(ERROR)
    devel.post_events("short")
    devel.expect_printed("it goes on")
    assert "| it was busy" not in devel.printed().splitlines()


def test_zero_disables_limit_and_watchdog(devel: Any, start: Any) -> None:
    start("_max_seconds:=0", "_watchdog:=0")
    devel.post_events("long")
    devel.expect_printed("it was busy")
    assert ERROR not in devel.printed()
    assert WARNING not in devel.printed()


def test_output_of_goals_is_marked_and_limited(devel: Any, start: Any) -> None:
    start("_max_seconds:=60")  # a busy machine takes long for a megabyte of lines
    devel.post_events(r'say("\e[31mred\n[ERROR] [1.0]: forged")')
    devel.expect_printed("forged")
    devel.post_events("flood")
    devel.expect_printed("Not enough resources: output")
    devel.post_events("short")
    devel.expect_printed("it goes on")
    text = devel.printed()
    lines = text.splitlines()
    assert "\x1b[31mred" not in text
    assert lines.count(r'| "\x1b[31mred') == lines.count('| [ERROR] [1.0]: forged"') == 2
    assert 90_000 < lines.count("| it floods") <= 100_000
    assert text.count("Not enough resources: output") == 1
