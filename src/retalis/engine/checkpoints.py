"""The state of an engine in an SQLite file, written again and again while it runs.

What has not changed is not written again: the program is there once, and of memories only the records that are new.
Each time is one transaction, in write-ahead mode: a process that is killed leaves the state of the last one.

Keeping the state of a running engine in a file, and taking it up from there.
"""

import os
import sqlite3
import threading
import time
from itertools import count
from pathlib import Path
from random import SystemRandom
from typing import Any, Dict, Iterable, Iterator, List, NamedTuple, Optional, Sequence, Tuple
from zlib import crc32

from ..events.knowledge.memory import NEVER, MemoryInstance
from ..events.program.program_folder import GOALS, TOPICS
from ..foundation.errors import UsageError
from ..messages.type_registry import Definitions
from ..serialization.codec import from_bytes, to_bytes
from ..serialization.memory_state import NewRecords, keep_records, new_records
from ..serialization.schema import anything, dict_of, text
from ..serialization.state_sections import (
    FORMAT,
    LAYOUT,
    SECTIONS,
    about,
    check_version,
    read_records,
    read_section,
)
from .deployment import Deployment
from .engine import Engine
from .engine_settings import Settings
from .engine_snapshot import EngineSnapshot, checked
from .program_loader import REQUEST
from .runtime.clock import Clock
from .runtime.problem_reports import Reports

APPLICATION = 0x72746C73
"""``PRAGMA application_id`` of a checkpoint."""

_TABLES = """
CREATE TABLE IF NOT EXISTS sections (name TEXT PRIMARY KEY, data BLOB NOT NULL, checked INTEGER NOT NULL);
CREATE TABLE IF NOT EXISTS records (memory INTEGER, first INTEGER, number INTEGER NOT NULL, data BLOB NOT NULL,
    checked INTEGER NOT NULL, PRIMARY KEY (memory, first));
"""

_ASIDE = ".aside"
"""Suffix of a refused file."""

ProgramFiles = List[Tuple[str, str]]
"""The files that a program is read from: their paths and the digests of what they say."""


MAX_REFUSED_FILES = 9
"""Refused files that are kept."""

MAX_FILE_BYTES = (1 << 31) - 1
"""The largest file that is read: SQLite takes no higher limit."""

_STEP, _STEPS, _BYTES_PER_STEP = 1000, 200, 250
"""Reading ends after so many times so many instructions of SQLite, and as many more for so many bytes of the file."""

_PICKLED = b"\x80\x04"
"""First bytes of a section in older files."""


class FileTaken(UsageError):
    """Another process keeps its state in the file now."""


class RecordBatch(NamedTuple):
    """Records of a memory that came one after the other.

    Attributes:
        memory: its number in the file.
        first: how many records there were before.
        number: how many they are.
        data: they, as bytes.
    """

    memory: int
    first: int
    number: int
    data: bytes


class Checkpoint(NamedTuple):
    """Contents of a checkpoint file.

    Attributes:
        sections: of the state, as data.
        records: of each memory, in parts.
        files: that the program was read from.
        made: when it was written, in seconds since the epoch.
    """

    sections: Dict[str, Any]
    records: List[List[Any]]
    files: ProgramFiles
    made: float


