#!/usr/bin/env python3
"""The scenarios of ``test/scenarios`` on node retalis: the outputs are those of bags and of ROS 2."""

import signal
import sys
import unittest
from pathlib import Path
from typing import Any, List

import rospy
import rostest
from rosgraph_msgs.msg import Clock

sys.path += map(str, Path(__file__).resolve().parents[1:3])
from harness import DEFINITIONS, ENGINE, Collector, NodeProcesses, RawPublisher, wait_for_service, wait_until  # noqa: E402
from scenarios.scenario_runs import SCENARIOS, MessageCodec, Scenario, play_live, read_scenario  # noqa: E402

from retalis import srv  # noqa: E402

SECOND = 10**9


class ScenarioNode:
    """Node retalis with the program of a scenario; see `LiveNode`."""

    def __init__(self, scenario: Scenario, clock: rospy.Publisher) -> None:
        self._clock = clock
        self._processes = NodeProcesses(scenario.program)
        self._processes.start(ENGINE)
        self._outputs = {topic: Collector(topic, rospy.AnyMsg) for topic in scenario.published}
        self._publishers = {
            topic: RawPublisher(topic, DEFINITIONS.find(scenario.types[topic].replace("/msg/", "/")))
            for topic in scenario.inputs()
        }
        self._list = wait_for_service("retalis/list", srv.List)
        self._query = wait_for_service("retalis/query", srv.Query)
        for publisher in self._publishers.values():
            wait_until(publisher.is_connected, "the subscriptions")
        for collector in self._outputs.values():
            wait_until(collector.is_connected, "the publishers of the outputs")
        self._sent = dict.fromkeys(self._publishers, 0)

    def set_time(self, instant: int) -> None:
        clock = Clock(rospy.Time(*divmod(instant, SECOND)))

        def is_received() -> bool:
            # The node may not be connected to the clock yet.
            self._clock.publish(clock)
            return bool(self._list().now.to_nsec() == instant)

        wait_until(is_received, f"the time {instant}", pause=0.001)

    def publish(self, topic: str, data: bytes) -> None:
        self._sent[topic] += 1
        self._publishers[topic].publish(data)
        wait_until(
            lambda: self._count_received(topic) == self._sent[topic], f"message on {topic}", pause=0.001
        )
        # A goal runs after the messages that were received before it.
        assert self._query(goal="true").result == "ok"

    def _count_received(self, topic: str) -> int:
        return int(
            sum(entry.messages for entry in self._list().inputs if entry.topic.strip("/") == topic.strip("/"))
        )

    def receive_outputs(self) -> List[Any]:
        assert self._query(goal="true").result == "ok"
        for subscription in self._list().subscriptions:
            self._outputs[subscription.topic].wait_for(lambda messages: len(messages) >= subscription.sent)  # noqa: B023 - called at once
        return [
            (topic, message._buff)
            for topic, collector in self._outputs.items()
            for message in collector.messages
        ]

    def close(self) -> None:
        self._processes.end(signal.SIGINT, ENGINE)
        for collector in self._outputs.values():
            collector.close()
        for publisher in self._publishers.values():
            publisher.close()


class Scenarios(unittest.TestCase):
    def test_outputs_are_expected_ones(self) -> None:
        clock = rospy.Publisher("/clock", Clock, queue_size=10)
        codec = MessageCodec(1)
        for folder in SCENARIOS:
            with self.subTest(folder.name):
                scenario = read_scenario(folder)
                node = ScenarioNode(scenario, clock)
                try:
                    self.assertEqual(play_live(scenario, node, codec), scenario.outputs)
                finally:
                    node.close()


if __name__ == "__main__":
    rospy.init_node("live_scenarios", disable_rostime=True)
    rostest.rosrun("retalis", "live_scenarios", Scenarios)
