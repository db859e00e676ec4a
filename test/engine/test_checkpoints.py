"""Checkpoints: the state of a running engine in a file."""

import os
import random
import sqlite3
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Dict, List, Tuple
from zlib import crc32

import pytest
from asserting_accessors import required
from nightly_round_numbers import round_numbers
from serialization.field_dictionaries import fields_of, to_fields
from subprocess_python_path import python_path

from retalis import Engine, Reports, Settings, StreamClock, UsageError, explain
from retalis.engine.checkpoints import (
    MAX_EXPLAINED_EVENTS,
    MIN_INTERVAL_SECONDS,
    MIN_PAUSE_FACTOR,
    Checkpointer,
    CheckpointStorage,
    read_checkpoint,
    rename_refused_file,
    resume,
)
from retalis.engine.engine_snapshot import EngineSnapshot
from retalis.serialization.codec import from_bytes, to_bytes

from .killed_checkpoint_process import GOALS, RULES

VICTIM = Path(__file__).with_name("killed_checkpoint_process.py")
KILLS = 6


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "goalPredicates.txt").write_text(GOALS)
    (tmp_path / "r.txt").write_text(RULES)
    return tmp_path


def start_engine(folder: Any) -> Engine:
    engine = Engine(StreamClock())
    engine.load_program(folder)
    engine.event("begin", 0.5)
    return engine


def create_checkpointer(engine: Any, folder: Any, name: str = "state.db") -> Checkpointer:
    return Checkpointer(engine, CheckpointStorage(folder / name), folder, Reports())


def record_events(engine: Engine) -> Any:
    events: List[Any] = []
    engine.on_event(lambda term, start, end: events.append(engine.show(term)))
    return events


def resume_engine(folder: Any, name: str = "state.db") -> Any:
    result = resume(folder / name, folder, StreamClock(), Settings(), Reports())
    return None if result is None else result[0]


def remembered_count(engine: Engine) -> int:
    """Return the number of events that an engine remembers for retractions and explanations."""
    return len(engine.rules.network.tracker.remembered_events())


def records(engine: Engine) -> List[Any]:
    return [
        engine.show(solution["R"]) + engine.show(solution["I"])
        for solution in engine.query("access_mem(m, R, I)")
    ]


def test_resumed_engine_continues_from_last_checkpoint(folder: Path) -> None:
    engine = start_engine(folder)
    checkpointer = create_checkpointer(engine, folder)
    for number in range(1, 1200):
        engine.event(f"in({number})", number)
        if number % 130 == 0:
            checkpointer.write()
            other = resume_engine(folder)
            assert records(other) == records(engine)
            assert other.query("counter(c, X), memory_counter(m, Y)") == engine.query(
                "counter(c, X), memory_counter(m, Y)"
            )
    other = resume_engine(folder)
    events = record_events(other)
    other.event("in(x)", 5000)
    assert "pair(1170,x)" in events
    assert "n(1171)" in events


def test_checkpoint_writes_only_changes(folder: Path) -> None:
    engine = start_engine(folder)
    checkpointer = create_checkpointer(engine, folder)
    checkpointer.write()
    base = sqlite3.connect(str(folder / "state.db"))
    program = base.execute("SELECT rowid, data FROM sections WHERE name = 'program'").fetchone()
    clauses = base.execute("SELECT data FROM sections WHERE name = 'clauses'").fetchone()
    for number in range(1, 400):
        engine.event(f"in({number})", number)
        if number % 20 == 0:
            checkpointer.write()
    assert base.execute("SELECT rowid, data FROM sections WHERE name = 'program'").fetchone() == program
    rows = base.execute("SELECT first, number FROM records ORDER BY first").fetchall()
    assert rows[:3] == [(0, 20), (20, 20), (40, 20)]
    engine.call("assertz(new(1))")
    checkpointer.write()
    assert base.execute("SELECT data FROM sections WHERE name = 'clauses'").fetchone() != clauses
    for number in range(400, 3000):
        engine.event(f"in({number})", number)
        if number % 200 == 0:
            checkpointer.write()
    assert base.execute("SELECT count(*) FROM records").fetchone()[0] <= 12


