"""ROS 2 bags (sqlite3 and mcap), read as if ROS 1 had recorded them; the ``rosbags`` package reads the files."""

import logging
import re
import shutil
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Callable, Collection, Counter, Dict, Iterator, List, NamedTuple, Optional, Tuple

from ...foundation import MessageError, counted, plain_type, shortened, topic_fault
from ...messages import Installed, ros2_type
from .bags import BagError, PathLike, Record, Topic, reason

log = logging.getLogger("retalis")

COMPRESSED = ".zstd"
"""The ending that ``ros2 bag record --compression-mode file`` adds to the name of a file."""

SUFFIXES = (".db3", ".mcap", f".db3{COMPRESSED}", f".mcap{COMPRESSED}")
"""Endings of the files of a ROS 2 bag."""

MAX_UNPACKED_BYTES = 256 << 30
"""Bytes that a compressed file may have unpacked; it may also take half of the free disk space at most."""

_BLOCK = 1 << 20

_HEADINGS = re.compile(r"^(?:={20,}|IDL:.*)$", re.MULTILINE)
"""Lines between the definitions of types in IDL, which are not IDL themselves."""


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
        self._stack = ExitStack()
        self._reader = _open(self.path, self._stack)
        types = _Types()
        self._sources: Dict[int, _Way] = {}
        unreadable: Dict[Tuple[str, str], List[str]] = {}
        for connection in self._reader.connections:
            try:
                self._sources[connection.id] = types.source(connection)
            except MessageError as error:
                problem = str(error).partition("\n")[0]  # without the text of the line
                topics = unreadable.setdefault((plain_type(connection.msgtype), problem), [])
                topics.append(_shown(connection.topic))
        for (kind, problem), topics in unreadable.items():
            names = f"topic{'s' if len(topics) > 1 else ''} {', '.join(sorted(topics))}"
            log.warning("%s: left out: %s (%s): %s", self.path, names, _shown(kind), problem)
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

        Messages that are not of their type are dropped, with a warning for the first one of a topic and their number.

        Raises:
            BagError: where the bag turns out to be broken.
        """
        dropped: Counter[str] = Counter()
        connections = [one for one in self._reader.connections if one.id in self._sources]
        if topics is not None:
            wanted = {name.lstrip("/") for name in topics}
            connections = [one for one in connections if one.topic.lstrip("/") in wanted]
        if not connections:
            return
        try:
            for connection, time, data in self._reader.messages(connections, start, stop):
                source = self._sources[connection.id]
                try:
                    raw = source.converted(data)
                except MessageError as error:
                    name = _shown(connection.topic)
                    if not dropped[name]:
                        log.warning("%s: a message on %s is dropped: %s", self.path, name, error)
                    dropped[name] += 1
                    continue
                yield Record(source.topic, time, raw)
        except Exception as error:  # broken bags raise whatever their bytes lead to
            raise BagError(f"{self.path}: the bag is broken: {reason(error)}") from error
        finally:
            for name, number in dropped.items():
                log.warning("%s: %s on %s dropped", self.path, counted(number, "message"), name)

    def close(self) -> None:
        """Close the file."""
        self._stack.close()

    def __enter__(self) -> "Ros2BagReader":
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()


class _Types:
    """The types of a bag's topics: by the definitions in the bag, by those of ROS 2, by what is installed."""

    def __init__(self) -> None:
        from rosbags import typesys  # noqa: PLC0415 - an optional package

        self._typesys: Any = typesys
        self._usual: Any = typesys.get_typestore(typesys.Stores.LATEST)
        self._installed = Installed()

    def source(self, connection: Any) -> _Way:
        """Return how to read a connection.

        Raises:
            MessageError: where its type is not defined, or the definition is wrong.
        """
        name = connection.msgtype
        found = ros2_type(name, self._definition(name, connection.msgdef), self._find)
        definition = found.definition
        topic = Topic(
            connection.topic,
            definition.name,
            definition.full_text,
            definition.md5sum,
            connection.msgcount,
        )
        return _Way(topic, found.to_ros1)

    def _definition(self, name: str, given: Any) -> str:
        text = given if isinstance(given, str) else given.data  # versions of rosbags differ
        if not text:
            found = self._find(plain_type(name))
            if found is None:
                raise MessageError("the type is not defined in the bag or on this system")
            return found
        if getattr(getattr(given, "format", None), "name", "") == "IDL" or text.lstrip("=\r\n ").startswith(
            "IDL:"
        ):
            return self._of_idl(name, text)
        return str(text)

    def _of_idl(self, name: str, text: str) -> str:
        store = self._typesys.get_typestore(self._typesys.Stores.EMPTY)
        try:
            usual = getattr(self._usual, "fielddefs", None) or self._usual.FIELDDEFS  # by its version
            store.register({**usual, **self._typesys.get_types_from_idl(_HEADINGS.sub("", text))})
            return str(store.generate_msgdef(name, ros_version=2)[0])
        except Exception as error:  # text of a bag can lead its parser to anything
            problem = shortened(" ".join(reason(error).split()))
            raise MessageError(f"its definition in IDL cannot be read: {problem}") from error

    def _find(self, kind: str) -> Optional[str]:
        name = "/msg/".join(kind.split("/"))
        if name in self._usual.types:
            return str(self._usual.generate_msgdef(name, ros_version=2)[0])
        installed = self._installed.text(kind)
        return None if installed is None else installed[0]


