"""Endless goals in a node with default parameters: they are reported and aborted."""

from pathlib import Path
from typing import Any

import pytest

RULES = """
loop :- loop.
null_event do loop <- endless.
null_event do (writeln('it goes on'), flush_output) <- short.
null_event do (write(X), nl, write(user_error, X), nl(user_error)) <- say(X).
null_event do (repeat, writeln('it floods'), fail) <- flood.
"""
ERROR = "Not enough resources: seconds"


@pytest.fixture
def start(devel: Any, tmp_path: Path) -> Any:
    """Return a function that starts a node with the program."""
    (tmp_path / "pub_sub.xml").write_text("<publish_subscribe/>")
    (tmp_path / "rules.txt").write_text(RULES)
    (tmp_path / "goalPredicates.txt").write_text("compile_event_file('rules.txt')\n")
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
