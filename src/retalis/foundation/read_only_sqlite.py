"""Opening of SQLite databases that have no writer, such as a recording or a checkpoint on a read-only medium.

A writer that was killed leaves its newest pages in the write-ahead log (``NAME-wal``;
https://www.sqlite.org/wal.html). Usually, SQLite creates an index of the log beside it (``NAME-shm``), and copies the
log into the database when the last connection is closed. `open_without_locks` keeps the index in memory and opens the
database for reading only, so nothing is written, and a log in a read-only folder is read.
"""

import os
import sqlite3
from pathlib import Path


def open_without_locks(path: Path) -> sqlite3.Connection:
    """Return a connection that reads a database with its write-ahead log, and creates no files beside it.

    The schema is not trusted: functions in it that have side effects are not called.

    Raises:
        sqlite3.Error: if the database is empty, or cannot be opened.
    """
    # SQLite searches the log beside the file itself, not beside a symbolic link to it.
    path = path.resolve()
    # SQLite deletes the log of an empty database, although that is opened for reading only.
    if path.is_file() and not path.stat().st_size:
        raise sqlite3.DatabaseError("it is empty: expected a database")
    log_path = f"{path}-wal"
    # Without locks, which need write permission. `immutable` also ignores the log.
    access = "vfs=unix-none" if os.path.isfile(log_path) and os.path.getsize(log_path) else "immutable=1"
    database = sqlite3.connect(f"{path.as_uri()}?mode=ro&{access}", uri=True, check_same_thread=False)
    try:
        # Without shared memory, the index of the log is in this process (SQLite manual, "Use of WAL Without
        # Shared-Memory").
        database.execute("PRAGMA locking_mode = EXCLUSIVE")
        database.execute("PRAGMA trusted_schema = OFF")
    except BaseException:
        database.close()
        raise
    return database
