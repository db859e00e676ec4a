#!/usr/bin/env python3
"""Long run of both nodes: messages of the NAO, images, random service calls, and restarts of nodes and master.

    test/faults/soak.py [--minutes N] [--speed N] [--images RATE] [--size WIDTHxHEIGHT] [--restarts SECONDS]
                        [--seed N] [--log FILE.csv] [--plot FILE.png]

Needs ROS and the built package on the path (``source devel/setup.bash``), and matplotlib for the plot, which
``soak_plot.py`` draws from the log as well. Starts a master of its own on a free port.

The stream is a bag of the simulated NAO that is repeated with later stamps, at ``--speed`` times its rate; all
messages are exchanged as text between the nodes unless ``--direct`` is given. Every ``--restarts`` seconds a node or
the master is ended by SIGKILL or SIGTERM and restarted. The log has a line per second: the memory of both nodes, the
numbers of sent, received and (from /diagnostics) dropped messages, and the delay of the poses in seconds.

The exit status is 0 if all of these conditions hold:

* Every pose that can be computed is received once and equals that of an offline playback of the same messages.
  Exempt are poses for which messages were sent while a node was down, or were in transit to a node when it ended (a
  restart of the master loses nothing), and poses for which messages were in transit when a node counted a drop. The
  summary has the number of each. A fast machine without other load drops nothing.
* Every service call was answered while the nodes were running.
* The memory of each node does not grow after minute 5 (a third of the time in shorter runs).
"""

import argparse
import csv
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from functools import partial
from pathlib import Path
from typing import Any, Dict, List

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path[:0] = [str(HERE), str(HERE.parent / "ros1"), str(ROOT / "bench"), str(ROOT / "examples" / "nao")]

import rosgraph  # noqa: E402
import rospy  # noqa: E402
from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from dropped_message_counts import Drops  # noqa: E402
from nao_stream import Stream, reference  # noqa: E402
from processes import free_port, resident  # noqa: E402
from soak_evaluation import Restart, verdict  # noqa: E402
from soak_plot import draw  # noqa: E402

from retalis import srv  # noqa: E402
from retalis.ros1.master_watch import MasterWatch  # noqa: E402

NODES = {"retalis": "retalis_node", "retalis_ros_interface": "retalis_ros_converter.py"}
IMAGE_SUBSCRIPTION = '<subscribe_to name="camera" msg_type="sensor_msgs/Image"/>'
IMAGE_MEMORY = "memorize(sensor_msgs__0__Image(H, _, _, _, _, _, _), [], seen(H), seen, 100)\n"
TIMEOUT_SECONDS = 60.0


def program(folder: Any) -> Any:
    """Write the program of the example with the camera as an additional input."""
    source = ROOT / "application_source"
    for path in filter(Path.is_file, source.iterdir()):
        text = path.read_text()
        if path.name == "pub_sub.xml":
            text = text.replace("</publish_subscribe>", f"{IMAGE_SUBSCRIPTION}</publish_subscribe>")
        if path.name == "goalPredicates.txt":
            text += "\n" + IMAGE_MEMORY
        (folder / path.name).write_text(text)
    return folder


class Processes:
    """The master and both nodes."""

    def __init__(self, folder: Any, port: Any, log: Any, direct: Any) -> None:
        self._program = program(folder)
        self._direct = str(direct).lower()
        self._port = port
        self._output = log.open("wb")
        self.running: Dict[Any, Any] = {}
        for name in ("master", *NODES):
            self.start(name)

    def start(self, name: Any) -> None:
        command = ["rosmaster", "--core", "-p", str(self._port)]
        if name in NODES:
            command = ["rosrun", "retalis", NODES[name], f"__name:={name}"]
            command += [f"_program:={self._program}", f"_direct:={self._direct}"]
        self.running[name] = subprocess.Popen(command, stdout=self._output, stderr=subprocess.STDOUT)
        if name == "master":
            self.wait_for_master()

    def wait_for_master(self) -> None:
        wait_until(rosgraph.is_master_online)

    def restart(self, name: Any, number: Any) -> None:
        process = self.running[name]
        process.send_signal(number)
        process.wait(TIMEOUT_SECONDS)
        self.start(name)

    def memory(self) -> Any:
        """Return the memory of each node in MB, 0 for a node that is starting."""
        sizes: Dict[Any, Any] = {}
        for name in NODES:
            try:
                sizes[name] = resident(self.running[name].pid)
            except (OSError, ValueError, IndexError):
                sizes[name] = 0.0
        return sizes

    def end(self) -> None:
        for name in (*NODES, "master"):
            process = self.running[name]
            process.send_signal(signal.SIGINT)
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
        self._output.close()


def wait_until(condition: Any) -> None:
    end = time.monotonic() + TIMEOUT_SECONDS
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError("the nodes are not connected")
        time.sleep(0.05)


class Caller(threading.Thread):
    """Calls random services and records invalid answers."""

    def __init__(self, seed: Any) -> None:
        super().__init__(daemon=True, name="services")
        self._random = random.Random(seed)
        self.paused = self.ended = False
        self.calls = 0
        self.failures: List[Any] = []

    def run(self) -> None:
        while not self.ended:
            time.sleep(0.2)
            name, fields = self._request()
            if self.paused:
                continue
            try:
                result = call(name, *fields)
            except Exception as error:
                if not self.paused:
                    self.failures.append(f"{name}{fields}: {error}")
                continue
            self.calls += 1
            if result != "ok" and not result.startswith("error: "):
                self.failures.append(f"{name}{fields}: {result}")

    def _request(self) -> Any:
        key = f"key{self._random.randrange(20)}"
        return self._random.choice(
            [
                ("AddMemory", ("tf(A, B, V, Q)", "", "tf(V, Q)", key, "500")),
                ("DeleteMemory", (key,)),
                ("AddOutputSubscription", ("tf(A, B, V, Q)", "A == never", "_", "nowhere", key)),
                ("DeleteOutputSubscription", ("nowhere", key)),
                ("AddInputSubscription", (f"input_{key}", "std_msgs/String")),
                ("DeleteInputSubscription", (f"input_{key}",)),
                ("AddMemory", ("tf(", "", "_", key, "many")),
            ]
        )


