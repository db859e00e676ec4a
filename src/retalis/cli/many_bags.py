"""Parallel runs over many bags, in processes of this machine or on a Dask cluster, with results in the bags' order.

Each bag is a `BagTask`, which a worker plays from the program's initial state (`play_bag`). With ``--parts``, the
parts of a split recording form a chain: a part is ready when the former one has finished, and continues from its
snapshot. `play_separately` schedules the tasks; `_Results` holds finished results back until all earlier ones have
been printed, so that the output does not depend on the number of workers.
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

from ..foundation.cpython_and_pypy import restore_gc
from ..foundation.errors import RetalisError, UsageError
from ..playback.bag_locations import (
    BagLocation,
    find_bags,
    group_recordings,
    is_folder_of_bags,
    is_url,
    local_copy,
    location_exists,
    remove_incomplete_results,
    result_file,
)
from ..playback.playback import RunTable
from ..playback.worker_pool import Unfinished, run_in_processes, run_on_cluster
from .bag_run import RecordHandler, play, print_record
from .option_values import positive_integer
from .stderr_report import StderrReporter, detach_reporters, show_progress

FORMATS = ("bag", "parquet", "jsonl")

_MAX_MESSAGE_CHARACTERS = 64 << 10
"""Limit for the characters of errors and warnings of a bag."""


class BagTask(NamedTuple):
    """A bag to play.

    Attributes:
        location: path or URL of the bag.
        target: path or URL for the result.
        format: format of the result, one of `FORMATS`; None for the printed output.
        options: the options of the command that apply to a single bag.
        has_next_part: whether it is a part of a recording with a further part.
        state: snapshot of the program after the previous part; None without one.
    """

    location: str
    target: str
    format: Optional[str]
    options: Dict[str, Any]
    has_next_part: bool = False
    state: Optional[bytes] = None


class BagOutcome(NamedTuple):
    """Outcome of a bag.

    Attributes:
        errors: number of errors during the run, which do not prevent a result.
        stderr_text: text of errors and warnings.
        failure: reason why there is no result; None if there is one.
        state: snapshot of the program for the next part; None without one.
    """

    errors: int
    stderr_text: str
    failure: Optional[str] = None
    state: Optional[bytes] = None


_PROCESS_LOCK = threading.Lock()
"""Lock of standard output and the reports, which exist once per process: a Dask worker may have several threads."""


def play_bag(task: BagTask, scratch: str) -> BagOutcome:
    """Play a bag and write its result; all errors are part of the returned outcome.

    Args:
        task: the bag.
        scratch: folder for temporary files.
    """
    stderr, failure, bag, state = _LimitedOutput(), "", task.location, None
    with _PROCESS_LOCK, redirect_stderr(stderr):
        stderr_reporter = StderrReporter().attach(show_events=True)
        try:
            with local_copy(task.location, scratch) as bag, result_file(task.target, scratch) as result:
                state = _play_to_file(result, bag, task, stderr_reporter)
        except RetalisError as error:
            failure = str(error)
        except Exception as error:
            # An internal error in one bag must not stop the others.
            failure = f"{type(error).__name__}: {error}"
        finally:
            detach_reporters()
            restore_gc()
    # Messages name the bag as the user gave it, not the temporary copy of a URL.
    messages, failure = (text.replace(bag, task.location) for text in (stderr.getvalue(), failure))
    return BagOutcome(stderr_reporter.errors, messages, failure or None, state)


def _play_to_file(result: str, bag: str, task: BagTask, stderr_reporter: StderrReporter) -> Optional[bytes]:
    """Play a bag into a file; return the program's snapshot if a part follows."""
    options = argparse.Namespace(**task.options, bags=[bag], output=None, overwrite=True)
    write_record: RecordHandler = print_record
    with ExitStack() as stack:
        if task.format == "bag":
            # The recording has the outputs, so they are not printed.
            options.output, options.quiet = result, True
        elif task.format is not None:
            options.json = True
        if task.format == "parquet":
            write_record = stack.enter_context(RunTable(result, options.events)).write
        # Printed output becomes the result of the formats that consist of lines, and is discarded otherwise.
        printed_output_path = result if task.format in (None, "jsonl") else os.devnull
        file = stack.enter_context(open(printed_output_path, "w", encoding="utf-8"))
        stack.enter_context(redirect_stdout(file))
        playback = play(options, stderr_reporter, write_record, task.state)
        return playback.engine.snapshot() if task.has_next_part else None


