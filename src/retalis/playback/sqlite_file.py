"""Reading of the SQLite files (``.db3``) of ROS 2 bags.

The files are not trusted: a database may only have plain tables, and is limited to a number of virtual machine
instructions and of bytes.

A recorder that was killed leaves its newest messages in the write-ahead log (``.db3-wal``). They are read, and
nothing is written, as `read_only_sqlite` describes.

A database that is shorter than its header states, or whose pages are damaged, is read by the primary key of its
messages up to the first one that cannot be read: the index of their times may be damaged, too. They are sorted if
they are not in order of time.
"""

import os
import sqlite3
from collections import Counter
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Collection, Dict, Iterator, List, Mapping, Optional, Tuple

from ..foundation.interrupts import check_interrupt, is_interrupted
from ..foundation.read_only_sqlite import open_without_locks
from ..messages.ros2_definitions import find_interfaces
from .decompression import ChunkLimit, describe_error
from .incomplete_files import IncompleteFile
from .message_merge import MAX_TIME, Message
from .ros2_connections import Connection
from .rosbag1 import IncompleteBagError
from .sqlite_damage import count_complete_rows, read_stated_size

_BASE_QUERY_STEPS = 1_000_000
_STEPS_PER_BYTE = 10
"""Limit for the virtual machine instructions of a query: a row has at least 10 bytes, and takes about 20 of them."""

_STEPS_PER_CALLBACK = 1000

_TOO_MANY_BYTES_MESSAGE = "its rows have more bytes than the file: some name the same pages"

_LIMIT_LENGTH = 0
"""``SQLITE_LIMIT_LENGTH`` of ``sqlite3.h``: maximum size of a string, blob or row."""

_MAX_LENGTH = (1 << 31) - 1
"""Maximum value of a limit, which is a C ``int``."""


