"""``examples/localization_faults`` on a live node: each fault has its alarm on ``/diagnostics``, and no other.

One node receives all recordings, by simulated time that is many times faster than real time. The clock jumps back
between two of them, as with bags that are played in a loop.
"""

from itertools import groupby
from typing import Any, Dict, Iterator, List

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed")
pytest.importorskip("retalis.srv", reason="the classes of this package's services have not been generated")

from diagnostic_msgs.msg import DiagnosticArray
from examples.test_localization_faults import ERROR, FAULTS, PROGRAM
from rclpy.serialization import deserialize_message
from ros2.node_processes import NodeProcess
from ros2.rclpy_nodes import Network
from ros2.simulated_time_node import SECOND, SimulatedTimeNode
from script_modules import load_script

script = load_script(PROGRAM / "make_recordings.py", "localization_recordings")

SLICE_SECONDS = 0.2
"""Seconds whose messages are published at once.

Messages of different topics may overtake each other within a slice, so it is shorter than each limit of the program.
"""

LEAD_SECONDS = 10.0
"""Seconds before a fault that the short test plays: the receiver must have had a fix for so long."""

DIAGNOSTICS = "/diagnostics"
INPUTS = {topic: message_type for topic, message_type in script.TOPICS.items() if topic != DIAGNOSTICS}
PREFIX = "localization: "

Alarms = Dict[str, List[float]]
"""Seconds of the messages with each alarm, by the name of its status."""


def make_instant(seconds: float) -> int:
    """Return the instant in ns of a time since the start of the recordings."""
    return int(script.START) * SECOND + round(seconds * SECOND)


def read_messages(case: str, faulty: bool, begin: float, end: float) -> Iterator[Any]:
    """Yield the messages of a part of a recording."""
    for message in script.Robot(case, faulty, 1).messages():
        if begin <= message.time < end and message.topic in INPUTS:
            yield message


class LocalizationNode:
    """The node with the program.

    Args:
        network: the nodes of the test.
    """

    def __init__(self, network: Network) -> None:
        self._node = SimulatedTimeNode(network, INPUTS, {DIAGNOSTICS: script.TOPICS[DIAGNOSTICS]})
        self._types = script.MessageTypes(2)

    def play(self, case: str, faulty: bool, begin: float = 0.0, end: float = script.DURATION) -> Alarms:
        """Play a part of a recording; return its alarms."""
        # The clock jumps back first, so that the node forgets the recording before.
        self._node.set_time(make_instant(-10.0))
        self._node.set_time(make_instant(begin))
        for _, messages in groupby(
            read_messages(case, faulty, begin, end), lambda message: int(message.time / SLICE_SECONDS)
        ):
            self._node.play(
                (
                    make_instant(message.time),
                    message.topic,
                    self._types.serialize(message.fields, INPUTS[message.topic]),
                )
                for message in messages
            )
        self._node.set_time(make_instant(end))
        return self._read_alarms()

    def _read_alarms(self) -> Alarms:
        alarms: Alarms = {}
        for _, data in self._node.receive_outputs():
            message = deserialize_message(data, DiagnosticArray)
            for status in message.status:
                if status.level == bytes([ERROR]):
                    name = status.name[len(PREFIX) :]
                    alarms.setdefault(name, []).append(message.header.stamp.sec - script.START)
        return alarms


@pytest.fixture
def process(start_node: Any) -> NodeProcess:
    """Start the program without the node's own diagnostics."""
    parameters = (f"program:={PROGRAM}", "use_sim_time:=true", "diagnostics:=0.0")
    process: NodeProcess = start_node(*(word for parameter in parameters for word in ("-p", parameter)))
    return process


def check_log(process: NodeProcess) -> None:
    """Check that the node ends without errors."""
    assert process.interrupt() == 0
    log = process.log()
    assert "[ERROR]" not in log
    assert "Traceback" not in log


@pytest.mark.slow
def test_each_fault_has_its_alarm_only(network: Network, process: NodeProcess) -> None:
    node = LocalizationNode(network)
    for case, fault in FAULTS.items():
        alarms = node.play(case, True, max(0.0, fault.first - LEAD_SECONDS), fault.last + 2)
        assert list(alarms) == [fault.status], case
        assert fault.first < alarms[fault.status][0] <= fault.last, case
    # The pause that resembles the death of a node is in these seconds.
    assert node.play("filter_died", False, 35, 50) == {}
    check_log(process)


@pytest.mark.nightly
@pytest.mark.slow
def test_whole_recordings_have_their_alarms_only(network: Network, process: NodeProcess) -> None:
    node = LocalizationNode(network)
    for case, fault in FAULTS.items():
        alarms = node.play(case, True)
        assert list(alarms) == [fault.status], case
        times = alarms[fault.status]
        assert times == list(range(int(times[0]), int(times[-1]) + 1)), case
        assert times[-1] < fault.end if fault.end else times[-1] >= script.DURATION - 1, case
        assert node.play(case, False) == {}, case
    check_log(process)
