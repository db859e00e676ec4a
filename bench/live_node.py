#!/usr/bin/env python3
"""Cost of the nodes with the NAO's messages on a real master: CPU, delay, losses, memory, start time.

    bench/live_node.py [--seconds N] [--speed 1 5 10 20] [--way idle roscpp direct kept embedded converter] [--runs N]
                  [--memory MESSAGES] [--starts N] [--interrupts N] [--json FILE] [--plot FILE]

Needs ROS and the built package on the path (``source devel/setup.bash``). Starts its own master on a free port.
The configurations run alternately, and the medians of the runs are shown.

``idle`` is a rospy subscriber of the same topics that does nothing, ``roscpp`` one in C++ (left out where it cannot
be built). CPU is user and system time of the nodes' processes from ``/proc``, until the last message is processed, as
percent of a core. ``idle = 1`` is the CPU time of node retalis, compared with the median of ``idle`` at that speed.
The delay is the time from sending the message that completes a marker's data to the receipt of its pose. Lost are the
messages that did not arrive at the engine's node: sent messages minus those that its connections have delivered.
``--interrupts`` measures the time from SIGINT, at `INTERRUPTED_SPEED`, to the end of node retalis.
"""

import argparse
import json
import os
import signal
import statistics
import struct
import subprocess
import sys
import tempfile
import threading
import time
from bisect import bisect_right
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List, Optional

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "test" / "ros1"), str(HERE.parent / "examples" / "nao")]

from arguments import above_zero, positive, target  # noqa: E402
from processes import ROSPY_IDLE, Started, build_roscpp, cpu, machine, own_master, resident  # noqa: E402

LAUNCH = ["roslaunch", "retalis", "retalis.launch", "use_sim_time:=false"]
WAYS = {
    "idle": [sys.executable, "-c", ROSPY_IDLE],
    "roscpp": [],
    "direct": LAUNCH,
    "kept": [*LAUNCH, f"checkpoint:={tempfile.mkdtemp()}/state.db"],
    "embedded": [*LAUNCH, "embedded:=true"],
    "converter": [*LAUNCH, "direct:=false", "embedded:=false"],
}
"""Configurations with their commands: ``direct`` is the default, ``embedded`` is one node, ``kept`` writes
checkpoints, ``converter`` passes messages as text."""

PATIENCE = 20.0

INTERRUPTED_SPEED = 10.0
"""Speed of the messages that an interrupted node receives."""


TICK = 0.0005
"""Minimum sleep of the player in seconds, so that the nodes get the processor."""


