"""Layout of a clause: the line breaks, indentation and spaces between its tokens.

A clause is a list of pieces: its tokens and comments. The layout keeps the line breaks of the author where it allows
one: after a comma or opening bracket, after ``:-``, and before an operator. In other places, breaks are moved to the
nearest of these or removed. Breaks are added only in lines that are too long, at the outermost brackets and the
operator that binds most loosely first. As indentation and spaces follow from tokens and breaks alone, and breaks are
added until none is needed, the layout of a text that has been laid out is the same text.

A piece belongs to the frame of the innermost bracket around it. The contents of a bracket are indented by four
columns if a line ends after the bracket, and otherwise aligned with the column after it. Alternatives in round
brackets that do not fit into a line are written as in SWI-Prolog's library: ``(``, ``->`` and ``;`` in one column.
"""

from enum import Enum
from typing import Iterator, List, NamedTuple, Optional, Sequence, Tuple

from ..prolog.syntax.operators import EVENT_SYNTAX, Operator
from ..prolog.syntax.tokenizer import END, NAME, OPEN_CT, QUOTED, AnyToken, comment_spans
from .clause_reader import ParsedClause

INDENT = 4
"""Columns by which the contents of a bracket and the body of a clause are indented."""
_ARROW_COLUMN = 2
"""Column of the arrow of a rule at the start of a line."""
_MAX_PASSES = 50
"""Passes that add line breaks, one level of brackets at a time; deeper lines stay too long."""
_MAX_HANGING_PART = 0.6
"""Part of the line length after which contents of a bracket are not aligned with it."""

_OPENING = frozenset(("(", OPEN_CT, "[", "{"))
_CLOSING = frozenset((")", "]", "}"))
_NECKS = frozenset((":-", "-->", "=>"))
_CHOICES = frozenset((";", "->", "*->"))
_SEPARATOR_PRIORITY = 1002
_PATTERN_PRIORITY = 1001
"""Priority that stands for those of all operators of patterns: these are not indented below each other."""
_LOOSE_PRIORITY = 700
"""Priority from which operators have spaces around them; below, the author decides."""
_SUPPRESSION = "retalis: ignore="
"""Part of a comment that suppresses findings in its line, which is therefore not broken."""


class PieceRole(Enum):
    """Role of a piece in a clause."""

    OPERAND = "operand"
    OPENER = "opening bracket"
    CLOSER = "closing bracket"
    SEPARATOR = "comma"
    NECK = "operator with a line break after it"
    INFIX = "operator with a line break before it"
    PREFIX = "prefix operator"
    POSTFIX = "postfix operator"
    COLON = "colon after the name of a slot"
    STOP = "full stop"
    COMMENT = "comment"


class BracketFrame:
    """A bracket, or the clause itself, with the columns of its contents.

    Attributes:
        opener: the opening bracket; None for the clause.
        position: index of that bracket among the pieces.
        depth: number of brackets around the contents.
        is_group: whether it is a round bracket that is not part of a compound term.
        is_message: whether it holds named slots.
        loosest: highest priority of the operators and separators directly in it.
        has_choices: whether ``;`` or ``->`` are directly in it.
        is_choice: whether these are laid out in a column.
        has_breaks: whether lines begin directly in it.
        column: column of the opening bracket.
        content_column: column of its contents at the start of a line.
        closer_column: column of the closing bracket at the start of a line.
    """

    def __init__(
        self, opener: "Optional[LayoutPiece]", depth: int, is_group: bool = False, is_message: bool = False
    ):
        self.opener = opener
        self.position = -1
        self.depth = depth
        self.is_group = is_group
        self.is_message = is_message
        self.loosest = 0
        self.has_choices = False
        self.is_choice = False
        self.has_breaks = False
        self.column = 0
        self.content_column = 0
        self.closer_column = 0