class SqliteFile:
    """A ``.db3`` file.

    Attributes:
        connections: topics of the file.
        start, end: times of the first and the last message in nanoseconds; 0 if there are none.
        incomplete_file: description of what is missing, without the path; None if the file is complete.

    Raises:
        Exception: if the file cannot be read.
    """

    def __init__(self, path: Path, limit: ChunkLimit):
        # The log is beside the file itself, not beside a symbolic link to it.
        path = path.resolve()
        log_size = _measure_log(path)
        file_size = path.stat().st_size
        self._size = file_size + log_size
        # The newest pages of a database with a log are in the log only.
        missing_bytes = 0 if log_size else max(0, read_stated_size(path) - file_size)
        self._messages = "messages"
        """Table of the messages, or the part of it that can be read."""
        self._order = "ORDER BY timestamp"
        self._steps = 0
        self.start = self.end = 0
        problem = None
        is_data_complete = False
        with ExitStack() as stack:
            self._database = open_without_locks(path)
            stack.callback(self._database.close)
            # Older versions of Python cannot limit single values; the number of rows and steps is limited in any
            # case.
            set_limit = getattr(self._database, "setlimit", None)  # from Python 3.11
            if set_limit is not None:
                set_limit(_LIMIT_LENGTH, min(limit.bytes + 1, self._size + 1, _MAX_LENGTH))
            self._database.set_progress_handler(self._count_steps, _STEPS_PER_CALLBACK)
            if log_size:
                problem = "its recorder has not closed it (it has a write-ahead log, which is read)"
            elif _has_journal(path):
                problem = (
                    "its recorder has not ended a transaction (it has a rollback journal, which is ignored)"
                )
            try:
                if missing_bytes:
                    raise sqlite3.DatabaseError("it is shorter than it states")
                self.connections = self._read_connections(self._count_messages())
                self.start, self.end = self._read_times()
            except sqlite3.DatabaseError as error:
                problem = f"{describe_error(error)}{f', and {problem}' if problem else ''}"
                is_data_complete = self._recover(None if log_size else path)
            self._stack = stack.pop_all()
        self.incomplete_file = None
        if problem is not None:
            message_count = sum(connection.messages for connection in self.connections)
            self.incomplete_file = IncompleteFile(
                "",
                problem,
                message_count,
                self.end,
                missing_bytes=missing_bytes,
                is_data_complete=is_data_complete,
            )

    def read(self, ids: Collection[int], start: Optional[int], stop: Optional[int]) -> Iterator[Message]:
        """Yield the messages of connections in order of time, from ``start`` and before ``stop``.

        Raises:
            Exception: if the file is malformed.
        """
        # SQLite does not know a table whose first page is missing.
        if not any(connection.messages for connection in self.connections):
            return
        query = (
            f"SELECT topic_id, timestamp, data FROM {self._messages} "
            f"WHERE topic_id IN ({','.join(map(str, ids))})"
        )
        arguments = []
        for operator, bound in ((">=", start), ("<", stop)):
            if bound is not None:
                query += f" AND timestamp {operator} ?"
                arguments.append(bound)
        for identifier, time, data in self._query_limited(f"{query} {self._order}", *arguments):
            # SQLite does not enforce the types of columns.
            if time.__class__ is not int or data.__class__ is not bytes:
                raise ValueError("a message is not an integer and a blob")
            yield identifier, time, data

    def close(self) -> None:
        """Close the file."""
        self._stack.close()

    def _query_limited(self, query: str, *arguments: object) -> Iterator[Tuple[Any, ...]]:
        """Yield the rows of a query, which may not have more bytes than the file."""
        # Rows of a malformed database can share pages, so that a small file returns gigabytes.
        remaining = self._size
        for row in self._execute(query, *arguments):
            remaining -= sum(len(value) for value in row if isinstance(value, (str, bytes)))
            if remaining < 0:
                raise ValueError(_TOO_MANY_BYTES_MESSAGE)
            yield row

    def _execute(self, query: str, *arguments: object) -> Iterator[Tuple[Any, ...]]:
        """Yield the rows of a query; raise `ValueError` if it takes more steps than the size of the file allows."""
        # The budget is per query. A crafted schema could otherwise make a query run forever.
        self._steps = _BASE_QUERY_STEPS + _STEPS_PER_BYTE * self._size
        try:
            # `yield from` would close the cursor of an abandoned iterator, which raises after the file was closed.
            for row in self._database.execute(query, arguments):  # noqa: UP028
                yield row
        except sqlite3.OperationalError as error:
            check_interrupt()
            if self._steps >= 0:
                raise
            raise ValueError("its tables have more rows than a file of its size can hold") from error

    def _count_steps(self) -> bool:
        self._steps -= _STEPS_PER_CALLBACK
        return self._steps < 0 or is_interrupted()  # True interrupts the query

    def _recover(self, path: Optional[Path]) -> bool:
        """Read a damaged database up to the first message that is damaged; return whether there is none.

        Args:
            path: the database; None if it has a write-ahead log, which has some of its pages.

        Raises:
            ValueError: if its topics cannot be read.
        """
        # Without this, SQLite does not open a database that is shorter than its header states. Nothing is written.
        self._database.execute("PRAGMA writable_schema = ON")
        try:
            self._require_tables()
            connections = self._read_connections({})
            ((root_page,),) = self._query_limited(
                "SELECT rootpage FROM sqlite_master WHERE name = 'messages'"
            )
        except (sqlite3.DatabaseError, ValueError) as error:
            raise ValueError(
                f"it is cut or damaged, and its topics cannot be read: {describe_error(error)}"
            ) from error
        counts: Counter[int] = Counter()
        self.start, previous_time, is_in_order = MAX_TIME, 0, True
        count, is_complete = (-1, True) if path is None else count_complete_rows(path, root_page)
        try:
            # The primary key is used, because the index of the times may be damaged, too.
            for identifier, time, data in self._query_limited(
                f"SELECT topic_id, timestamp, data FROM messages NOT INDEXED LIMIT {count}"
            ):
                if time.__class__ is not int or data.__class__ is not bytes:
                    is_complete = False
                    break
                counts[identifier] += 1
                self.start, self.end = min(self.start, time), max(self.end, time)
                is_in_order = is_in_order and time >= previous_time
                previous_time = time
        except sqlite3.DatabaseError:
            is_complete = False
        count = sum(counts.values())
        if not count:
            self.start = 0
        # A query with this limit ends before it reads the damaged page.
        self._messages = f"(SELECT topic_id, timestamp, data FROM messages NOT INDEXED LIMIT {count})"
        if is_in_order:
            self._order = ""
        self.connections = [connection._replace(messages=counts[connection.id]) for connection in connections]
        return is_complete

    def _require_tables(self) -> None:
        """Raise `ValueError` if a table is missing."""
        for table in ("topics", "messages"):
            if not self._has_table(table):
                raise ValueError(f"it has no table '{table}': expected a database that ros2 bag has written")

    def _count_messages(self) -> Mapping[int, int]:
        """Return the number of messages by the id of their topic."""
        self._require_tables()
        return dict(self._query_limited("SELECT topic_id, count(*) FROM messages GROUP BY topic_id"))

    def _read_connections(self, counts: Mapping[int, int]) -> List[Connection]:
        """Return the topics, with the definitions and the number of their messages."""
        definitions: Dict[str, Tuple[str, str]] = {}
        if self._has_table("message_definitions"):
            rows = self._query_limited(
                "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
            )
            for name, encoding, text in rows:
                definitions.setdefault(_require_text(name), (_require_text(encoding), _require_text(text)))
        connections = []
        for identifier, topic, name, message_format in self._query_limited(
            "SELECT id, name, type, serialization_format FROM topics"
        ):
            # rosbag2 stores the definition of the events of a service under the name of the service.
            owners = find_interfaces(_require_text(name))
            stored_names = [
                name,
                *(interface.name.replace("/", f"/{folder}/") for interface, folder in owners),
            ]
            stored_definitions = (definitions.get(stored_name) for stored_name in stored_names)
            encoding, text = next(filter(None, stored_definitions), ("", ""))
            message_count = counts.get(identifier, 0)
            connections.append(
                Connection(
                    int(identifier),
                    _require_text(topic),
                    name,
                    encoding,
                    text,
                    _require_text(message_format),
                    message_count,
                )
            )
        return connections

    def _has_table(self, name: str) -> bool:
        """Return whether there is a table; raise `ValueError` if it is not a plain one.

        A view or a generated column would execute SQL from the file, which may run forever or produce gigabytes.
        """
        rows = list(self._query_limited("SELECT type, sql FROM sqlite_master WHERE name = ?", name))
        if not rows:
            return False
        types = [str(object_type) for object_type, sql in rows if str(sql)[:13].upper() == "CREATE TABLE "]
        columns = list(self._query_limited(f"PRAGMA table_xinfo({name})"))
        # Columns: number, name, type, not null, default, primary key, and 0 for columns that are not generated.
        if types != ["table"] or any(column[6] or column[4] is not None for column in columns):
            raise ValueError(
                f"'{name}' is not a plain table: expected columns without defaults or expressions"
            )
        return True

    def _read_times(self) -> Tuple[int, int]:
        ((first, last, size),) = self._query_limited(
            "SELECT min(timestamp), max(timestamp), total(length(data)) FROM messages"
        )
        # Rows that share pages would fill the disk when SQLite sorts them.
        if size > self._size:
            raise ValueError(_TOO_MANY_BYTES_MESSAGE)
        return (0, 0) if first is None else (int(first), int(last))


def _measure_log(path: Path) -> int:
    """Return the size of the write-ahead log of a database; 0 if it has none.

    Raises:
        IncompleteBagError: if the log cannot be read.
    """
    log_path = f"{path}-wal"
    if not os.path.lexists(log_path):
        return 0
    try:
        with open(log_path, "rb") as file:
            return os.fstat(file.fileno()).st_size
    except OSError as error:
        raise IncompleteBagError(
            f"{path}: its write-ahead log {path.name}-wal, which has the newest messages, cannot be read: "
            f"{describe_error(error)}: make the log readable, or copy both files to another folder"
        ) from error


def _has_journal(path: Path) -> bool:
    """Return whether a database has a rollback journal.

    SQLite would change the file to undo its last transaction, and may delete a file that the journal names.
    """
    journal_path = f"{path}-journal"
    return os.path.exists(journal_path) and os.path.getsize(journal_path) > 0


def _require_text(text: object) -> str:
    if not isinstance(text, str):
        raise ValueError("a name or a definition is not text")
    return text
