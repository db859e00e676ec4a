"""Program folders: names of the files, and the topics in ``pub_sub.xml``.

``pub_sub.xml`` is parsed with expat. Document types are refused, because entities can expand a small text to a huge
one ("billion laughs") or read other files; size and depth are limited. All errors are collected with their positions.
"""

import re
from pathlib import Path
from typing import Callable, Dict, FrozenSet, List, NamedTuple, Optional, Set, Tuple, Union
from xml.parsers import expat

from ...foundation.errors import (
    MAX_SHOWN_CHARACTERS,
    Errors,
    Place,
    ProgramErrors,
    RetalisError,
    RuleError,
    SyntaxFault,
    UsageError,
    describe_decode_error,
    place_at_column,
    printable,
    shorten,
    suggest_file,
)
from ...foundation.ros_name_checks import ros1_type_name, topic_fault, type_fault
from ..language.event_declarations import event_name_error

GOALS = "goalPredicates.txt"
TOPICS = "pub_sub.xml"
RULES = "eventRules.txt"

QUALITY_ATTRIBUTES = ("reliability", "durability", "depth")
"""Attributes of both elements for the quality of service of ROS 2; ROS 1 has none."""

ATTRIBUTES = {
    "subscribe_to": ("name", "msg_type", "event", *QUALITY_ATTRIBUTES),
    "publish_to": ("name", "msg_type", "latch", *QUALITY_ATTRIBUTES),
}
"""Elements of ``pub_sub.xml`` with their attributes."""

MAX_QUEUE_DEPTH = 1_000_000
"""Largest number of messages that a topic may queue."""

MAX_XML_CHARACTERS = 4_000_000
"""Maximum length of ``pub_sub.xml``."""

MAX_XML_DEPTH = 100
"""Maximum nesting depth of elements in ``pub_sub.xml``."""


_XML_ENCODING = re.compile(r"""<\?xml[^>]{0,100}\sencoding\s*=\s*["']([A-Za-z][A-Za-z0-9._-]{0,30})["']""")
"""Encoding in the declaration at the beginning of an XML file."""

_XML_ENCODINGS = ("utf-8", "us-ascii", "iso-8859-1", "iso-8859-15", "windows-1252")
"""Encodings of ``pub_sub.xml``."""


class TopicType(NamedTuple):
    """Name of a topic as written, possibly relative, and its message type ``pkg/Type``.

    >>> playback = Playback(folder, report=print, topics=[TopicType("scan", "sensor_msgs/LaserScan")])
    """

    topic: str
    type: str


DEFAULT_DIRECT_TOPICS = (TopicType("tf", "tf/tfMessage"), TopicType("ar_pose_marker", "ar_pose/ARMarkers"))
"""Topics that node retalis subscribes to by default, like the original system."""


AUTO = "auto"
"""Value of ``~direct``: all topics of ``pub_sub.xml``, and those of `DEFAULT_DIRECT_TOPICS` that it does not name."""

DirectTopics = Union[bool, str, Tuple[TopicType, ...]]
"""Value of ``~direct``: `AUTO`, True, False, or the topics."""

_DIRECT_VALUES: Dict[str, Union[bool, str]] = {"auto": AUTO, "true": True, "false": False}


def topic_type(topic: str, message_type: str) -> TopicType:
    """Return a validated topic and type; the type may be written as in ROS 2 (``pkg/msg/Type``).

    Raises:
        UsageError: if the name or type is invalid in ROS.
    """
    message_type = ros1_type_name(message_type)
    error_text = topic_fault(topic) or type_fault(message_type)
    if error_text is not None:
        raise UsageError(error_text)
    return TopicType(topic, message_type)


class TopicEvent(NamedTuple):
    """Name of a topic as written, and the name of its events."""

    topic: str
    event: str


class QualityOfService(NamedTuple):
    """Demands of a program on a topic of ROS 2; the node chooses the rest.

    Attributes:
        is_reliable: whether lost messages are sent again; None for no demand.
        is_transient_local: whether late subscribers receive the last messages; None for no demand.
        depth: number of messages to queue; None for no demand.
    """

    is_reliable: Optional[bool] = None
    is_transient_local: Optional[bool] = None
    depth: Optional[int] = None


ANY_QUALITY = QualityOfService()
"""The quality of a topic without demands."""


