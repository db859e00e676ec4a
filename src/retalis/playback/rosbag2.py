"""Reading of ROS 2 bags (SQLite and MCAP files).

`Ros2BagReader` has the interface of `rosbag1.BagReader`. `sqlite_file` and `mcap_file` read one file each; types come
from the definitions in the bag, from ROS 2 (with the package ``rosbags``), or from the installed messages. An MCAP
file can also contain messages of ROS 1.

The files are parsed here instead of with ``rosbags``, so that a malformed file cannot consume more memory or time
than its size justifies.

The files of a split recording may overlap in time, and may be listed in any order. They are merged by the time of
receipt, and a file is read from the time of its first message on.
"""

import logging
import shutil
from collections import Counter
from contextlib import ExitStack
from functools import partial
from itertools import islice, takewhile
from operator import attrgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import (
    Any,
    Callable,
    Collection,
    Dict,
    Iterable,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
    Union,
)

from ..foundation.displayed_text import format_count, quote_shortened, shorten
from ..foundation.errors import MessageError
from ..foundation.ros_name_checks import ros1_type_name, strip_slashes, topic_fault
from ..messages.ros2_definitions import BUILTIN_DEFINITIONS
from ..messages.type_definition import Definition, SerializationFormat
from ..messages.type_registry import Definitions, InstalledTypes, parse_ros2_type
from .decompression import (
    MAX_CHUNK_MEGABYTES,
    ChunkLimit,
    MissingPackageError,
    copy_up_to,
    describe_error,
    zstd_reader,
)
from .incomplete_files import IncompleteFile
from .mcap_file import McapFile
from .message_merge import merge_by_time
from .ros2_connections import Connection
from .rosbag1 import (
    BagError,
    PathLike,
    Record,
    Topic,
    UnreadableTopic,
    import_rosbags,
    report_incomplete_files,
)
from .sqlite_file import SqliteFile

Storage = Union[SqliteFile, McapFile]

log = logging.getLogger("retalis")

_COMPRESSED_SUFFIX = ".zstd"
"""Suffix that ``ros2 bag record --compression-mode file`` adds to file names."""

SUFFIXES = (".db3", ".mcap", f".db3{_COMPRESSED_SUFFIX}", f".mcap{_COMPRESSED_SUFFIX}")
"""Suffixes of the files of a ROS 2 bag."""

METADATA = "metadata.yaml"
"""File that identifies a folder as a ROS 2 bag."""

MAX_UNPACKED_RATIO = 100
"""Maximum ratio of a file's size after decompression to its compressed size, unless the chunk limit is larger.

A decompressed file may also take at most half of the free disk space.
"""

MAX_METADATA_BYTES = 4_000_000

_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
"""First bytes of a zstd frame (RFC 8878)."""