class Player:
    """Playback of a NAO bag at any speed, directly into the connections of rospy's publishers.

    `Publisher.publish` alone would cost more than the nodes at the higher speeds. Due messages are written to the
    connections directly, framed as rospy frames them.

    Args:
        path: the bag; it is created if it does not exist.
        seconds: duration of a created bag.
    """

    def __init__(self, path: Path, seconds: float):
        from make_bag import make_bag

        from retalis import BagReader

        self.truth = make_bag(path, seconds, 1)
        reader = BagReader(path)
        self.topics = reader.topics
        self.records = list(reader.records())
        self._first = self.records[0].time
        self._times = [record.time - self._first for record in self.records]
        self._frames = [struct.pack("<I", len(record.data)) + record.data for record in self.records]
        self._publishers: Dict[str, Any] = {}
        self.sent: List[float] = []

    def advertise(self) -> None:
        """Create the publishers of all topics."""
        from harness import DEFINITIONS, RawPublisher

        for topic in self.topics:
            definition = DEFINITIONS.add(topic.type, topic.definition)
            self._publishers[topic.name] = RawPublisher(topic.name, definition)

    def connected(self) -> bool:
        """Return whether every topic has a subscriber."""
        return all(one.is_connected() for one in self._publishers.values())

    def close(self) -> None:
        """Unregister the publishers."""
        for one in self._publishers.values():
            one.publisher.unregister()
        self._publishers.clear()

    def play(self, speed: float, progress: Callable[[int], Any] = lambda done: None) -> float:
        """Play all messages once; return the duration in seconds.

        Stores the time of each message in ``sent``. It waits for slow subscribers.
        """
        links = {topic: self._sockets(topic) for topic in self._publishers}
        self.sent = sent = [0.0] * len(self._times)
        topics = [record.topic.name for record in self.records]
        began = time.monotonic()
        done = 0
        while done < len(sent):
            elapsed = (time.monotonic() - began) * speed * 1e9
            upto = bisect_right(self._times, elapsed, done)
            if upto == done:
                time.sleep(max(TICK, (self._times[done] - elapsed) / 1e9 / speed))
                continue
            due: Dict[str, List[bytes]] = {}
            now = time.monotonic()
            for at in range(done, upto):
                due.setdefault(topics[at], []).append(self._frames[at])
                sent[at] = now
            for topic, frames in due.items():
                for link in list(links[topic]):
                    try:
                        link.sendall(b"".join(frames))
                    except OSError:  # of a node that has ended; what a living one does not get counts as lost
                        links[topic].remove(link)
            done = upto
            progress(done)
        return time.monotonic() - began

    def _sockets(self, topic: str) -> List[Any]:
        connections = self._publishers[topic].publisher.impl.connections
        return [getattr(one, "_connection", one).socket for one in connections]

    def completing(self) -> Dict[Any, int]:
        """Return for each observation of a marker the index of the message that completes its data."""
        from nao_robot import CHAIN

        links: Dict[Any, List[Any]] = {(f'"{one[0]}"', f'"{one[1]}"'): [] for one in CHAIN}
        arrived: Dict[Any, int] = {}
        for index, (topic, parent, child, stamp) in enumerate(self._stamped()):
            if topic == "/tf" and (parent, child) in links:
                links[parent, child].append((stamp, index))
            elif topic == "/ar_pose_marker":
                arrived[parent.strip('"'), stamp] = index
        wanted = {(one.marker, one.stamp) for one in self.truth.complete}
        return {
            key: max(index, *(next(at for stamp, at in link if stamp >= key[1]) for link in links.values()))
            for key, index in arrived.items()
            if key in wanted
        }

    def _stamped(self) -> Any:
        """Yield topic, frame, child frame and stamp of each message; empty values if it has none."""
        from retalis import Definitions, deref, list_items

        definitions = Definitions()
        for record in self.records:
            topic = record.topic
            if topic.name not in ("/tf", "/ar_pose_marker"):
                yield topic.name, "", "", 0
                continue
            decoder = definitions.decoder(definitions.add(topic.type, topic.definition))
            (item,) = list_items(deref(decoder.decode(record.data))[-1])
            header, child = deref(deref(item)[1]), deref(deref(item)[2])
            seconds, nanoseconds = (deref(part) for part in list_items(header[2]))
            yield topic.name, deref(header[3]).name, getattr(child, "name", ""), seconds * 10**9 + nanoseconds


