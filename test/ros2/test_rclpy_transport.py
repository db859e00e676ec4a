"""rclpy as a transport: topics, time, services, parameters and the graph, with other nodes of rclpy."""

import threading
import time
from functools import partial
from types import SimpleNamespace
from typing import AbstractSet, Any, Iterator, List, Optional, Sequence

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed")
pytest.importorskip("retalis.srv", reason="the classes of this package's services have not been generated")

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_services_default
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.service_introspection import ServiceIntrospectionState
from ros2.rclpy_nodes import TIMEOUT_SECONDS, Network, RecordingReceiver, wait_until
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

from retalis import Reports, UsageError
from retalis.events.program.topic_configuration import QualityOfService
from retalis.foundation.errors import MessageError
from retalis.messages.type_registry import Definitions
from retalis.node.subscribed_topics import list_endpoints
from retalis.node.transport import MessageSource, NodeGraph
from retalis.ros2 import message_intake, rclpy_transport, topic_subscription
from retalis.ros2.rclpy_transport import RclpyTransport, RequestThreads
from retalis.ros2.ros_clock import replace_clock_subscription
from retalis.srv import Query

SECOND = 10**9
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
TRANSIENT_LOCAL = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture
def network(domain: int) -> Iterator[Network]:
    network = Network()
    yield network
    network.close()


def make_text(text: str) -> bytes:
    return bytes(serialize_message(String(data=text)))


def read_texts(messages: List[bytes]) -> List[str]:
    return [deserialize_message(message, String).data for message in messages]


def subscribe(transport: Any, receiver: RecordingReceiver, **options: Any) -> Any:
    return transport.subscribe("/texts", "std_msgs/String", receiver.connect, 100, **options)


def test_messages_have_time_of_reception(network: Network) -> None:
    transport = network.add_transport()
    receiver = RecordingReceiver()
    subscribe(transport, receiver)
    publisher = network.add_node().create_publisher(String, "texts", 10)
    wait_until(publisher.get_subscription_count)
    before = time.time_ns()
    publisher.publish(String(data="a"))
    wait_until(lambda: receiver.messages)
    after = time.time_ns()
    (received,) = receiver.received
    assert before <= received <= after


def find_graph(transport: RclpyTransport) -> NodeGraph:
    """Return the graph as soon as it contains the topic of the tests."""

    def find() -> Optional[NodeGraph]:
        graph = transport.graph()
        return graph if graph is not None and "/texts" in graph.types else None

    graph: NodeGraph = wait_until(find)
    return graph


def advertise(transport: Any, **options: Any) -> Any:
    definition = Definitions(transport.installed_types()).find("std_msgs/String")
    return transport.advertise("/texts", definition, 100, **options)


# ---- subscriptions


def test_message_of_other_node_is_received(network: Network) -> None:
    transport, receiver = network.add_transport(), RecordingReceiver()
    subscription = subscribe(transport, receiver)
    publisher = network.add_node().create_publisher(String, "texts", 10)
    wait_until(lambda: subscription.publisher_count() and publisher.get_subscription_count())
    publisher.publish(String(data="hello"))
    wait_until(lambda: receiver.messages)
    assert read_texts(receiver.messages) == ["hello"]
    assert receiver.source.message_type == "std_msgs/String"
    assert receiver.source.node == "/peer"


def test_messages_keep_their_order(network: Network) -> None:
    transport, receiver = network.add_transport(), RecordingReceiver()
    subscribe(transport, receiver)
    publisher = network.add_node().create_publisher(String, "texts", 100)
    wait_until(publisher.get_subscription_count)
    texts = [str(number) for number in range(50)]
    for text in texts:
        publisher.publish(String(data=text))
    wait_until(lambda: len(receiver.messages) == len(texts))
    assert read_texts(receiver.messages) == texts


def test_type_that_is_not_installed_is_refused(network: Network) -> None:
    transport = network.add_transport()
    with pytest.raises(MessageError, match="ar_pose/ARMarkers is not installed"):
        transport.subscribe("/markers", "ar_pose/ARMarkers", RecordingReceiver().connect, 10)


