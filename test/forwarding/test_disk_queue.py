"""The queue of events in a file: order, ids, limits, restarts, damage."""

import resource
import sqlite3
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Iterator, List

import pytest

from retalis import UsageError
from retalis.forwarding import disk_queue
from retalis.forwarding.disk_queue import DiskQueue, ForwardedEvent, QueueFailed

MEGABYTE = 1_000_000


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "queue.db"


def events(*texts: str) -> List[ForwardedEvent]:
    return [ForwardedEvent(4, 5, text) for text in texts]


def take_all(queue: DiskQueue) -> List[Any]:
    """Take the events that are not in flight; return their ids and texts."""
    return [(queued.id, queued.event.text) for queued in queue.take(10_000, 100 * MEGABYTE)]


@contextmanager
def limited_file_size(max_bytes: int) -> Iterator[None]:
    """Let this process write no file beyond a size: SQLite reports an input or output error."""
    soft_limit, hard_limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (max_bytes, hard_limit))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft_limit, hard_limit))


def test_events_have_increasing_ids(path: Path) -> None:
    queue = DiskQueue(path, MEGABYTE)
    queue.append(events("a", "b"))
    queue.append(events("c"))
    (first, *_), session = queue.take(1, 100), queue.take(1, 100)[0].session
    assert first == (session, 1, ForwardedEvent(4, 5, "a"))
    assert take_all(queue) == [(3, "c")]
    queue.close()


def test_time_of_event_may_be_wrong(path: Path) -> None:
    queue = DiskQueue(path, MEGABYTE)
    # The last second of the year 9999, which has no 64-bit number of nanoseconds.
    event = ForwardedEvent(-1.5, 253402300799.0, "a")
    queue.append([event])
    assert queue.take(1, 100)[0].event == event
    queue.close()


def test_events_in_flight_return_to_queue(path: Path) -> None:
    queue = DiskQueue(path, MEGABYTE)
    queue.append(events("a", "b", "c"))
    session = queue.take(2, 100)[0].session
    queue.confirm(session, 1, 1)
    queue.rewind()
    assert take_all(queue) == [(2, "b"), (3, "c")]
    assert queue.count == 2
    queue.close()


def test_events_stay_in_flight_after_write_error(path: Path) -> None:
    queue = DiskQueue(path, MEGABYTE)
    queue.append(events("a", "b"))
    session = queue.take(2, 100)[0].session
    with limited_file_size(60_000), pytest.raises(QueueFailed, match="disk I/O error"):
        queue.append(events("c" * 100_000))
    queue.append(events("d"))
    assert take_all(queue) == [(4, "d")]
    queue.confirm(session, 2, 2)
    assert queue.count == 1
    queue.close()


def test_text_that_cannot_be_encoded_affects_no_later_event(path: Path) -> None:
    queue = DiskQueue(path, MEGABYTE)
    with pytest.raises(UnicodeEncodeError):
        queue.append(events("a", "\ud800"))
    queue.append(events("b"))
    assert take_all(queue) == [(3, "b")]
    queue.close()


def test_size_is_that_of_encoded_texts(path: Path) -> None:
    queue = DiskQueue(path, MEGABYTE)
    for _ in range(2):
        queue.append(events("\U0001f600" * 150_000))
    assert queue.used_bytes <= MEGABYTE
    queue.close()


def test_length_of_taken_events_is_limited(path: Path) -> None:
    queue = DiskQueue(path, MEGABYTE)
    queue.append(events("a" * 90, "b" * 90, "c"))
    assert [queued.id for queued in queue.take(10, 100)] == [1]
    # A single event is returned in any case.
    assert [queued.id for queued in queue.take(10, 1)] == [2]
    queue.close()


def test_restart_keeps_unconfirmed_events(path: Path) -> None:
    queue = DiskQueue(path, MEGABYTE)
    queue.append(events("a", "b", "c"))
    session = queue.take(3, 100)[0].session
    queue.confirm(session, 2, 2)
    queue.close()
    queue = DiskQueue(path, MEGABYTE)
    assert queue.count == 1
    (queued,) = queue.take(3, 100)
    assert (queued.session, queued.id, queued.event.text) == (session, 3, "c")
    queue.close()


def test_ids_of_deleted_events_are_not_used_again(path: Path) -> None:
    queue = DiskQueue(path, MEGABYTE)
    queue.append(events("a", "b"))
    queue.confirm(queue.take(2, 100)[0].session, 2, 2)
    queue.close()
    queue = DiskQueue(path, MEGABYTE)
    queue.append(events("c"))
    assert take_all(queue) == [(3, "c")]
    queue.close()


