"""Streams: texts that a program reads, and files that it writes.

A file that is read is read whole, as far as files may be large; one that is written is opened for each line
of it. So no file stays open, whatever becomes of the goal, and nothing that was written to the end of a line is lost.

What is known of streams: properties, positions, lines and columns.
"""

from typing import Any, Callable, Dict, Iterator, List, Optional, Tuple, Union

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
from ..syntax.operators import Operators
from ..syntax.term_reader import Program, ReadTerm, read_program
from ..syntax.tokenizer import ReadFlags
from ..terms.types import Atom, CompoundTerm, Term, Var, atom, deref, functor
from ..terms.unification import unify
from .builtin_registry import Machine, MachineProgram, Solutions, StreamFiles, deterministic, nondeterministic
from .text_arguments import long_text

MAX_OPEN_STREAMS = 64
"""ProgramStreams that may be open at once."""

_HELD = 4096
"""Characters of a line that are held back at most."""

_STREAM = functor("$stream", 1)
_SYNTAX, _AT = functor("syntax_error", 1), functor("stream", 4)
_USER = ("user_input", "user_output", "user_error")


class InputStream:
    """A text that is read.

    Args:
        name: what errors call it.
        text: what is known of it.
        more: gives the next line, None at the end.

    Attributes:
        at: where it is in the text.
        itself: the term that names it.
        kind: ``text`` or ``binary``.
        eof_action: what reading on behind the end does: ``error``, ``eof_code`` or ``reset``.
        ended: whether the end has been read.
    """

    mode = "read"

    def __init__(self, name: str, text: str = "", more: Optional[Callable[[], Optional[str]]] = None):
        self.name = name
        self.asked = ""
        self.text = text
        self.at = 0
        self.more = more
        self.itself: Term = atom(name)
        self.kind = "text"
        self.eof_action = "eof_code" if more is None else "reset"
        self.ended = False
        self._before = (0, 0, 0)
        self._counted = (0, 0, -1)  # up to where lines were counted, how many, and where the last one ended
        self._program: Optional[Program] = None
        self._base = 0
        self._next = 0

    def _fill(self) -> bool:
        """Take the next line; return whether there was one."""
        line = None if self.more is None else self.more()
        if line is None:
            return False
        self._before = self.position
        self.text, self.at, self._program = self.text[self.at :] + line, 0, None
        self._counted = (0, 0, -1)
        return True

    @property
    def position(self) -> Tuple[int, int, int]:
        """How many characters have been read, how many line ends, and how many characters of the line."""
        characters, lines, column = self._before
        at, counted, newline = self._counted
        if at > self.at:  # it was set back
            at, counted, newline = 0, 0, -1
        counted += self.text.count("\n", at, self.at)
        newline = max(newline, self.text.rfind("\n", at, self.at))
        self._counted = (self.at, counted, newline)
        column = column + self.at if newline < 0 else self.at - newline - 1
        return characters + self.at, lines + counted, column

    def go_to(self, characters: int) -> bool:
        """Go to where so many characters had been read; return whether that is still known."""
        at = characters - self._before[0]
        if not 0 <= at <= len(self.text):
            return False
        self.at, self.ended = at, False
        return True

    def read_end(self, take: bool) -> None:
        """Note that its end is read.

        Raises:
            PrologError: where it had been read before, and may not be read again.
        """
        if self.ended and self.eof_action == "error":
            raise permission_error("input", "past_end_of_stream", self.itself)
        self.ended = self.ended or take

    def character(self, take: bool) -> str:
        """Return the next character, "" at the end."""
        if self.at >= len(self.text) and not self._fill():
            self.read_end(take)
            return ""
        found = self.text[self.at]
        self.at += take
        return found

    def ahead(self, length: int) -> str:
        """Return so many of the next characters, fewer at the end; they stay."""
        while len(self.text) - self.at < length and self._fill():
            pass
        return self.text[self.at : self.at + length]

    @property
    def line(self) -> int:
        """The number of the line that it is in."""
        return self.position[1] + 1

    def term(self, operators: Operators, flags: ReadFlags) -> Union[ReadTerm, SyntaxFault, None]:
        """Read a term; return what is wrong where it does not read, and None at the end."""
        while True:
            found = self._term(operators, flags)
            if self.more is None or not self._goes_on(found) or not self._fill():
                self.at = self._next
                if found is None:
                    self.read_end(True)
                return found

    def _term(self, operators: Operators, flags: ReadFlags) -> Union[ReadTerm, SyntaxFault, None]:
        program = self._program
        if program is None or self._next != self.at:
            program = read_program(self.text[self.at :], operators, self.name, flags, self.line)
            self._program, self._base = program, self.at
        program.operators, program.flags = operators, flags
        before = program.end
        found = next(iter(program), None)
        self._next = self._base + program.end if program.end > before else len(self.text)
        if isinstance(found, SyntaxFault):
            self._program = None
        return found

    def _goes_on(self, found: Union[ReadTerm, SyntaxFault, None]) -> bool:
        """Tell whether more lines have to be seen."""
        rest = self.text[self.at :].rstrip()
        if found is None or not rest:
            return True
        if not isinstance(found, SyntaxFault) or rest.endswith("."):
            return False
        return found.place is None or found.place.line >= self.line + rest.count("\n")


