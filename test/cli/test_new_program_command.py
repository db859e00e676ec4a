"""Command ``new``: sources of topics, errors, and files."""

from pathlib import Path
from typing import Tuple

import pytest

from retalis import BagWriter, Definitions
from retalis.cli.command_line import main


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the working folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run_new(capsys: pytest.CaptureFixture[str], *arguments: str) -> Tuple[int, str]:
    """Return the exit status and the printed text."""
    status = main(["new", *arguments])
    captured = capsys.readouterr()
    return status, captured.out + captured.err


def test_new_program_passes_check_and_test(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    status, text = run_new(
        capsys, "robot", "--from", "scan:sensor_msgs/LaserScan", "--from", "tf:tf2_msgs/TFMessage"
    )
    assert status == 0
    assert text.endswith("next: retalis check robot && retalis test robot\n")
    assert main(["check", "--strict", "robot"]) == 0
    assert main(["test", "robot"]) == 0
    assert capsys.readouterr().out == "robot: no errors, no warnings\n2 passed\n"
    assert "roslaunch launch/robot.launch" in (folder / "robot" / "launch" / "robot.launch").read_text()


def test_name_of_topic_is_not_replaced(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    assert run_new(capsys, "robot", "--from", "FILENAME:std_msgs/String")[0] == 0
    assert '<subscribe_to name="FILENAME"' in (folder / "robot" / "pub_sub.xml").read_text()


def test_folder_with_hidden_entries_is_used(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    (folder / "robot" / ".git").mkdir(parents=True)
    assert run_new(capsys, "robot")[0] == 0
    assert main(["test", "robot"]) == 0


def test_existing_file_is_not_replaced(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    workflow = folder / "robot" / ".github" / "workflows" / "retalis.yml"
    workflow.parent.mkdir(parents=True)
    workflow.write_text("mine")
    status, text = run_new(capsys, "robot")
    assert status == 1
    assert "robot/.github/workflows/retalis.yml already exists: expected a folder without it" in text
    assert workflow.read_text() == "mine"
    assert [path.name for path in (folder / "robot").iterdir()] == [".github"]


def test_topics_of_a_bag(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    definitions = Definitions()
    with BagWriter(folder / "day.bag") as bag:
        bag.add("/battery", definitions.find("sensor_msgs/BatteryState"))
        bag.add("/rosout", definitions.find("std_msgs/String"))
        bag.add("/odd", definitions.add("my_robot/Odd", "bool left"))
    status, text = run_new(capsys, "robot", "--from", "day.bag")
    assert status == 0
    assert "warning: day.bag: topic /odd is omitted: no definition of the message type my_robot/Odd" in text
    topics = (folder / "robot" / "pub_sub.xml").read_text()
    assert topics.count("<subscribe_to") == topics.count('<subscribe_to name="/battery"') == 1


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (("1robot",), "'1robot' is not a valid name of a program: expected letters, digits, _ and -"),
        (
            ("robot", "--from", "nowhere.bag"),
            "--from 'nowhere.bag': expected TOPIC:PACKAGE/Type, or the path of a bag",
        ),
        (("robot", "--from", "s:sensor_msgs/LaserScn"), "did you mean sensor_msgs/LaserScan?"),
        (("robot", "--from", "a b:std_msgs/String"), "' ' is not allowed in it"),
        (("used",), "used already exists: expected a new or an empty folder"),
    ],
)
def test_wrong_arguments_are_errors(
    arguments: Tuple[str, ...], error: str, capsys: pytest.CaptureFixture[str], folder: Path
) -> None:
    (folder / "used").mkdir()
    (folder / "used" / "file").write_text("")
    status, text = run_new(capsys, *arguments)
    assert status == 1
    assert error in text
    assert sorted(path.name for path in folder.iterdir()) == ["used"]


def test_bag_without_known_types_is_an_error(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    with BagWriter(folder / "day.bag"):
        pass
    status, text = run_new(capsys, "robot", "--from", "day.bag")
    assert status == 1
    assert "day.bag: has no topic with a known type" in text
