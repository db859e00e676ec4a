"""Calls of services through clients of rclpy, with serialized requests and responses."""

import threading
from collections import Counter, OrderedDict
from time import monotonic, sleep
from typing import TYPE_CHECKING, Any, Tuple

from rclpy.callback_groups import CallbackGroup
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.task import Future

from ..engine.service_calls import MAX_CALLS_UNDER_WAY, ServiceCall
from ..foundation.displayed_text import shorten
from ..foundation.errors import MessageError
from ..foundation.ros_name_checks import ros1_type_name
from .installed_interfaces import InstalledInterfaces

if TYPE_CHECKING:
    from rclpy.client import Client

MAX_CLIENTS = 2 * MAX_CALLS_UNDER_WAY
"""Maximum number of clients; beyond it the one whose last call is the oldest is destroyed, unless it has a call.

It is larger than the number of calls under way, so there is always one without a call.
"""

DISCOVERY_SECONDS = 1.0
"""Seconds for which the first call of a service waits for its node."""

_POLL_SECONDS = 0.02


class RclpyServiceCalls:
    """Calls of services, with one client for each service.

    Args:
        interfaces: the installed types.
        group: group of the clients, whose callbacks may overlap.
    """

    def __init__(self, node: Node, interfaces: InstalledInterfaces, group: CallbackGroup):
        self._node = node
        self._interfaces = interfaces
        self._group = group
        self._lock = threading.Lock()
        self._clients: OrderedDict[Tuple[str, str], Client] = OrderedDict()
        self._call_counts: Counter[Client] = Counter()
        """Number of calls under way by client."""

    def call_service(self, name: str, call: ServiceCall) -> None:
        """Call a service, after waiting for its discovery; see `Transport.call_service`."""
        try:
            self._send(name, call)
        except MessageError as error:
            call.fail(error.message)
        except (RuntimeError, InvalidHandle) as error:
            # The node is ending, or a middleware refuses a second type in one process.
            reason = f"it cannot be called: {shorten(str(error).partition(', at ')[0])}"
            call.fail(self._explain_other_type(name, call.request.type) or reason)

    def _send(self, name: str, call: ServiceCall) -> None:
        service_class = self._interfaces.service_class(call.request.type)
        client = self._acquire_client(name, call.request.type, service_class)
        call.on_end(lambda: self._release_client(client))
        end = monotonic() + DISCOVERY_SECONDS
        while not client.service_is_ready():
            if call.is_ended:
                return
            if monotonic() > end:
                call.fail(self._explain_other_type(name, call.request.type) or "no node offers it")
                return
            sleep(_POLL_SECONDS)
        # The service may have been discovered after the time limit: the program no longer expects it to act.
        if call.is_ended:
            return
        future = client.call_async(deserialize_message(call.request.data, service_class.Request))
        # Without a response, the client would keep the request until its own end.
        call.on_end(lambda: client.remove_pending_request(future))
        future.add_done_callback(lambda answer: _finish(call, answer))

    def _acquire_client(self, name: str, type_name: str, service_class: Any) -> "Client":
        """Return the client of a service, a new one if there is none; it exists until `_release_client`."""
        key = name, type_name
        with self._lock:
            client = self._clients.get(key)
            if client is None:
                client = self._node.create_client(service_class, name, callback_group=self._group)
                self._clients[key] = client
            self._clients.move_to_end(key)
            self._call_counts[client] += 1
            if len(self._clients) > MAX_CLIENTS:
                self._destroy_oldest_client()
            return client

    def _release_client(self, client: "Client") -> None:
        with self._lock:
            self._call_counts[client] -= 1
            if not self._call_counts[client]:
                del self._call_counts[client]

    def _destroy_oldest_client(self) -> None:
        for key, client in self._clients.items():
            if client not in self._call_counts:
                del self._clients[key]
                self._node.destroy_client(client)
                return

    def _explain_other_type(self, name: str, type_name: str) -> str:
        """Return the reason for a service that has another type, or ""."""
        types = dict(self._node.get_service_names_and_types()).get(name, [])
        others = sorted({ros1_type_name(other) for other in types} - {type_name})
        return f"it has the type {others[0]}, not {type_name}" if others else ""


def _finish(call: ServiceCall, answer: Future) -> None:
    """End a call with the response of a future that is done."""
    response = answer.result()
    if response is not None:
        call.reply(serialize_message(response))