class OutputStream:
    """A file that is written, a line at a time."""

    def __init__(self, name: str, mode: str, add: Callable[[str], None]):
        self.name = name
        self.asked = ""
        self.itself: Term = atom(name)
        self.kind = "text"
        self.mode = mode
        self.column = 0
        self._add = add
        self._held: List[str] = []
        self._size = 0

    def write(self, text: str) -> None:
        """Write a text."""
        self._held.append(text)
        self._size += len(text)
        if self._size > _HELD or "\n" in text:
            self.flush()

    def flush(self) -> None:
        """Write what has been held back."""
        text = "".join(self._held)
        self._held, self._size = [], 0
        if text:
            self._add(text)


class _Outer:
    """The output that a stream or a capture replaces, and its column."""

    __slots__ = ("output", "column")

    def __init__(self, output: Callable[[str], None], column: int):
        self.output = output
        self.column = column

    def write(self, text: str) -> None:
        """Write to it while it is replaced."""
        self.column = column_after(self.column, text)
        self.output(text)


def column_after(column: int, text: str) -> int:
    """Return the column behind a text that is written at a column."""
    newline = text.rfind("\n")
    return column + len(text) if newline < 0 else len(text) - newline - 1


class OutputCapture:
    """The output of a goal, kept as text.

    It replaces the current output of the program until `end` is called. Captures and streams that are set as current
    output nest: a capture remembers which stream was set before, so that each `end` gives back what it has replaced.

    Attributes:
        texts: the parts of the text.
        before: the output that it replaces.
        replaced: the output that the stream had replaced which was the current output before; None without one.
        itself: the term of its stream.
    """

    mode = "append"
    kind = "text"
    name = asked = ""

    def __init__(self, logic: MachineProgram):
        self.texts: List[str] = []
        self.before = _Outer(logic.output, logic.column)
        self._logic = logic
        self._streams = _streams(logic)
        self.itself: Term = self._streams.new_term()
        self._size = 0
        self._stream, self.replaced = self._streams.replace_current(None, None)
        logic.output, logic.column = self, 0

    def __call__(self, text: str) -> None:
        """Keep a text."""
        self._size += len(text)
        long_text(self._size)
        self.texts.append(text)

    def end(self) -> None:
        """Give the output back that was replaced."""
        logic = self._logic
        logic.output, logic.column = self.before.output, self.before.column
        self._streams.replace_current(self._stream, self.replaced)


def end_captures(logic: MachineProgram) -> None:
    """End all captures, and write to no stream any more: no goal runs."""
    while True:
        _streams(logic).set_output("user_output")
        if not isinstance(logic.output, OutputCapture):
            return
        logic.output.end()


OpenStream = Union[InputStream, OutputStream, OutputCapture]


