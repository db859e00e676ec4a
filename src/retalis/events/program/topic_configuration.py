"""Program folders: names of the files, and the topics in ``pub_sub.xml``.

``pub_sub.xml`` is parsed with expat. Document types are refused, because entities can expand a small text to a huge
one ("billion laughs") or read other files; size and depth are limited. All errors are collected with their positions.
"""

import re
from pathlib import Path
from typing import Callable, Dict, FrozenSet, List, NamedTuple, Optional, Set, Tuple, Union
from xml.parsers import expat

from ...foundation.displayed_text import MAX_SHOWN_CHARACTERS, describe_decode_error, printable, shorten
from ...foundation.errors import (
    Errors,
    ProgramErrors,
    RetalisError,
    RuleError,
    SyntaxFault,
    UsageError,
    suggest_file,
)
from ...foundation.ros_name_checks import ros1_type_name, topic_fault, type_fault
from ...foundation.similar_names import did_you_mean
from ...foundation.source_places import Place, place_at_column
from ...foundation.unsaved_files import unsaved_text
from ...messages.action_events import ACTION_EVENTS, ActionEvent, event_name
from ...messages.type_definition import QUOTED_STRINGS, STRING_FORMS, functor_name
from ..language.event_declarations import event_name_error

GOALS = "goalPredicates.txt"
TOPICS = "pub_sub.xml"
RULES = "eventRules.txt"

PROGRAM_FILES = (GOALS, TOPICS)
"""Files by which the folder of a program is recognized."""

ROOT_ELEMENT = "publish_subscribe"
"""Root element of ``pub_sub.xml``."""

QUALITY_ATTRIBUTES = ("reliability", "durability", "depth")
"""Attributes of elements for topics, for the quality of service of ROS 2; ROS 1 has none."""

SUBSCRIBE, PUBLISH = "subscribe_to", "publish_to"
OBSERVE_ACTION, OBSERVE_SERVICE = "observe_action", "observe_service"

SERVICE_EVENTS = "/_service_event"
"""Suffix of the topic on which ROS 2 publishes the events of a service."""

ATTRIBUTES = {
    SUBSCRIBE: ("name", "msg_type", "event", *QUALITY_ATTRIBUTES),
    PUBLISH: ("name", "msg_type", "latch", *QUALITY_ATTRIBUTES),
    OBSERVE_ACTION: ("name", "action_type", "event"),
    OBSERVE_SERVICE: ("name", "srv_type", "event"),
}
"""Elements of ``pub_sub.xml`` with their attributes; the first two are required."""

ATTRIBUTE_VALUES: Dict[str, Tuple[str, ...]] = {
    "latch": ("true", "false"),
    "reliability": ("reliable", "best_effort", "auto"),
    "durability": ("transient_local", "volatile", "auto"),
    "depth": ("auto",),
}
"""Words that attributes of ``pub_sub.xml`` may have as values; a depth may also be a number."""

ROOT_ATTRIBUTES = {"strings": STRING_FORMS}
"""Attributes of the root element with their values; all are optional, and the first value is the default."""


class ElementSuffixes(NamedTuple):
    """Suffixes of the name, the type and the event that an element has for one of its topics."""

    topic: str = ""
    type: str = ""
    event: str = ""


ELEMENT_SUFFIXES: Dict[str, Tuple[ElementSuffixes, ...]] = {
    SUBSCRIBE: (ElementSuffixes(),),
    PUBLISH: (ElementSuffixes(),),
    OBSERVE_ACTION: tuple(
        ElementSuffixes(f"/{kind}", ActionEvent("", kind).type_name, event_name("", kind))
        for kind in ACTION_EVENTS
    ),
    OBSERVE_SERVICE: (ElementSuffixes(SERVICE_EVENTS, "_Event"),),
}
"""Topics of the elements: of an action one for each kind of event, of a service that of its events."""