class Bench:
    """Runs of the benchmark with one player.

    Args:
        player: the player of the bag.
    """

    def __init__(self, player: Player):
        import rospy
        from rosgraph_msgs.msg import Log

        self.rospy = rospy
        self.player = player
        self.completing = player.completing()
        self.received: Dict[Any, float] = {}
        self.warnings: List[str] = []
        rospy.Subscriber("rosout_agg", Log, self._note, queue_size=1000)

    def run(self, way: str, speed: float, progress: Callable[..., Any] = lambda done, nodes: None) -> Any:
        """Play the bag once and return the figures."""
        from geometry_msgs.msg import PoseStamped

        started = Started()
        self.received.clear()
        self.warnings.clear()
        listening = [
            self.rospy.Subscriber(f"marker{i}", PoseStamped, self._take, queue_size=10_000)
            for i in range(1, 9)
        ]
        try:
            started(WAYS[way])
            nodes = self._ready(way, listening)
            return {"way": way, "speed": speed, **self._measure(nodes, speed, progress)}
        finally:
            for one in listening:
                one.unregister()
            self.player.close()
            started.end()

    def _ready(self, way: str, listening: List[Any]) -> Dict[str, int]:
        """Return the nodes' process ids after all topics have been connected."""
        self.player.advertise()
        wait_until(self.player.connected)
        if way in ("idle", "roscpp"):
            return {"/" + name.strip("/"): pid for name, pid in running("/idle")}
        wait_until(lambda: all(one.get_num_connections() for one in listening))
        number = 1 if way == "embedded" else 2
        wait_until(lambda: len(list(running("/retalis"))) >= number)
        nodes = dict(running("/retalis"))
        topics = {one.resolved_name for one in listening}
        wait_until(lambda: topics <= {topic for name in nodes for topic in heard(name)})
        if way == "converter":
            wait_until(lambda: connected(nodes, "/retalisInputEvents", "/retalisOutputEvents"))
        return nodes

    def _measure(self, nodes: Dict[str, int], speed: float, progress: Callable[..., Any]) -> Dict[str, Any]:
        arrived = arrivals(nodes) if "/retalis" in nodes else None
        before = {name: cpu(pid) for name, pid in nodes.items()}
        took = self.player.play(speed, lambda done: progress(done, nodes))
        expected = len(self.completing) if "/retalis" in nodes else 0
        self._settle(nodes, expected)
        percent = {name: 100 * (cpu(pid) - before[name]) / took for name, pid in nodes.items()}
        sent = len(self.player.records)
        delays = self._delays()
        return {
            "messages_a_second": sent / took,
            "cpu_percent": sum(percent.values()),
            "by_node": percent,
            "resident_mb": {name: resident(pid) for name, pid in nodes.items()},
            "lost": sent - (arrivals(nodes) - arrived) if arrived is not None else 0,
            "drops_reported": len([one for one in self.warnings if "dropped so far" in one]),
            "poses": len(self.received),
            "expected": expected,
            "delay_ms_median": statistics.median(delays) if delays else None,
            "delay_ms_99": delays[int(0.99 * (len(delays) - 1))] if delays else None,
        }

    def _settle(self, nodes: Dict[str, int], expected: int) -> None:
        """Wait until all poses have arrived, or nothing has arrived for some time."""
        deadline = time.monotonic() + PATIENCE
        last: Any = None
        while time.monotonic() < deadline:
            time.sleep(0.1)
            now = len(self.received), arrivals(nodes)
            if now == last and len(self.received) >= expected:
                return
            last = now

    def _delays(self) -> List[float]:
        sent = self.player.sent
        return sorted(
            1000 * (self.received[key] - sent[index])
            for key, index in self.completing.items()
            if key in self.received
        )

    def _take(self, pose: Any) -> None:
        key = (pose.header.frame_id, pose.header.stamp.to_nsec())
        self.received.setdefault(key, time.monotonic())

    def _note(self, message: Any) -> None:
        if message.level >= message.WARN:
            self.warnings.append(message.msg)


def wait_until(condition: Callable[[], Any]) -> None:
    """Wait for a condition.

    Raises:
        TimeoutError: if it does not come true.
    """
    deadline = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > deadline:
            raise TimeoutError("the nodes are not connected")
        time.sleep(0.05)


def running(prefix: str) -> Iterator[Any]:
    """Yield name and process id of the nodes with a prefix."""
    import rosnode

    for name in rosnode.get_node_names():
        if name.startswith(prefix):
            yield name, slave(name).getPid("/bench")[2]


def slave(name: str) -> Any:
    """Return the XML-RPC interface of a node."""
    import xmlrpc.client

    import rosgraph

    return xmlrpc.client.ServerProxy(rosgraph.Master("/bench").lookupNode(name))


def connected(nodes: Dict[str, int], *topics: str) -> bool:
    """Return whether the nodes receive these topics from each other."""
    return set(topics) <= {topic for name in nodes for topic, links in received(name) if links}


def heard(name: str) -> List[str]:
    """Return the topics of a node with subscribers: a node records a connection after the other side."""
    return [topic for topic, _, links in slave(name).getBusStats("/bench")[2][0] if links]


def received(name: str) -> List[Any]:
    """Return the topics and connections of a node's subscriptions."""
    answer = slave(name).getBusStats("/bench")
    return answer[2][1] if len(answer) > 2 else []  # roscpp does not tell