def call(name: Any, *fields: Any) -> Any:
    path = "".join("_" + c.lower() if c.isupper() else c for c in name).strip("_")
    rospy.wait_for_service(path, 5)
    return rospy.ServiceProxy(path, getattr(srv, name))(*fields).result


class Soak:
    """A run with its options."""

    def __init__(self, options: Any, folder: Path) -> None:
        self.options = options
        (folder / "program").mkdir()
        port = int(os.environ["ROS_MASTER_URI"].rsplit(":", 1)[1])
        output = options.log.with_suffix(".nodes.log")
        self.processes = Processes(folder / "program", port, output, options.direct)
        rospy.init_node("soak", disable_signals=True)
        MasterWatch().start()
        self.stream = Stream(folder / "nao.bag", options.speed, options.images, options.size)
        self.expected = reference(folder / "nao.bag", ROOT / "application_source")
        self.caller = Caller(options.seed)
        self.restarts: List[Any] = []
        self.rows: List[Any] = []
        self.drops = Drops()
        self._random = random.Random(options.seed)
        rospy.Subscriber("/diagnostics", DiagnosticArray, self._add_statuses, queue_size=100)

    def _add_statuses(self, message: Any) -> None:
        statuses = [
            (status.name, [(value.key, value.value) for value in status.values]) for status in message.status
        ]
        self.drops.add(self.stream.stamp, self.stream.through, statuses)

    def run(self) -> None:
        self.wait_for_nodes()
        self.caller.start()
        began = time.monotonic()
        sending = threading.Thread(target=self.stream.run, daemon=True, name="stream")
        sending.start()
        end, restart_at = began + 60 * self.options.minutes, began + self.options.restarts
        while time.monotonic() < end:
            time.sleep(1)
            self.note(time.monotonic() - began)
            if self.options.restarts and restart_at < time.monotonic() < end - 10:
                self.restart(began)
                restart_at = time.monotonic() + self.options.restarts
        self.caller.ended = self.stream.ended = True
        sending.join(TIMEOUT_SECONDS)
        self.settle()
        self.note(time.monotonic() - began)

    def settle(self) -> None:
        """Wait until no pose is received for longer than the period of the diagnostics."""
        last, since = -1, time.monotonic()
        while time.monotonic() - since < 5:
            time.sleep(0.1)
            if self.stream.received != last:
                last, since = self.stream.received, time.monotonic()

    def wait_for_nodes(self) -> None:
        wait_until(self.stream.is_connected)
        for service in ("add_memory", "add_input_subscription"):
            wait_until(partial(is_offered, service))

    def restart(self, began: Any) -> None:
        name = self._random.choice(("master", *NODES))
        number = self._random.choice((signal.SIGKILL, signal.SIGTERM))
        self.caller.paused = True
        first = self.stream.through
        self.processes.restart(name, number)
        self.wait_for_nodes()
        before = self.stream.received
        wait_until(lambda: self.stream.received > before + 8)
        self.caller.paused = False
        self.restarts.append(Restart(time.monotonic() - began, name, number.name, first, self.stream.stamp))
        print(f"{time.monotonic() - began:6.0f} s: {name} ended by {number.name}, restarted", flush=True)

    def note(self, seconds: Any) -> None:
        row = {
            "seconds": round(seconds, 1),
            **self.processes.memory(),
            "sent": self.stream.sent,
            "images": self.stream.images,
            "poses": self.stream.received,
            "calls": self.caller.calls,
            "dropped": self.drops.total,
            "behind": round(self.stream.behind, 1),
            "restarts": len(self.restarts),
        }
        self.rows.append(row)


def is_offered(service: Any) -> bool:
    """Return whether a service answers; the master may still have that of a killed node."""
    try:
        rospy.wait_for_service(service, 1)
    except rospy.ROSException:
        return False
    return True


def arguments() -> Any:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--speed", type=float, default=5.0, help="times the rate of a NAO")
    parser.add_argument("--images", type=float, default=10.0, help="images a second")
    parser.add_argument("--size", default="640x480", help="of an image")
    parser.add_argument("--restarts", type=float, default=90.0, help="seconds between them; 0: none")
    parser.add_argument(
        "--direct", action="store_true", help="have node retalis subscribe and publish itself"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--log", type=Path, default=Path("soak.csv"))
    parser.add_argument("--plot", type=Path)
    return parser.parse_args()


def main() -> Any:
    options = arguments()
    os.environ["ROS_MASTER_URI"] = f"http://127.0.0.1:{free_port()}"
    os.environ["ROS_HOSTNAME"] = "127.0.0.1"
    with tempfile.TemporaryDirectory() as folder:
        soak = Soak(options, Path(folder))
        # Also after an error: otherwise the master and the nodes would run on.
        try:
            soak.run()
        finally:
            soak.processes.end()
    with options.log.open("w", newline="") as out:
        writer = csv.DictWriter(out, list(soak.rows[0]))
        writer.writeheader()
        writer.writerows(soak.rows)
    if options.plot:
        draw(options.log, options.plot)
    is_good, lines = verdict(soak)
    print("\n".join(lines))
    return 0 if is_good else 1


if __name__ == "__main__":
    raise SystemExit(main())
