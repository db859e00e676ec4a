"""A bag as transport: connections, topics that are subscribed later, and publications."""

from pathlib import Path
from typing import Any, Dict, Iterator, List

import pytest

from retalis import BagReader, BagWriter, Definitions
from retalis.node.transport import MessageSource
from retalis.playback.bag_transport import BagTransport

SECOND = 10**9
DEFINITIONS = Definitions()
STRING = DEFINITIONS.find("std_msgs/String")


class Receiver:
    """Receiver of messages; see `retalis.node.transport.MessageReceiver`."""

    def __init__(self, name: Any, error: str = "", reads_transforms: bool = False) -> None:
        self.name, self.error, self.reads_transforms = name, error, reads_transforms


@pytest.fixture
def bag(tmp_path: Path) -> Iterator[Any]:
    """Return a function that writes a bag with a connection for each topic and opens it."""
    readers: List[Any] = []

    def write(*topics: Any) -> Any:
        path = tmp_path / f"{len(readers)}.bag"
        with BagWriter(path) as writer:
            for topic in topics:
                writer.write(writer.add(topic, STRING), SECOND, b"\0\0\0\0")
        readers.append(BagReader(path))
        return readers[-1]

    yield write
    for reader in readers:
        reader.close()


@pytest.fixture
def transport() -> Any:
    return BagTransport()


def subscribe(transport: Any, topic: str, receiver: Receiver) -> Any:
    return transport.subscribe(transport.resolve_topic(topic), STRING.name, lambda source: receiver, 1)


def receiver_names(transport: Any, bag: Any) -> Dict[Any, Any]:
    return {
        topic.name: [receiver.name for receiver in transport.receivers[id(topic)]] for topic in bag.topics
    }


@pytest.mark.parametrize("topic", ["scan", "/scan", "/scan/"])
def test_outer_slashes_of_topics_are_ignored(transport: Any, bag: Any, topic: str) -> None:
    reader = bag("/scan", "map", "/other")
    subscribe(transport, topic, Receiver("scan"))
    subscribe(transport, "/map", Receiver("map"))
    assert transport.start(reader) == ({"/scan", "map"}, [])
    assert receiver_names(transport, reader) == {"/scan": ["scan"], "map": ["map"], "/other": []}


def test_source_has_definition_of_connection(transport: Any, bag: Any) -> None:
    sources: List[Any] = []

    def connect(source: Any) -> Receiver:
        sources.append(source)
        return Receiver("scan")

    subscription = transport.subscribe("/scan", "std_msgs/Int8", connect, 1)
    transport.start(bag("/scan"))
    assert sources == [MessageSource("", STRING.name, STRING.full_text, STRING.md5sum)]
    assert (subscription.publisher_count(), subscription.publishers()) == (1, [])


def test_refused_connection_has_no_receiver(transport: Any, bag: Any) -> None:
    reader = bag("/scan")
    subscribe(transport, "scan", Receiver("scan", error="wrong type"))
    _, ((topic, error),) = transport.start(reader)
    assert (topic.name, error) == ("/scan", "wrong type")
    assert receiver_names(transport, reader) == {"/scan": []}


def test_transforms_precede_events_of_same_message(transport: Any, bag: Any) -> None:
    reader = bag("/tf")
    subscribe(transport, "tf", Receiver("event"))
    transport.start(reader)
    assert not transport.has_transforms()
    subscribe(transport, "/tf", Receiver("transforms", reads_transforms=True))
    # The topic is read already, so its messages must not be read a second time.
    assert transport.connect(reader) == (set(), [])
    assert receiver_names(transport, reader) == {"/tf": ["transforms", "event"]}
    assert transport.has_transforms()


def test_connection_without_transforms_is_no_error(transport: Any, bag: Any) -> None:
    subscribe(transport, "tf", Receiver("transforms", "wrong type", reads_transforms=True))
    assert transport.start(bag("/tf")) == ({"/tf"}, [])
    assert not transport.has_transforms()


def test_later_subscription_is_connected_once(transport: Any, bag: Any) -> None:
    reader = bag("/scan", "/map")
    subscribe(transport, "scan", Receiver("scan"))
    transport.start(reader)
    assert not transport.has_new_subscriptions()
    subscribe(transport, "map", Receiver("map"))
    assert transport.has_new_subscriptions()
    assert transport.connect(reader) == ({"/map"}, [])
    assert not transport.has_new_subscriptions()
    assert receiver_names(transport, reader) == {"/scan": ["scan"], "/map": ["map"]}


def test_next_bag_replaces_connections(transport: Any, bag: Any) -> None:
    first, second = bag("/scan"), bag("/map")
    subscribe(transport, "scan", Receiver("scan"))
    map_subscription = subscribe(transport, "map", Receiver("map"))
    transport.start(first)
    assert transport.start(second) == ({"/map"}, [])
    assert receiver_names(transport, second) == {"/map": ["map"]}
    map_subscription.close()
    assert transport.start(bag("/map")) == (set(), [])


def test_publication_stores_messages_until_taken(transport: Any) -> None:
    publication = transport.advertise("/alarm", STRING, 1)
    publication.send(b"a")
    publication.send(b"b")
    assert (publication.take(), publication.take(), publication.sent) == ([b"a", b"b"], [], 2)
    assert transport.publications["/alarm"].definition is STRING


def test_time_of_transport_is_clock_time(transport: Any) -> None:
    assert transport.now() == 0
    transport.clock.move_to(5 * SECOND)
    assert transport.now() == 5 * SECOND
