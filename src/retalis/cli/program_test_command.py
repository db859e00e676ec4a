"""Command ``test``: runs the test cases of programs."""

import argparse
import json
import os
import shlex
import sys
import time
from pathlib import Path
from typing import Callable, Dict, Iterable, Iterator, List, NamedTuple, Optional, Sequence, Set, Tuple

from ..foundation.displayed_text import format_count, printable
from ..foundation.errors import RetalisError, UsageError
from ..testing.case_definition import Case
from ..testing.case_file import SUFFIXES, list_case_files, make_json_schema, read_case_file
from ..testing.case_fuzzer import fuzz_cases
from ..testing.case_processes import run_cases
from ..testing.case_run import CaseResult
from ..testing.golden_file import write_golden_file
from ..testing.html_report import ReportedCase, write_html_report
from ..testing.junit_report import FileError, write_junit_report
from ..testing.live_run import check_live_case
from ..testing.rule_coverage import (
    CoveredPart,
    covered_percentage,
    format_coverage,
    merge_parts,
    write_cobertura_report,
)
from .command_options import add_message_folders, message_folders
from .option_values import any_integer, percentage, positive_integer, positive_seconds
from .optional_ros_imports import installed_definitions
from .stderr_reports import paint

DESCRIPTION = """\
Run the test cases of programs, without ROS, or on a running node with --node. A test file is tests/*.yaml or
*_test.yaml below a folder, or any file that is named.

The exit status is 0 if all cases have passed, 1 if one has failed, and 2 for wrong usage: no case, or a wrong test
file.
"""

DEFAULT_LIVE_SECONDS = 60.0
"""Longest time in seconds for a case without end on a node."""

_WATCH_SECONDS = 0.5
"""Seconds between two checks whether a file has changed."""

_FAILED, _MISUSED = 1, 2
"""Exit statuses."""

NamePredicate = Callable[[str], bool]
"""Returns whether the name of a case is selected."""


