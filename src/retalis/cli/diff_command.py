"""Command ``diff``: compares the outputs of two versions of a program over bags."""

import argparse
import os
import sys
from collections import Counter
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Callable, Dict, List, NamedTuple, Optional, Sequence, Tuple
from xml.etree import ElementTree

from ..foundation.displayed_text import format_count, printable
from ..foundation.errors import RetalisError, UsageError
from ..foundation.output_files import print_json, write_xml
from ..messages.type_registry import Definitions
from ..node.subscribed_topics import HandlerFactory
from ..playback.bag_locations import MergedBag, find_bags, is_url, local_copy
from ..playback.incomplete_files import INCOMPLETE_STATUS, IncompleteFile
from ..playback.playback import Playback, make_incomplete_file_record
from ..playback.worker_pools import Unfinished, run_in_processes
from ..prolog.terms.timestamps import SECOND
from ..testing.case_run import ProblemLog
from ..testing.change_impact_analysis import Extent
from ..testing.output_changes import (
    MOVED_WITHIN_SECONDS,
    ChangeType,
    Comparison,
    OutputChange,
    PlainOutput,
    Version,
    compare_versions,
    have_equal_programs,
)
from .command_options import add_message_folders, message_folders
from .dask_cluster import (
    ClusterError,
    add_cluster_options,
    cluster_options,
    make_listener,
    run_on_cluster,
)
from .git_revisions import Revision, extract_revision
from .option_values import non_negative, positive_integer
from .optional_ros_imports import installed_definitions
from .progress_bar import show_long_progress
from .stderr_reports import paint

DESCRIPTION = """\
Run two versions of a program over bags, and print each output that is lost, gained, moved to another time, or
changed, with the reason in both versions. A folder of bags stands for all bags below it.

  retalis diff OLD NEW BAG...              two folders
  retalis diff --git REVISION PROGRAM BAG...    a folder in git, before and after

Exit status 0 if all outputs are equal, 1 if any differs or a bag or program has an error, 2 for wrong usage, 3 if
they are equal and a bag is incomplete.
"""


