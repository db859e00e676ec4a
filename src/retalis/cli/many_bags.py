"""One bag of many: what a worker does, be it a process of this machine or of a Dask cluster.

Many bags, each played by itself: in processes of this machine or on a Dask cluster, the results in order.
"""

import argparse
import io
import os
import shutil
import sys
import threading
from collections import deque
from contextlib import ExitStack, closing, redirect_stderr, redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Callable, Deque, Dict, Generator, List, NamedTuple, Optional, Tuple, Union

from ..engine.runtime.gc_tuning import restore_gc
from ..foundation.errors import RetalisError, UsageError
from ..playback.bag_sources import (
    FoundBag,
    fetched,
    find_bags,
    in_parts,
    is_folder_of_bags,
    is_there,
    is_url,
    remove_parts,
    result_file,
)
from ..playback.run_recorder import RunTable
from ..playback.worker_pool import Unfinished, in_processes, on_cluster
from .bag_run import play, print_line
from .error_report import Report, leave, progress
from .option_values import from_one

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


_OPTIONS = (
    "program",
    "start",
    "duration",
    "topic",
    "direct",
    "max_skew",
    "max_gap",
    "max_chunk_megabytes",
    "events",
    "times",
    "explain",
    "json",
    "quiet",
    "allow_swi",
    "max_seconds",
    "max_inferences",
    "max_megabytes",
    "max_output_megabytes",
    "watchdog",
    "max_depth",
    "folder",
    "write_folder",
)
"""The options that say how one bag is played."""


