"""Many connections at once are held until the node takes them."""

import socket

from rospy.impl.tcpros_base import get_tcpros_server_address, start_tcpros_server

from retalis.ros.backlog import widen_backlog

NUMBER = 100
ASKED_AGAIN = 0.9
"""Seconds, before the system asks a second time for a connection that was not answered."""


def test_a_burst_of_connections_is_held():
    """The node reads the header of the first, which never comes."""
    start_tcpros_server()
    port = get_tcpros_server_address()[1]
    widen_backlog()
    links = []
    try:
        for _ in range(NUMBER):
            links.append(socket.create_connection(("localhost", port), timeout=ASKED_AGAIN))
    finally:
        for link in links:
            link.close()
    assert len(links) == NUMBER
