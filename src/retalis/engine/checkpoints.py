"""Checkpoints: periodic, incremental copies of an engine's state in an SQLite file.

A checkpoint consists of sections (the program's clauses, rules with their partial matches, timers, counters) and of
the records of each memory. Only the difference to the previous checkpoint is written: a section if it has changed,
and the records that a memory has stored since. Each checkpoint is one transaction in write-ahead mode (SQLite manual,
"Write-Ahead Logging"), so a process that is killed leaves the last complete checkpoint. `Checkpointer` takes the
state in its own thread between two events, which blocks the engine briefly, and encodes and writes it afterwards.

A file is not trusted when it is read: its schema, sizes and checksums are verified, no SQL of the file is executed,
and data is decoded by a codec that creates only known types. `resume` creates an engine from a file if the program's
own files are the same as when the checkpoint was written.
"""

import os
import sqlite3
import sys
import threading
import time
from itertools import count
from pathlib import Path
from random import SystemRandom
from typing import (
    TYPE_CHECKING,
    Any,
    Container,
    Dict,
    Iterable,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
)
from zlib import crc32

from ..events.clock.clock import Clock
from ..events.knowledge.memory import NO_POSITION, MemoryInstance
from ..events.program.topic_configuration import GOALS, TOPICS
from ..foundation.errors import UsageError
from ..foundation.output_files import set_aside
from ..foundation.read_only_sqlite import open_without_locks
from ..messages.type_registry import Definitions
from ..serialization.codec import from_bytes, to_bytes
from ..serialization.columns import DecodedRecords, MemoryRecords, decode_records, encode_records
from ..serialization.state_fields import read_named_values, record_of
from ..serialization.state_file_format import FORMAT_NUMBER, changes_since, check_version
from ..serialization.stored_field_types import (
    ANYTHING,
    COUNT,
    PATH,
    SECONDS,
    TEXT,
    ReadContext,
    compact_record_of,
    sequence_of,
    tuple_of,
    with_path,
)
from .engine import Engine
from .engine_settings import Settings
from .engine_snapshot import convert_errors, decode_sections, records_since
from .runtime.problem_reports import Reports

if TYPE_CHECKING:
    from .loaded_items import Deployment

APPLICATION_ID = 0x72746C73
"""``PRAGMA application_id`` of a checkpoint file, the letters ``rtls``."""

_TABLE_DEFINITIONS = """
CREATE TABLE IF NOT EXISTS sections (name TEXT PRIMARY KEY, data BLOB NOT NULL, checked INTEGER NOT NULL);
CREATE TABLE IF NOT EXISTS records (memory INTEGER, first INTEGER, number INTEGER NOT NULL, data BLOB NOT NULL,
    checked INTEGER NOT NULL, PRIMARY KEY (memory, first));
"""
"""Tables of the file. ``checked`` is a CRC-32 of the data. A row of ``records`` is a `RecordBatch`; ``first`` is its
``earlier_count``, ``number`` its ``record_count``."""

ProgramFiles = List[Tuple[str, str]]
"""Paths of the files that a program was read from, with digests of their contents."""


MAX_REFUSED_FILES = 9
"""Maximum number of refused files; when it is reached, a new one replaces the last one."""

MAX_FILE_BYTES = (1 << 31) - 1
"""Maximum size of a checkpoint in bytes. SQLite accepts no higher length limit."""

_INSTRUCTIONS_PER_STEP, _MIN_STEPS, _BYTES_PER_STEP = 1000, 200, 250
"""Limit of SQLite instructions for reading: `_MIN_STEPS` steps, and one per `_BYTES_PER_STEP` bytes of the file.

One step is `_INSTRUCTIONS_PER_STEP` instructions. The limit ends queries that a crafted file makes run forever.
"""

_DATABASE_ERRORS = (sqlite3.Error, UnicodeDecodeError)
"""Errors of the SQLite module: it decodes messages that quote names of a damaged schema."""

_PICKLE_PREFIX = b"\x80\x04"
"""First bytes of a section in files of format 5 and older, which were pickles."""


class CheckpointFileInUse(UsageError):
    """Another process has opened the checkpoint file for writing; this process writes no more."""


