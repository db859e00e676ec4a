"""Text streams of Prolog programs: input files, output files, captured output, and their properties.

An input file is read as a whole when it is opened, up to the size limit of files. An output file is opened and closed
for each write of complete lines. So no file descriptor stays open if a goal is abandoned, and no complete line is
lost.

The current output is a stack: a goal that captures its output (``with_output_to/2``) or a stream that is set with
``set_output/1`` replaces the output below it, which is stored with its column until the replacement ends.
"""

import sys
from typing import TYPE_CHECKING, Any, Callable, Dict, Iterator, List, Optional, Tuple, Union

from ...foundation.displayed_text import printable
from ...foundation.errors import SyntaxFault
from ..machine.errors import (
    ERROR,
    PrologError,
    domain_error,
    existence_error,
    instantiation_error,
    permission_error,
    resource_error,
)
from ..machine.resource_limits import Budget
from ..syntax.operators import Operators
from ..syntax.term_reader import Program, ReadTerm, read_program
from ..syntax.tokenizer import ReadFlags
from ..terms.types import Atom, CompoundTerm, Term, Var, atom, deref, functor
from ..terms.unification import unify
from .builtin_registry import ProgramMachine, Solutions, deterministic, nondeterministic
from .text_arguments import check_text_length

if TYPE_CHECKING:
    from ..files.source_files import SourceFiles

MAX_OPEN_STREAMS = 64
"""Maximum number of streams that are open at the same time."""

_MAX_BUFFERED_CHARACTERS = 4096
"""Maximum number of characters of an incomplete line that an output stream buffers."""

_STREAM = functor("$stream", 1)
_SYNTAX, _STREAM_CONTEXT = functor("syntax_error", 1), functor("stream", 4)
_STANDARD_STREAMS = ("user_input", "user_output", "user_error")


