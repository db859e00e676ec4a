#!/usr/bin/env python3
"""The recipe as a rospy node: the time of the opening, and a timer."""

import threading

import rospy
from std_msgs.msg import Bool, String


class Door:
    """Reports when the door has been open for ten seconds, and for how long it was open."""

    def __init__(self):
        self._lock = threading.Lock()
        self._was_shut = False
        self._since = None
        self._door = rospy.Publisher("door", String, queue_size=10)
        rospy.Subscriber("door_open", Bool, self._on_contact)

    def _on_contact(self, message):
        now = rospy.Time.now()
        with self._lock:
            was_shut, self._was_shut = self._was_shut, not message.data
            since = self._since
            if message.data and was_shut:
                self._since = now
                rospy.Timer(rospy.Duration(10), lambda event: self._on_time(now), oneshot=True)
            elif not message.data:
                self._since = None
        if not message.data and since is not None:
            self._door.publish(String(f"open for {(now - since).to_sec():.1f} s"))

    def _on_time(self, since):
        with self._lock:
            if since != self._since:
                return
        self._door.publish(String("left open"))


if __name__ == "__main__":
    rospy.init_node("door")
    Door()
    rospy.spin()