class RecordBatch(NamedTuple):
    """Consecutive records of a memory, encoded.

    Attributes:
        memory: number of the memory in the file.
        earlier_count: number of records that the memory had stored before those of the batch.
        record_count: number of records in the batch.
    """

    memory: int
    earlier_count: int
    record_count: int
    data: bytes


class Checkpoint(NamedTuple):
    """Contents of a checkpoint file.

    Attributes:
        sections: decoded sections of the state, by name.
        records: for each memory its batches of records.
        files: files that the program was read from.
        written_at: time at which the checkpoint was written, in seconds since the epoch.
    """

    sections: Dict[str, Any]
    records: List[List[DecodedRecords]]
    files: ProgramFiles
    written_at: float
    format_number: int


class StoredMemoryPosition(NamedTuple):
    """Records of a memory in a checkpoint file.

    Attributes:
        dropped_count: number of records that were stored before its oldest one.
        end: an empty batch, encoded, positioned after its newest record.
    """

    number: int
    dropped_count: int
    end: object


class CheckpointHeader(NamedTuple):
    """Contents of section ``about``.

    Attributes:
        format: number of the format.
        byte_order: byte order of packed numbers.
        files: files that the program was read from.
        memories: the memories, in order.
        written_at: time of writing, in seconds since the epoch.
    """

    format: int
    byte_order: str
    files: ProgramFiles
    memories: List[StoredMemoryPosition]
    written_at: float


_HEADER = record_of(
    CheckpointHeader,
    format=COUNT,
    byte_order=TEXT,
    files=sequence_of(tuple_of(PATH, TEXT)),
    memories=sequence_of(
        compact_record_of(
            StoredMemoryPosition,
            number=COUNT,
            dropped_count=COUNT,
            end=ANYTHING,
        )
    ),
    written_at=SECONDS,
)


class CheckpointStorage:
    """A checkpoint file that is open for writing.

    Args:
        path: path of the file. An existing checkpoint stays valid until the first `write`.

    Attributes:
        next_number: a memory number greater than all numbers in the file.

    Raises:
        UsageError: if the file cannot be opened for writing, or is not a checkpoint; then it is not changed.
    """

    def __init__(self, path: Path):
        self.path = path
        _check_owned(path)
        try:
            self._database = sqlite3.connect(str(path), isolation_level=None, check_same_thread=False)
            _query_value(self._database, "PRAGMA journal_mode = WAL")
            self._database.execute("PRAGMA synchronous = NORMAL")
            # The schema of an existing file is not trusted: functions in its views and triggers must not run.
            self._database.execute("PRAGMA trusted_schema = OFF")
            # One transaction creates all tables and the application id, so that a reader, also after a kill, finds
            # either an empty database or a complete schema.
            self._database.executescript(
                f"BEGIN; PRAGMA application_id = {APPLICATION_ID}; {_TABLE_DEFINITIONS} COMMIT;"
            )
            _check_schema(self._database)
            newest = _query_value(self._database, "SELECT max(memory) FROM records")
            self.next_number: int = 0 if newest is None else newest + 1
            # The last process that opens the file owns it. `write` compares the number, so that a second engine that
            # starts with the same file does not mix its records with those of the first one.
            self._owner = SystemRandom().randrange(1 << 31)
            self._database.execute(f"PRAGMA user_version = {self._owner}")
        except _DATABASE_ERRORS as error:
            raise UsageError(f"cannot write a checkpoint to {path}: {error}") from error

    def write(
        self, sections: Dict[str, bytes], batches: Iterable[RecordBatch], dropped_counts: Dict[int, int]
    ) -> None:
        """Write the changes since the previous checkpoint in one transaction.

        Args:
            sections: the sections that have changed, encoded.
            batches: new records; a batch replaces all records of its memory from its first record on.
            dropped_counts: for each existing memory, by its number, the number of records that were stored before
                the oldest one that it still has.

        Raises:
            CheckpointFileInUse: if another process writes to the file.
            UsageError: if the transaction fails; the file keeps the previous checkpoint.
        """
        database = self._database
        try:
            database.execute("BEGIN IMMEDIATE")
            if _query_value(database, "PRAGMA user_version") != self._owner:
                raise CheckpointFileInUse(
                    f"{self.path}: another process writes to this file: this one writes no more"
                )
            database.executemany(
                "INSERT OR REPLACE INTO sections VALUES (?, ?, ?)",
                [(name, data, crc32(data)) for name, data in sections.items()],
            )
            for batch in batches:
                # An event out of order is inserted between older records and moves them. All records from there on
                # are new in the batch, so older batches of the same range are replaced.
                database.execute(
                    "DELETE FROM records WHERE memory = ? AND first >= ?",
                    (batch.memory, batch.earlier_count),
                )
                database.execute("INSERT INTO records VALUES (?, ?, ?, ?, ?)", (*batch, crc32(batch.data)))
            # A batch is deleted when the memory has evicted all records of it; batches are never split.
            database.executemany(
                "DELETE FROM records WHERE memory = ? AND first + number <= ?", list(dropped_counts.items())
            )
            self._delete_records_of_missing_memories(dropped_counts)
            database.execute("COMMIT")
        except _DATABASE_ERRORS as error:
            raise UsageError(f"cannot write a checkpoint to {self.path}: {error}") from error
        finally:
            self._roll_back()

    def _roll_back(self) -> None:
        """Roll back a transaction that was not committed."""
        try:
            if self._database.in_transaction:
                self._database.execute("ROLLBACK")
        except sqlite3.Error:
            # The error that made the rollback necessary is already being raised. The next write begins a new
            # transaction.
            return

    def _delete_records_of_missing_memories(self, existing_numbers: Container[int]) -> None:
        stored_numbers = [
            number for (number,) in self._database.execute("SELECT DISTINCT memory FROM records")
        ]
        missing = [(number,) for number in stored_numbers if number not in existing_numbers]
        if missing:
            self._database.executemany("DELETE FROM records WHERE memory = ?", missing)

    def close(self) -> None:
        """Close the file."""
        self._database.close()


