"""Playback of a NAO bag to nodes at any speed, directly into the connections of rospy's publishers.

``Publisher.publish`` alone would cost more than the nodes at the higher speeds. Due messages are written to the
connections directly, framed as rospy frames them.
"""

import struct
import time
from bisect import bisect_right
from pathlib import Path
from typing import Any, Callable, Dict, List

TICK = 0.0005
"""Minimum sleep of the player in seconds, so that the nodes get the processor."""


class Player:
    """The messages of a bag, with their publishers.

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
