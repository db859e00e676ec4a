"""``/diagnostics``: how a node is, once in a while."""

import threading
from typing import Any, List, Optional

import rospy

from ..foundation import beginning, printable
from .health import Health, NodeHealth

TOPIC = "/diagnostics"

HARDWARE = "retalis"
"""The hardware id if parameter ``~hardware_id`` gives no other; ``diagnostic_aggregator`` may group by it."""


class Diagnostics:
    """Publishes the health of a node, from a thread of its own by the system's time: simulated time may stand still.

    Args:
        period: seconds from one message to the next; None for none at all.
        health: is looked at.
        hardware_id: of each status.
    """

    def __init__(self, period: Optional[float], health: NodeHealth, hardware_id: str = HARDWARE):
        self._health = health
        self._hardware_id = hardware_id
        self._ended = threading.Event()
        if period is None:
            return
        try:
            from diagnostic_msgs import msg  # noqa: PLC0415 - a node runs without it
        except ImportError:
            rospy.logwarn("%s is not published: the package diagnostic_msgs is not installed", TOPIC)
            return
        self._msg = msg
        self._publisher = rospy.Publisher(TOPIC, msg.DiagnosticArray, queue_size=2)
        rospy.on_shutdown(self._ended.set)
        threading.Thread(target=self._run, args=(period,), name="retalis diagnostics", daemon=True).start()

    def _run(self, period: float) -> None:
        while not self._ended.wait(period):
            try:
                self._publisher.publish(self._array(self._health.look()))
            except rospy.ROSException:  # it is just being taken down
                if not rospy.is_shutdown():
                    raise
            except Exception as error:  # what is looked at is in use; the next look finds it in order
                rospy.logerr_throttle(60, f"{TOPIC}: {error!r}")

    def _array(self, found: List[Health]) -> Any:
        message = self._msg.DiagnosticArray()
        message.header.stamp = rospy.get_rostime()
        node = rospy.get_name().strip("/")
        message.status = [
            self._msg.DiagnosticStatus(
                level=int(one.level),
                name=f"{node}: {one.name}",
                message=_line(one.message),
                hardware_id=self._hardware_id,
                values=[self._msg.KeyValue(key=_line(key), value=_line(value)) for key, value in one.values],
            )
            for one in found
        ]
        return message


def _line(text: str) -> str:
    """Return a text as one line without what a terminal would act on."""
    return " ".join(printable(beginning(text, LONGEST)).split("\n"))


LONGEST = 1000
"""Characters of one text."""
