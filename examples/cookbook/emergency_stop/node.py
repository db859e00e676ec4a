#!/usr/bin/env python3
"""The recipe as a rospy node: whether the button is pressed, and whether the motors are stopped."""

import threading

import rospy
from std_msgs.msg import Bool, Empty


class EmergencyStop:
    """Stops the motors when the button is pressed, until a reset."""

    def __init__(self):
        self._lock = threading.Lock()
        self._pressed = True
        self._stopped = False
        self._motors = rospy.Publisher("motors_on", Bool, queue_size=10, latch=True)
        rospy.Subscriber("emergency_stop", Bool, self._on_button)
        rospy.Subscriber("reset", Empty, self._on_reset)

    def _on_button(self, message):
        with self._lock:
            self._pressed = message.data
            if not message.data or self._stopped:
                return
            self._stopped = True
        self._motors.publish(Bool(False))

    def _on_reset(self, message):
        with self._lock:
            if self._pressed or not self._stopped:
                return
            self._stopped = False
        self._motors.publish(Bool(True))


if __name__ == "__main__":
    rospy.init_node("emergency_stop")
    EmergencyStop()
    rospy.spin()
