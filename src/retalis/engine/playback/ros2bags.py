"""ROS 2 bags (SQLite and mcap), read as if ROS 1 had recorded them; types as the ``rosbags`` package knows them."""

import logging
import re
import shutil
from contextlib import ExitStack
from itertools import islice, takewhile
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Callable, Collection, Counter, Dict, Iterator, List, NamedTuple, Optional, Tuple

from ...foundation import MessageError, beginning, counted, plain_type, shortened, topic_fault
from ...messages import Installed, Ros2Type, ros2_type
from .bags import BagError, PathLike, Record, Topic
from .decompression import MAX_CHUNK_MEGABYTES, ChunkLimit, copy_up_to, reason, zstd_reader
from .storages import Connection, McapFile, SqliteFile, Storage

log = logging.getLogger("retalis")

COMPRESSED = ".zstd"
"""The ending that ``ros2 bag record --compression-mode file`` adds to the name of a file."""

SUFFIXES = (".db3", ".mcap", f".db3{COMPRESSED}", f".mcap{COMPRESSED}")
"""Endings of the files of a ROS 2 bag."""

METADATA = "metadata.yaml"
"""The file that makes a folder a bag of ROS 2."""

MAX_UNPACKED_RATIO = 100
"""Largest ratio of a compressed file's size unpacked to its own, if that is more than the limit of a chunk.

An unpacked file may also take at most half of the free disk space.
"""

MAX_METADATA_BYTES = 4_000_000

_HEADINGS = re.compile(r"^(?:={20,}|IDL:.*)$", re.MULTILINE)
"""Lines between the definitions of types in IDL, which are not IDL themselves."""


class _Way(NamedTuple):
    """A topic, and what makes ROS 1's bytes of its messages."""

    topic: Topic
    converted: Callable[[bytes], bytes]


class Ros2BagReader:
    """A bag of ROS 2 that is open for reading: a folder with ``metadata.yaml``, or one of its files.

    Types have ROS 1's names, and a header has the sequence number 0. Arguments, attributes and methods are those of
    `BagReader`.

    Raises:
        BagError: where it cannot be read.
    """

    def __init__(self, path: PathLike, max_chunk_megabytes: int = MAX_CHUNK_MEGABYTES):
        self.path = Path(path)
        self._limit = ChunkLimit(max_chunk_megabytes)
        self._stack = ExitStack()
        self._files, self._has_packed_messages = _open(self.path, self._limit, self._stack)
        self._sources = self._read_types()
        self.topics: Tuple[Topic, ...] = tuple(source.topic for source in self._sources.values())
        self.messages = sum(connection.messages for file in self._files for connection in file.connections)
        full = [file for file in self._files if any(connection.messages for connection in file.connections)]
        self.start = min((file.start for file in full), default=0)
        self.end = max((file.end for file in full), default=0)

    def _read_types(self) -> "Dict[Tuple[str, str], _Way]":
        """Return how to read each topic by its name and type; warn of those that cannot be read."""
        merged: Dict[Tuple[str, str], Connection] = {}
        for file in self._files:
            for connection in file.connections:
                key = connection.topic, connection.type
                known = merged.get(key)
                if known is not None:
                    messages = known.messages + connection.messages
                    connection = (known if known.definition else connection)._replace(messages=messages)
                merged[key] = connection
        types = _Types()
        sources: Dict[Tuple[str, str], _Way] = {}
        unreadable: Dict[Tuple[str, str], List[str]] = {}
        for key, connection in merged.items():
            try:
                sources[key] = types.source(connection)
            except MessageError as error:
                problem = str(error).partition("\n")[0]  # without the text of the line
                topics = unreadable.setdefault((plain_type(connection.type), problem), [])
                topics.append(_shown(connection.topic))
        for (kind, problem), topics in unreadable.items():
            names = f"topic{'s' if len(topics) > 1 else ''} {', '.join(sorted(topics))}"
            log.warning("%s: left out: %s (%s): %s", self.path, names, _shown(kind), problem)
        return sources

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
        wanted = None if topics is None else {name.lstrip("/") for name in topics}
        try:
            for file in self._files:
                ways = {
                    connection.id: self._sources[connection.topic, connection.type]
                    for connection in file.connections
                    if (connection.topic, connection.type) in self._sources
                    and (wanted is None or connection.topic.lstrip("/") in wanted)
                }
                if not ways:
                    continue
                for identifier, time, data in file.read(ways, start, stop):
                    topic, converted = ways[identifier]
                    try:
                        raw = converted(
                            self._limit.unpack_message(data) if self._has_packed_messages else data
                        )
                    except MessageError as error:
                        name = _shown(topic.name)
                        if not dropped[name]:
                            log.warning("%s: a message on %s is dropped: %s", self.path, name, error)
                        dropped[name] += 1
                        continue
                    yield Record(topic, time, raw)
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
        self._read: Dict[Tuple[str, str], Ros2Type] = {}

    def source(self, connection: Connection) -> _Way:
        """Return how to read a connection.

        Raises:
            MessageError: where its type is not defined, or the definition is wrong.
        """
        if connection.format != "cdr":
            raise MessageError(f"its messages are in '{beginning(connection.format)}': expected cdr")
        key = connection.type, connection.definition
        found = self._read.get(key)
        if found is None:
            text = self._definition(connection)
            found = self._read[key] = ros2_type(connection.type, text, self._find)
        definition = found.definition
        topic = Topic(
            connection.topic,
            definition.name,
            definition.full_text,
            definition.md5sum,
            connection.messages,
        )
        return _Way(topic, found.to_ros1)

    def _definition(self, connection: Connection) -> str:
        name, text = connection.type, connection.definition
        if not text:
            found = self._find(plain_type(name))
            if found is None:
                raise MessageError("the type is not defined in the bag or on this system")
            return found
        if connection.encoding.endswith("idl") or text.lstrip("=\r\n ").startswith("IDL:"):
            return self._of_idl(name, text)
        return text

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


