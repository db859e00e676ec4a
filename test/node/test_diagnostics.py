"""Publishing of ``/diagnostics``."""

import threading
from typing import Any, Iterator, List

import pytest
from node.memory_transport import MemoryNetwork, MemoryTransport

from retalis import Definitions, Reports
from retalis.messages.message_values import read_message_term
from retalis.messages.type_registry import InstalledTypes
from retalis.node.diagnostics import (
    DIAGNOSTICS_TOPIC,
    DIAGNOSTICS_TYPE,
    Diagnostics,
    Health,
    Level,
    NodeHealth,
)

DEFINITIONS = Definitions()
DEFINITION = DEFINITIONS.find(DIAGNOSTICS_TYPE)
HEALTH = NodeHealth(list, list, lambda: [Health("queue", Level.WARN, "two\nlines", [("a", "\x1b[31m")])])


class Listener:
    """Receiver of messages on ``/diagnostics``.

    Args:
        network: network of the node.

    Attributes:
        messages: the received messages.
    """

    def __init__(self, network: Any) -> None:
        self.messages: List[Any] = []
        self._received = threading.Event()
        transport = MemoryTransport(network, "/listener")
        transport.subscribe(DIAGNOSTICS_TOPIC, DIAGNOSTICS_TYPE, lambda source: self, 10)

    def receive(self, messages: Any) -> None:
        decode = DEFINITIONS.decoder(DEFINITION).decode
        self.messages += [read_message_term(DEFINITION, decode(data)) for data in messages]
        self._received.set()

    def close(self, is_incomplete: Any) -> None:
        pass

    def wait(self) -> Any:
        """Return the first message."""
        assert self._received.wait(60)
        return self.messages[0]


@pytest.fixture
def network() -> Any:
    return MemoryNetwork(now=1_000_000_002)


@pytest.fixture
def transport(network: Any) -> Iterator[Any]:
    """Return a transport with the type of diagnostics, which does not depend on the installation of ROS."""
    transport = MemoryTransport(network, "/ns/retalis")
    transport.installed_types = lambda include_rosbags=True: InstalledTypes()
    yield transport
    transport.shut_down()


@pytest.fixture
def listener(network: Any) -> Listener:
    return Listener(network)


def test_each_part_is_a_status_of_node(transport: Any, listener: Listener) -> None:
    Diagnostics(transport, 0.001, HEALTH, Reports(), "robot7")
    message = listener.wait()
    assert message["header"]["stamp"] == 1_000_000_002
    status = message["status"][0]
    assert (status["name"], status["level"], status["message"]) == ("ns/retalis: queue", 1, "two lines")
    assert status["values"] == [{"key": "a", "value": "\\x1b[31m"}]
    assert [status["name"] for status in message["status"]] == [
        "ns/retalis: queue",
        "ns/retalis: process memory",
    ]
    assert {status["hardware_id"] for status in message["status"]} == {"robot7"}


def test_nothing_is_published_without_period(network: Any, transport: Any) -> None:
    Diagnostics(transport, None, HEALTH, Reports())
    assert network.publications == {}


def test_missing_package_is_warned_of_once(
    network: Any, transport: Any, caplog: pytest.LogCaptureFixture
) -> None:
    transport.installed_types = lambda include_rosbags=True: InstalledTypes([], include_rosbags=False)
    Diagnostics(transport, 1.0, HEALTH, Reports())
    warnings = [record.getMessage() for record in caplog.records]
    assert warnings == ["/diagnostics is not published: the package diagnostic_msgs is not installed"]
    assert network.publications == {}


def test_error_of_evaluation_does_not_end_publishing(transport: Any, listener: Listener) -> None:
    evaluations, reports = [], Reports()

    def evaluate() -> List[Any]:
        evaluations.append(1)
        if len(evaluations) == 1:
            raise RuntimeError("changed size during iteration")
        return []

    Diagnostics(transport, 0.001, NodeHealth(list, list, evaluate), reports)
    assert listener.wait()["status"]
    assert reports.errors == 1
