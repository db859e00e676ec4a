"""Restart of the master: both nodes register again, and messages are delivered."""

import sys
from pathlib import Path
from typing import Any, Dict, List
from xmlrpc.client import ServerProxy

import pytest

PROBE = Path(__file__).with_name("round_trip_probe.py")
CONFIGURATIONS = {
    "text": ("_direct:=false",),
    "direct": ("_direct:=[in, std_msgs/String]",),
    "embedded": ("_direct:=false", "_embedded:=true"),
}
FILES = {
    "pub_sub.xml": '<publish_subscribe><subscribe_to name="in" msg_type="std_msgs/String"/>'
    '<publish_to name="out" msg_type="std_msgs/String"/></publish_subscribe>',
    "goalPredicates.txt": "subscribe(std_msgs__0__String(X), [], _, out, o1)\n",
}
WARNING = "the master was started anew"


@pytest.fixture
def program(tmp_path: Path) -> Path:
    folder = tmp_path / "program"
    folder.mkdir()
    for name, text in FILES.items():
        (folder / name).write_text(text)
    return folder


class Master:
    """A master without other processes, and its registrations of the nodes."""

    def __init__(self, space: Any) -> None:
        self._space = space
        self.uri: Any = ServerProxy(space.env["ROS_MASTER_URI"])
        self.start()

    def start(self) -> None:
        self._process = self._space.start_master()

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()

    def wait_until(self, condition: Any) -> None:
        def holds(nodes: Any, services: Any) -> Any:
            try:
                return condition()
            except OSError:
                return False

        self._space.expect(holds)

    def registrations(self) -> List[List[Any]]:
        """Return the publications, subscriptions and services of the nodes."""
        state = self.uri.getSystemState("/test")[2]
        return [
            sorted((name, node) for name, nodes in entries for node in nodes if node.startswith("/retalis"))
            for entries in state
        ]

    def parameters(self) -> Dict[Any, Any]:
        names = ("/use_sim_time", "/retalis/program", "/retalis_ros_interface/program")
        return {name: self.uri.getParam("/test", name)[2] for name in names}


@pytest.fixture
def nodes(devel: Any, program: Path) -> Any:
    """Return a function that starts both nodes, and the master."""
    master = Master(devel)
    master.uri.setParam("/test", "/use_sim_time", False)

    def start(configuration: Any) -> Master:
        arguments = (f"_program:={program}", *CONFIGURATIONS[configuration])
        devel.start(devel.executable("retalis_node"), *arguments)
        if configuration != "embedded":
            name = "__name:=retalis_ros_interface"
            devel.start(devel.executable("retalis_ros_converter.py"), name, *arguments)
        probe(devel, "before")
        return master

    return start


def probe(space: Any, text: str) -> None:
    space.env["PYTHONPATH"] = str(PROBE.parent)
    try:
        space.run(sys.executable, str(PROBE), text)
    finally:
        space.env.pop("PYTHONPATH")


@pytest.mark.parametrize("configuration", CONFIGURATIONS)
def test_nodes_register_with_new_master(devel: Any, nodes: Any, configuration: str) -> None:
    master = nodes(configuration)
    before = master.registrations()
    parameters = master.parameters()
    for number in (1, 2):
        master.kill()
        master.start()
        master.wait_until(lambda before=before: master.registrations() == before)
        assert master.parameters() == parameters
        probe(devel, f"after{number}")
        before = master.registrations()
        assert [topic for topic, _ in before[1]].count(f"/topic_after{number}") == 1
        warning_count = number * (1 if configuration == "embedded" else 2)
        master.wait_until(lambda warning_count=warning_count: devel.printed().count(WARNING) == warning_count)


def test_changed_parameter_is_not_overwritten(devel: Any, nodes: Any) -> None:
    master = nodes("embedded")
    before = master.registrations()
    master.kill()
    master.start()
    master.uri.setParam("/test", "/retalis/program", "/another")
    master.wait_until(lambda: master.registrations() == before)
    assert master.parameters()["/retalis/program"] == "/another"


def test_ended_node_is_not_registered_again(devel: Any, nodes: Any) -> None:
    master = nodes("embedded")
    master.kill()
    master.start()
    node = devel.started[1]
    node.terminate()
    assert node.wait(60) == 0
    assert master.registrations() == [[], [], []]
