"""Databases of checkpoints: changed bytes, other tables, views, triggers, and sections with changed values."""

import sqlite3
from typing import Any
from zlib import crc32

from retalis import Reports, StreamClock
from retalis.engine.checkpoints import Checkpointer, CheckpointStorage, read_checkpoint, resume
from retalis.serialization.codec import from_bytes, to_bytes

from ..mutate import mutate_bytes
from . import states
from .base import LOGGED, SETTINGS, create_silent_engine

SCHEMAS = (
    "DROP TABLE records; CREATE VIEW records AS WITH RECURSIVE x(memory, first, number, data, checked) AS "
    "(SELECT 1, 1, 1, x'00', 1 UNION ALL SELECT memory, first + 1, 1, data, 1 FROM x) SELECT * FROM x",
    "CREATE TRIGGER t AFTER INSERT ON sections BEGIN INSERT INTO records VALUES (1, 1, 1, zeroblob(1000), 1); END",
    "CREATE INDEX i ON records (number)",
    "CREATE TABLE more (x)",
    "DROP TABLE records",
    "ALTER TABLE sections ADD COLUMN more",
    "ALTER TABLE records RENAME COLUMN number TO x",
    "PRAGMA application_id = 5",
    "DELETE FROM sections WHERE name = 'about'",
    "DELETE FROM sections WHERE name = 'program'",
    "DELETE FROM sections",
    "DELETE FROM records",
    "UPDATE records SET first = first + 1000000",
    "UPDATE records SET memory = memory + 1000",
    "UPDATE sections SET data = 'text'",
    "UPDATE sections SET checked = 'x'",
    "UPDATE sections SET data = zeroblob(100000)",
    "UPDATE records SET data = x'80049500'",
    "INSERT INTO sections VALUES ('more', x'00', 0)",
    "INSERT INTO records SELECT 7, first, number, data, checked FROM records",
)


class Inputs(states.Inputs):
    """Inputs are the bytes of complete databases, without a write-ahead log."""

    def setup(self) -> None:
        super().setup()
        self.folder = self.scratch / "program"
        self.folder.mkdir(exist_ok=True)
        (self.folder / "goalPredicates.txt").write_text("memorize(a(X), [], X, as, 5)\n")
        (self.folder / "pub_sub.xml").write_text("<xml></xml>\n")
        self.path = self.scratch / "state.db"
        engine = create_silent_engine()
        engine.load_program(self.folder)
        engine.load(states.PROGRAMS[0][0])
        checkpointer = Checkpointer(engine, CheckpointStorage(self.path), self.folder, Reports(), 0.5)
        for now, event in enumerate(states.EVENTS, 1):
            engine.event(event, now)
            checkpointer.write()
        checkpointer.stop()
        self.database = self.path.read_bytes()
        LOGGED.logged_error = None

    def generate(self, rng: Any) -> Any:
        draw = rng.random()
        if draw < 0.3:
            return mutate_bytes(rng, self.database, [self.database])
        self.path.write_bytes(self.database)
        base = sqlite3.connect(str(self.path), isolation_level=None)
        base.execute("PRAGMA journal_mode = DELETE")
        if draw < 0.4:
            base.executescript(rng.choice(SCHEMAS))
        else:
            table = rng.choice(("sections", "sections", "records"))
            rows = base.execute(f"SELECT rowid, data FROM {table} ORDER BY rowid").fetchall()
            row_id, data = rng.choice(rows)
            if draw < 0.55:
                data = mutate_bytes(rng, data, [data])
            else:
                value = from_bytes(data)
                data = to_bytes(self.changed(rng, value, self.places(value)))
            base.execute(
                f"UPDATE {table} SET data = ?, checked = ? WHERE rowid = ?", (data, crc32(data), row_id)
            )
        base.close()
        return self.path.read_bytes()

    def prepare(self, data: Any) -> None:
        for ending in ("-wal", "-shm", "-journal"):
            self.path.with_name(f"{self.path.name}{ending}").unlink(missing_ok=True)
        self.path.write_bytes(data)

    def restored(self, data: Any) -> Any:
        if self.attempt(read_checkpoint, self.path) is None:
            return None
        resumed = resume(self.path, self.folder, StreamClock(), SETTINGS, Reports())
        return None if resumed is None else resumed[0]
