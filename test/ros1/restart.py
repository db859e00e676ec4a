#!/usr/bin/env python3
"""Killed, restarted and interrupted nodes; the other node continues."""

import os
import signal
import subprocess
import sys
import unittest
from pathlib import Path

import rosgraph
import rosnode
import rospy
import rostest
from std_msgs.msg import String

sys.path.append(str(Path(__file__).resolve().parent))
from harness import TIMEOUT_SECONDS, Collector, wait_for_message_path, wait_for_service, wait_until  # noqa: E402

from retalis import srv  # noqa: E402

TYPES = {"retalis": "retalis_node", "retalis_ros_interface": "retalis_ros_converter.py"}


def is_alive(name):
    return f"/{name}" in rosnode.get_node_names()


class Restart(unittest.TestCase):
    def start(self, name):
        """Start a node by rosrun; it ends after the test."""
        process = subprocess.Popen(
            ["rosrun", "retalis", TYPES[name], f"__name:={name}"], start_new_session=True
        )
        self.addCleanup(self.end, process)
        wait_until(lambda: is_alive(name), f"node {name}")
        return process

    def end(self, process):
        """Interrupt a node, so that it is unregistered."""
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGINT)
            process.wait(TIMEOUT_SECONDS)

    def kill(self, name):
        killed, failed = rosnode.kill_nodes([f"/{name}"])
        self.assertEqual((killed, failed), ([f"/{name}"], []))
        wait_until(lambda: not self.is_registered(name), f"the end of {name}")

    def test_1_killed_interface_is_restarted(self):
        wait_for_message_path()
        self.kill("retalis_ros_interface")
        self.assertTrue(is_alive("retalis"))
        add = wait_for_service("add_memory", srv.AddMemory)
        self.assertEqual(add("x(Y)", "", "_", "while_alone", "1").result, "ok")
        self.start("retalis_ros_interface")
        deleted = wait_for_service("delete_output_subscription", srv.DeleteOutputSubscription)(
            "face_by_marker", "probe"
        )
        self.assertEqual(deleted.result, "ok")
        wait_for_message_path()

    def test_2_killed_engine_is_restarted(self):
        self.start("retalis_ros_interface")  # that of the first test has ended
        self.kill("retalis")
        self.start("retalis")
        wait_for_message_path()

    def test_3_interrupt_ends_each_node(self):
        for name in TYPES:
            process = self.start(name)
            events = rospy.Publisher("retalisInputEvents", String, queue_size=100)
            outputs = Collector("retalisOutputEvents", String)
            if name == "retalis":
                wait_until(lambda events=events: events.get_num_connections() > 0, "the engine")
                events.publish("event(a)")
            else:
                wait_until(lambda: is_alive("retalis_ros_interface"), "the interface")
            os.killpg(process.pid, signal.SIGINT)
            process.wait(5)
            outputs.close()
            wait_until(lambda name=name: not self.is_registered(name), f"the end of {name}")

    def is_registered(self, name):
        return any(
            f"/{name}" in nodes
            for state in rosgraph.Master("/restart").getSystemState()
            for _, nodes in state
        )


if __name__ == "__main__":
    rospy.init_node("restart")
    rostest.rosrun("retalis", "restart", Restart)