class InputStream:
    """An input stream over a text.

    Args:
        name: name for error messages.
        text: the text, or its known part that has not been dropped.
        read_line: returns the next line, or None at the end; None if ``text`` is complete.

    Attributes:
        offset: position in ``text``.
        opening_name: name by which ``see/1`` or ``tell/1`` opened it.
        stream_type: ``text`` or ``binary``.
        eof_action: action for a read past the end: ``error``, ``eof_code`` or ``reset``.
        has_read_end: whether the end of the stream has been read.
    """

    mode = "read"

    def __init__(self, name: str, text: str = "", read_line: Optional[Callable[[], Optional[str]]] = None):
        self.name = name
        self.opening_name = ""
        self.text = text
        self.offset = 0
        self.read_line = read_line
        self.stream_term: Term = atom(name)
        self.stream_type = "text"
        self.eof_action = "eof_code" if read_line is None else "reset"
        self.has_read_end = False
        # Numbers of characters and line ends before `text`, and the column at its start.
        self._start = (0, 0, 0)
        # Position up to which line ends have been counted, their number, and the position of the last one.
        self._line_counts = (0, 0, -1)
        # Reader of terms, the position in `text` where it began, and the one where the next term begins.
        self._program: Optional[Program] = None
        self._program_start = 0
        self._next_term_start = 0

    def _append_line(self) -> bool:
        """Append the next line to the text; return whether there was one."""
        line = None if self.read_line is None else self.read_line()
        if line is None:
            return False
        # Text that has been read is dropped, so that memory does not grow in an interactive session.
        self._start = self.position
        self.text, self.offset, self._program = self.text[self.offset :] + line, 0, None
        # Positions are relative to the text that remains.
        self._line_counts = (0, 0, -1)
        return True

    @property
    def position(self) -> Tuple[int, int, int]:
        """Numbers of characters read, of line ends read, and of characters read of the current line."""
        characters, lines, column = self._start
        counted_to, count, newline = self._line_counts
        # Lines are counted incrementally from the last position; only repositioning backwards restarts the count.
        if counted_to > self.offset:
            counted_to, count, newline = 0, 0, -1
        count += self.text.count("\n", counted_to, self.offset)
        newline = max(newline, self.text.rfind("\n", counted_to, self.offset))
        self._line_counts = (self.offset, count, newline)
        # Without a line end in the present text, the column continues that of the dropped text.
        column = column + self.offset if newline < 0 else self.offset - newline - 1
        return characters + self.offset, lines + count, column

    def set_position(self, characters: int) -> bool:
        """Set the position to a number of characters from the start; return whether its text is still stored."""
        # Only the text that has not been dropped can be read again.
        position = characters - self._start[0]
        if not 0 <= position <= len(self.text):
            return False
        self.offset, self.has_read_end = position, False
        return True

    def record_end_read(self, is_consumed: bool) -> None:
        """Record that the end of the stream is read; ``is_consumed`` is False for a peek.

        Raises:
            PrologError: a permission error if it has been read before, and the ``eof_action`` is ``error``.
        """
        if self.has_read_end and self.eof_action == "error":
            raise permission_error("input", "past_end_of_stream", self.stream_term)
        self.has_read_end = self.has_read_end or is_consumed

    def read_character(self, is_consumed: bool) -> str:
        """Return the next character, or "" at the end; it is consumed if ``is_consumed``."""
        if self.offset >= len(self.text) and not self._append_line():
            self.record_end_read(is_consumed)
            return ""
        char = self.text[self.offset]
        # Adds 1 or 0: a peek does not advance.
        self.offset += is_consumed
        return char

    def peek_text(self, length: int) -> str:
        """Return the next ``length`` characters, or fewer at the end, without consuming them."""
        while len(self.text) - self.offset < length and self._append_line():
            pass
        return self.text[self.offset : self.offset + length]

    @property
    def line(self) -> int:
        """Number of the current line, from 1."""
        return self.position[1] + 1

    def read_term(self, operators: Operators, flags: ReadFlags) -> Union[ReadTerm, SyntaxFault, None]:
        """Read a term; return a `SyntaxFault` for an invalid one, and None at the end."""
        while True:
            result = self._read_next_term(operators, flags)
            # A term may span lines, but a line is requested only if the term is incomplete, because the user expects
            # an answer to complete terms.
            if self.read_line is None or not self._may_continue(result) or not self._append_line():
                self.offset = self._next_term_start
                if result is None:
                    self.record_end_read(True)
                return result

    def _read_next_term(self, operators: Operators, flags: ReadFlags) -> Union[ReadTerm, SyntaxFault, None]:
        program = self._program
        # The reader is reused for the next term, because a new one would tokenize the rest of the text again.
        if program is None or self._next_term_start != self.offset:
            program = read_program(self.text[self.offset :], operators, self.name, flags, self.line)
            self._program, self._program_start = program, self.offset
        program.operators, program.flags = operators, flags
        previous_end = program.end
        result = next(iter(program), None)
        self._next_term_start = (
            self._program_start + program.end if program.end > previous_end else len(self.text)
        )
        # The reader cannot continue after an error, so the next term starts a new one.
        if isinstance(result, SyntaxFault):
            self._program = None
        return result

    def _may_continue(self, result: Union[ReadTerm, SyntaxFault, None]) -> bool:
        """Return whether the term may be incomplete, so that another line has to be read."""
        unread_text = self.text[self.offset :].rstrip()
        if result is None or not unread_text:
            return True
        if not isinstance(result, SyntaxFault) or unread_text.endswith("."):
            return False
        return result.place is None or result.place.line >= self.line + unread_text.count("\n")


class OutputStream:
    """An output stream to a file, written in complete lines.

    Args:
        name: path of the file.
        mode: ``write`` or ``append``.
        append_to_file: appends a text to the file.
    """

    def __init__(self, name: str, mode: str, append_to_file: Callable[[str], None]):
        self.name = name
        self.opening_name = ""
        self.stream_term: Term = atom(name)
        self.stream_type = "text"
        self.mode = mode
        self.column = 0
        self._append_to_file = append_to_file
        self._buffer: List[str] = []
        self._size = 0

    def write(self, text: str) -> None:
        """Write a text."""
        self._buffer.append(text)
        self._size += len(text)
        if self._size > _MAX_BUFFERED_CHARACTERS or "\n" in text:
            self.flush()

    def flush(self) -> None:
        """Write the buffered text to the file."""
        text = "".join(self._buffer)
        self._buffer, self._size = [], 0
        if text:
            self._append_to_file(text)


def flush_standard_streams(budget: Budget) -> None:
    """Write the text of the user's streams to the standard streams, which Python buffers except on terminals."""
    with budget.ending_entry():
        sys.stdout.flush()
        sys.stderr.flush()


