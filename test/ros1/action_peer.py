"""Server and client of an action, whose goal stalls until the program has noticed it, and is then canceled.

Prints what the program publishes on ``seen``, until it has seen the request to cancel the goal, and its end.
"""

import threading
from typing import Any, List

import actionlib
import rospy
from actionlib.msg import TestAction, TestFeedback, TestGoal, TestResult
from std_msgs.msg import String

TIMEOUT_SECONDS = 60.0


class Peer:
    """The server, its client, and the outputs of the program.

    Attributes:
        seen: the outputs.
    """

    def __init__(self) -> None:
        self.seen: List[str] = []
        self._changed = threading.Condition()
        rospy.Subscriber("seen", String, self._receive)
        self.server = actionlib.SimpleActionServer("fetch", TestAction, self._execute, auto_start=False)
        self.server.start()

    def wait_for(self, text: str) -> None:
        """Wait until the program has published a text."""
        with self._changed:
            assert self._changed.wait_for(lambda: text in self.seen, TIMEOUT_SECONDS), self.seen

    def _receive(self, message: Any) -> None:
        with self._changed:
            self.seen.append(message.data)
            self._changed.notify_all()

    def _execute(self, goal: Any) -> None:
        self.server.publish_feedback(TestFeedback(goal.goal + 1))
        while not self.server.is_preempt_requested():
            rospy.sleep(0.01)
        self.server.set_preempted(TestResult(7))


def main() -> None:
    rospy.init_node("peer")
    peer = Peer()
    client = actionlib.SimpleActionClient("fetch", TestAction)
    assert client.wait_for_server(rospy.Duration(TIMEOUT_SECONDS))
    server, sender = peer.server.action_server, client.action_client
    # Each has the other side and the program as subscribers: actionlib repeats only the status.
    publishers = [server.feedback_pub, server.result_pub, sender.pub_goal, sender.pub_cancel]
    while any(publisher.get_num_connections() < 2 for publisher in publishers):
        rospy.sleep(0.01)
    client.send_goal(TestGoal(4))
    peer.wait_for("stalled")
    client.cancel_goal()
    peer.wait_for("cancel")
    peer.wait_for("result canceled 7")
    print("\n".join(peer.seen))
    # The thread of the server would keep the process from ending.
    rospy.signal_shutdown("done")


main()
