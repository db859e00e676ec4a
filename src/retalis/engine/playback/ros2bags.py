"""ROS 2 bags (sqlite3 and mcap), read as if ROS 1 had recorded them; the ``rosbags`` package does the work."""

import logging
from pathlib import Path
from typing import Any, Callable, Collection, Dict, Iterator, NamedTuple, Optional, Tuple

from ...foundation import MessageError
from ...messages import Definitions
from .bags import BagError, PathLike, Record, Topic, reason

log = logging.getLogger("retalis")

SUFFIXES = (".db3", ".mcap")
"""What the files of a ROS 2 bag are called."""

_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")

_HEADER = "MSG: std_msgs/Header\n"
_SEQUENCE = "uint32 seq\n"
"""What a header has in ROS 1 only; ``rosbags`` writes it into the bytes and not into the definition."""


class _Way(NamedTuple):
    """A topic, and what makes ROS 1's bytes of its messages."""

    topic: Topic
    converted: Callable[[bytes], bytes]


class Ros2BagReader:
    """A bag of ROS 2 that is open for reading: a folder with ``metadata.yaml``, or one of its files.

    Types have ROS 1's names, and a header has the sequence number 0. Attributes and methods are those of
    `BagReader`.

    Raises:
        BagError: where it cannot be read.
    """

    def __init__(self, path: PathLike):
        self.path = Path(path)
        self._reader = _open(self.path)
        self._types = _Types()
        self._sources: Dict[int, _Way] = {}
        unknown = []
        for connection in self._reader.connections:
            source = self._types.source(connection)
            if source is None:
                unknown.append(f"{connection.topic} ({_plain(connection.msgtype)})")
            else:
                self._sources[connection.id] = source
        if unknown:
            log.warning(
                "%s: left out are topics of types that neither the bag nor this system defines: %s",
                self.path,
                ", ".join(sorted(unknown)),
            )
        self.topics: Tuple[Topic, ...] = tuple(source.topic for source in self._sources.values())
        self.messages: int = self._reader.message_count
        self.start: int = self._reader.start_time if self.messages else 0
        self.end: int = self._reader.end_time - 1 if self.messages else 0

    def records(
        self,
        topics: Optional[Collection[str]] = None,
        start: Optional[int] = None,
        stop: Optional[int] = None,
    ) -> Iterator[Record]:
        """Yield the messages in the order of their receipt; see `BagReader.records`.

        Raises:
            BagError: where the bag turns out to be broken.
        """
        connections = [one for one in self._reader.connections if one.id in self._sources]
        if topics is not None:
            wanted = {name.lstrip("/") for name in topics}
            connections = [one for one in connections if one.topic.lstrip("/") in wanted]
        if not connections:
            return
        try:
            for connection, time, data in self._reader.messages(connections, start, stop):
                source = self._sources[connection.id]
                yield Record(source.topic, time, source.converted(data))
        except Exception as error:  # broken bags raise whatever their bytes lead to
            raise BagError(f"{self.path}: the bag is broken: {reason(error)}") from error

    def close(self) -> None:
        """Close the file."""
        self._reader.close()

    def __enter__(self) -> "Ros2BagReader":
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()


class _Types:
    """The types of a bag's topics: by the definitions in the bag, by those of ROS 2, by what is installed."""

    def __init__(self) -> None:
        from rosbags import typesys  # noqa: PLC0415 - an optional package

        self._typesys: Any = typesys
        self._usual = typesys.get_typestore(typesys.Stores.LATEST)
        self._installed = Definitions()

    def source(self, connection: Any) -> Optional[_Way]:
        """Return how to read a connection, or None where its type is not known."""
        name = connection.msgtype
        store = self._store(name, connection.msgdef)
        if store is None:
            return None
        text, _ = store.generate_msgdef(name, ros_version=1)
        text = text.replace(_HEADER, _HEADER + _SEQUENCE)
        if name == "std_msgs/msg/Header":
            text = _SEQUENCE + text
        definition = Definitions().add(_plain(name), text)
        topic = Topic(
            connection.topic,
            definition.name,
            definition.full_text,
            definition.md5sum,
            connection.msgcount,
        )
        return _Way(topic, lambda data: bytes(store.cdr_to_ros1(data, name)))

    def _store(self, name: str, definition: Any) -> Any:
        text = definition if isinstance(definition, str) else definition.data  # versions of rosbags differ
        if text:
            return self._read(name, text)
        if name in self._usual.types:
            return self._usual
        try:
            return self._read(name, self._installed.find(_plain(name)).full_text)
        except MessageError:
            return None

    def _read(self, name: str, text: str) -> Any:
        typesys = self._typesys
        is_idl = text.lstrip("=\r\n ").startswith("IDL:")
        found = typesys.get_types_from_idl(text) if is_idl else typesys.get_types_from_msg(text, name)
        store = typesys.get_typestore(typesys.Stores.EMPTY)
        for kind in _TIMES:
            found.setdefault(kind, typesys.get_types_from_msg("int32 sec\nuint32 nanosec\n", kind)[kind])
        store.register(found)
        return store


def _plain(name: str) -> str:
    """Return ROS 1's name of a type."""
    return name.replace("/msg/", "/")


def _open(path: Path) -> Any:
    try:
        from rosbags import rosbag2  # noqa: PLC0415 - an optional package
    except ImportError:
        raise BagError("reading bags needs the Python package rosbags (pip install rosbags)") from None
    takes_files = ".mcap" in getattr(rosbag2.Reader, "STORAGE_PLUGINS", ())
    if path.is_file() and not takes_files:
        raise BagError(
            f"{path}: this version of the Python package rosbags reads the folder of a ROS 2 bag "
            f"(with metadata.yaml), not one file of it"
        )
    try:
        reader = rosbag2.Reader(path)
        reader.open()
    except Exception as error:  # broken bags raise whatever their bytes lead to
        raise BagError(f"{path} is not a complete ROS 2 bag: {reason(error)}") from error
    return reader
