"""Exact texts of the findings for typical mistakes."""

from collections import defaultdict
from pathlib import Path

import pytest
from source import ROOT

from retalis.engine.program_check import check_program

TABLE = ROOT / "test" / "data" / "mistakes.txt"

TOPICS = """\
<publish_subscribe>
  <subscribe_to name="heat" msg_type="sensor_msgs/Temperature"/>
  <subscribe_to name="bumper" msg_type="std_msgs/Bool"/>
  <subscribe_to name="said" msg_type="std_msgs/String"/>
  <publish_to name="alarms" msg_type="std_msgs/String"/>
"""

GOALS = """\
compile_event_file('eventRules.txt')
memorize(hit, [], _, hits, 10)
subscribe(alarm(Text), [], std_msgs__0__String(Text), alarms, a)
"""

RULES = """\
hit <- std_msgs__0__Bool(true).
alarm('"hit"') <- hit where access_mem(hits, _, _).
"""


def mistakes():
    """Yield the mistakes of the table: what they add to each file, and what is said."""
    for entry in TABLE.read_text(encoding="utf-8").split("\n## ")[1:]:
        name, *lines = entry.rstrip().split("\n")
        found = defaultdict(list)
        for line in lines:
            if line.startswith("|"):
                found["said"].append(line[2:])
            else:
                found[line[:6].strip()].append(line[6:])
        yield pytest.param({kind: "\n".join(lines) for kind, lines in found.items()}, id=name)


def write(folder, rule="", goal="", topic="", said=""):
    """Write a program that has additions."""
    (folder / "pub_sub.xml").write_text(f"{TOPICS}{topic}\n</publish_subscribe>\n")
    (folder / "goalPredicates.txt").write_text(f"{GOALS}{goal}\n")
    (folder / "eventRules.txt").write_text(f"{RULES}{rule}\n")


def said_of(folder: Path, definitions):
    found = check_program(folder, definitions)
    said = "\n".join(f"{finding.severity}: {finding.problem}" for finding in found)
    return said.replace(f"{folder}/", "")


@pytest.mark.parametrize("mistake", list(mistakes()))
def test_a_mistake_is_said_once_with_its_place(tmp_path, definitions, mistake):
    write(tmp_path, **mistake)
    assert said_of(tmp_path, definitions) == mistake["said"]


def test_there_are_thirty_of_them():
    assert len(list(mistakes())) >= 30


def test_nothing_is_said_of_the_program_without_them(tmp_path, definitions):
    write(tmp_path)
    assert said_of(tmp_path, definitions) == ""


def test_a_stamp_is_a_number_of_arithmetic(tmp_path, definitions):
    header = "sensor_msgs__0__Temperature(std_msgs__0__Header(_, T, _), _, _)"
    write(tmp_path, rule=f"hit <- {header} check (t2(E), E - T > 0.5).")
    assert said_of(tmp_path, definitions) == ""


@pytest.mark.parametrize(
    "rule",
    [
        "std_msgs__0__Bool(X) <- std_msgs__0__String(_) where member(X, [0, 1]), X > 0.",
        "std_msgs__0__Bool(X) <- sensor_msgs__0__Temperature(_, X, _).",
        "std_msgs__0__String(X) <- sensor_msgs__0__Temperature(_, T, _) where T > 3, X = go, X == go.",
        "std_msgs__0__Float64(X) <- reading(X) where X \\== unknown.",
    ],
)
def test_what_a_program_makes_of_other_kinds_of_values_is_left_alone(tmp_path, definitions, rule):
    write(tmp_path, rule=rule)
    assert [one.problem for one in check_program(tmp_path, definitions) if one.check == "kinds"] == []


@pytest.mark.slow
def test_nothing_is_said_of_the_example(definitions):
    assert said_of(ROOT / "application_source", definitions) == ""