@pytest.mark.slow
@pytest.mark.parametrize("seed", round_numbers(2, 6))
def test_random_changes_are_restored(folder: Path, seed: int) -> None:
    generator = random.Random(seed)
    engine = start_engine(folder)
    checkpointer = create_checkpointer(engine, folder)
    extra = record_count = 0
    for number in range(1, 300):
        engine.event(f"in({number})", max(0.6, number - generator.choice((0, 0, 0, 1, 5, 40))))
        choice = generator.randrange(40)
        if choice == 0:
            extra += 1
            engine.call(f"memorize(in(_), [], _, e{extra}, {generator.randrange(30)})")
        elif choice == 1 and extra:
            engine.call(f"delete_memory(e{extra})")
            extra -= 1
        elif choice == 2:
            engine.knowledge.clear()
        elif choice < 10:
            checkpointer.write()
            restored = resume_engine(folder)
            for name in ("m", *(f"e{number}" for number in range(1, extra + 1))):
                query = f"access_mem({name}, R, I)"
                expected = [engine.show(solution["R"]) for solution in engine.query(query)]
                record_count += len(expected)
                assert [restored.show(solution["R"]) for solution in restored.query(query)] == expected
    assert record_count > 100


def test_checkpoints_are_written_until_stop(folder: Path) -> None:
    engine = start_engine(folder)
    checkpointer = Checkpointer(engine, CheckpointStorage(folder / "state.db"), folder, Reports(), 0.001)
    checkpointer.start()
    for number in range(1, 2000):
        engine.event(f"in({number})", number)
    checkpointer.stop()
    assert checkpointer.checkpoint_count > 1
    assert len(records(engine)) > 100
    assert records(resume_engine(folder)) == records(engine)


def test_file_stays_valid_until_next_checkpoint(folder: Path) -> None:
    engine = start_engine(folder)
    engine.event("in(1)", 2)
    create_checkpointer(engine, folder).write()
    other = resume_engine(folder)
    checkpointer = create_checkpointer(other, folder)
    assert records(resume_engine(folder)) == records(engine)
    other.event("in(2)", 3)
    checkpointer.write()
    assert len(records(resume_engine(folder))) == 2


def test_missing_or_empty_file_has_no_checkpoint(folder: Path) -> None:
    assert resume_engine(folder) is None
    (folder / "state.db").touch()
    assert resume_engine(folder) is None
    CheckpointStorage(folder / "state.db")
    assert resume_engine(folder) is None


@pytest.mark.parametrize("name", ["r.txt", "goalPredicates.txt", "pub_sub.xml"])
def test_changed_program_is_refused(folder: Path, name: str) -> None:
    engine = start_engine(folder)
    create_checkpointer(engine, folder).write()
    (folder / name).write_text("% changed")
    with pytest.raises(UsageError, match=f"{name} has changed since"):
        resume_engine(folder)


def test_program_in_other_folder_is_refused(folder: Path) -> None:
    create_checkpointer(start_engine(folder), folder).write()
    (folder / "other").mkdir()
    with pytest.raises(UsageError, match="it is of another program"):
        resume(folder / "state.db", folder / "other", StreamClock(), Settings(), Reports())


def test_other_byte_order_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    create_checkpointer(start_engine(folder), folder).write()
    monkeypatch.setattr("sys.byteorder", "other")
    with pytest.raises(UsageError, match="another byte order: little"):
        resume_engine(folder)


def test_unfinished_file_has_no_checkpoint(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = folder / "state.db"
    results: List[Any] = []
    connect = sqlite3.connect

    def read_during_statement(statement: Any) -> None:
        try:
            results.append((statement, read_checkpoint(path)))
        except UsageError as error:
            results.append((statement, error))

    def connect_with_trace(name: Any, **options: Any) -> Any:
        base = connect(name, **options)
        if name == str(path):
            base.set_trace_callback(read_during_statement)
        return base

    monkeypatch.setattr(sqlite3, "connect", connect_with_trace)
    CheckpointStorage(path).close()
    statements = [statement for statement, _ in results]
    assert any("application_id" in statement for statement in statements)
    assert any("CREATE TABLE" in statement for statement in statements)
    assert [result for _, result in results] == [None] * len(results)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("statements", "message"),
    [
        ("CREATE TABLE more (x)", "its tables are not those of a checkpoint"),
        ("CREATE INDEX more ON records (number)", "its tables are not those of a checkpoint"),
        (
            "CREATE TRIGGER t AFTER INSERT ON sections "
            "BEGIN INSERT INTO records VALUES (1, 1, 1, zeroblob(9), 1); END",
            "its tables are not those of a checkpoint",
        ),
        (
            "DROP TABLE records; CREATE VIEW records AS WITH RECURSIVE x(memory, first, number, data, checked) AS "
            "(SELECT 1, 1, 1, x'00', 1 UNION ALL SELECT memory, first + 1, 1, data, 1 FROM x) SELECT * FROM x",
            "its tables are not those of a checkpoint",
        ),
        ("PRAGMA application_id = 5", "another database"),
        ("UPDATE sections SET data = 'text'", "data of another type"),
        ("DELETE FROM sections WHERE name = 'program'", "no section program"),
        ("UPDATE sections SET data = x'800495' WHERE name = 'about'", "a checksum is wrong"),
    ],
)
def test_other_database_is_refused(folder: Path, statements: str, message: str) -> None:
    checkpointer = create_checkpointer(start_engine(folder), folder)
    checkpointer.stop()
    base = sqlite3.connect(str(folder / "state.db"), isolation_level=None)
    base.executescript(statements)
    base.close()
    with pytest.raises(UsageError, match=message):
        resume_engine(folder)


