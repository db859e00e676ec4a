"""Formatter of rule files and goal files.

`format_rules` and `format_goals` return the text of a file in a uniform layout: see `clause_layout` for the layout of
a clause. Between clauses, comments and single blank lines are kept. Comments at the end of adjacent lines, and the
arguments of adjacent facts of one line each, stay aligned if they are aligned.

The result is read again and compared with the original, token by token and comment by comment, so that the meaning of
a text never changes. Formatting a formatted text returns the same text.
"""

from os.path import commonprefix
from typing import Callable, Iterator, List, NamedTuple, Optional, Sequence, Tuple

from ..events.program.goal_file import GoalLines, ReadResult
from ..foundation.errors import Errors, ProgramErrors, RetalisError, SyntaxFault
from ..prolog.syntax.tokenizer import END, comment_spans
from ..prolog.terms.term_traversal import variant_key
from ..prolog.terms.types import atom, deref
from .clause_layout import ClauseLayout, LayoutLine, clean_comment
from .clause_reader import ClauseReader, ParsedClause, read_goal_clauses

DEFAULT_LINE_LENGTH = 120
"""Default of the maximum line length, without the comment at the end of a line."""

_COMMENT_GAP = 2
"""Spaces before a comment at the end of a line."""
_END_OF_FILE = atom("end_of_file")


def format_rules(text: str, source: str, line_length: int = DEFAULT_LINE_LENGTH) -> str:
    """Return the text of a rule file in a uniform layout.

    Args:
        text: the text.
        source: name of the file in errors.
        line_length: maximum length of lines, without the comment at the end.

    Raises:
        ProgramErrors: all syntax errors.
        RetalisError: if the result would not be read as the text is read, which is an error of this package.
    """
    return _format(text, source, line_length, _layout_rules, _read_rules)


def format_goals(text: str, source: str, line_length: int = DEFAULT_LINE_LENGTH) -> str:
    """Return the text of a goal file in a uniform layout; see `format_rules`.

    A goal without a full stop stays on its line.
    """
    return _format(text, source, line_length, _layout_goals, _read_goals)


class _FactRow(NamedTuple):
    """A clause of one line, which may be a row of a table.

    Attributes:
        shape: its first token, and the depth of brackets at each comma.
        columns: columns of the tokens after commas in the source, relative to the clause.
        targets: columns of these tokens in the layout.
        has_padding: for each of these tokens, whether more than one space was before it.
    """

    shape: Tuple[object, ...]
    columns: Tuple[int, ...]
    targets: Tuple[int, ...]
    has_padding: Tuple[bool, ...]


class _OutputLine:
    """A line of the result.

    Attributes:
        line: its parts.
        comment_column: column of the comment at its end in the source.
        row: the clause if this is its only line.
        is_verbatim: whether spaces at its end remain.
    """

    def __init__(
        self,
        line: LayoutLine,
        comment_column: int = -1,
        is_verbatim: bool = False,
    ):
        self.line = line
        self.comment_column = comment_column
        self.row: Optional[_FactRow] = None
        self.is_verbatim = is_verbatim


def _format(
    text: str,
    source: str,
    line_length: int,
    layout: Callable[[str, str, int], List[_OutputLine]],
    read: "Callable[[str, str], _Reading]",
) -> str:
    """Return a text in the layout of a function, after it was read again by another one."""
    # Line ends are those of the file if they are uniform.
    has_crlf = "\r\n" in text and text.count("\r\n") == text.count("\n")
    if has_crlf:
        text = text.replace("\r\n", "\n")
    expected = read(text, source)
    lines = layout(text, source, line_length)
    _align_rows(lines, line_length)
    _align_comments(lines)
    result = "".join(f"{line}\n" for line in _final_lines(lines))
    if text.startswith("\ufeff"):
        result = f"\ufeff{result}"
    if read(result, source) != expected:
        raise RetalisError(
            f"{source}: the formatted text is read differently, which is an error of retalis: the file is not changed"
        )
    return result.replace("\n", "\r\n") if has_crlf else result