class TopicQuality(NamedTuple):
    """Name of a topic as written, and the demanded quality of service."""

    topic: str
    quality: QualityOfService


class Topics(NamedTuple):
    """Contents of ``pub_sub.xml``.

    Attributes:
        subscribed: topics whose messages become events.
        published: topics for outputs, with their types.
        latched: names of latched topics, whose last message is sent to each new subscriber.
        events: subscribed topics with a name for their events.
        subscribed_quality: subscribed topics with demands on the quality of service.
        published_quality: published topics with such demands.
    """

    subscribed: Tuple[TopicType, ...] = ()
    published: Tuple[TopicType, ...] = ()
    latched: FrozenSet[str] = frozenset()
    events: Tuple[TopicEvent, ...] = ()
    subscribed_quality: Tuple[TopicQuality, ...] = ()
    published_quality: Tuple[TopicQuality, ...] = ()

    def event_name_of(self, topic: str, canonical_name: Callable[[str], str] = str) -> str:
        """Return the name of the events of a topic, or "" if they are named by the message type.

        Args:
            topic: name of the topic.
            canonical_name: returns the canonical form of a topic name.
        """
        canonical_topic = canonical_name(topic)
        return next((event for name, event in self.events if canonical_name(name) == canonical_topic), "")


def quality_of(
    qualities: Tuple[TopicQuality, ...], topic: str, canonical_name: Callable[[str], str] = str
) -> QualityOfService:
    """Return the demanded quality of service of a topic.

    Args:
        qualities: the topics with demands.
        topic: name of the topic.
        canonical_name: returns the canonical form of a topic name.
    """
    canonical_topic = canonical_name(topic)
    return next(
        (quality for name, quality in qualities if canonical_name(name) == canonical_topic), ANY_QUALITY
    )


def read_text(path: Union[str, Path], encoding: str = "utf-8") -> str:
    """Return the text of a file, in UTF-8 by default.

    Raises:
        UsageError: if it cannot be read.
    """
    try:
        return Path(path).read_text(encoding=encoding)
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"cannot read {path}: {describe_decode_error(error)}") from error
    except ValueError as error:
        # The name contains a NUL character or surrogates.
        raise UsageError(f"cannot read {str(path)!r}: {error}") from error


def read_topics(path: Union[str, Path]) -> Topics:
    """Parse a ``pub_sub.xml`` file.

    Raises:
        ProgramErrors: all errors with their positions.
        UsageError: if it cannot be read.
    """
    reader = _TopicReader(str(path), read_xml(Path(path)))
    return reader.read()


def read_xml(path: Path) -> str:
    """Return the text of an XML file in the encoding that it declares, UTF-8 by default.

    Raises:
        UsageError: if it cannot be read.
    """
    try:
        # The declaration is ASCII in each of the encodings.
        declaration = _XML_ENCODING.match(path.read_bytes()[:200].decode("latin-1"))
    except OSError as error:
        hint = suggest_file(path) if isinstance(error, FileNotFoundError) else ""
        raise UsageError(f"cannot read {path}: {error.strerror}{'; ' if hint else ''}{hint}") from error
    encoding = "utf-8" if declaration is None else declaration[1].lower()
    if encoding not in _XML_ENCODINGS:
        raise UsageError(
            f"cannot read {path}: its encoding '{encoding}' is unknown: expected {' or '.join(_XML_ENCODINGS)}"
        )
    return read_text(path, encoding)


def read_direct(value: object) -> DirectTopics:
    """Return the value of parameter ``~direct`` or option ``--direct``.

    Args:
        value: ``auto``, true, false, or a list of topics and types, flat or in pairs; each may also be given as text.

    Raises:
        UsageError: if the value is invalid, or a topic or type is invalid in ROS.
    """
    parsed_value = value
    if isinstance(parsed_value, str):
        parsed_value = _DIRECT_VALUES.get(parsed_value.strip().lower(), parsed_value.strip())
    if isinstance(parsed_value, str) and parsed_value.startswith("[") and parsed_value.endswith("]"):
        # Names have neither brackets nor commas nor quotes, so a list of pairs reads as a flat one.
        parsed_value = [item.strip(" []'\"") for item in parsed_value[1:-1].split(",") if item.strip(" []")]
    if isinstance(parsed_value, bool) or parsed_value == AUTO:
        return parsed_value
    if isinstance(parsed_value, list):
        flat_items = [
            item for entry in parsed_value for item in (entry if isinstance(entry, list) else [entry])
        ]
        if len(flat_items) % 2 == 0 and all(isinstance(item, str) for item in flat_items):
            return tuple(
                topic_type(topic, message_type)
                for topic, message_type in zip(flat_items[::2], flat_items[1::2])
            )
    raise UsageError(
        "expected auto, true, false, or a list of topics and types [topic, package/Type, ...], "
        f"found {printable(shorten(repr(value)))}"
    )


