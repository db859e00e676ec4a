#!/usr/bin/env python3
"""Cost of the node of ROS 2 beside a node of rclpy that only counts the same messages; losses; memory.

    bench/ros2_node.py [--kind pose image scan cloud] [--rate N ...] [--seconds N] [--burst N]
    bench/ros2_node.py --loss [--kind pose ...] [--rate 1900 9500 19000] [--seconds N] [--depth N]
    bench/ros2_node.py --memory [--kind pose ...] [--rate N ...] [--seconds N]

Needs rclpy and the installed package (``./install.py test --ros2 --collect-only`` builds it; the same environment).
Both nodes read the same topic of one publisher, at the same time. CPU is user and system time of each process from
``/proc``, for each message. The delay is the time from publishing to the callback of the counting node, or to that of
a second one, which receives the outputs that the program sends for each message. A relay, a node of rclpy that
publishes as much, has the same two steps. For all kinds but poses only the CPU is measured. ``--burst 2`` publishes
two messages at once, as drivers do with an image and the parameters of its camera.

``--loss`` compares the number of sent messages with what the node has received and counted as missing, without the
counting node. Quality of service is reliable. Publisher and node store as many messages as ``--depth`` says, so a
node that is late by more of them loses some.

``--memory`` reads the resident memory of the node each second. Its growth is the slope of a line through the values
after the first third.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager, suppress
from pathlib import Path
from statistics import linear_regression
from typing import Any, Dict, Iterator, List, NamedTuple, Tuple

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "test")]

from arguments import above_zero, positive  # noqa: E402
from processes import cpu, resident  # noqa: E402

KINDS = ("pose", "image", "scan", "cloud")
RATES = {"pose": [100.0, 1900.0], "image": [30.0], "scan": [40.0], "cloud": [10.0]}
"""Default rates in messages per second."""

LOSS_RATES = [1900.0, 9500.0, 19000.0]
"""One, five and ten times the rate of a NAO."""

PROGRAMS = {
    "pose": (
        '<subscribe_to name="measured" msg_type="geometry_msgs/PoseStamped"/>',
        "memorize(geometry_msgs__0__PoseStamped(H, P), [], pose(H, P), poses, 1000)\n",
    ),
    "image": (
        '<subscribe_to name="measured" msg_type="sensor_msgs/Image" event="image"/>',
        "memorize(image{header: H}, [], H, images, 10)\n",
    ),
    "scan": (
        '<subscribe_to name="measured" msg_type="sensor_msgs/LaserScan" event="scan"/>',
        "memorize(scan{header: H}, [], H, scans, 10)\n",
    ),
    "cloud": (
        '<subscribe_to name="measured" msg_type="sensor_msgs/PointCloud2" event="cloud"/>',
        "memorize(cloud{header: H, width: W}, [], c(H, W), clouds, 10)\n",
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

DEPTH = 1000
"""Number of messages that publisher and readers store by default; the largest one that a node chooses itself."""


OUTPUTS = ("output", "relayed")
"""Topics of the outputs of the node, and of the relay."""


class Load(NamedTuple):
    """Messages to publish.

    Attributes:
        kind: kind of the messages.
        rate: messages per second.
        seconds: seconds for which they are published.
        depth: number of messages that the publisher stores.
        burst: number of messages that are published at once.
    """

    kind: str
    rate: float
    seconds: float
    depth: int = DEPTH
    burst: int = 1


class SentMessages(NamedTuple):
    """Number of sent messages, and the seconds in which they were sent."""

    sent: int
    seconds: float


def make_message(kind: str) -> Any:
    """Return a message of a kind."""
    if kind == "pose":
        from geometry_msgs.msg import PoseStamped

        return PoseStamped()
    from sensor_msgs.msg import Image, LaserScan, PointCloud2

    if kind == "scan":
        return LaserScan(ranges=[1.0] * 720)
    if kind == "image":
        return Image(height=480, width=640, step=1920, encoding="rgb8", data=bytes(480 * 1920))
    # 100,000 points of 16 bytes.
    return PointCloud2(height=1, width=100_000, point_step=16, row_step=1_600_000, data=bytes(1_600_000))


def message_class(kind: str) -> Any:
    """Return the class of the messages."""
    return type(make_message(kind))


def count(kind: str, topic: str = "measured") -> None:
    """Count messages until SIGINT; print the delays in seconds."""
    import rclpy

    delays: List[float] = []

    def receive(message: Any) -> None:
        stamp = message.stamp if hasattr(message, "stamp") else message.header.stamp
        delays.append(time.time() - stamp.sec - stamp.nanosec / 1e9)

    rclpy.init()
    node = rclpy.create_node(f"counter_{topic}")
    if topic in OUTPUTS:
        from std_msgs.msg import Header

        node.create_subscription(Header, topic, receive, DEPTH)
    else:
        node.create_subscription(message_class(kind), topic, receive, DEPTH)
    spin(node)
    print(json.dumps(delays))


def relay() -> None:
    """Publish the header of each pose until SIGINT."""
    import rclpy
    from std_msgs.msg import Header

    rclpy.init()
    node = rclpy.create_node("relay")
    publisher = node.create_publisher(Header, "relayed", DEPTH)

    def receive(message: Any) -> None:
        publisher.publish(message.header)

    node.create_subscription(message_class("pose"), "measured", receive, DEPTH)
    spin(node)


def spin(node: Any) -> None:
    """Run the callbacks of a node until SIGINT."""
    import rclpy

    with suppress(KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
        rclpy.spin(node)


def publish(load: Load, is_compared: bool) -> None:
    """Publish messages at a rate; print their number and the seconds that this has taken.

    Args:
        load: the messages.
        is_compared: whether the counting node reads them, too, and measures delays. Otherwise they are serialized
            once, which allows higher rates, and have no stamps.
    """
    import rclpy
    from rclpy.serialization import serialize_message

    rclpy.init()
    node = rclpy.create_node("load")
    message = make_message(load.kind)
    data = serialize_message(message)
    publisher = node.create_publisher(type(message), "measured", load.depth)
    end = time.monotonic() + 30
    while publisher.get_subscription_count() < 1 + is_compared and time.monotonic() < end:
        time.sleep(0.02)
    time.sleep(START_SECONDS)
    sent, start = 0, time.monotonic()
    while time.monotonic() - start < load.seconds:
        due = int((time.monotonic() - start) * load.rate / load.burst) * load.burst
        while sent < due:
            if is_compared:
                message.header.stamp.sec, message.header.stamp.nanosec = divmod(time.time_ns(), 10**9)
            publisher.publish(message if is_compared else data)
            sent += 1
        time.sleep(min(0.0005, 0.5 / load.rate))
    taken = time.monotonic() - start
    # The reader may have to ask for messages again.
    time.sleep(2.0)
    print(sent, taken)


def start(*words: str, **options: Any) -> Any:
    """Start a part of this script."""
    return subprocess.Popen([sys.executable, __file__, *words], text=True, **options)


@contextmanager
def run_node(program: Any) -> Iterator[Any]:
    """Run a node with a program, which consists of topics and goals; yield its process."""
    from ros2.node_processes import NodeProcess

    with tempfile.TemporaryDirectory() as folder:
        topics, goals = program
        Path(folder, "pub_sub.xml").write_text(f"<publish_subscribe>{topics}</publish_subscribe>")
        Path(folder, "goalPredicates.txt").write_text(goals)
        node = NodeProcess(Path(folder, "node.log"), "-p", f"program:={folder}")
        try:
            yield node.process
            if node.process.poll() is not None:
                raise SystemExit(f"the node has ended:\n{node.log()}")
            node.interrupt()
        finally:
            node.kill()


def start_load(load: Load, is_compared: bool) -> Any:
    """Start the publisher; see `publish`."""
    return start("--publish", *map(str, load), str(int(is_compared)), stdout=subprocess.PIPE)


def finish_load(process: Any) -> SentMessages:
    """Wait for the publisher; return what it has sent."""
    sent, seconds = process.communicate(timeout=MAX_SECONDS)[0].split()
    return SentMessages(int(sent), float(seconds))


def measure(load: Load, program: Any, has_output: bool) -> Dict[str, Any]:
    """Return the cost of both nodes, and the delays of the counting node; with outputs, of those before it."""
    with run_node(program) as node:
        counter = start("--count", load.kind, stdout=subprocess.PIPE)
        relaying = start("--relay") if has_output else None
        receivers = [
            start("--count", load.kind, topic, stdout=subprocess.PIPE) for topic in OUTPUTS if has_output
        ]
        time.sleep(START_SECONDS)
        before = [cpu(process.pid) for process in (node, counter)]
        sent = finish_load(start_load(load, True)).sent
        spent = [cpu(process.pid) - first for process, first in zip((node, counter), before)]
        delays = [read_delays(process) for process in (*receivers, counter)]
        if relaying is not None:
            relaying.send_signal(signal.SIGINT)
            relaying.wait(MAX_SECONDS)
    return {
        "node_us": 1e6 * spent[0] / sent,
        "counter_us": 1e6 * spent[1] / sent,
        "delays": delays,
    }


def measure_loss(load: Load) -> str:
    """Return a line with the sent messages, and those that the node has received and counted as missing."""
    topics, goals = PROGRAMS[load.kind]
    with run_node((topics.replace("/>", f' depth="{load.depth}"/>'), goals)) as node:
        time.sleep(START_SECONDS)
        before = cpu(node.pid)
        sent, seconds = finish_load(start_load(load, False))
        spent = cpu(node.pid) - before
        received, missing = read_counters()
    return (
        f"{load.kind} at {load.rate:g}/s, depth {load.depth}: {sent / seconds:.0f}/s sent, {sent} messages: "
        f"{received} received, {missing} counted as missing, {sent - received - missing} not counted; "
        f"node {1e6 * spent / sent:.0f} us a message, {spent / seconds:.0%} of a core"
    )


def read_counters() -> Tuple[int, int]:
    """Return the numbers of received and of missing messages of the node, when it has read what has arrived."""
    import rclpy

    import retalis.srv

    if not rclpy.ok():
        rclpy.init()
    client_node = rclpy.create_node("reader")
    client = client_node.create_client(retalis.srv.List, "/retalis/list")
    client.wait_for_service(MAX_SECONDS)
    counters, before = (0, 0), (-1, -1)
    while counters != before:
        before = counters
        time.sleep(1.0)
        future = client.call_async(retalis.srv.List.Request())
        rclpy.spin_until_future_complete(client_node, future)
        counters = next(
            (int(entry.messages), int(entry.missing))
            for entry in future.result().inputs
            if entry.topic == "/measured"
        )
    client_node.destroy_node()
    return counters


def measure_memory(load: Load) -> str:
    """Return a line with the resident memory of the node, and its growth."""
    with run_node(PROGRAMS[load.kind]) as node:
        time.sleep(START_SECONDS)
        before = cpu(node.pid)
        publisher = start_load(load, False)
        samples: List[Tuple[float, float]] = []
        while publisher.poll() is None:
            samples.append((time.monotonic(), resident(node.pid)))
            time.sleep(1.0)
        result = finish_load(publisher)
        spent = cpu(node.pid) - before
    steady = samples[len(samples) // 3 :]
    slope = linear_regression(*zip(*steady)).slope
    values = [value for _, value in steady]
    return (
        f"{load.kind} at {load.rate:g}/s for {result.seconds:.0f} s: {min(values):.1f} to {max(values):.1f} MB, "
        f"growth {3600 * slope:.1f} MB an hour; {spent / result.seconds:.0%} of a core"
    )


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


def measure_cost(load: Load) -> str:
    """Return lines with the cost of both nodes, and with the delays for poses."""
    cost = measure(load, PROGRAMS[load.kind], False)
    lines = [
        f"{load.kind} at {load.rate:g}/s: node {cost['node_us']:.0f} us a message, counting node "
        f"{cost['counter_us']:.0f} us = {cost['node_us'] / cost['counter_us']:.2f}"
    ]
    if load.kind == "pose":
        outputs, relayed, counted = measure(load, DELAY_PROGRAM, True)["delays"]
        lines.append(f"  node with outputs: {describe_delays(outputs)}")
        lines.append(f"  relay:             {describe_delays(relayed)}")
        lines.append(f"  counting node:     {describe_delays(counted)}")
    return "\n".join(lines)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--kind", nargs="+", choices=KINDS, default=["pose"])
    parser.add_argument("--rate", nargs="+", type=above_zero)
    parser.add_argument("--seconds", type=above_zero, default=10.0)
    parser.add_argument("--depth", type=positive, default=DEPTH, help="for --loss and --memory")
    parser.add_argument(
        "--burst", type=positive, default=1, help="number of messages that are published at once"
    )
    group = parser.add_mutually_exclusive_group()
    group.add_argument("--loss", dest="measure", action="store_const", const=measure_loss)
    group.add_argument("--memory", dest="measure", action="store_const", const=measure_memory)
    parser.set_defaults(measure=measure_cost)
    options = parser.parse_args()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    for kind in options.kind:
        rates = LOSS_RATES if options.measure is measure_loss and kind == "pose" else RATES[kind]
        for rate in options.rate or rates:
            load = Load(kind, rate, options.seconds, options.depth, options.burst)
            print(options.measure(load), flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--count"]:
        count(*sys.argv[2:])
    elif sys.argv[1:2] == ["--relay"]:
        relay()
    elif sys.argv[1:2] == ["--publish"]:
        kind, rate, seconds, depth, burst, is_compared = sys.argv[2:]
        publish(Load(kind, float(rate), float(seconds), int(depth), int(burst)), is_compared == "1")
    else:
        main()