@pytest.mark.parametrize(
    ("about", "message"),
    [
        (lambda old: b"\x80\x04}\x94.", "format 5 or older, a pickle, which is never read"),
        (
            lambda old: to_bytes(to_fields({**old, "written_at": "abc"})),
            "written_at: 'abc': expected a number of seconds",
        ),
        (lambda old: to_bytes(to_fields({**old, "files": [["x"]]})), "files: .*expected 2 items"),
        (
            lambda old: to_bytes(to_fields({**old, "format": 99})),
            "format 99: this version reads formats 11 to 14",
        ),
        (lambda old: to_bytes(to_fields({**old, "memories": old["memories"] * 2})), "two memories"),
    ],
)
def test_invalid_description_is_refused(folder: Path, about: Any, message: str) -> None:
    checkpointer = create_checkpointer(start_engine(folder), folder)
    checkpointer.stop()
    base = sqlite3.connect(str(folder / "state.db"), isolation_level=None)
    ((old,),) = base.execute("SELECT data FROM sections WHERE name = 'about'").fetchall()
    data = about(fields_of(from_bytes(old)))
    base.execute("UPDATE sections SET data = ?, checked = ? WHERE name = 'about'", (data, crc32(data)))
    base.close()
    with pytest.raises(UsageError, match=message):
        resume_engine(folder)


def test_other_file_is_refused(folder: Path) -> None:
    (folder / "state.db").write_bytes(b"no database at all" * 100)
    with pytest.raises(UsageError, match="not a checkpoint, or is damaged"):
        resume_engine(folder)
    (folder / "state.db").unlink()
    other = sqlite3.connect(str(folder / "state.db"))
    other.execute("CREATE TABLE x (y)")
    other.commit()
    other.close()
    with pytest.raises(UsageError, match="another database"):
        resume_engine(folder)


def test_schema_with_invalid_name_is_refused(folder: Path) -> None:
    checkpointer = create_checkpointer(start_engine(folder), folder)
    checkpointer.stop()
    data = (folder / "state.db").read_bytes()
    # The name of a table, followed by the table's name and a statement that cannot be parsed.
    damaged = data.replace(b"tablerecordsrecords", b"table\xff\xfecordsrecords")
    damaged = damaged.replace(b"CREATE TABLE records", b"CREATX TABLE records")
    (folder / "state.db").write_bytes(damaged)
    with pytest.raises(UsageError, match="not a checkpoint, or is damaged"):
        resume_engine(folder)
    with pytest.raises(UsageError, match="cannot write a checkpoint"):
        CheckpointStorage(folder / "state.db")


@pytest.mark.parametrize("times", [15, pytest.param(100, marks=pytest.mark.slow)])
def test_damaged_file_is_refused(folder: Path, times: int) -> None:
    engine = start_engine(folder)
    for number in range(1, 300):
        engine.event(f"in({number})", number)
    checkpointer = create_checkpointer(engine, folder)
    checkpointer.stop()
    data = (folder / "state.db").read_bytes()
    generator = random.Random(1)
    refused = 0
    for _ in range(times):
        broken = bytearray(data)
        position = generator.randrange(len(data))
        broken[position : position + 40] = bytes(
            generator.randrange(256) for _ in range(len(broken[position : position + 40]))
        )
        (folder / "broken.db").write_bytes(bytes(broken))
        try:
            restored = resume_engine(folder, "broken.db")
        except UsageError:
            refused += 1
        else:
            assert records(restored) == records(engine)  # the damage is in an unused page
    assert refused > times // 6


