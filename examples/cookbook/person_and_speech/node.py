#!/usr/bin/env python3
"""The recipe as a rospy node: the last person nearby, and the last words without a speaker."""

import threading

import rospy
from geometry_msgs.msg import TransformStamped
from std_msgs.msg import String

WITHIN = rospy.Duration(1.0)


class PersonAndSpeech:
    """Pairs words with a person who is near within a second."""

    def __init__(self):
        self._lock = threading.Lock()
        self._near = []
        self._said = []
        self._addressed = rospy.Publisher("addressed", String, queue_size=10)
        rospy.Subscriber("people", TransformStamped, self._on_person)
        rospy.Subscriber("speech", String, self._on_speech)

    def _on_person(self, message):
        if message.transform.translation.x < 2:
            self._pair(self._near, self._said, message.header.stamp, message.child_frame_id)

    def _on_speech(self, message):
        self._pair(self._said, self._near, rospy.Time.now(), message.data)

    def _pair(self, own, others, time, value):
        with self._lock:
            others[:] = [other for other in others if abs(time - other[0]) < WITHIN]
            if not others:
                own.append((time, value))
                return
            _, other = others.pop()
        who, text = (value, other) if own is self._near else (other, value)
        self._addressed.publish(String(f"{who}: {text}"))


if __name__ == "__main__":
    rospy.init_node("person_and_speech")
    PersonAndSpeech()
    rospy.spin()
