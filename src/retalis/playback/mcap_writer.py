"""Writing of ROS 2 bags as MCAP files, with the package ``mcap``.

A file has what ``ros2 bag record -s mcap`` writes: definitions as ``ros2msg``, messages in CDR, and the offered
quality of service in the metadata of each channel. ``ros2 bag info`` and ``play`` and Foxglove open such a file
itself. A folder with ``metadata.yaml`` would repeat its contents, and cannot be replaced in one step.
"""

import json
from pathlib import Path
from typing import Any, BinaryIO, Dict, List, Mapping, Optional, Sequence, Tuple

from ..events.program.topic_configuration import QualityOfService
from ..messages.cdr_decoder import list_slot_types
from ..messages.ros2_definitions import format_ros2_text, ros2_type_name
from ..messages.type_definition import Definition
from ..messages.type_registry import parse_ros2_type
from .rosbag1 import BagError, NewBag, PathLike, import_rosbags, log

INCOMPLETE_FILES_RECORD = "retalis.incomplete_files"
"""Name of the metadata record with the incomplete files of the bag that was played; ``files`` is a JSON list."""

_DEFAULT_DEPTH = 10
"""Depth of the queue that tools assume for a topic without demands."""

_QUALITY_TEMPLATE = """\
- history: 1
  depth: {depth}
  reliability: {reliability}
  durability: {durability}
  deadline:
    sec: 9223372036
    nsec: 854775807
  lifespan:
    sec: 9223372036
    nsec: 854775807
  liveliness: 1
  liveliness_lease_duration:
    sec: 9223372036
    nsec: 854775807
  avoid_ros_namespace_conventions: false
"""
"""A quality of service in YAML, with the numbers of ``rmw/types.h``, which all versions of rosbag2 read.

The names of ``metadata.yaml`` in version 9 are not known to older ones. The times are infinite.
"""


class McapWriter(NewBag):
    """A new ROS 2 bag: an MCAP file; a context manager. It is complete when it is closed.

    Args:
        overwrite: whether an existing file may be replaced.
        incomplete_files: records of the files that were incomplete in the bag from which the messages come.

    Raises:
        BagError: if the file exists already, or cannot be written, or the Python package mcap is not installed.
    """

    _MAX_TIME = (1 << 63) - 1

    def __init__(
        self, path: PathLike, overwrite: bool = False, incomplete_files: Sequence[Mapping[str, Any]] = ()
    ):
        try:
            from mcap import writer  # noqa: PLC0415 - an optional package
        except ImportError:
            raise BagError("writing MCAP files needs the Python package mcap (pip install mcap)") from None
        self._mcap: Any = writer
        self._incomplete_files = incomplete_files
        self._file: Optional[BinaryIO] = None
        self._schemas: Dict[Tuple[str, str], int] = {}
        super().__init__(path, overwrite)

    def _start(self, path: Path) -> None:
        self._file = path.open("wb")
        # As `ros2 bag record` does by default, so that every reader can read the file.
        self._writer = self._mcap.Writer(self._file, compression=self._mcap.CompressionType.NONE)
        self._writer.start("ros2", "retalis")
        if self._incomplete_files:
            content = json.dumps([dict(record) for record in self._incomplete_files])
            self._writer.add_metadata(INCOMPLETE_FILES_RECORD, {"files": content})

    def _finish(self) -> None:
        self._writer.finish()
        self._close_file()

    def _close_file(self) -> None:
        if self._file is not None:
            self._file.close()

    def add(self, topic: str, definition: Definition, quality: QualityOfService) -> object:
        """Add a topic; return the argument for `write` that identifies it.

        Args:
            topic: its absolute name.
            definition: its type.
            quality: the quality of service that ``ros2 bag play`` offers.
        """
        with self._discarding_on_error():
            schema = self._add_schema(topic, definition)
            offer = _QUALITY_TEMPLATE.format(
                depth=quality.depth or (1 if quality.is_transient_local else _DEFAULT_DEPTH),
                reliability=2 if quality.is_reliable is False else 1,
                durability=1 if quality.is_transient_local else 2,
            )
            return self._writer.register_channel(topic, "cdr", schema, {"offered_qos_profiles": offer})

    def _add_schema(self, topic: str, definition: Definition) -> int:
        """Add a type, unless it has been added; return its number."""
        key = definition.name, definition.full_text
        if key not in self._schemas:
            text = format_ros2_text(definition).encode()
            self._schemas[key] = self._writer.register_schema(
                ros2_type_name(definition.name), "ros2msg", text
            )
            versions = _list_versions_with_other_slots(definition)
            if versions:
                log.warning(
                    "topic %s: %s has other slots in ROS 2 %s: 'ros2 bag play' needs that type "
                    "(--msg FOLDER), other tools use the definition in the file",
                    topic,
                    definition.name,
                    ", ".join(versions),
                )
        return self._schemas[key]

    def write(self, topic: object, time: int, data: bytes) -> None:
        """Write a message in CDR, with its time in nanoseconds.

        Raises:
            BagError: if the file cannot be written, as on a full disk, or the time is before 1970 or after 2262.
        """
        with self._discarding_on_error():
            self._check_time(time)
            self._writer.add_message(topic, time, data, time)


def _list_versions_with_other_slots(definition: Definition) -> List[str]:
    """Return the versions of ROS 2 since Humble that have a type of this name with other slots."""
    typesys = import_rosbags("typesys")
    name = ros2_type_name(definition.name)
    layout = list_slot_types(definition)
    stores = [store for store in typesys.Stores if store.name.startswith("ROS2_")]
    versions = []
    for store in stores[stores.index(typesys.Stores.ROS2_HUMBLE) :]:
        types = typesys.get_typestore(store)
        if name in types.types:
            text, _ = types.generate_msgdef(name, ros_version=2)
            if list_slot_types(parse_ros2_type(name, text, lambda nested: None)) != layout:
                versions.append(store.name[len("ROS2_") :].capitalize())
    return versions