def test_refused_file_is_renamed_with_its_log(folder: Path) -> None:
    checkpointer = create_checkpointer(start_engine(folder), folder)
    checkpointer.write()
    (folder / "state.db.aside").write_text("older")
    aside = rename_refused_file(folder / "state.db")
    assert aside.name == "state.db.aside2"
    assert not any(name.startswith("state.db") and "aside" not in name for name in os.listdir(folder))
    assert len(records(resume_engine(folder, "state.db.aside2"))) == 0
    with pytest.raises(UsageError, match="is not a file"):
        rename_refused_file(folder)


def test_empty_refused_file_is_renamed_with_its_log(folder: Path) -> None:
    storage = CheckpointStorage(folder / "state.db")
    log = (folder / "state.db-wal").read_bytes()
    storage.close()
    path = folder / "emptied.db"
    path.touch()
    (folder / "emptied.db-wal").write_bytes(log)
    renamed = rename_refused_file(path)
    assert renamed.read_bytes() == b""
    assert log
    assert (folder / f"{renamed.name}-wal").read_bytes() == log


def test_missing_folder_is_an_error(folder: Path) -> None:
    with pytest.raises(UsageError, match="cannot write a checkpoint to"):
        CheckpointStorage(folder / "not_there" / "state.db")


@pytest.mark.slow
def test_file_is_consistent_after_random_kills(folder: Path) -> None:
    """After each kill the file has one recent state, with all parts of the same time."""
    generator = random.Random(3)
    newest = previous = 0
    for number in range(KILLS + 1):
        process = subprocess.Popen(
            [sys.executable, str(VICTIM), str(folder)],
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": python_path()},
        )
        output = required(process.stdout)
        try:
            if number:
                counter, record_count, added, last = map(int, output.readline().split())
                assert counter == added == last
                assert record_count == min(500, last)
                assert previous <= last <= newest + 5000
                previous = last
                assert output.readline() == "True True\n"
            assert output.readline() == "ready\n"
            first = int(output.readline().split()[0])
            target = first + generator.randrange(200, 3000)
            for line in output:
                newest = int(line.split()[0])
                if newest >= target and (number or read_checkpoint(folder / "state.db") is not None):
                    break
        finally:
            process.kill()
            process.wait()
            output.close()