class Ros2BagReader:
    """A ROS 2 bag opened for reading: a folder with ``metadata.yaml`` or with the files of one recording, or a file.

    Types have the names of ROS 1. Attributes and methods are those of `BagReader`.

    Args:
        max_chunk_megabytes: as for `BagReader`.
        message_folders: folders with the types that the bag does not define; see `InstalledTypes`.
        strict: as for `BagReader`.

    Raises:
        BagError: if the bag cannot be read.
    """

    def __init__(
        self,
        path: PathLike,
        max_chunk_megabytes: int = MAX_CHUNK_MEGABYTES,
        message_folders: Sequence[str] = (),
        strict: bool = False,
    ):
        self.path = Path(path)
        self._limit = ChunkLimit(max_chunk_megabytes)
        unreadable: List[UnreadableTopic] = []
        # The files are closed if anything below raises an error.
        with ExitStack() as stack:
            content = _open_files(self.path, self._limit, stack)
            self.incomplete_files = tuple(content.list_incomplete_files(self.path))
            report_incomplete_files(self.incomplete_files, strict)
            files, self._has_packed_messages = content.files, content.has_packed_messages
            self._topics = _read_topics(files, unreadable, message_folders)
            self._stack = stack.pop_all()
        self.unreadable: Tuple[UnreadableTopic, ...] = tuple(unreadable)
        self.topics: Tuple[Topic, ...] = tuple(self._topics.values())
        self.messages = sum(connection.messages for file in files for connection in file.connections)
        non_empty_files = [
            file for file in files if any(connection.messages for connection in file.connections)
        ]
        self.start = min((file.start for file in non_empty_files), default=0)
        self.end = max((file.end for file in non_empty_files), default=0)
        # For `merge_by_time`.
        self._files = sorted(files, key=attrgetter("start"))

    def records(
        self,
        topics: Optional[Collection[str]] = None,
        start: Optional[int] = None,
        stop: Optional[int] = None,
    ) -> Iterator[Record]:
        """Yield the messages in order of receipt; see `BagReader.records`.

        Topics that cannot be read are left out with a warning. Compressed messages that are broken are dropped, with
        a warning for the first one of a topic and their number.

        Raises:
            BagError: if the bag is malformed.
        """
        dropped: Counter[str] = Counter()
        wanted = None if topics is None else {strip_slashes(name) for name in topics}
        self._warn_of_unreadable(wanted)
        sources: List[Tuple[int, Callable[[], Iterator[Record]]]] = []
        for file in self._files:
            connections = {
                connection.id: self._topics[connection.topic, connection.type]
                for connection in file.connections
                if (connection.topic, connection.type) in self._topics
                and (wanted is None or strip_slashes(connection.topic) in wanted)
            }
            if connections:
                sources.append(
                    (file.start, partial(self._read_file, file, connections, start, stop, dropped))
                )
        try:
            yield from merge_by_time(sources)
        except Exception as error:  # malformed bags raise arbitrary exceptions
            raise BagError(f"{self.path}: the bag is broken: {describe_error(error)}") from error
        finally:
            for name, count in dropped.items():
                log.warning("%s: %s on %s dropped", self.path, format_count(count, "message"), name)

    def _read_file(
        self,
        file: Storage,
        connections: Dict[int, Topic],
        start: Optional[int],
        stop: Optional[int],
        dropped: "Counter[str]",
    ) -> Iterator[Record]:
        """Yield the messages of connections of a file; count the dropped ones by topic."""
        for identifier, time, data in file.read(connections, start, stop):
            topic = connections[identifier]
            if not self._is_packed(topic, data):
                yield Record(topic, time, data)
                continue
            try:
                message = self._limit.unpack_message(data)
            except MessageError as error:
                name = _quote_if_invalid(topic.name)
                if not dropped[name]:
                    log.warning("%s: a message on %s is dropped: %s", self.path, name, error)
                dropped[name] += 1
                continue
            yield Record(topic, time, message)

    def _is_packed(self, topic: Topic, data: bytes) -> bool:
        """Return whether a message is compressed: without metadata, by its first bytes."""
        if self._has_packed_messages is None:
            # Messages in CDR begin with a zero byte.
            return data[:4] == _ZSTD_MAGIC and topic.format is SerializationFormat.CDR
        return self._has_packed_messages

    def _warn_of_unreadable(self, wanted: Optional[Collection[str]]) -> None:
        """Log the topics that cannot be read, one line for all topics with the same problem."""
        names: Dict[Tuple[str, str], List[str]] = {}
        for topic in self.unreadable:
            if wanted is None or strip_slashes(topic.name) in wanted:
                names.setdefault((topic.type, topic.problem), []).append(_quote_if_invalid(topic.name))
        for (type_name, problem), topics in names.items():
            subject = f"topic{'s' if len(topics) > 1 else ''} {', '.join(sorted(topics))}"
            log.warning(
                "%s: left out: %s (%s): %s", self.path, subject, _quote_if_invalid(type_name), problem
            )

    def close(self) -> None:
        """Close the files."""
        self._stack.close()

    def __enter__(self) -> "Ros2BagReader":
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()


