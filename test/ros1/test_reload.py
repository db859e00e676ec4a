"""Reloading of a program in a running node."""

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

RULES = "alarm(X) <- smoke(X) seq heat(X).\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    program = tmp_path / "program"
    program.mkdir()
    (program / "pub_sub.xml").write_text("<publish_subscribe/>\n")
    (program / "goalPredicates.txt").write_text(
        "compile_event_file('rules.txt')\nmemorize(alarm(_), [], _, alarms, 5)\n"
    )
    (program / "rules.txt").write_text(RULES)
    return program


def start(space: Any, folder: Any, *words: Any) -> None:
    """Start node retalis with a program, on a master of its own."""
    space.start_master()
    space.start(space.executable("retalis_node"), f"_program:={folder}", *words)
    space.expect(lambda nodes, services: "/retalis/reload" in services)


def output(space: Any, *words: Any) -> Any:
    """Return the standard output of a command."""
    return run_command(space, words, 0).stdout


def error(space: Any, *words: Any) -> Any:
    """Return the error of a command that fails."""
    return run_command(space, words, 1).stderr


def run_command(space: Any, words: Any, status: int) -> Any:
    command = space.command(space.executable("retalis"), *words)
    process = subprocess.run(command, env=space.env, capture_output=True, text=True, timeout=60)
    assert process.returncode == status, process.stderr
    return process


def add_events(space: Any, *events: Any) -> None:
    """Add events, each with a time in seconds."""
    output(space, "query", ", ".join(f"new_event({event}, {second}, 0)" for event, second in events))


def test_changed_program_is_reloaded(devel: Any, folder: Path) -> None:
    start(devel, folder)
    add_events(devel, ("smoke(hall)", 1), ("heat(hall)", 2), ("smoke(attic)", 3))
    assert "rules: 0 new, 0 gone, 1 kept, with 1 partial match\n" in output(devel, "reload")
    (folder / "rules.txt").write_text(RULES + "fire <- smoke.\nwrong <- a seq.\n")
    message = error(devel, "reload")
    assert f"{folder}/rules.txt:3:" in message
    assert "\nwrong <- a seq.\n" in message
    assert "^" in message
    (folder / "rules.txt").write_text(RULES + "more(X) <- alarm(X).\n")
    (folder / "pub_sub.xml").write_text(
        '<publish_subscribe><subscribe_to name="a" msg_type="std_msgs/String"/></publish_subscribe>\n'
    )
    changes = json.loads(output(devel, "reload", "--json"))
    assert changes[0] == "rules: 1 new, 0 gone, 1 kept, with 1 partial match"
    assert "memories: 0 new, 0 gone, 1 kept, with 1 record" in changes
    assert changes[-1].startswith("topics: pub_sub.xml has changed")
    add_events(devel, ("heat(attic)", 4))
    assert output(devel, "query", "memory_counter(alarms, N)") == "N = 2\n"
    (folder / "pub_sub.xml").write_text("<publish_subscribe>\n")
    assert "is not closed" in error(devel, "reload")


def test_writable_program_is_not_reloaded(devel: Any, folder: Path) -> None:
    start(devel, folder, f"_write_folders:=[{folder.parent}]")
    assert "of ~write_folders" in error(devel, "reload")
    assert output(devel, "query", "memory_counter(alarms, N)") == "N = 0\n"
