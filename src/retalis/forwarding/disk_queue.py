"""Queue of events in an SQLite file, which survives crashes and power failures.

Each event gets a number (id) that is larger than all earlier ones of the file. The session, which is a random text of
the file, and the id identify an event. Receivers drop repetitions by them, so no two events may have the same id. The
file is therefore synchronized with the disk at each commit (``synchronous = FULL``), and an event is only sent
after its commit: otherwise a power failure could remove an event that was sent, and its id would be given again.

The file is in WAL mode, which needs one synchronization for each commit in place of three. The connection holds an
exclusive lock, so a second process is refused. If the queue is full, the oldest events that are not in flight are
deleted. SQLite reuses the pages of deleted events, and the file is shortened when the queue is empty.
"""

import os
import sqlite3
import threading
from pathlib import Path
from typing import Any, Callable, List, NamedTuple, Optional, Sequence, Tuple, TypeVar

from ..foundation.errors import RetalisError, UsageError
from ..foundation.output_files import set_aside

MAX_QUEUED_EVENTS = 1_000_000
"""Limit for the number of events in a queue."""

MAX_SET_ASIDE_FILES = 3
"""Number of damaged files that are kept."""

LOCK_TIMEOUT_SECONDS = 5.0
"""Time limit for the lock of a file: a process that ends may still hold it."""

_APPLICATION_ID = 0x72746C71
"""Number in the header of the file that identifies queues of this package; ``rtlq`` in ASCII."""

_APPLICATION_ID_OFFSET = 68
"""Offset of this number in the header, with its most significant byte first."""

_SCHEMA_VERSION = 1

_EXPECTED_FILE = f"expected a queue of format {_SCHEMA_VERSION}, or no file"

_ROW_OVERHEAD_BYTES = 30
"""Approximate size of a row, without its text."""

_MIN_DROPPED_EVENTS = 100
"""Number of events that are dropped together: single rows release no page."""

_MAX_DELETED_EVENTS = 1000
"""Number of confirmed events that are deleted in one transaction, so that it needs little space on the disk."""

_MAX_UNUSED_PAGES = 250
"""Number of unused pages up to which the file of an empty queue is not shortened."""

_SETTINGS = (
    "PRAGMA journal_mode = WAL",
    "PRAGMA synchronous = FULL",
    # On a full disk, the file can use its own free pages again when the log has been copied into it. This needs as
    # much space as the log has, so the log is short.
    "PRAGMA wal_autocheckpoint = 100",
    "PRAGMA journal_size_limit = 1000000",
    # Some distributions overwrite deleted data by default, which writes each page twice.
    "PRAGMA secure_delete = OFF",
)

_TABLES = (
    "BEGIN IMMEDIATE",
    f"PRAGMA application_id = {_APPLICATION_ID}",
    f"PRAGMA user_version = {_SCHEMA_VERSION}",
    "CREATE TABLE session (session TEXT NOT NULL)",
    "CREATE TABLE events (id INTEGER PRIMARY KEY AUTOINCREMENT, start REAL NOT NULL, end REAL NOT NULL, "
    "text TEXT NOT NULL)",
    "INSERT INTO session SELECT lower(hex(randomblob(16)))",
    "COMMIT",
)

Result = TypeVar("Result")


class ForwardedEvent(NamedTuple):
    """An event for the broker.

    Attributes:
        start: start of its interval in seconds since the epoch.
        end: end of its interval in seconds since the epoch.
        text: its term as text.
    """

    start: float
    end: float
    text: str


class QueuedEvent(NamedTuple):
    """An event of the queue; session and id identify it."""

    session: str
    id: int
    event: ForwardedEvent


class QueueFailed(UsageError):
    """Raised if the file cannot be read or written now, for example because the disk is full."""


