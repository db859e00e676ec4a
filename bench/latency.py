#!/usr/bin/env python3
"""Latency of the nodes: time from publishing a message to receiving the output of one rule.

    bench/latency.py [--rates 100 1000] [--seconds N] [--runs N] [--nodes relay direct embedded two] [--json FILE]

Needs ROS and the built package on the path (``source devel/setup.bash``). Starts its own master on a free port.
This process publishes ``geometry_msgs/PoseStamped`` messages and subscribes to the result, so the configurations
differ only in what runs between the two topics:

* ``relay``: a rospy node that publishes each message that it receives;
* ``direct``: both nodes by default: node ``retalis`` subscribes and publishes;
* ``embedded``: only node ``retalis``;
* ``two``: node ``retalis_ros_interface`` subscribes and publishes, and all events go through text to node ``retalis``
  and back.

The configurations run one after the other at each rate; the runs of a configuration are pooled. ``of relay`` is the
99th percentile divided by that of ``relay`` at the same rate.
"""

import argparse
import gc
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Dict, List, Optional

sys.path.insert(0, str(Path(__file__).resolve().parent))

from arguments import above_zero, positive, target  # noqa: E402
from live_node import LAUNCH, connected, running, wait_until  # noqa: E402
from processes import Started, machine, own_master  # noqa: E402

RELAY = """
import rospy
from geometry_msgs.msg import PoseStamped
rospy.init_node("relay")
publisher = rospy.Publisher("latency_out", PoseStamped, queue_size=5000)
rospy.Subscriber("latency_in", PoseStamped, publisher.publish, queue_size=5000, tcp_nodelay=True)
rospy.spin()
"""

PROGRAM = {
    "eventRules.txt": "posed(Header, Pose) <- geometry_msgs__0__PoseStamped(Header, Pose).\n",
    "goalPredicates.txt": (
        "compile_event_file('eventRules.txt')\n"
        "subscribe(posed(H, P), [], geometry_msgs__0__PoseStamped(H, P), latency_out, out)\n"
    ),
    "pub_sub.xml": (
        "<publish_subscribe>\n"
        '  <subscribe_to name="latency_in" msg_type="geometry_msgs/PoseStamped"/>\n'
        '  <publish_to name="latency_out" msg_type="geometry_msgs/PoseStamped"/>\n'
        "</publish_subscribe>\n"
    ),
}

CONFIGURATIONS = {
    "relay": [sys.executable, "-c", RELAY],
    "direct": LAUNCH,
    "embedded": [*LAUNCH, "embedded:=true"],
    "two": [*LAUNCH, "direct:=false", "embedded:=false"],
}
"""The command that starts each configuration."""

WARM_UP_SECONDS = 2.0
DRAIN_SECONDS = 5.0
PERCENTILES = {"p50": 0.5, "p99": 0.99, "p99.9": 0.999}


class Probe:
    """Publishes messages and measures when their results arrive.

    Args:
        program: the folder of the program that the nodes load.
    """

    def __init__(self, program: Path):
        self._program = program
        self._received: Dict[int, float] = {}

    def run(self, configuration: str, rate: float, seconds: float) -> Dict[str, Any]:
        """Return the number of lost messages and the sorted latencies in ms of one run.

        Args:
            configuration: a key of `CONFIGURATIONS`.
            rate: messages a second.
            seconds: length of the measurement, which follows a warm-up.
        """
        import rospy
        from geometry_msgs.msg import PoseStamped

        publisher = rospy.Publisher("latency_in", PoseStamped, queue_size=5000)
        subscriber = rospy.Subscriber("latency_out", PoseStamped, self._receive, tcp_nodelay=True)
        started = Started()
        command = CONFIGURATIONS[configuration]
        try:
            started(command if configuration == "relay" else [*command, f"program:={self._program}"])
            self._wait_for_nodes(configuration, publisher, subscriber)
            self._publish(publisher, rate, WARM_UP_SECONDS)
            sent = self._publish(publisher, rate, seconds)
            self._wait_for_results(sent)
        finally:
            publisher.unregister()
            subscriber.unregister()
            started.end()
        latencies = [1000 * (self._received[key] - sent[key]) for key in sent if key in self._received]
        return {"lost": len(sent) - len(latencies), "latencies_ms": sorted(latencies)}

    def _wait_for_nodes(self, configuration: str, publisher: Any, subscriber: Any) -> None:
        wait_until(lambda: publisher.get_num_connections() and subscriber.get_num_connections())
        if configuration in ("direct", "two"):
            wait_until(lambda: len(list(running("/retalis"))) == 2)
        if configuration == "two":
            nodes = dict(running("/retalis"))
            wait_until(lambda: connected(nodes, "/retalisInputEvents", "/retalisOutputEvents"))
        # The subscriber notes a connection before the publisher does; then a first result shows that all is ready.
        wait_until(lambda: self._received or not self._publish(publisher, 10, 0.1))

    def _publish(self, publisher: Any, rate: float, seconds: float) -> Dict[int, float]:
        """Publish messages at a rate; return the time at which each was published, by its timestamp in ns."""
        import rospy
        from geometry_msgs.msg import PoseStamped

        message = PoseStamped()
        message.header.frame_id = "map"
        message.pose.orientation.w = 1.0
        self._received.clear()
        sent: Dict[int, float] = {}
        gc.collect()
        began = time.monotonic()
        for number in range(max(1, int(rate * seconds))):
            pause = began + number / rate - time.monotonic()
            if pause > 0:
                time.sleep(pause)
            message.header.stamp = rospy.Time.from_sec(time.time())
            message.pose.position.x = 0.01 * number
            sent[message.header.stamp.to_nsec()] = time.monotonic()
            publisher.publish(message)
        return sent

    def _receive(self, message: Any) -> None:
        self._received[message.header.stamp.to_nsec()] = time.monotonic()

    def _wait_for_results(self, sent: Dict[int, float]) -> None:
        deadline = time.monotonic() + DRAIN_SECONDS
        while time.monotonic() < deadline and not sent.keys() <= self._received.keys():
            time.sleep(0.01)


