"""The NAO's messages without an end: a bag again and again, its stamps moved on each time; images beside it."""

import struct
import threading
import time
from collections import Counter

import rospy
from geometry_msgs.msg import PoseStamped
from harness import DEFINITIONS, RawPublisher
from make_bag import START, make_bag

from retalis import BagReader, Playback

SECONDS = 20
"""Length of the bag."""

TICK = 0.002

HELD = 15.0
"""Seconds that messages wait in queues and connections at most; what is dropped later has no excuse."""

RECONNECT = 0.2
"""Seconds from one look to the next who is connected."""


class Stream:
    """What is sent, and the poses that come back.

    Attributes:
        step: seconds by which the stamps move on each time the bag is sent.
        stamp: seconds since the beginning, in the stamps of what is sent now.
        through: the newest stamp of a pose that came, but at most `HELD` seconds' worth before what is sent now.
        late: by how many seconds it was sent too late at most: a node that does not keep up holds up who sends to it.
        turns: how often the bag has been sent.
        poses: how often each came, by marker and stamp (of the whole stream), and what it was.
    """

    step = SECONDS + 2

    def __init__(self, path, speed, rate, size):
        self.truth = make_bag(path, seconds=SECONDS, seed=1)
        self._speed, self._rate = speed, rate
        self.sent = self.images = self.received = 0
        self.stamp = 0.0
        self.ended = False
        self.late = self._newest = 0.0
        self.turns = 0
        self.poses = {}
        self.times = Counter()
        self._lock = threading.Lock()
        self._publishers, self._links = {}, {}
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

    def is_connected(self):
        return all(one.is_connected() for one in self._publishers.values())

    def _connect(self):
        """Look anew who is connected."""
        self._links = {
            topic: [getattr(one, "_connection", one).socket for one in publisher.publisher.impl.connections]
            for topic, publisher in self._publishers.items()
        }

    def run(self):
        """Send until ``ended`` is set."""
        began, connected = time.monotonic(), 0.0
        while not self.ended:
            for topic, at, frame, places in self._records:
                if time.monotonic() > connected + RECONNECT:
                    connected = time.monotonic()
                    self._connect()
                self.stamp = self.turns * self.step + at
                while (wait := began + self.stamp / self._speed - time.monotonic()) > 0:
                    time.sleep(max(wait, TICK))
                self.late = max(self.late, -wait)
                self._send(topic, _moved(frame, places, self.turns * self.step))
                self.sent += 1
                if self.images < (time.monotonic() - began) * self._rate:
                    self.images += 1
                    self._send("camera", self._image)
            self.turns += 1

    def _send(self, topic, frame):
        for link in self._links[topic]:
            try:
                link.sendall(frame)
            except (OSError, AttributeError):  # the node has just been ended; the verdict knows when
                pass

    def _take(self, message):
        stamp = message.header.stamp.to_nsec()
        key = message.header.frame_id, stamp
        self.poses[key] = numbers(message.pose)
        self.times[key] += 1
        self.received += 1
        self._newest = max(self._newest, (stamp - self.truth.start) / 1e9)

    @property
    def behind(self):
        """By how many seconds the newest pose is behind what is sent."""
        return max(0.0, self.stamp - self._newest) / self._speed

    @property
    def through(self):
        return max(self._newest, self.stamp - HELD * self._speed)


def reference(path, program):
    """Return the poses that the engine gives offline, by marker and stamp."""

    def fail(error):
        raise error

    found = {}
    with BagReader(path) as bag:
        for output in Playback(program, report=fail).run(bag):
            if output.topic.startswith("marker"):
                message = PoseStamped().deserialize(output.data)
                found[message.header.frame_id, message.header.stamp.to_nsec()] = numbers(message.pose)
    return found


def numbers(pose):
    place, turn = pose.position, pose.orientation
    return place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w


def _framed(data):
    """Return a message as on the wire, and where stamps are in it: the seconds of this bag are found nowhere else."""
    frame = struct.pack("<I", len(data)) + data
    last = START + SECONDS + 1
    places = [at for at in range(4, len(frame) - 7) if START - 1 <= _seconds(frame, at) <= last]
    return frame, places


def _seconds(frame, at):
    return struct.unpack_from("<I", frame, at)[0]


def _moved(frame, places, seconds):
    moved = bytearray(frame)
    for at in places:
        struct.pack_into("<I", moved, at, _seconds(frame, at) + seconds)
    return moved


def _image(width, height):
    body = struct.pack("<III", 0, START, 0) + _text("camera")
    body += struct.pack("<II", height, width) + _text("rgb8") + struct.pack("<BI", 0, 3 * width)
    body += struct.pack("<I", 3 * width * height) + bytes(3 * width * height)
    return struct.pack("<I", len(body)) + body


def _text(text):
    return struct.pack("<I", len(text)) + text.encode()