class DiskQueue:
    """Queue of events in a file; it may be used by several threads.

    A damaged queue is renamed, and a new one begins. Errors name the parameter of a node that has the path.

    Args:
        path: the file, which is created if it does not exist.
        max_bytes: limit for the size of the file, without its write-ahead log of up to 1 MB.
        max_events: limit for the number of events.
        on_damage: called with the error if a file is damaged.

    Attributes:
        count: number of events that are not confirmed.
        used_bytes: size of the used part of the file.
        set_aside_count: number of damaged files.

    Raises:
        UsageError: if the file cannot be opened, is used by another process, or is no queue.
    """

    def __init__(
        self,
        path: Path,
        max_bytes: int,
        max_events: int = MAX_QUEUED_EVENTS,
        on_damage: Callable[[RetalisError], object] = lambda error: None,
    ):
        # A write-ahead log is beside the file itself, not beside a symbolic link to it.
        self._path = path.resolve()
        self._place = f"parameter ~forward_queue: {self._path}"
        self._max_bytes = max_bytes
        self._max_events = max_events
        self._on_damage = on_damage
        self._lock = threading.Lock()
        self._database: Optional[sqlite3.Connection] = None
        self._is_closed = False
        self._session = ""
        self._next_id = 1
        self._confirmed_id = self._in_flight_id = 0
        """Ids of the last confirmed event, whose row may still exist, and of the last one that was taken."""
        self._undeleted_count = 0
        """Number of confirmed events whose rows exist."""
        self.count = self.used_bytes = self.set_aside_count = 0
        try:
            self._open()
        except sqlite3.OperationalError as error:
            if not _is_disk_full(error):
                raise UsageError(f"{self._place}: {_explain_opening_error(error)}") from error
            # The node starts nevertheless, and opens the file when there is space.

    def append(self, events: Sequence[ForwardedEvent]) -> int:
        """Store events; return the number of events that were dropped to make room for them.

        Raises:
            QueueFailed: if they cannot be stored. Their ids are not used again, so that receivers notice the loss.
        """
        with self._lock:
            try:
                dropped_count, deleted_count = self._run(lambda database: self._append(database, events))
                self._undeleted_count = max(0, self._undeleted_count - deleted_count)
                self.count += len(events) - dropped_count
                return dropped_count
            finally:
                self._next_id += len(events)

    def skip_ids(self, count: int) -> None:
        """Leave out ids for events that were lost before they could be appended."""
        with self._lock:
            self._next_id += count

    def take(self, max_events: int, max_bytes: int) -> List[QueuedEvent]:
        """Return the oldest events that are not in flight, which are in flight from now on.

        Args:
            max_events: limit for their number.
            max_bytes: limit for the length of their texts, which a single event may exceed.

        Raises:
            QueueFailed: if they cannot be read.
        """
        with self._lock:
            return self._run(lambda database: self._take(database, max_events, max_bytes))

    def rewind(self) -> None:
        """Return the events in flight to the queue, so that `take` begins with the oldest unconfirmed event."""
        with self._lock:
            self._in_flight_id = self._confirmed_id

    def confirm(self, session: str, last_id: int, count: int) -> None:
        """Confirm the oldest events in flight; their rows are deleted together with others.

        Args:
            session: their session.
            last_id: id of the last one.
            count: their number.
        """
        with self._lock:
            # A damaged file may have been replaced while they were in flight.
            if session == self._session:
                self._confirmed_id = last_id
                self._undeleted_count += count
                self.count -= count

    def release(self) -> None:
        """Delete confirmed events; if there are none, and the queue is empty, shorten the file.

        Raises:
            QueueFailed: if the file cannot be written.
        """
        with self._lock:
            if self._undeleted_count:
                self._delete_all_confirmed()
            elif not self.count and self._database is not None:
                self._run(self._shorten)

    def close(self) -> None:
        """Delete confirmed events, and close the file."""
        with self._lock:
            try:
                self._delete_all_confirmed()
            except QueueFailed:
                # Confirmed events that are still in the file are sent again, and receivers drop them.
                pass
            self._is_closed = True
            self._close_file()

    # ---- transactions

    def _run(self, work: Callable[[sqlite3.Connection], Result]) -> Result:
        """Run work in a transaction; if the file is damaged, again in a new one.

        Raises:
            QueueFailed: if the file cannot be read or written.
        """
        for _ in range(2):
            try:
                database = self._database or self._open()
                database.execute("BEGIN IMMEDIATE")
                result = work(database)
                database.execute("COMMIT")
            except sqlite3.OperationalError as error:
                self._roll_back(error)
                raise QueueFailed(f"{self._place}: {error}") from error
            except sqlite3.DatabaseError as error:
                self._replace_damaged(error)
            except UsageError as error:
                raise QueueFailed(error.message) from error
            except BaseException:
                # An open transaction would let the next one fail.
                self._close_file()
                raise
            else:
                self.used_bytes = _used_bytes(database)
                return result
        raise QueueFailed(f"{self._place}: two files in succession are damaged")

    def _roll_back(self, error: sqlite3.OperationalError) -> None:
        database = self._database
        if database is None:
            return
        if not _is_disk_full(error):
            # After an input or output error, only a new connection may succeed.
            self._close_file()
        elif database.in_transaction:
            database.execute("ROLLBACK")

    def _append(self, database: sqlite3.Connection, events: Sequence[ForwardedEvent]) -> Tuple[int, int]:
        """Store events; return the numbers of dropped and of deleted ones."""
        deleted_count, dropped_count = self._delete_confirmed(database), 0
        # Rows of half a page waste nearly as much again.
        size = 2 * sum(_ROW_OVERHEAD_BYTES + len(event.text.encode()) for event in events)
        while (
            self.count + len(events) - dropped_count > self._max_events
            or _used_bytes(database) + size > self._max_bytes
        ):
            batch_count = self._delete_confirmed(database)
            deleted_count += batch_count
            if batch_count:
                continue
            batch_count = self._drop_oldest(database, max(_MIN_DROPPED_EVENTS, len(events)))
            dropped_count += batch_count
            if not batch_count:
                break
        database.executemany(
            "INSERT INTO events (id, start, end, text) VALUES (?, ?, ?, ?)",
            ((id, *event) for id, event in enumerate(events, self._next_id)),
        )
        return dropped_count, deleted_count

    def _drop_oldest(self, database: sqlite3.Connection, count: int) -> int:
        """Delete the oldest events that are not in flight: those in flight are older, and will probably arrive."""
        return database.execute(
            "DELETE FROM events WHERE id IN (SELECT id FROM events WHERE id > ? ORDER BY id LIMIT ?)",
            (self._in_flight_id, count),
        ).rowcount

    def _take(self, database: sqlite3.Connection, max_events: int, max_bytes: int) -> List[QueuedEvent]:
        taken: List[QueuedEvent] = []
        rows = database.execute(
            "SELECT id, start, end, text FROM events WHERE id > ? ORDER BY id LIMIT ?",
            (self._in_flight_id, max_events),
        )
        for id, *fields in rows:
            event = ForwardedEvent(*fields)
            max_bytes -= len(event.text)
            if taken and max_bytes < 0:
                break
            taken.append(QueuedEvent(self._session, id, event))
        rows.close()
        if taken:
            self._in_flight_id = taken[-1].id
        return taken

    def _delete_confirmed(self, database: sqlite3.Connection) -> int:
        """Delete some confirmed events; return their number."""
        if not self._undeleted_count:
            return 0
        return database.execute(
            "DELETE FROM events WHERE id IN (SELECT id FROM events WHERE id <= ? ORDER BY id LIMIT ?)",
            (self._confirmed_id, _MAX_DELETED_EVENTS),
        ).rowcount

    def _delete_all_confirmed(self) -> None:
        while self._undeleted_count:
            deleted_count = self._run(self._delete_confirmed)
            # There are none if the file has been replaced.
            self._undeleted_count = max(0, self._undeleted_count - deleted_count) if deleted_count else 0

    @staticmethod
    def _shorten(database: sqlite3.Connection) -> None:
        if _query_number(database, "PRAGMA freelist_count") > _MAX_UNUSED_PAGES:
            # VACUUM copies the contents, which are a few pages, and must not be part of a transaction.
            database.execute("COMMIT")
            database.execute("VACUUM")
            database.execute("BEGIN")

    # ---- the file

    def _open(self) -> sqlite3.Connection:
        """Open the file, and read its state; a damaged queue is replaced.

        Raises:
            UsageError: if the file is no queue, or cannot be created or renamed.
            sqlite3.OperationalError: if the disk is full, or the file is locked.
        """
        if self._is_closed:
            raise UsageError(f"{self._place}: it has been closed")
        try:
            self._open_file()
        except sqlite3.OperationalError:
            self._close_file()
            raise
        except sqlite3.DatabaseError as error:
            self._close_file()
            if not _was_queue(self._path):
                raise UsageError(f"{self._place}: it is not a queue ({error}): {_EXPECTED_FILE}") from error
            self._replace_damaged(error)
            self._open_file()
        assert self._database is not None
        return self._database

    def _open_file(self) -> None:
        path = self._path
        try:
            if not path.exists():
                # Events may be confidential. SQLite gives the write-ahead log the permissions of the file.
                os.close(os.open(path, os.O_CREAT | os.O_RDWR, 0o600))
        except OSError as error:
            raise UsageError(f"{self._place}: it cannot be created: {error.strerror}") from error
        if not path.is_file() or not os.access(path, os.R_OK | os.W_OK):
            raise UsageError(f"{self._place}: expected a file that can be read and written")
        database = self._database = sqlite3.connect(
            str(path), timeout=LOCK_TIMEOUT_SECONDS, isolation_level=None, check_same_thread=False
        )
        # By default, a text with a damaged byte could not be read, and events after it would never be sent.
        database.text_factory = lambda data: data.decode("utf-8", "replace")
        # The lock is taken by the next statement, and needs no shared memory then.
        database.execute("PRAGMA locking_mode = EXCLUSIVE")
        database.execute("PRAGMA trusted_schema = OFF")
        is_new = self._check_format(database)
        for statement in (*_SETTINGS, *(_TABLES if is_new else ())):
            database.execute(statement).fetchall()
        ((session,),) = database.execute("SELECT session FROM session").fetchall()
        # The sequence contains the last id, also if its event has been deleted.
        last_id = _query_number(database, "SELECT coalesce(max(seq), 0) FROM sqlite_sequence")
        if session == self._session:
            # The events in flight stay so: the connection may still confirm them.
            self._next_id = max(self._next_id, last_id + 1)
        else:
            # Events that were lost before the first opening have the ids that follow.
            self._next_id = last_id + (1 if self._session else self._next_id)
            self._session, self._confirmed_id, self._in_flight_id = session, 0, 0
        self.count = _query_number(database, f"SELECT count(*) FROM events WHERE id > {self._confirmed_id}")
        self.used_bytes = _used_bytes(database)

    def _check_format(self, database: sqlite3.Connection) -> bool:
        """Return whether a file has no tables yet.

        Raises:
            UsageError: if it is no queue, or one of a newer version.
        """
        application_id = _query_number(database, "PRAGMA application_id")
        version = _query_number(database, "PRAGMA user_version")
        if application_id == _APPLICATION_ID and version == _SCHEMA_VERSION:
            return False
        if not application_id and not _query_number(database, "SELECT count(*) FROM sqlite_master"):
            return True
        self._close_file()
        is_queue = application_id == _APPLICATION_ID
        problem = (
            f"it is a queue of format {version}" if is_queue else "it is the database of another program"
        )
        raise UsageError(f"{self._place}: {problem}: {_EXPECTED_FILE}")

    def _replace_damaged(self, error: sqlite3.DatabaseError) -> None:
        """Rename a damaged file; the next use creates a new one.

        Raises:
            QueueFailed: if it cannot be renamed.
        """
        self._close_file()
        try:
            new_path = set_aside(self._path, MAX_SET_ASIDE_FILES)
        except OSError as rename_error:
            raise QueueFailed(
                f"{self._place}: it is damaged ({error}) and cannot be renamed: {rename_error.strerror}"
            ) from error
        self.set_aside_count += 1
        self._session, self._next_id = "", 1
        self.count = self._undeleted_count = 0
        self._on_damage(
            RetalisError(
                f"{self._place}: it is damaged ({error}): its events are lost; it is kept as {new_path}, and a new "
                "queue begins"
            )
        )

    def _close_file(self) -> None:
        database, self._database = self._database, None
        if database is not None:
            try:
                database.close()
            except sqlite3.Error:
                # The write-ahead log of a damaged file cannot be copied into it.
                pass


