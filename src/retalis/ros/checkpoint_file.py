"""The state of node ``retalis`` in a file: taken up at the start, kept while the node runs."""

import time
from typing import Callable, Optional

import rospy

from ..engine.checkpoints import Checkpoint, Checkpointer, CheckpointStorage, ProgramFiles, put_aside, resume
from ..engine.engine import Engine
from ..engine.runtime.clock import Clock
from ..engine.runtime.problem_reports import Reports
from ..foundation.errors import RetalisError, counted
from ..messages.type_registry import Definitions
from .parameters import Parameters


class StateFile:
    """The file of parameter ``~checkpoint``, if there is one.

    Args:
        parameters: of the node.
        reports: takes what goes wrong.

    Attributes:
        resumed: whether the engine goes on from the file, so that its program is there already.
    """

    def __init__(self, parameters: Parameters, reports: Reports):
        self._parameters = parameters
        self._reports = reports
        self.resumed = False
        self._usable = parameters.checkpoint is not None
        self._files: Optional[ProgramFiles] = None

    def engine(self, clock: Callable[[], Clock], definitions: Definitions) -> Engine:
        """Return the engine of the node: one that goes on from the file, or a new one.

        Args:
            clock: makes its clock.
            definitions: the message types that are known.
        """
        parameters = self._parameters
        path = parameters.checkpoint
        if path is not None:
            try:
                found = resume(
                    path, parameters.program, clock(), parameters.settings, self._reports, definitions
                )
            except RetalisError as error:
                self._refuse(error)
                found = None
            if found is not None:
                self.resumed = True
                self._files = found[1].files
                self._tell(*found)
                return found[0]
        return Engine(clock(), parameters.settings, self._reports, definitions)

    def _refuse(self, error: RetalisError) -> None:
        path = self._parameters.checkpoint
        assert path is not None
        try:
            where = f"the file is kept as {put_aside(path)}"
        except RetalisError as second:
            where = f"{second.message}, so no state is kept"
            self._usable = False
        rospy.logwarn("%s is not taken up: %s. The node starts fresh; %s", path, error.message, where)

    def _tell(self, engine: Engine, found: Checkpoint) -> None:
        parts = engine
        records = sum(len(one.memory) for one in parts.knowledge.memories)
        rospy.loginfo(
            "goes on from %s, written %.1f s ago: %s with %s, %s, %s",
            self._parameters.checkpoint,
            time.time() - found.made,
            engine.summary(),
            counted(records, "record"),
            counted(parts.rules.waiting, "partial match", "partial matches"),
            counted(len(parts.knowledge.waiting), "waiting query", "waiting queries"),
        )

    def begin(self, engine: Engine) -> None:
        """Keep the engine's state from now on, until the node ends."""
        path = self._parameters.checkpoint
        if path is None or not self._usable:
            return
        try:
            file = CheckpointStorage(path)
        except RetalisError as error:
            rospy.logerr("parameter ~checkpoint: %s", error.message)
            return
        kept = Checkpointer(engine, file, self._parameters.program, self._reports, files=self._files)
        kept.begin()
        rospy.on_shutdown(kept.end)
