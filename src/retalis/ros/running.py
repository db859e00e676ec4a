"""Starting and ending a node."""

import logging
import signal
from typing import Callable, Union

import rospy

from ..engine.runtime import relax
from ..foundation import RetalisError
from .log import forward_log
from .parameters import Parameters, read_parameters


def run_node(name: str, build: Callable[[Parameters], object]) -> int:
    """Run a node until it is shut down or interrupted; return its exit status.

    rospy's own signal handler calls the master from within the handler, and hangs where the interrupted code
    was just doing the same. Here a signal raises KeyboardInterrupt, and the node is taken down afterwards;
    while the node is set up, only when that is done, so that nothing stays registered by half.
    """
    interrupt = _Interrupt()
    try:
        rospy.init_node(name, disable_signals=True)
        forward_log(logging.getLogger("retalis"))
        node = build(read_parameters())
        relax()
        interrupt.allow()
        rospy.spin()
        del node
    except RetalisError as error:
        rospy.logfatal("%s", error)
        return 1
    except KeyboardInterrupt:
        pass
    finally:
        interrupt.ignore()
        rospy.signal_shutdown("ended")
    return 0


class _Interrupt:
    """What SIGINT and SIGTERM do; a second one while a first is put off interrupts at once."""

    def __init__(self) -> None:
        self._allowed = self._pending = False
        self._set(self._take)

    def _set(self, handler: Union[Callable[[int, object], None], signal.Handlers]) -> None:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, handler)

    def _take(self, number: int, frame: object) -> None:
        if self._allowed or self._pending:
            raise KeyboardInterrupt
        self._pending = True

    def allow(self) -> None:
        """Let signals interrupt from now on, and do so if one came before."""
        self._allowed = True
        if self._pending:
            raise KeyboardInterrupt

    def ignore(self) -> None:
        """Let no signal cut off what the master has to be told at the end."""
        self._set(signal.SIG_IGN)
