"""Starting and ending a node."""

import logging
import threading
import time
from typing import Callable

import rospy

from ..engine.runtime import collect_when_idle, limit_gc_pauses
from ..foundation import RetalisError, stop_collecting
from .connection_limits import limit_connections
from .interrupts import PAUSE, Interrupts
from .log import forward_log, write_out_each_line
from .master import MasterWatch, wait_for_master
from .parameters import Parameters, read_parameters

SPIN = 0.5
"""Seconds from one look to the next whether the node has been shut down."""

IDLE = 0.02
"""Share of one core below which a node counts as idle: garbage is collected then, if much may have gathered."""


def run_node(name: str, build: Callable[[Parameters], object]) -> int:
    """Run a node until it is shut down or interrupted; return its exit status.

    That is 1 where the node could not be set up, and 0 where it was asked to end, at whatever moment.

    rospy's own signal handler calls the master from within the handler, and hangs where the interrupted code
    was just doing the same. Here a signal raises KeyboardInterrupt, and the node is taken down afterwards.
    """
    interrupts = Interrupts()
    status = 0
    try:
        interrupts.begin()
        status = _live(name, build, interrupts)
    except KeyboardInterrupt:
        pass
    finally:
        interrupts.end(status)
        rospy.signal_shutdown("ended")
        while not rospy.is_shutdown():  # another thread is at it (``rosnode kill``)
            time.sleep(PAUSE)
        stop_collecting()  # 100,000 recorded events would take seconds at each of the collections to come
    return status


def _live(name: str, build: Callable[[Parameters], object], interrupts: Interrupts) -> int:
    write_out_each_line()
    wait_for_master()
    limit_connections()
    rospy.init_node(name, disable_signals=True)
    forward_log(logging.getLogger("retalis"))
    try:
        parameters = read_parameters()
        rospy.on_shutdown(interrupts.shut_down)
        MasterWatch().start()
        node = build(parameters)
    except RetalisError as error:
        rospy.logfatal("%s", error)
        return 1
    limit_gc_pauses()
    interrupts.allow()
    while not rospy.is_shutdown():  # not `rospy.spin`, which takes the node down from within the interrupt
        worked = time.process_time()
        time.sleep(SPIN)
        if time.process_time() - worked < IDLE * SPIN:
            # In a thread of its own: an interrupt that comes in a callback of the garbage collector would be lost.
            collecting = threading.Thread(target=collect_when_idle, daemon=True)
            collecting.start()
            collecting.join()
    del node
    return 0
