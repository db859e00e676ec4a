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
from configuration_bags import BAGS, DEFINITIONS_BY_TOPIC, write_bag  # noqa: E402
from harness import Collector, RawPublisher, wait_until  # noqa: E402

from retalis import BagReader, Playback, atom, functor  # noqa: E402
from retalis.prolog.syntax.event_text import to_text  # noqa: E402
from retalis.prolog.terms.timestamps import datime  # noqa: E402

PROGRAM = Path(__file__).resolve().parent / "node_configurations"
OUTPUT = functor("event", 3)
PUBLISHED = {"copies": "c", "greens": "g"}
"""Published topics with the ids of their subscriptions."""


def datime_prefix(instant):
    """Return the common prefix of the datimes in the second of an instant."""
    return to_text(datime(instant // 10**9 * 10**9))[: -len("0)")]


class NodeConfigurations(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.clock = rospy.Publisher("/clock", Clock, queue_size=100)
        cls.events = rospy.Publisher("retalisInputEvents", String, queue_size=100)
        cls.outputs = Collector("retalisOutputEvents", String)
        cls.probes = rospy.Publisher("probes", Empty, queue_size=100)
        cls.publishers = {
            topic: RawPublisher(topic, definition) for topic, definition in DEFINITIONS_BY_TOPIC.items()
        }
        wait_until(
            lambda: all(publisher.is_connected() for publisher in cls.publishers.values()), "the subscribers"
        )
        wait_until(lambda: cls.probes.get_num_connections() > 0, "the subscriber of the probes")
        wait_until(
            lambda: cls.events.get_num_connections() > 0 and cls.outputs.is_connected(), "node retalis"
        )
        cls.published = {topic: Collector(topic, rospy.AnyMsg) for topic in PUBLISHED}
        for collector in cls.published.values():
            wait_until(collector.is_connected, "the publisher of messages of an initially unknown type")

    def test_outputs_equal_those_of_playback(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        offline = Playback(PROGRAM, report=self.fail)
        texts = []
        greens = 0
        offline.engine.on_output(
            lambda term, topic, name: texts.append(to_text((OUTPUT, term, atom(topic), name)))
        )
        for number, specification in enumerate(BAGS):
            path = write_bag(Path(folder.name) / f"{number}.bag", number, specification)
            for turn in range(2):
                with BagReader(path) as bag, self.subTest(bag=specification.name, turn=turn):
                    texts.clear()
                    messages = [(output.topic, output.data) for output in offline.run(bag)]
                    outputs, published = self.play(bag, f"{number}/{turn}")
                    self.assertEqual(outputs, texts)
                    for topic in PUBLISHED:
                        expected = [data for name, data in messages if name == topic]
                        self.assertEqual(published[topic], expected, topic)
                    self.assertGreater(len(texts), bag.messages)
                    greens += len(published["greens"])
        self.assertGreater(greens, 0)

    def play(self, bag, name):
        """Publish the messages of a bag in sequence; return the outputs as texts, and bytes by topic."""
        self.set_clock(bag.start)
        output_count = len(self.outputs.messages)
        counts = {topic: len(collector.messages) for topic, collector in self.published.items()}
        now = bag.start
        for number, record in enumerate(bag.records(), 1):
            if record.time != now:
                now = record.time
                self.clock.publish(Clock(rospy.Time(*divmod(now, 10**9))))
            self.publishers[record.topic.name.strip("/")].publish(record.data)
            self.outputs.wait_for(
                lambda messages, number=number: self.count_seen(messages[output_count:]) >= number,
                "an output",
            )
        self.events.publish(f"event(done('{name}'))")
        last_output = f"event(done('{name}'),done,d)"
        self.outputs.wait_for(lambda messages: messages[-1].data == last_output, last_output)
        outputs = [message.data for message in self.outputs.messages[output_count:-1]]
        published = {}
        for topic, collector in self.published.items():
            first = counts[topic]
            count = sum(output.endswith(f",{topic},{PUBLISHED[topic]})") for output in outputs)
            collector.wait_for(
                lambda messages, first=first, count=count: len(messages) - first >= count, topic
            )
            published[topic] = [message._buff for message in collector.messages[first:]]
        return outputs, published

    @staticmethod
    def count_seen(messages):
        return sum(",seen," in message.data[-12:] for message in messages)

    def set_clock(self, instant):
        """Set the time and wait until the node that stamps messages and the engine have it."""
        self.clock.publish(Clock(rospy.Time(*divmod(instant, 10**9))))
        begin = datime_prefix(instant)
        prefix = f"event(times({begin}"

        def is_received():
            count = len(self.outputs.messages)
            self.probes.publish()
            self.events.publish("event(tick)")
            self.events.publish("event(ask)")
            time.sleep(0.02)
            return any(
                message.data.startswith(prefix) and message.data.count(begin) == 2
                for message in self.outputs.messages[count:]
            )

        wait_until(is_received, f"the time {begin}")
        self.events.publish(f"event(done(clock{instant}))")
        last_output = f"event(done(clock{instant}),done,d)"
        self.outputs.wait_for(lambda messages: messages[-1].data == last_output, last_output)


if __name__ == "__main__":
    rospy.init_node("node_configurations")
    rostest.rosrun("retalis", "node_configurations", NodeConfigurations)
