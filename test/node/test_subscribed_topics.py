"""Subscribed topics: types of publishers, errors of single messages, order and counts."""

import struct
import threading
from typing import Any, List

import pytest
from node.memory_transport import MemoryNetwork, MemoryTransport

from retalis import Definitions, MessageError, Reports, TopicType, UsageError
from retalis.engine.event_input import TopicRequest
from retalis.engine.runtime.clock_epochs import ClockEpochs
from retalis.engine.runtime.clock_skew import ClockSkewMonitor
from retalis.node.subscribed_topics import (
    MessageProcessing,
    ReadingOptions,
    RequestQueue,
    SubscribedTopic,
    SubscribedTopics,
    consume_and_discard,
)
from retalis.node.transport import MessageSource

TEXT = "float32 degrees\n"
WARM = struct.pack("<f", 36.5)


@pytest.fixture
def publish(network: MemoryNetwork) -> Any:
    """Return a function that publishes messages of a type on ``/heat``, together."""
    transport = MemoryTransport(network, "/thermometer")

    def publish(message_type: str, *messages: Any, definition: Any = None) -> Any:
        definition = definition or Definitions().add(message_type, TEXT)
        publication = transport.advertise("/heat", definition, 10)
        publication.send(*messages)
        return publication

    return publish


@pytest.fixture
def subscribe(network: MemoryNetwork, reports: Reports) -> Any:
    """Return a function that subscribes to ``/heat``, and the results of the handler."""

    def subscribe(
        message_type: str,
        make_handler: Any = None,
        event: str = "",
        definitions: Any = None,
        **processing: Any,
    ) -> Any:
        results: List[Any] = []

        def decode(decoder: Any, topic: Any, source: Any) -> Any:
            return lambda data: results.append(decoder.decode(data))

        SubscribedTopic(
            MemoryTransport(network),
            definitions or Definitions(),
            reports,
            TopicRequest("/heat", message_type, event),
            MessageProcessing(make_handler or decode, threading.Lock())._replace(**processing),
            ReadingOptions(5),
        )
        return results

    return subscribe


def texts(caplog: pytest.LogCaptureFixture) -> List[Any]:
    return [record.getMessage() for record in caplog.records]


@pytest.mark.parametrize(("event", "name"), [("warm", "warm"), ("", "lab__0__Temperature")])
def test_events_have_the_given_name(
    subscribe: Any, publish: Any, caplog: pytest.LogCaptureFixture, event: str, name: str
) -> None:
    results = subscribe("lab/Temperature", event=event)
    publish("lab/Temperature", WARM)
    assert [(term[0].name, term[1]) for term in results] == [(name, 36.5)]
    assert texts(caplog) == []


def test_messages_that_transport_has_lost_are_counted(network: Any, caplog: pytest.LogCaptureFixture) -> None:
    topic = SubscribedTopic(
        MemoryTransport(network),
        Definitions(),
        Reports(),
        TopicRequest("/heat", "std_msgs/String"),
        MessageProcessing(lambda decoder, name, source: decoder.decode, threading.Lock()),
        ReadingOptions(5),
    )
    (subscription,) = network.subscriptions["/heat"]
    subscription.connect(MessageSource("/sensor", "std_msgs/String")).record_lost(3)
    assert topic.status().missing == 3
    assert texts(caplog) == [
        "topic /heat: /sensor sends faster than this node reads: 3 messages lost; have it publish more slowly, with "
        "a longer queue, or end later (rosbag play --keep-alive)"
    ]


def test_event_without_stamp_has_time_of_reception(subscribe: Any, network: MemoryNetwork) -> None:
    results: List[Any] = []

    def make_handler(decoder: Any, topic: Any, source: Any) -> Any:
        return lambda data: (data, decoder.stamp(data))

    subscribe(
        "geometry_msgs/PointStamped",
        make_handler,
        consume_results=results.extend,
        stamp_receipt=lambda received: received + 1,
    )
    (subscription,) = network.subscriptions["/heat"]
    source = MessageSource("/talker", "geometry_msgs/PointStamped")
    unstamped, stamped = bytes(40), bytes([0] * 4 + [7] + [0] * 35)
    receive = subscription.connect(source).receive
    receive([unstamped, stamped, unstamped], [100, 200, 300])
    receive([unstamped])
    assert [instant for _, instant in results] == [101, 7 * 10**9, 301, None]