def _read_topics(
    files: List[Storage], unreadable: List[UnreadableTopic], message_folders: Sequence[str]
) -> Dict[Tuple[str, str], Topic]:
    """Return the readable topics by name and type; append the others to ``unreadable``."""
    merged: Dict[Tuple[str, str], Connection] = {}
    for file in files:
        for connection in file.connections:
            key = connection.topic, connection.type
            previous = merged.get(key)
            if previous is not None:
                messages = previous.messages + connection.messages
                connection = (previous if previous.definition else connection)._replace(messages=messages)
            merged[key] = connection
    types = _Types(message_folders)
    topics: Dict[Tuple[str, str], Topic] = {}
    for key, connection in merged.items():
        try:
            topics[key] = types.read_topic(connection)
        except MessageError as error:
            problem = str(error).partition("\n")[0]  # without the source line
            unreadable.append(UnreadableTopic(connection.topic, ros1_type_name(connection.type), problem))
    return topics


class _Types:
    """Resolver of the types of a bag: definitions in the bag first, then those of ROS 2, then installed ones."""

    def __init__(self, message_folders: Sequence[str]) -> None:
        from rosbags import typesys  # noqa: PLC0415 - an optional package

        self._typesys: Any = typesys
        # Types of ROS 2 that bags without definitions refer to.
        self._ros2_store: Any = typesys.get_typestore(typesys.Stores.LATEST)
        self._installed = InstalledTypes(extra_folders=message_folders)
        self._by_definition: Dict[Tuple[str, str], Definition] = {}

    def read_topic(self, connection: Connection) -> Topic:
        """Return the topic of a connection, with its type in ROS 1 form.

        Raises:
            MessageError: if its type is not defined, or the definition is invalid.
        """
        if connection.format == "ros1":
            # Messages that were converted from a ROS 1 bag, with the complete definition.
            definition = Definitions(self._installed).add(connection.type, connection.definition)
            return _make_topic(connection, definition, SerializationFormat.ROS1)
        if connection.format != "cdr":
            raise MessageError(f"its messages are in '{shorten(connection.format)}': expected cdr or ros1")
        key = connection.type, connection.definition
        cached_definition = self._by_definition.get(key)
        if cached_definition is None:
            text = self._find_definition(connection)
            # Writers also store IDL, which begins with its heading, with the encoding of `.msg`.
            is_idl = connection.encoding.endswith("idl") or text.lstrip("=\n").startswith("IDL:")
            cached_definition = self._by_definition[key] = parse_ros2_type(
                connection.type, text, self._find_text, is_idl
            )
        return _make_topic(connection, cached_definition, SerializationFormat.CDR)

    def _find_definition(self, connection: Connection) -> str:
        if connection.definition.strip():
            return connection.definition
        definition = self._find_text(ros1_type_name(connection.type))
        if definition is None:
            # A type without slots has an empty text, which other definitions only have if they are missing.
            if connection.encoding == "ros2msg":
                return ""
            raise MessageError("the type is not defined in the bag or on this system")
        return definition

    def _find_text(self, type_name: str) -> Optional[str]:
        name = "/msg/".join(type_name.split("/"))
        if name in self._ros2_store.types:
            return str(self._ros2_store.generate_msgdef(name, ros_version=2)[0])
        installed = self._installed.find(type_name)
        return BUILTIN_DEFINITIONS.get(type_name) if installed is None else installed.text


def _make_topic(
    connection: Connection, definition: Definition, serialization_format: SerializationFormat
) -> Topic:
    return Topic(
        connection.topic,
        definition.name,
        definition.full_text,
        definition.md5sum,
        connection.messages,
        format=serialization_format,
    )


def _quote_if_invalid(name: str) -> str:
    """Return the name of a topic or type; it is quoted if ROS does not allow it."""
    return name if topic_fault(name) is None else quote_shortened(name)


