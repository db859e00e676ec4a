"""Scenarios: programs with messages and the outputs that are expected on every transport.

Each folder beside this module is the folder of a program, with a file ``scenario.json``: the messages, each with the
second of its receipt, its topic and its fields; the second at which the run ends; the expected outputs by topic.
Stamps are seconds. Fields that are not named are zero, empty or false.

The messages are encoded and decoded by rosbags. The drivers of the transports are
``test/playback/test_bag_scenarios.py``, ``test/ros1/rostests/live_scenarios.py`` and ``test/ros2/test_scenarios.py``;
the last two share `play_live`.
"""

import dataclasses
import json
from pathlib import Path
from typing import Any, Dict, Iterable, List, NamedTuple, Protocol
from xml.etree import ElementTree

import numpy
from script_modules import load_script

HERE = Path(__file__).resolve().parent
TEST = HERE.parent
SCENARIOS = sorted(path.parent for path in HERE.glob("*/scenario.json"))
"""Folders of the scenarios."""

SECOND = 10**9
TICK = SECOND // 4
"""Step of simulated time in ns. Instants at which rules emit something have to be multiples of it."""

TRANSFORM_TYPE = "tf2_msgs/msg/TFMessage"

ALL = slice(None)

TypedFields = Dict[str, Any]
Outputs = Dict[str, List[TypedFields]]


class Message(NamedTuple):
    """A message of a scenario: instant of its receipt in ns, topic, and fields."""

    time: int
    topic: str
    fields: TypedFields


class Scenario(NamedTuple):
    """A scenario.

    Attributes:
        program: folder of the program.
        messages: the messages in the order of their receipt.
        end: instant in ns at which the run ends.
        outputs: expected outputs by topic.
        types: types of the topics, in the form of ROS 2.
        published: topics of the outputs.
    """

    program: Path
    messages: List[Message]
    end: int
    outputs: Outputs
    types: Dict[str, str]
    published: List[str]

    def inputs(self) -> List[str]:
        """Return the topics of the messages."""
        return sorted({message.topic for message in self.messages})


def read_scenario(folder: Path) -> Scenario:
    """Read the files of a scenario."""
    content = json.loads((folder / "scenario.json").read_text(encoding="utf-8"))
    topics = ElementTree.parse(folder / "pub_sub.xml").getroot()
    types = {entry.get("name", ""): entry.get("msg_type", "").replace("/", "/msg/") for entry in topics}
    types.update({"/tf": TRANSFORM_TYPE, "/tf_static": TRANSFORM_TYPE})
    messages = [
        Message(round(time * SECOND), topic, _convert_stamps(fields))
        for time, topic, fields in content["messages"]
    ]
    published = [entry.get("name", "") for entry in topics.iter("publish_to")]
    return Scenario(folder, messages, content["end"] * SECOND, content["outputs"], types, published)


def _convert_stamps(fields: Any) -> Any:
    """Return fields with stamps as messages have them."""
    if isinstance(fields, list):
        return [_convert_stamps(item) for item in fields]
    if not isinstance(fields, dict):
        return fields
    return {
        name: dict(zip(("sec", "nanosec"), divmod(round(value * SECOND), SECOND)))
        if name == "stamp"
        else _convert_stamps(value)
        for name, value in fields.items()
    }


class MessageCodec:
    """Encoding and decoding of messages by rosbags.

    Args:
        version: 1 or 2, the generation of ROS.

    Attributes:
        store: the types of rosbags.
    """

    def __init__(self, version: int):
        self._script = load_script(TEST.parent / "examples" / "localization_faults" / "make_recordings.py")
        self._types = self._script.MessageTypes(version)
        self._version = version
        self.store = self._types.store

    def open_writer(self, path: Path) -> Any:
        """Return a writer of a bag of this generation of ROS."""
        return self._script.open_writer(path, "bag" if self._version == 1 else "db3")

    def encode(self, fields: TypedFields, message_type: str) -> bytes:
        """Return a serialized message."""
        return bytes(self._types.serialize(fields, message_type))

    def decode(self, data: bytes, message_type: str) -> TypedFields:
        """Return the fields of a message that are not zero, empty or false, with stamps in seconds."""
        deserialize = self.store.deserialize_ros1 if self._version == 1 else self.store.deserialize_cdr
        return dict(_read_fields(deserialize(data, message_type)))


def _read_fields(value: Any) -> Any:
    if dataclasses.is_dataclass(value):
        fields = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        fields.pop("__msgtype__", None)
        if set(fields) == {"sec", "nanosec"}:
            return fields["sec"] + fields["nanosec"] / SECOND
        # The number of a header of ROS 1 is set by its publisher.
        fields.pop("seq", None)
        converted = {name: _read_fields(item) for name, item in fields.items()}
        return {name: item for name, item in converted.items() if item}
    if isinstance(value, numpy.ndarray):
        return value.tolist()
    if isinstance(value, list):
        return [_read_fields(item) for item in value]
    return value


def collect_outputs(outputs: Iterable[Any], scenario: Scenario, codec: MessageCodec) -> Outputs:
    """Return the decoded outputs by topic.

    Args:
        outputs: pairs of topic and serialized message.
        scenario: the scenario.
        codec: decodes the messages.
    """
    decoded: Outputs = {topic: [] for topic in scenario.published}
    for topic, data in outputs:
        decoded[topic].append(codec.decode(data, scenario.types[topic]))
    return decoded


class LiveNode(Protocol):
    """A node that runs the program of a scenario with simulated time, as a driver of a transport sees it."""

    def set_time(self, instant: int) -> None:
        """Publish an instant in ns on ``/clock``, and wait until the node has it."""

    def publish(self, topic: str, data: bytes) -> None:
        """Publish a serialized message, and wait until the node has processed it."""

    def receive_outputs(self) -> List[Any]:
        """Wait for all outputs since the last call; return pairs of topic and serialized message."""


def play_live(scenario: Scenario, node: LiveNode, codec: MessageCodec, part: slice = ALL) -> Outputs:
    """Play a scenario to a node, and return its outputs.

    Simulated time runs in steps of `TICK`, so that the order of messages and alarms is that of their instants.

    Args:
        scenario: the scenario.
        node: the node.
        codec: encodes and decodes the messages.
        part: the messages to play; time runs until the next message, or the end of the scenario.
    """
    messages, rest = scenario.messages[part], scenario.messages[part.stop :] if part.stop else []
    now = messages[0].time - (0 if part.start else SECOND)
    node.set_time(now)
    for message in messages:
        now = _advance(node, now, message.time)
        node.publish(message.topic, codec.encode(message.fields, scenario.types[message.topic]))
    _advance(node, now, rest[0].time if rest else scenario.end)
    return collect_outputs(node.receive_outputs(), scenario, codec)


def _advance(node: LiveNode, now: int, end: int) -> int:
    for instant in range(now + TICK, end + 1, TICK):
        node.set_time(instant)
    return end