class LayoutPiece:
    """A token or a comment.

    Attributes:
        name: the name that it is, or "".
        offset: its offset in the source.
        frame: the frame that it is in; for brackets, the frame around them.
        inner: the frame that a bracket opens or closes.
        priority: priority of an operator.
        is_adjacent: whether nothing is between it and the piece before it.
        is_tight: whether nothing is on either side of an operator.
        breaks: whether it begins a line.
        has_blank_line: whether a blank line is before it.
    """

    __slots__ = (
        "text",
        "name",
        "offset",
        "role",
        "frame",
        "inner",
        "priority",
        "is_adjacent",
        "is_tight",
        "breaks",
        "has_blank_line",
        "column",
    )

    def __init__(
        self, text: str, offset: int, role: PieceRole, frame: BracketFrame, name: str = "", priority: int = 0
    ):
        self.text = text
        self.name = name
        self.offset = offset
        self.role = role
        self.frame = frame
        self.inner: Optional[BracketFrame] = None
        self.priority = priority
        self.is_adjacent = False
        self.is_tight = False
        self.breaks = False
        self.has_blank_line = False
        self.column = 0

    @property
    def is_comment(self) -> bool:
        """True if it is a comment."""
        return self.role is PieceRole.COMMENT

    @property
    def ends_line(self) -> bool:
        """True if it is a comment that extends to the end of the line."""
        return self.role is PieceRole.COMMENT and self.text.startswith("%")

    @property
    def is_arrow(self) -> bool:
        """True if it is the arrow of an event rule."""
        return self.role is PieceRole.INFIX and self.name in EVENT_SYNTAX.arrows

    @property
    def is_choice_operator(self) -> bool:
        """True if it is an operator of alternatives in round brackets."""
        return self.role is PieceRole.INFIX and self.frame.is_group and self.name in _CHOICES

    @property
    def rank(self) -> int:
        """Priority of an operator, the same for all operators of patterns."""
        return min(self.priority, _PATTERN_PRIORITY)


class LayoutLine(NamedTuple):
    """A line of the layout.

    Attributes:
        code: its text without the comment at its end.
        comment: the comment at its end, or "".
        comment_offset: offset of that comment in the source; -1 without comment.
        has_blank_line: whether a blank line is before it.
    """

    code: str
    comment: str = ""
    comment_offset: int = -1
    has_blank_line: bool = False


class _BreakCandidate(NamedTuple):
    """A place in a line where a break may be added.

    Attributes:
        piece: the piece that would begin a line.
        position: its index in the line.
        frame: the frame that would be broken.
        depth: number of brackets around it, or more if the brackets in the operand should be broken first.
        priority: priority of the operator or comma, which binds the more loosely the higher it is.
    """

    piece: LayoutPiece
    position: int
    frame: BracketFrame
    depth: float
    priority: int

    def preference(self, first: BracketFrame) -> Tuple[bool, float, int]:
        """Return the order of preference, smallest first, in a line that begins in a frame.

        The outermost brackets are broken first, except those that are around the beginning of the line.
        """
        if self.frame.depth < first.depth:
            return True, -self.depth, -self.priority
        return False, self.depth, -self.priority


