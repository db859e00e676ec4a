"""SQLite databases without a writer: logs, links, and errors."""

import shutil
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any, Dict, List

import pytest

from retalis.foundation.read_only_sqlite import open_without_locks


@pytest.fixture
def database_with_log(tmp_path: Path) -> Path:
    """A database whose writer was killed: the row 1 is in the file, the row 2 in its log."""
    path = tmp_path / "killed" / "numbers.db"
    path.parent.mkdir()
    source = tmp_path / "numbers.db"
    with closing(sqlite3.connect(str(source))) as database:
        database.executescript(
            "PRAGMA journal_mode = WAL; CREATE TABLE numbers(value); INSERT INTO numbers VALUES(1); "
            "PRAGMA wal_checkpoint(TRUNCATE); INSERT INTO numbers VALUES(2);"
        )
        shutil.copy(source, path)
        shutil.copy(f"{source}-wal", f"{path}-wal")
    return path


def contents(folder: Path) -> Dict[Any, Any]:
    return {file.name: file.read_bytes() for file in folder.iterdir()}


def read_numbers(path: Any) -> List[Any]:
    with closing(open_without_locks(path)) as database:
        return [value for (value,) in database.execute("SELECT value FROM numbers ORDER BY value")]


def test_log_is_read_without_writing(database_with_log: Path) -> None:
    before = contents(database_with_log.parent)
    assert sorted(before) == ["numbers.db", "numbers.db-wal"]
    assert read_numbers(database_with_log) == [1, 2]
    assert contents(database_with_log.parent) == before


def test_log_beside_target_of_link_is_read(database_with_log: Path, tmp_path: Path) -> None:
    link = tmp_path / "link.db"
    link.symlink_to(database_with_log)
    assert read_numbers(link) == [1, 2]


def test_database_cannot_be_changed(database_with_log: Path) -> None:
    with closing(open_without_locks(database_with_log)) as database, pytest.raises(
        sqlite3.OperationalError, match="readonly"
    ):
        database.execute("INSERT INTO numbers VALUES(3)")


def test_empty_database_is_refused_and_keeps_its_log(database_with_log: Path) -> None:
    database_with_log.write_bytes(b"")
    before = contents(database_with_log.parent)
    with pytest.raises(sqlite3.DatabaseError, match="it is empty: expected a database"):
        open_without_locks(database_with_log)
    assert contents(database_with_log.parent) == before


def test_missing_database_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(sqlite3.OperationalError, match="unable to open database file"):
        open_without_locks(tmp_path / "missing.db")
