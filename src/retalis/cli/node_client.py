"""Client of a running node: finds the node, and calls its services.

A `ClientConnection` connects the process to the middleware; each package of a middleware implements it. Nodes are
identified by their services, not by their names, which launch files may change.
"""

import sys
from typing import (
    TYPE_CHECKING,
    Any,
    Callable,
    Container,
    Dict,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Protocol,
    Sequence,
    Set,
)

from ..engine.client_requests import decode_bindings
from ..foundation.errors import UsageError
from ..foundation.output_files import print_json
from ..messages.type_definition import Definition, SerializationFormat
from ..node.services import NO_DURATION

if TYPE_CHECKING:
    from ..messages.type_registry import InstalledTypes

ENGINE_SERVICE_SUFFIX = "/add_memory"
"""Suffix of a service that identifies nodes with an engine, in all versions."""

INTERFACE_SERVICE_SUFFIX = "/add_input_subscription"
"""Suffix of a service that identifies nodes with a ROS interface."""

TIME_FIELDS = frozenset(("instant", "last_fired", "newest", "now", "oldest", "since"))
"""Fields of responses that are times in nanoseconds; zero if absent."""

DURATION_FIELDS = frozenset(("age", "behind", "lag", "work_time"))
"""Fields of responses that are durations in nanoseconds; `NO_DURATION` if absent."""

MAX_RESPONSE_SECONDS = 60.0
"""Seconds after which a service counts as silent, in addition to the times that its request states."""

CONNECTION_SECONDS = 5.0
"""Seconds after which a topic, or a service that was discovered, counts as impossible to connect to."""

_SECOND = 10**9


class RunningNodes(NamedTuple):
    """The running nodes by what they offer.

    Attributes:
        services: names of the nodes that offer each service.
        publishers: names of the nodes that publish each topic.
        interfaces: names of the other nodes that are the ROS interface of a node, by the name of that node.
    """

    services: Mapping[str, Set[str]]
    publishers: Mapping[str, Set[str]]
    interfaces: Mapping[str, Set[str]]


class ClientConnection(Protocol):
    """Connection of a command to the middleware of running nodes.

    Attributes:
        namespace: namespace of this shell, with a slash at its end.
        scope: where nodes are searched, as the end of an error; may be empty.
        end_of_time: seconds since the epoch from which on messages cannot contain an instant.
        format: serialization of messages.
    """

    namespace: str
    scope: str
    end_of_time: int
    format: SerializationFormat

    def resolve_node(self, name: str) -> str:
        """Return the full name of a node, which may be relative to the namespace."""

    def limit_discovery(self, seconds: float) -> None:
        """Wait at most some seconds, from now on, for nodes that the middleware discovers."""

    def find_nodes(self, requested_name: Optional[str] = None) -> RunningNodes:
        """Return the running nodes.

        Args:
            requested_name: full name of the node that is needed; None for any node. A middleware that discovers nodes
                one by one waits for it.

        Raises:
            UsageError: if the middleware does not answer.
        """

    def call(self, service: str, service_type: str, fields: Mapping[str, Any], max_seconds: float) -> Any:
        """Call a service of package ``retalis``.

        Args:
            service: full name of the service.
            service_type: name of its type, such as ``List`` for ``srv/List.srv``.
            fields: plain values of the request; missing fields are zero or empty, times are in nanoseconds.
            max_seconds: time limit for the response. A middleware with connections ignores it: they show whether the
                node still exists.

        Returns:
            An object with the fields of the response, in their order, in ``__dict__``. Nested messages are such
            objects, too; times and durations are integers in nanoseconds.

        Raises:
            UsageError: if the service does not answer.
        """

    def start_node(self, name: str) -> None:
        """Make this process a node that other nodes see.

        Args:
            name: beginning of the name of the node.
        """

    def subscribe(self, topic: str, receive: Callable[[str], object]) -> None:
        """Call a function with each text on a topic, in a thread of the middleware; needs `start_node`.

        Args:
            topic: full name of a topic of type ``std_msgs/String``.
            receive: receives the texts. While it waits, the middleware may drop further texts.
        """

    def installed_types(self, extra_folders: Sequence[str]) -> "InstalledTypes":
        """Return the message types that are installed for the middleware.

        Args:
            extra_folders: folders that are searched first, if the middleware can publish types that are not built.
        """

    def advertise(self, topic: str, definition: Definition) -> Callable[[bytes], object]:
        """Return the function that publishes serialized messages on a topic; needs `start_node`.

        This returns when a node that subscribes to the topic is connected.

        Raises:
            UsageError: if no node subscribes to the topic, or the type cannot be published.
        """

    def end(self) -> None:
        """End the connection."""


def find_engine_nodes(services: Mapping[str, Set[str]], include_interfaces: bool = False) -> List[str]:
    """Return the running nodes with an engine.

    Args:
        services: nodes that offer each service.
        include_interfaces: whether nodes that are only a ROS interface are included.
    """
    suffixes = (
        (ENGINE_SERVICE_SUFFIX, INTERFACE_SERVICE_SUFFIX) if include_interfaces else (ENGINE_SERVICE_SUFFIX,)
    )
    return sorted({node for name, nodes in services.items() if name.endswith(suffixes) for node in nodes})