def arrivals(nodes: Dict[str, int]) -> int:
    """Return the number of messages that have arrived at the engine's node, from topics and as text."""
    name = "/retalis" if "/retalis" in nodes else next(iter(nodes))
    count = 0
    for topic, links in received(name):
        if topic not in ("/rosout_agg", "/clock"):
            count += sum(link[2] for link in links)
    return count


def summary(rows: List[Dict[str, Any]], options: argparse.Namespace) -> List[Dict[str, Any]]:
    """Return a row for each configuration and speed: medians of the runs, and the sum of the losses."""
    found = []
    for speed in options.speed:
        for way in options.way:
            runs = [row for row in rows if (row["way"], row["speed"]) == (way, speed)]
            if runs:
                found.append({"way": way, "speed": speed, "runs": len(runs), **middle(runs)})
    for row in found:
        idle = [one for one in found if (one["way"], one["speed"]) == ("idle", row["speed"])]
        main = row["by_node"].get("/retalis", row["cpu_percent"])
        row["to_idle"] = main / idle[0]["cpu_percent"] if idle else None
    return found


def middle(runs: List[Dict[str, Any]]) -> Dict[str, Any]:
    """Return the medians of several runs."""
    result: Dict[str, Any] = {}
    for key, value in runs[0].items():
        values = [run[key] for run in runs]
        if key in ("lost", "drops_reported", "poses", "expected"):
            result[key] = sum(values)
        elif isinstance(value, dict):
            result[key] = {name: statistics.median(one[name] for one in values) for name in value}
        elif isinstance(value, float):
            result[key] = statistics.median(values)
    return result


def line(row: Dict[str, Any]) -> str:
    """Return one row of the table."""
    delay = row.get("delay_ms_median")
    shown = "" if delay is None else f"  delay {delay:6.2f} ms, 99 % {row['delay_ms_99']:6.2f} ms"
    nodes = " + ".join(f"{value:.1f}" for _, value in sorted(row["by_node"].items()))
    memory = " + ".join(f"{value:.0f}" for _, value in sorted(row["resident_mb"].items()))
    ratio = f" = {row['to_idle']:4.2f} idle" if row.get("to_idle") else ""
    return (
        f"{row['way']:<9} {row['speed']:3g}x {row['messages_a_second']:6.0f}/s  cpu {nodes:>11} %{ratio}  "
        f"lost {row['lost']}  poses {row['poses']}/{row['expected']}  memory {memory} MB{shown}"
    )


def memory_curve(messages: int, folder: Path) -> List[List[float]]:
    """Return the resident memory of the node in MB while messages are sent at full speed."""
    bench = Bench(Player(folder / "long.bag", messages / 1881))
    curve: List[List[float]] = []

    def note(done: int, nodes: Dict[str, int]) -> None:
        if not curve or done - curve[-1][0] >= messages / 20:
            curve.append([done, resident(nodes["/retalis"])])

    bench.run("embedded", 10.0, note)
    return curve


def starts(number: int) -> Dict[str, float]:
    """Return the seconds of wall and CPU time until rospy is imported, and until the node is ready."""
    figures: Dict[str, List[float]] = {}
    for _ in range(number):
        began, before = time.monotonic(), sum(os.times()[2:4])
        subprocess.run([sys.executable, "-c", "import rospy"])
        figures.setdefault("rospy", []).append(time.monotonic() - began)
        figures.setdefault("rospy_cpu", []).append(sum(os.times()[2:4]) - before)
        for name, value in zip(("node", "node_cpu"), one_start()):
            figures.setdefault(name, []).append(value)
    found = {name: statistics.median(values) for name, values in figures.items()}
    found["beyond"] = found["node"] - found["rospy"]
    found["beyond_cpu"] = found["node_cpu"] - found["rospy_cpu"]
    return found


def node_command() -> List[str]:
    """Return the command of node retalis with the program of the NAO."""
    import rospkg

    return [sys.executable, str(Path(rospkg.RosPack().get_path("retalis")) / "nodes" / "retalis_node")]


