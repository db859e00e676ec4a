"""Reloading of a program in a running node."""

import json
import subprocess

import pytest

LIVE = ("rosrun", "retalis", "retalis")
RULES = "alarm(X) <- smoke(X) seq heat(X).\n"


@pytest.fixture
def folder(tmp_path):
    found = tmp_path / "program"
    found.mkdir()
    (found / "pub_sub.xml").write_text("<publish_subscribe/>\n")
    (found / "goalPredicates.txt").write_text(
        "compile_event_file('rules.txt')\nmemorize(alarm(_), [], _, alarms, 5)\n"
    )
    (found / "rules.txt").write_text(RULES)
    return found


def start(space, folder, *words):
    """Start node retalis with a program, on a master of its own."""
    space.start_master()
    space.start("rosrun", "retalis", "retalis_node", f"_program:={folder}", *words)
    space.expect(lambda found, services: "/retalis/reload" in services)


def said(space, *words, wrong=False):
    """Return what a command prints; where something is wrong, the error."""
    command = space.command(*LIVE, *words)
    done = subprocess.run(command, env=space.env, capture_output=True, text=True, timeout=60)
    assert done.returncode == int(wrong), done.stderr
    return done.stderr if wrong else done.stdout


def happen(space, *events):
    """Have events happen, each at a second."""
    said(space, "query", ", ".join(f"new_event({event}, {second}, 0)" for event, second in events))


def test_a_program_is_read_again(devel, folder):
    start(devel, folder)
    happen(devel, ("smoke(hall)", 1), ("heat(hall)", 2), ("smoke(attic)", 3))
    assert "rules: 0 new, 0 gone, 1 kept, with 1 partial match\n" in said(devel, "reload")
    (folder / "rules.txt").write_text(RULES + "fire <- smoke.\nwrong <- a seq.\n")
    error = said(devel, "reload", wrong=True)
    assert f"{folder}/rules.txt:3:" in error
    assert "\nwrong <- a seq.\n" in error
    assert "^" in error
    (folder / "rules.txt").write_text(RULES + "more(X) <- alarm(X).\n")
    (folder / "pub_sub.xml").write_text(
        '<publish_subscribe><subscribe_to name="a" msg_type="std_msgs/String"/></publish_subscribe>\n'
    )
    told = json.loads(said(devel, "reload", "--json"))
    assert told[0] == "rules: 1 new, 0 gone, 1 kept, with 1 partial match"
    assert "memories: 0 new, 0 gone, 1 kept, with 1 record" in told
    assert told[-1].startswith("topics: pub_sub.xml has changed")
    happen(devel, ("heat(attic)", 4))
    assert said(devel, "query", "memory_counter(alarms, N)") == "N = 2\n"
    (folder / "pub_sub.xml").write_text("<publish_subscribe>\n")
    assert "is not closed" in said(devel, "reload", wrong=True)


def test_a_program_that_goals_could_write_is_not_read_again(devel, folder):
    start(devel, folder, f"_write_folders:=[{folder.parent}]")
    assert "of ~write_folders" in said(devel, "reload", wrong=True)
    assert said(devel, "query", "memory_counter(alarms, N)") == "N = 0\n"