def summary(runs: List[Dict[str, Any]]) -> List[Dict[str, Any]]:
    """Return a row for each rate and configuration, of the latencies of all its runs."""
    rows: Dict[Any, Dict[str, Any]] = {}
    for run in runs:
        key = run["rate"], run["configuration"]
        row = rows.setdefault(key, {"rate": key[0], "configuration": key[1], "lost": 0, "latencies_ms": []})
        row["lost"] += run["lost"]
        row["latencies_ms"].extend(run["latencies_ms"])
    for row in rows.values():
        latencies = sorted(row.pop("latencies_ms"))
        row["messages"] = len(latencies)
        for name, share in PERCENTILES.items():
            row[name] = percentile(latencies, share)
    for row in rows.values():
        relay = rows.get((row["rate"], "relay"), {}).get("p99")
        row["of_relay"] = row["p99"] / relay if relay and row["p99"] is not None else None
    return list(rows.values())


def percentile(values: List[float], share: float) -> Optional[float]:
    """Return the value at a share of the sorted values, counted from the first; None without values."""
    if not values:
        return None
    return values[min(len(values) - 1, int(share * len(values)))]


def table(rows: List[Dict[str, Any]]) -> str:
    """Return the rows as a table in Markdown."""
    lines = [
        "| nodes | Hz | p50 ms | p99 ms | p99.9 ms | p99 of relay | messages | lost |",
        "| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    for row in rows:
        figures = [*(row[name] for name in PERCENTILES), row["of_relay"]]
        shown = " | ".join("" if figure is None else f"{figure:.2f}" for figure in figures)
        name, rate = row["configuration"], row["rate"]
        lines.append(f"| {name} | {rate:g} | {shown} | {row['messages']} | {row['lost']} |")
    return "\n".join(lines)


def measure(options: argparse.Namespace) -> List[Dict[str, Any]]:
    """Return all runs that the command line asks for."""
    runs = []
    with tempfile.TemporaryDirectory() as folder:
        for name, text in PROGRAM.items():
            (Path(folder) / name).write_text(text)
        probe = Probe(Path(folder))
        for rate in options.rates:
            for _ in range(options.runs):
                for configuration in options.nodes:
                    run = probe.run(configuration, rate, options.seconds)
                    runs.append({"rate": rate, "configuration": configuration, **run})
                    print(table(summary(runs[-1:])).splitlines()[-1], file=sys.stderr, flush=True)
    return runs


def arguments(given: Optional[List[str]] = None) -> argparse.Namespace:
    """Return the options of a command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rates", type=above_zero, nargs="+", default=[100.0, 1000.0], metavar="HZ")
    parser.add_argument("--seconds", type=above_zero, default=20.0, help="length of each run (20)")
    parser.add_argument("--runs", type=positive, default=1, help="runs of each configuration and rate (1)")
    parser.add_argument("--nodes", nargs="+", choices=list(CONFIGURATIONS), default=list(CONFIGURATIONS))
    parser.add_argument("--json", type=target, metavar="FILE", help="write all latencies there, too")
    return parser.parse_args(given)


def main() -> int:
    """Run what the command line asks for."""
    options = arguments()
    with own_master("latency"):
        runs = measure(options)
    rows = summary(runs)
    print(table(rows))
    if options.json:
        result = {"machine": machine(), "rows": rows, "runs": runs}
        Path(options.json).write_text(json.dumps(result, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