def _was_queue(path: Path) -> bool:
    """Return whether a file that SQLite cannot read was a queue, by its header.

    Raises:
        UsageError: if it cannot be read.
    """
    try:
        with open(path, "rb") as file:
            header = file.read(100)
    except OSError as error:
        raise UsageError(f"parameter ~forward_queue: {path}: it cannot be read: {error.strerror}") from error
    number = int.from_bytes(header[_APPLICATION_ID_OFFSET : _APPLICATION_ID_OFFSET + 4], "big")
    # After a power failure, blocks that were not written yet may be zeros.
    return number == _APPLICATION_ID or not header.strip(b"\0")


def _query_number(database: sqlite3.Connection, query: str) -> int:
    # All rows are fetched: a statement that is not exhausted would block the commit.
    ((number,),) = database.execute(query).fetchall()
    return int(number)


def _used_bytes(database: sqlite3.Connection) -> int:
    def query(name: str) -> int:
        return _query_number(database, f"PRAGMA {name}")

    return (query("page_count") - query("freelist_count")) * query("page_size")


def _is_disk_full(error: Any) -> bool:
    # Python 3.8 has no error codes of SQLite.
    return "full" in str(error)


def _explain_opening_error(error: sqlite3.OperationalError) -> str:
    if "locked" in str(error):
        return "another process uses it: expected a file for this node alone"
    return f"it cannot be opened: {error}"
