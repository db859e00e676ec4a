#!/usr/bin/env python3
"""Large messages through the nodes: images and clouds of a camera at once, with lost messages, delay and CPU.

    bench/large_messages.py [--seconds N] [--runs N] [--way default embedded text] [--queue N] [--json FILE]

Needs ROS and the built package on the path (``source devel/setup.bash``). Starts its own master on a free port.
A process publishes images of 0.9 MB at 30 Hz and clouds of 1.6 MB at 10 Hz with rospy. A rule reads the mean colour
of each image, and counts the points of each cloud in a box; each result is a message with the header of its input.
Lost are inputs without a result. The delay is the time from the stamp of an input to the receipt of its result.
"""

import argparse
import json
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Dict, List, Optional

sys.path.insert(0, str(Path(__file__).resolve().parent))

from arguments import above_zero, positive, target  # noqa: E402
from live_node import LAUNCH, running, wait_until  # noqa: E402
from processes import Started, cpu, machine, own_master  # noqa: E402

TOPICS = ("image", "cloud")

SENDER = """
import sys, threading, time
import rospy
from sensor_msgs.msg import Image, PointCloud2, PointField
seconds, queue = float(sys.argv[1]), int(sys.argv[2])
rospy.init_node("camera", disable_signals=True)
image = Image(height=480, width=640, encoding="rgb8", step=1920, data=bytes(921_600))
fields = [PointField(name, 4 * at, PointField.FLOAT32, 1) for at, name in enumerate("xyz")]
cloud = PointCloud2(height=1, width=100_000, fields=fields, point_step=16, row_step=1_600_000,
                    data=bytes(1_600_000), is_dense=True)
publishers = {"image": rospy.Publisher("image", Image, queue_size=queue),
              "cloud": rospy.Publisher("cloud", PointCloud2, queue_size=queue)}
while not all(one.get_num_connections() for one in publishers.values()):
    time.sleep(0.05)
time.sleep(0.5)  # the subscriber's side of the connections

def publish(topic, message, rate):
    began = time.monotonic()
    for number in range(int(rate * seconds)):
        time.sleep(max(0.0, began + number / rate - time.monotonic()))
        message.header.stamp = rospy.Time.from_sec(time.time())
        publishers[topic].publish(message)

threads = [threading.Thread(target=publish, args=given) for given in (("image", image, 30), ("cloud", cloud, 10))]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
time.sleep(5)  # what waits in the queues is still sent
"""

PROGRAM = {
    "eventRules.txt": (
        "image_seen(H) <- sensor_msgs__0__Image{header: H}\n"
        "  where (access_mem(image, I, _), image_region_mean(I, 160, 120, 320, 240, [_, _, _])).\n"
        "cloud_seen(H) <- sensor_msgs__0__PointCloud2{header: H}\n"
        "  where (access_mem(cloud, C, _), cloud_box(C, [-1, -1, -1], [1, 1, 1], _)).\n"
    ),
    "goalPredicates.txt": (
        "compile_event_file('eventRules.txt')\n"
        "memorize(sensor_msgs__0__Image{}, [], _, image, 1)\n"
        "memorize(sensor_msgs__0__PointCloud2{}, [], _, cloud, 1)\n"
        "subscribe(image_seen(H), [], H, image_seen, i)\n"
        "subscribe(cloud_seen(H), [], H, cloud_seen, c)\n"
    ),
    "pub_sub.xml": (
        "<publish_subscribe>\n"
        '  <subscribe_to name="image" msg_type="sensor_msgs/Image"/>\n'
        '  <subscribe_to name="cloud" msg_type="sensor_msgs/PointCloud2"/>\n'
        '  <publish_to name="image_seen" msg_type="std_msgs/Header"/>\n'
        '  <publish_to name="cloud_seen" msg_type="std_msgs/Header"/>\n'
        "</publish_subscribe>\n"
    ),
}

WAYS = {
    "default": LAUNCH,
    "embedded": [*LAUNCH, "embedded:=true"],
    "text": [*LAUNCH, "direct:=false"],
}
"""The command that starts each configuration."""

RATES = {"image": 30, "cloud": 10}


def run(way: str, seconds: float, queue: int, program: Path) -> Dict[str, Any]:
    """Return the figures of one run.

    Args:
        way: a key of `WAYS`.
        seconds: duration of the stream.
        queue: length of the publishers' queues.
        program: folder of the program.
    """
    import rospy
    from std_msgs.msg import Header

    delays: Dict[str, List[float]] = {topic: [] for topic in TOPICS}

    def receive(header: Any, topic: str) -> None:
        delays[topic].append(1000 * (time.time() - header.stamp.to_sec()))

    subscribers = [
        rospy.Subscriber(f"{topic}_seen", Header, receive, topic, queue_size=1000, tcp_nodelay=True)
        for topic in TOPICS
    ]
    started = Started()
    try:
        started([*WAYS[way], f"program:={program}"])
        wait_until(lambda: all(one.get_num_connections() for one in subscribers))
        wait_until(lambda: len(list(running("/retalis"))) == (1 if way == "embedded" else 2))
        nodes = dict(running("/retalis"))
        before = {name: cpu(pid) for name, pid in nodes.items()}
        began = time.monotonic()
        started([sys.executable, "-c", SENDER, str(seconds), str(queue)]).wait()
        took = time.monotonic() - began
        percent = {name: 100 * (cpu(pid) - before[name]) / took for name, pid in nodes.items()}
    finally:
        for subscriber in subscribers:
            subscriber.unregister()
        started.end()
    figures: Dict[str, Any] = {"way": way, "cpu_percent": percent}
    for topic, values in delays.items():
        values.sort()
        sent = int(RATES[topic] * seconds)
        figures[topic] = {
            "sent": sent,
            "lost": sent - len(values),
            "median_ms": statistics.median(values) if values else None,
            "p99_ms": values[int(0.99 * (len(values) - 1))] if values else None,
        }
    return figures


def line(figures: Dict[str, Any]) -> str:
    """Return one row of the table in Markdown."""
    cells = [
        figures["way"],
        " + ".join(f"{value:.1f}" for _, value in sorted(figures["cpu_percent"].items())),
    ]
    for topic in TOPICS:
        one = figures[topic]
        times = [one["median_ms"], one["p99_ms"]]
        cells += [
            f"{one['lost']}/{one['sent']}",
            *("" if value is None else f"{value:.1f}" for value in times),
        ]
    return f"| {' | '.join(cells)} |"


def arguments(given: Optional[List[str]] = None) -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=above_zero, default=20.0, help="duration of the stream")
    parser.add_argument("--runs", type=positive, default=1)
    parser.add_argument("--way", nargs="+", choices=list(WAYS), default=list(WAYS))
    parser.add_argument("--queue", type=positive, default=10, help="length of the publishers' queues")
    parser.add_argument("--json", type=target, help="write the figures there")
    return parser.parse_args(given)


def main() -> int:
    """Run the benchmark that the command line selects."""
    options = arguments()
    print("| nodes | CPU % | images lost | median ms | 99 % ms | clouds lost | median ms | 99 % ms |")
    print("| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |")
    rows = []
    with own_master("bench"), tempfile.TemporaryDirectory() as folder:
        for name, text in PROGRAM.items():
            (Path(folder) / name).write_text(text)
        for _ in range(options.runs):
            for way in options.way:
                rows.append(run(way, options.seconds, options.queue, Path(folder)))
                print(line(rows[-1]), flush=True)
    if options.json:
        Path(options.json).write_text(json.dumps({"machine": machine(), "runs": rows}, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