class _LimitedOutput(io.StringIO):
    """Standard error of a bag, cut after `_MAX_MESSAGE_CHARACTERS` characters."""

    _dropped_characters = 0

    def write(self, text: str) -> int:
        # A bag with an error per message must not fill the memory of the process that collects the messages.
        written = text[: max(0, _MAX_MESSAGE_CHARACTERS - self.tell())]
        self._dropped_characters += len(text) - len(written)
        super().write(written)
        return len(text)

    def getvalue(self) -> str:
        truncation_note = (
            f"\n... and {self._dropped_characters} more characters\n" if self._dropped_characters else ""
        )
        return super().getvalue() + truncation_note


_OPTIONS = (
    "program",
    "start",
    "duration",
    "topic",
    "direct",
    "max_skew",
    "max_gap",
    "tf_cache",
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
"""Options that apply to a single bag."""


def add_many_bags_options(parser: argparse.ArgumentParser) -> None:
    """Add the options for many bags."""
    group = parser.add_argument_group(
        "many bags",
        "Each bag is a separate run of the program. A bag that cannot be played is reported, and the others are "
        "played. A bag whose worker dies is played again by another worker.",
    )
    add = group.add_argument
    add(
        "--jobs",
        type=positive_integer,
        metavar="N",
        help="play N bags at a time, in processes of this machine",
    )
    add(
        "--scheduler",
        metavar="ADDRESS",
        help="play them on the Dask cluster of this scheduler, as tcp://HOST:8786; its workers need this package, "
        "and have to see the program, bags and results under the same paths; needs --output",
    )
    add(
        "--parts",
        action="store_true",
        help="play the parts of a recording by rosbag record --split, NAME_0.bag, NAME_1.bag and so on, as one run: "
        "each continues with the memories, partial matches and waiting queries of the former one",
    )
    add(
        "--format",
        choices=FORMATS,
        help="format of the results; --output is then the folder or URL for one file per bag: a bag of the published "
        "messages, or the output of --json, as lines or as Parquet (bag; with --json: jsonl)",
    )


def requests_separate_runs(options: argparse.Namespace) -> bool:
    """Return whether the options request a separate run for each bag.

    Raises:
        UsageError: if they do not, but another option or a bag requires it.
    """
    if options.jobs or options.scheduler:
        return True
    for name in ("format", "parts"):
        if getattr(options, name):
            raise UsageError(f"--{name} needs --jobs or --scheduler")
    for location in options.bags:
        if is_url(location):
            raise UsageError(f"{location}: --jobs plays bags of URLs, each by itself")
        if is_folder_of_bags(location):
            raise UsageError(
                f"{location} is not a ROS 2 bag: it has no metadata.yaml: use --jobs to play all bags below a folder"
            )
    return False


_TaskOutcome = Union[BagOutcome, Unfinished]


def play_separately(options: argparse.Namespace) -> int:
    """Play each bag in a run of its own, and print or store the results in order; return the exit status."""
    _check_options(options)
    with ExitStack() as stack:
        scratch = stack.enter_context(TemporaryDirectory(prefix="retalis-"))
        tasks, ready = _create_tasks(options, _find_recordings(options), scratch)
        stack.callback(remove_incomplete_results, [task.target for task in tasks])
        reporter = _OutcomeReporter(tasks, to_print=options.output is None)
        bar = stack.enter_context(show_progress("bags", lambda: reporter.finished_count / len(tasks)))
        clear_bar = bar.clear if bar is not None else lambda: None

        def warn_worker_death(number: int, description: str) -> None:
            clear_bar()
            print(
                f"warning: {tasks[number].location}: its worker died {description}; it is played again",
                file=sys.stderr,
            )

        outcomes = stack.enter_context(closing(_run_tasks(options, tasks, ready, scratch, warn_worker_death)))
        for number, outcome in outcomes:
            clear_bar()
            if isinstance(outcome, BagOutcome) and outcome.state is not None:
                # The next part runs before other bags, so that few snapshots exist at a time: they are large.
                tasks[number + 1] = tasks[number + 1]._replace(state=outcome.state)
                ready.appendleft(number + 1)
                outcome = outcome._replace(state=None)
            # The snapshot that the task started from is not needed any more, unless its worker had died.
            tasks[number] = tasks[number]._replace(state=None)
            reporter.add_outcome(number, outcome)
            if bar is not None:
                bar(reporter.finished_count)
        return reporter.finish()


def _run_tasks(
    options: argparse.Namespace,
    tasks: List[BagTask],
    ready: Deque[int],
    scratch: str,
    on_worker_death: Callable[[int, str], object],
) -> Generator[Tuple[int, _TaskOutcome], None, None]:
    if options.scheduler:
        return run_on_cluster(play_bag, tasks, options.scheduler, ready)
    return run_in_processes(play_bag, tasks, options.jobs, scratch, on_worker_death, ready)


def _check_options(options: argparse.Namespace) -> None:
    """Reject incompatible options.

    Raises:
        UsageError: if there are any.
    """
    result_format = _select_format(options)
    if options.jobs and options.scheduler:
        raise UsageError(
            "--jobs and --scheduler: give only one option: a cluster determines the number of its workers"
        )
    # The results of other machines have to be written to a folder or URL that both sides can read.
    if options.scheduler and not options.output:
        raise UsageError("--scheduler needs --output: a folder that the workers see, or a URL")
    if options.format and not options.output:
        raise UsageError("--format needs --output")
    if options.write_folder:
        raise UsageError(
            "--write-folder: bags that are played at the same time would write over each other's files"
        )
    if result_format == "bag" and options.events:
        raise UsageError("--events: a bag contains only published messages; use --format jsonl or parquet")
    if result_format in ("bag", "parquet") and options.explain:
        raise UsageError(
            f"--explain: --format {result_format} cannot contain explanations: use --format jsonl"
        )
    if options.output and not is_url(options.output):
        target = Path(options.output).resolve()
        for location in options.bags:
            if is_folder_of_bags(location) and Path(location).resolve() in (target, *target.parents):
                raise UsageError(
                    f"--output {options.output} is below {location}: results would be played the next time"
                )


def _select_format(options: argparse.Namespace) -> Optional[str]:
    if not options.output:
        return None
    return str(options.format or ("jsonl" if options.json else "bag"))


def _find_recordings(options: argparse.Namespace) -> List[List[BagLocation]]:
    bags = find_bags(options.bags)
    return group_recordings(bags) if options.parts else [[bag] for bag in bags]


def _create_tasks(
    options: argparse.Namespace, recordings: List[List[BagLocation]], scratch: str
) -> Tuple[List[BagTask], Deque[int]]:
    """Return all tasks in order, and the numbers of the tasks that can start: the first parts of recordings.

    Raises:
        UsageError: if two results would have the same name, or a result exists already.
    """
    result_format = _select_format(options)
    # The processes of a cluster may have other working directories.
    absolute = os.path.abspath if options.scheduler else str

    def shared_path(path_or_url: str) -> str:
        return path_or_url if is_url(path_or_url) else absolute(path_or_url)

    bag_options = {name: getattr(options, name) for name in _OPTIONS}
    bag_options["program"] = Path(absolute(options.program))
    bag_options["folder"] = [absolute(folder_name) for folder_name in options.folder]
    targets: Dict[str, str] = {}
    tasks: List[BagTask] = []
    ready: Deque[int] = deque()
    for bags in recordings:
        ready.append(len(tasks))
        for bag in bags:
            if result_format is None:
                # Printed output is collected in temporary files, so that it can be printed in the order of the
                # bags.
                target = os.path.join(scratch, str(len(tasks)))
            else:
                target = shared_path(f"{options.output.rstrip('/')}/{bag.name}.{result_format}")
                _check_target(target, bag, targets, options.overwrite)
            targets[target] = bag.location
            tasks.append(
                BagTask(
                    shared_path(bag.location),
                    target,
                    result_format,
                    bag_options,
                    has_next_part=bag is not bags[-1],
                )
            )
    return tasks, ready


def _check_target(target: str, bag: BagLocation, targets: Dict[str, str], overwrite: bool) -> None:
    if target in targets:
        raise UsageError(
            f"{targets[target]} and {bag.location}: the result of both would be {target}; "
            "give the folder that both are below, or different ones to --output"
        )
    if not overwrite and location_exists(target):
        raise UsageError(f"{target} already exists; --overwrite replaces it")


class _OutcomeReporter:
    """Reporter of the outcomes of bags, in the order of the bags.

    Attributes:
        finished_count: number of bags that have finished or failed.
    """

    def __init__(self, tasks: List[BagTask], to_print: bool):
        self._tasks = tasks
        self._to_print = to_print
        self._outcomes: Dict[int, _TaskOutcome] = {}
        self._next_to_report = 0
        self._error_count = 0
        self._failed_count = 0
        self._message_counts: Dict[str, int] = {}
        self.finished_count = 0

    def add_outcome(self, number: int, outcome: _TaskOutcome) -> None:
        """Store the outcome of a bag; report all outcomes whose predecessors have been reported."""
        self.finished_count += 1
        self._outcomes[number] = outcome
        # All later parts of a recording fail with one of its parts, because they would lack its state.
        while self._tasks[number].has_next_part and _get_failure(self._outcomes[number]) is not None:
            number, location = number + 1, self._tasks[number].location
            self.finished_count += 1
            self._outcomes[number] = Unfinished(f"not played: it goes on from {location}, which failed")
        while self._next_to_report in self._outcomes:
            self._report(self._tasks[self._next_to_report], self._outcomes.pop(self._next_to_report))
            self._next_to_report += 1

    def _report(self, task: BagTask, outcome: _TaskOutcome) -> None:
        failure = _get_failure(outcome)
        if isinstance(outcome, BagOutcome):
            self._error_count += outcome.errors
            self._report_messages(task, outcome.stderr_text)
        # A worker of a cluster may have written to a folder of its own machine with the same path.
        if failure is None and not (self._to_print or is_url(task.target) or os.path.exists(task.target)):
            failure = f"{task.target} is not seen here: this machine and the workers need to share its folder"
        if failure is not None:
            self._failed_count += 1
            print(f"error: {_prefix_location(task.location, failure)}", file=sys.stderr)
        elif self._to_print:
            with open(task.target, encoding="utf-8") as file:
                shutil.copyfileobj(file, sys.stdout)
            os.unlink(task.target)

    def _report_messages(self, task: BagTask, messages: str) -> None:
        """Print the errors and warnings of a bag, unless another bag had the same ones."""
        if not messages:
            return
        if messages not in self._message_counts:
            print(f"{task.location}:\n{messages}", end="", file=sys.stderr)
        self._message_counts[messages] = self._message_counts.get(messages, 0) + 1

    def finish(self) -> int:
        """Print a summary; return the exit status."""
        repeated_count = sum(self._message_counts.values()) - len(self._message_counts)
        if repeated_count:
            print(
                f"{repeated_count} more bags had the same errors and warnings as one before", file=sys.stderr
            )
        if self._failed_count:
            print(f"{self._failed_count} of {len(self._tasks)} bags failed", file=sys.stderr)
        return 1 if self._failed_count or self._error_count else 0


def _get_failure(outcome: _TaskOutcome) -> Optional[str]:
    return outcome.reason if isinstance(outcome, Unfinished) else outcome.failure


def _prefix_location(location: str, failure: str) -> str:
    return failure if failure.startswith(location) else f"{location}: {failure}"