def test_second_writer_stops_first_one(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    first_engine, second_engine = start_engine(folder), start_engine(folder)
    first = create_checkpointer(first_engine, folder)
    first.write()
    second = create_checkpointer(second_engine, folder)
    second_engine.event("in(2)", 2)
    second.write()
    first_engine.event("in(1)", 1)
    with pytest.raises(UsageError, match="another process writes to this file"):
        first.write()
    first.stop()
    assert "this one writes no more" in caplog.text
    assert records(resume_engine(folder)) == records(second_engine)


def test_missing_records_are_an_error(folder: Path) -> None:
    engine = start_engine(folder)
    checkpointer = create_checkpointer(engine, folder)
    for number in range(1, 4):
        engine.event(f"in({number})", number)
        checkpointer.write()
    base = sqlite3.connect(str(folder / "state.db"))
    base.execute("DELETE FROM records WHERE first = 0")
    base.commit()
    with pytest.raises(UsageError, match="records of a memory are missing"):
        resume_engine(folder)


def test_program_edited_after_loading_is_refused(folder: Path) -> None:
    engine = start_engine(folder)
    checkpointer = create_checkpointer(engine, folder)
    (folder / "r.txt").write_text(RULES + "% more\n")
    engine.call("assertz(new(1))")
    checkpointer.write()
    with pytest.raises(UsageError, match=r"r\.txt has changed since it was read"):
        resume_engine(folder)
    engine.reload(folder)
    checkpointer.write()
    assert resume_engine(folder).query("new(X)") == [{"X": 1}]


def test_unexpected_error_of_writing_is_logged(
    folder: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    engine = start_engine(folder)
    checkpointer = create_checkpointer(engine, folder)
    with monkeypatch.context() as patched:
        patched.setattr(checkpointer, "write", lambda: 1 // 0)
        checkpointer.stop()
    assert "division" in caplog.text


def test_stop_does_not_wait_for_blocked_engine(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("retalis.engine.checkpoints.FINAL_WRITE_SECONDS", 0.1)
    engine = start_engine(folder)
    checkpointer = create_checkpointer(engine, folder)
    going, stopped = threading.Event(), threading.Event()

    def hold(term: Any, start: Any, end: Any) -> None:
        going.set()
        stopped.wait(60)

    engine.on_event(hold)
    thread = threading.Thread(target=engine.event, args=("x", 9))
    thread.start()
    going.wait(60)
    checkpointer.start()
    checkpointer.stop()
    stopped.set()
    thread.join()


def test_query_during_checkpoint_binds_no_records(folder: Path) -> None:
    """A query for a justification temporarily unifies terms of rules."""
    engine = start_engine(folder)
    engine.call("set_etalis_flag(etalis_justification, on)")
    checkpointer = create_checkpointer(engine, folder)
    answered = threading.Event()

    def ask() -> None:
        for number in range(60):
            engine.query(f"justify_event(out(x{number}), _, _)")
        answered.set()

    thread = threading.Thread(target=ask)
    thread.start()
    while True:
        engine.call("assertz(new(1))")
        checkpointer.write()
        if answered.is_set():
            break
    thread.join()
    restored = resume_engine(folder)
    events = record_events(restored)
    restored.event("in(7)", 50)
    assert "out(7)" in events


def test_pause_is_proportional_to_work(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    engine = start_engine(folder)
    times = SimpleNamespace(now=0.0, cpu=0.0)
    monkeypatch.setattr(
        "retalis.engine.checkpoints.time",
        SimpleNamespace(
            monotonic=lambda: times.now,
            thread_time=lambda: times.cpu,
            time=lambda: times.now,
            sleep=lambda seconds: None,
        ),
    )
    checkpointer = create_checkpointer(engine, folder)
    call, capture_state = engine.executor.call, EngineSnapshot.capture

    def call_after_wait(work: Any, entry: Any) -> Any:
        times.now += 7.0  # the engine is busy
        result = call(work, entry)
        times.cpu += 100.0  # of another thread that has captured the state meanwhile
        return result

    def capture(snapshot: Any, **options: Any) -> Dict[str, Any]:
        times.now += 0.2
        times.cpu += durations.pop(0)
        return capture_state(snapshot, **options)

    durations = [0.01, 0.05]
    monkeypatch.setattr(engine.executor, "call", call_after_wait)
    monkeypatch.setattr(EngineSnapshot, "capture", capture)
    checkpointer.write()
    assert checkpointer.pause_seconds == MIN_INTERVAL_SECONDS
    checkpointer.write()
    assert checkpointer.pause_seconds == pytest.approx(MIN_PAUSE_FACTOR * 0.05)


def test_database_of_another_program_is_left_untouched(tmp_path: Path) -> None:
    path = tmp_path / "music.db"
    database = sqlite3.connect(str(path))
    database.executescript(
        "PRAGMA journal_mode = WAL; CREATE TABLE songs (title); INSERT INTO songs VALUES ('x');"
    )
    files = [path, tmp_path / "music.db-wal"]
    before = [file.read_bytes() for file in files]
    with pytest.raises(UsageError, match="music.db: it is the database of another program"):
        CheckpointStorage(path)
    assert [file.read_bytes() for file in files] == before
    database.close()
    content = path.read_bytes()
    with pytest.raises(UsageError, match="music.db: it is the database of another program"):
        CheckpointStorage(path)
    with pytest.raises(UsageError, match="music.db is the database of another program"):
        rename_refused_file(path)
    assert path.read_bytes() == content
    assert [file.name for file in tmp_path.iterdir()] == ["music.db"]


def test_other_file_is_left_untouched(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("not a database " * 100)
    with pytest.raises(UsageError, match="cannot write a checkpoint to .*notes.txt: file is not a database"):
        CheckpointStorage(path)
    assert path.read_text() == "not a database " * 100


READ_IN_READ_ONLY_FOLDER = """
import os, sys
from pathlib import Path
from retalis.engine.checkpoints import read_checkpoint
path = Path(sys.argv[1])
assert not os.access(path.parent, os.W_OK)
run = read_checkpoint(path).sections["run"]
event_input = run[run.index("event_input") + 1]
print(event_input[event_input.index("event_count") + 1], sorted(os.listdir(path.parent)))
"""


@pytest.mark.parametrize("is_killed", [False, True], ids=["closed", "with log"])
def test_checkpoint_in_read_only_folder_is_read(folder: Path, is_killed: bool) -> None:
    engine = start_engine(folder)
    checkpointer = create_checkpointer(engine, folder)
    checkpointer.write()
    target = folder / "medium"
    target.mkdir()
    if not is_killed:
        checkpointer.stop()
    expected = [file.name for file in sorted(folder.glob("state.db*")) if not file.name.endswith("-shm")]
    assert expected == (["state.db", "state.db-wal"] if is_killed else ["state.db"])
    for name in expected:
        (target / name).write_bytes((folder / name).read_bytes())
        (target / name).chmod(0o444)
    target.chmod(0o555)
    # The superuser may write to a read-only folder, unless this capability is missing.
    prefix = ["setpriv", "--bounding-set=-dac_override"] if os.geteuid() == 0 else []
    try:
        process = subprocess.run(
            [*prefix, sys.executable, "-c", READ_IN_READ_ONLY_FOLDER, str(target / "state.db")],
            capture_output=True,
            text=True,
            env={**os.environ, "PYTHONPATH": python_path()},
        )
    finally:
        target.chmod(0o755)
    assert (process.stdout, process.stderr) == (f"{engine.event_input.event_count} {expected}\n", "")


def explained(folder: Path, number_of_events: int) -> Tuple[Any, ...]:
    """Return a checkpointer of an engine that has recorded events for explanations."""
    (folder / "r.txt").write_text(
        "pair(X) <- first(X) seq second(X).\nnext(X) <- (pair(X) where X < 9) seq third(X).\n"
    )
    (folder / "goalPredicates.txt").write_text(
        "compile_event_file('r.txt').\nset_etalis_flag(etalis_justification, on).\n"
    )
    engine = start_engine(folder)
    for number in range(number_of_events):
        engine.event(f"first({number})", number + 1)
        engine.event(f"second({number})", number + 1.5)
    return engine, create_checkpointer(engine, folder)


def size_of_matches(folder: Path) -> Any:
    """Return the size of the section with partial matches and recorded events."""
    database = sqlite3.connect(str(folder / "state.db"))
    try:
        return database.execute("SELECT length(data) FROM sections WHERE name = 'matches'").fetchone()[0]
    finally:
        database.close()


def explanation_of(engine: Any, event: str) -> List[Any]:
    return [line for tree in explain(engine, event).lines for line in tree.indented()]


def test_size_of_recorded_events_is_bounded(folder: Path) -> None:
    sizes: List[Any] = []
    for number_of_events in (400, 1200):
        _, checkpointer = explained(folder, number_of_events)
        checkpointer.write()
        checkpointer.stop()
        sizes.append(size_of_matches(folder))
    assert sizes[1] < 1.1 * sizes[0]


def test_newest_events_are_explained_after_restart(folder: Path) -> None:
    engine, checkpointer = explained(folder, 400)
    checkpointer.write()
    other = resume_engine(folder)
    assert remembered_count(other) == MAX_EXPLAINED_EVENTS
    assert len(explanation_of(engine, "pair(399)")) == 3
    assert explanation_of(other, "pair(399)") == explanation_of(engine, "pair(399)")


def test_older_partial_match_continues_after_restart(folder: Path) -> None:
    engine, checkpointer = explained(folder, 400)
    checkpointer.write()
    other = resume_engine(folder)
    for either in (engine, other):
        either.event("third(0)", 1000)
    assert len(explanation_of(engine, "next(0)")) == 5
    _, origin, third = explanation_of(other, "next(0)")
    assert origin.endswith("/r.txt:1): what it came from is no longer recorded")
    assert third == explanation_of(engine, "next(0)")[-1]


def test_snapshot_contains_all_recorded_events(folder: Path) -> None:
    engine, _ = explained(folder, 400)
    other = Engine.restore(engine.snapshot())
    assert remembered_count(other) == remembered_count(engine) > 1200


def test_checkpoint_contains_retractable_events(folder: Path) -> None:
    engine, checkpointer = explained(folder, 400)
    engine.call("set_etalis_flag(revision_flag, on)")
    checkpointer.write()
    other = resume_engine(folder)
    assert remembered_count(other) == remembered_count(engine)
