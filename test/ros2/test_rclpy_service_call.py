"""Calls of services through the transport of ROS 2."""

import threading
from typing import Any, Callable, Iterable, Iterator, List

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed")
pytest.importorskip("retalis.srv", reason="the classes of this package's services have not been generated")

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future
from ros2.rclpy_nodes import TIMEOUT_SECONDS, Network, wait_until
from std_srvs.srv import SetBool, Trigger

from retalis import Clock, Definitions, Engine, UsageError
from retalis.engine.service_calls import ServiceCall
from retalis.messages.type_definition import SerializationFormat
from retalis.node.service_caller import ServiceCaller
from retalis.ros2.installed_interfaces import InstalledInterfaces
from retalis.ros2.rclpy_service_call import MAX_CLIENTS, RclpyServiceCalls
from retalis.ros2.rclpy_transport import MAX_CONCURRENT_REQUESTS
from retalis.srv import Query


@pytest.fixture
def network(domain: int) -> Iterator[Network]:
    network = Network()
    yield network
    network.close()


class CallingEngine:
    """An engine that calls services through a transport.

    Attributes:
        events: texts of its events, without those of calls.
    """

    def __init__(self, network: Network, **parameters: Any) -> None:
        self.events: List[str] = []
        self.transport = network.add_transport(**parameters)
        self._engine = Engine(Clock(), definitions=Definitions(self.transport.installed_types()))
        self._engine.on_service_call(ServiceCaller(self.transport, ["*"]).call, self.transport.format)
        self._engine.on_event(self._record_end)

    def _record_end(self, term: Any, start: int, end: int) -> None:
        if term[0].name != "service_call":
            self.events.append(self._engine.show(term))

    def call(self, name: str, service_type: str, request: str, options: str = "[]") -> str:
        """Call a service, and return the event of its end."""
        count = len(self.events)
        assert self._engine.call(f"ros_service('{name}', '{service_type}', {request}, a, {options})")
        return str(wait_until(lambda: self.events[count:])[0])


def test_reply_of_service_is_an_event(network: Network) -> None:
    def lift(request: Any, response: Any) -> Any:
        response.success, response.message = request.data, "up"
        return response

    network.add_node().create_service(SetBool, "/arm", lift)
    calling = CallingEngine(network)
    reply = """service_reply(arm,a,std_srvs__0__SetBool_Response(true,'"up"'))"""
    for service_type in ("std_srvs/SetBool", "std_srvs/srv/SetBool"):
        assert calling.call("arm", service_type, "std_srvs__0__SetBool_Request(true)") == reply


def test_failures_of_services_have_reasons(network: Network) -> None:
    ended = threading.Event()

    def wait(request: Any, response: Any) -> Any:
        ended.wait(30)
        return response

    peer = network.add_node()
    peer.create_service(Trigger, "/slow", wait, callback_group=ReentrantCallbackGroup())
    calling = CallingEngine(network)
    trigger = ("std_srvs/Trigger", "std_srvs__0__Trigger_Request")
    wait_until(lambda: "/slow" in dict(calling.transport._node.get_service_names_and_types()))  # noqa: SLF001
    slow = calling.call("/slow", *trigger, "[timeout(0.2)]")
    ended.set()
    assert slow == "service_failed('/slow',a,'no reply within 0.2 s')"
    assert calling.call("/missing", *trigger) == "service_failed('/missing',a,'no node offers it')"
    assert calling.call("/slow", "std_srvs/Empty", "std_srvs__0__Empty_Request") == (
        "service_failed('/slow',a,'it has the type std_srvs/Trigger, not std_srvs/Empty')"
    )


def test_names_of_services_are_resolved(network: Network) -> None:
    transport = network.add_transport()
    assert transport.resolve_service("~arm") == "/retalis/arm"
    with pytest.raises(UsageError):
        transport.resolve_service("a b")


