"""Fixtures of the tests on ROS: ports, and a workspace with a master of its own."""

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import time
from pathlib import Path
from typing import Any, Iterator, List, Tuple
from xmlrpc.client import ServerProxy

import pytest

SPACES = ("devel", "install")

TIMEOUT_SECONDS = 120.0
"""Seconds after which a wait fails; only a busy machine needs most of them."""


def find_unused_port() -> int:
    with socket.socket() as probe:
        probe.bind(("localhost", 0))
        return int(probe.getsockname()[1])


def _restore_sigint() -> None:
    """Let SIGINT end a process, because a shell starts background processes with the signal ignored."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


class Space:
    """A space of the workspace with the built package, and an own master."""

    def __init__(self, script: Path, logs: Path) -> None:
        self.port = port = find_unused_port()
        self.env = dict(
            os.environ,
            PATH="/usr/bin" + os.pathsep + os.environ["PATH"],
            ROS_MASTER_URI=f"http://localhost:{port}",
            ROS_HOSTNAME="localhost",
            ROS_LOG_DIR=str(logs),
        )
        for name in list(self.env):  # variables of the shell: PYTHONUNBUFFERED hides missing flushes
            if name.startswith("PYTHON") or name in ("CMAKE_PREFIX_PATH", "ROS_PACKAGE_PATH"):
                del self.env[name]
        self.script = script
        self.logs = logs
        self.started: List[Any] = []

    def executable(self, name: str) -> str:
        """Return the path of an executable of the package; the search of `rosrun` takes most of a second."""
        return str(self.script.parent / "lib" / "retalis" / name)

    def command(self, *words: Any) -> List[Any]:
        """Return the command for a shell that sources setup.bash."""
        return ["bash", "-c", 'source "$0" && exec "$@"', str(self.script), *words]

    def run(self, *words: Any) -> str:
        """Run a command to its end and return its output."""
        return subprocess.run(
            self.command(*words),
            env=self.env,
            check=True,
            stdout=subprocess.PIPE,
            text=True,
            timeout=TIMEOUT_SECONDS,
        ).stdout

    def start(self, *words: Any) -> Any:
        """Start a process that ends after the test."""
        log = self.logs / f"{len(self.started)}.out"
        with log.open("wb") as output:
            process = subprocess.Popen(
                self.command(*words),
                env=self.env,
                stdout=output,
                stderr=subprocess.STDOUT,
                preexec_fn=_restore_sigint,
            )
        self.started.append(process)
        return process

    def start_master(self) -> Any:
        """Start a master and return its process when it answers.

        roslaunch and roscore wait at most 10 s for a master that they start, which a busy machine may exceed.
        """
        process = self.start("rosmaster", "--core", "-p", str(self.port))
        master = ServerProxy(self.env["ROS_MASTER_URI"])
        end = time.monotonic() + TIMEOUT_SECONDS
        while process.poll() is None and time.monotonic() < end:
            try:
                master.getPid("/test")
                return process
            except OSError:
                time.sleep(0.1)
        code = process.poll()
        problem = "does not answer" if code is None else f"has ended with {code}"
        return pytest.fail(f"the master {problem}\n{self.printed()}")

    def printed(self) -> str:
        """Return the output of the started processes."""
        return "\n".join(path.read_text(errors="replace") for path in sorted(self.logs.glob("*.out")))

    def expect_printed(self, text: Any) -> None:
        """Wait until the started processes have printed a text."""
        self.expect(lambda nodes, services: text in self.printed())

    def query(self, goal: Any) -> Any:
        """Return the printed response of service `query` of node retalis for a goal."""
        return self.run("rosservice", "call", "/retalis/query", f"{{goal: '{goal}'}}")

    def post_events(self, *events: Any) -> None:
        """Publish events for node retalis, as another node does."""
        self.run("python3", str(Path(__file__).with_name("event_publisher.py")), *events)

    def state(self) -> Tuple[Any, ...]:
        """Return the nodes and services of the master, empty sets without a master."""
        try:
            master: Any = ServerProxy(self.env["ROS_MASTER_URI"])
            publications, subscriptions, services = master.getSystemState("/test")[2]
        except OSError:
            return set(), set()
        everything = (*publications, *subscriptions, *services)
        return {node for _, nodes in everything for node in nodes}, {name for name, _ in services}

    def pid(self, node: Any) -> Any:
        """Return the process of a node, None if it does not answer."""
        try:
            master: Any = ServerProxy(self.env["ROS_MASTER_URI"])
            uri = master.lookupNode("/test", node)[2]
            server: Any = ServerProxy(uri) if uri else None
            return server.getPid("/test")[2] if uri else None
        except OSError:
            return None

    def expect(self, condition: Any, seconds: Any = TIMEOUT_SECONDS) -> None:
        """Wait until a condition holds for the nodes and services of the master."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if condition(*self.state()):
                return
            time.sleep(0.1)
        pytest.fail(f"{self.state()}\n{self.printed()}")

    def close(self) -> List[Any]:
        """End the started processes, the last one first; return the exit statuses."""
        for process in reversed(self.started):
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
            try:
                process.wait(timeout=TIMEOUT_SECONDS / 2)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        return [process.returncode for process in self.started]


@contextlib.contextmanager
def open_space(name: str, logs: Path) -> Iterator[Space]:
    """Return a space that install.py has built; end the processes that are started in it."""
    workspace = os.environ.get("RETALIS_WORKSPACE")
    if not workspace or not shutil.which("roslaunch"):
        pytest.skip("./install.py test builds the spaces")
    space = Space(Path(workspace) / name / "setup.bash", logs)
    try:
        yield space
    finally:
        space.close()


@pytest.fixture(params=SPACES)
def space(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Space]:
    """Return each of the spaces, one after the other."""
    with open_space(request.param, tmp_path) as space:
        yield space


@pytest.fixture
def devel(tmp_path: Path) -> Iterator[Space]:
    """Return the devel space, for tests that do not differ between spaces."""
    with open_space("devel", tmp_path) as space:
        yield space


@pytest.fixture(scope="module", params=["devel", pytest.param("install", marks=pytest.mark.nightly)])
def module_space(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Space]:
    """Return each of the spaces, for the tests of a module."""
    with open_space(request.param, tmp_path_factory.mktemp("space")) as space:
        yield space


@pytest.fixture(scope="module")
def module_devel(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Space]:
    """Return the devel space, for the tests of a module that share its nodes."""
    with open_space("devel", tmp_path_factory.mktemp("space")) as space:
        yield space
