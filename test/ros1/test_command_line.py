"""Commands for a running node."""

import json
import re
import signal
import subprocess
from xmlrpc.client import ServerProxy

import pytest

LIVE = ("rosrun", "retalis", "retalis")


def start_node(space):
    """Return the space after a master and node retalis have been started in it."""
    space.start_master()
    space.start("rosrun", "retalis", "retalis_node", "_explain:=true")
    space.expect(lambda found, services: "/retalis/delete_rule" in services)
    return space


@pytest.fixture
def node(devel):
    return start_node(devel)


@pytest.fixture
def node_of_space(space):
    """Node retalis in each space: for commands that find files of the package."""
    return start_node(space)


def said(space, *words, wrong=False, text=None):
    """Return what a command prints; where something is wrong, the error."""
    command = space.command(*LIVE, *words)
    done = subprocess.run(command, env=space.env, input=text, capture_output=True, text=True, timeout=60)
    assert done.returncode == int(wrong), done.stderr
    return done.stderr if wrong else done.stdout


def test_without_a_master_or_a_node(space):
    assert "no master answers at http://localhost" in said(space, "query", "true", wrong=True)
    space.start_master()
    assert said(space, "query", "true", wrong=True) == "retalis: no node retalis runs\n"


def test_goals_are_asked(node_of_space):
    assert said(node_of_space, "query", "member(X, [1, f(_)])") == "X = 1\nX = f(_1)\n"
    found = said(node_of_space, "query", "member(X-Y, [a-1, b-[2]])", "--json", "--node", "/retalis")
    assert [json.loads(line) for line in found.splitlines()] == [{"X": "a", "Y": 1}, {"X": "b", "Y": [2]}]
    assert "column 4" in said(node_of_space, "query", "f(X", wrong=True)
    assert "those that run are /retalis" in said(
        node_of_space, "query", "true", "--node", "other", wrong=True
    )
    late = said(node_of_space, "query", "true", "--wait-for", "odom_base", "--timeout", "0.01", wrong=True)
    assert "in memory odom_base (nothing yet) after 0.01 s" in late
    assert said(node_of_space, "explain", "no_such(1)").startswith("no_such(1) did not happen\n")
    answered = said(node_of_space, "console", "--node", "retalis", text="X = 1 ; X = 2.\nfail.\n")
    assert answered == "X = 1 ;\nX = 2.\nfalse.\n"
    console = ("console", "--node", "retalis", "--json", "--goal")
    assert said(node_of_space, *console, "member(X, [1, a])") == '{"X": 1}\n{"X": "a"}\n'
    assert said(node_of_space, *console, "fail", wrong=True) == ""
    listed = json.loads(said(node_of_space, "list", "--json"))
    assert [memory["id"] for memory in listed["memories"]][:2] == ["odom_base", "base_torso"]
    assert listed["memories"][0]["oldest"] is None and listed["inputs"][0]["age"] is None
    shown = said(node_of_space, "status", "--once", "--every", "0.1").split("\n")
    assert shown[0].startswith("/retalis  idle  0.0 events/s  0.0 firings/s") and "memories" in shown
    assert max(map(len, shown)) <= 80
    assert not any(re.search(r"\d{9}", line) for line in shown)  # no seconds since the epoch


def test_numbers_that_cannot_be_are_told_in_a_line(node):
    for stamp in ("1e12", "-1", "nan"):
        told = said(node, "query", "true", "--stamp", stamp, wrong=True)
        assert told.startswith("retalis: --stamp: expected seconds since the epoch") and told.count("\n") == 1
    for every in ("0", "nan", "inf"):
        told = said(node, "status", "--every", every, wrong=True)
        assert told.startswith("retalis: --every: expected a number above 0") and told.count("\n") == 1


def test_the_interface_is_listed_too(node):
    node.start(
        "rosrun", "retalis", "retalis_ros_converter.py", "__name:=retalis_ros_interface", "_direct:=false"
    )
    node.expect(lambda found, services: "/retalis_ros_interface/list" in services)
    listed = json.loads(said(node, "list", "--json", "--node", "/retalis_ros_interface"))
    assert "/retalisOutputEvents" in [topic["topic"] for topic in listed["inputs"]]
    inputs = json.loads(said(node, "list", "--json"))["inputs"]
    assert {topic["topic"]: topic.get("node") for topic in inputs}["/tf"] == "/retalis_ros_interface"
    assert re.search(r"\n  /ar_pose_marker .* /retalis_ros_interface\n", said(node, "list"))
    for command in ("list", "status"):
        told = said(node, command, "--node", "other", wrong=True)
        assert (
            told == "retalis: there is no node /other; those that run are /retalis, /retalis_ros_interface\n"
        )
    shown = said(node, "status", "--node", "retalis_ros_interface", "--every", "0.1")
    assert "events/s" not in shown and "/retalisOutputEvents" in shown
    told = said(node, "query", "true", "--node", "/retalis_ros_interface", wrong=True)
    assert "has no service ~query: it is a ROS interface, or of an older version" in told


