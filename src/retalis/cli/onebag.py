"""One bag of many: what a worker does, be it a process of this machine or of a Dask cluster."""

import argparse
import io
import os
import threading
from contextlib import ExitStack, redirect_stderr, redirect_stdout
from typing import Any, Dict, NamedTuple, Optional

from ..engine.playback import RunTable, fetched, result_file
from ..engine.runtime import restore_gc
from ..foundation import RetalisError
from .playing import play, print_line
from .report import Report, leave

FORMATS = ("bag", "parquet", "jsonl")

_SAID = 64 << 10
"""Characters of errors and warnings that are kept of a bag."""


class BagTask(NamedTuple):
    """A bag to be played.

    Attributes:
        place: its path or URL.
        target: what gets the result: a path or a URL.
        format: of the result, one of `FORMATS`; None for what is printed.
        options: those of the command that say how.
        goes_on: whether it is a part of a recording, and not the last.
        state: what the part before it has left, where there is one.
    """

    place: str
    target: str
    format: Optional[str]
    options: Dict[str, Any]
    goes_on: bool = False
    state: Optional[bytes] = None


class Played(NamedTuple):
    """What became of a bag.

    Attributes:
        errors: how many there were while it was played; its result is there in spite of them.
        said: errors and warnings.
        failure: why there is no result, where there is none.
        state: what the next part goes on from, where there is one.
    """

    errors: int
    said: str
    failure: Optional[str] = None
    state: Optional[bytes] = None


_PROCESS = threading.Lock()
"""A Dask worker may have several threads: standard output and the reports are those of one bag at a time."""


def play_bag(task: BagTask, scratch: str) -> Played:
    """Play a bag into its result, from the state of the part before it to its own; raise nothing."""
    said, failure, bag, state = _Said(), "", task.place, None
    with _PROCESS, redirect_stderr(said):
        report = Report().listen(events=True)
        try:
            with fetched(task.place, scratch) as bag, result_file(task.target, scratch) as result:
                state = _play_into(result, bag, task, report)
        except RetalisError as error:
            failure = str(error)
        except Exception as error:  # whatever it is, the other bags are to be played
            failure = f"{type(error).__name__}: {error}"
        finally:
            leave()
            restore_gc()
    told, failure = (text.replace(bag, task.place) for text in (said.getvalue(), failure))
    return Played(report.errors, told, failure or None, state)


def _play_into(result: str, bag: str, task: BagTask, report: Report) -> Optional[bytes]:
    """Play a bag into a file; return the program's state where a part follows."""
    options = argparse.Namespace(**task.options, bags=[bag], output=None, overwrite=True)
    tell = print_line
    with ExitStack() as stack:
        if task.format == "bag":
            options.output, options.quiet = result, True
        elif task.format is not None:
            options.json = True
        if task.format == "parquet":
            tell = stack.enter_context(RunTable(result, options.events)).write
        printed = result if task.format in (None, "jsonl") else os.devnull
        file = stack.enter_context(open(printed, "w", encoding="utf-8"))
        stack.enter_context(redirect_stdout(file))
        playback = play(options, report, tell, task.state)
        return playback.engine.snapshot() if task.goes_on else None


class _Said(io.StringIO):
    """Standard error of a bag: its beginning, and how much more there was."""

    _more = 0

    def write(self, text: str) -> int:
        kept = text[: max(0, _SAID - self.tell())]
        self._more += len(text) - len(kept)
        super().write(kept)
        return len(text)

    def getvalue(self) -> str:
        more = f"\n... and {self._more} more characters\n" if self._more else ""
        return super().getvalue() + more