_TYPE_ATTRIBUTES = frozenset(attributes[1] for attributes in ATTRIBUTES.values())

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
        strings: form of strings in messages: `QUOTED_STRINGS` or `PLAIN_STRINGS`.
        forwarded: topics that a parameter of the node forwards, which need no type; ``*`` stands for any text.
    """

    subscribed: Tuple[TopicType, ...] = ()
    published: Tuple[TopicType, ...] = ()
    latched: FrozenSet[str] = frozenset()
    events: Tuple[TopicEvent, ...] = ()
    subscribed_quality: Tuple[TopicQuality, ...] = ()
    published_quality: Tuple[TopicQuality, ...] = ()
    strings: str = QUOTED_STRINGS
    forwarded: Tuple[str, ...] = ()

    def event_types(self) -> Dict[str, str]:
        """Return the message types by the event names that the topics define."""
        # Reversed, because the first of several entries for a topic counts.
        types = dict(reversed(self.subscribed))
        return {event: types[topic] for topic, event in reversed(self.events)}

    def event_name_of(self, topic: str, canonical_name: Callable[[str], str] = str) -> str:
        """Return the name of the events of a topic, or "" if they are named by the message type."""
        canonical_topic = canonical_name(topic)
        return next((event for name, event in self.events if canonical_name(name) == canonical_topic), "")

    def functor_name_of(self, topic: TopicType, canonical_name: Callable[[str], str] = str) -> str:
        """Return the name of the functor of a topic's events; see `event_name_of`."""
        return self.event_name_of(topic.topic, canonical_name) or functor_name(topic.type)


def quality_of(
    qualities: Tuple[TopicQuality, ...], topic: str, canonical_name: Callable[[str], str] = str
) -> QualityOfService:
    """Return the demanded quality of service of a topic."""
    canonical_topic = canonical_name(topic)
    return next(
        (quality for name, quality in qualities if canonical_name(name) == canonical_topic), ANY_QUALITY
    )