class _PieceBuilder:
    """Builds the pieces of a clause."""

    def __init__(self, clause: ParsedClause):
        self._clause = clause
        self._text = clause.source.text
        self.root = BracketFrame(None, 0)
        self.pieces: List[LayoutPiece] = []
        self._frames = [self.root]
        self._last_token: Optional[LayoutPiece] = None

    def build(self) -> List[LayoutPiece]:
        """Return the pieces."""
        end = self._clause.tokens[0][2]
        for token in self._clause.tokens:
            self._add_token(token, end)
            end = token[3]
        for position, piece in enumerate(self.pieces):
            if piece.role is PieceRole.OPENER and piece.inner is not None:
                piece.inner.position = position
        return self.pieces

    def _add_token(self, token: AnyToken, previous_end: int) -> None:
        comments, start = self._comments(previous_end, token[2])
        piece = self._create_token(token)
        has_break = "\n" in self._text[previous_end : token[2]]
        # A comma or full stop follows its operand directly; comments that end a line are moved behind it.
        is_moved = has_break and piece.role in (
            PieceRole.SEPARATOR,
            PieceRole.NECK,
            PieceRole.POSTFIX,
            PieceRole.COLON,
        )
        if piece.role is PieceRole.STOP:
            is_moved = len(comments) == 1 and comments[0].ends_line and not comments[0].breaks
        if not is_moved:
            self.pieces += comments
            self._set_gap(piece, start, token[2])
        piece.is_adjacent = previous_end == token[2]
        self.pieces.append(piece)
        if is_moved:
            self.pieces += comments
            piece.breaks = not comments
        self._last_token = piece

    def _comments(self, start: int, end: int) -> Tuple[List[LayoutPiece], int]:
        """Return the comments between two tokens, and the end of the last one, or ``start``."""
        comments = []
        for comment_start, comment_end in comment_spans(self._text, start, end):
            comment = LayoutPiece(
                clean_comment(self._text[comment_start:comment_end]),
                comment_start,
                PieceRole.COMMENT,
                self._frames[-1],
            )
            self._set_gap(comment, start, comment_start)
            comments.append(comment)
            start = comment_end
        return comments, start

    def _set_gap(self, piece: LayoutPiece, start: int, end: int) -> None:
        newlines = self._text.count("\n", start, end)
        piece.breaks = newlines > 0
        piece.has_blank_line = newlines > 1

    def _create_token(self, token: AnyToken) -> LayoutPiece:
        kind, value, start, end = token
        text = self._text[start:end]
        if kind in _CLOSING:
            inner = self._frames.pop()
            piece = LayoutPiece(text, start, PieceRole.CLOSER, self._frames[-1])
            piece.inner = inner
            return piece
        frame = self._frames[-1]
        if kind in _OPENING:
            piece = LayoutPiece(text, start, PieceRole.OPENER, frame)
            piece.inner = self._create_frame(piece, kind)
            self._frames.append(piece.inner)
            return piece
        if kind == ",":
            priority = 1000 if frame.opener is None or frame.is_group else _SEPARATOR_PRIORITY
            frame.loosest = max(frame.loosest, priority)
            return LayoutPiece(text, start, PieceRole.SEPARATOR, frame, priority=priority)
        if kind == END:
            return LayoutPiece(text, start, PieceRole.STOP, frame)
        name = value if kind in (NAME, QUOTED) else text if kind == "|" else ""
        operator = self._clause.uses.get(start)
        if name and (operator is not None or kind == "|" or (name == ":" and self._follows_slot_name())):
            return self._create_operator(text, start, name, operator)
        return LayoutPiece(text, start, PieceRole.OPERAND, frame, name)

    def _create_operator(self, text: str, start: int, name: str, operator: Optional[Operator]) -> LayoutPiece:
        frame = self._frames[-1]
        if name == ":" and self._follows_slot_name():
            return LayoutPiece(text, start, PieceRole.COLON, frame, name)
        if operator is None:
            # The bar of a list.
            return LayoutPiece(text, start, PieceRole.INFIX, frame, name, _SEPARATOR_PRIORITY)
        if len(operator.type) == 2:
            role = PieceRole.PREFIX if operator.type[0] == "f" else PieceRole.POSTFIX
            return LayoutPiece(text, start, role, frame, name, operator.priority)
        is_arrow = name in EVENT_SYNTAX.arrows
        role = (
            PieceRole.NECK
            if not is_arrow and (operator.priority >= 1200 or name in _NECKS)
            else PieceRole.INFIX
        )
        piece = LayoutPiece(text, start, role, frame, name, operator.priority)
        if role is PieceRole.INFIX and not is_arrow:
            frame.loosest = max(frame.loosest, piece.rank)
        frame.has_choices = frame.has_choices or piece.is_choice_operator
        return piece

    def _follows_slot_name(self) -> bool:
        """Return whether the last token is the name of a slot: a name directly after the bracket or a comma."""
        frame, last = self._frames[-1], self._last_token
        if not frame.is_message or last is None or not last.name:
            return False
        before = [piece for piece in self.pieces[-3:] if not piece.is_comment and piece is not last]
        return bool(before) and (before[-1] is frame.opener or before[-1].role is PieceRole.SEPARATOR)

    def _create_frame(self, opener: LayoutPiece, kind: str) -> BracketFrame:
        last = self._last_token
        outer = self._frames[-1]
        follows_name = last is not None and last.role is PieceRole.OPERAND and bool(last.name)
        is_group = kind == "(" or (kind == OPEN_CT and not follows_name)
        is_message = outer.is_message or (kind == "{" and follows_name)
        return BracketFrame(opener, outer.depth + 1, is_group, is_message and kind in ("{", "["))