def test_best_effort_publisher_is_read(network: Network) -> None:
    publisher = network.add_node().create_publisher(String, "texts", BEST_EFFORT)
    transport, receiver = network.add_transport(), RecordingReceiver()
    find_graph(transport)
    subscribe(transport, receiver)
    wait_until(publisher.get_subscription_count)
    publisher.publish(String(data="hello"))
    wait_until(lambda: receiver.messages)
    assert network.reports.texts == []


def test_quality_follows_publisher_that_appears_later(network: Network) -> None:
    transport, receiver = network.add_transport(), RecordingReceiver()
    subscribe(transport, receiver)
    publisher = network.add_node().create_publisher(String, "texts", BEST_EFFORT)
    wait_until(publisher.get_subscription_count)
    publisher.publish(String(data="hello"))
    # The change is reported after the new subscription may receive messages.
    wait_until(lambda: receiver.messages and network.reports.texts)
    assert network.reports.texts == [
        "topic /texts: read as best effort, volatile, before as reliable, volatile: "
        "published by /peer (best effort, volatile)"
    ]


def test_demanded_quality_is_kept(network: Network) -> None:
    node = network.add_node()
    publisher = node.create_publisher(String, "texts", BEST_EFFORT)
    transport, receiver = network.add_transport(), RecordingReceiver()
    find_graph(transport)
    subscribe(transport, receiver, quality=QualityOfService(is_reliable=True))
    wait_until(lambda: network.reports.texts)
    assert network.reports.texts == [
        "topic /texts: nothing is received from /peer (best effort, volatile): pub_sub.xml demands reliable, "
        "volatile; leave out reliability and durability there, or have the node offer more"
    ]
    assert publisher.get_subscription_count() == 0


def test_demanded_quality_is_published(network: Network) -> None:
    transport = network.add_transport()
    advertise(transport, quality=QualityOfService(False, True, 7))
    node = network.add_node()
    (endpoint,) = wait_until(lambda: node.get_publishers_info_by_topic("/texts"))
    profile = endpoint.qos_profile
    assert (profile.reliability, profile.durability) == (
        ReliabilityPolicy.BEST_EFFORT,
        DurabilityPolicy.TRANSIENT_LOCAL,
    )


def test_last_message_of_transient_local_publisher_is_received_once(network: Network) -> None:
    publisher = network.add_node().create_publisher(String, "texts", TRANSIENT_LOCAL)
    publisher.publish(String(data="map"))
    transport, receiver = network.add_transport(), RecordingReceiver()
    find_graph(transport)
    subscribe(transport, receiver)
    wait_until(lambda: receiver.messages)
    publisher.publish(String(data="new map"))
    wait_until(lambda: len(receiver.messages) > 1)
    assert read_texts(receiver.messages) == ["map", "new map"]


def test_message_is_not_repeated_after_change_of_quality(network: Network) -> None:
    transport, receiver = network.add_transport(), RecordingReceiver()
    subscribe(transport, receiver)
    # Without a publisher the subscription is volatile, and may receive the message before and after its change.
    publisher = network.add_node().create_publisher(String, "texts", TRANSIENT_LOCAL)
    wait_until(publisher.get_subscription_count)
    publisher.publish(String(data="map"))
    wait_until(lambda: network.reports.texts and publisher.get_subscription_count() == 1)
    publisher.publish(String(data="new map"))
    wait_until(lambda: len(receiver.messages) > 1)
    assert read_texts(receiver.messages) == ["map", "new map"]


def test_own_messages_are_ignored(network: Network) -> None:
    transport, receiver = network.add_transport(), RecordingReceiver()
    subscribe(transport, receiver, ignores_own=True)
    publication = advertise(transport)
    texts: List[str] = []
    peer = network.add_node()
    peer.create_subscription(String, "texts", lambda message: texts.append(message.data), 10)
    publisher = peer.create_publisher(String, "texts", 10)
    wait_until(lambda: publisher.get_subscription_count() == 2)
    wait_until(lambda: publication.subscriber_count() == 1)
    publication.send(make_text("own"))
    wait_until(lambda: texts == ["own"])
    publisher.publish(String(data="of another node"))
    wait_until(lambda: receiver.messages and len(texts) == 2)
    assert read_texts(receiver.messages) == ["of another node"]