@pytest.mark.parametrize("message_type", ["*", "std_msgs/String"])
def test_source_without_definition_has_known_type(
    subscribe: Any, network: MemoryNetwork, message_type: str
) -> None:
    results = subscribe("std_msgs/String")
    (subscription,) = network.subscriptions["/heat"]
    subscription.connect(MessageSource("", message_type)).receive([b"\1\0\0\0a"])
    assert [term[1].name for term in results] == ['"a"']


@pytest.mark.parametrize(
    ("message_type", "error"),
    [("std_msgs/Int8", "expected std_msgs/String, found std_msgs/Int8"), ("lab/Unknown", "lab/Unknown")],
)
def test_source_of_other_type_is_refused(
    subscribe: Any, network: MemoryNetwork, caplog: pytest.LogCaptureFixture, message_type: str, error: str
) -> None:
    results = subscribe("std_msgs/String")
    (subscription,) = network.subscriptions["/heat"]
    subscription.connect(MessageSource("/talker", message_type)).receive([b"\1"])
    assert results == []
    assert error in texts(caplog)[0]
    assert "a message of /talker is dropped" in texts(caplog)[0]


def test_misspelt_type_is_named_at_connection(
    subscribe: Any, publish: Any, caplog: pytest.LogCaptureFixture
) -> None:
    results = subscribe("lab/Temperatur")
    publish("lab/Temperature", WARM)
    assert [term[0].name for term in results] == ["lab__0__Temperatur"]
    (warning,) = texts(caplog)
    assert "/heat is subscribed as lab/Temperatur" in warning
    assert "/thermometer publishes lab/Temperature" in warning


def test_messages_of_other_type_are_counted(
    subscribe: Any, publish: Any, reports: Reports, caplog: pytest.LogCaptureFixture
) -> None:
    results = subscribe("std_msgs/String")
    publish("lab/Temperature", *[WARM] * 7)
    reports.sum_up()
    text = (
        "topic /heat: expected std_msgs/String, found lab/Temperature: a message of /thermometer is dropped"
    )
    assert results == []
    assert (texts(caplog)[0], texts(caplog)[-1]) == (text, f"7 times in all: {text}")


def test_damaged_messages_are_dropped_and_counted(
    subscribe: Any, publish: Any, reports: Reports, caplog: pytest.LogCaptureFixture
) -> None:
    results = subscribe("lab/Temperature")
    publish("lab/Temperature", *[b"12"] * 7)
    reports.sum_up()
    assert results == []
    assert texts(caplog)[0].startswith("a message on /heat is dropped: ")
    assert texts(caplog)[-1] == f"7 times in all: {texts(caplog)[0]}"


def test_failed_message_does_not_affect_batch(
    subscribe: Any, publish: Any, caplog: pytest.LogCaptureFixture
) -> None:
    lock, batches = threading.Lock(), []

    def handle(data: Any) -> Any:
        assert lock.locked()
        if data == b"wrong":
            raise MessageError("too short")
        if data == b"worse":
            raise KeyError("no such thing")
        return data

    subscribe(
        "lab/Temperature",
        lambda decoder, topic, source: handle,
        lock=lock,
        consume_results=lambda results: batches.append(list(results)),
    )
    publication = publish("lab/Temperature", b"one", b"wrong", b"worse", b"two")
    publication.send(b"three")
    assert batches == [[b"one", b"two"], [b"three"]]
    assert not lock.locked()
    assert texts(caplog)[0] == "a message on /heat is dropped: too short"
    assert "no such thing" in texts(caplog)[1]


def test_source_without_handler_is_refused_once(
    subscribe: Any, publish: Any, reports: Reports, caplog: pytest.LogCaptureFixture
) -> None:
    def make_handler(decoder: Any, topic: Any, source: Any) -> None:
        raise KeyError("no such thing")

    subscribe("lab/Temperature", make_handler)
    publish("lab/Temperature", WARM, WARM, WARM)
    assert (reports.errors, reports.warnings) == (1, 3)
    assert "no such thing" in texts(caplog)[0]
    assert texts(caplog)[1] == "topic /heat: internal error: a message of /thermometer is dropped"