class ProgramStreams:
    """The streams of a program."""

    def __init__(self, logic: MachineProgram):
        self._logic = logic
        self.opened: Dict[int, OpenStream] = {}
        self.aliases: Dict[str, int] = {}
        self.user = InputStream("user_input", more=self._ask)
        self.input = self.user
        self.output: Optional[OutputStream] = None
        self._outer: Optional[_Outer] = None
        self._number = 0

    def _ask(self) -> Optional[str]:
        ask = self._logic.ask
        return None if ask is None else ask()

    def open(
        self, name: Term, mode: str, alias: Optional[str] = None, kind: str = "text", encoding: str = "utf-8"
    ) -> Term:
        """Open a file; return the stream's term.

        Args:
            name: that of the file.
            mode: ``read``, ``write`` or ``append``.
            alias: a name for the stream.
            kind: ``text`` or ``binary``.
            encoding: how its characters are bytes; latin-1 for binary files.

        Raises:
            PrologError: where that is not allowed, or not there; and for too many.
        """
        files = self._logic.files
        if alias is not None and (alias in self.aliases or alias in _USER):
            raise permission_error("open", "source_sink", (functor("alias", 1), atom(alias)))
        if len(self.opened) >= MAX_OPEN_STREAMS:
            raise resource_error("streams", reason=f"{MAX_OPEN_STREAMS} streams are open; close/1 closes one")
        if files is None:
            raise permission_error("open", "source_sink", name, "there are no files")
        if mode == "read":
            stream: OpenStream = InputStream(*_text_of(files, name, encoding))
        else:
            path = files.to_write(name, mode == "append")
            stream = OutputStream(path, mode, lambda text: files.add(path, text, encoding))
        stream.itself, stream.kind = self.new_term(), kind
        self.opened[self._number] = stream
        if alias is not None:
            self.aliases[alias] = self._number
        return stream.itself

    def new_term(self) -> Term:
        """Return the term of one more stream."""
        self._number += 1
        return (_STREAM, self._number)

    def term_of(self, stream: OpenStream) -> Term:
        """Return the term of a stream."""
        return stream.itself

    def find(self, term: Term) -> Union[OpenStream, str]:
        """Return the stream that a term or alias names; the name itself for the streams that are always there.

        Raises:
            PrologError: where there is none.
        """
        term = deref(term)
        number: Optional[int] = None
        if term.__class__ is Var:
            raise instantiation_error()
        if isinstance(term, Atom):
            number = self.aliases.get(term.name)
            if number is None and term.name in (*_USER, "user", "current_output"):
                return term.name
        elif isinstance(term, tuple) and term[0] is _STREAM:
            for capture in self._captures():
                if capture.itself == term:
                    return capture
            at = deref(term[1])
            number = at if isinstance(at, int) else None
        else:
            raise domain_error("stream_or_alias", term)
        found = None if number is None else self.opened.get(number)
        if found is None:
            raise existence_error("stream", term)
        return found

    def find_open(self, term: Term) -> OpenStream:
        """Return a stream that has been opened, by its term."""
        found = self.find(term)
        assert not isinstance(found, str)
        return found

    def to_read(self, term: Optional[Term]) -> InputStream:
        """Return a stream that is read; the current one for None.

        Raises:
            PrologError: where it is none.
        """
        if term is None:
            return self.input
        found = self.find(term)
        if found in ("user_input", "user"):
            return self.user
        if not isinstance(found, InputStream):
            raise permission_error("input", "stream", deref(term))
        return found

    def to_write(self, term: Term) -> Union[OutputStream, OutputCapture, str]:
        """Return a stream that is written, by its name where it is always there.

        Raises:
            PrologError: where it is none.
        """
        found = self.find(term)
        if found == "user_input" or isinstance(found, InputStream):
            raise permission_error("output", "stream", deref(term))
        return found

    def write(self, term: Term, text: str) -> None:
        """Write a text to a stream."""
        found, logic = self.to_write(term), self._logic
        if found == "user_error":
            logic.error_output(text)
        elif found == "current_output" or found is self.output or found is logic.output:
            logic.write(text)
        elif isinstance(found, OutputStream):
            found.column = column_after(found.column, text)
            found.write(text)
        else:
            outer = self._outer_of(found)
            if outer is None:
                logic.write(text)
            else:
                outer.write(text)

    def column(self, stream: Union[OutputStream, OutputCapture, str]) -> int:
        """Return how many characters of the last line of an output have been written."""
        logic = self._logic
        if stream == "current_output" or stream is self.output or stream is logic.output:
            return logic.column
        if isinstance(stream, OutputStream):
            return stream.column
        outer = self._outer_of(stream)
        return logic.column if outer is None else outer.column

    def _outer_of(self, stream: Union[OutputCapture, str]) -> Optional[_Outer]:
        """Return a capture, or with a name the output of the user, where something replaces it; None otherwise."""
        outers = list(self._outers())
        if isinstance(stream, OutputCapture):
            return next((outer for outer in outers if outer.output is stream), None)
        return outers[-1] if outers else None

    def _outers(self) -> Iterator[_Outer]:
        """Yield the outputs that streams and captures replace, the innermost first; the last one is the user's."""
        output = self._logic.output
        if self._outer is not None:
            yield self._outer
            output = self._outer.output
        while isinstance(output, OutputCapture):
            outer = output.replaced or output.before
            yield outer
            output = outer.output

    def _captures(self) -> Iterator[OutputCapture]:
        """Yield the captures under way, the innermost first."""
        for output in (self._logic.output, *(outer.output for outer in self._outers())):
            if isinstance(output, OutputCapture):
                yield output

    def current_output(self) -> Term:
        """Return the term of the stream that is written."""
        capture = self._logic.output
        if isinstance(capture, OutputCapture):
            return capture.itself
        return atom("user_output") if self.output is None else self.output.itself

    def replace_current(
        self, stream: Optional[OutputStream], outer: Optional[_Outer]
    ) -> Tuple[Optional[OutputStream], Optional[_Outer]]:
        """Set the stream that is the current output, and what that replaces; return both from before."""
        before = self.output, self._outer
        self.output, self._outer = stream, outer
        return before

    def set_output(self, stream: Union[OutputStream, OutputCapture, str]) -> None:
        """Have what the program writes go to a stream."""
        logic = self._logic
        if stream is logic.output:
            return
        if self.output is not None and self._outer is not None:
            self.output.column = logic.column
            logic.output, logic.column = self._outer.output, self._outer.column
            self.output = self._outer = None
        if isinstance(stream, OutputStream):
            self._outer = _Outer(logic.output, logic.column)
            self.output = stream
            logic.output, logic.column = stream.write, stream.column

    def close(self, stream: OpenStream) -> None:
        """Close a stream; the current ones are those of before then."""
        if isinstance(stream, OutputCapture):
            return
        if stream is self.input:
            self.input = self.user
        if stream is self.output:
            self.set_output("user_output")
        for number, one in list(self.opened.items()):
            if one is stream:
                del self.opened[number]
                self.aliases = {alias: at for alias, at in self.aliases.items() if at != number}
        if isinstance(stream, OutputStream):
            stream.flush()

    def mend(self) -> None:
        """Close all: the goal that had opened them has been interrupted."""
        self.set_output("user_output")
        self.input = self.user
        self.opened.clear()
        self.aliases.clear()