class UserStream:
    """Stream ``user_output`` or ``user_error``, which escapes control characters that terminals and logs interpret.

    Args:
        budget: limits the output of an entry.
        write: prints a text.
    """

    def __init__(self, budget: Budget, write: Callable[[str], None]):
        self._budget = budget
        self._write = write

    def __call__(self, text: str) -> None:
        """Write a text.

        Raises:
            LimitError: if the text exceeds the limit of output; none of it is written. Also if an interrupt ends the
                output.
        """
        # Counted before it is processed, so that a text that is too long costs nothing. Escapes and multibyte
        # characters are added once they are known.
        self._budget.count_output(len(text))
        escaped = printable(text)
        added_bytes = len(escaped.encode()) - len(text)
        if added_bytes:
            self._budget.count_output(added_bytes)
        with self._budget.ending_entry():
            self._write(escaped)


class _ReplacedOutput:
    """An output that has been replaced by a stream or a capture, with its column."""

    __slots__ = ("output", "column")

    def __init__(self, output: Callable[[str], None], column: int):
        self.output = output
        self.column = column

    def write(self, text: str) -> None:
        """Write a text to it while it is replaced."""
        self.column = column_after(self.column, text)
        self.output(text)


def column_after(column: int, text: str) -> int:
    """Return the column after a text that is written at a column."""
    newline = text.rfind("\n")
    return column + len(text) if newline < 0 else len(text) - newline - 1


class OutputCapture:
    """Captured output of a goal.

    It replaces the current output of the program until `end` is called. Captures nest with each other and with
    streams that are set as current output: a capture stores the stream that was set before, and `end` restores it.

    Attributes:
        texts: parts of the captured text.
        stream_output: the output that the stream set before had replaced; None if none was set.
    """

    mode = "append"
    stream_type = "text"
    name = opening_name = ""

    def __init__(self, machine: ProgramMachine):
        logic = machine.logic
        self.texts: List[str] = []
        self.replaced_output = _ReplacedOutput(logic.output, logic.column)
        self._logic = logic
        self._streams = streams_of(machine)
        self.stream_term: Term = self._streams.new_term()
        self._size = 0
        self._outer_stream, self.stream_output = self._streams.replace_current(None, None)
        logic.redirect(self, 0)

    def __call__(self, text: str) -> None:
        """Append a text."""
        self._size += len(text)
        check_text_length(self._size)
        self.texts.append(text)

    def end(self) -> None:
        """Restore the output that was replaced."""
        self._logic.redirect(self.replaced_output.output, self.replaced_output.column)
        self._streams.replace_current(self._outer_stream, self.stream_output)


OpenStream = Union[InputStream, OutputStream, OutputCapture]


