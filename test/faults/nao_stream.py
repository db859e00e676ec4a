"""Endless messages of the NAO: a bag that is repeated with later stamps, and images."""

import struct
import threading
import time
from collections import Counter
from typing import Any, Dict, Tuple

import rospy
from geometry_msgs.msg import PoseStamped
from harness import DEFINITIONS, RawPublisher
from make_bag import START, make_bag

from retalis import BagReader, Playback

BAG_SECONDS = 20
"""Length of the bag."""

MIN_PAUSE_SECONDS = 0.002

MAX_QUEUE_SECONDS = 15.0
"""Maximum time of messages in queues and connections; later drops do not excuse a missing pose."""

CONNECTION_CHECK_SECONDS = 0.2
"""Time between two checks of the connections."""


class Stream:
    """Sent messages and received poses.

    Attributes:
        step: seconds added to the stamps with each repetition of the bag.
        stamp: stamp that is sent now, in seconds since the start.
        through: newest stamp of a received pose, but at most `MAX_QUEUE_SECONDS` before `stamp`.
        late: maximum delay of a sent message in seconds; a slow node blocks its senders.
        turns: number of repetitions of the bag.
        poses: received poses by marker and stamp of the stream.
        times: number of times that each pose is received.
    """

    step = BAG_SECONDS + 2

    def __init__(self, path: Any, speed: Any, rate: Any, size: Any) -> None:
        self.truth = make_bag(path, seconds=BAG_SECONDS, seed=1)
        self._speed, self._rate = speed, rate
        self.sent = self.images = self.received = 0
        self.stamp = 0.0
        self.ended = False
        self.late = self._newest = 0.0
        self.turns = 0
        self.poses: Dict[Any, Any] = {}
        self.times: Counter[Any] = Counter()
        self._lock = threading.Lock()
        self._publishers: Dict[Any, Any] = {}
        self._links: Dict[Any, Any] = {}
        with BagReader(path) as bag:
            records = list(bag.records())
            self._records = [
                (record.topic.name, (record.time - bag.start) / 1e9, *_framed(record.data))
                for record in records
            ]
            for topic in bag.topics:
                definition = DEFINITIONS.add(topic.type, topic.definition)
                self._publishers[topic.name] = RawPublisher(topic.name, definition)
        width, height = map(int, size.split("x"))
        self._publishers["camera"] = RawPublisher("camera", DEFINITIONS.find("sensor_msgs/Image"))
        self._image = _image(width, height)
        for number in range(1, 9):
            rospy.Subscriber(f"marker{number}", PoseStamped, self._take, queue_size=10_000)

    def is_connected(self) -> bool:
        return all(publisher.is_connected() for publisher in self._publishers.values())

    def _connect(self) -> None:
        """Update the sockets of the connections."""
        self._links = {
            topic: [
                getattr(link, "_connection", link).socket for link in publisher.publisher.impl.connections
            ]
            for topic, publisher in self._publishers.items()
        }

    def run(self) -> None:
        """Send until ``ended`` is set."""
        began, connected = time.monotonic(), 0.0
        while not self.ended:
            for topic, second, frame, positions in self._records:
                if time.monotonic() > connected + CONNECTION_CHECK_SECONDS:
                    connected = time.monotonic()
                    self._connect()
                self.stamp = self.turns * self.step + second
                while (wait := began + self.stamp / self._speed - time.monotonic()) > 0:
                    time.sleep(max(wait, MIN_PAUSE_SECONDS))
                self.late = max(self.late, -wait)
                self._send(topic, _with_later_stamps(frame, positions, self.turns * self.step))
                self.sent += 1
                if self.images < (time.monotonic() - began) * self._rate:
                    self.images += 1
                    self._send("camera", self._image)
            self.turns += 1

    def _send(self, topic: str, frame: Any) -> None:
        for link in self._links[topic]:
            try:
                link.sendall(frame)
            except (OSError, AttributeError):  # the node has ended; the evaluation knows the time
                pass

    def _take(self, message: Any) -> None:
        stamp = message.header.stamp.to_nsec()
        key = message.header.frame_id, stamp
        self.poses[key] = numbers(message.pose)
        self.times[key] += 1
        self.received += 1
        self._newest = max(self._newest, (stamp - self.truth.start) / 1e9)

    @property
    def behind(self) -> Any:
        """Delay of the newest pose in seconds."""
        return max(0.0, self.stamp - self._newest) / self._speed

    @property
    def through(self) -> Any:
        return max(self._newest, self.stamp - MAX_QUEUE_SECONDS * self._speed)


def reference(path: Any, program: Any) -> Any:
    """Return the poses of an offline playback, by marker and stamp."""

    def fail(error: Any) -> None:
        raise error

    poses: Dict[Any, Any] = {}
    with BagReader(path) as bag:
        for output in Playback(program, report=fail).run(bag):
            if output.topic.startswith("marker"):
                message = PoseStamped().deserialize(output.data)
                poses[message.header.frame_id, message.header.stamp.to_nsec()] = numbers(message.pose)
    return poses


def numbers(pose: Any) -> Tuple[Any, ...]:
    position, rotation = pose.position, pose.orientation
    return position.x, position.y, position.z, rotation.x, rotation.y, rotation.z, rotation.w


def _framed(data: Any) -> Tuple[Any, ...]:
    """Return a message as on the wire, and the positions of its stamps, found by the seconds of this bag."""
    frame = struct.pack("<I", len(data)) + data
    last = START + BAG_SECONDS + 1
    positions = [
        position for position in range(4, len(frame) - 7) if START - 1 <= _seconds(frame, position) <= last
    ]
    return frame, positions


def _seconds(frame: Any, position: Any) -> Any:
    return struct.unpack_from("<I", frame, position)[0]


def _with_later_stamps(frame: Any, positions: Any, seconds: Any) -> Any:
    changed = bytearray(frame)
    for position in positions:
        struct.pack_into("<I", changed, position, _seconds(frame, position) + seconds)
    return changed


def _image(width: Any, height: Any) -> Any:
    body = struct.pack("<III", 0, START, 0) + _text("camera")
    body += struct.pack("<II", height, width) + _text("rgb8") + struct.pack("<BI", 0, 3 * width)
    body += struct.pack("<I", 3 * width * height) + bytes(3 * width * height)
    return struct.pack("<I", len(body)) + body


def _text(text: str) -> bytes:
    return struct.pack("<I", len(text)) + text.encode()