def _text_of(files: StreamFiles, name: Term, encoding: str) -> Tuple[str, str]:
    """Return the path of a file and its text; where there is none, the error has the name as the program has it."""
    try:
        return files.to_read(name, encoding)
    except PrologError as error:
        ball: Any = error.term
        if isinstance(ball[1], tuple) and ball[1][0].name == "existence_error":
            raise existence_error("source_sink", name, ball[2]) from error
        raise


def is_stream_term(term: Term) -> bool:
    """Tell whether a term is that of a stream, open or not."""
    return isinstance(term, tuple) and term[0] is _STREAM


def streams_of(machine: Machine) -> ProgramStreams:
    """Return the streams of the program that a machine runs."""
    return _streams(machine.logic)


def _streams(logic: MachineProgram) -> ProgramStreams:
    found: Optional[ProgramStreams] = logic.state.get("streams")
    if found is None:
        found = logic.state["streams"] = ProgramStreams(logic)
    return found


def syntax_error_in(stream: InputStream, term: Term, fault: SyntaxFault) -> PrologError:
    """Return the error for a term of a stream that does not read."""
    line, column = (0, 0) if fault.place is None else (fault.place.line, fault.place.column)
    return PrologError((ERROR, (_SYNTAX, atom(fault.message)), (_AT, term, line, column - 1, stream.at)))


_POSITION = functor("$stream_position", 4)
_STANDARD = ("user_input", "user_output", "user_error")
_WITHOUT_VALUE = ("input", "output")
_WITH_VALUE = (
    *("alias", "buffer", "encoding", "end_of_stream", "eof_action", "file_name", "mode", "newline"),
    *("position", "reposition", "tty", "type"),
)


@deterministic("is_stream/1")
def is_stream(machine: Machine, term: Term) -> bool:
    """Succeed for a stream that is open."""
    try:
        streams_of(machine).find(term)
    except PrologError:
        return False
    return True


