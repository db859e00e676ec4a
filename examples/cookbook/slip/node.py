#!/usr/bin/env python3
"""The recipe as a rospy node: the time of the last grip, and the last command."""

import threading

import rospy
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty, Float32


class Slip:
    """Reports when something has slipped out of the gripper."""

    def __init__(self):
        self._lock = threading.Lock()
        self._held = None
        self._width = None
        self._slipped = rospy.Publisher("slipped", Empty, queue_size=10)
        rospy.Subscriber("gripper_command", Float32, self._on_command)
        rospy.Subscriber("joint_states", JointState, self._on_joints)

    def _on_command(self, message):
        with self._lock:
            self._width = message.data

    def _on_joints(self, message):
        efforts = dict(zip(message.name, message.effort))
        effort, now = efforts.get("gripper"), message.header.stamp
        if effort is None or 1 <= effort <= 5:
            return
        with self._lock:
            if effort > 5:
                self._held = now
                return
            if self._held is None or self._width is None or self._width >= 0.01:
                return
            held, self._held = self._held, None
        if now - held < rospy.Duration(0.5):
            self._slipped.publish(Empty())


if __name__ == "__main__":
    rospy.init_node("slip")
    Slip()
    rospy.spin()
