import os
import shutil
import signal
import socket
import subprocess
import time
from pathlib import Path
from xmlrpc.client import ServerProxy

import pytest

SPACES = ("devel", "install")

PATIENCE = 120.0
"""Seconds after which what has not come is missing: most of it is for a machine that is busy."""


@pytest.fixture
def port():
    """A port that nobody listens to."""
    with socket.socket() as probe:
        probe.bind(("localhost", 0))
        return probe.getsockname()[1]


def _interruptible():
    """Have SIGINT end a process also where the tests were started in the background of a shell, which ignores it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


class Space:
    """The package as built into one of the workspace's spaces, with a master of its own."""

    def __init__(self, script, port, logs):
        self.port = port
        self.env = dict(
            os.environ,
            PATH="/usr/bin" + os.pathsep + os.environ["PATH"],
            ROS_MASTER_URI=f"http://localhost:{port}",
            ROS_HOSTNAME="localhost",
            ROS_LOG_DIR=str(logs),
        )
        for name in list(self.env):  # of the shell: PYTHONUNBUFFERED hides what a user does not get to see
            if name.startswith("PYTHON") or name in ("CMAKE_PREFIX_PATH", "ROS_PACKAGE_PATH"):
                del self.env[name]
        self.script = script
        self.logs = logs
        self.started = []

    def command(self, *words):
        """Return the command as it is run in a shell that has sourced setup.bash."""
        return ["bash", "-c", 'source "$0" && exec "$@"', str(self.script), *words]

    def run(self, *words):
        """Run to the end and return what was printed."""
        return subprocess.run(
            self.command(*words),
            env=self.env,
            check=True,
            stdout=subprocess.PIPE,
            text=True,
            timeout=PATIENCE,
        ).stdout

    def start(self, *words):
        """Start a process; it is ended after the test."""
        log = self.logs / f"{len(self.started)}.out"
        with log.open("wb") as output:
            process = subprocess.Popen(
                self.command(*words),
                env=self.env,
                stdout=output,
                stderr=subprocess.STDOUT,
                preexec_fn=_interruptible,
            )
        self.started.append(process)
        return process

    def start_master(self):
        """Start a master and return its process when it answers.

        A roslaunch or roscore that starts one by itself gives it 10 s, which a busy machine may take longer for.
        """
        process = self.start("rosmaster", "--core", "-p", str(self.port))
        master = ServerProxy(self.env["ROS_MASTER_URI"])
        end = time.monotonic() + PATIENCE
        while process.poll() is None and time.monotonic() < end:
            try:
                master.getPid("/test")
                return process
            except OSError:
                time.sleep(0.1)
        code = process.poll()
        what = "does not answer" if code is None else f"has ended with {code}"
        return pytest.fail(f"the master {what}\n{self.printed()}")

    def printed(self):
        """Return what the started processes have printed."""
        return "\n".join(path.read_text(errors="replace") for path in sorted(self.logs.glob("*.out")))

    def expect_printed(self, text):
        """Wait until the started processes have printed a text."""
        self.expect(lambda nodes, services: text in self.printed())

    def query(self, goal):
        """Return what service `query` of node retalis prints for a goal."""
        return self.run("rosservice", "call", "/retalis/query", f"{{goal: '{goal}'}}")

    def post_events(self, *events):
        """Publish events for node retalis, as another node does."""
        self.run("python3", str(Path(__file__).with_name("event_publisher.py")), *events)

    def state(self):
        """Return the master's nodes and services, or nothing where there is no master yet."""
        try:
            master = ServerProxy(self.env["ROS_MASTER_URI"])
            publications, subscriptions, services = master.getSystemState("/test")[2]
        except OSError:
            return set(), set()
        everything = (*publications, *subscriptions, *services)
        return {node for _, nodes in everything for node in nodes}, {name for name, _ in services}

    def pid(self, node):
        """Return the process of a node, None where it does not answer."""
        try:
            uri = ServerProxy(self.env["ROS_MASTER_URI"]).lookupNode("/test", node)[2]
            return ServerProxy(uri).getPid("/test")[2] if uri else None
        except OSError:
            return None

    def expect(self, condition, seconds=PATIENCE):
        """Wait until the master's nodes and services fulfil the condition."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if condition(*self.state()):
                return
            time.sleep(0.1)
        pytest.fail(f"{self.state()}\n{self.printed()}")

    def close(self):
        """End what was started, last first; return the exit statuses."""
        for process in reversed(self.started):
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
            try:
                process.wait(timeout=PATIENCE / 2)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        return [process.returncode for process in self.started]


def built(name, port, logs):
    """Return a space where install.py built it."""
    workspace = os.environ.get("RETALIS_WORKSPACE")
    if not workspace or not shutil.which("roslaunch"):
        pytest.skip("./install.py test builds the spaces")
    return Space(Path(workspace) / name / "setup.bash", port, logs)


@pytest.fixture(params=SPACES)
def space(request, port, tmp_path):
    """Each space in turn."""
    it = built(request.param, port, tmp_path)
    yield it
    it.close()


@pytest.fixture
def devel(port, tmp_path):
    """The space of the sources, for what is the same in both."""
    it = built("devel", port, tmp_path)
    yield it
    it.close()
