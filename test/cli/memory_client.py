"""Connection of commands to the nodes of a network in memory."""

import re
from types import SimpleNamespace
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple

from node.in_memory_hosts import decode
from node.memory_transport import MemoryTransport
from parsed_sources import ROOT

from retalis import UsageError
from retalis.cli.node_client import RunningNodes
from retalis.messages.type_definition import Definition, SerializationFormat
from retalis.messages.type_registry import InstalledTypes

_FIELD = re.compile(r"^(?P<type>\w+(?:\[\])?)\s+(?P<name>\w+)")


class MemoryClient:
    """Connection to the nodes of a network; see `ClientConnection`.

    Args:
        network: a `MemoryNetwork`.
        namespace: namespace of the shell.
        interfaces: names of the interface nodes of a node.
        scope: end of errors about missing nodes.
        after_call: called with the name of each service after it was called.

    Attributes:
        started_nodes: names of the started nodes.
        requested_names: arguments of `find_nodes`.
        discovery_limits: arguments of `limit_discovery`.
        end_of_time: see `ClientConnection`.
        format: see `ClientConnection`.
        response_limits: time limits of the calls.
        is_ended: whether the connection has ended.
    """

    end_of_time = 1 << 32
    format = SerializationFormat.ROS1

    def __init__(
        self,
        network: Any,
        namespace: str = "/",
        interfaces: Any = None,
        scope: str = "",
        after_call: Callable[[str], object] = lambda service: None,
    ) -> None:
        self.namespace, self.scope = namespace, scope
        self.response_limits: List[float] = []
        self.started_nodes: List[str] = []
        self.requested_names: List[Optional[str]] = []
        self.discovery_limits: List[float] = []
        self.is_ended = False
        self._network = network
        self._interfaces = interfaces or {}
        self._after_call = after_call

    def resolve_node(self, name: str) -> str:
        return name if name.startswith("/") else f"{self.namespace}{name}"

    def limit_discovery(self, seconds: float) -> None:
        self.discovery_limits.append(seconds)

    def find_nodes(self, requested_name: Optional[str] = None) -> RunningNodes:
        self.requested_names.append(requested_name)
        graph = MemoryTransport(self._network).graph()
        return RunningNodes(graph.servers, graph.publishers, self._interfaces)

    def call(self, service: str, service_type: str, fields: Mapping[str, Any], max_seconds: float) -> Any:
        self.response_limits.append(max_seconds)
        request_fields, response_fields = read_service_fields(service_type)
        request = {name: _default(field_type) for name, field_type in request_fields.items()}
        assert set(fields) <= set(request)
        response = self._network.call(service, **{**request, **fields})
        self._after_call(service)
        return _make_object(response_fields, response)

    def start_node(self, name: str) -> None:
        self.started_nodes.append(name)

    def subscribe(self, topic: str, receive: Callable[[str], object]) -> None:
        assert self.started_nodes

        class Receiver:
            def receive(self, messages: Any) -> None:
                for message in messages:
                    receive(decode(message))

            def close(self, is_incomplete: Any) -> None:
                pass

        transport = MemoryTransport(self._network, "/command")
        transport.subscribe(topic, "std_msgs/String", lambda source: Receiver(), 10)

    def installed_types(self, extra_folders: Sequence[str]) -> InstalledTypes:
        return InstalledTypes(extra_folders=extra_folders)

    def advertise(self, topic: str, definition: Definition) -> Callable[[bytes], object]:
        assert self.started_nodes
        publication = MemoryTransport(self._network, "/command").advertise(topic, definition, 10)
        if not publication.subscriber_count():
            raise UsageError(f"topic {topic}: no node subscribes to it")
        return publication.send

    def end(self) -> None:
        self.is_ended = True


def read_fields(text: str) -> Dict[str, str]:
    """Return the types of the fields of a definition by name, in their order."""
    fields = map(_FIELD.match, text.splitlines())
    return {field["name"]: field["type"] for field in fields if field is not None}


def read_service_fields(service_type: str) -> Tuple[Dict[str, str], Dict[str, str]]:
    """Return the types of the fields of a service's request and response by name."""
    text = (ROOT / "srv" / f"{service_type}.srv").read_text(encoding="utf-8")
    request, _, response = text.partition("\n---\n")
    return read_fields(request), read_fields(response)


def read_message_fields(message_type: str) -> Dict[str, str]:
    """Return the types of the fields of a message of this package by name."""
    return read_fields((ROOT / "msg" / f"{message_type}.msg").read_text(encoding="utf-8"))


def _default(field_type: str) -> Any:
    if field_type.endswith("[]"):
        return []
    return {"string": "", "bool": False}.get(field_type, 0)


def _make_object(fields: Mapping[str, str], values: Mapping[str, Any]) -> SimpleNamespace:
    """Return an object with all fields of a message, in their order."""
    assert set(values) <= set(fields)
    return SimpleNamespace(
        **{
            name: _make_value(field_type, values.get(name, _default(field_type)))
            for name, field_type in fields.items()
        }
    )


def _make_value(field_type: str, value: Any) -> Any:
    if field_type[0].isupper() and field_type.endswith("[]"):
        fields = read_message_fields(field_type[:-2])
        return [_make_object(fields, item) for item in value]
    return list(value) if field_type.endswith("[]") else value