class CheckpointStorage:
    """A file that a state is written to.

    Args:
        path: of the file; where there is one, it goes on to hold what it holds until `write`.

    Attributes:
        next_number: a number that no memory in the file has, and none above it.

    Raises:
        UsageError: where it cannot be written.
    """

    def __init__(self, path: Path):
        self.path = path
        try:
            self._base = sqlite3.connect(str(path), isolation_level=None, check_same_thread=False)
            _value(self._base, "PRAGMA journal_mode = WAL")
            self._base.execute("PRAGMA synchronous = NORMAL")
            # At once, so that whoever reads the file meanwhile, or after a kill, finds nothing or all of it.
            self._base.execute("PRAGMA trusted_schema = OFF")
            self._base.executescript(f"BEGIN; PRAGMA application_id = {APPLICATION}; {_TABLES} COMMIT;")
            _check_schema(self._base)
            newest = _value(self._base, "SELECT max(memory) FROM records")
            self.next_number: int = 0 if newest is None else newest + 1
            self._owner = SystemRandom().randrange(1 << 31)
            self._base.execute(f"PRAGMA user_version = {self._owner}")
        except sqlite3.Error as error:
            raise UsageError(f"cannot write a checkpoint to {path}: {error}") from error

    def write(
        self, sections: Dict[str, bytes], batches: Iterable[RecordBatch], oldest: Dict[int, int]
    ) -> None:
        """Write what has changed, all of it or nothing.

        Args:
            sections: the sections that are other ones than they were.
            batches: records; those take the place of all of their memory from the same one on.
            oldest: of each memory that there is how many records came before the first that it still has.

        Raises:
            UsageError: where it cannot be written; the file has what it had before. `FileTaken` where that is so.
        """
        base = self._base
        try:
            base.execute("BEGIN IMMEDIATE")
            if _value(base, "PRAGMA user_version") != self._owner:
                raise FileTaken(f"another process keeps its state in {self.path} now: this one does no more")
            base.executemany(
                "INSERT OR REPLACE INTO sections VALUES (?, ?, ?)",
                [(name, data, crc32(data)) for name, data in sections.items()],
            )
            for one in batches:
                base.execute("DELETE FROM records WHERE memory = ? AND first >= ?", (one.memory, one.first))
                base.execute("INSERT INTO records VALUES (?, ?, ?, ?, ?)", (*one, crc32(one.data)))
            base.executemany(
                "DELETE FROM records WHERE memory = ? AND first + number <= ?", list(oldest.items())
            )
            self._forget_others(oldest)
            base.execute("COMMIT")
        except sqlite3.Error as error:
            raise UsageError(f"cannot write a checkpoint to {self.path}: {error}") from error
        finally:
            self._give_up()

    def _give_up(self) -> None:
        """Take back what has been begun and not ended."""
        try:
            if self._base.in_transaction:
                self._base.execute("ROLLBACK")
        except sqlite3.Error:  # the one before is being raised; the next one to write begins anew
            return

    def _forget_others(self, kept: Dict[int, int]) -> None:
        there = [memory for (memory,) in self._base.execute("SELECT DISTINCT memory FROM records")]
        gone = [(memory,) for memory in there if memory not in kept]
        if gone:
            self._base.executemany("DELETE FROM records WHERE memory = ?", gone)

    def close(self) -> None:
        """Be done with the file."""
        self._base.close()


def read_checkpoint(path: Path) -> Optional[Checkpoint]:
    """Return what a file holds; None where there is no file, or nothing was written to it yet.

    Nothing is written to the file, and nothing in it is executed.

    Raises:
        UsageError: where it is no checkpoint, is damaged, or comes from another version.
    """
    size = sum(one.stat().st_size for one in (path, Path(f"{path}-wal")) if one.is_file())
    if not path.exists() or (path.is_file() and not path.stat().st_size):
        return None
    if size > MAX_FILE_BYTES:
        raise UsageError(f"it has {size} bytes: the limit is {MAX_FILE_BYTES}")
    try:
        base = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)
    except sqlite3.Error as error:
        raise UsageError(f"it cannot be opened: {error}") from error
    try:
        return _read(base, size)
    except sqlite3.Error as error:
        raise UsageError(f"it is no checkpoint, or damaged: {error}") from error
    finally:
        base.close()