class NodeClient:
    """Client of the services of a running node ``retalis``.

    Args:
        connection: connection to the middleware.
        requested_name: name of the node, relative to the namespace of the connection; by default the only one that
            runs in that namespace.
        include_interfaces: whether a node that is only a ROS interface may be named, too.

    Attributes:
        name: full name of the node.
        has_engine: whether the node has an engine.
        interfaces: names of the other nodes that are the ROS interface of this one.

    Raises:
        UsageError: if the middleware does not answer, or the node does not exist or is ambiguous.
    """

    def __init__(
        self,
        connection: ClientConnection,
        requested_name: Optional[str] = None,
        include_interfaces: bool = False,
    ):
        self._connection = connection
        full_name = None if requested_name is None else connection.resolve_node(requested_name)
        nodes = connection.find_nodes(full_name)
        self._services = nodes.services
        engine_nodes = find_engine_nodes(self._services)
        if full_name is None:
            self.name = _select_only_node(engine_nodes, connection)
        else:
            self.name = full_name
            named_nodes = find_engine_nodes(self._services, include_interfaces)
            _check_node(full_name, named_nodes, self._services, connection.scope)
        self.has_engine = self.name in engine_nodes
        self._reported_errors: Set[str] = set()
        # They send the subscriptions that their services add.
        self.interfaces = sorted(nodes.interfaces.get(self.name, ()))
        self.published_topics = sorted(
            topic for topic, publishers in nodes.publishers.items() if self.name in publishers
        )

    def report_once(self, error: UsageError) -> None:
        """Print an error that does not end the command, unless the same one was printed before."""
        if str(error) not in self._reported_errors:
            self._reported_errors.add(str(error))
            print(f"retalis: {error}", file=sys.stderr, flush=True)

    def call(self, service: str, service_type: str, **fields: Any) -> Any:
        """Call a service of the node; return the response.

        Args:
            service: private name of the service.
            service_type: name of its type.
            fields: fields of the request; see `ClientConnection.call`.

        Raises:
            UsageError: if the node does not offer the service, or does not answer.
        """
        name = f"{self.name}/{service}"
        if self.name not in self._services.get(name, ()):
            raise UsageError(
                f"node {self.name} has no service ~{service}: it is a ROS interface, or of an older version"
            )
        return self._call(name, service_type, fields)

    def call_relative_service(self, service: str, service_type: str, **fields: Any) -> Any:
        """Call a service of the node that is not private; see `call`.

        Its name is relative to the namespace of the node, and may be remapped. The service is therefore found by the
        end of its full name.
        """
        for name, nodes in self._services.items():
            if name.endswith(f"/{service}") and self.name in nodes:
                return self._call(name, service_type, fields)
        raise UsageError(f"node {self.name} has no service {service}")

    def _call(self, name: str, service_type: str, fields: Mapping[str, Any]) -> Any:
        max_seconds = MAX_RESPONSE_SECONDS + fields.get("seconds", 0.0) + fields.get("timeout", 0.0)
        return self._connection.call(name, service_type, fields, max_seconds)


def _check_node(name: str, nodes: List[str], services: Container[str], scope: str) -> None:
    """Check that a node of this package has a name.

    Raises:
        UsageError: if there is none.
    """
    if name not in nodes and f"{name}/list" not in services:
        # Each node of this package offers `list`, an interface node, too.
        raise UsageError(f"there is no node {name}; {_name_running_nodes(nodes, scope)}")


def _select_only_node(nodes: List[str], connection: ClientConnection) -> str:
    """Return the only node in the namespace of a connection.

    Raises:
        UsageError: if there are none or several.
    """
    namespace, scope = connection.namespace, connection.scope
    in_namespace = [name for name in nodes if name.startswith(namespace)]
    if len(in_namespace) == 1:
        return in_namespace[0]
    if in_namespace:
        raise UsageError(f"which node? {_name_running_nodes(in_namespace, scope)}; choose one by --node")
    if nodes:
        raise UsageError(
            f"no node retalis runs in namespace {namespace[:-1]} (ROS_NAMESPACE); "
            f"{_name_running_nodes(nodes, scope)}"
        )
    raise UsageError(_name_running_nodes(nodes, scope))


def _name_running_nodes(nodes: List[str], scope: str) -> str:
    return f"those that run are {', '.join(nodes)}" if nodes else f"no node retalis runs{scope}"


def require_ok(response: Any) -> Any:
    """Return a response if its result is ``ok``.

    Raises:
        UsageError: with the reason in the result.
    """
    if response.result != "ok":
        raise UsageError(response.result[len("error: ") :])
    return response


def make_dictionary(response: Any) -> Dict[str, Any]:
    """Return a response as dictionaries, lists and plain values; times in seconds, absent ones as None."""
    return {field: _make_plain(field, value) for field, value in vars(response).items()}


def _make_plain(field: str, value: Any) -> Any:
    if field in TIME_FIELDS:
        return _to_seconds(value) if value else None
    if field in DURATION_FIELDS:
        return None if value == NO_DURATION else _to_seconds(value)
    if isinstance(value, list):
        return [_make_plain("", item) for item in value]
    return make_dictionary(value) if hasattr(value, "__dict__") else value


def _to_seconds(nanoseconds: int) -> float:
    # Added as ROS does it, which is not always the nearest number.
    seconds, remainder = divmod(nanoseconds, _SECOND)
    return seconds + remainder / _SECOND


def decode_solutions(response: Any) -> Iterator[Dict[str, Any]]:
    """Yield the solutions of a response as dictionaries from variable names to plain values."""
    for solution in response.solutions:
        yield decode_bindings(solution.bindings)


def print_json_solutions(response: Any) -> None:
    """Print each solution of a response as a line of JSON."""
    for solution in decode_solutions(response):
        print_json(solution)


def format_solutions(response: Any) -> Iterator[str]:
    """Yield the solutions of a response in the form of a Prolog top level."""
    for solution in response.solutions:
        yield ", ".join(f"{binding.name} = {binding.text}" for binding in solution.bindings) or "true"
