"""Restart of the master: both nodes register again, and messages are delivered."""

import sys
from pathlib import Path
from xmlrpc.client import ServerProxy

import pytest

PROBE = Path(__file__).with_name("message_probe.py")
WAYS = {
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
def program(tmp_path):
    folder = tmp_path / "program"
    folder.mkdir()
    for name, text in FILES.items():
        (folder / name).write_text(text)
    return folder


class Master:
    """A master without more, and what it knows of the nodes."""

    def __init__(self, space):
        self._space = space
        self.uri = ServerProxy(space.env["ROS_MASTER_URI"])
        self.start()

    def start(self):
        self._process = self._space.start_master()

    def kill(self):
        self._process.kill()
        self._process.wait()

    def wait_until(self, condition):
        def holds(nodes, services):
            try:
                return condition()
            except OSError:
                return False

        self._space.expect(holds)

    def known(self):
        """Return what the nodes have registered."""
        state = self.uri.getSystemState("/test")[2]
        return [
            sorted((name, one) for name, nodes in kind for one in nodes if one.startswith("/retalis"))
            for kind in state
        ]

    def parameters(self):
        names = ("/use_sim_time", "/retalis/program", "/retalis_ros_interface/program")
        return {name: self.uri.getParam("/test", name)[2] for name in names}


@pytest.fixture
def nodes(devel, program):
    """Return a function that starts both nodes, and the master."""
    master = Master(devel)
    master.uri.setParam("/test", "/use_sim_time", False)

    def start(way):
        arguments = (f"_program:={program}", *WAYS[way])
        devel.start("rosrun", "retalis", "retalis_node", *arguments)
        if way != "embedded":
            name = "__name:=retalis_ros_interface"
            devel.start("rosrun", "retalis", "retalis_ros_converter.py", name, *arguments)
        probe(devel, "before")
        return master

    return start


def probe(space, text):
    space.env["PYTHONPATH"] = str(PROBE.parent)
    try:
        space.run(sys.executable, str(PROBE), text)
    finally:
        space.env.pop("PYTHONPATH")


@pytest.mark.parametrize("way", WAYS)
def test_nodes_register_again(devel, nodes, way):
    master = nodes(way)
    before = master.known()
    parameters = master.parameters()
    for number in (1, 2):
        master.kill()
        master.start()
        master.wait_until(lambda before=before: master.known() == before)
        assert master.parameters() == parameters
        probe(devel, f"after{number}")
        before = master.known()
        assert len([one for one in before[1] if one[0] == f"/topic_after{number}"]) == 1
        warned = number * (1 if way == "embedded" else 2)
        master.wait_until(lambda warned=warned: devel.printed().count(WARNING) == warned)


def test_what_somebody_has_set_meanwhile_stays(devel, nodes):
    master = nodes("embedded")
    before = master.known()
    master.kill()
    master.start()
    master.uri.setParam("/test", "/retalis/program", "/another")
    master.wait_until(lambda: master.known() == before)
    assert master.parameters()["/retalis/program"] == "/another"


def test_a_node_that_is_ended_is_not_registered_again(devel, nodes):
    master = nodes("embedded")
    master.kill()
    master.start()
    node = devel.started[1]
    node.terminate()
    assert node.wait(60) == 0
    assert master.known() == [[], [], []]
