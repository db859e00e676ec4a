#!/usr/bin/env python3
"""Alarms and timers by simulated ROS time, which stands still until the test advances it."""

import sys
import unittest
from pathlib import Path
from typing import Any

import rospy
import rostest
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

sys.path.append(str(Path(__file__).resolve().parents[1]))
from harness import Collector, wait_for_service, wait_until  # noqa: E402

from retalis import srv  # noqa: E402

START = 1_000_000_000
RULES = (
    "ins_event_rule((exceptionAlarm(rings(X), 5) <- starts(X)))",
    "ins_event_rule((lost(X) <- heard(X) seq absent(heard(X), 8)))",
    "timer(beats(1), every(2))",
    "timer(beats(2), after(3))",
    "ins_event_rule((exceptionAlarmAbsoluteDatime(strikes(X), datime(2001,9,9,1,47,0,0)) <- sets(X)))",
)


class Alarms(unittest.TestCase):
    outputs: Collector
    to_engine: rospy.Publisher
    clock: rospy.Publisher

    @classmethod
    def setUpClass(cls) -> None:
        cls.outputs = Collector("retalisOutputEvents", String)
        cls.to_engine = rospy.Publisher("retalisInputEvents", String, queue_size=5000)
        cls.clock = rospy.Publisher("/clock", Clock, queue_size=10)
        subscribe = wait_for_service("add_output_subscription", srv.AddOutputSubscription)
        for event in ("rings", "strikes", "seen", "beats", "lost"):
            assert subscribe(f"{event}(X)", "", "_", "t", event).result == "ok"
        wait_until(lambda: cls.to_engine.get_num_connections() > 0, "node retalis")
        wait_until(lambda: cls.outputs.is_connected(), "its outputs")
        wait_until(lambda: cls.clock.get_num_connections() > 1, "the nodes' clocks")
        for rule in RULES:
            cls.to_engine.publish(rule)

    def advance_to(self, seconds: int, nanoseconds: int, mark: int) -> None:
        """Set the time and wait until the engine has it: it outputs an event that follows the clock."""
        self.clock.publish(Clock(rospy.Time(START + seconds, nanoseconds)))
        wait_until(lambda: rospy.get_rostime() == rospy.Time(START + seconds, nanoseconds), "time")
        self.clock.publish(Clock(rospy.Time(START + seconds, nanoseconds)))
        self.to_engine.publish(f"event(seen({mark}))")
        self.wait_for(f"event(seen({mark}),t,seen)")

    def wait_for(self, text: str) -> None:
        self.outputs.wait_for(lambda messages: any(message.data == text for message in messages), text)

    def move_until(self, seconds: Any, text: str) -> None:
        """Advance time until an output is received: a timer that starts after a jump counts from there."""
        remaining_seconds = iter(seconds)

        def moved() -> bool:
            second = next(remaining_seconds, None)
            if second is not None:
                self.clock.publish(Clock(rospy.Time(START + second, 0)))
            return self.has(text)

        wait_until(moved, text)

    def has(self, text: str) -> bool:
        return any(message.data == text for message in self.outputs.messages)

    def test_alarm_fires_at_its_time_not_before(self) -> None:
        self.advance_to(0, 0, 1)
        self.to_engine.publish("event(starts(a),[datime(2001,9,9,1,46,40,0),datime(2001,9,9,1,46,40,0)])")
        self.to_engine.publish("event(sets(b))")
        self.to_engine.publish("event(heard(c),[datime(2001,9,9,1,46,40,0),datime(2001,9,9,1,46,40,0)])")
        self.advance_to(4, 999_999_999, 2)
        self.assertFalse(self.has("event(rings(a),t,rings)"))
        self.advance_to(5, 1_000_000, 3)
        self.move_until(range(6, 19), "event(rings(a),t,rings)")
        self.assertFalse(self.has("event(strikes(b),t,strikes)"))
        self.move_until(range(7, 19), "event(lost(c),t,lost)")  # no event is received at that time
        beats = [message.data for message in self.outputs.messages if message.data.startswith("event(beats")]
        self.assertEqual(beats[:3], [f"event(beats({advance_to}),t,beats)" for advance_to in (1, 2, 1)])
        # Without events, the timer of the node fires.
        self.move_until(range(21, 100_000), "event(strikes(b),t,strikes)")


if __name__ == "__main__":
    rospy.init_node("alarms")
    rostest.rosrun("retalis", "alarms", Alarms)
