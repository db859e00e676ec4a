#!/usr/bin/env python3
"""Cost of the node of ROS 2 beside a node of rclpy that only counts the same messages.

    bench/ros2_node.py [--kind pose image] [--rate N ...] [--seconds N]

Needs rclpy and the installed package (``./install.py test --ros2 --collect-only`` builds it; the same environment).
Both nodes read the same topic of one publisher, at the same time. CPU is user and system time of each process from
``/proc``, for each message. The delay is the time from publishing to an output that the program sends for a message,
or to the callback of the counting node. For images only the CPU is measured: the program does not read their data.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Dict, List

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "test")]

from arguments import above_zero  # noqa: E402
from processes import cpu  # noqa: E402

TYPES = {"pose": "PoseStamped", "image": "Image"}
PROGRAMS = {
    "pose": (
        '<subscribe_to name="measured" msg_type="geometry_msgs/PoseStamped"/>',
        "memorize(geometry_msgs__0__PoseStamped(H, P), [], pose(H, P), poses, 1000)\n",
    ),
    "image": (
        '<subscribe_to name="measured" msg_type="sensor_msgs/Image" event="image"/>',
        "memorize(image{header: H}, [], H, images, 10)\n",
    ),
}
"""Topics and goals of the program for each kind of message."""

DELAY_PROGRAM = (
    '<subscribe_to name="measured" msg_type="geometry_msgs/PoseStamped"/>'
    '<publish_to name="output" msg_type="std_msgs/Header"/>',
    "subscribe(geometry_msgs__0__PoseStamped(H, _), [], H, output, o)\n",
)

START_SECONDS = 3.0
"""Seconds for which the nodes may find each other before the load begins."""

MAX_SECONDS = 600


def message_class(kind: str) -> Any:
    """Return the class of the messages."""
    if kind == "pose":
        from geometry_msgs.msg import PoseStamped

        return PoseStamped
    from sensor_msgs.msg import Image

    return Image


def count(kind: str, topic: str = "measured") -> None:
    """Count messages until SIGINT; print the delays in seconds."""
    import rclpy

    delays: List[float] = []

    def receive(message: Any) -> None:
        stamp = message.stamp if hasattr(message, "stamp") else message.header.stamp
        delays.append(time.time() - stamp.sec - stamp.nanosec / 1e9)

    rclpy.init()
    node = rclpy.create_node(f"counter_{topic}")
    if topic == "output":
        from std_msgs.msg import Header

        node.create_subscription(Header, topic, receive, 1000)
    else:
        node.create_subscription(message_class(kind), topic, receive, 1000)
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
        print(json.dumps(delays))


def publish(kind: str, rate: float, seconds: float) -> None:
    """Publish messages at a rate; print their number."""
    import rclpy

    rclpy.init()
    node = rclpy.create_node("load")
    publisher = node.create_publisher(message_class(kind), "measured", 1000)
    end = time.monotonic() + 30
    while publisher.get_subscription_count() < 2 and time.monotonic() < end:
        time.sleep(0.02)
    time.sleep(START_SECONDS)
    message = message_class(kind)()
    if kind == "image":
        message.height, message.width, message.step, message.encoding = 480, 640, 1920, "rgb8"
        message.data = bytes(480 * 1920)
    sent, start = 0, time.monotonic()
    while time.monotonic() - start < seconds:
        due = int((time.monotonic() - start) * rate)
        while sent < due:
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(time.time_ns(), 10**9)
            publisher.publish(message)
            sent += 1
        time.sleep(min(0.0005, 0.5 / rate))
    time.sleep(1.0)
    print(sent)


def start(*words: str, **options: Any) -> Any:
    """Start a part of this script."""
    return subprocess.Popen([sys.executable, __file__, *words], text=True, **options)


def measure(kind: str, program: Any, rate: float, seconds: float, has_output: bool) -> Dict[str, Any]:
    """Return the cost of both nodes at a rate."""
    from ros2.node_processes import NodeProcess

    with tempfile.TemporaryDirectory() as folder:
        topics, goals = program
        Path(folder, "pub_sub.xml").write_text(f"<publish_subscribe>{topics}</publish_subscribe>")
        Path(folder, "goalPredicates.txt").write_text(goals)
        node = NodeProcess(Path(folder, "node.log"), "-p", f"program:={folder}")
        counter = start("--count", kind, stdout=subprocess.PIPE)
        output = start("--count", kind, "--output", stdout=subprocess.PIPE) if has_output else None
        time.sleep(START_SECONDS)
        before = [cpu(process.pid) for process in (node.process, counter)]
        load = start("--publish", kind, str(rate), str(seconds), stdout=subprocess.PIPE)
        sent = int(load.communicate(timeout=MAX_SECONDS)[0])
        spent = [cpu(process.pid) - first for process, first in zip((node.process, counter), before)]
        delays = [read_delays(process) for process in (output, counter) if process is not None]
        node.interrupt()
    return {
        "kind": kind,
        "rate": rate,
        "sent": sent,
        "node_us": 1e6 * spent[0] / sent,
        "counter_us": 1e6 * spent[1] / sent,
        "delays": delays,
    }


def read_delays(process: Any) -> List[float]:
    """End a counting node, and return its delays in order."""
    process.send_signal(signal.SIGINT)
    return sorted(json.loads(process.communicate(timeout=MAX_SECONDS)[0]))


def describe_delays(delays: List[float]) -> str:
    """Return the number of messages with the median and 99 % of their delays."""
    if not delays:
        return "no message"
    median, high = delays[len(delays) // 2], delays[len(delays) * 99 // 100]
    return f"{len(delays)} received, delay {1e3 * median:.2f} ms, 99 % {1e3 * high:.2f} ms"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--kind", nargs="+", choices=TYPES, default=["pose"])
    parser.add_argument("--rate", nargs="+", type=above_zero, default=[100.0, 1900.0])
    parser.add_argument("--seconds", type=above_zero, default=10.0)
    options = parser.parse_args()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    for kind in options.kind:
        for rate in options.rate:
            cost = measure(kind, PROGRAMS[kind], rate, options.seconds, False)
            print(
                f"{kind} at {rate:g}/s: node {cost['node_us']:.0f} us a message, counting node "
                f"{cost['counter_us']:.0f} us = {cost['node_us'] / cost['counter_us']:.2f}",
                flush=True,
            )
            if kind == "pose":
                outputs, counted = measure(kind, DELAY_PROGRAM, rate, options.seconds, True)["delays"]
                print(f"  node with outputs: {describe_delays(outputs)}")
                print(f"  counting node:     {describe_delays(counted)}", flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--count"]:
        count(sys.argv[2], "output" if sys.argv[3:] else "measured")
    elif sys.argv[1:2] == ["--publish"]:
        publish(sys.argv[2], float(sys.argv[3]), float(sys.argv[4]))
    else:
        main()