def uses_texts(direct: DirectTopics) -> bool:
    """Return whether topics of ``pub_sub.xml`` pass as text between the nodes with this value of ``~direct``."""
    return direct is not True and direct != AUTO


def direct_topics(
    direct: DirectTopics, topics: Topics, canonical_name: Callable[[str], str] = str
) -> Tuple[TopicType, ...]:
    """Return the topics that node retalis reads in addition to those of ``pub_sub.xml``, both live and offline.

    A topic that ``pub_sub.xml`` names, too, is read with the type that is returned here.

    Args:
        direct: value of ``~direct``.
        topics: topics of the program.
        canonical_name: returns the canonical form of a topic name.
    """
    if direct is True:
        return DEFAULT_DIRECT_TOPICS
    if direct == AUTO:
        subscribed_names = {canonical_name(topic) for topic, _ in topics.subscribed}
        return tuple(
            topic for topic in DEFAULT_DIRECT_TOPICS if canonical_name(topic.topic) not in subscribed_names
        )
    return direct if isinstance(direct, tuple) else ()


def event_types(folder: Path) -> Dict[str, str]:
    """Return the message types by the event names that a program's topics define.

    Empty if ``pub_sub.xml`` is invalid or missing; the subscription of the topics reports that.
    """
    try:
        topics = read_topics(folder / TOPICS)
    except RetalisError:
        return {}
    # Reversed, because the first of several entries for a topic counts.
    types = dict(reversed(topics.subscribed))
    return {event: types[topic] for topic, event in reversed(topics.events)}