def _final_lines(lines: Sequence[_OutputLine]) -> Iterator[str]:
    for index, output in enumerate(lines):
        if output.line.has_blank_line and index:
            yield ""
        text = f"{output.line.code}{output.line.comment}"
        yield text if output.is_verbatim else text.rstrip()


# Rule files


def _layout_rules(text: str, source: str, line_length: int) -> List[_OutputLine]:
    writer = _LineWriter(text)
    for clause in _clauses(text, source):
        writer.add_gap(clause.tokens[0][2])
        writer.add_clause(clause, ClauseLayout(clause, line_length))
        if deref(clause.term) is _END_OF_FILE:
            # The reader ignores the rest.
            writer.add_verbatim(clause.tokens[-1][3])
            return writer.lines
    writer.add_gap(len(text))
    return writer.lines


def _clauses(text: str, source: str) -> Iterator[ParsedClause]:
    """Yield the clauses of a rule file up to its end.

    Raises:
        ProgramErrors: all syntax errors.
    """
    errors = Errors()
    for clause in ClauseReader(text, source):
        if isinstance(clause, SyntaxFault):
            errors.append(clause)
            continue
        assert isinstance(clause, ParsedClause)
        if not errors:
            yield clause
        if deref(clause.term) is _END_OF_FILE:
            break
    if errors:
        raise ProgramErrors(errors)


class _Reading:
    """Content that is read from a text, for the comparison with that of another text.

    The comments are a list of their own, because those before a comma or full stop are moved behind it.
    """

    def __init__(self) -> None:
        self._clauses: List[object] = []
        self._comments: List[str] = []

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Reading) and vars(self) == vars(other)

    def add_clause(self, clause: ParsedClause, start: int) -> None:
        """Add a clause, and the comments in it and before it from a start on."""
        text = clause.source.text
        for _, _, token_start, token_end in clause.tokens:
            self.add_comments(text, start, token_start)
            start = token_end
        self._clauses.append([text[first:last] for _, _, first, last in clause.tokens])
        self._clauses.append(list(clause.names))
        self._clauses.append(variant_key(clause.term))

    def add_comments(self, text: str, start: int, end: int) -> None:
        """Add the comments in a part of a text without tokens."""
        self._comments += [clean_comment(text[first:last]) for first, last in comment_spans(text, start, end)]

    def add_text(self, text: str) -> None:
        """Add a text that is not read; an empty one makes no difference."""
        if text.strip():
            self._comments.append(text.strip())


def _read_rules(text: str, source: str) -> _Reading:
    reading = _Reading()
    end = 0 if not text.startswith("#!") else len(text.split("\n", 1)[0])
    for clause in _clauses(text, source):
        reading.add_clause(clause, end)
        end = clause.tokens[-1][3]
        if deref(clause.term) is _END_OF_FILE:
            reading.add_text(text[end:])
            return reading
    reading.add_comments(text, end, len(text))
    return reading


