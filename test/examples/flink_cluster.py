"""A cluster of Apache Flink, a broker of MQTT and the bridge as processes on this computer."""

import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Callable, Dict, List

import pytest
from subprocess_python_path import python_path

TIMEOUT_SECONDS = 180.0

SYSTEM_PATH = "/usr/sbin:/usr/bin:/bin"


def find_missing() -> str:
    """Return the name of a missing program, or ""."""
    for module in ("pyflink", "paho.mqtt"):
        try:
            if find_spec(module) is None:
                return module
        except ModuleNotFoundError:
            return module
    return next((name for name in ("java", "mosquitto") if shutil.which(name, path=SYSTEM_PATH) is None), "")


NEEDS_CLUSTER = pytest.mark.skipif(bool(find_missing()), reason=f"{find_missing()} is not installed")


def find_free_ports(count: int) -> List[int]:
    servers = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    ports = [server.getsockname()[1] for server in servers]
    for server in servers:
        server.close()
    return ports


def wait_until(condition: Callable[[], Any], description: str) -> Any:
    """Wait until a function returns a true value, and return it; fail after `TIMEOUT_SECONDS`."""
    end = time.monotonic() + TIMEOUT_SECONDS
    while True:
        value = condition()
        if value:
            return value
        assert time.monotonic() < end, f"waited in vain for {description}"
        time.sleep(0.1)


