"""Goal files (``goalPredicates.txt``): one goal per line, usually without a full stop.

Programs of the original system write one goal per line and omit most full stops. A line that reads as a term is a
goal. Otherwise the goal is assumed to continue to the next line that ends in a full stop.
"""

from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Any, Callable, Iterator, List, NamedTuple, Optional, Tuple, Union

from ...foundation.errors import ProgramErrors, RetalisError, RuleError, SyntaxFault
from ...foundation.source_places import Place
from ...prolog.files.source_files import SourceFiles
from ...prolog.syntax.operators import Operators
from ...prolog.syntax.term_reader import ReadTerm, read_term
from ...prolog.terms.types import Term, deref, functor
from ..language.event_operators import ARROWS

ReadResult = Union[ReadTerm, SyntaxFault]
RunWithPermissions = Callable[[Optional[Path], Callable[[], Any]], Any]
"""Takes a folder and a function; calls the function, which may read any file, with relative paths in the folder."""

_DIRECTIVES = (functor(":-", 1), functor("?-", 1))
_INCLUDE = functor("include", 1)


_MAX_REREAD_CHARACTERS = 100_000
"""Characters that may be read again, beyond a multiple of the file, in search of the end of goals over several lines.

Beyond them, each line with an error is reported by itself. Otherwise thousands of such lines, each read up to a full
stop far below, would take time that grows with the square of the file.
"""


class FileGoal(NamedTuple):
    """A goal with its position and the folder of its file."""

    term: Term
    place: Place
    folder: Optional[Path]


def goal_of(term: Term) -> Term:
    """Return the goal of a term in a goal file or stream; ``:- Goal`` means Goal."""
    term = deref(term)
    return deref(term[1]) if term.__class__ is tuple and term[0] in _DIRECTIVES else term


def read_file_goals(
    text: str,
    source: str,
    folder: Optional[Path],
    operators: Operators,
    files: SourceFiles,
    run_with_permissions: RunWithPermissions,
) -> Iterator[Union[FileGoal, RetalisError]]:
    """Yield the goals of a goal file; the goals of included files take the place of the ``include`` goal.

    ``:- Goal`` means Goal. A syntax error is yielded in place of the goal.
    """
    with nullcontext() if folder is None else files.loading_file(folder / Path(source).name):
        for entry in read_goals(text, operators, source):
            if isinstance(entry, SyntaxFault):
                yield entry
                continue
            term = goal_of(entry.term)
            if term.__class__ is tuple and term[0] in ARROWS:
                yield RuleError(
                    "this is a rule, not a goal: write it into a file that the goal compile_event_file(File) loads",
                    entry.place,
                )
                continue
            if term.__class__ is not tuple or term[0] is not _INCLUDE:
                yield FileGoal(term, entry.place, folder)
                continue
            try:
                # Included files are opened with the permissions of the program, when the goals before them have been
                # called.
                path, included_text = run_with_permissions(folder, partial(_find_text, files, term[1]))
                yield from read_file_goals(
                    included_text, str(path), path.parent, operators, files, run_with_permissions
                )
            except RetalisError as error:
                yield RuleError(error.message, entry.place)


def _find_text(files: SourceFiles, name: Term) -> Tuple[Path, str]:
    path = files.find(name)
    return path, files.text(path)


class GoalLines(NamedTuple):
    """A goal, or the error in its place, with the indexes of its first line and of the line after it."""

    goal: ReadResult
    start: int
    end: int


ReadLines = Callable[[str, int], ReadTerm]
"""Reads a text that is one term; takes the text and the number of its first line."""


def read_goals(text: str, operators: Operators, source: str) -> Iterator[ReadResult]:
    """Yield the goals of a goal file, or a `SyntaxFault` for each text that is not a goal."""

    def read_lines(part: str, first_line: int) -> ReadTerm:
        return read_term(part, operators, source, first_line=first_line)

    for goal_lines in read_goal_lines(text, read_lines):
        yield goal_lines.goal


def read_goal_lines(text: str, read_lines: ReadLines) -> Iterator[GoalLines]:
    """Yield the goals of a goal file with their lines.

    A line is a goal if it reads as a term, with or without a full stop. Otherwise the goal continues to a line that
    ends in a full stop.
    """
    lines = text.split("\n")
    position = stop_position = 0
    characters_left = 4 * len(text) + _MAX_REREAD_CHARACTERS
    while position < len(lines):
        if _is_blank(lines[position]):
            position += 1
            continue
        goal = _parse_lines(lines, position, position + 1, read_lines)
        end = position + 1
        if isinstance(goal, SyntaxFault) and characters_left > 0:
            stop_position = max(stop_position, end)
            while stop_position < len(lines) and not _ends_goal(lines[stop_position]):
                stop_position += 1
            if stop_position < len(lines):
                longer_goal = _parse_lines(lines, position, stop_position + 1, read_lines)
                # If the longer text also has an error, but beyond its first line, the lines belong together.
                if not isinstance(longer_goal, SyntaxFault) or _line_number(longer_goal) > position + 1:
                    goal, end = longer_goal, stop_position + 1
                else:
                    characters_left -= sum(map(len, lines[position : stop_position + 1]))
        if isinstance(goal, SyntaxFault) and end == position + 1:
            goal = _add_full_stop_advice(goal, lines, position)
        yield GoalLines(goal, position, end)
        position = end


def _add_full_stop_advice(fault: SyntaxFault, lines: List[str], position: int) -> SyntaxFault:
    """Return the error of a line, with advice about the full stop if the line ends in the middle of a term."""
    place = fault.place
    has_next_line = position + 1 < len(lines) and not _is_blank(lines[position + 1])
    if place is None or not has_next_line or not _is_blank(lines[position][place.column - 1 :]):
        return fault
    # The advice after the semicolon (a superfluous comma) would be misleading here.
    message = fault.message.partition("; ")[0]
    return SyntaxFault(f"{message}; a goal over several lines ends with a full stop", place)


def _is_blank(line: str) -> bool:
    code = line.strip()
    return not code or code.startswith("%")


def _ends_goal(line: str) -> bool:
    """Return whether a goal may end with this line."""
    return line.rstrip().endswith(".") or line.split("%")[0].rstrip().endswith(".")


def _line_number(fault: SyntaxFault) -> int:
    return 0 if fault.place is None else fault.place.line


def _parse_lines(lines: List[str], start: int, end: int, read_lines: ReadLines) -> ReadResult:
    try:
        return read_lines("\n".join(lines[start:end]), start + 1)
    except SyntaxFault as fault:
        return fault


def errors_of_goal(error: RetalisError, place: Place) -> List[RetalisError]:
    """Return the errors of a goal: those of the file that it loads, or its own."""
    if isinstance(error.__cause__, ProgramErrors):
        errors = error.__cause__.errors
    else:
        errors = [error]
    return [
        single_error if single_error.place else RuleError(single_error.message, place)
        for single_error in errors
    ]
