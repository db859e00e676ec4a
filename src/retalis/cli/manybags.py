"""Many bags, each played by itself: in processes of this machine or on a Dask cluster, the results in order."""

import argparse
import os
import shutil
import sys
from collections import deque
from contextlib import ExitStack, closing
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Callable, Deque, Dict, Generator, List, Optional, Tuple, Union

from ..engine.playback import (
    FoundBag,
    Unfinished,
    find_bags,
    in_parts,
    in_processes,
    is_folder_of_bags,
    is_there,
    is_url,
    on_cluster,
    remove_parts,
)
from ..foundation import UsageError
from .numbers import from_one
from .onebag import FORMATS, BagTask, Played, play_bag
from .progress import progress

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