class _LineWriter:
    """Writer of the lines of a file, with the comments between its clauses."""

    def __init__(self, text: str):
        self._text = text
        self._position = 0
        self._next_has_blank_line = False
        self.lines: List[_OutputLine] = []
        if text.startswith("#!"):
            self._position = len(text.split("\n", 1)[0])
            self.lines.append(_OutputLine(LayoutLine(text[: self._position])))

    def add_gap(self, end: int) -> None:
        """Add the comments between the last clause and the next one, or the end of the text."""
        for comment_start, comment_end in comment_spans(self._text, self._position, end):
            self._add_comment(comment_start, comment_end)
            self._position = comment_end
        self._next_has_blank_line = self._text.count("\n", self._position, end) > 1
        self._position = end

    def _add_comment(self, start: int, end: int) -> None:
        newlines = self._text.count("\n", self._position, start)
        comment = clean_comment(self._text[start:end])
        last = self.lines[-1] if self.lines else None
        if newlines == 0 and last is not None and not last.line.comment and self._position > 0:
            last.line = last.line._replace(comment=comment, comment_offset=start)
            last.comment_column = _column(self._text, start)
        else:
            self.lines.append(_OutputLine(LayoutLine(comment, has_blank_line=newlines > 1)))

    def add_clause(self, clause: ParsedClause, layout: ClauseLayout) -> None:
        """Add a clause after the comments before it."""
        lines = [
            _OutputLine(line, _column(clause.source.text, line.comment_offset)) for line in layout.lines()
        ]
        lines[0].line = lines[0].line._replace(has_blank_line=self._next_has_blank_line)
        if len(lines) == 1:
            lines[0].row = _row(clause, layout)
        self.lines += lines
        self._position = clause.tokens[-1][3]

    def add_verbatim(self, start: int) -> None:
        """Add the rest of the text as it is."""
        rest = self._text[start:].strip("\n").split("\n")
        self.lines += [_OutputLine(LayoutLine(line), is_verbatim=True) for line in rest]


def _column(text: str, offset: int) -> int:
    return -1 if offset < 0 else offset - text.rfind("\n", 0, offset) - 1


# Goal files


def _layout_goals(text: str, source: str, line_length: int) -> List[_OutputLine]:
    source_lines = text.split("\n")
    lines: List[_OutputLine] = []
    position = 0
    settings = ClauseReader("", source)
    for goal_lines in _goals(text, source, settings):
        lines += _lines_between(source_lines[position : goal_lines.start])
        position = goal_lines.end
        has_blank_line = goal_lines.start > 0 and not source_lines[goal_lines.start - 1].strip()
        goal = _layout_goal(goal_lines.goal, line_length, settings) or [
            _OutputLine(LayoutLine(line.rstrip())) for line in source_lines[goal_lines.start : position]
        ]
        goal[0].line = goal[0].line._replace(has_blank_line=has_blank_line)
        lines += goal
    return [*lines, *_lines_between(source_lines[position:])]


def _lines_between(source_lines: Sequence[str]) -> Iterator[_OutputLine]:
    """Yield the comments in lines without a goal."""
    for index, line in enumerate(source_lines):
        if line.strip():
            has_blank_line = index > 0 and not source_lines[index - 1].strip()
            yield _OutputLine(LayoutLine(line.strip(), has_blank_line=has_blank_line))


def _layout_goal(goal: ReadResult, line_length: int, settings: ClauseReader) -> List[_OutputLine]:
    """Return the lines of a goal; none if its first lines would be a goal of their own in the layout.

    Args:
        goal: the goal.
        line_length: maximum length of a line.
        settings: the operators and flags with which it was read.
    """
    assert isinstance(goal, ParsedClause)
    text, end = goal.source.text, goal.tokens[-1][3]
    layout = ClauseLayout(goal, line_length, can_break=goal.tokens[-1][0] == END)
    lines = [_OutputLine(line, _column(text, line.comment_offset)) for line in layout.lines()]
    last = lines[-1]
    comments = list(comment_spans(text, end, len(text)))
    if comments and not last.line.comment:
        comment = clean_comment(text[comments[0][0] :])
        last.line = last.line._replace(comment=comment, comment_offset=comments[0][0])
        last.comment_column = _column(text, comments[0][0])
    if len(lines) == 1:
        last.row = _row(goal, layout)
    result = "\n".join(f"{output.line.code} {output.line.comment}" for output in lines)
    try:
        readings = [_read_goals(layout_text, goal.source.name, settings) for layout_text in (result, text)]
        is_same = readings[0] == readings[1]
    except ProgramErrors:
        is_same = False
    return lines if is_same else []


