#!/usr/bin/env python3
"""Cost of predicates on arrays, from the bytes of a LaserScan to the result, beside numpy and beside lists.

    bench/arrays.py [--ranges N] [--repeats N] [--node SECONDS]

The messages are decoded for each call, as they are when they arrive. All cases run in turn; a figure is the median of
the repeats, in microseconds of CPU time, each repeat being the mean of several calls.

    decode          decoding of a scan that nobody looks into
    min             ``array_min/2`` of the ranges
    percentile      ``array_percentile/3``: the 5th percentile
    count           ``array_count/3``: ranges below a limit
    list min        ``min_list/2``, which uses the bytes as well
    walk min        ``min_list/2`` of the list that the ranges stand for
    walk percentile ``msort/2`` and ``nth0/3`` of that list
    numpy ...       the same by numpy, by somebody who knows the layout of the message
    window          a window that averages the ranges of 10 scans
    rules           three rules about each scan, over the same scan without a rule: the share of a core that 40 scans
                    a second take

``--node`` also measures the node on a master of its own: CPU of a rospy subscriber that does nothing, and of the node
with three rules, both with 40 scans a second. It needs ROS and the built package (``source devel/setup.bash``).
"""

import argparse
import statistics
import struct
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Callable, Dict, List

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "src"), str(HERE.parent / "test" / "ros1")]

import numpy as np  # noqa: E402
from arguments import above_zero, positive  # noqa: E402

from retalis import Definitions, Engine, Term, Var, deref, functor, limit_gc_pauses  # noqa: E402
from retalis.prolog.system.prolog_system import PrologSystem  # noqa: E402
from retalis.prolog.terms.list_terms import make_list  # noqa: E402

TYPE = "sensor_msgs/LaserScan"
TEXT = """\
std_msgs/Header header
float32 angle_min
float32 angle_max
float32 angle_increment
float32 time_increment
float32 scan_time
float32 range_min
float32 range_max
float32[] ranges
float32[] intensities
================================================================================
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
"""
RANGES = 9
"""Position of the ranges in the term."""

SCANS_PER_SECOND = 40
BATCH = 20
PATTERN = "sensor_msgs__0__LaserScan(_, _, _, _, _, _, _, _, Ranges, _)"
RULES = f"""
close(Nearest) <- {PATTERN} where (array_min(Ranges, Nearest), Nearest < 0.05).
crowded(Count) <- {PATTERN} where (array_count(Ranges, <(0.1), Count), Count > 100).
near(P) <- {PATTERN} where (array_percentile(Ranges, 5, P), P < 0.05).
"""
WINDOW = f"mean(M) <- aggregate(avg(Ranges), {PATTERN}, M, last(10, events)).\n"


def scan(count: int) -> bytes:
    """Return the message of a scan."""
    ranges = np.random.RandomState(1).uniform(0.1, 30, count).astype("<f4")
    head = struct.pack("<IIII5s7f", 1, 100, 0, 5, b"laser", *range(7))
    return head + struct.pack("<I", count) + ranges.tobytes() + struct.pack("<I", 0)


