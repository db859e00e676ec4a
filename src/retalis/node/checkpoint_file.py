"""The checkpoint of a node: restored at the start, then written periodically."""

import logging
import time
from pathlib import Path
from typing import Callable, Optional

from ..engine.checkpoints import (
    Checkpoint,
    Checkpointer,
    CheckpointStorage,
    ProgramFiles,
    rename_refused_file,
    resume,
)
from ..engine.engine import Engine
from ..engine.engine_settings import Settings
from ..engine.runtime.problem_reports import Reports
from ..events.clock.clock import Clock
from ..foundation.displayed_text import format_count
from ..foundation.errors import RetalisError
from ..messages.type_registry import Definitions

log = logging.getLogger("retalis")


class CheckpointFile:
    """File of parameter ``~checkpoint``, if it is set.

    A file that does not fit the program is renamed, and the node starts without state.

    Args:
        path: the file; None if the state is not saved.
        program: folder of the program.
        reports: receives the errors of writing.

    Attributes:
        is_resumed: whether the engine was restored from the file, with its program loaded.
    """

    def __init__(self, path: Optional[Path], program: Path, reports: Reports):
        self._path = path
        self._program = program
        self._reports = reports
        self.is_resumed = False
        self._is_usable = path is not None
        self._files: Optional[ProgramFiles] = None

    def create_engine(
        self, create_clock: Callable[[], Clock], settings: Settings, definitions: Definitions
    ) -> Engine:
        """Return an engine: restored from the file, or a new one.

        Args:
            create_clock: creates a clock; called again if restoring fails.
            settings: settings of the engine.
            definitions: known message types.
        """
        if self._path is not None:
            try:
                restored = resume(
                    self._path, self._program, create_clock(), settings, self._reports, definitions
                )
            except RetalisError as error:
                self._rename_unusable(self._path, error)
                restored = None
            if restored is not None:
                self.is_resumed = True
                self._files = restored[1].files
                self._log_restored(*restored)
                return restored[0]
        return Engine(create_clock(), settings, self._reports, definitions)

    def start_writing(self, engine: Engine, on_shutdown: Callable[[Callable[[], object]], object]) -> None:
        """Start to write the engine's state periodically, until the node ends."""
        if self._path is None or not self._is_usable:
            return
        try:
            storage = CheckpointStorage(self._path)
        except RetalisError as error:
            log.error("parameter ~checkpoint: %s", error.message)
            return
        # The files that the restored program was read from, which may have changed since.
        checkpointer = Checkpointer(engine, storage, self._program, self._reports, files=self._files)
        checkpointer.start()
        on_shutdown(checkpointer.stop)

    def _rename_unusable(self, path: Path, error: RetalisError) -> None:
        try:
            outcome = f"the file is kept as {rename_refused_file(path)}"
        except RetalisError as rename_error:
            outcome = f"{rename_error.message}, so no state is kept"
            self._is_usable = False
        log.warning("%s is not restored: %s: the node starts without state; %s", path, error.message, outcome)

    def _log_restored(self, engine: Engine, restored: Checkpoint) -> None:
        records = sum(len(entry.memory) for entry in engine.program.knowledge.memories)
        log.info(
            "restored from %s, written %.1f s ago: %s with %s, %s, %s",
            self._path,
            time.time() - restored.written_at,
            engine.summary(),
            format_count(records, "record"),
            format_count(engine.program.rules.match_count, "partial match", "partial matches"),
            format_count(len(engine.program.knowledge.pending_queries), "waiting query", "waiting queries"),
        )
