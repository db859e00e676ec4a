"""Service ``~reload``: the program's folder read again while the node runs."""

import os
from pathlib import Path
from typing import Any, Callable, Optional, Tuple

import rospy

from ..engine import Engine
from ..events.program import TOPICS, Topics, read_topics
from ..foundation import RetalisError, UsageError, beginning
from .services import OK

LONGEST = 10_000
"""Characters of what an answer says is wrong."""

RESTART = f"topics: {TOPICS} has changed; its topics change when the node is started again"


class ReloadService:
    """Service ``~reload`` of node retalis.

    Args:
        engine: whose program it is.
        folder: the program's.
        writable: where goals may write files; None means anywhere.
        topics: of the program when the node started.
        loaded: called where the program has been read again.
    """

    def __init__(
        self,
        engine: Engine,
        folder: Path,
        writable: Optional[Tuple[str, ...]],
        topics: Topics,
        loaded: Callable[[Topics], None],
    ):
        from retalis import srv  # noqa: PLC0415 - generated: there only where the package was built

        self._engine = engine
        self._folder = folder
        self._writable = writable
        self._topics = topics
        self._loaded = loaded
        self._reloaded = srv.ReloadResponse
        rospy.Service("~reload", srv.Reload, self._reload)

    def _reload(self, request: Any) -> Any:
        try:
            check_writers(self._folder, self._writable)
            topics = topics_now(self._folder)
            changes = self._engine.reload(self._folder)
        except RetalisError as error:
            return self._reloaded(f"error: {beginning(str(error), LONGEST)}", [])  # with the lines and carets
        if topics != self._topics:
            changes.append(RESTART)
        self._loaded(topics)
        rospy.loginfo("%s was read again: %s", self._folder, self._engine.summary())
        return self._reloaded(OK, changes)


def check_writers(folder: Path, writable: Optional[Tuple[str, ...]]) -> None:
    """Accept a program's folder in which no goal may write: its goals and rules may more than those of services.

    Raises:
        UsageError: where a goal may.
    """
    real = os.path.realpath(folder)
    for other in ("/",) if writable is None else writable:
        above = os.path.realpath(other)
        if os.path.commonpath((real, above)) == above:
            raise UsageError(
                f"{folder} is in {other} of ~write_folders: goals of services could write the program; "
                "restart the node to have it read again"
            )


def topics_now(folder: Path) -> Topics:
    """Return the topics of a program; none where there is no file of them, as when the node starts.

    Raises:
        ProgramErrors: what is wrong in the file.
    """
    try:
        return read_topics(folder / TOPICS)
    except UsageError:
        return Topics()