def test_message_with_distant_stamp_is_refused(subscribe: Any, publish: Any, reports: Reports) -> None:
    definition = Definitions().find("sensor_msgs/Temperature")
    stamps: List[Any] = []

    def make_handler(decoder: Any, topic: Any, source: Any) -> Any:
        def handle(data: Any) -> None:
            decoder.decode(data)
            stamps.append(decoder.stamp(data))

        return handle

    skew = ClockSkewMonitor(reports, lambda: 0, lambda: 0, 60.0)
    subscribe(definition.name, make_handler, skew=skew)
    messages = [struct.pack("<IIII", 0, second, 0, 0) + bytes(16) for second in (100, 3700, 101)]
    publish(definition.name, *messages, definition=definition)
    assert stamps == [100 * 10**9, 101 * 10**9]
    assert (reports.errors, reports.warnings) == (0, 1)


def test_messages_of_next_epoch_are_buffered(subscribe: Any, publish: Any, reports: Reports) -> None:
    epochs = ClockEpochs(reports, lambda: 0, lambda: None)
    results: List[Any] = []

    def consume(values: Any) -> None:
        results.extend(values)

    subscribe(
        "lab/Temperature",
        lambda decoder, topic, source: lambda data: data,
        clock_epochs=epochs,
        consume_results=consume,
    )
    epochs.buffer_early("/thermometer", lambda messages: results.extend(messages), [b"early"])
    publish("lab/Temperature", b"later")
    assert results == []


@pytest.fixture
def topics(network: MemoryNetwork, reports: Reports) -> SubscribedTopics:
    processing = MessageProcessing(
        lambda decoder, topic, source: lambda data: data, threading.Lock(), consume_and_discard
    )
    return SubscribedTopics(
        MemoryTransport(network), Definitions(), reports, processing, ReadingOptions(5), lambda: None
    )


def test_topic_is_subscribed_once(topics: SubscribedTopics) -> None:
    topics.subscribe("heat", "std_msgs/String")
    with pytest.raises(UsageError, match=r"topic /heat is already subscribed \(as std_msgs/String\)"):
        topics.subscribe("/heat", "std_msgs/Int8")
    assert topics.unsubscribe("heat") == TopicRequest("/heat", "std_msgs/String")
    with pytest.raises(UsageError, match="topic heat is not subscribed"):
        topics.unsubscribe("heat")


@pytest.mark.parametrize(
    ("topic", "error"),
    [
        ("retalisInputEvents", "is for events as text"),
        ("no name!", "expected a topic name"),
        ("tf", "itself"),
    ],
)
def test_unsuitable_topic_is_refused(topics: SubscribedTopics, topic: str, error: str) -> None:
    topics.exclude([TopicType("tf", "tf/tfMessage")])
    with pytest.raises(UsageError, match=error):
        topics.subscribe(topic, "std_msgs/String")
    assert not topics.try_to_subscribe(TopicRequest(topic, "std_msgs/String"))


def test_statuses_count_messages(topics: SubscribedTopics, network: MemoryNetwork) -> None:
    topics.subscribe("heat", "std_msgs/String")
    publication = MemoryTransport(network, "/talker").advertise(
        "/heat", Definitions().find("std_msgs/String"), 1
    )
    publication.send(b"\0\0\0\0", b"\0\0\0\0")
    (status,) = topics.statuses()
    assert (status.topic, status.publishers, status.messages) == ("/heat", 1, 2)
    assert topics.publishers() == {("/heat", "/talker")}
    publication.close(is_incomplete=True)
    assert topics.statuses()[0].missing == 1


def test_unknown_type_is_found_without_processing(topics: SubscribedTopics, network: MemoryNetwork) -> None:
    topics.learn("heat", "lab/Temperature")
    definition = Definitions().add("lab/Temperature", TEXT)
    MemoryTransport(network, "/thermometer").advertise("/heat", definition, 1).send(WARM)
    assert topics.knows_type("lab/Temperature")


def test_requests_before_start_are_executed_once() -> None:
    callbacks: List[Any] = []
    subscribed: List[Any] = []
    requests = RequestQueue(callbacks.append)
    first: Any = "first"
    requests.put(first)
    requests.start(subscribed.append, lambda request: subscribed.append(str(request).upper()))
    assert subscribed == ["first", "FIRST"]
    for callback in callbacks:
        callback()