class ProgramStreams:
    """Open streams of a program, and its current input and output.

    Attributes:
        open_streams: streams by the numbers in their stream terms.
        aliases: numbers of streams by their aliases.
        user_input: the standard input.
        output: the stream that is the current output; None for the user's output or a capture.
    """

    def __init__(self, machine: ProgramMachine):
        self._machine = machine
        self._logic = machine.logic
        self.open_streams: Dict[int, OpenStream] = {}
        self.aliases: Dict[str, int] = {}
        self.user_input = InputStream("user_input", read_line=self._read_user_line)
        self.input = self.user_input
        self.output: Optional[OutputStream] = None
        self._replaced: Optional[_ReplacedOutput] = None
        self._last_number = 0

    def _read_user_line(self) -> Optional[str]:
        ask = self._logic.ask
        # An interrupt while the user is typing ends the goal that reads.
        with self._machine.budget.ending_entry():
            return None if ask is None else ask()

    def open(
        self,
        name: Term,
        mode: str,
        alias: Optional[str] = None,
        stream_type: str = "text",
        encoding: str = "utf-8",
    ) -> Term:
        """Open a file; return the stream's term.

        Args:
            name: name of the file.
            mode: ``read``, ``write`` or ``append``.
            alias: alias of the stream.
            stream_type: ``text`` or ``binary``.
            encoding: Python name of the encoding; latin-1 for binary files.

        Raises:
            PrologError: a permission, existence or resource error.
        """
        files = self._logic.files
        # The alias is checked before the file is opened, which would already empty it.
        if alias is not None and (alias in self.aliases or alias in _STANDARD_STREAMS):
            raise permission_error("open", "source_sink", (functor("alias", 1), atom(alias)))
        if len(self.open_streams) >= MAX_OPEN_STREAMS:
            raise resource_error(
                "streams", reason=f"{MAX_OPEN_STREAMS} streams are open, the maximum: close one with close/1"
            )
        if files is None:
            raise permission_error("open", "source_sink", name, "this program has no access to files")
        if mode == "read":
            stream: OpenStream = InputStream(*_read_file(files, name, encoding))
        else:
            path = files.to_write(name, mode == "append")
            stream = OutputStream(path, mode, lambda text: files.add(path, text, encoding))
        stream.stream_term, stream.stream_type = self.new_term(), stream_type
        self.open_streams[self._last_number] = stream
        if alias is not None:
            self.aliases[alias] = self._last_number
        return stream.stream_term

    def new_term(self) -> Term:
        """Return a new stream term."""
        self._last_number += 1
        return (_STREAM, self._last_number)

    def find(self, term: Term) -> Union[OpenStream, str]:
        """Return the stream of a stream term or alias; for a standard stream, return its name.

        Raises:
            PrologError: an instantiation, domain or existence error.
        """
        term = deref(term)
        number: Optional[int] = None
        if term.__class__ is Var:
            raise instantiation_error()
        if isinstance(term, Atom):
            number = self.aliases.get(term.name)
            if number is None and term.name in (*_STANDARD_STREAMS, "user", "current_output"):
                return term.name
        elif isinstance(term, tuple) and term[0] is _STREAM:
            # Captures are not in `open_streams`, because they end without `close/1`.
            for capture in self._captures():
                if capture.stream_term == term:
                    return capture
            value = deref(term[1])
            number = value if isinstance(value, int) else None
        else:
            raise domain_error("stream_or_alias", term)
        stream = None if number is None else self.open_streams.get(number)
        if stream is None:
            raise existence_error("stream", term)
        return stream

    def find_open(self, term: Term) -> OpenStream:
        """Return an opened stream by its stream term."""
        open_stream = self.find(term)
        assert not isinstance(open_stream, str)
        return open_stream

    def find_input(self, term: Optional[Term]) -> InputStream:
        """Return an input stream; the current one for None.

        Raises:
            PrologError: a permission error for an output stream, or an error of `find`.
        """
        if term is None:
            return self.input
        open_stream = self.find(term)
        if open_stream in ("user_input", "user"):
            return self.user_input
        if not isinstance(open_stream, InputStream):
            raise permission_error("input", "stream", deref(term))
        return open_stream

    def find_output(self, term: Term) -> Union[OutputStream, OutputCapture, str]:
        """Return an output stream; for a standard stream, return its name.

        Raises:
            PrologError: a permission error for an input stream, or an error of `find`.
        """
        open_stream = self.find(term)
        if open_stream == "user_input" or isinstance(open_stream, InputStream):
            raise permission_error("output", "stream", deref(term))
        return open_stream

    def write(self, term: Term, text: str) -> None:
        """Write a text to a stream."""
        target, logic = self.find_output(term), self._logic
        if target == "user_error":
            logic.error_output(text)
        elif target == "current_output" or target is self.output or target is logic.output:
            logic.write(text)
        # A stream that is not the current output keeps its own column.
        elif isinstance(target, OutputStream):
            target.column = column_after(target.column, text)
            target.write(text)
        else:
            replaced = self._find_replaced(target)
            if replaced is None:
                logic.write(text)
            else:
                replaced.write(text)

    def column(self, stream: Union[OutputStream, OutputCapture, str]) -> int:
        """Return the number of characters in the last line of an output."""
        logic = self._logic
        if stream == "current_output" or stream is self.output or stream is logic.output:
            return logic.column
        if isinstance(stream, OutputStream):
            return stream.column
        replaced = self._find_replaced(stream)
        return logic.column if replaced is None else replaced.column

    def _find_replaced(self, stream: Union[OutputCapture, str]) -> Optional[_ReplacedOutput]:
        """Return a capture, or for a name the user's output, as a replaced output; None if it is not replaced."""
        outputs = list(self._replaced_outputs())
        if isinstance(stream, OutputCapture):
            return next((output for output in outputs if output.output is stream), None)
        return outputs[-1] if outputs else None

    def _replaced_outputs(self) -> Iterator[_ReplacedOutput]:
        """Yield the outputs that streams and captures have replaced, the innermost first and the user's last."""
        output = self._logic.output
        if self._replaced is not None:
            yield self._replaced
            output = self._replaced.output
        while isinstance(output, OutputCapture):
            replaced = output.stream_output or output.replaced_output
            yield replaced
            output = replaced.output

    def _captures(self) -> Iterator[OutputCapture]:
        """Yield the active captures, the innermost first."""
        for output in (self._logic.output, *(replaced.output for replaced in self._replaced_outputs())):
            if isinstance(output, OutputCapture):
                yield output

    def current_output(self) -> Term:
        """Return the stream term of the current output."""
        capture = self._logic.output
        if isinstance(capture, OutputCapture):
            return capture.stream_term
        return atom("user_output") if self.output is None else self.output.stream_term

    def replace_current(
        self, stream: Optional[OutputStream], replaced: Optional[_ReplacedOutput]
    ) -> Tuple[Optional[OutputStream], Optional[_ReplacedOutput]]:
        """Set the current output stream and the output that it replaces; return the previous ones."""
        previous_output = self.output, self._replaced
        self.output, self._replaced = stream, replaced
        return previous_output

    def set_output(self, stream: Union[OutputStream, OutputCapture, str]) -> None:
        """Set the current output."""
        logic = self._logic
        # A capture is the current output already; replacing it by itself would break the nesting.
        if stream is logic.output:
            return
        # A stream set before is left first: at most one stream is on the stack between two captures.
        if self.output is not None and self._replaced is not None:
            self.output.column = logic.column
            logic.redirect(self._replaced.output, self._replaced.column)
            self.output = self._replaced = None
        if isinstance(stream, OutputStream):
            self._replaced = _ReplacedOutput(logic.output, logic.column)
            self.output = stream
            logic.redirect(stream.write, stream.column)

    def close(self, stream: OpenStream) -> None:
        """Close a stream; if it was the current input or output, the user's becomes current."""
        if isinstance(stream, OutputCapture):
            return
        if stream is self.input:
            self.input = self.user_input
        # The output is reset before the stream is removed, so that nothing can be written to a closed stream.
        if stream is self.output:
            self.set_output("user_output")
        for number, open_stream in list(self.open_streams.items()):
            if open_stream is stream:
                del self.open_streams[number]
                self.aliases = {alias: index for alias, index in self.aliases.items() if index != number}
        if isinstance(stream, OutputStream):
            stream.flush()