class _Content(NamedTuple):
    """The files of a bag.

    Attributes:
        files: the open files.
        has_packed_messages: whether messages are compressed individually; None if no metadata states it.
        paths: the path of each file.
        cut_paths: compressed files that are cut.
        problem: what is wrong with the metadata of a folder; empty if nothing is.
        stated_messages: number of messages in all files; None if no metadata states it.
    """

    files: List[Storage]
    has_packed_messages: Optional[bool]
    paths: List[Path]
    cut_paths: List[Path]
    problem: str
    stated_messages: Optional[int]

    def list_incomplete_files(self, path: Path) -> List[IncompleteFile]:
        """Return the files that are not complete, and the bag itself if its metadata is missing."""
        files = list(self._describe_incomplete_files(path))
        # Several incomplete files share the lost messages, in unknown numbers. Metadata that was written for a file
        # after it was cut states no lost message.
        if len(files) == 1 and self.stated_messages is not None and not files[0].is_data_complete:
            lost_count = self.stated_messages - sum(
                connection.messages for file in self.files for connection in file.connections
            )
            if lost_count > 0:
                files[0] = files[0]._replace(lost_messages=lost_count)
        return files

    def _describe_incomplete_files(self, path: Path) -> Iterator[IncompleteFile]:
        for file, file_path in zip(self.files, self.paths):
            incomplete = file.incomplete_file
            if file_path in self.cut_paths:
                messages = sum(connection.messages for connection in file.connections)
                problem = "its compressed content is cut or damaged"
                if incomplete is None:
                    incomplete = IncompleteFile("", problem, messages, file.end)
                else:
                    incomplete = incomplete._replace(problem=f"{problem}, and unpacked, {incomplete.problem}")
            if incomplete is not None:
                yield incomplete._replace(path=str(file_path))
        if self.problem:
            count = sum(connection.messages for file in self.files for connection in file.connections)
            end = max((file.end for file in self.files), default=0)
            yield IncompleteFile(str(path), self.problem, count, end)


def _open_files(path: Path, limit: ChunkLimit, stack: ExitStack) -> _Content:
    """Return the open files of a bag, which ``stack`` closes."""
    import_rosbags("typesys")
    with ExitStack() as open_files:
        try:
            paths, has_packed_messages, problem, stated_messages = _find_files(path)
            files: List[Storage] = []
            cut_paths: List[Path] = []
            for file in paths:
                unpacked = file
                if file.suffix == _COMPRESSED_SUFFIX:
                    folder = open_files.enter_context(TemporaryDirectory(prefix="retalis-"))
                    unpacked = Path(folder) / file.stem
                    if not _unpack_file(file, unpacked, limit):
                        cut_paths.append(file)
                reader_class = McapFile if unpacked.suffix == ".mcap" else SqliteFile
                try:
                    files.append(reader_class(unpacked, limit))
                except Exception as error:  # malformed bags raise arbitrary exceptions
                    if file in cut_paths:
                        raise ValueError(
                            f"its compressed content is cut or damaged: {describe_error(error)}"
                        ) from error
                    raise
                open_files.callback(files[-1].close)
        except BagError:
            raise
        except Exception as error:  # malformed bags raise arbitrary exceptions
            raise BagError(f"{path} is not a complete ROS 2 bag: {describe_error(error)}") from error
        # Handed over only after all files were opened: an error above closes those that are open already.
        stack.push(open_files.pop_all())
    return _Content(files, has_packed_messages, paths, cut_paths, problem, stated_messages)


def _find_files(path: Path) -> Tuple[List[Path], Optional[bool], str, Optional[int]]:
    """Return the files of a bag in their order, and see `_Content` for the other values.

    Raises:
        ValueError: if the metadata is invalid, or there is none and the files are not those of one recording.
    """
    if not path.is_dir():
        return [path], None, "", None
    metadata = path / METADATA
    # The recorder writes the metadata last.
    if metadata.is_file() and metadata.stat().st_size:
        files, has_packed_messages, stated_messages = _read_metadata(metadata)
        return files, has_packed_messages, "", stated_messages
    names = [file.name for file in path.iterdir() if file.is_file()]
    parts = _list_parts(path.resolve().name, names)
    if not parts:
        raise ValueError(
            f"it has no {METADATA}, and its files are not those of one recording: expected {METADATA}, or files "
            f"{path.resolve().name}_0.mcap or .db3 and so on"
        )
    problem = f"its {METADATA} is {'empty' if metadata.is_file() else 'missing'}"
    return [path / name for name in parts], None, problem, None