def read_text(path: Union[str, Path], encoding: str = "utf-8") -> str:
    """Return the text of a file, in UTF-8 by default.

    Raises:
        UsageError: if it cannot be read.
    """
    text = unsaved_text(path)
    if text is not None:
        return text
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
    text = unsaved_text(path)
    if text is not None:
        return text
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
    """
    if direct is True:
        return DEFAULT_DIRECT_TOPICS
    if direct == AUTO:
        subscribed_names = {canonical_name(topic) for topic, _ in topics.subscribed}
        return tuple(
            topic for topic in DEFAULT_DIRECT_TOPICS if canonical_name(topic.topic) not in subscribed_names
        )
    return direct if isinstance(direct, tuple) else ()


def find_program_folder(path: Path) -> Optional[Path]:
    """Return the folder of the program that a file belongs to: the nearest one above, or None."""
    # Folders as they are written come first: relative paths are shorter in messages.
    for folder in (*path.parents, *path.absolute().parents):
        if any((folder / name).is_file() for name in PROGRAM_FILES):
            return folder
    return None


def find_topics(folder: Path) -> Optional[Topics]:
    """Return the topics of a program, or None if ``pub_sub.xml`` is invalid or missing.

    The subscription of the topics reports that.
    """
    try:
        return read_topics(folder / TOPICS)
    except RetalisError:
        return None


class _TopicReader:
    """Parser of ``pub_sub.xml``: collects the elements of `ATTRIBUTES` at any depth, and errors."""

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
        self.topics_by_tag: Dict[str, List[TopicType]] = {SUBSCRIBE: [], PUBLISH: []}
        self.latched: Set[str] = set()
        self.events: List[TopicEvent] = []
        self.qualities: Dict[str, List[TopicQuality]] = {SUBSCRIBE: [], PUBLISH: []}
        self.strings = QUOTED_STRINGS
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
        subscribed, published = (tuple(self.topics_by_tag[tag]) for tag in (SUBSCRIBE, PUBLISH))
        return Topics(
            subscribed,
            published,
            frozenset(self.latched),
            tuple(self.events),
            tuple(self.qualities[SUBSCRIBE]),
            tuple(self.qualities[PUBLISH]),
            self.strings,
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
        tag = tag if tag in ATTRIBUTES else tag[:MAX_SHOWN_CHARACTERS]
        self.open_elements.append((tag, place.line))
        if not self.has_root:
            self.has_root = True
            if tag != ROOT_ELEMENT:
                self.add_error(f"the root must be <{ROOT_ELEMENT}>, found <{tag}>", place)
            self.record_strings(attributes.get("strings", QUOTED_STRINGS).strip(), place)
            return
        if tag not in ATTRIBUTES:
            # Elements with other names only group their contents.
            if not _TYPE_ATTRIBUTES.isdisjoint(attributes):
                known = " or ".join(f"<{name}>" for name in ATTRIBUTES)
                self.add_error(f"expected {known}, found <{tag}>{did_you_mean(tag, ATTRIBUTES, 0.5)}", place)
            return
        self.add_element(tag, attributes, place)

    def add_element(self, tag: str, attributes: Dict[str, str], place: Place) -> None:
        """Add the topics of an element."""
        required = ATTRIBUTES[tag][:2]
        for attribute in required:
            if not attributes.get(attribute, "").strip():
                self.add_error(f'<{tag}> needs {attribute}="..."', place)
                return
        name, type_name = (attributes[attribute].strip() for attribute in required)
        try:
            topic, interface = topic_type(name, type_name)
            topics = tuple(
                topic_type(f"{topic}{suffixes.topic}", f"{interface}{suffixes.type}")
                for suffixes in ELEMENT_SUFFIXES[tag]
            )
        except UsageError as error:
            self.add_error(f"<{tag}>: {error.message}", place)
            return
        if tag == PUBLISH:
            self.record_latch(name, attributes.get("latch", "false").strip(), place)
        else:
            self.add_event_names(tag, topics, attributes.get("event"), place)
        if tag in self.qualities:
            self.add_quality(tag, name, attributes, place)
        self.topics_by_tag[PUBLISH if tag == PUBLISH else SUBSCRIBE] += topics

    def add_event_names(
        self, tag: str, topics: Tuple[TopicType, ...], event: Optional[str], place: Place
    ) -> None:
        """Add the names of the events of an element's topics."""
        if event is None:
            return
        error_text = event_name_error(event.strip())
        if error_text is not None:
            self.add_error(f"<{tag}>: {error_text}", place)
            return
        for (topic, _), suffixes in zip(topics, ELEMENT_SUFFIXES[tag]):
            # Of several entries for a topic the first one counts.
            if all(entry.topic != topic for entry in self.topics_by_tag[SUBSCRIBE]):
                self.events.append(TopicEvent(topic, f"{event.strip()}{suffixes.event}"))

    def add_quality(self, tag: str, topic: str, attributes: Dict[str, str], place: Place) -> None:
        texts = {name: attributes.get(name, "auto").strip() for name in QUALITY_ATTRIBUTES}
        try:
            quality = QualityOfService(
                _read_policy("reliability", texts["reliability"]),
                _read_policy("durability", texts["durability"]),
                _read_depth(texts["depth"]),
            )
        except UsageError as error:
            self.add_error(f"<{tag}>: {error.message}", place)
            return
        # Of several entries for a topic the first one counts.
        if quality != ANY_QUALITY and all(entry.topic != topic for entry in self.topics_by_tag[tag]):
            self.qualities[tag].append(TopicQuality(topic, quality))

    def record_latch(self, topic: str, value: str, place: Place) -> None:
        true, false = ATTRIBUTE_VALUES["latch"]
        if value == true:
            self.latched.add(topic)
        elif value != false:
            self.add_error(f'<publish_to>: latch is "{true}" or "{false}", found "{shorten(value)}"', place)

    def record_strings(self, value: str, place: Place) -> None:
        if value in STRING_FORMS:
            self.strings = value
        else:
            forms = " or ".join(f'"{form}"' for form in STRING_FORMS)
            self.add_error(f'<{ROOT_ELEMENT}>: strings is {forms}, found "{shorten(value)}"', place)

    def add_error(self, message: str, place: Place) -> None:
        self.errors.append(RuleError(message, place))


def _read_policy(name: str, text: str) -> Optional[bool]:
    """Return whether a policy is the strict one, which is the first of its values; None for ``auto``."""
    values = ATTRIBUTE_VALUES[name]
    if text not in values:
        raise UsageError(f'{name} is {", ".join(values)}, found "{shorten(text)}"')
    return (True, False, None)[values.index(text)]


def _read_depth(text: str) -> Optional[int]:
    """Return the depth of a queue; None for ``auto``."""
    if text == "auto":
        return None
    if not (text.isascii() and text.isdecimal() and len(text) < 10 and 0 < int(text) <= MAX_QUEUE_DEPTH):
        raise UsageError(f'depth is auto or a number from 1 to {MAX_QUEUE_DEPTH}, found "{shorten(text)}"')
    return int(text)
