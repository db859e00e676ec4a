"""Command ``msg``: message types of the installation and of bags."""

import json
from pathlib import Path
from typing import Any, Dict

import pytest
from rosbags import rosbag2

from retalis import BagWriter, Definitions
from retalis.cli.command_line import main


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    definitions = Definitions()
    name, path = "only_in_bags/Point", tmp_path / "some.bag"
    with BagWriter(path) as writer:
        connection = writer.add("/points", definitions.add(name, "float64 x\nfloat64 y\n"))
        writer.write(connection, 1, bytes(16))
    return path


PRINTED = {
    "term": """\
only_in_bags__0__Point(  % 16 bytes
    X,                   % x: float64, 8 bytes
    Y                    % y: float64, 8 bytes
)
""",
    "names": """\
only_in_bags__0__Point{  % 16 bytes
    x: X,                % float64, 8 bytes
    y: Y                 % float64, 8 bytes
}
""",
    "zero": "only_in_bags__0__Point(0.0,0.0)\n",
}

STRING = """\
std_msgs__0__String(  % 4 bytes or more
    Data              % data: string, 4 bytes + text
)
"""


@pytest.mark.parametrize(("name", "text"), PRINTED.items())
def test_type_of_bag_is_printed_in_each_format(
    bag: Path, name: str, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["msg", "only_in_bags/Point", "--bag", str(bag), "--format", name]) == 0
    assert capsys.readouterr().out == text


@pytest.mark.parametrize("name", ["std_msgs/String", "std_msgs__0__String", "std_msgs/msg/String"])
def test_each_form_of_type_name_is_accepted(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["msg", name]) == 0
    assert capsys.readouterr().out == STRING


def test_type_of_ros2_bag_is_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options: Dict[str, Any] = {"version": 8} if hasattr(rosbag2, "StoragePlugin") else {}
    with rosbag2.Writer(tmp_path / "two", **options) as writer:
        connection = writer.add_connection(
            "/solid", "my_msgs/msg/Solid", msgdef="float64[<=3] sizes [1, 2]\n", rihs01="RIHS01_0"
        )
        writer.write(connection, 1, bytes([0, 1, 0, 0, 0, 0, 0, 0]))
    assert main(["msg", "my_msgs/msg/Solid", "--bag", str(tmp_path / "two")]) == 0
    assert capsys.readouterr().out == (
        "my_msgs__0__Solid(  % 4 bytes or more\n    Sizes           % sizes: float64[], 4 bytes + 8 per element\n)\n"
        "\n% for array_min/2, array_percentile/3 and others: sizes\n"
    )


def test_unreadable_type_of_bag_has_reason(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options: Dict[str, Any] = {"version": 8} if hasattr(rosbag2, "StoragePlugin") else {}
    with rosbag2.Writer(tmp_path / "two", **options) as writer:
        writer.add_connection("/solid", "my_msgs/msg/Solid", msgdef="float64[<3] sizes\n", rihs01="RIHS01_0")
    assert main(["msg", "my_msgs/Solid", "--bag", str(tmp_path / "two")]) == 1
    assert "two: my_msgs/Solid:1:1: expected 'type name' or" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "error"),
    [
        ("only_in_bags/Point", "retalis: no definition of the message type only_in_bags/Point"),
        ("Point", 'expected a message type "package/Type"'),
        (
            "std_srvs/Trigger",
            "std_srvs/Trigger is a service: its messages are std_srvs/Trigger_Request and std_srvs/Trigger_Response",
        ),
    ],
)
def test_unknown_type_is_an_error(name: str, error: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["msg", name]) == 1
    assert error in capsys.readouterr().err


def test_type_that_bag_lacks_is_an_error(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["msg", "only_in_bags/Other", "--bag", str(bag)]) == 1
    assert capsys.readouterr().err.endswith("is installed or has been received\n")


@pytest.mark.parametrize("name", ["std_msgs/string", "std_msgs/Strng", "String", "string", "std_mgs/String"])
def test_unknown_type_has_similar_name(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["msg", name]) == 1
    assert capsys.readouterr().err.endswith("; did you mean std_msgs/String?\n")


def test_topics_of_bag_are_listed_without_type(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["msg", "--bag", str(bag)]) == 0
    assert capsys.readouterr().out == (
        "topic    type                messages\n/points  only_in_bags/Point  1\n"
    )
    assert main(["msg", "--bag", str(bag), "--json"]) == 0
    row = {"topic": "/points", "type": "only_in_bags/Point", "messages": 1}
    assert json.loads(capsys.readouterr().out) == {"topics": [row], "unreadable": []}


def test_type_is_printed_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["msg", "geometry_msgs/PoseWithCovariance", "--json", "--format", "zero"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["type"] == "geometry_msgs/PoseWithCovariance"
    assert printed["md5sum"] == "c23e848cf1b7533a8d7c259073a97e6f"
    assert printed["slots"] == [
        {"name": "pose", "type": "geometry_msgs/Pose"},
        {"name": "covariance", "type": "float64[36]"},
    ]
    assert printed["text"].startswith("geometry_msgs__0__PoseWithCovariance(")


def test_missing_type_without_bag_is_usage_error(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as exit_info:
        main(["msg"])
    assert exit_info.value.code == 2
    assert "give a type as PACKAGE/Type, or --bag" in capsys.readouterr().err
