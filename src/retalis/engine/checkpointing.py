"""Keeping the state of a running engine in a file, and taking it up from there."""

import threading
import time
from itertools import count
from pathlib import Path
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple

from ..events.knowledge import NEVER, Instance
from ..events.program import GOALS, TOPICS
from ..foundation import UsageError
from ..messages import Definitions
from .checkpoints import (
    Checkpoint,
    CheckpointFile,
    FileTaken,
    ProgramFiles,
    RecordBatch,
    about_state,
    read_checkpoint,
)
from .core import parts_of
from .engine import Engine
from .keeping import NewRecords, keep_records, new_records, to_bytes
from .ownfiles import REQUEST
from .runtime import Clock, Reports
from .settings import Settings
from .standing import Standing
from .states import StateKeeper, checked

EVERY = 0.5
"""Seconds from one checkpoint to the next where they cost little."""

SHARE = 20
"""A checkpoint is followed by that many times the time that it took, at least."""

MOST = 200
"""Records that are made to bytes in one step, while no other thread of Python runs."""

PATIENCE = 5.0
"""Seconds that the end of a node waits for the last time."""


class _InFile(NamedTuple):
    """What the file has of a memory: its number there, and how many records it ever had."""

    number: int
    added: int


class Checkpoints:
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
        file: CheckpointFile,
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
        self._keeper = StateKeeper(engine)
        self._memories: Dict[Instance, _InFile] = {}
        self._numbers = count(file.next_number)
        self._standings: List[Standing] = []
        self._files: Dict[str, str] = {}
        if files is not None:
            self._standings = list(parts_of(engine).programs.values())
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
            self._thread.join(PATIENCE)

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
            self._keeper = StateKeeper(self._engine)  # what has changed is not known any more
            self._memories = {}
            self._reports.error(error)
            return not isinstance(error, FileTaken)
        return True

    def write(self) -> None:
        """Write what has changed since the last time.

        Raises:
            UsageError: where that cannot be written.
        """
        parts = parts_of(self._engine)
        found = parts.runner.call(lambda: parts.dispatcher.undisturbed(self._take), (REQUEST,))
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
        parts = parts_of(self._engine)
        standings = list(parts.programs.values())
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
        memories: Dict[Instance, _InFile] = {}
        records = []
        for instance in parts_of(self._engine).knowledge.memories:
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
    for at in range(0, len(new.records), MOST):
        part = new.part(at, at + MOST)
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
        StateKeeper(engine).take_up(found.sections, found.records, folder)
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
