"""How many may call a node's services, or connect to its topics, at the same moment."""

import rospy
from rospy.impl import tcpros_base

WAITING = 1024
"""Connections that the system holds until the node takes them, where it allows as many."""


def widen_backlog() -> None:
    """Have the system hold more connections than the five that rospy asks for.

    Those beyond are not answered; who tried asks again after 1, 3 and 7 seconds, so that a burst of service calls was
    served in waves. Where rospy keeps its socket elsewhere than expected, it stays as it is.
    """
    server = getattr(tcpros_base, "_tcpros_server", None)
    listening = getattr(getattr(server, "tcp_ros_server", None), "server_sock", None)
    if listening is None:
        rospy.logdebug("the socket for connections is not where it was expected")
        return
    try:
        listening.listen(WAITING)
    except OSError as error:  # it has been closed: the node is being shut down
        rospy.logdebug("as many connections may wait as before: %s", error)