def test_text_of_other_node_that_equals_own_one_is_received(network: Network) -> None:
    transport, receiver = network.add_transport(), RecordingReceiver()
    subscribe(transport, receiver, ignores_own=True)
    publication = advertise(transport)
    texts: List[str] = []
    peer = network.add_node()
    peer.create_subscription(String, "texts", lambda message: texts.append(message.data), 10)
    publisher = peer.create_publisher(String, "texts", 10)
    wait_until(lambda: publisher.get_subscription_count() == 2)
    publication.send(make_text("same"))
    wait_until(lambda: texts == ["same"])
    publisher.publish(String(data="same"))
    wait_until(lambda: receiver.messages)
    assert read_texts(receiver.messages) == ["same"]


def test_closed_subscription_receives_nothing(network: Network) -> None:
    transport, receiver = network.add_transport(), RecordingReceiver()
    subscription = subscribe(transport, receiver)
    publisher = network.add_node().create_publisher(String, "texts", 10)
    wait_until(publisher.get_subscription_count)
    subscription.close()
    wait_until(lambda: not publisher.get_subscription_count())
    publisher.publish(String(data="late"))
    assert subscription.publisher_count() == 0
    assert receiver.messages == []


def test_subscription_that_is_closed_after_change_of_quality_receives_nothing(network: Network) -> None:
    transport, receiver = network.add_transport(), RecordingReceiver()
    subscription = subscribe(transport, receiver)
    publisher = network.add_node().create_publisher(String, "texts", BEST_EFFORT)
    wait_until(lambda: publisher.get_subscription_count() and network.reports.texts)
    subscription.close()
    wait_until(lambda: not publisher.get_subscription_count())
    publisher.publish(String(data="late"))
    assert receiver.messages == []


def test_losses_of_one_among_several_publishers_are_counted(network: Network) -> None:
    transport, receiver = network.add_transport(), RecordingReceiver()
    subscription = subscribe(transport, receiver)
    node = network.add_node()
    publishers = [node.create_publisher(String, "texts", 10) for _ in range(2)]
    wait_until(lambda: subscription.publisher_count() == 2)
    for number in range(20):
        publishers[number % 2].publish(String(data=str(number)))
    wait_until(lambda: len(receiver.messages) == 20)
    assert receiver.lost == 0


def test_each_warning_is_logged(network: Network, caplog: pytest.LogCaptureFixture) -> None:
    transport = network.add_transport(reports=Reports())
    node = network.add_node()
    for number in range(4):
        transport.subscribe(f"/t{number}", "std_msgs/String", RecordingReceiver().connect, 10)
    publishers = [node.create_publisher(String, f"t{number}", BEST_EFFORT) for number in range(4)]
    # A publisher finds the new subscription before the change is reported.
    wait_until(lambda: len(caplog.records) == len(publishers))
    changed = [record.getMessage()[: len("topic /t0")] for record in caplog.records]
    assert sorted(changed) == ["topic /t0", "topic /t1", "topic /t2", "topic /t3"]


def test_lost_messages_are_counted(network: Network) -> None:
    transport, receiver = network.add_transport(), RecordingReceiver()
    is_released = threading.Event()
    record = receiver.receive

    def receive_slowly(
        messages: List[bytes], received: Sequence[int] = (), identities: Sequence[Any] = ()
    ) -> None:
        record(messages)
        is_released.wait()

    receiver.receive = receive_slowly  # type: ignore[method-assign]
    transport.subscribe("/texts", "std_msgs/String", receiver.connect, 5)
    publisher = network.add_node().create_publisher(String, "texts", 200)
    wait_until(publisher.get_subscription_count)
    publisher.publish(String(data="first"))
    wait_until(lambda: receiver.messages)
    for number in range(100):
        publisher.publish(String(data=str(number)))
    is_released.set()
    wait_until(lambda: len(receiver.messages) + receiver.lost == 101)
    assert receiver.lost > 0