def clean_comment(text: str) -> str:
    """Return a comment without spaces at the end of its lines."""
    return "\n".join(line.rstrip() for line in text.split("\n"))


class ClauseLayout:
    """Layout of a clause.

    Args:
        line_length: maximum length of a line, without the comment at its end.
        can_break: whether line breaks may be added: not in a goal without a full stop.
    """

    def __init__(self, clause: ParsedClause, line_length: int, can_break: bool = True):
        builder = _PieceBuilder(clause)
        self._pieces = builder.build()
        self._root = builder.root
        self._line_length = line_length
        text, end = clause.source.text, clause.tokens[-1][3]
        line_end = text.find("\n", end)
        self._text_after = text[end : line_end if line_end >= 0 else len(text)]
        self._set_tight_operators()
        self._normalize_breaks()
        self._place_pieces()
        if can_break:
            breaks = [piece.breaks for piece in self._pieces]
            if not self._break_long_lines():
                # The layout would depend on the number of passes.
                for piece, value in zip(self._pieces, breaks):
                    piece.breaks = value
                self._place_pieces()

    def lines(self) -> List[LayoutLine]:
        """Return the lines."""
        result = []
        for pieces in self._split_into_lines():
            comment = pieces[-1] if len(pieces) > 1 and pieces[-1].ends_line else None
            code = " " * pieces[0].column
            for previous, piece in zip([None, *pieces], pieces):
                if piece is not comment:
                    code += ("" if previous is None else self._space(previous, piece)) + piece.text
            has_blank_line = pieces[0].has_blank_line and pieces[0] is not self._pieces[0]
            line = LayoutLine(code, has_blank_line=has_blank_line)
            if comment is not None:
                line = line._replace(comment=comment.text, comment_offset=comment.offset)
            result.append(line)
        return result

    def separated_pieces(self) -> List[LayoutPiece]:
        """Return the pieces directly after commas."""
        return [
            piece
            for previous, piece in zip(self._pieces, self._pieces[1:])
            if previous.role is PieceRole.SEPARATOR and not piece.is_comment
        ]

    def _split_into_lines(self) -> Iterator[List[LayoutPiece]]:
        line: List[LayoutPiece] = []
        for piece in self._pieces:
            if piece.breaks and line:
                yield line
                line = []
            line.append(piece)
        yield line

    def _set_tight_operators(self) -> None:
        """Mark the operators without spaces around them, where the author decides."""
        for piece, following in zip(self._pieces, self._pieces[1:]):
            is_bar = piece.text == "|" and piece.priority == _SEPARATOR_PRIORITY
            is_sign = piece.priority < _LOOSE_PRIORITY and not piece.name[:1].isalpha()
            piece.is_tight = (
                piece.role is PieceRole.INFIX
                and (is_bar or is_sign)
                and piece.is_adjacent
                and following.is_adjacent
                and not following.is_comment
            )

    # Line breaks

    def _normalize_breaks(self) -> None:
        """Move line breaks to places where the layout allows them, or remove them."""
        pieces = self._pieces
        pieces[0].breaks = False
        for index in range(1, len(pieces)):
            previous, piece = pieces[index - 1 : index + 1]
            if previous.ends_line:
                piece.breaks = True
            elif piece.breaks and not previous.is_comment and not piece.is_comment:
                self._move_break(index)
        self._arrange_choices()
        for piece in pieces:
            if piece.breaks:
                piece.is_tight = False
                piece.frame.has_breaks = piece.frame.has_breaks or piece.role is not PieceRole.CLOSER
            else:
                piece.has_blank_line = False

    def _move_break(self, index: int) -> None:
        """Move the line break before a piece, between two tokens."""
        previous, piece = self._pieces[index - 1 : index + 1]
        if piece.role in (PieceRole.SEPARATOR, PieceRole.NECK) and index + 1 < len(self._pieces):
            piece.breaks = False
            self._pieces[index + 1].breaks = True
        elif previous.role is PieceRole.INFIX:
            piece.breaks = False
            previous.breaks = previous.breaks or index > 1
        elif (
            piece.role
            in (PieceRole.STOP, PieceRole.POSTFIX, PieceRole.COLON, PieceRole.SEPARATOR, PieceRole.NECK)
            or previous.role is PieceRole.COLON
            or (previous.role is PieceRole.PREFIX and not self._is_declaration(previous))
            or (piece.role is PieceRole.CLOSER and not self._is_block(piece.inner))
        ):
            piece.breaks = False

    @staticmethod
    def _is_declaration(piece: LayoutPiece) -> bool:
        """Return whether a prefix operator is a word such as ``dynamic``, after which a line may end."""
        return piece.name[0].isalpha() and 1000 < piece.priority < 1200

    def _is_block(self, frame: Optional[BracketFrame]) -> bool:
        """Return whether a line ends after the opening bracket of a frame."""
        if frame is None or frame.opener is None:
            return False
        first = self._first_content(frame.position)
        return first.breaks and first.inner is not frame

    def _first_content(self, index: int) -> LayoutPiece:
        """Return the first token after the opening bracket with an index."""
        index += 1
        while self._pieces[index].is_comment:
            index += 1
        return self._pieces[index]

    def _arrange_choices(self) -> None:
        """Break the lines before all operators of alternatives that do not fit into a line."""
        for piece in self._pieces:
            if piece.breaks and piece.is_choice_operator:
                piece.frame.is_choice = True
        for previous, piece in zip(self._pieces, self._pieces[1:]):
            is_closer = piece.role is PieceRole.CLOSER and piece.inner is not None and piece.inner.is_choice
            if is_closer or (piece.is_choice_operator and piece.frame.is_choice):
                piece.breaks = True
            elif (
                previous.inner is not None and previous.role is PieceRole.OPENER and previous.inner.is_choice
            ):
                piece.breaks = piece.is_comment and piece.breaks

    # Columns

    def _place_pieces(self) -> None:
        """Set the columns of all pieces and frames."""
        self._root.content_column = self._clause_indent()
        column = logical_column = 0
        for index, piece in enumerate(self._pieces):
            if index == 0 or piece.breaks:
                column = self._indent(piece, index)
                logical_column = self._logical_column(piece, column)
            else:
                column += len(self._space(self._pieces[index - 1], piece))
            piece.column = column
            if piece.is_arrow and piece.frame is self._root:
                self._root.content_column = column + 3 if piece.breaks else _ARROW_COLUMN
            if piece.role is PieceRole.OPENER and piece.inner is not None:
                logical_column = self._open_frame(piece.inner, index, logical_column)
            column = end_column(piece)

    def _clause_indent(self) -> int:
        """Return the column of lines of the clause that are outside of all brackets."""
        own = [piece for piece in self._pieces if piece.frame is self._root]
        if any(piece.role is PieceRole.NECK and piece.name in _NECKS for piece in own):
            return INDENT
        if own[0].role is PieceRole.PREFIX and own[0].priority == 1200:
            return len(own[0].text) + 1
        return _ARROW_COLUMN if any(piece.role is PieceRole.INFIX for piece in own) else INDENT

    def _indent(self, piece: LayoutPiece, index: int) -> int:
        """Return the column of a piece that begins a line."""
        if index == 0 or (piece.is_comment and self._pieces[index - 1].role is PieceRole.STOP):
            return 0
        if piece.role is PieceRole.CLOSER and piece.inner is not None:
            return piece.inner.closer_column
        frame = piece.frame
        if frame is self._root and piece.is_arrow:
            return _ARROW_COLUMN
        if frame.is_choice and piece.is_choice_operator:
            return frame.column
        is_continuation = piece.role is PieceRole.INFIX and piece.rank < frame.loosest
        return frame.content_column + (INDENT if is_continuation else 0)

    def _logical_column(self, piece: LayoutPiece, column: int) -> int:
        """Return the column from which blocks are indented in the line that a piece begins."""
        if piece.is_arrow and piece.frame is self._root:
            return column + len(piece.text) + 1
        return column + INDENT if piece.frame.is_choice and piece.is_choice_operator else column

    def _open_frame(self, frame: BracketFrame, index: int, logical_column: int) -> int:
        """Set the columns of a frame; return the column from which blocks in the rest of the line are indented."""
        frame.column = column = self._pieces[index].column
        first = self._first_content(index)
        if frame.is_choice:
            frame.content_column, frame.closer_column = column + INDENT, column
            return frame.content_column
        if first.breaks and first.inner is not frame:
            outer = self._pieces[index].frame
            # The contents are indented from those of the bracket around it, if these are aligned in several lines.
            if outer.has_breaks and outer.content_column == outer.column + 1:
                logical_column = max(logical_column, outer.content_column)
            frame.content_column, frame.closer_column = logical_column + INDENT, logical_column
        else:
            frame.content_column, frame.closer_column = column + 1, column
        return logical_column

    def _space(self, previous: LayoutPiece, piece: LayoutPiece) -> str:
        """Return the space between two pieces in a line."""
        if previous.role is PieceRole.OPENER:
            is_choice = previous.inner is not None and previous.inner.is_choice
            return " " * (INDENT - 1) if is_choice and not piece.is_comment else ""
        if previous.frame.is_choice and previous.is_choice_operator:
            return " " * (INDENT - len(previous.text))
        if piece.role in (PieceRole.SEPARATOR, PieceRole.CLOSER, PieceRole.COLON):
            return ""
        if piece.is_comment or previous.is_comment:
            return "" if piece.role is PieceRole.STOP else " "
        if piece.role is PieceRole.STOP:
            return "" if piece.is_adjacent or not is_symbol(previous.text) else " "
        return "" if self._is_adjacent(previous, piece) else " "

    @staticmethod
    def _is_adjacent(previous: LayoutPiece, piece: LayoutPiece) -> bool:
        """Return whether there is no space between two tokens that are not separated by a comma."""
        if (
            previous.role in (PieceRole.SEPARATOR, PieceRole.COLON, PieceRole.NECK)
            or piece.role is PieceRole.NECK
        ):
            return False
        if previous.role is PieceRole.INFIX:
            return previous.is_tight
        if piece.role is PieceRole.INFIX:
            return piece.is_tight
        if previous.role is PieceRole.PREFIX and (previous.priority == 1200 or previous.name == "\\+"):
            return False
        return piece.is_adjacent

    # Long lines

    def _break_long_lines(self) -> bool:
        """Add line breaks until all lines are short enough or cannot be broken; return False if it takes too long."""
        for _ in range(_MAX_PASSES):
            lines = list(self._split_into_lines())
            has_breaks = [self._break_line(line) for line in lines]
            if not any(has_breaks):
                return True
            self._normalize_breaks()
            self._place_pieces()
        return False

    def _break_line(self, line: Sequence[LayoutPiece]) -> bool:
        """Add line breaks to a line if it is too long; return whether any was added."""
        code = [piece for piece in line if not piece.ends_line]
        if not code or end_column(code[-1]) <= self._line_length:
            return False
        comment = self._text_after if line[-1] is self._pieces[-1] else line[-1].text
        if _SUPPRESSION in comment:
            return False
        if self._break_after_opener(code[0].frame):
            return True
        candidates = _break_candidates(code)
        if not candidates:
            return False
        best = min(candidate.preference(code[0].frame) for candidate in candidates)
        group = [candidate for candidate in candidates if candidate.preference(code[0].frame) == best]
        # If several brackets are at this level, the last one that begins within the line length.
        frame = max(
            group, key=lambda candidate: (candidate.piece.column <= self._line_length, candidate.position)
        ).frame
        group = [candidate for candidate in group if candidate.frame is frame]
        if self._break_body(code, group[0]) or self._break_after_opener(frame):
            return True
        self._fill(code, group)
        return True

    def _break_body(self, code: Sequence[LayoutPiece], candidate: _BreakCandidate) -> bool:
        """Put each goal of a clause on a line of its own if a candidate is the start of the body."""
        previous = code[candidate.position - 1]
        if previous.role is not PieceRole.NECK or previous.name not in _NECKS:
            return False
        candidate.piece.breaks = True
        for previous, piece in zip(self._pieces, self._pieces[1:]):
            if previous.role is PieceRole.SEPARATOR and previous.frame is self._root and not piece.is_comment:
                piece.breaks = True
        return True

    def _break_after_opener(self, frame: BracketFrame) -> bool:
        """Break a line after an opening bracket if the contents would be aligned too far to the right."""
        is_aligned = (
            frame.opener is not None and not frame.is_choice and frame.content_column == frame.column + 1
        )
        if not is_aligned or frame.content_column <= _MAX_HANGING_PART * self._line_length:
            return False
        first = self._pieces[frame.position + 1]
        if first.is_comment or first.breaks:
            return False
        first.breaks = True
        return True

    def _fill(self, code: Sequence[LayoutPiece], group: Sequence[_BreakCandidate]) -> None:
        """Break a line at some of the candidates of a frame, so that as much as possible is in each line."""
        ends = [candidate.position for candidate in group[1:]] + [len(code)]
        shift = 0
        for candidate, end in zip(group, ends):
            if end_column(code[end - 1]) - shift > self._line_length:
                candidate.piece.breaks = True
                shift = candidate.piece.column - self._indent(candidate.piece, end)