def is_ros2_bag(folder_name: str, names: Collection[str]) -> bool:
    """Return whether a folder is a ROS 2 bag, with or without its metadata; arguments as for `_list_parts`."""
    return METADATA in names or bool(_list_parts(folder_name, names))


def _list_parts(folder_name: str, names: Iterable[str]) -> List[str]:
    """Return the files of a recording whose metadata is missing, in their order; an empty list if it is none.

    ``ros2 bag record`` names the files as their folder: ``NAME/NAME_0.mcap``, ``NAME/NAME_1.mcap``.
    """
    parts: Dict[int, str] = {}
    for name in names:
        suffix = max((suffix for suffix in SUFFIXES if name.endswith(suffix)), key=len, default="")
        if not suffix:
            continue
        base, _, number = name[: -len(suffix)].rpartition("_")
        # A folder with a file of another name is a folder of bags.
        if base != folder_name or not number.isdecimal() or len(number) > 9:
            return []
        part = parts.setdefault(int(number), name)
        # While a recorder compresses a file, both exist, and the compressed one is not complete. Other files of one
        # number are those of two recordings.
        if _strip_compression(part) != _strip_compression(name):
            return []
        if part.endswith(_COMPRESSED_SUFFIX):
            parts[int(number)] = name
    return [parts[number] for number in sorted(parts)]


def _strip_compression(name: str) -> str:
    return name[: -len(_COMPRESSED_SUFFIX)] if name.endswith(_COMPRESSED_SUFFIX) else name


def _read_metadata(path: Path) -> Tuple[List[Path], bool, Optional[int]]:
    """Return the files of a bag in their order, whether messages are compressed individually, and their number.

    Raises:
        ValueError: if the metadata is invalid.
    """
    size = path.stat().st_size
    if size > MAX_METADATA_BYTES:
        raise ValueError(f"{path.name} has {size} bytes: expected at most {MAX_METADATA_BYTES}")
    values = _parse_metadata(path.read_text(encoding="utf-8"))
    # Only the file name is used: some versions of ROS 2 wrote paths, and a path must not lead out of the bag.
    names = [name.rpartition("/")[2] for name in values.get("relative_file_paths", [])]
    storage, mode, compression_format = ("".join(values.get(name, [])) for name in _METADATA_SCALARS)
    if not names:
        raise ValueError(f"{path.name} names no files: expected relative_file_paths")
    if len(set(names)) < len(names):
        raise ValueError("a file is named twice")
    if storage not in _SUFFIXES_OF_STORAGE:
        raise ValueError(f"its storage_identifier is '{shorten(storage)}': expected sqlite3 or mcap")
    mode = mode.lower() or "none"
    _check_compression(mode, compression_format)
    suffixes = (_COMPRESSED_SUFFIX,) if mode == "file" else _SUFFIXES_OF_STORAGE[storage]
    files = [path.parent / name for name in names]
    for file in files:
        _check_file(file, suffixes, storage)
    count = "".join(values.get(_MESSAGE_COUNT, []))
    is_count = count.isdecimal() and len(count) < _MAX_COUNT_DIGITS
    return files, mode == "message", int(count) if is_count else None


def _check_compression(mode: str, compression_format: str) -> None:
    """Reject a compression that is not known: its compressed bytes would be read as messages.

    Raises:
        ValueError: for such a compression.
    """
    if mode not in ("none", "file", "message") or (
        mode != "none" and compression_format != _COMPRESSED_SUFFIX[1:]
    ):
        raise ValueError(
            f"its compression by '{mode}' with '{compression_format}' is unknown: expected zstd by file or message"
        )


