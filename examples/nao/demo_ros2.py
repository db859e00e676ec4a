#!/usr/bin/env python3
"""Run the NAO example on ROS 2: write a bag, play it to node retalis, and print the positions of the markers.

This process publishes the transforms of the bag on /tf, and its time on /clock. The types of markers and faces have
no package of ROS 2, so their messages are published as text, on the topic of events. Requires a shell in which the
package's setup.bash is sourced, as ``./install.py demo --ros2`` does.
"""

import argparse
import os
import shutil
import signal
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Dict, Iterator, NamedTuple, Optional, Sequence
from xml.etree import ElementTree

import demo
import rclpy
from ament_index_python import get_package_prefix
from geometry_msgs.msg import PoseStamped, TransformStamped
from make_bag import make_bag
from rclpy.node import Node
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from retalis import BagReader, Decoder, Definitions, Engine

EXAMPLE = Path(__file__).resolve().parent
PROGRAM = EXAMPLE.parent.parent / "application_source"
TF, TF_TYPE = "/tf", "tf/msg/tfMessage"
EVENTS = "retalisInputEvents"
QUEUE = 10_000  # messages; on a busy machine the node reads seconds later
LAST_SECONDS = 20.0  # maximum time without a pose, while poses are missing


class Message(NamedTuple):
    """A message of the bag: time in nanoseconds, and a message of ROS 2."""

    time: int
    topic: str
    message: Any


def find_node() -> Path:
    """Return the installed program of node retalis."""
    return Path(get_package_prefix("retalis"), "lib", "retalis", "retalis_node")


def copy_program(folder: Path) -> Path:
    """Copy the program without the topics whose types ROS 2 lacks; return the copy."""
    program = Path(shutil.copytree(PROGRAM, folder / "program"))
    topics = ElementTree.parse(PROGRAM / "pub_sub.xml")
    for element in topics.getroot().findall("subscribe_to"):
        if element.get("name") != "tf":
            topics.getroot().remove(element)
    topics.write(program / "pub_sub.xml")
    return program


def read_messages(bag: Path) -> Iterator[Message]:
    """Yield the messages of a bag in the order of their receipt."""
    store = get_typestore(Stores.ROS1_NOETIC)
    engine, definitions = Engine(), Definitions()
    decoders: Dict[str, Decoder] = {}
    with BagReader(bag) as reader:
        for record in reader.records():
            topic = record.topic
            if topic.name == TF:
                if TF_TYPE not in store.fielddefs:
                    store.register(get_types_from_msg(topic.definition, TF_TYPE))
                yield Message(record.time, TF, convert_transforms(store, record.data))
                continue
            if topic.name not in decoders:
                decoders[topic.name] = definitions.decoder(definitions.add(topic.type, topic.definition))
            text = engine.show(decoders[topic.name].decode(record.data))
            yield Message(record.time, EVENTS, String(data=f"event({text})"))


def convert_transforms(store: Any, data: bytes) -> TFMessage:
    """Return a message of transforms of ROS 1 as one of ROS 2, whose headers have no number."""
    converted = TFMessage()
    for source in store.deserialize_ros1(data, TF_TYPE).transforms:
        target = TransformStamped(child_frame_id=source.child_frame_id)
        target.header.frame_id = source.header.frame_id
        target.header.stamp.sec = int(source.header.stamp.sec)
        target.header.stamp.nanosec = int(source.header.stamp.nanosec)
        for part, axes in (("translation", "xyz"), ("rotation", "xyzw")):
            values = getattr(source.transform, part)
            for axis in axes:
                setattr(getattr(target.transform, part), axis, float(getattr(values, axis)))
        converted.transforms.append(target)
    return converted


def play(messages: Sequence[Message], rate: float, expected: int, node: Node, alive: Any) -> demo.Poses:
    """Publish the messages and their times, and return the poses that node retalis publishes.

    Raises:
        DemoError: if node retalis ends, or does not start.
    """
    poses = demo.Poses()
    for topic in demo.TOPICS:
        node.create_subscription(PoseStamped, topic, poses.add, QUEUE)
    clock = node.create_publisher(Clock, "/clock", 10)
    publishers = {
        TF: node.create_publisher(TFMessage, TF, QUEUE),
        EVENTS: node.create_publisher(String, EVENTS, QUEUE),
    }

    def spin_until(condition: Any) -> None:
        while not condition():
            rclpy.spin_once(node, timeout_sec=0.01)
            if alive.poll() is not None:
                raise demo.DemoError("node retalis ended")

    def is_connected() -> bool:
        if time.monotonic() > end:
            raise demo.DemoError("node retalis did not start")
        read = all(publisher.get_subscription_count() for publisher in (clock, *publishers.values()))
        return read and all(node.count_publishers(topic) for topic in demo.TOPICS)

    end = time.monotonic() + demo.START_SECONDS
    spin_until(is_connected)
    progress = demo.Progress()
    begin, first, length = time.monotonic(), messages[0].time, messages[-1].time - messages[0].time
    try:
        for message in messages:
            delay = (message.time - first) / 1e9 / rate
            spin_until(lambda: time.monotonic() - begin >= delay)  # noqa: B023 - called in this iteration
            sec, nanosec = divmod(message.time, 10**9)
            now = Clock()
            now.clock.sec, now.clock.nanosec = sec, nanosec
            clock.publish(now)
            publishers[message.topic].publish(message.message)
            share = (message.time - first) / max(length, 1)
            progress.show(share, f"{poses.count} poses of {len(poses.located)} markers")
        poses.latest = time.monotonic()
        spin_until(
            lambda: (
                time.monotonic() - poses.latest
                > (demo.QUIET_SECONDS if poses.count >= expected else LAST_SECONDS)
            )
        )
    finally:
        progress.close()
    return poses


def parse_arguments(argv: Optional[Sequence[str]]) -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(prog="demo --ros2", description=__doc__.split("\n\n")[0])
    demo.add_bag_arguments(parser)
    return parser.parse_args(argv)


def main(argv: Optional[Sequence[str]] = None) -> int:
    """Run the demonstration; return 0 if all markers were located."""
    options = parse_arguments(argv)
    logs = Path(tempfile.mkdtemp(prefix="retalis-demo-"))
    bag = logs / "nao.bag"
    os.environ.setdefault("ROS_DOMAIN_ID", str(os.getpid() % 100 + 1))
    processes = demo.Processes(logs, dict(os.environ))
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a calling script may ignore the signal
    try:
        print(f"Making {options.seconds:g} s of a simulated NAO: {bag}", flush=True)
        truth = make_bag(bag, options.seconds, options.seed)
        messages = list(read_messages(bag))
        print("Playing it to node retalis on ROS 2", flush=True)
        parameters = ("-p", f"program:={copy_program(logs)}", "-p", "use_sim_time:=true")
        retalis = processes.start("retalis", str(find_node()), "--ros-args", *parameters)
        rclpy.init()
        node = rclpy.create_node("nao_demo")
        poses = play(messages, options.rate, len(truth.complete), node, retalis)
    except demo.DemoError as error:
        print(f"demo: {error}; the logs are in {logs}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("\ndemo: interrupted", file=sys.stderr)
        return 130
    finally:
        processes.close()
        rclpy.try_shutdown()
    located = demo.report(poses, bag, list(truth.markers))
    if located:
        shutil.rmtree(logs)
    else:
        print(f"demo: not all markers were located; the logs are in {logs}", file=sys.stderr)
    return 0 if located else 1


if __name__ == "__main__":
    sys.exit(main())
