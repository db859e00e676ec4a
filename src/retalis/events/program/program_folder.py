"""The folder of a program: ``pub_sub.xml``, ``goalPredicates.txt`` and what these name."""

from pathlib import Path
from typing import Callable, Dict, FrozenSet, List, NamedTuple, Optional, Set, Tuple, Union
from xml.parsers import expat

from ...foundation.errors import (
    SHOWN,
    Errors,
    Place,
    ProgramErrors,
    RetalisError,
    RuleError,
    SyntaxFault,
    UsageError,
    beginning,
    place_in,
    printable,
    undecodable,
)
from ...foundation.ros_names import plain_type, topic_fault, type_fault
from ..language.event_declarations import event_fault

GOALS = "goalPredicates.txt"
TOPICS = "pub_sub.xml"
RULES = "eventRules.txt"

ATTRIBUTES = {"subscribe_to": ("name", "msg_type", "event"), "publish_to": ("name", "msg_type", "latch")}
"""The elements of ``pub_sub.xml`` that say something, and what they may say."""

MAX_XML_CHARACTERS = 4_000_000
"""Characters that ``pub_sub.xml`` may have."""

MAX_XML_DEPTH = 100
"""How deep its elements may lie in each other."""


class TopicType(NamedTuple):
    """A topic's name, as written (it may be relative), and its message type ``pkg/Type``.

    >>> playback = Playback(folder, report=print, topics=[TopicType("scan", "sensor_msgs/LaserScan")])
    """

    topic: str
    type: str


DIRECT = (TopicType("tf", "tf/tfMessage"), TopicType("ar_pose_marker", "ar_pose/ARMarkers"))
"""The topics that node retalis subscribes by itself by default, as the original did."""


AUTO = "auto"
"""The value of ``~direct`` for those topics of `DIRECT` that ``pub_sub.xml`` does not name."""

DirectTopics = Union[bool, str, Tuple[TopicType, ...]]
"""The value of ``~direct``: `AUTO`, True, False, or the topics."""

_DIRECT_WORDS: Dict[str, Union[bool, str]] = {"auto": AUTO, "true": True, "false": False}


def topic_type(topic: str, kind: str) -> TopicType:
    """Return a topic and its type, as they came from outside; the type may be written as in ROS 2 (``pkg/msg/Type``).

    Raises:
        UsageError: where one of them is not a name that ROS allows.
    """
    kind = plain_type(kind)
    fault = topic_fault(topic) or type_fault(kind)
    if fault is not None:
        raise UsageError(fault)
    return TopicType(topic, kind)


class TopicEvent(NamedTuple):
    """A topic's name, as written, and what its events are called."""

    topic: str
    event: str


class Topics(NamedTuple):
    """What ``pub_sub.xml`` says.

    Attributes:
        subscribed: topics that become events.
        published: topics that are published, with their types.
        latched: names of those whose last message goes to every subscriber that comes later.
        events: subscribed topics whose events have a name of their own, each with that.
    """

    subscribed: Tuple[TopicType, ...] = ()
    published: Tuple[TopicType, ...] = ()
    latched: FrozenSet[str] = frozenset()
    events: Tuple[TopicEvent, ...] = ()

    def event_of(self, topic: str, plain: Callable[[str], str] = str) -> str:
        """Return what the events of a topic are called, "" where they are called by its type.

        Args:
            topic: its name.
            plain: gives the form of a name by which two are compared.
        """
        wanted = plain(topic)
        return next((event for named, event in self.events if plain(named) == wanted), "")


def read_text(path: Union[str, Path]) -> str:
    """Return the text of a file (UTF-8).

    Raises:
        UsageError: where it cannot be read.
    """
    try:
        return Path(path).read_text(encoding="utf-8")
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"cannot read {path}: {undecodable(error)}") from error
    except ValueError as error:  # what no file is called: a NUL, surrogates
        raise UsageError(f"cannot read {str(path)!r}: {error}") from error


def read_topics(path: Union[str, Path]) -> Topics:
    """Read a ``pub_sub.xml``.

    Raises:
        ProgramErrors: all that is wrong with it, each with its place.
        UsageError: where it cannot be read.
    """
    reader = _TopicReader(str(path), read_text(path))
    return reader.read()


def read_direct(value: object) -> DirectTopics:
    """Return which topics node retalis subscribes by itself, as parameter ``~direct`` or option ``--direct`` says.

    Args:
        value: ``auto``, true, false, or a list of topics and types, flat or in pairs; a text may say each of them.

    Raises:
        UsageError: if it says something else, or names a topic or a type that ROS does not allow.
    """
    said = value
    if isinstance(said, str):
        said = _DIRECT_WORDS.get(said.strip().lower(), said.strip())
    if isinstance(said, str) and said.startswith("[") and said.endswith("]"):
        # Names have neither brackets nor commas nor quotes, so a list of pairs reads as a flat one.
        said = [item.strip(" []'\"") for item in said[1:-1].split(",") if item.strip(" []")]
    if isinstance(said, bool) or said == AUTO:
        return said
    if isinstance(said, list):
        flat = [item for entry in said for item in (entry if isinstance(entry, list) else [entry])]
        if len(flat) % 2 == 0 and all(isinstance(item, str) for item in flat):
            return tuple(topic_type(topic, kind) for topic, kind in zip(flat[::2], flat[1::2]))
    raise UsageError(
        "expected auto, true, false, or a list of topics and types [topic, package/Type, ...], "
        f"found {printable(beginning(repr(value)))}"
    )