def _goals(text: str, source: str, settings: Optional[ClauseReader] = None) -> Iterator[GoalLines]:
    """Yield the goals of a goal file; see `read_goal_clauses`.

    Raises:
        ProgramErrors: all syntax errors.
    """
    errors = Errors()
    for goal_lines in read_goal_clauses(text, source, settings):
        if isinstance(goal_lines.goal, SyntaxFault):
            errors.append(goal_lines.goal)
        elif not errors:
            yield goal_lines
    if errors:
        raise ProgramErrors(errors)


def _read_goals(text: str, source: str, settings: Optional[ClauseReader] = None) -> _Reading:
    source_lines = text.split("\n")
    reading = _Reading()
    position = 0
    for goal_lines in _goals(text, source, settings):
        goal = goal_lines.goal
        assert isinstance(goal, ParsedClause)
        for line in source_lines[position : goal_lines.start]:
            reading.add_text(line)
        reading.add_clause(goal, 0)
        reading.add_comments(goal.source.text, goal.tokens[-1][3], len(goal.source.text))
        position = goal_lines.end
    for line in source_lines[position:]:
        reading.add_text(line)
    return reading


# Alignment


def _row(clause: ParsedClause, layout: ClauseLayout) -> _FactRow:
    text, start = clause.source.text, clause.tokens[0][2]
    separated = layout.separated_pieces()
    is_one_line = "\n" not in text[start : clause.tokens[-1][3]]
    return _FactRow(
        (text[start : clause.tokens[0][3]], *(piece.frame.depth for piece in separated)),
        tuple(piece.offset - start if is_one_line else -1 for piece in separated),
        tuple(piece.column for piece in separated),
        tuple(text[piece.offset - 2 : piece.offset] == "  " for piece in separated),
    )


def _align_rows(lines: Sequence[_OutputLine], line_length: int) -> None:
    """Align the arguments of adjacent facts if they are aligned in the source."""
    start = 0
    while start < len(lines):
        row = lines[start].row
        end = start + 1
        while row is not None and end < len(lines) and _continues(lines[end], row):
            end += 1
        if end - start > 1:
            _align_table(lines[start:end], line_length)
        start = end


def _continues(output: _OutputLine, row: _FactRow) -> bool:
    return output.row is not None and output.row.shape == row.shape and not output.line.has_blank_line


def _align_table(lines: Sequence[_OutputLine], line_length: int) -> None:
    rows = [output.row for output in lines if output.row is not None]
    # Only the first columns may be aligned, as the others vary.
    count = len(commonprefix([row.columns for row in rows]))
    if not any(any(row.has_padding[:count]) for row in rows):
        return
    tables = [_cells(output.line.code, row.targets[:count]) for output, row in zip(lines, rows)]
    widths = [max(map(len, column)) + 1 for column in zip(*tables)][:-1]
    codes = ["".join(cell.ljust(width) for cell, width in zip(cells, widths)) + cells[-1] for cells in tables]
    if max(map(len, codes)) > line_length:
        return
    for output, code in zip(lines, codes):
        output.line = output.line._replace(code=code)


def _cells(code: str, columns: Sequence[int]) -> List[str]:
    starts = [0, *columns]
    ends = [*columns, len(code)]
    return [code[start:end].rstrip() for start, end in zip(starts, ends)]


def _align_comments(lines: Sequence[_OutputLine]) -> None:
    """Put spaces before the comments at ends of lines, which stay aligned with each other if they are."""
    start = 0
    while start < len(lines):
        column = lines[start].comment_column
        end = start + 1
        while column >= 0 and end < len(lines) and lines[end].comment_column == column:
            end += 1
        if column >= 0:
            # The length of the last line of a code with a quoted text over several lines.
            width = (
                max(len(output.line.code.rpartition("\n")[2]) for output in lines[start:end]) + _COMMENT_GAP
            )
            for output in lines[start:end]:
                gap = width - len(output.line.code.rpartition("\n")[2])
                output.line = output.line._replace(code=output.line.code + " " * gap)
        start = end