def add_parser(add_command: Callable[..., argparse.ArgumentParser]) -> None:
    """Add the parser of command ``diff``."""
    parser = add_command(
        "diff",
        help="compare the outputs of two versions of a program over bags",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("paths", nargs="+", metavar="PATH", help="OLD, NEW and bags; with --git a program and bags")
    add("--git", metavar="REVISION", help="the old version is the program's folder in this revision")
    add(
        "-j",
        "--jobs",
        type=positive_integer,
        metavar="N",
        help="compare N bags at a time (one for each core)",
    )
    add(
        "--moved-within",
        type=non_negative(float),
        default=MOVED_WITHIN_SECONDS,
        metavar="SECONDS",
        help=f"an equal output up to SECONDS earlier or later has moved ({MOVED_WITHIN_SECONDS:g})",
    )
    add(
        "--full",
        action="store_true",
        help="run also the rules that cannot differ, and report their errors",
    )
    add("--strict", action="store_true", help="refuse incomplete bags")
    add("--json", action="store_true", help="print one JSON object for each change")
    add("--junit", type=Path, metavar="FILE", help="write the results as JUnit XML, a test case for each bag")
    add_message_folders(parser.add_argument_group("message types").add_argument)
    add_cluster_options(parser)
    parser.set_defaults(run=run, reject_usage=parser.error)


class _ComparisonTask(NamedTuple):
    """Both versions of a program, and a bag."""

    old: Path
    new: Path
    bag: str
    message_folders: Sequence[str]
    moved_within: float
    is_full: bool
    is_strict: bool


class _BagResult(NamedTuple):
    """Result for a bag: the comparison, or the error of the bag, and what is missing in it.

    ``is_reported`` is true if the error concerns all bags that are left, and has been printed.
    """

    bag: str
    comparison: Optional[Comparison]
    error: str = ""
    is_reported: bool = False
    incomplete_files: Tuple[IncompleteFile, ...] = ()


def run(options: argparse.Namespace) -> int:
    """Run the command; return its exit status."""
    with ExitStack() as stack:
        old, new, locations, revision = _select_versions(options, stack)
        results = []
        for result in _run_tasks(options, _create_tasks(options, old, new, locations)):
            if revision is not None:
                result = _rename_paths(result, revision)
            results.append(result)
            _print_result(result, options.json)
    if options.junit is not None:
        _write_junit_report(options.junit, results)
    if not options.json:
        _print_summary(results)
    if not all(_is_equal(result) for result in results):
        return 1
    return INCOMPLETE_STATUS if any(result.incomplete_files for result in results) else 0


def _select_versions(
    options: argparse.Namespace, stack: ExitStack
) -> Tuple[Path, Path, List[str], Optional[Revision]]:
    """Return the folders of both versions, the locations of the bags, and the revision of ``--git``."""
    has_revision = options.git is not None
    program_count = 1 if has_revision else 2
    if len(options.paths) <= program_count:
        options.reject_usage("expected PROGRAM BAG..." if has_revision else "expected OLD NEW BAG...")
    if options.scheduler and options.jobs:
        options.reject_usage(
            "--jobs and --scheduler: expected only one option, because a cluster has its own workers"
        )
    if options.scheduler and has_revision:
        options.reject_usage("--scheduler and --git: expected OLD NEW BAG..., folders that the workers see")
    programs = [Path(path) for path in options.paths[:program_count]]
    for program in programs:
        if not program.is_dir():
            raise UsageError(f"{program} is not a folder: expected the folder of a program")
    old, new, locations = programs[0], programs[-1], options.paths[program_count:]
    if not has_revision:
        return old, new, locations, None
    revision = extract_revision(options.git, new, stack)
    return revision.program, new, locations, revision


def _create_tasks(
    options: argparse.Namespace, old: Path, new: Path, locations: Sequence[str]
) -> List[_ComparisonTask]:
    # The processes of a cluster may have other working directories.
    absolute = os.path.abspath if options.scheduler else str
    folders = message_folders(options)
    bags = [bag.location for bag in find_bags(locations)]
    return [
        _ComparisonTask(
            Path(absolute(old)),
            Path(absolute(new)),
            bag if is_url(bag) else absolute(bag),
            folders,
            options.moved_within,
            options.full,
            options.strict,
        )
        for bag in bags
    ]


def _run_tasks(options: argparse.Namespace, tasks: Sequence[_ComparisonTask]) -> List[_BagResult]:
    # Worthwhile if a bag is downloaded, or the programs would be loaded for each of several bags.
    if (
        not options.full
        and any(len(tasks) > 1 or is_url(task.bag) for task in tasks)
        and _has_equal_versions(tasks[0])
    ):
        comparison = Comparison((), 0, 0, Extent.EQUAL)
        return [_BagResult(task.bag, comparison) for task in tasks]
    with TemporaryDirectory(prefix="retalis-") as scratch:
        if len(tasks) == 1 and not options.scheduler:
            return [_compare_bag(tasks[0], scratch)]
        return _run_on_workers(options, tasks, scratch)


def _run_on_workers(
    options: argparse.Namespace, tasks: Sequence[_ComparisonTask], scratch: str
) -> List[_BagResult]:
    """Return the results of tasks that other processes perform."""
    results: Dict[int, _BagResult] = {}
    cluster_error = ""
    with ExitStack() as stack:
        bar = stack.enter_context(show_long_progress("bags", lambda: len(results) / len(tasks)))
        listener = make_listener(bar, lambda number: tasks[number].bag, "compared", lambda: len(results))
        if options.scheduler:
            outcomes = run_on_cluster(_compare_bag, tasks, cluster_options(options), listener)
        else:
            jobs = options.jobs or os.cpu_count() or 1
            outcomes = run_in_processes(
                _compare_bag,
                tasks,
                jobs,
                scratch,
                listener.on_worker_death,
                on_poll=lambda: bar(len(results)),
            )
        try:
            for number, outcome in stack.enter_context(closing(outcomes)):
                if isinstance(outcome, Unfinished):
                    outcome = _BagResult(tasks[number].bag, None, outcome.reason)
                results[number] = outcome
                bar(len(results))
        except ClusterError as error:
            listener.report(f"{paint('error', 'error', sys.stderr)}: {error}")
            cluster_error = error.message
    return [
        results.get(number) or _BagResult(task.bag, None, cluster_error, is_reported=True)
        for number, task in enumerate(tasks)
    ]


def _has_equal_versions(task: _ComparisonTask) -> bool:
    """Return whether both versions load without a bag, and no bag needs to be read because they are equal."""
    definitions = installed_definitions(task.message_folders)
    logs = _VersionLogs(ProblemLog(str), ProblemLog(str))
    try:
        with ProblemLog(str).attached():
            is_equal = have_equal_programs(_create_versions(task, definitions, None, logs))
    except RetalisError:
        # Reported for each bag.
        return False
    return is_equal and not logs.has_errors


def _compare_bag(task: _ComparisonTask, scratch: str) -> _BagResult:
    """Compare the outputs of both versions for a bag; a bag at a URL is downloaded to ``scratch``."""
    definitions = installed_definitions(task.message_folders)
    problems = ProblemLog(str)
    logs = _VersionLogs(ProblemLog(str), ProblemLog(str))
    try:
        with problems.attached(), local_copy(task.bag, scratch) as path, MergedBag(
            [path], strict=task.is_strict
        ) as bag:
            # Named as the user has given it, not as the temporary copy of a URL.
            incomplete_files = tuple(
                file._replace(path=file.path.replace(path, task.bag)) for file in bag.incomplete_files
            )
            comparison = compare_versions(
                *_create_versions(task, definitions, bag, logs),
                bag,
                task.moved_within,
                # The parts of a program with errors are not known.
                lambda: not (task.is_full or logs.has_errors),
            )
    except RetalisError as error:
        return _BagResult(task.bag, None, error.message)
    unique_problems = tuple(dict.fromkeys(problem for log in (*logs, problems) for problem in log.errors))
    return _BagResult(
        task.bag, comparison._replace(problems=unique_problems), incomplete_files=incomplete_files
    )


class _VersionLogs(NamedTuple):
    """The log of each version: the versions take turns, and errors of the old one are listed first."""

    old: ProblemLog
    new: ProblemLog

    @property
    def has_errors(self) -> bool:
        """True if a version has an error."""
        return bool(self.old.errors or self.new.errors)


def _create_versions(
    task: _ComparisonTask, definitions: Definitions, bag: Optional[MergedBag], logs: _VersionLogs
) -> Tuple[Version, Version]:
    """Return both versions of a program; their types are those of a bag, too, if there is one."""

    def load(folder: Path, log: ProblemLog, make_handler: HandlerFactory) -> Playback:
        return Playback(folder, log.add_error, bag=bag, definitions=definitions, make_handler=make_handler)

    return (
        Version(task.old, partial(load, task.old, logs.old), logs.old.attached),
        Version(task.new, partial(load, task.new, logs.new), logs.new.attached),
    )


def _rename_paths(result: _BagResult, revision: Revision) -> _BagResult:
    """Return a result whose messages name files of a revision instead of temporary files."""
    error = revision.rename_paths(result.error)
    comparison = result.comparison
    if comparison is None:
        return result._replace(error=error)
    changes = tuple(
        change._replace(reasons=tuple(map(revision.rename_paths, change.reasons)))
        for change in comparison.changes
    )
    problems = tuple(map(revision.rename_paths, comparison.problems))
    return result._replace(comparison=comparison._replace(changes=changes, problems=problems), error=error)


def _is_equal(result: _BagResult) -> bool:
    comparison = result.comparison
    return comparison is not None and not comparison.changes and not comparison.problems


def _print_result(result: _BagResult, as_json: bool) -> None:
    if result.is_reported:
        return
    if result.comparison is None:
        place = "" if result.error.startswith(result.bag) else f"{result.bag}: "
        print(f"{paint('error', 'error', sys.stderr)}: {place}{result.error}", file=sys.stderr)
        return
    _print_incomplete_files(result, as_json)
    for problem in result.comparison.problems:
        print(f"{paint('error', 'error', sys.stderr)}: {result.bag}: {problem}", file=sys.stderr)
    if as_json:
        for change in result.comparison.changes:
            print_json(_change_to_json(result.bag, change))
    elif result.comparison.changes:
        print(printable(result.bag))
        for change in result.comparison.changes:
            for line in format_change(change, result.comparison.start):
                print(f"  {line}")


def _print_incomplete_files(result: _BagResult, as_json: bool) -> None:
    for file in result.incomplete_files:
        print(f"{paint('warning', 'warning', sys.stderr)}: {printable(str(file))}", file=sys.stderr)
        if as_json:
            print_json(make_incomplete_file_record(file))


def format_change(change: OutputChange, start: int) -> List[str]:
    """Return the lines of a change: its type, time in seconds since the start, topic and term, and the reasons."""
    shown = change.old or change.new
    assert shown is not None
    time = _format_time(shown, start)
    text = shown.term
    if change.type is ChangeType.MOVED and change.new is not None:
        time = f"{time} -> {_format_time(change.new, start)}"
    elif change.type is ChangeType.CHANGED and change.new is not None:
        text = f"{text} -> {change.new.term}"
    line = f"{change.type.value:<8}{time}  {shown.topic}  {text}"
    return [printable(line), *(f"    {printable(reason)}" for reason in change.reasons)]


def _format_time(output: PlainOutput, start: int) -> str:
    return f"{(output.time - start) / SECOND:.3f} s"


def _change_to_json(bag: str, change: OutputChange) -> Dict[str, object]:
    return {
        "change": change.type.value,
        "bag": bag,
        "old": None if change.old is None else change.old._asdict(),
        "new": None if change.new is None else change.new._asdict(),
        "because": list(change.reasons),
    }


def _print_summary(results: Sequence[_BagResult]) -> None:
    comparisons = [result.comparison for result in results if result.comparison is not None]
    counts = Counter(change.type for comparison in comparisons for change in comparison.changes)
    extents = Counter(comparison.extent for comparison in comparisons)
    parts = []
    # Without a bag that was read, the number of equal outputs is not known.
    if extents[Extent.PART] or extents[Extent.WHOLE] or not comparisons:
        equal_count = sum(comparison.equal_count for comparison in comparisons)
        parts.append(f"{format_count(equal_count, 'equal output')}")
    parts += [
        f"{counts[change_type]} {change_type.value}" for change_type in ChangeType if counts[change_type]
    ]
    failed_count = len(results) - len(comparisons)
    if failed_count:
        parts.append(f"{format_count(failed_count, 'bag')} failed")
    incomplete_count = sum(1 for result in results if result.incomplete_files)
    if incomplete_count:
        parts.append(f"{format_count(incomplete_count, 'bag')} incomplete")
    parts += [f"{extents[extent]} {text}" for extent, text in _EXTENT_TEXTS.items() if extents[extent]]
    print(f"{format_count(len(results), 'bag')}: {', '.join(parts)}")


_EXTENT_TEXTS = {
    Extent.EQUAL: "not read (the programs are equal)",
    Extent.UNREACHED: "not read (no event for the rules that differ)",
    Extent.PART: "run in part (the other rules cannot differ)",
}
"""Texts about bags over which the programs were not run, or not whole."""


def _write_junit_report(path: Path, results: Sequence[_BagResult]) -> None:
    """Write the results as JUnit XML.

    Raises:
        UsageError: if the file cannot be written.
    """
    failure_count = sum(1 for result in results if not _is_equal(result))
    suite = ElementTree.Element(
        "testsuite", name="retalis diff", tests=str(len(results)), failures=str(failure_count), errors="0"
    )
    for result in results:
        case = ElementTree.SubElement(suite, "testcase", classname="retalis.diff", name=printable(result.bag))
        if not _is_equal(result):
            lines = _list_failure_lines(result)
            message = printable(lines[0].splitlines()[0])
            failure = ElementTree.SubElement(case, "failure", message=message, type="change")
            failure.text = printable("\n".join(lines))
        if result.incomplete_files:
            text = "\n".join(f"warning: {file}" for file in result.incomplete_files)
            ElementTree.SubElement(case, "system-out").text = printable(text)
    write_xml(path, suite)


def _list_failure_lines(result: _BagResult) -> List[str]:
    comparison = result.comparison
    if comparison is None:
        return [printable(result.error)]
    lines = list(comparison.problems)
    for change in comparison.changes:
        lines += format_change(change, comparison.start)
    return lines
