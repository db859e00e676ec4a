"""Template of a new program: its checks and its first test pass for any topics."""

import ast
from pathlib import Path
from typing import Sequence
from xml.etree import ElementTree

import pytest

from retalis import Definitions
from retalis.cli.program_template import make_files, name_topics
from retalis.engine.engine_settings import Settings
from retalis.engine.program_check import check_program
from retalis.events.program.topic_configuration import AUTO
from retalis.testing.case_file import read_case_file
from retalis.testing.case_run import run_case

TYPES = (
    "std_msgs/String",
    "std_msgs/Empty",
    "std_msgs/Header",
    "std_msgs/Time",
    "std_msgs/UInt8MultiArray",
    "sensor_msgs/BatteryState",
    "sensor_msgs/Image",
    "sensor_msgs/JointState",
    "geometry_msgs/PoseStamped",
    "geometry_msgs/PoseArray",
    "nav_msgs/Path",
    "tf2_msgs/TFMessage",
    "diagnostic_msgs/DiagnosticArray",
)


def write_program(folder: Path, topics: Sequence[str], definitions: Definitions) -> None:
    """Write a new program for topics, given as ``NAME:TYPE``."""
    pairs = [
        (name, definitions.find(type_name))
        for name, _, type_name in (topic.partition(":") for topic in topics)
    ]
    for path, text in make_files("mine", name_topics(pairs)).items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(text, encoding="utf-8")


def find_problems(folder: Path, definitions: Definitions) -> Sequence[str]:
    """Return the findings of the checks, and the failures of the test cases."""
    findings = check_program(folder, definitions, AUTO, Settings())
    failures = [
        failure
        for case in read_case_file(folder / "tests" / "mine.yaml")
        for failure in run_case(case, definitions).failures
    ]
    return [*(str(finding.problem) for finding in findings), *failures]


@pytest.mark.parametrize("type_name", TYPES)
def test_program_for_type_passes_its_checks_and_test(
    type_name: str, definitions: Definitions, tmp_path: Path
) -> None:
    write_program(tmp_path, [f"sensor:{type_name}"], definitions)
    assert find_problems(tmp_path, definitions) == []


def test_topics_with_equal_types_and_names_have_events_of_their_own(
    definitions: Definitions, tmp_path: Path
) -> None:
    topics = ["/left/bumper:std_msgs/Bool", "/right/bumper:std_msgs/Bool", "/x/and:std_msgs/Int8"]
    write_program(tmp_path, topics, definitions)
    assert find_problems(tmp_path, definitions) == []
    rules = (tmp_path / "eventRules.txt").read_text(encoding="utf-8")
    assert "bumper_value(Value) <- bumper_value_message{data: Value}." in rules
    assert "bumper_value_2(Value) <- bumper_value_2_message{data: Value}." in rules
    assert "and_value(Value) <- std_msgs__0__Int8{data: Value}." in rules


def test_launch_files_name_the_program(definitions: Definitions, tmp_path: Path) -> None:
    write_program(tmp_path, ["a:std_msgs/String"], definitions)
    launch = ElementTree.parse(tmp_path / "launch" / "mine.launch").getroot()
    assert [argument.get("value") for argument in launch.iter("arg")] == ["$(dirname)/..", "false", "[]"]
    text = (tmp_path / "launch" / "mine.launch.py").read_text(encoding="utf-8")
    names = {node.name for node in ast.parse(text).body if isinstance(node, ast.FunctionDef)}
    assert names == {"generate_launch_description"}


@pytest.mark.parametrize("topic", ["null", "true", "FILENAME", "/NAME/x"])
def test_names_of_topics_are_kept_in_all_files(topic: str, definitions: Definitions, tmp_path: Path) -> None:
    write_program(tmp_path, [f"{topic}:std_msgs/String"], definitions)
    assert find_problems(tmp_path, definitions) == []
    (case,) = read_case_file(tmp_path / "tests" / "mine.yaml")
    assert case.name == f"{topic} is received, and silent afterwards"
