"""Hosts of programs, and another node, on a network in memory."""

from typing import Any, Dict

from node.memory_transport import MemoryTransport

from retalis import Definitions, Reports
from retalis.messages.message_dictionaries import make_message_term, read_message_term
from retalis.messages.type_definition import SerializationFormat
from retalis.node.parameters import read_parameters
from retalis.node.program_host import ProgramHost
from retalis.node.program_host_context import HostContext
from retalis.node.text_exchange import PlainTextExchange

DEFINITIONS = Definitions()
STRING = DEFINITIONS.find("std_msgs/String")


def encode(text: Any) -> bytes:
    return DEFINITIONS.encoder(STRING).encode(make_message_term(STRING, {"data": text}))


def decode(data: Any) -> Any:
    return read_message_term(STRING, DEFINITIONS.decoder(STRING).decode(data))["data"]


class Robot:
    """Another node of the network.

    Attributes:
        received: received texts by topic.
    """

    def __init__(self, network: Any) -> None:
        self.transport = MemoryTransport(network, "/robot")
        self.received: Dict[Any, Any] = {}

    def publish(self, topic: Any, is_latched: bool = False) -> Any:
        """Return a publisher of texts."""
        return self.transport.advertise(topic, STRING, 10, is_latched)

    def subscribe(self, topic: Any) -> None:
        """Receive the texts of a topic."""
        texts = self.received[topic] = []

        class Receiver:
            def receive(self, messages: Any) -> None:
                texts.extend(map(decode, messages))

            def close(self, is_incomplete: Any) -> None:
                pass

        self.transport.subscribe(topic, STRING.name, lambda source: Receiver(), 10)


class RunningHost(ProgramHost):
    """A host, with its transport, its reports and its first parameters as further attributes."""

    def __init__(self, context: HostContext, transport: MemoryTransport, reports: Reports) -> None:
        super().__init__(context, PlainTextExchange(context))
        self.transport, self.reports, self.parameters = transport, reports, context.parameters


def start_host(
    network: Any,
    folder: Any,
    message_format: SerializationFormat = SerializationFormat.ROS1,
    is_time_simulated: bool = False,
    remappings: Any = None,
    **parameters: Any,
) -> RunningHost:
    """Start the program of a folder on a network.

    Args:
        network: a `MemoryNetwork`.
        folder: folder of the program.
        message_format: serialization of messages.
        is_time_simulated: whether time is that of messages on ``/clock``.
        remappings: names that topics have in place of others.
        parameters: parameters of the node.

    Returns:
        The host, with its transport and its reports as further attributes.
    """
    transport = MemoryTransport(
        network,
        parameters={"program": str(folder), "diagnostics": 0, **parameters},
        is_time_simulated=is_time_simulated,
        message_format=message_format,
        remappings=remappings,
    )
    reports = Reports()
    context = HostContext(transport, read_parameters(transport.parameters(), lambda: folder), reports)
    return RunningHost(context, transport, reports)
