#!/usr/bin/env python3
"""What the nodes cost while the NAO's messages flow on a real master: CPU, delay, losses, memory.

    bench/node.py [--seconds N] [--speed 1 5 10] [--way idle direct embedded converter] [--json FILE]

Needs ROS and the built package on the path (``source devel/setup.bash``). Starts a master of its own on a free
port. ``idle`` is a rospy subscriber of the same topics that does nothing. CPU is user and system time of the
nodes' processes from ``/proc`` as percent of a core. The delay is the time from publishing the message that
completes a marker's data to the receipt of its pose.
"""

import argparse
import json
import os
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Dict, List

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent / "test" / "ros"), str(HERE.parent / "examples" / "nao")]

WAYS = ("idle", "direct", "embedded", "converter")
ARGUMENTS = {
    "direct": ["direct:=true", "embedded:=false"],
    "embedded": ["direct:=auto", "embedded:=true"],
    "converter": ["direct:=false", "embedded:=false"],
}
IDLE = """
import rospy
rospy.init_node("idle")
subscribers = [rospy.Subscriber(topic, rospy.AnyMsg, lambda message: None, queue_size=5000)
               for topic in ("tf", "ar_pose_marker", "face_recognition/feedback")]
rospy.spin()
"""


def free_port() -> int:
    """Return a port that nobody uses."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


def cpu(pid: int) -> float:
    """Return the CPU seconds that a process has used."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def resident(pid: int) -> float:
    """Return the resident memory of a process in MB."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


class Started:
    """Processes that are ended together."""

    def __init__(self) -> None:
        self.processes: List[subprocess.Popen] = []

    def __call__(self, command: List[str]) -> subprocess.Popen:
        """Start a process without output."""
        quiet = subprocess.DEVNULL
        process = subprocess.Popen(command, stdout=quiet, stderr=quiet, start_new_session=True)
        self.processes.append(process)
        return process

    def end(self) -> None:
        """Interrupt all processes, the newest first, and wait for them."""
        for process in reversed(self.processes):
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGINT)
        for process in self.processes:
            try:
                process.wait(15)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
        self.processes.clear()


class Bench:
    """One player for all runs."""

    def __init__(self, seconds: float):
        import rospy
        from geometry_msgs.msg import PoseStamped
        from make_bag import make_bag

        from retalis.bags import BagReader

        self.rospy, self.pose = rospy, PoseStamped
        self.folder = tempfile.TemporaryDirectory()
        path = Path(self.folder.name) / "nao.bag"
        self.truth = make_bag(path, seconds, 1)
        self.reader = BagReader(path)
        self.records = list(self.reader.records())
        self.completing = self._completing()
        self.received: Dict[Any, float] = {}

    def _completing(self) -> Dict[Any, int]:
        """Return for each observation the index of the message that completes its data."""
        from nao_robot import CHAIN

        from retalis.messages import Definitions
        from retalis.terms import deref, list_items

        definitions = Definitions()
        chain: Dict[Any, List[Any]] = {(f'"{one[0]}"', f'"{one[1]}"'): [] for one in CHAIN}
        arrived: Dict[Any, int] = {}
        for index, record in enumerate(self.records):
            topic = record.topic
            if topic.name == "/face_recognition/feedback":
                continue
            decoder = definitions.decoder(definitions.add(topic.type, topic.definition))
            for item in list_items(deref(decoder.decode(record.data))[-1]):
                header = deref(deref(item)[1])
                seconds, nanoseconds = (deref(part) for part in list_items(header[2]))
                stamp = seconds * 10**9 + nanoseconds
                if topic.name == "/tf":
                    key = (deref(header[3]).name, deref(deref(item)[2]).name)
                    if key in chain:
                        chain[key].append((stamp, index))
                else:
                    arrived[deref(header[3]).name.strip('"'), stamp] = index
        wanted = {(one.marker, one.stamp) for one in self.truth.complete}
        found = {}
        for key, index in arrived.items():
            if key in wanted:
                later = [next(at for stamp, at in link if stamp >= key[1]) for link in chain.values()]
                found[key] = max(index, *later)
        return found

    def run(self, way: str, speed: float) -> Dict[str, Any]:
        """Play the bag once and return the figures."""
        from harness import DEFINITIONS, RawPublisher, wait_until

        rospy = self.rospy
        started = Started()
        try:
            if way == "idle":
                nodes = {"idle": started([sys.executable, "-c", IDLE]).pid}
            else:
                command = ["roslaunch", "retalis", "retalis.launch", "use_sim_time:=false", *ARGUMENTS[way]]
                started(command)
                nodes = {}
            publishers = {
                topic.name: RawPublisher(topic.name, DEFINITIONS.add(topic.type, topic.definition))
                for topic in self.reader.topics
            }
            self.received.clear()
            subscribers = [
                rospy.Subscriber(f"marker{i}", self.pose, self._take, queue_size=10_000) for i in range(1, 9)
            ]
            wait_until(lambda: all(one.connected() for one in publishers.values()), "subscribers")
            if way != "idle":
                wait_until(lambda: all(one.get_num_connections() for one in subscribers), "publishers")
                nodes = self._nodes()
                time.sleep(1.0)  # the text topics between two nodes connect unseen
            figures = self._play(publishers, nodes, speed)
            for one in subscribers:
                one.unregister()
            for one in publishers.values():
                one.publisher.unregister()
        finally:
            started.end()
        return {"way": way, "speed": speed, **figures}

    def _nodes(self) -> Dict[str, int]:
        import xmlrpc.client

        import rosgraph
        import rosnode

        master = rosgraph.Master("/bench")
        found = {}
        for name in rosnode.get_node_names():
            if name.startswith("/retalis"):
                found[name] = xmlrpc.client.ServerProxy(master.lookupNode(name)).getPid("/bench")[2]
        return found

    def _take(self, pose: Any) -> None:
        key = (pose.header.frame_id, pose.header.stamp.to_nsec())
        self.received.setdefault(key, time.monotonic())

    def _play(self, publishers: Dict[str, Any], nodes: Dict[str, int], speed: float) -> Dict[str, Any]:
        sent = [0.0] * len(self.records)
        before = {name: cpu(pid) for name, pid in nodes.items()}
        began = time.monotonic()
        first = self.records[0].time
        for index, record in enumerate(self.records):
            wait = (record.time - first) / 1e9 / speed - (time.monotonic() - began)
            if wait > 0.0005:
                time.sleep(wait)
            sent[index] = time.monotonic()
            publishers[record.topic.name].publish(record.data)
        took = time.monotonic() - began
        percent = {name: 100 * (cpu(pid) - before[name]) / took for name, pid in nodes.items()}
        deadline = time.monotonic() + 10
        while (
            "/retalis" in nodes and len(self.received) < len(self.completing) and time.monotonic() < deadline
        ):
            time.sleep(0.05)
        delays = sorted(
            1000 * (self.received[key] - sent[index])
            for key, index in self.completing.items()
            if key in self.received
        )
        return {
            "messages_a_second": len(self.records) / took,
            "cpu_percent": sum(percent.values()),
            "by_node": percent,
            "resident_mb": {name: resident(pid) for name, pid in nodes.items()},
            "poses": len(self.received),
            "expected": 0 if "/retalis" not in nodes else len(self.completing),
            "delay_ms_median": statistics.median(delays) if delays else None,
            "delay_ms_99": delays[int(0.99 * (len(delays) - 1))] if delays else None,
        }


def line(figures: Dict[str, Any]) -> str:
    """Return one row of the table."""
    delay = figures["delay_ms_median"]
    shown = "" if delay is None else f"delay {delay:6.2f} ms, 99 % {figures['delay_ms_99']:6.2f} ms"
    memory = ", ".join(f"{value:.0f}" for value in figures["resident_mb"].values())
    return (
        f"{figures['way']:<10} {figures['speed']:4g}x {figures['messages_a_second']:7.0f}/s "
        f"cpu {figures['cpu_percent']:6.1f} %  poses {figures['poses']}/{figures['expected']}  "
        f"memory {memory} MB  {shown}"
    )


def main() -> int:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=20.0, help="length of the bag")
    parser.add_argument("--speed", type=float, nargs="+", default=[1.0, 5.0, 10.0])
    parser.add_argument("--way", nargs="+", choices=WAYS, default=list(WAYS))
    parser.add_argument("--json", help="write the figures there")
    options = parser.parse_args()
    os.environ["ROS_MASTER_URI"] = f"http://127.0.0.1:{free_port()}"
    os.environ["ROS_HOSTNAME"] = "127.0.0.1"
    started = Started()
    started(["roscore", "-p", os.environ["ROS_MASTER_URI"].rsplit(":", 1)[1]])
    try:
        import rosgraph
        import rospy

        while not rosgraph.is_master_online():
            time.sleep(0.1)
        rospy.init_node("bench", disable_signals=True)
        bench = Bench(options.seconds)
        rows = []
        for speed in options.speed:
            for way in options.way:
                rows.append(bench.run(way, speed))
                print(line(rows[-1]), flush=True)
        if options.json:
            Path(options.json).write_text(json.dumps(rows, indent=1) + "\n")
    finally:
        started.end()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