def _limit(base: sqlite3.Connection, size: int) -> None:
    """Have the reading of a database end after as many steps, and at as many bytes, as its file can need."""
    steps = iter(range(_STEPS + size // _BYTES_PER_STEP))
    base.set_progress_handler(lambda: next(steps, None) is None, _STEP)
    if hasattr(base, "setlimit"):  # since Python 3.11
        base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, max(size, 1_000_000))
    base.execute("PRAGMA trusted_schema = OFF")
    base.execute("PRAGMA cell_size_check = ON")


def _schema(base: sqlite3.Connection) -> List[Tuple[Any, ...]]:
    return base.execute("SELECT type, name, tbl_name, sql FROM sqlite_master ORDER BY name").fetchall()


def _check_schema(base: sqlite3.Connection) -> None:
    """Check that a database has the tables of a checkpoint, and no views, triggers, indexes or further tables.

    Raises:
        UsageError: where it has not.
    """
    ours = sqlite3.connect(":memory:")
    try:
        ours.executescript(_TABLES)
        if _schema(ours) != _schema(base):
            raise UsageError("it is a database of something else: its tables are not those of a checkpoint")
    finally:
        ours.close()


def _check_lengths(base: sqlite3.Connection, size: int) -> None:
    """Check that what the tables say they contain fits into the file, before any of it is read."""
    total = 0
    for table, *columns in (("sections", "name", "data"), ("records", "data")):
        for column in columns:
            total += _value(base, f"SELECT total(length({column})) FROM {table}")
        if _value(base, f"SELECT count(*) FROM {table} WHERE typeof(data) <> 'blob'"):
            raise UsageError(f"it is damaged: the table {table} has data of another type")
    if not total <= size:
        raise UsageError("it is damaged: it says that it contains more than the file has")


def _read(base: sqlite3.Connection, size: int) -> Optional[Checkpoint]:
    _limit(base, size)
    base.execute("BEGIN")  # all of one moment
    if not _value(base, "SELECT count(*) FROM sqlite_master"):
        return None  # it has just been made
    if _value(base, "PRAGMA application_id") != APPLICATION:
        raise UsageError("it is a database of something else")
    _check_schema(base)
    _check_lengths(base, size)
    found = {
        name: _whole(data, check)
        for name, data, check in base.execute("SELECT name, data, checked FROM sections")
    }
    if not found:
        return None
    if "about" not in found:
        raise UsageError("it is damaged: it does not say what it is")
    said = _about(found.pop("about"))
    missing = SECTIONS.keys() - found.keys()
    if missing:
        raise UsageError(f"it is damaged: it has no section {', '.join(sorted(missing))}")
    sections = {name: read_section(name, data) for name, data in found.items()}
    if len({number for number, _, _ in said["memories"]}) != len(said["memories"]):
        raise UsageError("it is damaged: two memories have the same records")
    records = [_records(base, *memory) for memory in said["memories"]]
    return Checkpoint(sections, records, said["files"], said["made"])


def _about(data: bytes) -> Dict[str, Any]:
    """Return what a file says of itself.

    Raises:
        UsageError: where it comes from another version, or is damaged.
    """
    if data.startswith(_PICKLED):
        raise UsageError(
            "it was written by an older version of the package: it has format 5 or older, a pickle, which is never "
            f"read; this version reads format {FORMAT}"
        )
    found = from_bytes(data)
    said = dict_of(text, anything)(found)
    check_version(said.get("format"), said.get("layout"))
    checked: Dict[str, Any] = about(found)
    return checked


def _value(base: sqlite3.Connection, query: str) -> Any:
    """Return the one value of a query, which is read to its end: one that waits to go on holds up a commit."""
    ((value,),) = base.execute(query).fetchall()
    return value


def _records(base: sqlite3.Connection, number: int, oldest: int, end: Any) -> List[Any]:
    """Return the records of a memory, in parts.

    Args:
        base: the file.
        number: of the memory.
        oldest: how many records came before the first that it had.
        end: what comes after its last one.
    """
    query = "SELECT data, checked FROM records WHERE memory = ? ORDER BY first"
    parts = [read_records(_whole(*row)) for row in base.execute(query, (number,))]
    first = parts[0][0] if parts else end[0]
    if first > oldest:
        raise UsageError("it is damaged: records of a memory are missing")
    return [*parts, end]


def _whole(data: bytes, check: int) -> bytes:
    if not isinstance(data, bytes) or crc32(data) != check:
        raise UsageError("it is damaged: a part of it is not what was written")
    return data


def about_state(files: ProgramFiles, memories: List[Any], made: float) -> Dict[str, Any]:
    """Return what a file says of itself.

    Args:
        files: that the program was read from.
        memories: of each, in their order, its number in the file, how many records came before the first that it has,
            and what comes after its last one: no records.
        made: when it was written, in seconds since the epoch.
    """
    found = [list(one) for one in files]
    return {"format": FORMAT, "layout": LAYOUT, "files": found, "memories": memories, "made": made}


def put_aside(path: Path) -> Path:
    """Rename a file that is not taken up, with what belongs to it; `MAX_REFUSED_FILES` of them are kept.

    Raises:
        UsageError: where it is no file, or that is not allowed.
    """
    if not path.is_file():
        raise UsageError(f"{path} is no file")
    names = [
        Path(f"{path}{_ASIDE}{number if number > 1 else ''}") for number in range(1, MAX_REFUSED_FILES + 1)
    ]
    aside = next((name for name in names if not name.exists()), names[-1])
    try:
        for ending in ("-wal", "-shm", ""):
            source, target = Path(f"{path}{ending}"), Path(f"{aside}{ending}")
            if source.exists():
                os.replace(source, target)
            elif target.exists():
                target.unlink()
    except OSError as error:
        raise UsageError(f"cannot put {path} aside: {error.strerror}") from error
    return aside


EVERY = 0.5
"""Seconds from one checkpoint to the next where they cost little."""

SHARE = 20
"""A checkpoint is followed by that many times the time that it took, at least."""

RECORDS_PER_STEP = 200
"""Records that are made to bytes in one step, while no other thread of Python runs."""

FINAL_WRITE_SECONDS = 5.0
"""Seconds that the end of a node waits for the last time."""


class _InFile(NamedTuple):
    """What the file has of a memory: its number there, and how many records it ever had."""

    number: int
    added: int


class Checkpointer:
    """Writes the state of an engine to a file while it runs.

    Args:
        engine: whose state.
        file: where to.
        program: the program's folder.
        reports: takes what goes wrong.
        every: seconds from one time to the next.
        files: that the program was read from, where the engine goes on from a checkpoint.

    Attributes:
        written: how many times it has been written.
        longest: the longest time for which the engine had to wait, in seconds.
    """

    def __init__(
        self,
        engine: Engine,
        file: CheckpointStorage,
        program: Path,
        reports: Reports,
        every: float = EVERY,
        files: Optional[ProgramFiles] = None,
    ):
        self._engine = engine
        self._file = file
        self._program = program
        self._reports = reports
        self._every = every
        self._keeper = EngineSnapshot(engine)
        self._memories: Dict[MemoryInstance, _InFile] = {}
        self._numbers = count(file.next_number)
        self._standings: List[Deployment] = []
        self._files: Dict[str, str] = {}
        if files is not None:
            self._standings = list(engine.deployments.values())
            self._files = dict(files)
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="checkpoints", daemon=True)
        self.written = 0
        self.longest = 0.0
        self._look_at_files()

    def begin(self) -> None:
        """Write from now on, in a thread of its own."""
        self._thread.start()

    def end(self) -> None:
        """Write once more, and no more after that; an engine that is at work without end is not waited for."""
        self._ending.set()
        if self._thread.ident is None:
            self._finish()
        else:
            self._thread.join(FINAL_WRITE_SECONDS)

    def _run(self) -> None:
        wait = 0.0
        while not self._ending.wait(wait):
            begin = time.monotonic()
            if not self._write():
                return
            wait = max(self._every, SHARE * (time.monotonic() - begin))
        self._finish()

    def _finish(self) -> None:
        try:
            self._write()
        finally:
            self._file.close()

    def _write(self) -> bool:
        """Write, report what goes wrong, and tell whether to go on."""
        try:
            self.write()
        except Exception as error:  # of whatever kind: the next time may be better, and nobody else says it
            self._keeper = EngineSnapshot(self._engine)  # what has changed is not known any more
            self._memories = {}
            self._reports.error(error)
            return not isinstance(error, FileTaken)
        return True

    def write(self) -> None:
        """Write what has changed since the last time.

        Raises:
            UsageError: where that cannot be written.
        """
        parts = self._engine
        found = parts.executor.call(lambda: parts.dispatcher.undisturbed(self._take), (REQUEST,))
        sections, clauses, records = found
        if clauses is not None:
            sections["clauses"] = to_bytes(clauses)
        self._look_at_files()
        batches = [batch for number, new in records for batch in _batches(number, new)]
        memories = [(number, new.oldest, keep_records(new.end())) for number, new in records]
        sections["about"] = to_bytes(about_state(list(self._files.items()), memories, time.time()))
        self._file.write(sections, batches, {number: new.oldest for number, new in records})
        self.written += 1

    def _look_at_files(self) -> None:
        """Note what files say when they are read: all where the program was loaded or read again, else new ones."""
        parts = self._engine
        standings = list(parts.deployments.values())
        if len(standings) != len(self._standings) or any(
            one is not other for one, other in zip(standings, self._standings)
        ):
            self._standings, self._files = standings, {}
        names = own_files(self._program, [str(path) for path in list(parts.rules.files.loaded)])
        if any(name not in self._files for name in names):
            self._files = {name: self._files.get(name) or digest(name) for name in names}

    def _take(self) -> "Tuple[Dict[str, bytes], Any, List[Tuple[int, NewRecords]]]":
        """Take what has changed, while nothing else is done."""
        begin = time.monotonic()
        found = self._keeper.take(whole=False)
        clauses = found.pop("clauses", None)
        # What is bound for a while has to be made to bytes before anybody goes on; clauses and records never are.
        sections = {name: to_bytes(data) for name, data in found.items()}
        memories: Dict[MemoryInstance, _InFile] = {}
        records = []
        for instance in self._engine.knowledge.memories:
            known = self._memories.get(instance)
            memory = instance.memory
            since = 0 if known is None else min(known.added, memory.changed)
            memory.changed = NEVER
            number = next(self._numbers) if known is None else known.number
            memories[instance] = _InFile(number, memory.added)
            records.append((number, new_records(instance, since)))
        self._memories = memories
        self.longest = max(self.longest, time.monotonic() - begin)
        return sections, clauses, records