def _break_candidates(code: Sequence[LayoutPiece]) -> List[_BreakCandidate]:
    """Return the places in a line where a break may be added."""
    candidates = []
    for index in range(1, len(code)):
        previous, piece = code[index - 1 : index + 1]
        if not previous.is_comment and not piece.is_comment:
            candidate = _break_candidate(previous, piece, index)
            if candidate is not None:
                candidates.append(candidate)
    return candidates


def _break_candidate(previous: LayoutPiece, piece: LayoutPiece, index: int) -> Optional[_BreakCandidate]:
    """Return the place between two tokens of a line if a break may be added there."""
    if piece.role is PieceRole.INFIX:
        # The brackets of an operand of `=` are broken before the equation.
        depth = piece.frame.depth + (1.5 if piece.priority <= _LOOSE_PRIORITY else 0)
        return _BreakCandidate(piece, index, piece.frame, depth, 1300 if piece.is_arrow else piece.priority)
    if piece.role not in (PieceRole.OPERAND, PieceRole.OPENER, PieceRole.PREFIX):
        return None
    if previous.role is PieceRole.SEPARATOR:
        return _BreakCandidate(piece, index, previous.frame, previous.frame.depth, previous.priority)
    if previous.role is PieceRole.NECK:
        # The label of a rule stays in the line of the head if possible.
        priority = 1250 if previous.name in _NECKS else 1
        return _BreakCandidate(piece, index, previous.frame, previous.frame.depth, priority)
    if previous.role is PieceRole.OPENER and previous.inner is not None and not previous.inner.is_choice:
        return _BreakCandidate(piece, index, previous.inner, previous.inner.depth, 0)
    return None


def end_column(piece: LayoutPiece) -> int:
    """Return the column after a piece."""
    newline = piece.text.rfind("\n")
    return piece.column + len(piece.text) if newline < 0 else len(piece.text) - newline - 1


def is_symbol(text: str) -> bool:
    """Return whether a full stop directly after a token would become a part of it."""
    return text[-1] in "-+*/\\^<>=~:.?@#&$"