class _TopicReader:
    """Parser of ``pub_sub.xml``: collects ``subscribe_to`` and ``publish_to`` elements at any depth, and errors."""

    def __init__(self, source: str, text: str):
        self.source = source
        self.text = text
        self.lines = text.splitlines()
        self.parser = expat.ParserCreate()
        self.parser.StartElementHandler = self.on_start_element
        self.parser.EndElementHandler = lambda tag: self.open_elements.pop()
        # Refusing the document type excludes all entity declarations before they are read.
        self.parser.StartDoctypeDeclHandler = self.reject_document_type
        self.open_elements: List[Tuple[str, int]] = []
        self.has_root = False
        self.topics_by_tag: Dict[str, List[TopicType]] = {"subscribe_to": [], "publish_to": []}
        self.latched: Set[str] = set()
        self.events: List[TopicEvent] = []
        self.qualities: Dict[str, List[TopicQuality]] = {"subscribe_to": [], "publish_to": []}
        self.errors = Errors()

    def read(self) -> Topics:
        try:
            if len(self.text) > MAX_XML_CHARACTERS:
                raise SyntaxFault(
                    f"the file has {len(self.text)} characters: at most {MAX_XML_CHARACTERS} are allowed"
                )
            self.parser.Parse(self.text, True)
        except SyntaxFault as fault:
            self.errors.append(fault)
        except expat.ExpatError as error:
            message = f"this is not XML: {expat.errors.messages[error.code]}"
            if self.open_elements:
                tag, line = self.open_elements[-1]
                message += f"; <{tag[:MAX_SHOWN_CHARACTERS]}> of line {line} is not closed"
            self.errors.append(SyntaxFault(message, self.place_at(error.lineno, error.offset)))
        if self.errors:
            raise ProgramErrors(self.errors)
        subscribed, published = (tuple(self.topics_by_tag[tag]) for tag in ("subscribe_to", "publish_to"))
        return Topics(
            subscribed,
            published,
            frozenset(self.latched),
            tuple(self.events),
            tuple(self.qualities["subscribe_to"]),
            tuple(self.qualities["publish_to"]),
        )

    def place_at(self, line: int, offset: int) -> Place:
        text = self.lines[line - 1] if line <= len(self.lines) else ""
        return place_at_column(self.source, line, offset + 1, text)

    def current_place(self) -> Place:
        """Return the position of the parser."""
        return self.place_at(self.parser.CurrentLineNumber, self.parser.CurrentColumnNumber)

    def reject_document_type(self, *declared: object) -> None:
        """Refuse a document type: its entities could expand a small text to a huge one, or read other files."""
        raise SyntaxFault("a document type (<!DOCTYPE ...>) is not allowed", self.current_place())

    def on_start_element(self, tag: str, attributes: Dict[str, str]) -> None:
        place = self.current_place()
        if len(self.open_elements) >= MAX_XML_DEPTH:
            raise SyntaxFault(f"elements are nested more than {MAX_XML_DEPTH} deep", place)
        tag = tag if tag in self.topics_by_tag else tag[:MAX_SHOWN_CHARACTERS]
        self.open_elements.append((tag, place.line))
        if not self.has_root:
            self.has_root = True
            if tag != "publish_subscribe":
                self.add_error(f"the root must be <publish_subscribe>, found <{tag}>", place)
            return
        if tag not in self.topics_by_tag:
            # Elements with other names only group their contents.
            if "msg_type" in attributes:
                self.add_error(f"expected <subscribe_to> or <publish_to>, found <{tag}>", place)
            return
        for name in ("name", "msg_type"):
            if not attributes.get(name, "").strip():
                self.add_error(f'<{tag}> needs {name}="..."', place)
                return
        try:
            topic = topic_type(attributes["name"].strip(), attributes["msg_type"].strip())
        except UsageError as error:
            self.add_error(f"<{tag}>: {error.message}", place)
            return
        if tag == "publish_to":
            self.record_latch(topic.topic, attributes.get("latch", "false").strip(), place)
        else:
            self.add_event_name(topic.topic, attributes.get("event"), place)
        self.add_quality(tag, topic.topic, attributes, place)
        self.topics_by_tag[tag].append(topic)

    def add_event_name(self, topic: str, event: Optional[str], place: Place) -> None:
        if event is None or any(entry.topic == topic for entry in self.topics_by_tag["subscribe_to"]):
            # Of several entries for a topic the first one counts.
            return
        error_text = event_name_error(event.strip())
        if error_text is None:
            self.events.append(TopicEvent(topic, event.strip()))
        else:
            self.add_error(f"<subscribe_to>: {error_text}", place)

    def add_quality(self, tag: str, topic: str, attributes: Dict[str, str], place: Place) -> None:
        texts = {name: attributes.get(name, "auto").strip() for name in QUALITY_ATTRIBUTES}
        try:
            quality = QualityOfService(
                _read_policy("reliability", texts["reliability"], "reliable", "best_effort"),
                _read_policy("durability", texts["durability"], "transient_local", "volatile"),
                _read_depth(texts["depth"]),
            )
        except UsageError as error:
            self.add_error(f"<{tag}>: {error.message}", place)
            return
        # Of several entries for a topic the first one counts.
        if quality != ANY_QUALITY and all(entry.topic != topic for entry in self.topics_by_tag[tag]):
            self.qualities[tag].append(TopicQuality(topic, quality))

    def record_latch(self, topic: str, value: str, place: Place) -> None:
        if value == "true":
            self.latched.add(topic)
        elif value != "false":
            self.add_error(f'<publish_to>: latch is "true" or "false", found "{shorten(value)}"', place)

    def add_error(self, message: str, place: Place) -> None:
        self.errors.append(RuleError(message, place))


def _read_policy(name: str, text: str, strict: str, lenient: str) -> Optional[bool]:
    """Return whether a policy is the strict one; None for ``auto``."""
    policies = {strict: True, lenient: False, "auto": None}
    if text not in policies:
        raise UsageError(f'{name} is {", ".join(policies)}, found "{shorten(text)}"')
    return policies[text]


def _read_depth(text: str) -> Optional[int]:
    """Return the depth of a queue; None for ``auto``."""
    if text == "auto":
        return None
    if not (text.isascii() and text.isdecimal() and len(text) < 10 and 0 < int(text) <= MAX_QUEUE_DEPTH):
        raise UsageError(f'depth is auto or a number from 1 to {MAX_QUEUE_DEPTH}, found "{shorten(text)}"')
    return int(text)