def direct_topics(
    direct: DirectTopics, topics: Topics, plain: Callable[[str], str] = str
) -> Tuple[TopicType, ...]:
    """Return the topics that node retalis subscribes by itself, which enter the engine live and offline.

    Args:
        direct: the value of ``~direct``.
        topics: those that the program names.
        plain: gives the form of a name by which two are compared.
    """
    if direct is True:
        return DIRECT
    if direct == AUTO:
        named = {plain(topic) for topic, _ in topics.subscribed}
        return tuple(one for one in DIRECT if plain(one.topic) not in named)
    return direct if isinstance(direct, tuple) else ()


def event_types(folder: Path) -> Dict[str, str]:
    """Return the message types of the events of a program's topics that have names of their own.

    None where ``pub_sub.xml`` is wrong or not there, which those say who subscribe its topics.
    """
    try:
        topics = read_topics(folder / TOPICS)
    except RetalisError:
        return {}
    types = dict(reversed(topics.subscribed))
    return {event: types[topic] for topic, event in reversed(topics.events)}


class _TopicReader:
    """Collects ``subscribe_to`` and ``publish_to`` elements, at any depth, and the errors in them."""

    def __init__(self, source: str, text: str):
        self.source = source
        self.text = text
        self.lines = text.splitlines()
        self.parser = expat.ParserCreate()
        self.parser.StartElementHandler = self.element
        self.parser.EndElementHandler = lambda tag: self.open.pop()
        self.parser.StartDoctypeDeclHandler = self.doctype
        self.open: List[Tuple[str, int]] = []
        self.inside = False
        self.found: Dict[str, List[TopicType]] = {"subscribe_to": [], "publish_to": []}
        self.latched: Set[str] = set()
        self.events: List[TopicEvent] = []
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
            if self.open:
                message += f"; <{self.open[-1][0][:SHOWN]}> of line {self.open[-1][1]} is not closed"
            self.errors.append(SyntaxFault(message, self.place(error.lineno, error.offset)))
        if self.errors:
            raise ProgramErrors(self.errors)
        subscribed, published = (tuple(self.found[tag]) for tag in ("subscribe_to", "publish_to"))
        return Topics(subscribed, published, frozenset(self.latched), tuple(self.events))

    def place(self, line: int, offset: int) -> Place:
        text = self.lines[line - 1] if line <= len(self.lines) else ""
        return place_in(self.source, line, offset + 1, text)

    def here(self) -> Place:
        """Return the place where the parser is."""
        return self.place(self.parser.CurrentLineNumber, self.parser.CurrentColumnNumber)

    def doctype(self, *declared: object) -> None:
        """Refuse what entities could be declared in: they make a large text of a few, or read other files."""
        raise SyntaxFault("a document type (<!DOCTYPE ...>) is not allowed", self.here())

    def element(self, tag: str, attributes: Dict[str, str]) -> None:
        place = self.here()
        if len(self.open) >= MAX_XML_DEPTH:
            raise SyntaxFault(f"elements are nested more than {MAX_XML_DEPTH} deep", place)
        tag = tag if tag in self.found else tag[:SHOWN]
        self.open.append((tag, place.line))
        if not self.inside:
            self.inside = True
            if tag != "publish_subscribe":
                self.wrong(f"the root must be <publish_subscribe>, found <{tag}>", place)
            return
        if tag not in self.found:
            if "msg_type" in attributes:  # any other element only groups what is in it
                self.wrong(f"expected <subscribe_to> or <publish_to>, found <{tag}>", place)
            return
        for name in ("name", "msg_type"):
            if not attributes.get(name, "").strip():
                self.wrong(f'<{tag}> needs {name}="..."', place)
                return
        try:
            topic = topic_type(attributes["name"].strip(), attributes["msg_type"].strip())
        except UsageError as error:
            self.wrong(f"<{tag}>: {error.message}", place)
            return
        if tag == "publish_to":
            self.latch(topic.topic, attributes.get("latch", "false").strip(), place)
        else:
            self.name(topic.topic, attributes.get("event"), place)
        self.found[tag].append(topic)

    def name(self, topic: str, event: Optional[str], place: Place) -> None:
        if event is None or any(one.topic == topic for one in self.found["subscribe_to"]):
            return  # of a topic that stands there twice the first counts
        fault = event_fault(event.strip())
        if fault is None:
            self.events.append(TopicEvent(topic, event.strip()))
        else:
            self.wrong(f"<subscribe_to>: {fault}", place)

    def latch(self, topic: str, wanted: str, place: Place) -> None:
        if wanted == "true":
            self.latched.add(topic)
        elif wanted != "false":
            self.wrong(f'<publish_to>: latch is "true" or "false", found "{beginning(wanted)}"', place)

    def wrong(self, message: str, place: Place) -> None:
        self.errors.append(RuleError(message, place))