def _open(path: Path, limit: ChunkLimit, stack: ExitStack) -> Tuple[List[Storage], bool]:
    """Return the open files of a bag, which the stack closes, and whether each message is compressed."""
    try:
        import rosbags.typesys  # noqa: F401, PLC0415 - an optional package, which brings those that decompress
    except ImportError:
        raise BagError("reading bags needs the Python package rosbags (pip install rosbags)") from None
    with ExitStack() as opened:
        try:
            paths, has_packed_messages = _read_metadata(path / METADATA) if path.is_dir() else ([path], False)
            files: List[Storage] = []
            for file in paths:
                if file.suffix == COMPRESSED:
                    folder = opened.enter_context(TemporaryDirectory(prefix="retalis-"))
                    file = _unpack(file, Path(folder) / file.stem, limit)
                kind = McapFile if file.suffix == ".mcap" else SqliteFile
                files.append(kind(file, limit))
                opened.callback(files[-1].close)
        except BagError:
            raise
        except Exception as error:  # broken bags raise whatever their bytes lead to
            raise BagError(f"{path} is not a complete ROS 2 bag: {reason(error)}") from error
        stack.push(opened.pop_all())
    return files, has_packed_messages


def _read_metadata(path: Path) -> Tuple[List[Path], bool]:
    """Return the files of a bag in their order, and whether each message is compressed.

    Raises:
        ValueError: for a text that does not say it.
    """
    size = path.stat().st_size
    if size > MAX_METADATA_BYTES:
        raise ValueError(f"{path.name} has {size} bytes: expected at most {MAX_METADATA_BYTES}")
    values = _metadata_values(path.read_text(encoding="utf-8"))
    names = [name.rpartition("/")[2] for name in values.get("relative_file_paths", [])]
    storage, mode, form = ("".join(values.get(name, [])) for name in _METADATA_SCALARS)
    ending = {"sqlite3": ".db3", "mcap": ".mcap"}.get(storage)
    if not names or ending is None:
        raise ValueError(f"{path.name} names no files, or no storage_identifier: expected sqlite3 or mcap")
    mode = mode.lower() or "none"
    if mode not in ("none", "file", "message") or (mode != "none" and form != COMPRESSED[1:]):
        raise ValueError(
            f"its compression by '{mode}' with '{form}' is unknown: expected zstd by file or message"
        )
    if len(set(names)) < len(names):
        raise ValueError("a file is named twice")
    files = [path.parent / name for name in names]
    for file in files:
        if file.suffix != (COMPRESSED if mode == "file" else ending):
            raise ValueError(f"the name '{file.name}' does not end as one of storage '{storage}'")
        if not file.is_file():
            raise ValueError(f"its file {file.name} is missing")
    return files, mode == "message"


_METADATA_SCALARS = ("storage_identifier", "compression_mode", "compression_format")
_METADATA_KEYS = (*_METADATA_SCALARS, "relative_file_paths")


def _metadata_values(text: str) -> Dict[str, List[str]]:
    """Return the values of the four keys that are needed, each as a list.

    A reader of all YAML takes 10 s for 5,000 brackets, and does not end for a mapping that is merged three times into
    each of forty others. This one reads the form in which ``ros2 bag`` and ``rosbags`` write: the keys on lines of
    their own, one level deep, and a list in brackets or with a dash before each of its values.
    """
    lines = text.splitlines()
    values: Dict[str, List[str]] = {}
    level = -1
    for number, line in enumerate(lines):
        content = line.lstrip(" ")
        depth = len(line) - len(content)
        key, colon, value = content.partition(":")
        if level < 0 and depth and colon:
            level = depth
        if depth != level or key not in _METADATA_KEYS or key in values or not colon:
            continue
        value = value.strip()
        rest = islice(lines, number + 1, None)
        if value.startswith("["):
            parts = [value]
            while "]" not in parts[-1]:
                parts.append(next(rest, "]"))
            values[key] = [_unquoted(part) for part in "".join(parts)[1:].partition("]")[0].split(",")]
        elif value:
            values[key] = [_unquoted(value)]
        else:
            items = takewhile(lambda item: item.startswith("- "), (item.strip() for item in rest))
            values[key] = [_unquoted(item[2:]) for item in items]
    return values


def _unquoted(value: str) -> str:
    value = value.strip()
    if value[:1] in ('"', "'") and value[-1:] == value[:1]:
        return value[1:-1]
    return "" if value in ("~", "null") else value


def _unpack(path: Path, target: Path, limit: ChunkLimit) -> Path:
    """Unpack a compressed file; return the new one.

    Raises:
        BagError: if it would take too much disk space.
    """
    allowed = min(
        max(limit.bytes, MAX_UNPACKED_RATIO * path.stat().st_size),
        shutil.disk_usage(target.parent).free // 2,
    )
    with path.open("rb") as packed, zstd_reader(packed) as source, target.open("wb") as file:
        if copy_up_to(source, file, allowed) > allowed:
            raise BagError(
                f"{path} is too large: unpacked it would have more than {counted(allowed, 'byte')} "
                "(--max-chunk-megabytes allows more)"
            )
    return target