def read_checkpoint(path: Path) -> Optional[Checkpoint]:
    """Return the contents of a checkpoint file; None if there is no file or it is empty.

    The file is opened read-only, and no SQL of the file is executed.

    Raises:
        UsageError: if the file is not a checkpoint, is damaged, or has another format version.
    """
    # Pages that were not yet moved into the main file are in the write-ahead log, so the two sizes are added.
    size = sum(file.stat().st_size for file in (path, Path(f"{path}-wal")) if file.is_file())
    if not path.exists() or (path.is_file() and not path.stat().st_size):
        return None
    if size > MAX_FILE_BYTES:
        raise UsageError(f"it has {size} bytes: the limit is {MAX_FILE_BYTES}")
    try:
        database = _open_for_reading(path)
    except _DATABASE_ERRORS as error:
        raise UsageError(f"it cannot be opened: {error}") from error
    try:
        return _read_contents(database, size)
    except _DATABASE_ERRORS as error:
        raise UsageError(f"it is not a checkpoint, or is damaged: {error}") from error
    finally:
        database.close()


def _open_for_reading(path: Path) -> sqlite3.Connection:
    """Return a connection that does not change the database; in a read-only folder, it reads without locks.

    Raises:
        sqlite3.Error: if the database cannot be opened.
    """
    database = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)
    try:
        _query_value(database, "PRAGMA schema_version")
    except sqlite3.OperationalError:
        database.close()
        # SQLite creates its files beside the file itself, not beside a symbolic link to it.
        if os.access(path.resolve().parent, os.W_OK):
            raise
        # Readers of a write-ahead log create an index and locks beside it, which this folder does not permit.
        return open_without_locks(path)
    except _DATABASE_ERRORS:
        # The file is no database; the first query raises the error again.
        return database
    return database


def _check_owned(path: Path) -> None:
    """Check that a file does not exist, is empty, or is a checkpoint file; it is not changed.

    Raises:
        UsageError: if it is another file.
    """
    if path.is_file() and is_foreign_database(path):
        raise UsageError(
            f"cannot write a checkpoint to {path}: it is the database of another program: name another file"
        )


def is_foreign_database(path: Path) -> bool:
    """Return whether a file is a valid SQLite database, but not a checkpoint."""
    try:
        database = open_without_locks(path)
        try:
            has_tables = _query_value(database, "SELECT count(*) FROM sqlite_master")
            application_id = _query_value(database, "PRAGMA application_id")
        finally:
            database.close()
    except _DATABASE_ERRORS:
        return False
    return application_id != APPLICATION_ID and bool(has_tables or application_id)


