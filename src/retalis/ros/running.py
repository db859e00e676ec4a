"""Starting and ending a node."""

import logging
import signal
from typing import Any, Callable

import rospy

from ..errors import RetalisError
from ._log import forward_log
from .parameters import Parameters, read_parameters


def run_node(name: str, build: Callable[[Parameters], Any]) -> int:
    """Run a node until it is shut down or interrupted; return its exit status.

    rospy's own signal handler calls the master from within the handler, and hangs where the interrupted code
    was just doing the same. Here a signal raises KeyboardInterrupt, and the node is taken down afterwards.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    try:
        rospy.init_node(name, disable_signals=True)
        forward_log(logging.getLogger("retalis"))
        node = build(read_parameters())
        rospy.spin()
        del node
    except RetalisError as error:
        rospy.logfatal("%s", error)
        return 1
    except KeyboardInterrupt:
        pass
    finally:
        # A second interrupt must not cut off what the master has to be told.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)
        rospy.signal_shutdown("ended")
    return 0
