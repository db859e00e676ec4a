"""Template of a new program: the texts of its files, with a first rule for each of its topics.

The first rule of a topic has an event with the value of a slot, a second one detects that the topic is silent. The
values are published, so that the program has outputs from the start, which its first test compares.
"""

import json
from typing import Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple

from ..events.program.topic_configuration import GOALS, RULES, TOPICS
from ..messages.type_definition import FLOATS, HEADER, PRIMITIVES, Definition, Field
from ..prolog.syntax.literals import atom_text
from ..testing.case_file import make_json_schema

SILENCE_SECONDS = 5
"""Seconds without a message after which a topic is silent, in the rules of the template."""

SCHEMA_FILE = "retalis-test.schema.json"
"""Name of the file with the JSON Schema of test cases, which the first line of the test file names for editors."""

_PUBLISHED_TYPES = {"float": "std_msgs/Float64", "integer": "std_msgs/Int64", "bool": "std_msgs/Bool"}
"""Types of published values; texts are ``std_msgs/String``, and messages without such a value ``std_msgs/Empty``."""

_TEST_VALUES = {"float": "12.5", "integer": "7", "bool": "true", "text": "hello"}
"""Values of messages in the first test. They have an exact form in all types of numbers."""


class ProgramTopic(NamedTuple):
    """A topic of a new program.

    Attributes:
        topic: name of the topic.
        definition: type of its messages.
        event: name of the events of its first rule, unique in the program.
        has_own_name: whether its messages are events of a name of their own, since another topic has their type.
    """

    topic: str
    definition: Definition
    event: str
    has_own_name: bool


class _ReadSlot(NamedTuple):
    """A slot that a rule reads: its path, and the type of its values (a key of `_TEST_VALUES`)."""

    path: Tuple[str, ...]
    type: str


def make_files(name: str, topics: Sequence[ProgramTopic]) -> Dict[str, str]:
    """Return the texts of a new program's files by their paths; it has at least one topic."""
    values = [_find_value(topic.definition, ()) for topic in topics]
    pairs = list(zip(topics, values))
    return {
        TOPICS: _make_topic_file(pairs),
        GOALS: _make_goal_file(pairs),
        RULES: _make_rule_file(pairs),
        f"tests/{name}.yaml": _make_test_file(pairs),
        f"tests/{SCHEMA_FILE}": json.dumps(make_json_schema(), indent=2) + "\n",
        f"launch/{name}.launch": _ROS1_LAUNCH_FILE.replace("NAME", name),
        f"launch/{name}.launch.py": _ROS2_LAUNCH_FILE.replace("NAME", name),
        ".github/workflows/retalis.yml": _CI_FILE,
    }


def name_topics(topics: Sequence[Tuple[str, Definition]]) -> List[ProgramTopic]:
    """Return topics with names for their events, which are derived from the names of the topics."""
    type_counts: Dict[str, int] = {}
    for _, definition in topics:
        type_counts[definition.name] = type_counts.get(definition.name, 0) + 1
    named: List[ProgramTopic] = []
    used_names: Dict[str, None] = {}
    for topic, definition in topics:
        base = _make_event_name(topic)
        event, number = base, 2
        while event in used_names:
            event, number = f"{base}_{number}", number + 1
        used_names[event] = None
        named.append(ProgramTopic(topic, definition, event, type_counts[definition.name] > 1))
    return named


def _make_event_name(topic: str) -> str:
    """Return a name of an event: the last part of a topic's name, in lower case, beginning with a letter."""
    last = topic.strip("/").rpartition("/")[2].lower()
    name = "".join(
        char if char.isascii() and (char.isalnum() or char == "_") else "_" for char in last
    ).strip("_")
    # Operators and the predicates of the language have short names, as `and`; a suffix avoids them.
    return f"{name}_value" if name[:1].isalpha() else f"topic_{name}_value"