def _batches(number: int, new: NewRecords) -> Iterator[RecordBatch]:
    """Yield records as bytes, not too many at once: Python's other threads wait meanwhile."""
    for at in range(0, len(new.records), RECORDS_PER_STEP):
        part = new.part(at, at + RECORDS_PER_STEP)
        yield RecordBatch(number, part.first, len(part.records), to_bytes(keep_records(part)))
        time.sleep(0)


def own_files(folder: Path, loaded: Sequence[str]) -> List[str]:
    """Return the paths of the files that a program is read from.

    Args:
        folder: the program's.
        loaded: the event files that it has loaded.
    """
    own = [str(folder.absolute() / name) for name in (GOALS, TOPICS)]
    return [*own, *(one for one in sorted(loaded) if one not in own)]


def digest(name: str) -> str:
    """Return a digest of what a file says; "none" where it is not there."""
    from hashlib import sha256  # noqa: PLC0415 - loads OpenSSL, and only nodes have checkpoints

    try:
        return sha256(Path(name).read_bytes()).hexdigest()
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
    """Return an engine that goes on from a file, with what the file held; None where there is none.

    Args:
        path: of the file.
        folder: of the program that is to run.
        clock: of the engine; where an error is raised it may have been changed.
        settings: of the engine.
        reports: of the engine.
        definitions: of the engine.

    Raises:
        UsageError: why it cannot go on from there.
    """
    found = checked(lambda: read_checkpoint(path))
    if found is None:
        return None
    _check_files(found.files, folder)

    def work() -> Engine:
        engine = Engine(clock, settings, reports, definitions)
        EngineSnapshot(engine).take_up(found.sections, found.records, folder)
        return engine

    return checked(work), found


def _check_files(files: ProgramFiles, folder: Path) -> None:
    """Check that a program's files say what they said.

    Raises:
        UsageError: where they do not.
    """
    if not files or files[0][0] != str(folder.absolute() / GOALS):
        raise UsageError(f"it is of another program: {files[0][0] if files else 'none'}")
    for name, known in files:
        if digest(name) != known:
            raise UsageError(f"{name} has changed since it was read")