def interrupts(player: Player, number: int) -> List[Dict[str, Any]]:
    """Interrupt a node under load; return the seconds until its end, and its exit status, of each run."""
    runs = []
    for _ in range(number):
        started = Started()
        try:
            process = started(node_command())
            player.advertise()
            wait_until(player.connected)
            playing = threading.Thread(target=player.play, args=(INTERRUPTED_SPEED,))
            playing.start()
            # The queues fill meanwhile; the bag lasts longer.
            time.sleep(1.0)
            sent = time.monotonic()
            process.send_signal(signal.SIGINT)
            status = process.wait(PATIENCE)
            runs.append({"seconds": time.monotonic() - sent, "status": status})
            playing.join()
        finally:
            player.close()
            started.end()
    return runs


def one_start() -> Any:
    """Start node retalis; return the wall and CPU seconds until its services are offered."""
    import rosgraph

    master = rosgraph.Master("/bench")
    started = Started()
    began = time.monotonic()
    pid = started(node_command()).pid
    try:
        while time.monotonic() < began + PATIENCE:
            try:
                master.lookupService("/delete_memory")  # the last that the node makes
                return time.monotonic() - began, cpu(pid)
            except rosgraph.MasterError:
                time.sleep(0.005)
        raise TimeoutError("the node does not start")
    finally:
        started.end()


def measure(options: argparse.Namespace, folder: Path) -> Dict[str, Any]:
    """Run the measurements that the command line selects."""
    program = build_roscpp(folder) if "roscpp" in options.way else None
    if program is None:
        options.way = [way for way in options.way if way != "roscpp"]
    else:
        WAYS["roscpp"] = [program]
    rows = []
    bench = Bench(Player(folder / "nao.bag", options.seconds))
    for number in range(options.runs):
        for speed in options.speed:
            for way in options.way:
                rows.append(bench.run(way, speed))
                print(f"{number + 1}: {line(rows[-1])}", file=sys.stderr, flush=True)
    result: Dict[str, Any] = {"machine": machine(), "rows": summary(rows, options), "runs": rows}
    if options.memory:
        result["memory"] = memory_curve(options.memory, folder)
    if options.starts:
        result["starts"] = starts(options.starts)
    if options.interrupts:
        result["interrupts"] = interrupts(bench.player, options.interrupts)
    return result


def report(result: Dict[str, Any]) -> None:
    """Print the table."""
    for row in result["rows"]:
        print(line(row))
    for done, held in result.get("memory", ()):
        print(f"after {done:9.0f} messages the node holds {held:.1f} MB")
    if "interrupts" in result:
        times = [run["seconds"] for run in result["interrupts"]]
        statuses = sorted({run["status"] for run in result["interrupts"]})
        print(f"interrupt: {min(times):.3f} to {max(times):.3f} s in {len(times)} runs, status {statuses}")
    if "starts" in result:
        print("start: " + ", ".join(f"{name} {value:.3f} s" for name, value in result["starts"].items()))


def arguments(given: Optional[List[str]] = None) -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=above_zero, default=20.0, help="length of the bag")
    parser.add_argument("--speed", type=above_zero, nargs="+", default=[1.0, 5.0, 10.0, 20.0])
    parser.add_argument("--way", nargs="*", choices=list(WAYS), default=list(WAYS))
    parser.add_argument("--runs", type=positive, default=1)
    parser.add_argument("--memory", type=int, default=0, help="messages through which memory is watched")
    parser.add_argument("--starts", type=int, default=0, help="how often the node's start is timed")
    parser.add_argument(
        "--interrupts", type=int, default=0, help="how often a node under load is interrupted"
    )
    parser.add_argument("--json", type=target, help="write the figures there")
    parser.add_argument("--plot", type=target, help="draw them there")
    return parser.parse_args(given)


def main() -> int:
    """Run the benchmark that the command line selects."""
    options = arguments()
    with own_master("bench"), tempfile.TemporaryDirectory() as folder:
        result = measure(options, Path(folder))
    report(result)
    if options.json:
        Path(options.json).write_text(json.dumps(result, indent=1) + "\n")
    if options.plot:
        from performance_plots import draw_node

        draw_node(result, options.plot)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