def test_ids_of_lost_events_are_left_out(path: Path) -> None:
    queue = DiskQueue(path, MEGABYTE)
    queue.append(events("a"))
    queue.skip_ids(2)
    queue.append(events("b"))
    assert take_all(queue) == [(1, "a"), (4, "b")]
    queue.close()


def test_full_queue_drops_oldest_events(path: Path) -> None:
    queue = DiskQueue(path, MEGABYTE)
    dropped_count = sum(queue.append(events(*[f"{batch} {'x' * 1000}"] * 100)) for batch in range(20))
    assert path.stat().st_size <= MEGABYTE
    queued = take_all(queue)
    assert dropped_count == 2000 - len(queued) == 2000 - queue.count
    assert [id for id, _ in queued] == list(range(dropped_count + 1, 2001))
    # Whole groups are dropped, so that the queue stays nearly full.
    assert queue.count > 700
    queue.close()


def test_number_of_events_is_limited(path: Path) -> None:
    queue = DiskQueue(path, MEGABYTE, max_events=250)
    dropped_count = sum(queue.append(events(*"x" * 100)) for _ in range(4))
    assert (dropped_count, queue.count) == (200, 200)
    queue.close()


def test_events_in_flight_are_not_dropped(path: Path) -> None:
    queue = DiskQueue(path, MEGABYTE, max_events=250)
    queue.append(events(*"x" * 100))
    session = queue.take(50, 1000)[0].session
    assert queue.append(events(*"y" * 200)) == 50
    queue.confirm(session, 50, 50)
    assert queue.count == 200
    assert take_all(queue)[0] == (101, "y")
    queue.close()


def test_file_does_not_grow_with_time(path: Path) -> None:
    queue = DiskQueue(path, 10 * MEGABYTE)
    for _ in range(60):
        queue.append(events(*["x" * 1000] * 100))
        queued = queue.take(100, MEGABYTE)
        queue.confirm(queued[-1].session, queued[-1].id, len(queued))
    assert queue.used_bytes < MEGABYTE / 5
    wal_size = Path(f"{path}-wal").stat().st_size
    assert wal_size < MEGABYTE
    queue.close()
    assert path.stat().st_size < MEGABYTE / 5


def test_empty_queue_releases_space(path: Path) -> None:
    queue = DiskQueue(path, 10 * MEGABYTE)
    for _ in range(5):
        queue.append(events(*["x" * 1000] * 1000))
    used_bytes = queue.used_bytes
    queued = queue.take(5000, 10 * MEGABYTE)
    queue.confirm(queued[-1].session, queued[-1].id, len(queued))
    for _ in range(2):
        queue.release()
    assert used_bytes > 5 * MEGABYTE > 100 * queue.used_bytes
    queue.append(events("a"))
    assert take_all(queue) == [(5001, "a")]
    queue.close()
    assert path.stat().st_size < MEGABYTE / 10
    assert not Path(f"{path}-wal").exists()


def test_file_is_private(path: Path) -> None:
    DiskQueue(path, MEGABYTE).close()
    assert path.stat().st_mode & 0o777 == 0o600