def test_message_of_next_publisher_is_no_loss(network: Network) -> None:
    transport, receiver = network.add_transport(), RecordingReceiver()
    subscription = subscribe(transport, receiver)
    node = network.add_node()
    first = node.create_publisher(String, "texts", 10)
    wait_until(lambda: subscription.publisher_count() == 1 and first.get_subscription_count())
    first.publish(String(data="a"))
    second = node.create_publisher(String, "texts", 10)
    wait_until(lambda: subscription.publisher_count() == 2 and second.get_subscription_count())
    for number in range(10):
        second.publish(String(data=str(number)))
    wait_until(lambda: len(receiver.messages) == 11)
    node.destroy_publisher(first)
    wait_until(lambda: subscription.publisher_count() == 1)
    second.publish(String(data="b"))
    wait_until(lambda: len(receiver.messages) == 12)
    assert receiver.lost == 0


def test_executor_reads_messages_without_wait_set(network: Network, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(message_intake, "rclpy_implementation", SimpleNamespace())
    transport, receiver = network.add_transport(), RecordingReceiver()
    subscription = subscribe(transport, receiver)
    publisher = network.add_node().create_publisher(String, "texts", 10)
    wait_until(lambda: subscription.publisher_count() and publisher.get_subscription_count())
    publisher.publish(String(data="hello"))
    wait_until(lambda: receiver.messages)
    assert read_texts(receiver.messages) == ["hello"]


# ---- publications


def test_sent_message_is_received_by_other_node(network: Network) -> None:
    texts: List[str] = []
    network.add_node().create_subscription(String, "texts", lambda message: texts.append(message.data), 10)
    publication = advertise(network.add_transport())
    publication.send(make_text("hello"))
    wait_until(lambda: texts)
    assert texts == ["hello"]
    assert (publication.sent, publication.dropped) == (1, 0)


def test_message_directly_after_another_is_not_delayed(
    network: Network, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(message_intake, "BATCH_SECONDS", 10 * TIMEOUT_SECONDS)
    receiver = RecordingReceiver()
    subscribe(network.add_transport(), receiver)
    publisher = network.add_node().create_publisher(String, "texts", 100)
    wait_until(publisher.get_subscription_count)
    for number in range(0, 20, 2):
        publisher.publish(String(data="image"))
        # Otherwise both are read at once.
        time.sleep(0.001)
        publisher.publish(String(data="parameters"))
        wait_until(lambda: len(receiver.messages) == number + 2)  # noqa: B023
        # The rate of a camera.
        time.sleep(0.03)


def test_messages_at_high_rate_are_read_in_batches(network: Network, monkeypatch: pytest.MonkeyPatch) -> None:
    pauses: List[float] = []
    clock = SimpleNamespace(monotonic=time.monotonic, sleep=pauses.append)
    monkeypatch.setattr(message_intake, "time", clock)
    subscribe(network.add_transport(), RecordingReceiver())
    publisher = network.add_node().create_publisher(String, "texts", 1000)

    def publish() -> bool:
        for _ in range(20):
            publisher.publish(String(data="scan"))
        return message_intake.BATCH_SECONDS in pauses

    wait_until(publish)


def test_repeated_message_has_the_same_identity(network: Network) -> None:
    publisher = network.add_node().create_publisher(String, "texts", TRANSIENT_LOCAL)
    publisher.publish(String(data="map"))
    receivers = [RecordingReceiver() for _ in range(2)]
    for number, receiver in enumerate(receivers):
        subscribe(network.add_transport(f"retalis{number}"), receiver)
        wait_until(lambda: receiver.messages)  # noqa: B023 - called at once
    # An equal message that is sent again.
    publisher.publish(String(data="map"))
    wait_until(lambda: all(len(receiver.messages) == 2 for receiver in receivers))
    first, second = receivers
    assert first.identities == second.identities
    assert first.identities[0] != first.identities[1]


def test_messages_that_are_not_repeated_have_no_identity(network: Network) -> None:
    publisher = network.add_node().create_publisher(String, "texts", 10)
    receiver = RecordingReceiver()
    transport = network.add_transport()
    find_graph(transport)
    subscribe(transport, receiver)
    wait_until(publisher.get_subscription_count)
    publisher.publish(String(data="scan"))
    wait_until(lambda: receiver.messages)
    assert receiver.identities == []


def test_latched_message_reaches_late_subscriber(network: Network) -> None:
    publication = advertise(network.add_transport(), is_latched=True)
    publication.send(make_text("old map"))
    publication.send(make_text("map"))
    texts: List[str] = []
    network.add_node().create_subscription(
        String, "texts", lambda message: texts.append(message.data), TRANSIENT_LOCAL
    )
    wait_until(lambda: "map" in texts)
    assert publication.subscriber_count() == 1


def test_nothing_is_sent_after_shutdown(network: Network) -> None:
    transport = network.add_transport()
    publication = advertise(transport)
    transport.shut_down()
    publication.send(make_text("late"))
    assert publication.sent == 0


# ---- names


@pytest.mark.parametrize(
    ("name", "full_name"),
    [
        ("texts", "/texts"),
        ("/a/texts", "/a/texts"),
        ("~texts", "/retalis/texts"),
        ("~/texts", "/retalis/texts"),
    ],
)
def test_topic_is_resolved(network: Network, name: str, full_name: str) -> None:
    assert network.add_transport().resolve_topic(name) == full_name


@pytest.mark.parametrize(
    ("remapping", "full_name"),
    [
        ("unused:=other", "/robot/dock/_service_event"),
        ("dock:=station", "/robot/station/_service_event"),
        ("rosservice://dock:=/base/dock", "/base/dock/_service_event"),
        ("rostopic://dock:=other", "/robot/dock/_service_event"),
        ("dock/_service_event:=recorded", "/robot/recorded"),
    ],
)
def test_topic_of_service_follows_remapped_service(network: Network, remapping: str, full_name: str) -> None:
    peer = network.add_node(cli_args=["--ros-args", "-r", "__ns:=/robot", "-r", remapping])
    service = peer.create_service(Query, "dock", lambda request, response: response)
    service.configure_introspection(
        peer.get_clock(), qos_profile_services_default, ServiceIntrospectionState.METADATA
    )
    transport = network.add_transport(remappings=["__ns:=/robot", remapping])
    assert transport.resolve_topic("dock/_service_event") == full_name
    assert [name for name, _ in peer.get_topic_names_and_types() if name == full_name] == [full_name]


@pytest.mark.parametrize(
    ("remapping", "full_name"),
    [
        ("dock:=/base/dock", "/base/dock/_action/send_goal/_service_event"),
        ("dock/_action/send_goal:=station/send_goal", "/robot/station/send_goal/_service_event"),
    ],
)
def test_topic_of_action_follows_remapped_action(network: Network, remapping: str, full_name: str) -> None:
    transport = network.add_transport(remappings=["__ns:=/robot", remapping])
    (endpoint,) = list_endpoints("dock/goal", "lab/Dock__goal", transport)
    assert endpoint.topic == full_name


@pytest.mark.parametrize("name", ["", "/", "two words", "a//b", "/1st", "ä", "1st/_service_event"])
def test_invalid_topic_is_refused(network: Network, name: str) -> None:
    transport = network.add_transport()
    with pytest.raises(UsageError):
        transport.resolve_topic(name)


# ---- services


def test_service_answers(network: Network) -> None:
    transport = network.add_transport()
    requests: List[Any] = []

    def handle(request: Any) -> Any:
        requests.append(request)
        return {
            "result": "ok",
            "complete": True,
            "solutions": [{"bindings": [{"name": "X", "text": "1"}]}],
        }

    transport.offer_service("~query", "Query", handle)
    client = network.add_node().create_client(Query, "/retalis/query")
    assert client.wait_for_service(60)
    request = Query.Request(goal="true")
    request.stamp.sec, request.stamp.nanosec = 5, 7
    future = client.call_async(request)
    wait_until(future.done)
    response = future.result()
    assert requests[0].goal == "true"
    assert requests[0].stamp == 5 * SECOND + 7
    assert response.result == "ok"
    assert [binding.text for binding in response.solutions[0].bindings] == ["1"]


def test_error_of_handler_is_answered(network: Network) -> None:
    transport = network.add_transport()
    transport.offer_service("~query", "Query", lambda request: {"result": 1 // 0})
    client = network.add_node().create_client(Query, "/retalis/query")
    assert client.wait_for_service(60)
    future = client.call_async(Query.Request())
    wait_until(future.done)
    assert future.result().result == "error: internal error; the log of the node has the details"
    assert network.reports.texts == ["integer division or modulo by zero"]


def test_waiting_request_does_not_block_others(network: Network) -> None:
    transport = network.add_transport()
    is_released = threading.Event()

    def handle(request: Any) -> Any:
        if request.goal == "wait":
            is_released.wait()
        return {"result": request.goal}

    transport.offer_service("~query", "Query", handle)
    node = network.add_node()
    client = node.create_client(Query, "/retalis/query", callback_group=ReentrantCallbackGroup())
    assert client.wait_for_service(60)
    waiting = client.call_async(Query.Request(goal="wait"))
    other = client.call_async(Query.Request(goal="other"))
    wait_until(other.done)
    assert not waiting.done()
    is_released.set()
    wait_until(waiting.done)
    assert (waiting.result().result, other.result().result) == ("wait", "other")


def test_name_of_source_is_that_of_present_publisher(
    network: Network, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(topic_subscription, "CHECK_SECONDS", 0.02)
    transport = network.add_transport()
    sources: List[str] = []
    receiver = RecordingReceiver()

    def connect(source: MessageSource) -> RecordingReceiver:
        sources.append(source.node)
        return receiver

    subscription = transport.subscribe("/texts", "std_msgs/String", connect, 100)
    for name in ("first", "second"):
        node = network.add_node(name)
        publisher = node.create_publisher(String, "texts", 10)
        wait_until(publisher.get_subscription_count)
        # The change of publishers is noticed after a while.
        wait_until(lambda: publisher.publish(String(data=name)) or f"/{name}" in sources)  # noqa: B023 - called at once
        network.remove_node(node)
        wait_until(lambda: not subscription.publisher_count())
    assert [name for name in sources if name] == ["/first", "/second"]


def test_requests_beyond_limit_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rclpy_transport, "MAX_CONCURRENT_REQUESTS", 2)
    monkeypatch.setattr(rclpy_transport, "MAX_WAITING_REQUESTS", 3)
    threads = RequestThreads()
    is_ended = threading.Event()
    answers: List[int] = []

    def answer(number: int) -> None:
        is_ended.wait()
        answers.append(number)

    for number in range(5):
        threads.submit(partial(answer, number))
    with pytest.raises(UsageError, match="2 requests are running and 3 are waiting: send this one later"):
        threads.submit(is_ended.wait)
    is_ended.set()
    wait_until(lambda: len(answers) == 5)
    threads.submit(partial(answer, 5))
    wait_until(lambda: 5 in answers)
    threads.stop()


# ---- parameters and graph


def test_parameters_are_plain_values(network: Network) -> None:
    transport = network.add_transport(
        queue=10, direct=["tf", "tf2_msgs/TFMessage"], max_seconds=0.5, explain=True, program="/p"
    )
    assert transport.parameters() == {
        "queue": 10,
        "direct": ["tf", "tf2_msgs/TFMessage"],
        "max_seconds": 0.5,
        "explain": True,
        "program": "/p",
    }


def test_graph_has_topics_and_services_of_all_nodes(network: Network) -> None:
    transport = network.add_transport()
    transport.offer_service("~query", "Query", lambda request: {})
    network.add_node().create_publisher(String, "texts", 10)
    graph = find_graph(transport)
    assert graph.types["/texts"] == "std_msgs/String"
    assert graph.publishers["/texts"] == {"/peer"}
    assert graph.servers["/retalis/query"] == {"/retalis"}


def test_graph_has_publisher_and_subscriber_that_cannot_connect(network: Network) -> None:
    transport = network.add_transport()
    network.add_node("camera").create_publisher(String, "texts", BEST_EFFORT)
    network.add_node("reader").create_subscription(String, "texts", lambda message: None, 10)
    mismatches = wait_until(lambda: find_graph(transport).mismatches)
    assert [(each.topic, each.publisher, each.subscriber) for each in mismatches] == [
        ("/texts", "/camera", "/reader")
    ]
    assert "reliab" in mismatches[0].reason.lower()


def test_graph_has_nodes_without_topics(network: Network) -> None:
    transport = network.add_transport()
    network.add_node("idle", start_parameter_services=False, enable_rosout=False)
    graph = wait_until(lambda: "/idle" in find_nodes(transport) and transport.graph())
    assert {"/idle", "/retalis"} <= graph.nodes


def find_nodes(transport: RclpyTransport) -> AbstractSet[str]:
    graph = transport.graph()
    return frozenset() if graph is None else graph.nodes


# ---- time


def test_clock_is_subscribed_once(network: Network) -> None:
    transport = network.add_transport(use_sim_time=True)
    peer = network.add_node()
    publisher = peer.create_publisher(Clock, "/clock", 10)
    wait_until(publisher.get_subscription_count)
    publisher.publish(make_clock(7))
    wait_until(lambda: transport.now() == 7 * SECOND)
    readers = peer.get_subscriptions_info_by_topic("/clock")
    assert [reader.node_name for reader in readers] == ["retalis"]


def test_time_of_node_is_set(network: Network) -> None:
    parameter = Parameter("use_sim_time", value=True)
    node = network.add_node("retalis", parameter_overrides=[parameter])
    set_time = replace_clock_subscription(node)
    assert set_time is not None
    set_time(7 * SECOND)
    assert node.get_clock().now().nanoseconds == 7 * SECOND


def test_node_without_time_source_keeps_subscription(network: Network) -> None:
    node = network.add_node("retalis")
    clock = node.get_clock()
    assert replace_clock_subscription(SimpleNamespace(get_clock=lambda: clock)) is None


def make_clock(seconds: int) -> Clock:
    clock = Clock()
    clock.clock.sec = seconds
    return clock


def test_simulated_time_follows_clock(network: Network) -> None:
    publisher = network.add_node().create_publisher(Clock, "/clock", BEST_EFFORT)
    transport = network.add_transport(use_sim_time=True)
    instants: List[int] = []
    transport.on_clock(instants.append)
    assert transport.is_time_simulated
    assert transport.now() == 0
    wait_until(publisher.get_subscription_count)
    publisher.publish(make_clock(100))
    wait_until(lambda: transport.now() == 100 * SECOND)
    publisher.publish(make_clock(50))
    wait_until(lambda: transport.now() == 50 * SECOND)
    assert instants == [100 * SECOND, 50 * SECOND]


def test_timer_follows_simulated_time(network: Network) -> None:
    publisher = network.add_node().create_publisher(Clock, "/clock", BEST_EFFORT)
    transport = network.add_transport(use_sim_time=True)
    wait_until(publisher.get_subscription_count)
    publisher.publish(make_clock(100))
    wait_until(transport.now)
    calls: List[int] = []
    transport.call_later(10 * SECOND, lambda: calls.append(transport.now()))
    publisher.publish(make_clock(109))
    wait_until(lambda: transport.now() == 109 * SECOND)
    assert calls == []
    publisher.publish(make_clock(111))
    wait_until(lambda: calls)
    assert calls == [111 * SECOND]


# ---- shutdown


def test_shutdown_callbacks_run_in_their_order(network: Network) -> None:
    transport = network.add_transport()
    calls: List[Any] = []
    transport.on_shutdown(lambda: calls.append(("first", transport.is_shut_down())))
    transport.on_shutdown(lambda: calls.append(("second", transport.is_shut_down())))
    transport.shut_down()
    assert calls == [("first", True), ("second", True)]