def cases(count: int) -> Dict[str, Callable[[], object]]:
    """Return the functions to measure, by name."""
    logic, definitions = PrologSystem(), Definitions()
    decode = definitions.decoder(definitions.add(TYPE, TEXT)).decode
    data = scan(count)

    def goal(
        name: str, *inputs: Any, read: Callable[[Term], Term] = lambda term: term
    ) -> Callable[[], object]:
        """Return a function that calls a predicate with the ranges of a message, and returns its last argument."""
        result, ranges = Var(), Var()
        call = logic.compile_goal(
            (functor(name, len(inputs) + 2), ranges, *inputs, result), [ranges], [result]
        )

        def run() -> object:
            term: Any = decode(data)
            (found,) = call.first_solution((read(term[RANGES]),)) or (None,)
            return found

        return run

    def as_list(term: Term) -> Term:
        return make_list(np.frombuffer(data, "<f4", count, 53).tolist())

    sort = goal("msort", read=as_list)

    def walk_percentile() -> object:
        item: Any = deref(sort())
        for _ in range(count // 20):
            item = item[2]
        return item[1]

    return {
        "decode": lambda: decode(data),
        "min": goal("array_min"),
        "percentile": goal("array_percentile", 5),
        "count": goal("array_count", (functor("<", 1), 0.5)),
        "list min": goal("min_list"),
        "walk min": goal("min_list", read=as_list),
        "walk percentile": walk_percentile,
        "numpy min": lambda: float(ranges_of(data).min()),
        "numpy percentile": lambda: float(np.percentile(ranges_of(data), 5)),
        "numpy count": lambda: int((ranges_of(data) < 0.5).sum()),
        "window": engine_with(WINDOW, data),
        "rules": engine_with(RULES, data),
        "no rules": engine_with("", data),
    }


def ranges_of(data: bytes) -> Any:
    """Return the ranges of a message."""
    (count,) = struct.unpack_from("<I", data, 49)
    return np.frombuffer(data, "<f4", count, 53)


def engine_with(rules: str, data: bytes) -> Callable[[], object]:
    """Return a function that gives a scan to an engine with some rules."""
    engine, definitions = Engine(), Definitions()
    engine.load(rules=rules)
    decoder = definitions.decoder(definitions.add(TYPE, TEXT))
    instant = [0]

    def take() -> None:
        instant[0] += 25_000_000
        engine.post(decoder.decode(data), instant[0])

    return take


def measure(options: argparse.Namespace) -> None:
    """Print a line for each case, and the share of a core of the rules."""
    found = cases(options.ranges)
    assert found["min"]() == found["list min"]() == found["walk min"]() == found["numpy min"]()
    assert found["count"]() == found["numpy count"]()
    limit_gc_pauses()
    taken: Dict[str, List[float]] = {name: [] for name in found}
    for _ in range(options.repeats):
        for name, run in found.items():
            began = time.process_time()
            for _ in range(BATCH):
                run()
            taken[name].append((time.process_time() - began) / BATCH * 1e6)
    medians = {name: statistics.median(times) for name, times in taken.items()}
    for name, microseconds in medians.items():
        print(f"{name:<17} {microseconds:8.2f} us, at best {min(taken[name]):.2f}")
    share = SCANS_PER_SECOND * (medians["rules"] - medians["no rules"]) / 1e4
    print(f"three rules about {SCANS_PER_SECOND} scans a second: {share:.3f} % of a core")


IDLE = """
import rospy
rospy.init_node("idle")
rospy.Subscriber("scan", rospy.AnyMsg, lambda message: None, queue_size=1000)
rospy.spin()
"""
NODE = [
    "roslaunch",
    "retalis",
    "retalis.launch",
    "use_sim_time:=false",
    "direct:=[scan, sensor_msgs/LaserScan]",
]


def measure_node(seconds: float, count: int) -> None:
    """Print the CPU of an idle subscriber, and of the node, with scans on a topic."""
    from processes import own_master

    with own_master("bench"), tempfile.TemporaryDirectory() as folder:
        program = Path(folder)
        (program / "eventRules.txt").write_text(RULES)
        (program / "goalPredicates.txt").write_text("")
        (program / "pub_sub.xml").write_text("<retalis></retalis>\n")
        ways = {
            "idle": [sys.executable, "-c", IDLE],
            "node": [*NODE, f"program:={program}"],
            "embedded": [*NODE, f"program:={program}", "embedded:=true"],
        }
        for name, command in ways.items():
            percent = cpu_of(command, "/idle" if name == "idle" else "/retalis", seconds, scan(count))
            print(f"{name:<9} {percent:.2f} % of a core with {SCANS_PER_SECOND} scans a second")


def cpu_of(command: List[str], node: str, seconds: float, data: bytes) -> float:
    """Return the percentage of a core that a node takes while scans are published."""
    import rosnode
    from harness import DEFINITIONS, RawPublisher, wait_until
    from live_node import slave
    from processes import Started, cpu

    started = Started()
    publisher = RawPublisher("scan", DEFINITIONS.add(TYPE, TEXT))
    try:
        started(command)
        wait_until(publisher.connected, "a subscriber", pause=0.1)
        wait_until(lambda: node in rosnode.get_node_names(), "the node", pause=0.5)
        pid = slave(node).getPid("/bench")[2]
        # The first seconds load modules.
        send(publisher, data, 3)
        before, began = cpu(pid), time.monotonic()
        send(publisher, data, seconds)
        return 100 * (cpu(pid) - before) / (time.monotonic() - began)
    finally:
        publisher.publisher.unregister()
        started.end()


def send(publisher: Any, data: bytes, seconds: float) -> None:
    """Publish scans for some time."""
    began, number = time.monotonic(), 0
    while number < seconds * SCANS_PER_SECOND:
        number += 1
        # A new stamp: the node would take an equal one for a repeated message.
        now = time.time_ns()
        publisher.publish(struct.pack("<III", number, *divmod(now, 10**9)) + data[12:])
        time.sleep(max(0.0, began + number / SCANS_PER_SECOND - time.monotonic()))


def main() -> int:
    """Run the benchmark that the command line selects."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--ranges", type=positive, default=1080, help="of each scan")
    parser.add_argument("--repeats", type=positive, default=200)
    parser.add_argument("--node", type=above_zero, metavar="SECONDS", help="measure the node for so long")
    options = parser.parse_args()
    if options.node:
        measure_node(options.node, options.ranges)
    else:
        measure(options)
    return 0


if __name__ == "__main__":
    sys.exit(main())