def add_many(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    group = parser.add_argument_group(
        "many bags",
        "Each bag is played by itself, from the program's start. One that cannot be played is told of, and the "
        "others are played; one whose worker dies is played again by another.",
    )
    add = group.add_argument
    add("--jobs", type=from_one, metavar="N", help="play so many at a time, in processes of this machine")
    add(
        "--scheduler",
        metavar="ADDRESS",
        help="play them on the Dask cluster of this scheduler, as tcp://HOST:8786; its workers need this package, "
        "and have to see the program, bags and results under the same paths; needs --output",
    )
    add(
        "--parts",
        action="store_true",
        help="have what rosbag record --split has written in parts, NAME_0.bag, NAME_1.bag and so on, go on with "
        "what the part before has left: memories, half-matched patterns, waiting queries",
    )
    add(
        "--format",
        choices=FORMATS,
        help="with --output, which is then the folder or URL that gets a file for each bag: a bag of what is "
        "published, or what --json prints, as lines or as Parquet (bag; with --json: jsonl)",
    )


def are_many(options: argparse.Namespace) -> bool:
    """Tell whether the options ask for bags to be played each by itself.

    Raises:
        UsageError: where they do not, and something else asks for it.
    """
    if options.jobs or options.scheduler:
        return True
    for name in ("format", "parts"):
        if getattr(options, name):
            raise UsageError(f"--{name} needs --jobs or --scheduler")
    for place in options.bags:
        if is_url(place):
            raise UsageError(f"{place}: --jobs plays bags of URLs, each by itself")
        if is_folder_of_bags(place):
            raise UsageError(
                f"{place} is no bag of ROS 2: no metadata.yaml; --jobs plays all bags below a folder"
            )
    return False


_One = Union[Played, Unfinished]


def play_many(options: argparse.Namespace) -> int:
    """Play bags each by itself, and print or keep the results in order; return the exit status."""
    _refuse(options)
    with ExitStack() as stack:
        scratch = stack.enter_context(TemporaryDirectory(prefix="retalis-"))
        tasks, ready = _tasks(options, _recordings(options), scratch)
        stack.callback(remove_parts, [task.target for task in tasks])
        results = _Results(tasks, to_print=options.output is None)
        bar = stack.enter_context(progress("bags", lambda: results.done / len(tasks)))
        clear = bar.clear if bar is not None else lambda: None

        def lost(number: int, how: str) -> None:
            clear()
            print(
                f"warning: {tasks[number].place}: its worker died {how}; it is played again",
                file=sys.stderr,
            )

        played = stack.enter_context(closing(_played(options, tasks, ready, scratch, lost)))
        for number, one in played:
            clear()
            if isinstance(one, Played) and one.state is not None:  # the recording first: states are large
                tasks[number + 1] = tasks[number + 1]._replace(state=one.state)
                ready.appendleft(number + 1)
                one = one._replace(state=None)
            tasks[number] = tasks[number]._replace(state=None)
            results.take(number, one)
            if bar is not None:
                bar(results.done)
        return results.finish()


def _played(
    options: argparse.Namespace,
    tasks: List[BagTask],
    ready: Deque[int],
    scratch: str,
    lost: Callable[[int, str], object],
) -> Generator[Tuple[int, _One], None, None]:
    if options.scheduler:
        return on_cluster(play_bag, tasks, options.scheduler, ready)
    return in_processes(play_bag, tasks, options.jobs, scratch, lost, ready)


def _refuse(options: argparse.Namespace) -> None:
    """Refuse options that do not go together.

    Raises:
        UsageError: where there are some.
    """
    kind = _format(options)
    if options.jobs and options.scheduler:
        raise UsageError("--jobs and --scheduler: give one of them; a cluster has as many workers as it has")
    if options.scheduler and not options.output:
        raise UsageError("--scheduler needs --output: a folder that the workers see, or a URL")
    if options.format and not options.output:
        raise UsageError("--format needs --output")
    if options.write_folder:
        raise UsageError(
            "--write-folder: bags that are played at the same time would write over each other's files"
        )
    if kind == "bag" and options.events:
        raise UsageError("--events: a bag has what is published only; --format jsonl and parquet have events")
    if kind in ("bag", "parquet") and options.explain:
        raise UsageError(f"--explain: --format {kind} has no place for it, jsonl has")
    if options.output and not is_url(options.output):
        target = Path(options.output).resolve()
        for place in options.bags:
            if is_folder_of_bags(place) and Path(place).resolve() in (target, *target.parents):
                raise UsageError(
                    f"--output {options.output} is below {place}: results would be played the next time"
                )


def _format(options: argparse.Namespace) -> Optional[str]:
    if not options.output:
        return None
    return str(options.format or ("jsonl" if options.json else "bag"))


def _recordings(options: argparse.Namespace) -> List[List[FoundBag]]:
    bags = find_bags(options.bags)
    return in_parts(bags) if options.parts else [[bag] for bag in bags]


def _tasks(
    options: argparse.Namespace, recordings: List[List[FoundBag]], scratch: str
) -> Tuple[List[BagTask], Deque[int]]:
    """Return what there is to do, in order, and with what it begins: the first parts.

    Raises:
        UsageError: where two results would have one name, or one is there already.
    """
    kind = _format(options)
    seen = os.path.abspath if options.scheduler else str  # other processes may be elsewhere

    def told(place: str) -> str:
        return place if is_url(place) else seen(place)

    how = {name: getattr(options, name) for name in _OPTIONS}
    how["program"] = Path(seen(options.program))
    how["folder"] = [seen(one) for one in options.folder]
    targets: Dict[str, str] = {}
    tasks: List[BagTask] = []
    first: Deque[int] = deque()
    for bags in recordings:
        first.append(len(tasks))
        for bag in bags:
            if kind is None:
                target = os.path.join(scratch, str(len(tasks)))
            else:
                target = told(f"{options.output.rstrip('/')}/{bag.name}.{kind}")
                _refuse_target(target, bag, targets, options.overwrite)
            targets[target] = bag.place
            tasks.append(BagTask(told(bag.place), target, kind, how, goes_on=bag is not bags[-1]))
    return tasks, first


def _refuse_target(target: str, bag: FoundBag, targets: Dict[str, str], overwrite: bool) -> None:
    if target in targets:
        raise UsageError(
            f"{targets[target]} and {bag.place}: the result of both would be {target}; "
            "give the folder that both are below, or different ones to --output"
        )
    if not overwrite and is_there(target):
        raise UsageError(f"{target} already exists; --overwrite replaces it")


class _Results:
    """Tells what became of bags, in their order.

    Attributes:
        done: how many bags there is a result of, or none to be had.
    """

    def __init__(self, tasks: List[BagTask], to_print: bool):
        self._tasks = tasks
        self._to_print = to_print
        self._held: Dict[int, _One] = {}
        self._told = 0
        self._errors = 0
        self._failed = 0
        self._said: Dict[str, int] = {}
        self.done = 0

    def take(self, number: int, one: _One) -> None:
        """Take what became of a bag; tell of all whose turn it is."""
        self.done += 1
        self._held[number] = one
        while self._tasks[number].goes_on and _failure(self._held[number]) is not None:
            number, place = number + 1, self._tasks[number].place
            self.done += 1
            self._held[number] = Unfinished(f"not played: it goes on from {place}, which failed")
        while self._told in self._held:
            self._tell(self._tasks[self._told], self._held.pop(self._told))
            self._told += 1

    def _tell(self, task: BagTask, one: _One) -> None:
        failure = _failure(one)
        if isinstance(one, Played):
            self._errors += one.errors
            self._tell_said(task, one.said)
        if failure is None and not (self._to_print or is_url(task.target) or os.path.exists(task.target)):
            failure = f"{task.target} is not seen here: this machine and the workers need to share its folder"
        if failure is not None:
            self._failed += 1
            print(f"error: {_beginning_with(task.place, failure)}", file=sys.stderr)
        elif self._to_print:
            with open(task.target, encoding="utf-8") as file:
                shutil.copyfileobj(file, sys.stdout)
            os.unlink(task.target)

    def _tell_said(self, task: BagTask, said: str) -> None:
        """Tell of errors and warnings of a bag, once where those of others are the same."""
        if not said:
            return
        if said not in self._said:
            print(f"{task.place}:\n{said}", end="", file=sys.stderr)
        self._said[said] = self._said.get(said, 0) + 1

    def finish(self) -> int:
        """Sum up; return the exit status."""
        again = sum(self._said.values()) - len(self._said)
        if again:
            print(f"{again} more bags had the same errors and warnings as one before", file=sys.stderr)
        if self._failed:
            print(f"{self._failed} of {len(self._tasks)} bags failed", file=sys.stderr)
        return 1 if self._failed or self._errors else 0


def _failure(one: _One) -> Optional[str]:
    return one.cause if isinstance(one, Unfinished) else one.failure


def _beginning_with(place: str, failure: str) -> str:
    return failure if failure.startswith(place) else f"{place}: {failure}"