def _shown(name: str) -> str:
    """Return the name of a topic or type, quoted if ROS does not allow it."""
    return name if topic_fault(name) is None else shortened(name)


def _open(path: Path, stack: ExitStack) -> Any:
    """Return the open reader of a bag, which the stack closes."""
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
    with ExitStack() as opened:
        try:
            file = path
            if path.is_file() and path.suffix == COMPRESSED:
                file = Path(opened.enter_context(TemporaryDirectory(prefix="retalis-"))) / path.stem
                _unpack(path, file)
            reader = (rosbag2.Reader if takes_files else _lenient_reader(rosbag2))(file)
            reader.open()
        except BagError:
            raise
        except Exception as error:  # broken bags raise whatever their bytes lead to
            raise BagError(f"{path} is not a complete ROS 2 bag: {reason(error)}") from error
        opened.callback(reader.close)
        stack.push(opened.pop_all())
    return reader


def _lenient_reader(rosbag2: Any) -> Any:
    """Return a reader for ``rosbags`` before 0.10, whose own refuses all of a bag for one definition."""
    from rosbags.rosbag2 import storage_sqlite3  # noqa: PLC0415 - of that version

    base: Any = storage_sqlite3.ReaderSqlite3  # type: ignore[attr-defined]

    class LenientSqlite(base):  # type: ignore[misc]
        """A database whose definitions are taken as they are."""

        def open(self) -> None:
            try:
                super().open()
            except Exception:  # whatever the text of a definition leads to, an AssertionError among it
                if not self.dbconns:
                    raise
                cursor = self.dbconns[-1].cursor()
                (self.schema,) = cursor.execute("SELECT schema_version FROM schema").fetchone()
                rows = cursor.execute(
                    "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions ORDER BY id"
                )
                self.msgtypes = [{"name": row[0], "encoding": row[1], "msgdef": row[2]} for row in rows]

    class LenientReader(rosbag2.Reader):  # type: ignore[misc]
        """A reader whose databases are such."""

        STORAGE_PLUGINS = {**rosbag2.Reader.STORAGE_PLUGINS, "sqlite3": LenientSqlite}  # noqa: RUF012

    return LenientReader


def _unpack(path: Path, target: Path) -> None:
    """Unpack a compressed file.

    Raises:
        BagError: where it would take too much disk space.
    """
    most = min(MAX_UNPACKED_BYTES, shutil.disk_usage(target.parent).free // 2)
    size = 0
    with path.open("rb") as packed, _zstd_reader(packed) as source, target.open("wb") as file:
        while True:
            block = source.read(_BLOCK)
            if not block:
                return
            size += len(block)
            if size > most:
                raise BagError(
                    f"{path} is too large: unpacked it would have more than {counted(most, 'byte')}"
                )
            file.write(block)


def _zstd_reader(packed: Any) -> Any:
    """Return a reader of what is unpacked, by the package that this version of ``rosbags`` needs."""
    try:
        import zstandard  # noqa: PLC0415 - an optional package
    except ImportError:
        from rosbags.rosbag2.reader import zstd  # type: ignore[attr-defined]  # noqa: PLC0415

        return zstd.open(packed, "rb")
    return zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True)