def test_the_namespace_chooses_the_node(devel):
    devel.start_master()
    for space in ("robot1", "robot2", "robot2/arm"):
        devel.start("env", f"ROS_NAMESPACE={space}", "rosrun", "retalis", "retalis_node")
    names = {"/robot1/retalis", "/robot2/retalis", "/robot2/arm/retalis"}
    devel.expect(lambda found, services: {f"{name}/delete_rule" for name in names} <= services)
    all_names = "/robot1/retalis, /robot2/arm/retalis, /robot2/retalis"
    expected = {
        "": f"which node? those that run are {all_names}; choose one by --node",
        "robot2": "which node? those that run are /robot2/arm/retalis, /robot2/retalis; choose one by --node",
        "robot3": f"no node retalis runs in namespace /robot3 (ROS_NAMESPACE); those that run are {all_names}",
    }
    for space, error in expected.items():
        devel.env["ROS_NAMESPACE"] = space
        assert said(devel, "query", "true", wrong=True) == f"retalis: {error}\n"
    devel.env["ROS_NAMESPACE"] = "robot1"
    assert json.loads(said(devel, "list", "--json"))["node"] == "/robot1/retalis"
    assert said(devel, "query", "X = 1") == "X = 1\n"
    devel.env["ROS_NAMESPACE"] = "/robot2"
    assert json.loads(said(devel, "list", "--json", "--node", "retalis"))["node"] == "/robot2/retalis"
    assert json.loads(said(devel, "list", "--json", "--node", "/robot1/retalis"))["node"] == "/robot1/retalis"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_one_who_watches_and_is_ended_leaves_no_subscription(node, number):
    watching = subprocess.Popen(
        node.command(*LIVE, "watch", "--event", "fever_(_)"),
        env=node.env,
        preexec_fn=lambda: signal.signal(number, signal.SIG_DFL),  # these tests may be run by nohup
    )
    try:
        assert any("fever_" in said(node, "list") for _ in range(30))
        watching.send_signal(number)
        assert watching.wait(timeout=60) == 128 + number
    finally:
        watching.kill()
    assert "fever_" not in said(node, "list")
    assert "has no type" not in node.printed()


def test_a_status_and_what_is_watched_go_on_with_a_new_master(node):
    words = {"env": node.env, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    status = subprocess.Popen(node.command(*LIVE, "status", "--json", "--every", "0.1"), **words)
    watch = subprocess.Popen(node.command(*LIVE, "watch", "--inputs", "--count", "1"), **words)
    try:
        status.stdout.readline()
        node.expect(lambda found, services: any(name.startswith("/retalis_watch") for name in found))
        master = node.started[0]
        master.send_signal(signal.SIGINT)
        master.wait(timeout=60)
        assert "unable to contact master" in status.stderr.readline()
        node.start_master()
        status.stdout.readline()
        node.expect(lambda found, services: any(name.startswith("/retalis_watch") for name in found))
        node.start("rostopic", "pub", "-r", "5", "/retalisInputEvents", "std_msgs/String", "event(fever_(1))")
        assert watch.communicate(timeout=60)[0] == "input: event(fever_(1))\n"
        status.send_signal(signal.SIGINT)
        status.communicate(timeout=60)
        assert status.returncode == 130
    finally:
        status.kill()
        watch.kill()


@pytest.mark.parametrize("command", [["watch"], ["status", "--json", "--every", "0.1"]])
def test_messages_of_rospy_are_not_in_the_output(node, command):
    running = subprocess.Popen(
        node.command(*LIVE, *command), env=node.env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        name = f"/retalis_{command[0]}"
        node.expect(lambda found, services: any(one.startswith(name) for one in found))
        running_as = next(one for one in node.state()[0] if one.startswith(name))
        address = ServerProxy(node.env["ROS_MASTER_URI"]).lookupNode("/test", running_as)[2]
        ServerProxy(address).shutdown("/test", "for a test")  # rospy prints this request
        running.send_signal(signal.SIGINT)
        output, messages = running.communicate(timeout=60)
    finally:
        running.kill()
    assert "shutdown request: for a test\n" in messages
    assert all(json.loads(line)["node"] == "/retalis" for line in output.splitlines())


def test_outputs_and_events_are_watched(node):
    watching = subprocess.Popen(
        node.command(*LIVE, "watch", "--event", "fever_(_)", "--count", "1"),
        env=node.env,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        node.start(
            *("rostopic", "pub", "-r", "5", "/retalisInputEvents", "std_msgs/String", "event(fever_('A b'))")
        )
        assert watching.communicate(timeout=60)[0] == "event: fever_('A b')\n"
    finally:
        watching.kill()
    assert watching.returncode == 0


def test_names_are_completed_by_the_shell(node_of_space):
    script = (
        "COMP_WORDS=(retalis query x --wait-for odo); COMP_CWORD=4; _retalis_complete; echo ${COMPREPLY[@]};"
        "COMP_WORDS=(retalis query --node /re); COMP_CWORD=3; _retalis_complete; echo ${COMPREPLY[@]};"
        "COMP_WORDS=(retalis exp); COMP_CWORD=1; _retalis_complete; echo ${COMPREPLY[@]};"
        "COMP_WORDS=(retalis watch --in); COMP_CWORD=2; _retalis_complete; echo ${COMPREPLY[@]}"
    )
    words = ["bash", "-c", f'source "$0"; {script}', str(node_of_space.script)]
    done = subprocess.run(
        words, env=node_of_space.env, stdout=subprocess.PIPE, text=True, timeout=60, check=True
    )
    assert done.stdout == "odom_base\n/retalis\nexplain\n--inputs\n"
