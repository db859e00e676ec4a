"""Tutorial about a program on ROS 2: its commands print the output on the page.

The commands of ros2cli, which is not on PyPI, are replaced by a node of rclpy.
"""

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Iterator, List

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed")
pytest.importorskip("retalis.srv", reason="the classes of this package's services have not been generated")

from ros2.node_processes import NodeProcess, find_program
from ros2.rclpy_nodes import TIMEOUT_SECONDS, Network, wait_until
from std_msgs.msg import Float32, String

TUTORIALS = Path(__file__).resolve().parents[2] / "docs" / "tutorials"
FILE = re.compile(r"^<!-- (corner/\S+) -->\n```\w*\n(.*?)^```", re.DOTALL | re.MULTILINE)
FENCE = re.compile(r"^```(\w+)\n(.*?)^```", re.DOTALL | re.MULTILINE)
COMMAND = re.compile(r"^\$ (.*)\n((?:(?!\$ ).*\n)*)", re.MULTILINE)
VARYING = ((re.compile(r"datime\([\d,]*\)"), "datime(...)"), (re.compile(r"/\S*/corner/"), ".../corner/"))
"""Patterns of output that differs between readers, with the text on the page."""
RETALIS = ["ros2", "run", "retalis", "retalis"]
PUBLISH = ["ros2", "topic", "pub", "--once", "/bumper", "std_msgs/msg/String"]


@pytest.fixture
def network(domain: int) -> Iterator[Network]:
    network = Network()
    yield network
    network.close()


@pytest.fixture
def node(domain: int, tmp_path: Path) -> Iterator[NodeProcess]:
    # A later version of a file replaces an earlier one, as for a reader.
    for name, text in FILE.findall((TUTORIALS / "robot-program.md").read_text(encoding="utf-8")):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    rules = tmp_path / "corner" / "eventRules.txt"
    rules.write_text(rules.read_text(encoding="utf-8").replace("within 10", "within 60"), encoding="utf-8")
    node = NodeProcess(tmp_path / "node.log", "-p", f"program:={tmp_path / 'corner'}", "-p", "explain:=true")
    yield node
    node.kill()


def run(words: List[str], folder: Path) -> str:
    """Return the output of the installed command, with the page's text for what varies."""
    output = subprocess.run(
        [sys.executable, find_program("retalis"), *words],
        cwd=folder,
        env=dict(os.environ),
        stdout=subprocess.PIPE,
        text=True,
        timeout=TIMEOUT_SECONDS,
    ).stdout
    for pattern, replacement in VARYING:
        output = pattern.sub(replacement, output)
    return output


class Session:
    """The commands of a reader of the page.

    Args:
        network: network of the node.
        folder: the reader's folder.
    """

    def __init__(self, network: Network, folder: Path) -> None:
        self._folder = folder
        self._publisher = network.add_node().create_publisher(String, "/bumper", 10)
        wait_until(self._publisher.get_subscription_count)
        self.message_count = 0

    def run(self, command: str) -> str:
        """Return the output of a command; messages are published here."""
        words = shlex.split(command)
        if words[: len(PUBLISH)] == PUBLISH:
            self._publish(words[-1])
            return ""
        assert words[: len(RETALIS)] == RETALIS
        return run(words[len(RETALIS) :], self._folder)

    def _publish(self, text: str) -> None:
        """Publish a message, and wait until the node has received it."""
        match = re.fullmatch(r"\{data: (\w+)\}", text)
        assert match is not None
        self._publisher.publish(String(data=match[1]))
        self.message_count += 1
        wait_until(self._has_received_all)

    def _has_received_all(self) -> bool:
        status = json.loads(run(["list", "--json"], self._folder))
        counts = {topic["topic"]: topic["messages"] for topic in status["inputs"]}
        return bool(counts["/bumper"] == self.message_count)


@pytest.mark.slow
def test_commands_print_output_of_page(node: NodeProcess, network: Network, tmp_path: Path) -> None:
    wait_until(lambda: "corner: 4 event rules, 1 memory, 1 subscription" in node.log())
    turns: List[float] = []
    network.add_node("reader").create_subscription(
        Float32, "/turn", lambda message: turns.append(message.data), 10
    )
    session = Session(network, tmp_path)
    rules = tmp_path / "corner" / "eventRules.txt"
    commands: List[str] = []
    for language, text in FENCE.findall((TUTORIALS / "ros2-robot.md").read_text(encoding="utf-8")):
        if language == "prolog":
            with rules.open("a", encoding="utf-8") as file:
                file.write(text)
        for command, expected in COMMAND.findall(text) if language == "console" else ():
            assert session.run(command) == expected, command
            commands.append(command)
    assert (len(commands), session.message_count) == (8, 4)
    wait_until(lambda: turns and turns[-1] == 0.0)
