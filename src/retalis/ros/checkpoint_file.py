"""Checkpoint file of node ``retalis``: restored at the start, written periodically while the node runs.

A file that does not fit the program is renamed, and the node starts without state.
"""

import time
from typing import Callable, Optional

import rospy

from ..engine.checkpoints import (
    Checkpoint,
    Checkpointer,
    CheckpointStorage,
    ProgramFiles,
    rename_refused_file,
    resume,
)
from ..engine.engine import Engine
from ..engine.runtime.clock import Clock
from ..engine.runtime.problem_reports import Reports
from ..foundation.errors import RetalisError, counted
from ..messages.type_registry import Definitions
from .parameters import Parameters


class CheckpointFile:
    """The file of parameter ``~checkpoint``, which may be unset.

    Args:
        parameters: parameters of the node.
        reports: receives the errors of writing.

    Attributes:
        resumed: whether the engine was restored from the file, with its program loaded.
    """

    def __init__(self, parameters: Parameters, reports: Reports):
        self._parameters = parameters
        self._reports = reports
        self.resumed = False
        self._is_usable = parameters.checkpoint is not None
        self._files: Optional[ProgramFiles] = None

    def engine(self, clock: Callable[[], Clock], definitions: Definitions) -> Engine:
        """Return the engine of the node: restored from the file, or a new one.

        Args:
            clock: creates a clock; called again if restoring fails.
            definitions: known message types.
        """
        parameters = self._parameters
        path = parameters.checkpoint
        if path is not None:
            try:
                restored = resume(
                    path, parameters.program, clock(), parameters.settings, self._reports, definitions
                )
            except RetalisError as error:
                self._rename_unusable(error)
                restored = None
            if restored is not None:
                self.resumed = True
                self._files = restored[1].files
                self._log_restored(*restored)
                return restored[0]
        return Engine(clock(), parameters.settings, self._reports, definitions)

    def _rename_unusable(self, error: RetalisError) -> None:
        path = self._parameters.checkpoint
        assert path is not None
        try:
            outcome = f"the file is kept as {rename_refused_file(path)}"
        except RetalisError as rename_error:
            outcome = f"{rename_error.message}, so no state is kept"
            self._is_usable = False
        rospy.logwarn(
            "%s is not restored: %s: the node starts without state; %s", path, error.message, outcome
        )

    def _log_restored(self, engine: Engine, restored: Checkpoint) -> None:
        records = sum(len(entry.memory) for entry in engine.knowledge.memories)
        rospy.loginfo(
            "restored from %s, written %.1f s ago: %s with %s, %s, %s",
            self._parameters.checkpoint,
            time.time() - restored.written_at,
            engine.summary(),
            counted(records, "record"),
            counted(engine.rules.waiting, "partial match", "partial matches"),
            counted(len(engine.knowledge.pending_queries), "waiting query", "waiting queries"),
        )

    def begin(self, engine: Engine) -> None:
        """Start to write the engine's state periodically, until the node ends."""
        path = self._parameters.checkpoint
        if path is None or not self._is_usable:
            return
        try:
            storage = CheckpointStorage(path)
        except RetalisError as error:
            rospy.logerr("parameter ~checkpoint: %s", error.message)
            return
        # The files that the restored program was read from, which may have changed since.
        checkpointer = Checkpointer(
            engine, storage, self._parameters.program, self._reports, files=self._files
        )
        checkpointer.start()
        rospy.on_shutdown(checkpointer.stop)
