#!/usr/bin/env python3
"""The recipe as a rospy node: the active tasks, with a timer for each."""

import threading

import rospy
from actionlib_msgs.msg import GoalID, GoalStatus


class TaskTimeout:
    """Cancels a task that has not ended after 20 seconds."""

    def __init__(self):
        self._lock = threading.Lock()
        self._timers = {}
        self._cancel = rospy.Publisher("cancel", GoalID, queue_size=10)
        rospy.Subscriber("task", GoalStatus, self._on_status)

    def _on_status(self, message):
        goal = message.goal_id
        with self._lock:
            timer = self._timers.get(goal.id)
            if message.status == GoalStatus.ACTIVE and timer is None:
                limit = rospy.Duration(20)
                self._timers[goal.id] = rospy.Timer(limit, lambda event: self._on_time(goal), oneshot=True)
            elif message.status > GoalStatus.ACTIVE and timer is not None:
                timer.shutdown()
                del self._timers[goal.id]

    def _on_time(self, goal):
        with self._lock:
            if goal.id not in self._timers:
                return
        self._cancel.publish(goal)


if __name__ == "__main__":
    rospy.init_node("task_timeout")
    TaskTimeout()
    rospy.spin()