class Cluster:
    """A job manager and two task managers, a broker, and the bridge; a process that was killed is started again.

    Args:
        folder: folder of all files.
        program: folder with a copy of the example.
    """

    def __init__(self, folder: Path, program: Path):
        self._folder, self._program = folder, program
        self._rpc_port, self._rest_port, self.mqtt_port = find_free_ports(3)
        self.home = Path(str(find_spec("pyflink").submodule_search_locations[0]))  # type: ignore[union-attr, index]
        self._processes: Dict[str, Any] = {}
        self.job = ""
        self._environment = {
            **{name: value for name, value in os.environ.items() if not name.startswith("FLINK")},
            "PATH": f"{SYSTEM_PATH}:{os.environ['PATH']}",
            "PYTHONPATH": python_path(),
            "FLINK_CONF_DIR": str(folder / "conf"),
            "FLINK_LOG_DIR": str(folder / "log"),
            # By default in /tmp, where `stop-cluster.sh` of another cluster would find these processes.
            "FLINK_PID_DIR": str(folder),
        }
        for name in ("conf", "log", "temporary"):
            (folder / name).mkdir()
        for path in (self.home / "conf").glob("log*"):
            shutil.copy(path, folder / "conf")
        self.configure(parallelism=1)
        (folder / "mosquitto.conf").write_text(
            f"listener {self.mqtt_port} 127.0.0.1\nallow_anonymous true\nmax_queued_messages 0\nuser root\n"
        )
        try:
            for name in ("broker", "bridge", "manager", "worker 1", "worker 2"):
                self.start(name)
            wait_until(lambda: self.get("/overview").get("taskmanagers") == 2, "two task managers")
        except BaseException:
            # Nobody else could end the processes of an object that is not complete.
            self.close()
            raise

    def configure(self, parallelism: int) -> None:
        """Write the configuration of all processes of Flink and of jobs that are started from now on."""
        java_options = next(
            line.strip().partition("all: ")[2]
            for line in (self.home / "conf" / "config.yaml").read_text().splitlines()
            if line.strip().startswith("all: ")
        )
        settings = {
            "env.java.opts.all": java_options,
            "jobmanager.rpc.address": "127.0.0.1",
            "jobmanager.rpc.port": self._rpc_port,
            "jobmanager.bind-host": "127.0.0.1",
            "jobmanager.memory.process.size": "1000m",
            "rest.address": "127.0.0.1",
            "rest.port": self._rest_port,
            "rest.bind-address": "127.0.0.1",
            "rest.bind-port": self._rest_port,
            "taskmanager.host": "127.0.0.1",
            "taskmanager.bind-host": "127.0.0.1",
            "taskmanager.memory.process.size": "1300m",
            "taskmanager.numberOfTaskSlots": 1,
            "heartbeat.timeout": "10000",
            "heartbeat.interval": "1000",
            "io.tmp.dirs": str(self._folder / "temporary"),
            "parallelism.default": parallelism,
            "execution.target": "remote",
        }
        text = "".join(f"{key}: {value}\n" for key, value in settings.items())
        (self._folder / "conf" / "config.yaml").write_text(text)

    def start(self, name: str) -> None:
        """Start a process: the broker, the bridge, the manager or a worker."""
        scripts = self.home / "bin"
        bridge = self._program / "bridge.py"
        commands: Dict[str, List[Any]] = {
            "broker": [shutil.which("mosquitto", path=SYSTEM_PATH), "-c", self._folder / "mosquitto.conf"],
            "bridge": [sys.executable, bridge, "127.0.0.1", self.mqtt_port, self._folder / "events"],
            "manager": ["bash", scripts / "jobmanager.sh", "start-foreground"],
            "worker": ["bash", scripts / "taskmanager.sh", "start-foreground"],
        }
        command = commands[name.partition(" ")[0]]
        with open(self._folder / f"{name}.log", "a", encoding="utf-8") as log:
            self._processes[name] = subprocess.Popen(
                [str(word) for word in command],
                env=self._environment,
                stdout=log,
                stderr=log,
                cwd=self._folder,
            )

    def kill(self, name: str) -> None:
        """Kill a process and start it again, or kill all Python processes of a worker: ``worker 1 python``."""
        if name.endswith(" python"):
            kill_all(children_of(self._processes[name[: -len(" python")]].pid))
            return
        self._end(name)
        self.start(name)

    def count_free_slots(self) -> int:
        """Return the number of free slots, and start ended task managers again, as a service manager does.

        A task manager may end itself after its manager was killed: Beam's "Reference count must not be negative".
        """
        for name, process in self._processes.items():
            if name.startswith("worker") and process.poll() is not None:
                self.start(name)
        return int(self.get("/overview").get("slots-available", 0))

    def _end(self, name: str) -> None:
        process = self._processes[name]
        # The Python processes of a task manager notice its end themselves, but not at once.
        children = children_of(process.pid)
        process.kill()
        process.wait(TIMEOUT_SECONDS)
        kill_all(children)

    def get(self, path: str, body: Any = None) -> Any:
        """Return the answer of the REST interface, or an empty one; with a body the request is a command."""
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(
            f"http://127.0.0.1:{self._rest_port}{path}", data, {"Content-Type": "application/json"}
        )
        try:
            with urllib.request.urlopen(request, timeout=10) as answer:
                return json.load(answer)
        except (OSError, urllib.error.HTTPError, ValueError):
            return {}

    def submit(self, resume: Any = None) -> None:
        """Start the job, from a checkpoint or savepoint if there is one."""
        command = [
            *("bash", self.home / "bin" / "flink", "run", "--detached"),
            *("--pyClientExecutable", sys.executable, "--python", self._program / "fleet_mqtt.py"),
            *(self._folder / "events", self._folder / "results", self._folder / "checkpoints"),
            *("127.0.0.1", self.mqtt_port, *([] if resume is None else [resume])),
        ]
        process = subprocess.run(
            [str(word) for word in command],
            env=self._environment,
            cwd=self._folder,
            capture_output=True,
            text=True,
            timeout=TIMEOUT_SECONDS,
        )
        submitted = re.search("with JobID ([0-9a-f]+)", process.stdout)
        assert submitted, process.stdout + process.stderr
        self.job = submitted[1]

    def is_running(self) -> bool:
        """Return whether all tasks of the job run."""
        vertices = self.get(f"/jobs/{self.job}").get("vertices", [])
        return bool(vertices) and all(vertex["status"] == "RUNNING" for vertex in vertices)

    def stop_with_savepoint(self) -> str:
        """Stop the job, and return the path of a savepoint."""
        target = str(self._folder / "savepoints")
        answer = wait_until(
            lambda: self.get(f"/jobs/{self.job}/stop", {"targetDirectory": target}), "an answer to stop"
        )
        path = f"/jobs/{self.job}/savepoints/{answer['request-id']}"
        wait_until(lambda: self.get(path).get("status", {}).get("id") == "COMPLETED", "a savepoint")
        location: str = self.get(path)["operation"]["location"]
        return location

    def lines_of(self, name: str) -> List[str]:
        """Return the lines of the complete files of a result."""
        paths = sorted((self._folder / "results" / name).glob("*/part-*"))
        return [line for path in paths for line in path.read_text(encoding="utf-8").splitlines()]

    def close(self) -> None:
        """End all processes."""
        for name in self._processes:
            self._end(name)


def kill_all(process_ids: List[int]) -> None:
    for process_id in process_ids:
        try:
            os.kill(process_id, signal.SIGKILL)
        except ProcessLookupError:
            pass


def children_of(process_id: int) -> List[int]:
    """Return the ids of all processes below a process."""
    parents = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            # The name of the program, in brackets, may contain spaces.
            parents[int(path.parent.name)] = int(path.read_text().rpartition(")")[2].split()[1])
        except (OSError, ValueError):
            continue
    children = [child for child, parent in parents.items() if parent == process_id]
    return [*children, *(below for child in children for below in children_of(child))]
