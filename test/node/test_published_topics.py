"""Published topics: outputs as messages."""

from pathlib import Path
from typing import Any, List

import pytest
from node.memory_transport import MemoryNetwork, MemoryTransport

from retalis import Definitions, MessageError, Reports, UsageError, atom, functor
from retalis.events.program.topic_configuration import Topics as ProgramTopics
from retalis.events.program.topic_configuration import topic_type
from retalis.messages.type_registry import InstalledTypes
from retalis.node.published_topics import (
    OutputRelay,
    PublishedTopics,
    UntypedTopicWarnings,
    advertise_topics,
)
from retalis.node.text_exchange import WATCH

NAME = atom("id")
TEXT = functor("std_msgs__0__String", 1)(atom('"a"'))


def test_outputs_of_load_are_relayed_in_order() -> None:
    received: List[Any] = []
    relay = OutputRelay(10, Reports())
    relay(atom("a"), "topic", NAME)
    relay(atom("b"), "topic", NAME)
    relay.start(lambda *output: received.append(output), lambda *output: received.append("second"))
    relay(atom("c"), "topic", NAME)
    assert received == [item for name in "abc" for item in ((atom(name), "topic", NAME), "second")]


def test_excess_outputs_of_load_are_dropped() -> None:
    reports, received = Reports(), []
    relay = OutputRelay(2, reports)
    for number in range(5):
        relay(number, "topic", NAME)
    relay.start(lambda term, topic, name: received.append(term))
    assert (received, reports.warnings) == ([3, 4], 3)


class Topics(PublishedTopics):
    """Published topics, with their definitions and reports as attributes."""

    def __init__(self, network: MemoryNetwork) -> None:
        self.definitions, self.reports = Definitions(), Reports()
        super().__init__(MemoryTransport(network), self.definitions, 5, self.reports)


@pytest.fixture
def topics(network: MemoryNetwork) -> Topics:
    return Topics(network)


@pytest.mark.parametrize("text", ["hello", '"hello"', "'hello'"])
def test_text_of_plain_program_is_published(network: MemoryNetwork, text: str) -> None:
    definitions = Definitions().with_strings("plain")
    published = PublishedTopics(MemoryTransport(network), definitions, 5, Reports())
    published.advertise("speech", "std_msgs/String")
    published.publish_text(f"event(std_msgs__0__String({text}),speech,id)")
    assert network.publications["/speech"][0].messages == [b"\5\0\0\0hello"]


def test_output_is_published_as_message(network: MemoryNetwork, topics: Topics) -> None:
    topics.advertise("speech", "std_msgs/String")
    topics.publish(TEXT, "speech")
    (publication,) = network.publications["/speech"]
    assert publication.messages == [b"\x01\0\0\0a"]
    (status,) = topics.statuses()
    assert (status.topic, status.type, status.sent) == ("/speech", "std_msgs/String", 1)


def test_term_of_another_type_is_reported(network: MemoryNetwork, topics: Topics) -> None:
    topics.advertise("speech", "std_msgs/String")
    topics.publish(atom("a"), "speech")
    assert (network.publications["/speech"][0].messages, topics.reports.errors) == ([], 1)


def test_invalid_topic_is_logged_once(topics: Topics, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    topics.publish(TEXT, "front door")
    topics.publish(TEXT, "front door")
    assert topics.reports.errors == 0
    (message,) = caplog.messages
    assert message.startswith("topic front door has no type")


def test_topic_has_one_type(topics: Topics) -> None:
    topics.advertise("speech", "std_msgs/String")
    topics.advertise("speech", "std_msgs/String")
    with pytest.raises(UsageError, match="topic speech already has the type std_msgs/String"):
        topics.advertise("speech", "std_msgs/Int8")


def test_topic_is_advertised_if_type_is_found(network: MemoryNetwork, topics: Topics) -> None:
    with pytest.raises(MessageError):
        topics.advertise("door", "lab/Door")
    topics.publish(TEXT, "door")
    assert ("/door" in network.publications, topics.reports.warnings) == (False, 1)
    topics.definitions.add("lab/Door", "bool open")
    topics.advertise_learned_types()
    topics.publish(functor("lab__0__Door", 1)(atom("true")), "door")
    assert network.publications["/door"][0].messages == [b"\1"]


def test_type_that_no_publisher_can_define_is_an_error(
    network: MemoryNetwork, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = tmp_path / "door_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Door.msg").write_text("bool open\n")
    definitions = Definitions(InstalledTypes(extra_folders=[str(tmp_path)]))
    published = PublishedTopics(MemoryTransport(network), definitions, 5, Reports())
    caplog.set_level("INFO")
    topics = ProgramTopics(
        published=(topic_type("a", "door_msgs/Movement"), topic_type("b", "lift_msgs/Lift"))
    )
    advertise_topics(published, topics, may_be_learned=True)
    assert [(record.levelname, record.getMessage().split(":")[1]) for record in caplog.records] == [
        ("ERROR", " topic a"),
        ("INFO", " topic b"),
    ]


def test_advice_for_invalid_topic_is_its_fault(
    network: MemoryNetwork, caplog: pytest.LogCaptureFixture
) -> None:
    UntypedTopicWarnings(MemoryTransport(network), [], Reports()).check("no name!")
    assert "publish_to" not in caplog.text
    assert "found 'no name!': ' ' is not allowed in it" in caplog.text


@pytest.mark.parametrize(
    ("topic", "warnings"), [("speech", 0), ("/speech", 0), ("other", 1), (f"{WATCH}1", 0), ("no name!", 1)]
)
def test_topic_without_type_is_warned_of_once(network: MemoryNetwork, topic: str, warnings: int) -> None:
    reports = Reports()
    checker = UntypedTopicWarnings(MemoryTransport(network), ["speech"], reports)
    checker.check(topic)
    checker.check(topic)
    assert reports.warnings == warnings
