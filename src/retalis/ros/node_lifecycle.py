"""What SIGINT and SIGTERM do to a node.

Starting and ending a node.
"""

import logging
import os
import signal
import sys
import threading
import time
from types import FrameType
from typing import Callable, Optional, Union

import rospy

from ..engine.runtime.gc_tuning import collect_when_idle, limit_gc_pauses
from ..foundation.errors import RetalisError
from ..foundation.python_interpreter import stop_collecting
from .connection_limits import limit_connections
from .master_watch import MasterWatch, wait_for_master
from .parameters import Parameters, read_parameters
from .ros_log import forward_log, write_out_each_line

SIGNAL_DELAY_SECONDS = (("xmlrpc.", 2.0), ("rospy.", 0.2))
"""Seconds for which a signal is put off at most, by the modules that the main thread is in.

That is in a request to the master, which may be one that hangs; or in rospy, which may be between two steps that
belong together, or wait for a master that is not there.
"""

PAUSE = 0.05
"""Seconds from one look to the next whether it need not be put off any longer."""

LAST = 10.0
"""Seconds that taking a node down may take. Whoever started it often kills it after 15."""


class Interrupts:
    """Raises KeyboardInterrupt for a signal, but not amid a conversation with the master.

    A request that is cut off leaves its connection of no use, and the node would stay registered with the master. So
    a signal that comes while the node is set up is put off until such a request is over, for a moment mostly.
    """

    def __init__(self) -> None:
        self._allowed = self._raised = self._insisting = False
        self._since: Optional[float] = None

    def begin(self) -> None:
        """Take the signals from now on."""
        self._set(self._take)

    def allow(self) -> None:
        """Let signals interrupt at any moment from now on, and do so if one was put off."""
        self._allowed = True
        if self._since is not None:
            self._interrupt()

    def shut_down(self) -> None:
        """Interrupt what the main thread is doing, where the node is shut down before it was set up."""
        main = threading.main_thread().ident
        if not (self._allowed or self._raised or main is None):
            signal.pthread_kill(main, signal.SIGTERM)

    def end(self, status: int) -> None:
        """Let no signal cut off what the master has to be told at the end, nor the end wait for it forever."""
        self._raised = True
        self._set(signal.SIG_IGN)
        threading.Thread(target=_give_up, args=(status,), daemon=True, name="last resort").start()

    def _set(self, handler: Union[Callable[[int, Optional[FrameType]], None], signal.Handlers]) -> None:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, handler)

    def _take(self, number: int, frame: Optional[FrameType]) -> None:
        if self._since is None:
            self._since = time.monotonic()
        if self._allowed or time.monotonic() - self._since >= _patience(frame):
            self._interrupt()
        if not self._insisting:
            self._insisting = True
            threading.Thread(target=self._insist, args=(number,), daemon=True, name="interrupt").start()

    def _interrupt(self) -> None:
        self._raised = True
        raise KeyboardInterrupt

    def _insist(self, number: int) -> None:
        """Send a signal that was put off again and again."""
        main = threading.main_thread().ident
        while True:
            time.sleep(PAUSE)
            if self._raised or main is None:
                return
            signal.pthread_kill(main, number)


def _patience(frame: Optional[FrameType]) -> float:
    """Return how long a signal may be put off for what runs in a frame, and in those that it was called from."""
    modules = []
    while frame is not None:
        modules.append(frame.f_globals.get("__name__") or "")
        frame = frame.f_back
    for begin, seconds in SIGNAL_DELAY_SECONDS:
        if any(module.startswith(begin) for module in modules):
            return seconds
    return 0.0


def _give_up(status: int) -> None:
    """End the process, where a master that hangs, or a thread that does not end, keeps it from doing so."""
    time.sleep(LAST)
    try:
        print(f"not everything has ended after {LAST:.0f} s: the process ends all the same", file=sys.stderr)
        sys.stderr.flush()
        sys.stdout.flush()
    finally:
        os._exit(status)


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