def _read_file(files: "SourceFiles", name: Term, encoding: str) -> Tuple[str, str]:
    """Return the path and the text of a file; an existence error contains the name as the program wrote it."""
    try:
        return files.to_read(name, encoding)
    except PrologError as error:
        ball: Any = error.term
        # The sandbox reports the resolved path, which a program that gave a relative name would not recognise.
        if isinstance(ball[1], tuple) and ball[1][0].name == "existence_error":
            raise existence_error("source_sink", name, ball[2]) from error
        raise


def is_stream_term(term: Term) -> bool:
    """Return whether a term is a stream term, of an open or a closed stream."""
    return isinstance(term, tuple) and term[0] is _STREAM


def streams_of(machine: ProgramMachine) -> ProgramStreams:
    """Return the streams of a machine's program."""
    state = machine.logic.state
    streams: Optional[ProgramStreams] = state.get("streams")
    if streams is None:
        streams = state["streams"] = ProgramStreams(machine)
    return streams


def syntax_error_in(stream: InputStream, term: Term, fault: SyntaxFault) -> PrologError:
    """Return the Prolog error for a syntax error in a stream."""
    line, column = (0, 0) if fault.place is None else (fault.place.line, fault.place.column)
    return PrologError(
        (ERROR, (_SYNTAX, atom(fault.message)), (_STREAM_CONTEXT, term, line, column - 1, stream.offset))
    )


_POSITION = functor("$stream_position", 4)
_PROPERTIES_WITHOUT_VALUE = ("input", "output")
_PROPERTIES_WITH_VALUE = (
    "alias",
    "buffer",
    "encoding",
    "end_of_stream",
    "eof_action",
    "file_name",
    "mode",
    "newline",
    "position",
    "reposition",
    "tty",
    "type",
)


@deterministic("is_stream/1")
def is_stream(machine: ProgramMachine, term: Term) -> bool:
    """Test for an open stream, by its term or alias."""
    try:
        streams_of(machine).find(term)
    except PrologError:
        return False
    return True


@nondeterministic("stream_property/2")
def stream_property(machine: ProgramMachine, stream: Term, property_term: Term) -> Solutions:
    """Enumerate the properties of open streams."""
    streams, stream = streams_of(machine), deref(stream)
    _require_property(deref(property_term))
    if stream.__class__ is Var:
        candidates: List[Tuple[Term, Union[OpenStream, str]]] = [
            (atom(name), name) for name in _STANDARD_STREAMS
        ]
        candidates += [
            (stream_or_name.stream_term, stream_or_name)
            for stream_or_name in list(streams.open_streams.values())
        ]
    elif is_stream_term(stream):
        candidates = [(stream, streams.find(stream))]
    else:
        candidates = [(stream, _standard_stream_name(streams, stream))]
    for term, stream_or_name in candidates:
        for value in _properties(streams, stream_or_name):
            if machine.unify_all((stream, term), (property_term, value)):
                yield None


