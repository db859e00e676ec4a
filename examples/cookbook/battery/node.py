#!/usr/bin/env python3
"""The recipe as a rospy node: the levels of the last minutes, and whether the warning was published."""

from collections import deque

import rospy
from sensor_msgs.msg import BatteryState
from std_msgs.msg import String


class Battery:
    """Warns once of a low battery, with the minutes that it lasts."""

    def __init__(self):
        self._levels = deque(maxlen=100)
        self._told = False
        self._low = rospy.Publisher("battery_low", String, queue_size=10)
        rospy.Subscriber("battery", BatteryState, self._on_battery)

    def _on_battery(self, message):
        if message.power_supply_status == BatteryState.POWER_SUPPLY_STATUS_CHARGING:
            self._told = False
        elif message.power_supply_status == BatteryState.POWER_SUPPLY_STATUS_DISCHARGING:
            self._levels.append((message.header.stamp, message.percentage))
            if len(self._levels) > 1 and not self._told:
                self._look(message.header.stamp)

    def _look(self, now):
        level = self._levels[-1][1]
        if level >= 0.25 or self._levels[-2][1] >= 0.25:
            return
        before = [old for stamp, old in self._levels if now - stamp >= rospy.Duration(120)]
        if before and before[-1] > level:
            minutes = round(2 * level / (before[-1] - level))
            self._low.publish(String(f"{round(100 * level)} %, empty in {minutes} minutes"))
            self._told = True


if __name__ == "__main__":
    rospy.init_node("battery")
    Battery()
    rospy.spin()