@nondeterministic("stream_property/2")
def stream_property(machine: Machine, stream: Term, wanted: Term) -> Solutions:
    """Enumerate the streams that are open, and what is known of them."""
    streams, stream = streams_of(machine), deref(stream)
    _require_property(deref(wanted))
    if stream.__class__ is Var:
        asked: List[Tuple[Term, Union[OpenStream, str]]] = [(atom(name), name) for name in _STANDARD]
        asked += [(one.itself, one) for one in list(streams.opened.values())]
    elif is_stream_term(stream):
        asked = [(stream, streams.find(stream))]
    else:
        asked = [(stream, _standard(streams, stream))]
    for term, one in asked:
        for found in _properties(streams, one):
            if machine.unify_all((stream, term), (wanted, found)):
                yield None


def _standard(streams: ProgramStreams, stream: Term) -> str:
    """Return the name of a stream that is always there: no other alias is a stream's term."""
    try:
        found = streams.find(stream)
    except PrologError:
        raise domain_error("stream", stream) from None
    if not isinstance(found, str):
        raise domain_error("stream", stream)
    return found


def _require_property(wanted: Term) -> None:
    """Accept a property, or a variable.

    Raises:
        PrologError: a domain error for what is none.
    """
    if wanted.__class__ is Var:
        return
    if isinstance(wanted, tuple):
        known = len(wanted) == 2 and wanted[0].name in _WITH_VALUE
    else:
        known = wanted in [atom(name) for name in _WITHOUT_VALUE]
    if not known:
        raise domain_error("stream_property", wanted)


def _properties(streams: ProgramStreams, stream: Union[OpenStream, str]) -> Iterator[Term]:
    if stream == "user_input":
        stream = streams.user
    is_input = isinstance(stream, InputStream)
    mode = "append" if isinstance(stream, str) else stream.mode
    yield atom("input" if is_input else "output")
    yield _of("mode", mode)
    if isinstance(stream, str):
        yield _of("alias", stream)
    elif stream is streams.user:
        yield _of("alias", stream.name)
    elif not isinstance(stream, OutputCapture):
        yield _of("file_name", stream.name)
        for alias, number in list(streams.aliases.items()):
            if streams.opened.get(number) is stream:
                yield _of("alias", alias)
    if isinstance(stream, InputStream):
        yield _of("eof_action", stream.eof_action)
        if stream is not streams.user:
            yield _of("end_of_stream", _end(stream))
        yield (functor("position", 1), _position(stream))
        yield _of("reposition", "false" if stream is streams.user else "true")
    yield _of("type", "text" if isinstance(stream, str) else stream.kind)


def _of(name: str, value: str) -> CompoundTerm:
    return (functor(name, 1), atom(value))


def _end(stream: InputStream) -> str:
    if stream.at < len(stream.text):
        return "not"
    return "past" if stream.ended else "at"


def _position(stream: InputStream) -> CompoundTerm:
    characters, lines, column = stream.position
    return (_POSITION, characters, lines + 1, column, characters)


@deterministic("set_stream_position/2")
def set_stream_position(machine: Machine, stream: Term, position: Term) -> bool:
    """Go on reading where a stream was when that was its position."""
    position = deref(position)
    if position.__class__ is Var or deref(stream).__class__ is Var:
        raise instantiation_error()
    found = streams_of(machine).find(stream)
    characters = deref(position[1]) if isinstance(position, tuple) and position[0] is _POSITION else None
    if not isinstance(characters, int):
        raise domain_error("stream_position", position)
    if not isinstance(found, InputStream) or not found.go_to(characters):
        raise permission_error("reposition", "stream", deref(stream))
    return True


@deterministic("line_count/2")
def line_count(machine: Machine, stream: Term, line: Term) -> bool:
    """Give the number of the line that is read next."""
    return unify(line, streams_of(machine).to_read(stream).line, machine.trail)


@deterministic("line_position/2")
def line_position(machine: Machine, stream: Term, column: Term) -> bool:
    """Give how many characters of the line have been read or written."""
    streams = streams_of(machine)
    found = streams.find(stream)
    if found == "user_input" or isinstance(found, InputStream):
        at = streams.to_read(stream).position[2]
    else:
        at = streams.column(found)
    return unify(column, at, machine.trail)


@deterministic("character_count/2")
def character_count(machine: Machine, stream: Term, count: Term) -> bool:
    """Give how many characters have been read."""
    return unify(count, streams_of(machine).to_read(stream).position[0], machine.trail)
