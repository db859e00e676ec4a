#!/usr/bin/env python3
"""The recipe as a rospy node: a mean, and whether the fan is on."""

import rospy
from sensor_msgs.msg import Temperature
from std_msgs.msg import Bool


class Hysteresis:
    """Switches a fan by a smoothed temperature, with two limits."""

    def __init__(self):
        self._mean = None
        self._cooling = False
        self._fan = rospy.Publisher("fan", Bool, queue_size=10, latch=True)
        rospy.Subscriber("temperature", Temperature, self._on_temperature)

    def _on_temperature(self, message):
        reading = message.temperature
        self._mean = reading if self._mean is None else self._mean + 0.25 * (reading - self._mean)
        if self._mean < 55 if self._cooling else self._mean > 60:
            self._cooling = not self._cooling
            self._fan.publish(Bool(self._cooling))


if __name__ == "__main__":
    rospy.init_node("hysteresis")
    Hysteresis()
    rospy.spin()