def _standard_stream_name(streams: ProgramStreams, stream: Term) -> str:
    """Return the name of a standard stream; other aliases are not accepted as stream terms here."""
    try:
        name = streams.find(stream)
    except PrologError:
        raise domain_error("stream", stream) from None
    if not isinstance(name, str):
        raise domain_error("stream", stream)
    return name


def _require_property(property_term: Term) -> None:
    """Check that a term is a stream property or a variable.

    Raises:
        PrologError: a domain error for any other term.
    """
    if property_term.__class__ is Var:
        return
    if isinstance(property_term, tuple):
        is_known = len(property_term) == 2 and property_term[0].name in _PROPERTIES_WITH_VALUE
    else:
        is_known = property_term in [atom(name) for name in _PROPERTIES_WITHOUT_VALUE]
    if not is_known:
        raise domain_error("stream_property", property_term)


def _properties(streams: ProgramStreams, stream: Union[OpenStream, str]) -> Iterator[Term]:
    """Yield the properties of an open stream, or of a standard stream by its name."""
    if stream == "user_input":
        stream = streams.user_input
    is_input = isinstance(stream, InputStream)
    mode = "append" if isinstance(stream, str) else stream.mode
    yield atom("input" if is_input else "output")
    yield _property("mode", mode)
    if isinstance(stream, str):
        yield _property("alias", stream)
    elif stream is streams.user_input:
        yield _property("alias", stream.name)
    elif not isinstance(stream, OutputCapture):
        yield _property("file_name", stream.name)
        for alias, number in list(streams.aliases.items()):
            if streams.open_streams.get(number) is stream:
                yield _property("alias", alias)
    if isinstance(stream, InputStream):
        yield _property("eof_action", stream.eof_action)
        # Whether the user's input has ended is not known before it is read.
        if stream is not streams.user_input:
            yield _property("end_of_stream", _end_of_stream(stream))
        yield (functor("position", 1), _position_term(stream))
        yield _property("reposition", "false" if stream is streams.user_input else "true")
    yield _property("type", "text" if isinstance(stream, str) else stream.stream_type)


def _property(name: str, value: str) -> CompoundTerm:
    return (functor(name, 1), atom(value))


def _end_of_stream(stream: InputStream) -> str:
    if stream.offset < len(stream.text):
        return "not"
    return "past" if stream.has_read_end else "at"


def _position_term(stream: InputStream) -> CompoundTerm:
    characters, lines, column = stream.position
    return (_POSITION, characters, lines + 1, column, characters)


@deterministic("set_stream_position/2")
def set_stream_position(machine: ProgramMachine, stream: Term, position: Term) -> bool:
    """Set the position of an input stream to one obtained from its property ``position``."""
    position = deref(position)
    if position.__class__ is Var or deref(stream).__class__ is Var:
        raise instantiation_error()
    open_stream = streams_of(machine).find(stream)
    characters = deref(position[1]) if isinstance(position, tuple) and position[0] is _POSITION else None
    if not isinstance(characters, int):
        raise domain_error("stream_position", position)
    if not isinstance(open_stream, InputStream) or not open_stream.set_position(characters):
        raise permission_error("reposition", "stream", deref(stream))
    return True


@deterministic("line_count/2")
def line_count(machine: ProgramMachine, stream: Term, line: Term) -> bool:
    """Unify with the number of the current line of an input stream."""
    return unify(line, streams_of(machine).find_input(stream).line, machine.trail)


@deterministic("line_position/2")
def line_position(machine: ProgramMachine, stream: Term, column: Term) -> bool:
    """Unify with the number of characters read or written of the current line."""
    streams = streams_of(machine)
    open_stream = streams.find(stream)
    if open_stream == "user_input" or isinstance(open_stream, InputStream):
        position = streams.find_input(stream).position[2]
    else:
        position = streams.column(open_stream)
    return unify(column, position, machine.trail)


@deterministic("character_count/2")
def character_count(machine: ProgramMachine, stream: Term, count: Term) -> bool:
    """Unify with the number of characters read."""
    return unify(count, streams_of(machine).find_input(stream).position[0], machine.trail)
