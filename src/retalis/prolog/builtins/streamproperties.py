"""What is known of streams: properties, positions, lines and columns."""

from typing import Iterator, List, Tuple, Union

from ..machine import PrologError, domain_error, instantiation_error, permission_error
from ..terms import CompoundTerm, Term, Var, atom, deref, functor, unify
from .program import Machine, Solutions
from .registry import deterministic, nondeterministic
from .streams import InputStream, OpenStream, OutputCapture, ProgramStreams, is_stream_term, streams_of

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
