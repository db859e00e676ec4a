#!/usr/bin/env python3
"""Run the NAO example on a separate ROS master: write a bag, play it, and print the positions of the markers.

Requires a shell in which the package's setup.bash is sourced, as ``./install.py demo`` does.
"""

import argparse
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import xmlrpc.client
from pathlib import Path
from typing import Any, Callable, Collection, Dict, FrozenSet, List, NamedTuple, Optional, Sequence, TextIO

import nao_truth

INPUTS = {
    "topics": ("direct:=false", "embedded:=false"),
    "direct": ("direct:=true", "embedded:=false"),
    "embedded": ("direct:=false", "embedded:=true"),
}
TOPICS = tuple(f"marker{number}" for number in range(1, 9))
START_SECONDS = 60.0  # maximum; the first start after an installation is slow
QUIET_SECONDS = 2.0  # time without a pose after which all poses have been received
CONNECT_SECONDS = 1.5  # for the bag's subscribers to connect before its first message


class DemoError(Exception):
    """Error that ends the demonstration; its text is one line for the user."""


class Processes:
    """Child processes, each with its output in a log; terminated in reverse order."""

    def __init__(self, logs: Path, environment: Dict[str, str]) -> None:
        self._logs = logs
        self._environment = environment
        self._started: List[subprocess.Popen[bytes]] = []

    def start(self, name: str, *command: str) -> "subprocess.Popen[bytes]":
        """Start a command in a separate session, so that ctrl-C reaches it only through `close`."""
        with (self._logs / f"{name}.log").open("wb") as log:
            process = subprocess.Popen(
                command,
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        self._started.append(process)
        return process

    def close(self) -> None:
        """Terminate the processes with increasingly strong signals."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        for process in reversed(self._started):
            for number, patience in ((signal.SIGINT, 15), (signal.SIGTERM, 5), (signal.SIGKILL, 5)):
                if process.poll() is not None:
                    break
                process.send_signal(number)
                try:
                    process.wait(patience)
                except subprocess.TimeoutExpired:
                    continue


class Progress:
    """Progress: a bar on a terminal, otherwise a line at each quarter."""

    def __init__(self, stream: TextIO = sys.stderr) -> None:
        self._stream = stream
        self._drawn = stream.isatty()
        self._quarter = 0

    def show(self, share: float, text: str) -> None:
        """Show the fraction of the bag that has been played."""
        share = min(1.0, max(0.0, share))
        if self._drawn:
            width = max(10, min(40, shutil.get_terminal_size().columns - 40))
            filled = round(share * width)
            bar = "#" * filled + "." * (width - filled)
            self._stream.write(f"\r[{bar}] {share:4.0%} {text}\x1b[K")
        elif int(share * 4) > self._quarter:
            self._quarter = int(share * 4)
            self._stream.write(f"{share:4.0%} {text}\n")
        self._stream.flush()

    def close(self) -> None:
        """End the line of the bar."""
        if self._drawn:
            self._stream.write("\n")


class Content(NamedTuple):
    """Content of a bag: start and end in seconds, and the names of the markers that the robot saw."""

    start: float
    end: float
    markers: FrozenSet[str]


class Poses:
    """Last position of each marker and the number of poses, from the topics that the nodes publish."""

    def __init__(self) -> None:
        self.located: Dict[str, Sequence[float]] = {}
        self.count = 0
        self.latest = time.monotonic()

    def add(self, message: Any) -> None:
        """Store a pose; called by threads of rospy."""
        place = message.pose.position
        self.located[message.header.frame_id.strip('"')] = (place.x, place.y, place.z)
        self.count += 1
        self.latest = time.monotonic()


def look_into(bag: Path) -> Content:
    """Return the content of a bag.

    Raises:
        DemoError: if the bag cannot be read, or has no marker.
    """
    import rosbag  # noqa: PLC0415 - needs ROS

    try:
        with rosbag.Bag(str(bag)) as opened:
            seen = opened.read_messages(topics=["/ar_pose_marker", "ar_pose_marker"])
            names = {
                marker.header.frame_id.strip('"') for _, message, _ in seen for marker in message.markers
            }
            start, end = opened.get_start_time(), opened.get_end_time()
    except (rosbag.ROSBagException, OSError) as error:
        raise DemoError(f"{bag} cannot be read: {error}") from None
    if not names:
        raise DemoError(f"{bag} has no markers on ar_pose_marker")
    return Content(start, end, frozenset(names))


def free_port() -> int:
    """Return a free port."""
    with socket.socket() as probe:
        probe.bind(("localhost", 0))
        return int(probe.getsockname()[1])


def wait_until(condition: Callable[[], bool], what: str, alive: Sequence["subprocess.Popen[bytes]"]) -> None:
    """Wait for a condition.

    Raises:
        DemoError: if it does not become true in time, or one of the processes ends.
    """
    end = time.monotonic() + START_SECONDS
    while not condition():
        if time.monotonic() > end or any(process.poll() is not None for process in alive):
            raise DemoError(f"{what} did not start")
        time.sleep(0.1)


class Master:
    """Queries to the ROS master."""

    def __init__(self, uri: str) -> None:
        self._proxy = xmlrpc.client.ServerProxy(uri)

    def answers(self) -> bool:
        """Return whether the master answers."""
        try:
            self._proxy.getUri("/nao_demo")
        except OSError:
            return False
        return True

    def ready(self) -> bool:
        """Return whether the nodes subscribe to the robot's topics and publish all markers."""
        publications, subscriptions, _ = self._proxy.getSystemState("/nao_demo")[2]  # type: ignore[index, misc]
        published, subscribed = ({name for name, _ in found} for found in (publications, subscriptions))
        return {"/tf", "/ar_pose_marker"} <= subscribed and {"/" + name for name in TOPICS} <= published


def start_nodes(options: argparse.Namespace, processes: Processes, uri: str) -> "subprocess.Popen[bytes]":
    """Start a master and the nodes; return the nodes' process when they are ready.

    Raises:
        DemoError: Something did not start.
    """
    core = processes.start("roscore", "roscore", "-p", uri.rsplit(":", 1)[1])
    master = Master(uri)
    wait_until(master.answers, "the master", [core])
    nodes = processes.start("nodes", "roslaunch", "retalis", "nao.launch", *INPUTS[options.input])
    wait_until(master.ready, "the nodes", [core, nodes])
    return nodes


def play(
    bag: Path, content: Content, rate: float, processes: Processes, nodes: "subprocess.Popen[bytes]"
) -> Poses:
    """Play the bag and return what the nodes published.

    Raises:
        DemoError: The nodes or the player failed.
    """
    import rospy  # noqa: PLC0415 - needs ROS
    from geometry_msgs.msg import PoseStamped  # noqa: PLC0415 - needs ROS

    rospy.init_node("nao_demo", disable_signals=True)
    poses = Poses()
    for topic in TOPICS:
        rospy.Subscriber(topic, PoseStamped, poses.add)
    # The default queue of 100 messages drops /tf on a busy machine.
    options = ("--clock", "--quiet", "--queue=100000", f"--delay={CONNECT_SECONDS}", f"--rate={rate}")
    player = processes.start("rosbag", "rosbag", "play", *options, str(bag))
    progress = Progress()
    try:
        while player.poll() is None or time.monotonic() - poses.latest < QUIET_SECONDS:
            now = rospy.get_time()
            played = (now - content.start) / max(content.end - content.start, 1e-9) if now else 0.0
            progress.show(played, f"{poses.count} poses of {len(poses.located)} markers")
            if nodes.poll() is not None:
                raise DemoError("the nodes ended while the bag was played")
            time.sleep(0.2)
    finally:
        progress.close()
        rospy.signal_shutdown("the bag has been played")
    if player.returncode:
        raise DemoError(f"rosbag play ended with exit status {player.returncode}")
    return poses


def report(poses: Poses, bag: Path, seen: Collection[str]) -> bool:
    """Print the position of each marker, with the truth if it is known; return whether all were located."""
    try:
        truth = nao_truth.load(bag)
    except FileNotFoundError:
        for name in sorted(seen):
            place = poses.located.get(name)
            shown = " ".join(f"{value:8.3f}" for value in place) if place else "not located"
            print(f"{name:<8} {shown}")
        found = len(set(seen) & set(poses.located))
        print(
            f"{found} of {len(seen)} markers located by {poses.count} poses; the true positions are not known"
        )
        return found == len(seen)
    comparisons = nao_truth.compare(truth, poses.located)
    good = sum(comparison.good for comparison in comparisons)
    print(nao_truth.table(comparisons))
    print(
        f"{good} of {len(comparisons)} markers located within {nao_truth.TOLERANCE * 100:g} cm; "
        f"{poses.count} poses from {len(truth.complete)} observations"
    )
    return good == len(comparisons)


def positive_number(text: str) -> float:
    """Return the number in a command-line argument.

    Raises:
        argparse.ArgumentTypeError: if it is not positive.
    """
    try:
        number = float(text)
    except ValueError:
        number = 0.0
    if not 0 < number < float("inf"):
        raise argparse.ArgumentTypeError(f"expected a positive number, found '{text}'")
    return number


def add_bag_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments for the simulated bag and its speed."""
    parser.add_argument(
        "--seconds", type=positive_number, default=20.0, help="length of the simulated bag (default 20)"
    )
    parser.add_argument("--seed", type=int, default=1, help="another seed gives another run (default 1)")
    parser.add_argument("--rate", type=positive_number, default=1.0, help="speed of the bag (default 1)")


def arguments(argv: Optional[Sequence[str]]) -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(prog="demo", description=__doc__.split("\n\n")[0])
    parser.add_argument("--bag", type=Path, metavar="FILE", help="play this bag instead of a simulated one")
    add_bag_arguments(parser)
    parser.add_argument(
        "--input", choices=sorted(INPUTS), default="topics",
        help="way in: direct (node retalis subscribes), embedded (one node), or as text between the nodes (default)",
    )  # fmt: skip
    options = parser.parse_args(argv)
    if options.bag and not options.bag.is_file():
        parser.error(f"no such file: {options.bag}")
    return options


def main(argv: Optional[Sequence[str]] = None) -> int:
    """Run the demonstration; return 0 if all markers were located."""
    options = arguments(argv)
    logs = Path(tempfile.mkdtemp(prefix="retalis-demo-"))
    uri = f"http://localhost:{free_port()}"
    os.environ.update(ROS_MASTER_URI=uri, ROS_HOSTNAME="localhost", ROS_LOG_DIR=str(logs))
    processes = Processes(logs, dict(os.environ))
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a calling script may ignore the signal
    bag = options.bag
    try:
        if not bag:
            from make_bag import make_bag  # noqa: PLC0415 - needs rosbags

            bag = logs / "nao.bag"
            print(f"Making {options.seconds:g} s of a simulated NAO: {bag}", flush=True)
            make_bag(bag, options.seconds, options.seed)
        content = look_into(bag)
        print(f"Playing it to the nodes of nao.launch, input: {options.input}", flush=True)
        nodes = start_nodes(options, processes, uri)
        poses = play(bag, content, options.rate, processes, nodes)
    except DemoError as error:
        print(f"demo: {error}; the logs are in {logs}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("\ndemo: interrupted", file=sys.stderr)
        return 130
    finally:
        processes.close()
    located = report(poses, bag, content.markers)
    if located:
        shutil.rmtree(logs)
    else:
        print(f"demo: not all markers were located; the logs are in {logs}", file=sys.stderr)
    return 0 if located else 1


if __name__ == "__main__":
    sys.exit(main())