def test_parameters_of_node_are_read(network: Network) -> None:
    parameters: Any = {"limit": 40.5, "arm.joints": ["a", "b"], "arm.gain": 2}
    transport = network.add_transport(**parameters)
    for name in ("limit", "~limit", "/limit"):
        assert transport.ros_parameter(name) == 40.5
    assert transport.ros_parameter("/arm/gain") == transport.ros_parameter("arm.gain") == 2
    assert transport.ros_parameter("arm") == {"joints": ["a", "b"], "gain": 2}
    with pytest.raises(KeyError):
        transport.ros_parameter("/unknown")


class FakeClient:
    """A client of rclpy whose service is ready, and never answers."""

    def __init__(self, name: str, on_search: Callable[[], object]) -> None:
        self.name, self._on_search = name, on_search
        self.requests: List[Any] = []

    def service_is_ready(self) -> bool:
        self._on_search()
        return True

    def call_async(self, request: Any) -> Any:
        self.requests.append(request)
        return Future()

    def remove_pending_request(self, future: Any) -> None:
        pass


class FakeNode:
    """A node of rclpy.

    Attributes:
        clients: its clients, also those that it has destroyed.
        destroyed: names of the services of these.
    """

    def __init__(self, on_search: Callable[[], object] = lambda: None) -> None:
        self.clients: List[FakeClient] = []
        self.destroyed: List[str] = []
        self._on_search = on_search

    def create_client(self, service_class: Any, name: str, **options: Any) -> FakeClient:
        client = FakeClient(name, self._on_search)
        self.clients.append(client)
        return client

    def destroy_client(self, client: FakeClient) -> None:
        self.destroyed.append(client.name)


def call_services(node: Any, names: Iterable[str], calls: List[ServiceCall]) -> None:
    """Call services through clients of a node; the calls are added to a list."""
    service_calls = RclpyServiceCalls(node, InstalledInterfaces(), ReentrantCallbackGroup())
    engine = Engine(Clock(), definitions=Definitions(InstalledInterfaces()))

    def call_service(call: ServiceCall) -> None:
        calls.append(call)
        service_calls.call_service(call.request.name, call)
        if call.request.name != "/long":
            call.fail("no reply within 5 s")

    engine.on_service_call(call_service, SerializationFormat.CDR)
    for name in names:
        assert engine.call(f"ros_service('{name}', 'std_srvs/Trigger', std_srvs__0__Trigger_Request, a)")


def test_client_with_call_is_not_destroyed() -> None:
    node = FakeNode()
    call_services(node, ["/long", *(f"/short{number}" for number in range(MAX_CLIENTS + 1))], [])
    assert node.destroyed == ["/short0", "/short1"]


def test_request_is_not_sent_after_end_of_call() -> None:
    calls: List[ServiceCall] = []
    node = FakeNode(on_search=lambda: calls[0].fail("no reply within 1 s"))
    call_services(node, ["/arm"], calls)
    assert [client.requests for client in node.clients] == [[]]


def test_calls_do_not_occupy_threads_of_requests(network: Network, monkeypatch: pytest.MonkeyPatch) -> None:
    resumed = threading.Event()
    monkeypatch.setattr(RclpyServiceCalls, "call_service", lambda calls, name, call: resumed.wait(60))
    transport = network.add_transport()
    engine = Engine(Clock(), definitions=Definitions(transport.installed_types()))
    engine.on_service_call(ServiceCaller(transport, ["*"]).call, transport.format)
    for number in range(MAX_CONCURRENT_REQUESTS):
        assert engine.call(
            f"ros_service('/missing', 'std_srvs/Trigger', std_srvs__0__Trigger_Request, {number})"
        )
    transport.offer_service("~query", "Query", lambda request: {"result": "ok"})
    client = network.add_node().create_client(Query, "/retalis/query")
    assert client.wait_for_service(TIMEOUT_SECONDS)
    future = client.call_async(Query.Request())
    wait_until(future.done)
    resumed.set()
