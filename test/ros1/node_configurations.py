#!/usr/bin/env python3
"""Playback of ten bags to nodes, each twice: the outputs are those of the engine without ROS, in the same order."""

import sys
import tempfile
import time
import unittest
from pathlib import Path

import rospy
import rostest
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Empty, String

sys.path.append(str(Path(__file__).resolve().parent))
from configuration_bags import BAGS, KINDS, write_bag  # noqa: E402
from harness import Collector, RawPublisher, wait_until  # noqa: E402

from retalis import BagReader, Playback, atom, functor  # noqa: E402
from retalis.prolog.syntax.event_text import to_text  # noqa: E402
from retalis.prolog.terms.timestamps import datime  # noqa: E402

PROGRAM = Path(__file__).resolve().parent / "node_configurations"
OUTPUT = functor("event", 3)
PUBLISHED = {"copies": "c", "greens": "g"}
"""Topics that are published, each with the id of its subscription."""


def second_of(instant):
    """Return how datimes of the second of an instant begin."""
    return to_text(datime(instant // 10**9 * 10**9))[: -len("0)")]


class NodeConfigurations(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.clock = rospy.Publisher("/clock", Clock, queue_size=100)
        cls.events = rospy.Publisher("retalisInputEvents", String, queue_size=100)
        cls.outputs = Collector("retalisOutputEvents", String)
        cls.probes = rospy.Publisher("probes", Empty, queue_size=100)
        cls.publishers = {topic: RawPublisher(topic, kind) for topic, kind in KINDS.items()}
        wait_until(lambda: all(one.is_connected() for one in cls.publishers.values()), "the subscribers")
        wait_until(lambda: cls.probes.get_num_connections() > 0, "the subscriber of the probes")
        wait_until(
            lambda: cls.events.get_num_connections() > 0 and cls.outputs.is_connected(), "node retalis"
        )
        cls.published = {topic: Collector(topic, rospy.AnyMsg) for topic in PUBLISHED}
        for one in cls.published.values():
            wait_until(one.is_connected, "the publisher of messages whose type is learned")

    def test_ten_bags(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        offline = Playback(PROGRAM, report=self.fail)
        texts = []
        greens = 0
        offline.engine.on_output(
            lambda term, topic, name: texts.append(to_text((OUTPUT, term, atom(topic), name)))
        )
        for number, kind in enumerate(BAGS):
            path = write_bag(Path(folder.name) / f"{number}.bag", number, kind)
            for turn in range(2):
                with BagReader(path) as bag, self.subTest(bag=kind.name, turn=turn):
                    texts.clear()
                    messages = [(one.topic, one.data) for one in offline.run(bag)]
                    found, published = self.play(bag, f"{number}/{turn}")
                    self.assertEqual(found, texts)
                    for topic in PUBLISHED:
                        expected = [data for name, data in messages if name == topic]
                        self.assertEqual(published[topic], expected, topic)
                    self.assertGreater(len(texts), bag.messages)
                    greens += len(published["greens"])
        self.assertGreater(greens, 0)

    def play(self, bag, name):
        """Publish a bag's messages one after the other; return the outputs as texts, and bytes by topic."""
        self.set_clock(bag.start)
        outputs = len(self.outputs.messages)
        before = {topic: len(one.messages) for topic, one in self.published.items()}
        now = bag.start
        for number, record in enumerate(bag.records(), 1):
            if record.time != now:
                now = record.time
                self.clock.publish(Clock(rospy.Time(*divmod(now, 10**9))))
            self.publishers[record.topic.name.strip("/")].publish(record.data)
            self.outputs.wait_for(
                lambda all_, number=number: self.seen(all_[outputs:]) >= number, "an output"
            )
        self.events.publish(f"event(done('{name}'))")
        done = f"event(done('{name}'),done,d)"
        self.outputs.wait_for(lambda messages: messages[-1].data == done, done)
        found = [one.data for one in self.outputs.messages[outputs:-1]]
        published = {}
        for topic, collector in self.published.items():
            first = before[topic]
            wanted = sum(one.endswith(f",{topic},{PUBLISHED[topic]})") for one in found)
            collector.wait_for(
                lambda messages, first=first, wanted=wanted: len(messages) - first >= wanted, topic
            )
            published[topic] = [one._buff for one in collector.messages[first:]]
        return found, published

    @staticmethod
    def seen(messages):
        return sum(",seen," in one.data[-12:] for one in messages)

    def set_clock(self, instant):
        """Set the time and wait until it has come to whoever stamps messages, and to the engine."""
        self.clock.publish(Clock(rospy.Time(*divmod(instant, 10**9))))
        begin = second_of(instant)
        wanted = f"event(times({begin}"

        def there():
            count = len(self.outputs.messages)
            self.probes.publish()
            self.events.publish("event(tick)")
            self.events.publish("event(ask)")
            time.sleep(0.02)
            return any(
                one.data.startswith(wanted) and one.data.count(begin) == 2
                for one in self.outputs.messages[count:]
            )

        wait_until(there, f"the time {begin}")
        self.events.publish(f"event(done(clock{instant}))")
        done = f"event(done(clock{instant}),done,d)"
        self.outputs.wait_for(lambda messages: messages[-1].data == done, done)


if __name__ == "__main__":
    rospy.init_node("node_configurations")
    rostest.rosrun("retalis", "node_configurations", NodeConfigurations)