def _find_value(definition: Definition, path: Tuple[str, ...]) -> Optional[_ReadSlot]:
    """Return the first slot with a single number, truth value or text, in the message or a nested one, or None.

    Slots of headers are the last choice, because all messages have them.
    """
    for slot in definition.fields:
        value_type = _get_value_type(slot)
        # Headers of ROS 2 have no sequence number.
        if value_type is not None and (definition.name, slot.name) != (HEADER, "seq"):
            return _ReadSlot((*path, slot.name), value_type)
    nested = [slot for slot in definition.fields if slot.definition is not None and slot.length is None]
    for slot in sorted(nested, key=lambda each: each.type == HEADER):
        assert slot.definition is not None
        value = _find_value(slot.definition, (*path, slot.name))
        if value is not None:
            return value
    return None


def _get_value_type(slot: Field) -> Optional[str]:
    if slot.length is not None:
        return None
    if slot.type in FLOATS:
        return "float"
    if slot.type in ("bool", "string"):
        return "text" if slot.type == "string" else "bool"
    return "integer" if slot.type in PRIMITIVES else None


_TopicWithValue = Tuple[ProgramTopic, Optional[_ReadSlot]]


def _published_type(value: Optional[_ReadSlot]) -> str:
    if value is None:
        return "std_msgs/Empty"
    return _PUBLISHED_TYPES.get(value.type, "std_msgs/String")


def _make_topic_file(pairs: Sequence[_TopicWithValue]) -> str:
    lines = ['<publish_subscribe strings="plain">', "  <!-- Messages of these topics become events. -->"]
    for topic, _ in pairs:
        event = f' event="{topic.event}_message"' if topic.has_own_name else ""
        lines.append(f'  <subscribe_to name="{topic.topic}" msg_type="{topic.definition.name}"{event}/>')
    lines.append("  <!-- Subscriptions in goalPredicates.txt send messages to these topics. -->")
    lines += [
        f'  <publish_to name="{topic.event}" msg_type="{_published_type(value)}"/>' for topic, value in pairs
    ]
    lines.append('  <publish_to name="silent_topics" msg_type="std_msgs/String"/>')
    return "\n".join([*lines, "</publish_subscribe>", ""])


def _make_goal_file(pairs: Sequence[_TopicWithValue]) -> str:
    lines = [
        "% Goals that are called at the start, one on each line.",
        f"compile_event_file('{RULES}')",
        "",
        "% subscribe(Event, Conditions, Message, Topic, Id): each such event is published as a message.",
    ]
    for topic, value in pairs:
        event, message = _make_event_and_message(topic, value)
        lines.append(f"subscribe({event}, [], {message}, {topic.event}, {topic.event})")
    lines.append("subscribe(silent(Topic), [], std_msgs__0__String(Topic), silent_topics, silent_topics)")
    return "\n".join([*lines, ""])


def _make_event_and_message(topic: ProgramTopic, value: Optional[_ReadSlot]) -> Tuple[str, str]:
    """Return the texts of the first rule's event and of its published message."""
    if value is None:
        return topic.event, "std_msgs__0__Empty"
    functor_name = _published_type(value).replace("/", "__0__")
    return f"{topic.event}(Value)", f"{functor_name}(Value)"


def _make_rule_file(pairs: Sequence[_TopicWithValue]) -> str:
    lines = [
        "% HEAD <- PATTERN: each match of the pattern is a new event. A name with a capital letter is a variable.",
        "% Slots that are not named may have any value; `retalis msg PACKAGE/Type --format names` lists all slots.",
    ]
    for topic, value in pairs:
        event, _ = _make_event_and_message(topic, value)
        message = f"{topic.event}_message" if topic.has_own_name else topic.definition.functor_name
        pattern = "" if not topic.definition.fields else "{}" if value is None else _make_slots(value)
        any_event = event.replace("Value", "_")
        lines += [
            "",
            f"% An event for each message of topic {topic.topic}.",
            f"{event} <- {message}{pattern}.",
            "",
            f"% No message for {SILENCE_SECONDS} s after the last one.",
            f"silent({atom_text(topic.topic)}) <- {any_event} seq absent({any_event}, {SILENCE_SECONDS}).",
        ]
    return "\n".join([*lines, ""])