def add_parser(add_command: Callable[..., argparse.ArgumentParser]) -> None:
    """Add the parser of command ``test``."""
    parser = add_command(
        "test",
        help="run the test cases of programs",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add(
        "paths",
        nargs="*",
        type=Path,
        default=[Path()],
        metavar="PATH",
        help="a test file, the line of a case (FILE:LINE), or a folder with test files (the current one)",
    )
    add("-k", metavar="EXPR", help="only the cases whose file or name contains a text; with and, or, not")
    add("-x", "--exitfirst", action="store_true", help="stop after the first case that fails")
    add("-j", "--jobs", type=positive_integer, metavar="N", help="run N cases at a time (one for each core)")
    add("-v", "--verbose", action="store_true", help="print each case, and the warnings of programs")
    add("--update", action="store_true", help="print the differences to golden files, and write these anew")
    add(
        "--watch",
        action="store_true",
        help="run again when a file of the cases or their programs has changed",
    )
    add = parser.add_argument_group("random changes of the input").add_argument
    add(
        "--fuzz",
        type=positive_integer,
        metavar="N",
        help="run each case N more times with lost, late, repeated or reordered input and other stamps, and print "
        "what breaks an expectation",
    )
    add("--seed", type=any_integer, default=0, metavar="N", help="seed of the random changes (0)")
    add = parser.add_argument_group("running node").add_argument
    add(
        "--node",
        metavar="/NAME",
        help="run the cases on this node, in place of their programs",
    )
    add(
        "--for",
        dest="seconds",
        type=positive_seconds,
        default=DEFAULT_LIVE_SECONDS,
        metavar="SECONDS",
        help=f"longest time for a case without 'until' on a node ({DEFAULT_LIVE_SECONDS:g})",
    )
    add = parser.add_argument_group("reports and message types").add_argument
    add("--schema", action="store_true", help="print the JSON Schema of test files, for editors")
    add("--junit", type=Path, metavar="FILE", help="write the results as JUnit XML")
    add(
        "--coverage",
        action="store_true",
        help="print the parts of programs that no case uses",
    )
    add(
        "--html",
        type=Path,
        metavar="FILE",
        help="write results and, with --coverage, coverage as HTML page",
    )
    add("--threshold", type=percentage, metavar="N", help="fail if less than N percent of them are used")
    add("--cobertura", type=Path, metavar="FILE", help="write the coverage of the rules as Cobertura XML")
    add_message_folders(add)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command; return its exit status."""
    if options.schema:
        print(json.dumps(make_json_schema(), indent=2))
        return 0
    if options.node is not None:
        _check_node_options(options)
    if not options.watch:
        return _TestRun(options).run()
    while True:
        test_run = _TestRun(options)
        # Noted before the run: a change during the run starts the next one.
        state = _watched_files(test_run.folders)
        try:
            test_run.run()
        except RetalisError as error:
            print(error)
        print("waiting for changes; ctrl-C ends", flush=True)
        while _watched_files(test_run.folders) == state:
            time.sleep(_WATCH_SECONDS)


def _check_node_options(options: argparse.Namespace) -> None:
    """Reject options that concern the program of a case.

    Raises:
        UsageError: if there is one.
    """
    given = {
        "--fuzz": options.fuzz is not None,
        "--update": options.update,
        "--watch": options.watch,
        "--coverage": options.coverage,
        "--threshold": options.threshold is not None,
        "--cobertura": options.cobertura is not None,
    }
    names = [name for name, is_given in given.items() if is_given]
    if names:
        error = UsageError(f"--node: a running node has no {' or '.join(names)}")
        error.exit_status = _MISUSED
        raise error


class _CollectedCases(NamedTuple):
    """The selected cases of all files, the files that cannot be read, and those that are not test files."""

    cases: List[Case]
    file_errors: List[FileError]
    skipped_files: List[Path]


class _TestRun:
    """A run of the cases that the options select.

    Attributes:
        folders: folders of the test files and of their programs.
    """

    def __init__(self, options: argparse.Namespace):
        self._options = options
        self._collected = _collect_cases(options)
        paths = [_split_line(path)[0] for path in options.paths]
        self.folders = {path if path.is_dir() else path.absolute().parent.parent for path in paths}
        programs = {case.program.folder for case in self._collected.cases}
        self.folders.update(folder for folder in programs if folder is not None)
        self._printed_warnings: Set[Tuple[Optional[Path], str]] = set()
        self._started = time.monotonic()
        self._results: Dict[int, CaseResult] = {}
        self._is_terminal = sys.stdout.isatty()
        self._definitions = installed_definitions(message_folders(options))
        self._jobs: int = options.jobs or os.cpu_count() or 1

    def run(self) -> int:
        """Run the cases, print the results and write the reports; return the exit status."""
        collected = self._collected
        cases = collected.cases
        for path in collected.skipped_files:
            print(f"skipped {printable(str(path))}: it has no key 'cases'")
        for _, error in collected.file_errors:
            print(f"{paint('error', 'error', sys.stdout)}: {error}")
        if not cases and not collected.file_errors:
            raise _no_cases(self._options)
        # On a node, which remembers what a case has done, an error of a file is found before the first case runs.
        if self._options.node is None or not collected.file_errors:
            self._run_cases(cases)
        for number in sorted(self._results):
            self._print_result(cases[number], self._results[number])
        results = [(cases[number], self._results[number]) for number in sorted(self._results)]
        if self._options.update:
            _update_golden_files(results)
        parts = merge_parts(result.coverage for _, result in results)
        self._write_reports(results, parts)
        if self._options.fuzz is not None:
            self._fuzz([case for case, result in results if not result.failures])
        failed = sum(1 for _, result in results if result.failures)
        self._print_summary(len(results) - failed, failed, len(cases) - len(results), collected.file_errors)
        is_covered = self._report_coverage(parts)
        if collected.file_errors:
            return _MISUSED
        return 0 if is_covered and not failed else _FAILED

    def _write_reports(
        self, results: Sequence[Tuple[Case, CaseResult]], parts: Sequence[CoveredPart]
    ) -> None:
        """Write the results as JUnit XML and HTML if the options request it."""
        options, file_errors = self._options, self._collected.file_errors
        if options.junit is not None:
            write_junit_report(options.junit, results, file_errors)
        if options.html is not None:
            cases = list(_report_cases(results, file_errors))
            write_html_report(options.html, "Test results", cases, parts if options.coverage else ())

    def _report_coverage(self, parts: Sequence[CoveredPart]) -> bool:
        """Print and write the coverage if the options request it; return whether it reaches the threshold."""
        options = self._options
        if options.coverage:
            # Without a case, no program was loaded.
            for line in format_coverage(parts) if self._results else ("coverage: no case has run",):
                print(line)
        if options.cobertura is not None:
            write_cobertura_report(options.cobertura, parts)
        reached = covered_percentage(parts)
        if options.threshold is None or reached >= options.threshold:
            return True
        print(f"coverage {reached:.0f} % is below the threshold of {options.threshold:g} %")
        return False

    def _fuzz(self, cases: Sequence[Case]) -> None:
        """Print the report about random changes of the input of cases."""
        options = self._options
        for report in fuzz_cases(cases, self._definitions, self._jobs, options.fuzz, options.seed):
            for line in report.format_lines():
                print(line, flush=True)

    def _run_cases(self, cases: Sequence[Case]) -> None:
        for number, result in self._start_cases(cases):
            self._results[number] = result
            self._show_progress(len(cases))
            if result.failures and self._options.exitfirst:
                break
        if self._is_terminal:
            print("\r\033[K", end="", flush=True)

    def _start_cases(self, cases: Sequence[Case]) -> Iterable[Tuple[int, CaseResult]]:
        if self._options.node is None:
            return run_cases(cases, self._definitions, self._jobs, self._records_coverage())
        # Imported here, because the command works without the modules of clients.
        from .live_cases import run_live_cases  # noqa: PLC0415

        return run_live_cases(cases, self._options)

    def _records_coverage(self) -> bool:
        options = self._options
        return bool(options.coverage or options.cobertura or options.threshold is not None)

    def _show_progress(self, count: int) -> None:
        if self._is_terminal:
            failed = sum(1 for result in self._results.values() if result.failures)
            text = f"{len(self._results)} of {count} cases, {failed} failed"
            print(f"\r\033[K{text}", end="", flush=True)

    def _print_result(self, case: Case, result: CaseResult) -> None:
        name = printable(f"{case.path}:{case.place.line}: {case.name}")
        if result.failures:
            print(f"{paint('FAILED', 'error', sys.stdout)} {name}")
            for failure in result.failures:
                print("\n".join(f"  {line}" for line in failure.splitlines()))
            print(f"  alone: {_format_command(case, self._options)}")
        elif self._options.verbose:
            print(f"passed {name}")
        for warning in result.warnings if self._options.verbose else result.incomplete_files:
            # The cases of a program have the same warnings.
            key = (case.program.folder, warning)
            if key not in self._printed_warnings:
                self._printed_warnings.add(key)
                print(f"  {paint('warning', 'warning', sys.stdout)}: {warning}")

    def _print_summary(
        self, passed: int, failed: int, skipped: int, file_errors: Sequence[FileError]
    ) -> None:
        parts = [f"{passed} passed"]
        if failed:
            parts.append(paint(f"{failed} failed", "error", sys.stdout))
        if skipped:
            parts.append(f"{skipped} not run")
        if file_errors:
            parts.append(paint(format_count(len(file_errors), "file error"), "error", sys.stdout))
        # Without the time, the output of a log is the same for each run.
        duration = f" in {time.monotonic() - self._started:.2f} s" if self._is_terminal else ""
        print(f"{', '.join(parts)}{duration}", flush=True)


def _collect_cases(options: argparse.Namespace) -> _CollectedCases:
    is_selected = parse_selection(options.k) if options.k else lambda name: True
    cases: List[Case] = []
    file_errors: List[FileError] = []
    paths = [_split_line(path) for path in options.paths]
    lines: Dict[Path, Set[int]] = {}
    for path, line in paths:
        if line is not None:
            lines.setdefault(path, set()).add(line)
    files, skipped_files = list_case_files([path for path, _ in paths])
    for path in files:
        try:
            selected = [
                case
                for case in read_case_file(path, options.node is None)
                if is_selected(f"{path}: {case.name}")
                and (path not in lines or case.place.line in lines[path])
            ]
            if options.node is not None:
                for case in selected:
                    check_live_case(case)
            cases += selected
        except RetalisError as error:
            file_errors.append((path, error))
    return _CollectedCases(cases, file_errors, skipped_files)


def _report_cases(
    results: Sequence[Tuple[Case, CaseResult]], file_errors: Sequence[FileError]
) -> Iterator[ReportedCase]:
    """Yield the cases, and the files with errors, for the HTML page."""
    for case, result in results:
        yield ReportedCase(f"{case.path}:{case.place.line}", case.name, result.seconds, result.failures)
    for path, error in file_errors:
        yield ReportedCase(str(path), "", 0.0, (str(error),))


def _split_line(path: Path) -> Tuple[Path, Optional[int]]:
    """Return the path and the line of ``FILE:LINE``; line None for other paths."""
    name, _, line = str(path).rpartition(":")
    return (Path(name), int(line)) if name and line.isdecimal() and not path.exists() else (path, None)


def _no_cases(options: argparse.Namespace) -> UsageError:
    error = UsageError(
        f"no case matches -k '{options.k}'"
        if options.k
        else f"no test cases in {', '.join(map(str, options.paths))}: expected tests/*.yaml or *_test.yaml"
    )
    error.exit_status = _MISUSED
    return error


def _format_command(case: Case, options: argparse.Namespace) -> str:
    """Return the command that runs a case alone: its line is that of the case, since names may be ambiguous."""
    folders = "".join(f" --msg {shlex.quote(str(folder))}" for folder in options.msg)
    node = "" if options.node is None else f" --node {shlex.quote(options.node)} --for {options.seconds:g}"
    return printable(f"retalis test {shlex.quote(f'{case.path}:{case.place.line}')}{folders}{node}")


def _update_golden_files(results: Sequence[Tuple[Case, CaseResult]]) -> None:
    for case, result in results:
        golden = case.expectations.golden
        if golden is not None and result.golden_lines is not None and result.only_golden_differs:
            lines = [f"{line}\n" for line in result.golden_lines]
            if not golden.exists() or golden.read_text(encoding="utf-8") != "".join(lines):
                write_golden_file(golden, result.golden_lines)
                print(f"updated {golden}")


def _watched_files(folders: Iterable[Path]) -> Dict[Path, float]:
    """Return the times of change of all files in folders that cases and their programs may consist of."""
    times: Dict[Path, float] = {}
    for folder in folders:
        for file in folder.rglob("*"):
            if file.suffix in (*SUFFIXES, ".txt", ".xml", ".jsonl", ".pl"):
                try:
                    times[file] = file.stat().st_mtime
                except OSError:
                    # Removed meanwhile.
                    continue
    return times


def parse_selection(expression: str) -> NamePredicate:
    """Return the selection of the expression of option ``-k``.

    A name is selected if it contains a text, in any case of letters. Texts are combined with ``not``, ``and`` and
    ``or``, which bind in this order, as in Python.

    >>> is_selected = parse_selection("fever and not slow")
    >>> is_selected("Fever after an hour"), is_selected("slow fever")
    (True, False)

    Raises:
        UsageError: if a text is missing.
    """
    alternatives = [_parse_conjunction(part, expression) for part in _split(expression, "or")]
    return lambda name: any(is_selected(name.lower()) for is_selected in alternatives)


def _parse_conjunction(text: str, expression: str) -> NamePredicate:
    parts = [_parse_negation(part, expression) for part in _split(text, "and")]
    return lambda name: all(is_selected(name) for is_selected in parts)


def _parse_negation(text: str, expression: str) -> NamePredicate:
    words = text.split()
    is_negated = False
    while words and words[0] == "not":
        is_negated = not is_negated
        words = words[1:]
    if not words:
        raise UsageError(
            f"-k '{expression}': expected a text after 'not', 'and' and 'or', and before 'and' and 'or'"
        )
    searched = " ".join(words).lower()
    return lambda name: (searched in name) != is_negated


def _split(text: str, word: str) -> List[str]:
    parts = [""]
    for part in text.split():
        if part == word:
            parts.append("")
        else:
            parts[-1] = f"{parts[-1]} {part}"
    return parts
