#!/usr/bin/env python3
"""The recipe as a rospy node: the efforts of the last two seconds, and the state of each joint."""

from collections import deque

import numpy
import rospy
from sensor_msgs.msg import JointState
from std_msgs.msg import String


class JointEffort:
    """Reports when a joint becomes strained or relaxed, by the mean over two seconds."""

    def __init__(self):
        self._window = deque()
        self._states = {}
        self._joint = rospy.Publisher("joint", String, queue_size=10)
        rospy.Subscriber("joint_states", JointState, self._on_joints)

    def _on_joints(self, message):
        now = message.header.stamp
        self._window.append((now, numpy.array(message.effort)))
        while now - self._window[0][0] >= rospy.Duration(2):
            self._window.popleft()
        means = numpy.mean([efforts for _, efforts in self._window], axis=0)
        for joint, mean in zip(message.name, means):
            if 4 <= mean <= 6:
                continue
            state = "strained" if mean > 6 else "relaxed"
            if self._states.get(joint) != state:
                self._states[joint] = state
                self._joint.publish(String(f"{joint} {state}"))


if __name__ == "__main__":
    rospy.init_node("joint_effort")
    JointEffort()
    rospy.spin()