def _make_slots(value: _ReadSlot) -> str:
    text = "Value"
    for name in reversed(value.path):
        text = f"{{{name}: {text}}}"
    return text


def _make_test_file(pairs: Sequence[_TopicWithValue]) -> str:
    lines = [
        "# `retalis test` runs these cases. Times are in seconds since the start of a case.",
        f"# yaml-language-server: $schema={SCHEMA_FILE}",
        "cases:",
    ]
    for topic, value in pairs:
        lines += ["", *_make_case(topic, value)]
    return "\n".join([*lines, ""])


def _make_case(topic: ProgramTopic, value: Optional[_ReadSlot]) -> Iterator[str]:
    event, _ = _make_event_and_message(topic, value)
    message = "{}"
    published = ""
    # Without quotes, some names are no texts in YAML, as `null`. Texts of JSON are texts of YAML.
    quoted_topic = json.dumps(topic.topic)
    if value is not None:
        message = test_value = _TEST_VALUES[value.type]
        for name in reversed(value.path):
            message = f"{{{name}: {message}}}"
        published = f", message: {{data: {test_value}}}"
    yield f"  - name: {json.dumps(f'{topic.topic} is received, and silent afterwards')}"
    yield "    input:"
    yield f"      - {{at: 1, topic: {quoted_topic}, message: {message}}}"
    yield f"    # The clock runs on to this time: the topic is silent {SILENCE_SECONDS} s after its message."
    yield "    until: 10"
    yield "    expect:"
    yield "      outputs:"
    yield f"        - {{at: 1, topic: {topic.event}{published}}}"
    yield f"        - {{at: {1 + SILENCE_SECONDS}, topic: silent_topics, message: {{data: {quoted_topic}}}}}"
    yield "      events:"
    yield f'        contains: ["{event.replace("Value", "_")}"]'


_ROS1_LAUNCH_FILE = """\
<!-- roslaunch launch/NAME.launch: runs the program on ROS 1. -->
<launch>
  <include file="$(find retalis)/launch/retalis.launch">
    <arg name="program" value="$(dirname)/.."/>
    <!-- true if a bag or a simulator publishes the time -->
    <arg name="use_sim_time" value="false"/>
    <!-- services that rules may call with ros_service, as [/dock] -->
    <arg name="allow_services" value="[]"/>
  </include>
</launch>
"""

_ROS2_LAUNCH_FILE = '''\
"""ros2 launch launch/NAME.launch.py: runs the program on ROS 2."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

PROGRAM = Path(__file__).resolve().parent.parent
RETALIS = Path(get_package_share_directory("retalis")) / "launch" / "retalis.launch.py"


def generate_launch_description():
    # use_sim_time: true if a bag or a simulator publishes the time.
    # "allow_services": "[/dock]" allows rules to call a service with ros_service.
    arguments = {"program": str(PROGRAM), "use_sim_time": "false"}
    source = PythonLaunchDescriptionSource(str(RETALIS))
    return LaunchDescription([IncludeLaunchDescription(source, launch_arguments=arguments.items())])
'''

_CI_FILE = """\
# GitHub Actions: checks and tests the program at each push, without ROS. It runs only if the folder of the program is
# the root of its repository; elsewhere, move .github there, and replace "." in the last two commands by the folder.
# The variable RETALIS_REPOSITORY must be added in the settings of the repository (Actions, Variables): the address of
# the repository of retalis without https://, at a version of your choice, as example.org/retalis.git@1.1.0.
name: retalis
on: [push, pull_request]
jobs:
  test:
    runs-on: ubuntu-latest
    steps:
      - uses: actions/checkout@v4
      - uses: actions/setup-python@v5
        with: {python-version: "3.11"}
      - run: pip install "retalis @ git+https://${{ vars.RETALIS_REPOSITORY }}"
      - run: retalis check --strict .
      - run: retalis test . --junit results.xml
"""