def test_queue_of_other_process_is_refused(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(disk_queue, "LOCK_TIMEOUT_SECONDS", 0.0)
    queue = DiskQueue(path, MEGABYTE)
    with pytest.raises(UsageError, match="another process uses it"):
        DiskQueue(path, MEGABYTE)
    queue.append(events("a"))
    queue.close()


def test_other_database_is_refused(path: Path) -> None:
    database = sqlite3.connect(str(path))
    database.execute("CREATE TABLE topics (name TEXT)")
    database.close()
    content = path.read_bytes()
    with pytest.raises(UsageError, match="it is the database of another program"):
        DiskQueue(path, MEGABYTE)
    assert path.read_bytes() == content


def test_newer_format_is_refused(path: Path) -> None:
    DiskQueue(path, MEGABYTE).close()
    database = sqlite3.connect(str(path))
    database.execute("PRAGMA user_version = 2")
    database.close()
    with pytest.raises(
        UsageError, match="it is a queue of format 2: expected a queue of format 1, or no file"
    ):
        DiskQueue(path, MEGABYTE)


@pytest.mark.parametrize("name", ["missing/queue.db", ""])
def test_impossible_path_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(UsageError, match="cannot be created|expected a file"):
        DiskQueue(tmp_path / name, MEGABYTE)


@pytest.mark.parametrize("content", [b"notes\n", b"notes\n" * 1000, b"\xff\xd8\xff\xe0" * 1000])
def test_other_file_is_refused(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    with pytest.raises(UsageError) as error:
        DiskQueue(path, MEGABYTE)
    assert str(error.value) == (
        f"parameter ~forward_queue: {path}: it is not a queue (file is not a database): "
        "expected a queue of format 1, or no file"
    )
    assert path.read_bytes() == content
    assert [file.name for file in path.parent.iterdir()] == ["queue.db"]


def test_other_damaged_database_is_refused(path: Path) -> None:
    database = sqlite3.connect(str(path))
    database.execute("CREATE TABLE topics (name TEXT)")
    database.close()
    content = bytearray(path.read_bytes())
    content[100:108] = b"\xff" * 8
    path.write_bytes(content)
    with pytest.raises(UsageError, match="it is not a queue"):
        DiskQueue(path, MEGABYTE)
    assert path.read_bytes() == content


def damage(path: Path, start: int, stop: int, value: bytes = b"\xff") -> None:
    """Overwrite bytes of the file of a queue."""
    content = bytearray(path.read_bytes())
    content[start:stop] = value * (stop - start)
    path.write_bytes(content)


# The first bytes, the whole header, and the pages after it.
@pytest.mark.parametrize(
    ("start", "stop", "value"), [(0, 16, b"\xff"), (0, 4096, b"\0"), (100, 4096, b"\xff")]
)
def test_damaged_file_is_set_aside(path: Path, start: int, stop: int, value: bytes) -> None:
    DiskQueue(path, MEGABYTE).close()
    damage(path, start, stop, value)
    content = path.read_bytes()
    errors: List[Any] = []
    queue = DiskQueue(path, MEGABYTE, on_damage=errors.append)
    (error,) = errors
    assert str(error).startswith(f"parameter ~forward_queue: {path}: it is damaged (")
    assert str(error).endswith(f"its events are lost; it is kept as {path}.aside, and a new queue begins")
    assert Path(f"{path}.aside").read_bytes() == content
    queue.append(events("a"))
    assert take_all(queue) == [(1, "a")]
    assert queue.set_aside_count == 1
    queue.close()


def test_file_damaged_in_the_middle_is_set_aside(path: Path) -> None:
    queue = DiskQueue(path, MEGABYTE)
    queue.append(events(*["x" * 1000] * 200))
    session = queue.take(1, 1)[0].session
    queue.close()
    damage(path, 20_000, 120_000)
    queue = DiskQueue(path, MEGABYTE)
    assert (queue.set_aside_count, queue.count) == (1, 0)
    queue.append(events("a"))
    (queued,) = queue.take(10, 1000)
    assert queued.session != session
    # Confirmations of the lost events do not affect the new ones.
    queue.confirm(session, 100, 100)
    assert queue.count == 1
    queue.close()


def test_damaged_text_does_not_block_later_events(path: Path) -> None:
    queue = DiskQueue(path, MEGABYTE)
    queue.append(events("door(open)", "b"))
    queue.close()
    path.write_bytes(path.read_bytes().replace(b"open", b"op\xffn"))
    queue = DiskQueue(path, MEGABYTE)
    assert take_all(queue) == [(1, "door(op\ufffdn)"), (2, "b")]
    queue.close()


def test_damaged_file_that_cannot_be_renamed_is_reported(path: Path) -> None:
    queue = DiskQueue(path, 10 * MEGABYTE)
    for _ in range(4):
        queue.append(events(*["x" * 1000] * 1000))
    queue.close()
    queue = DiskQueue(path, 10 * MEGABYTE)
    with path.open("r+b") as file:
        # Pages that SQLite does not have in its cache.
        file.seek(20_000)
        file.write(b"\xff" * MEGABYTE)
    for suffix in (".aside", ".aside2", ".aside3"):
        Path(f"{path}{suffix}").mkdir()
    with pytest.raises(QueueFailed, match="it is damaged .* and cannot be renamed"):
        take_all(queue)
    queue.close()


def test_number_of_damaged_files_is_limited(path: Path) -> None:
    for number in range(6):
        DiskQueue(path, MEGABYTE).close()
        damage(path, 0, 16, str(number).encode())
    DiskQueue(path, MEGABYTE).close()
    names = sorted(file.name for file in path.parent.iterdir())
    assert names == ["queue.db", "queue.db.aside", "queue.db.aside2", "queue.db.aside3"]
    assert Path(f"{path}.aside3").read_bytes().startswith(b"5555")