def _limit_reading(database: sqlite3.Connection, size: int) -> None:
    """Limit the instructions and the value lengths of queries to what a file of ``size`` bytes can need."""
    steps = iter(range(_MIN_STEPS + size // _BYTES_PER_STEP))
    database.set_progress_handler(lambda: next(steps, None) is None, _INSTRUCTIONS_PER_STEP)
    if hasattr(database, "setlimit"):  # since Python 3.11
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, max(size, 1_000_000))
    database.execute("PRAGMA trusted_schema = OFF")
    database.execute("PRAGMA cell_size_check = ON")


def _read_schema(database: sqlite3.Connection) -> List[Tuple[Any, ...]]:
    return database.execute("SELECT type, name, tbl_name, sql FROM sqlite_master ORDER BY name").fetchall()


def _check_schema(database: sqlite3.Connection) -> None:
    """Check that a database has exactly the tables of a checkpoint: no views, triggers, indexes or further tables.

    Raises:
        UsageError: if the schema differs.
    """
    # SQLite stores the text of CREATE statements, so equal schemas have equal rows in ``sqlite_master``.
    expected_database = sqlite3.connect(":memory:")
    try:
        expected_database.executescript(_TABLE_DEFINITIONS)
        if _read_schema(expected_database) != _read_schema(database):
            raise UsageError("it is another database: its tables are not those of a checkpoint")
    finally:
        expected_database.close()


def _check_lengths(database: sqlite3.Connection, size: int) -> None:
    """Check that the lengths in the tables fit into the file before any value is read."""
    total = 0
    for table, *columns in (("sections", "name", "data"), ("records", "data")):
        # ``total`` returns a float and does not overflow, as ``sum`` would for crafted lengths.
        for column in columns:
            total += _query_value(database, f"SELECT total(length({column})) FROM {table}")
        if _query_value(database, f"SELECT count(*) FROM {table} WHERE typeof(data) <> 'blob'"):
            raise UsageError(f"it is damaged: the table {table} has data of another type")
    # Written as `not <=` because the total can be NaN for a crafted file.
    if not total <= size:
        raise UsageError("it is damaged: its rows state more bytes than the file has")


def _read_contents(database: sqlite3.Connection, size: int) -> Optional[Checkpoint]:
    """Return the contents of a checkpoint; None if none has been written yet."""
    _limit_reading(database, size)
    # A transaction, so that all queries see the same checkpoint even if another process writes meanwhile.
    database.execute("BEGIN")
    if not _query_value(database, "SELECT count(*) FROM sqlite_master"):
        # The file was created, and its tables are not committed yet.
        return None
    if _query_value(database, "PRAGMA application_id") != APPLICATION_ID:
        raise UsageError("it is another database: its application id is not that of a checkpoint")
    _check_schema(database)
    _check_lengths(database, size)
    data_by_name = {
        name: _verify_checksum(data, checksum)
        for name, data, checksum in database.execute("SELECT name, data, checked FROM sections")
    }
    if not data_by_name:
        return None
    if "about" not in data_by_name:
        raise UsageError("it is damaged: it has no section about")
    header = _read_header(data_by_name.pop("about"))
    sections = decode_sections(data_by_name)
    if len({memory.number for memory in header.memories}) != len(header.memories):
        raise UsageError("it is damaged: two memories have the same records")
    context = ReadContext(changes=changes_since(header.format))
    records = [_read_batches(database, memory, context) for memory in header.memories]
    return Checkpoint(sections, records, header.files, header.written_at, header.format)


def _read_header(data: bytes) -> CheckpointHeader:
    """Return the decoded section ``about`` of a file.

    Raises:
        UsageError: if the file has another format version or is damaged.
    """
    if data.startswith(_PICKLE_PREFIX):
        raise UsageError(
            "it was written by an older version of the package: it has format 5 or older, a pickle, which is never "
            f"read; this version reads format {FORMAT_NUMBER}"
        )
    fields = from_bytes(data)
    # The version is checked before the full schema: a file of another version has other fields.
    unchecked = read_named_values(fields)
    format_number = check_version(unchecked.get("format"), unchecked.get("byte_order"))
    context = ReadContext(changes=changes_since(format_number))
    return with_path("section about", _HEADER.checker(context))(fields)


def _query_value(database: sqlite3.Connection, query: str) -> Any:
    """Return the single value of a query.

    All rows are fetched, because a statement that is not exhausted keeps a read lock and blocks the commit.
    """
    ((value,),) = database.execute(query).fetchall()
    return value


def _read_batches(
    database: sqlite3.Connection, memory: StoredMemoryPosition, context: ReadContext
) -> List[DecodedRecords]:
    """Return the batches of records of a memory, and its end.

    Args:
        database: the open file.
        memory: the memory.
        context: has the changes from the format of the file.
    """
    end = decode_records(memory.end, context)
    query = "SELECT data, checked FROM records WHERE memory = ? ORDER BY first"
    batches = [
        decode_records(from_bytes(_verify_checksum(*row)), context)
        for row in database.execute(query, (memory.number,))
    ]
    first = batches[0] if batches else end
    if first.earlier_count > memory.dropped_count:
        raise UsageError("it is damaged: records of a memory are missing")
    return [*batches, end]


def _verify_checksum(data: bytes, checksum: int) -> bytes:
    if not isinstance(data, bytes) or crc32(data) != checksum:
        raise UsageError("it is damaged: a checksum is wrong")
    return data


def rename_refused_file(path: Path) -> Path:
    """Rename a refused checkpoint file, with its write-ahead log; at most `MAX_REFUSED_FILES` are kept.

    Raises:
        UsageError: if the path is not a file, is the database of another program, or renaming is not permitted.
    """
    if not path.is_file():
        raise UsageError(f"{path} is not a file")
    if is_foreign_database(path):
        raise UsageError(f"{path} is the database of another program")
    try:
        return set_aside(path, MAX_REFUSED_FILES)
    except OSError as error:
        raise UsageError(f"{path} cannot be renamed: {error.strerror}") from error


MIN_INTERVAL_SECONDS = 0.5
"""Minimum interval between two checkpoints, in seconds."""

MIN_PAUSE_FACTOR = 20
"""Minimum pause after a checkpoint, as a multiple of its CPU time: writing uses at most 5 % of a core.

The time for which it has waited for the engine, for other Python threads and for the disk does not count. Otherwise
the checkpoints of a busy engine, which are needed most, would be the rarest.
"""

MAX_EXPLAINED_EVENTS = 500
"""Maximum number of events in a checkpoint that can be explained after a restart.

An engine records up to 100,000 events for explanations. They change with each event and are encoded while the engine
is blocked, so writing all of them would block it for seconds.
"""

RECORDS_PER_STEP = 200
"""Records that are encoded in one step; other Python threads wait for the duration of a step."""

FINAL_WRITE_SECONDS = 5.0
"""Maximum duration of the final write when a node ends, in seconds."""


class _FilePosition(NamedTuple):
    """Position of a memory in the file: its number, and the number of records ever written."""

    number: int
    written_count: int


class Checkpointer:
    """Periodic writer of an engine's state, in its own thread.

    Args:
        program: folder of the program.
        reports: receives errors.
        interval_seconds: minimum interval between checkpoints, in seconds.
        files: files that the program was read from, if the engine was created by `resume`.

    Attributes:
        checkpoint_count: number of checkpoints written.
        longest_pause_seconds: longest time for which the engine was blocked, in seconds.
        cpu_seconds: CPU time of the last checkpoint, in seconds.
    """

    def __init__(
        self,
        engine: Engine,
        file: CheckpointStorage,
        program: Path,
        reports: Reports,
        interval_seconds: float = MIN_INTERVAL_SECONDS,
        files: Optional[ProgramFiles] = None,
    ):
        self._engine = engine
        self._file = file
        self._program = program
        self._reports = reports
        self._interval_seconds = interval_seconds
        self._snapshot = engine.incremental_snapshot()
        self._file_positions: Dict[MemoryInstance, _FilePosition] = {}
        self._numbers = count(file.next_number)
        self._deployments: List[Deployment] = []
        self._files: Dict[str, str] = {}
        if files is not None:
            self._deployments = list(engine.loaded_deployments().values())
            self._files = dict(files)
        self._stop_requested = threading.Event()
        self._writer_thread = threading.Thread(target=self._run, name="checkpoints", daemon=True)
        self.checkpoint_count = 0
        self.longest_pause_seconds = self.cpu_seconds = 0.0
        self._capture_cpu_seconds = 0.0
        self._update_digests()

    def start(self) -> None:
        """Start the thread that writes."""
        self._writer_thread.start()

    def stop(self) -> None:
        """Write a last checkpoint and stop; wait at most `FINAL_WRITE_SECONDS` for a busy engine."""
        self._stop_requested.set()
        if self._writer_thread.ident is None:
            # The thread was never started: a node that ends immediately still writes a checkpoint.
            self._write_last()
        else:
            self._writer_thread.join(FINAL_WRITE_SECONDS)

    def _run(self) -> None:
        pause = 0.0
        while not self._stop_requested.wait(pause):
            if not self._write_or_report():
                return
            pause = self.pause_seconds
        self._write_last()

    @property
    def pause_seconds(self) -> float:
        """Pause until the next checkpoint, in seconds."""
        return max(self._interval_seconds, MIN_PAUSE_FACTOR * self.cpu_seconds)

    def _write_last(self) -> None:
        """Write the last checkpoint and close the file."""
        try:
            self._write_or_report()
        finally:
            self._file.close()

    def _write_or_report(self) -> bool:
        """Write a checkpoint, or report the error; return whether to continue."""
        try:
            self.write()
        except Exception as error:
            # The thread continues, because the next attempt may succeed, for example when the disk has space again.
            # The failed attempt has reset the change marks, so the next one writes the complete state.
            self._snapshot = self._engine.incremental_snapshot()
            self._file_positions = {}
            self._reports.error(error)
            return not isinstance(error, CheckpointFileInUse)
        return True

    def write(self) -> None:
        """Write the changes since the previous checkpoint.

        Raises:
            UsageError: if the file cannot be written.
        """
        # Only capturing the state blocks the engine; encoding of clauses and records and the disk access do not.
        state = self._engine.do(self._capture_state)
        start_time = time.thread_time()
        try:
            self._write_state(*state)
        finally:
            # The state may have been captured by another thread, whose CPU time is counted there.
            self.cpu_seconds = self._capture_cpu_seconds + time.thread_time() - start_time

    def _write_state(
        self,
        sections: Dict[str, bytes],
        clauses: Any,
        records: "List[Tuple[int, MemoryRecords]]",
    ) -> None:
        """Encode the rest of a state from `_capture_state`, and write it."""
        if clauses is not None:
            sections["clauses"] = to_bytes(clauses)
        self._update_digests()
        batches = [batch for number, unwritten in records for batch in _encode_batches(number, unwritten)]
        memories = [
            StoredMemoryPosition(number, unwritten.dropped_count, encode_records(unwritten.empty_end()))
            for number, unwritten in records
        ]
        header = CheckpointHeader(
            FORMAT_NUMBER, sys.byteorder, list(self._files.items()), memories, time.time()
        )
        sections["about"] = to_bytes(_HEADER.encode(header))
        self._file.write(
            sections, batches, {number: unwritten.dropped_count for number, unwritten in records}
        )
        self.checkpoint_count += 1

    def _update_digests(self) -> None:
        """Update the digests of the program's files.

        After a load or reload all files are read again; otherwise only files that are new.
        """
        engine = self._engine
        deployments = list(engine.loaded_deployments().values())
        if len(deployments) != len(self._deployments) or any(
            deployment is not known_deployment
            for deployment, known_deployment in zip(deployments, self._deployments)
        ):
            self._deployments, self._files = deployments, {}
        names = list_program_files(
            self._program, [str(path) for path in list(engine.program.rules.files.loaded)]
        )
        if any(name not in self._files for name in names):
            self._files = {name: self._files.get(name) or compute_file_digest(name) for name in names}

    def _capture_state(self) -> "Tuple[Dict[str, bytes], Any, List[Tuple[int, MemoryRecords]]]":
        """Return the changes since the previous checkpoint; the engine must be idle during the call.

        Returns:
            The encoded sections that have changed; the clauses or None; for each memory, its number in the file and
            the records that are not in the file.
        """
        start_time, start_cpu_time = time.monotonic(), time.thread_time()
        data_by_name = self._snapshot.capture(
            include_program=False, max_explained_events=MAX_EXPLAINED_EVENTS
        )
        clauses = data_by_name.pop("clauses", None)
        # Variables of matches and values may be bound temporarily, so these sections are encoded before the
        # engine continues. Clauses and records are immutable and can be encoded later.
        sections = {name: to_bytes(data) for name, data in data_by_name.items()}
        file_positions: Dict[MemoryInstance, _FilePosition] = {}
        records = []
        for instance in self._engine.program.knowledge.memories:
            file_position = self._file_positions.get(instance)
            memory = instance.memory
            # `first_changed_position` is the lowest position that an insertion out of order has moved since the
            # previous checkpoint; everything from there on is written again.
            first_changed = (
                0
                if file_position is None
                else min(file_position.written_count, memory.first_changed_position)
            )
            memory.first_changed_position = NO_POSITION
            number = next(self._numbers) if file_position is None else file_position.number
            file_positions[instance] = _FilePosition(number, memory.added_count)
            records.append((number, records_since(instance, first_changed)))
        self._file_positions = file_positions
        self._capture_cpu_seconds = time.thread_time() - start_cpu_time
        self.longest_pause_seconds = max(self.longest_pause_seconds, time.monotonic() - start_time)
        return sections, clauses, records


def _encode_batches(number: int, unwritten: MemoryRecords) -> Iterator[RecordBatch]:
    """Yield records in encoded batches, and let other Python threads run between two batches."""
    for position in range(0, len(unwritten.records), RECORDS_PER_STEP):
        batch = unwritten.slice(position, position + RECORDS_PER_STEP)
        yield RecordBatch(number, batch.earlier_count, len(batch.records), to_bytes(encode_records(batch)))
        time.sleep(0)


def list_program_files(folder: Path, loaded: Sequence[str]) -> List[str]:
    """Return the paths of the files that a program is read from."""
    fixed_files = [str(folder.absolute() / name) for name in (GOALS, TOPICS)]
    return [*fixed_files, *(path for path in sorted(loaded) if path not in fixed_files)]


def compute_file_digest(path: str) -> str:
    """Return the SHA-256 digest of a file, or "none" if it cannot be read."""
    from hashlib import sha256  # noqa: PLC0415 - loads OpenSSL, which only nodes with checkpoints need

    try:
        return sha256(Path(path).read_bytes()).hexdigest()
    except OSError:
        return "none"


def resume(
    path: Path,
    folder: Path,
    clock: Clock,
    settings: Settings,
    reports: Reports,
    definitions: Optional[Definitions] = None,
) -> Optional[Tuple[Engine, Checkpoint]]:
    """Return an engine created from a checkpoint, and the checkpoint; None if there is none.

    Args:
        path: path of the checkpoint file.
        folder: folder of the program that is to run.
        clock: clock of the engine; it may have been changed if an error is raised.
        settings: settings of the engine.
        reports: reports of the engine.
        definitions: known message types.

    Raises:
        UsageError: the reason why the checkpoint cannot be used.
    """
    checkpoint = convert_errors(lambda: read_checkpoint(path))
    if checkpoint is None:
        return None
    _check_files(checkpoint.files, folder)

    def create_engine() -> Engine:
        engine = Engine(clock, settings, reports, definitions)
        engine.incremental_snapshot().restore(
            checkpoint.sections, checkpoint.records, folder, changes_since(checkpoint.format_number)
        )
        return engine

    return convert_errors(create_engine), checkpoint


def _check_files(files: ProgramFiles, folder: Path) -> None:
    """Check that a program's files have not changed since the checkpoint.

    Raises:
        UsageError: if a file has changed, or the checkpoint belongs to another program.
    """
    goal_file = files[0][0] if files else "none"
    if goal_file != str(folder.absolute() / GOALS):
        raise UsageError(f"it is of another program: {goal_file}")
    for name, expected_digest in files:
        if compute_file_digest(name) != expected_digest:
            raise UsageError(f"{name} has changed since it was read")