def _check_file(file: Path, suffixes: Tuple[str, ...], storage: str) -> None:
    """Check a file that the metadata names.

    Args:
        file: the file.
        suffixes: the suffixes that it may have.
        storage: the ``storage_identifier``; may be empty.

    Raises:
        ValueError: if it has another suffix, or is missing.
    """
    if file.suffix not in suffixes:
        raise ValueError(
            f"the name '{file.name}' does not have the suffix of storage '{storage}'"
            if storage
            else f"the storage_identifier is empty, and the name '{file.name}' does not end with .db3 or .mcap"
        )
    if not file.is_file():
        raise ValueError(f"its file {file.name} is missing")


_SUFFIXES_OF_STORAGE = {"sqlite3": (".db3",), "mcap": (".mcap",), "": (".db3", ".mcap")}
"""Suffixes by ``storage_identifier``. ``ros2 bag reindex`` can leave that empty; then the suffix decides."""

_METADATA_SCALARS = ("storage_identifier", "compression_mode", "compression_format")
_MESSAGE_COUNT = "message_count"
_METADATA_KEYS = (*_METADATA_SCALARS, "relative_file_paths", _MESSAGE_COUNT)

_MAX_COUNT_DIGITS = 20
"""Length from which on a number of messages is ignored."""


def _parse_metadata(text: str) -> Dict[str, List[str]]:
    """Return the values of the five keys in `_METADATA_KEYS`, each as a list.

    A complete YAML parser takes 10 s for 5,000 brackets, and does not terminate for a mapping that is merged three
    times into each of forty others. This one parses the form that ``ros2 bag`` and ``rosbags`` write: the keys on
    separate lines, one level deep, and a list in brackets or with a dash before each value.
    """
    lines = text.splitlines()
    values: Dict[str, List[str]] = {}
    key_depth = -1
    for number, line in enumerate(lines):
        content = line.lstrip(" ")
        depth = len(line) - len(content)
        key, colon, value = content.partition(":")
        if key_depth < 0 and depth and colon:
            key_depth = depth
        if depth != key_depth or key not in _METADATA_KEYS or key in values or not colon:
            continue
        value = value.strip()
        following = islice(lines, number + 1, None)
        if value.startswith("["):
            parts = [value]
            while "]" not in parts[-1]:
                parts.append(next(following, "]"))
            values[key] = [_unquote(part) for part in "".join(parts)[1:].partition("]")[0].split(",")]
        elif value:
            values[key] = [_unquote(value)]
        else:
            items = takewhile(lambda item: item.startswith("- "), (item.strip() for item in following))
            values[key] = [_unquote(item[2:]) for item in items]
    return values


def _unquote(value: str) -> str:
    value = value.strip()
    if value[:1] in ('"', "'") and value[-1:] == value[:1]:
        return value[1:-1]
    return "" if value in ("~", "null") else value


def _unpack_file(path: Path, target: Path, limit: ChunkLimit) -> bool:
    """Decompress a file; return whether it is complete. Of a file that is cut, the part before the cut is written.

    Raises:
        BagError: if it would take too much disk space.
    """
    max_bytes = min(
        max(limit.bytes, MAX_UNPACKED_RATIO * path.stat().st_size),
        shutil.disk_usage(target.parent).free // 2,
    )
    with path.open("rb") as packed, zstd_reader(packed) as source, target.open("wb") as file:
        try:
            # `read` would lose the bytes that it has decompressed before the cut.
            copied_bytes = copy_up_to(source.read1, file, max_bytes)
        except (MissingPackageError, OSError):
            raise
        except Exception:  # any exception of the decompression library
            return False
    if copied_bytes > max_bytes:
        raise BagError(
            f"{path} is too large: unpacked it would have more than {format_count(max_bytes, 'byte')} "
            "(--max-chunk-megabytes allows more)"
        )
    return True
