"""Command ``format``: lays out rule files and goal files uniformly."""

import argparse
import difflib
import sys
from pathlib import Path
from typing import Callable, Iterator, List, NamedTuple, Sequence

from ..editing.formatter import DEFAULT_LINE_LENGTH, format_goals, format_rules
from ..events.program.topic_configuration import GOALS, RULES
from ..foundation.displayed_text import describe_decode_error, format_count, printable
from ..foundation.errors import ProgramErrors, RetalisError, UsageError
from ..foundation.output_files import replace_file
from .option_values import positive_integer
from .stderr_reports import paint

STANDARD_INPUT = Path("-")
PROGRAM_FILES = (RULES, GOALS)
"""Names of the files that are formatted in a folder."""
PROGRAM_SUFFIXES = (".event", ".retalis")
"""Suffixes of the files that are formatted in a folder."""

DESCRIPTION = """\
Lay out rule files and goal files uniformly. Comments stay, and the program reads the files as before. A file with a
syntax error is not changed. The exit status is 0 for success, 1 if --check or --diff finds a file that would be
changed, 2 if a file cannot be formatted.
"""


def add_parser(add_command: Callable[..., argparse.ArgumentParser]) -> None:
    """Add the parser of command ``format``."""
    parser = add_command(
        "format", help="lay out rule files and goal files uniformly", description=DESCRIPTION
    )
    add = parser.add_argument
    add(
        "paths",
        nargs="*",
        type=Path,
        default=[Path()],
        metavar="PATH",
        help="rule files, goal files, or folders (the current one), whose files "
        f"{', '.join(PROGRAM_FILES)} and *{', *'.join(PROGRAM_SUFFIXES)} are formatted; - for standard input, whose "
        "result is printed",
    )
    add("--check", action="store_true", help="change no file, but list the files that would be changed")
    add("--diff", action="store_true", help="change no file, but print the differences")
    add(
        "--line-length",
        type=positive_integer,
        default=DEFAULT_LINE_LENGTH,
        metavar="N",
        help=f"maximum length of a line, without the comment at its end ({DEFAULT_LINE_LENGTH})",
    )
    add(
        "--goals",
        action="store_true",
        help=f"format goal files; without this option, only files called {GOALS} are goal files",
    )
    add = parser.add_argument_group("standard input").add_argument
    add(
        "--stdin-filename",
        type=Path,
        default=Path("standard input"),
        metavar="FILE",
        help="the name of standard input, for errors and for the kind of file",
    )
    parser.set_defaults(run=run)


class _FormatResult(NamedTuple):
    """The text of a file and its text in the uniform layout."""

    name: str
    text: str
    formatted: str


def run(options: argparse.Namespace) -> int:
    """Run the command; return its exit status."""
    changed = failed = unchanged = 0
    for path in _find_files(options.paths):
        try:
            result = _format_file(path, options)
        except RetalisError as error:
            _report(error)
            failed += 1
            continue
        if path == STANDARD_INPUT and not (options.check or options.diff):
            sys.stdout.write(result.formatted)
        elif result.formatted == result.text:
            unchanged += 1
        else:
            changed += 1
            _apply(path, result, options)
    if options.paths != [STANDARD_INPUT]:
        _print_summary(changed, unchanged, failed, options.check or options.diff)
    if failed:
        return 2
    return 1 if changed and (options.check or options.diff) else 0


def _find_files(paths: Sequence[Path]) -> Iterator[Path]:
    """Yield the files that are formatted, each once.

    Raises:
        UsageError: if a file or folder does not exist, or if a folder has no such files.
    """
    seen = set()
    for path in paths:
        for file in _find_in_folder(path) if path != STANDARD_INPUT and path.is_dir() else [path]:
            if file != STANDARD_INPUT and not file.exists():
                raise UsageError(f"format: there is no file {printable(str(file))}")
            if file not in seen:
                seen.add(file)
                yield file


def _find_in_folder(folder: Path) -> List[Path]:
    """Return the files of programs in a folder and its subfolders, except hidden ones."""
    files = [
        path
        for path in sorted(folder.rglob("*"))
        if (path.name in PROGRAM_FILES or path.suffix in PROGRAM_SUFFIXES)
        and path.is_file()
        and not any(part.startswith(".") for part in path.relative_to(folder).parts)
    ]
    if not files:
        names = f"{', '.join(PROGRAM_FILES)} or *{' or *'.join(PROGRAM_SUFFIXES)}"
        raise UsageError(f"format: {printable(str(folder))} contains no file to format: expected {names}")
    return files


def _format_file(path: Path, options: argparse.Namespace) -> _FormatResult:
    """Return the text of a file and its formatted text.

    Raises:
        ProgramErrors: all syntax errors.
        UsageError: if the file cannot be read.
    """
    source = options.stdin_filename if path == STANDARD_INPUT else path
    try:
        if path == STANDARD_INPUT:
            content = sys.stdin.buffer.read()
        else:
            content = path.read_bytes()
        # Line ends are kept, so the text is not read with universal newlines.
        text = content.decode("utf-8")
    except OSError as error:
        raise UsageError(f"cannot read {printable(str(source))}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"cannot read {printable(str(source))}: {describe_decode_error(error)}") from error
    format_text = format_goals if options.goals or source.name == GOALS else format_rules
    return _FormatResult(str(source), text, format_text(text, str(source), options.line_length))


def _apply(path: Path, result: _FormatResult, options: argparse.Namespace) -> None:
    """Write, list or print the change of a file."""
    if options.diff:
        for line in difflib.unified_diff(
            result.text.splitlines(keepends=True),
            result.formatted.splitlines(keepends=True),
            result.name,
            result.name,
        ):
            mark = "" if line.endswith("\n") else "\n\\ No newline at end of file\n"
            sys.stdout.write(printable(line) + mark)
    if options.check:
        print(f"would reformat {printable(result.name)}", file=sys.stderr)
    if not (options.check or options.diff):
        with replace_file(path) as new_path:
            new_path.write_bytes(result.formatted.encode("utf-8"))
        print(f"reformatted {printable(result.name)}", file=sys.stderr)


def _report(error: RetalisError) -> None:
    for single_error in error.errors if isinstance(error, ProgramErrors) else [error]:
        print(f"{paint('error', 'error', sys.stderr)}: {single_error}", file=sys.stderr)


def _print_summary(changed: int, unchanged: int, failed: int, is_check: bool) -> None:
    verb = "would be reformatted" if is_check else "reformatted"
    counts = [
        f"{format_count(changed, 'file')} {verb}" if changed else "",
        f"{format_count(unchanged, 'file')} left unchanged" if unchanged else "",
        f"{format_count(failed, 'file')} with errors" if failed else "",
    ]
    print(", ".join(filter(None, counts)), file=sys.stderr)
