"""Commands for a running node."""

import json
import signal
import subprocess
from typing import Any, List
from xmlrpc.client import ServerProxy

import pytest
from asserting_accessors import required


def restore_sigint() -> None:
    """Let SIGINT end a process, because a shell starts background processes with the signal ignored."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def start_node(space: Any) -> Any:
    """Start a master and node retalis in a space; return the space."""
    space.start_master()
    space.start(space.executable("retalis_node"), "_explain:=true")
    space.expect(lambda nodes, services: "/retalis/delete_rule" in services)
    return space


@pytest.fixture
def node(devel: Any) -> Any:
    return start_node(devel)


@pytest.fixture(scope="module")
def shared_node(module_devel: Any) -> Any:
    """Return node retalis for tests that do not change its program or its master."""
    return start_node(module_devel)


@pytest.fixture(scope="module")
def node_of_space(module_space: Any) -> Any:
    """Return node retalis in each space, for commands that read files of the package."""
    return start_node(module_space)


def output(space: Any, *words: Any, text: Any = None) -> Any:
    """Return the standard output of a command."""
    return run_command(space, words, 0, text).stdout


def error(space: Any, *words: Any) -> Any:
    """Return the error of a command that fails."""
    return run_command(space, words, 1).stderr


def run_command(space: Any, words: Any, status: int, text: Any = None) -> Any:
    command = space.command(space.executable("retalis"), *words)
    process = subprocess.run(command, env=space.env, input=text, capture_output=True, text=True, timeout=60)
    assert process.returncode == status, process.stderr
    return process


def test_missing_master_or_node_is_an_error(devel: Any) -> None:
    assert "no master answers at http://localhost" in error(devel, "query", "true")
    devel.start_master()
    assert error(devel, "query", "true") == "retalis: no node retalis runs\n"


def test_commands_print_answers_of_node(node_of_space: Any) -> None:
    assert output(node_of_space, "query", "member(X, [1, f(_)])") == "X = 1\nX = f(_1)\n"
    assert "those that run are /retalis" in error(node_of_space, "query", "true", "--node", "other")
    late = error(node_of_space, "query", "true", "--wait-for", "odom_base", "--timeout", "0.01")
    assert "in memory odom_base (nothing yet) after 0.01 s" in late
    assert output(node_of_space, "explain", "no_such(1)").startswith("no_such(1) did not happen\n")
    solutions = output(node_of_space, "console", "--node", "retalis", text="X = 1 ; X = 2.\nfail.\n")
    assert solutions == "X = 1 ;\nX = 2.\nfalse.\n"
    listed = json.loads(output(node_of_space, "list", "--json"))
    assert [memory["id"] for memory in listed["memories"]][:2] == ["odom_base", "base_torso"]
    status = output(node_of_space, "status", "--once", "--every", "0.1")
    assert status.startswith("/retalis  idle  0.0 events/s  0.0 firings/s")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_ended_watch_leaves_no_subscription(shared_node: Any, number: Any) -> None:
    watch = subprocess.Popen(
        shared_node.command(shared_node.executable("retalis"), "watch", "--event", "cold_(_)"),
        env=shared_node.env,
        preexec_fn=lambda: signal.signal(number, signal.SIG_DFL),  # nohup ignores signals
    )
    try:
        assert any("cold_" in output(shared_node, "list") for _ in range(30))
        watch.send_signal(number)
        assert watch.wait(timeout=60) == 128 + number
    finally:
        watch.kill()
    assert "cold_" not in output(shared_node, "list")
    assert "has no type" not in shared_node.printed()


def test_status_and_watch_survive_new_master(node: Any) -> None:
    words = {"env": node.env, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    words["preexec_fn"] = restore_sigint
    program = node.executable("retalis")
    status = subprocess.Popen(node.command(program, "status", "--json", "--every", "0.1"), **words)
    watch = subprocess.Popen(node.command(program, "watch", "--inputs", "--count", "1"), **words)
    try:
        required(status.stdout).readline()
        node.expect(lambda nodes, services: any(name.startswith("/retalis_watch") for name in nodes))
        master = node.started[0]
        master.send_signal(signal.SIGINT)
        master.wait(timeout=60)
        assert "unable to contact master" in required(status.stderr).readline()
        node.start_master()
        required(status.stdout).readline()
        node.expect(lambda nodes, services: any(name.startswith("/retalis_watch") for name in nodes))
        node.start("rostopic", "pub", "-r", "5", "/retalisInputEvents", "std_msgs/String", "event(fever_(1))")
        assert watch.communicate(timeout=60)[0] == "input: event(fever_(1))\n"
        status.send_signal(signal.SIGINT)
        status.communicate(timeout=60)
        assert status.returncode == 130
    finally:
        status.kill()
        watch.kill()


@pytest.mark.parametrize("command", [["watch"], ["status", "--json", "--every", "0.1"]])
def test_messages_of_rospy_are_not_in_output(shared_node: Any, command: List[str]) -> None:
    running = subprocess.Popen(
        shared_node.command(shared_node.executable("retalis"), *command),
        env=shared_node.env,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=restore_sigint,
    )
    try:
        prefix = f"/retalis_{command[0]}"

        def answering(nodes: Any) -> List[str]:
            return [name for name in nodes if name.startswith(prefix) and shared_node.pid(name)]

        shared_node.expect(lambda nodes, services: answering(nodes))
        (node_name,) = answering(shared_node.state()[0])
        master: Any = ServerProxy(shared_node.env["ROS_MASTER_URI"])
        address = master.lookupNode("/test", node_name)[2]
        ServerProxy(address).shutdown("/test", "for a test")  # rospy prints this request
        running.send_signal(signal.SIGINT)
        output, messages = running.communicate(timeout=60)
    finally:
        running.kill()
    assert "shutdown request: for a test\n" in messages
    assert all(json.loads(line)["node"] == "/retalis" for line in output.splitlines())


def test_events_are_watched(shared_node: Any) -> None:
    program = shared_node.executable("retalis")
    watch = subprocess.Popen(
        shared_node.command(program, "watch", "--event", "fever_(_)", "--count", "1"),
        env=shared_node.env,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        event = ("/retalisInputEvents", "std_msgs/String", "event(fever_('A b'))")
        shared_node.start("rostopic", "pub", "-r", "5", *event)
        assert watch.communicate(timeout=60)[0] == "event: fever_('A b')\n"
    finally:
        watch.kill()
    assert watch.returncode == 0


def test_shell_completes_names(node_of_space: Any) -> None:
    script = (
        "COMP_WORDS=(retalis query x --wait-for odo); COMP_CWORD=4; _retalis_complete; echo ${COMPREPLY[@]};"
        "COMP_WORDS=(retalis query --node /re); COMP_CWORD=3; _retalis_complete; echo ${COMPREPLY[@]};"
        "COMP_WORDS=(retalis exp); COMP_CWORD=1; _retalis_complete; echo ${COMPREPLY[@]};"
        "COMP_WORDS=(retalis watch --in); COMP_CWORD=2; _retalis_complete; echo ${COMPREPLY[@]}"
    )
    words = ["bash", "-c", f'source "$0"; {script}', str(node_of_space.script)]
    process = subprocess.run(
        words, env=node_of_space.env, stdout=subprocess.PIPE, text=True, timeout=60, check=True
    )
    assert process.stdout == "odom_base\n/retalis\nexplain\n--inputs\n"
