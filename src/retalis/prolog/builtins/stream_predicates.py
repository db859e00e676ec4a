"""Predicates that open and close streams, select the current ones, and read terms, characters and bytes.

Streams are those of ISO 13211-1 (8.11 to 8.14), with the Edinburgh predicates ``see/1`` and ``tell/1``. The streams
themselves are in `text_streams`.
"""

from typing import Callable, List, Optional

from ...foundation.errors import SyntaxFault
from ...foundation.limit_checks import check_limits
from ..machine.errors import (
    domain_error,
    instantiation_error,
    permission_error,
    representation_error,
    type_error,
    uninstantiation_error,
)
from ..terms.types import Atom, CompoundTerm, String, Term, Var, atom, deref
from ..terms.unification import unify
from .argument_checks import atom_of, natural, option_values
from .builtin_registry import ProgramMachine, deterministic
from .output_predicates import character_of
from .text_arguments import MAX_CODE, end_of_file, flags_of, unify_options
from .text_streams import InputStream, OutputStream, flush_standard_streams, streams_of, syntax_error_in

_END_OF_FILE = atom("end_of_file")


# Streams


@deterministic("open/3")
def open_stream(machine: ProgramMachine, name: Term, mode: Term, stream: Term) -> bool:
    """Open a file for reading, writing or appending."""
    return _open(machine, name, mode, stream, [])


@deterministic("open/4")
def open_with(machine: ProgramMachine, name: Term, mode: Term, stream: Term, options: Term) -> bool:
    """Open a file with the options ``alias``, ``type``, ``encoding`` and ``eof_action``; others are ignored."""
    return _open(machine, name, mode, stream, option_values(options))


def _open(machine: ProgramMachine, name: Term, mode: Term, stream: Term, options: List[Term]) -> bool:
    stream_mode, values = _parse_mode(mode), dict(_OPEN_OPTIONS)
    if deref(name).__class__ is Var:
        raise instantiation_error()
    # The order of these checks is that of ISO 13211-1, 8.11.5.3.
    if deref(stream).__class__ is not Var:
        raise uninstantiation_error(deref(stream))
    for option in options:
        if not isinstance(option, tuple) or len(option) != 2:
            raise domain_error("stream_option", option)
        if option[0].name in values:
            values[option[0].name] = atom_of(option[1]).name
    stream_type, encoding, eof_action = values["type"], values["encoding"], values["eof_action"]
    if stream_type not in ("text", "binary") or eof_action not in ("", "error", "eof_code", "reset"):
        raise domain_error("stream_option", options[-1])
    streams = streams_of(machine)
    # Latin-1 maps each byte to the character with its code, so binary streams need no second implementation.
    python_encoding = "latin-1" if stream_type == "binary" else _PYTHON_ENCODINGS.get(encoding, "utf-8")
    open_stream = streams.open(
        deref(name), stream_mode, values["alias"] or None, stream_type, python_encoding
    )
    source = streams.find_open(open_stream)
    # The default depends on the stream: a terminal is read again after its end, a file is not.
    if eof_action and isinstance(source, InputStream):
        source.eof_action = eof_action
    return unify(stream, open_stream, machine.trail)


def _parse_mode(term: Term) -> str:
    """Return the mode of a stream: ``read``, ``write`` or ``append``.

    Raises:
        PrologError: an instantiation, type or domain error.
    """
    mode = atom_of(term)
    if mode.name not in ("read", "write", "append"):
        raise domain_error("io_mode", mode)
    return mode.name


_OPEN_OPTIONS = {"alias": "", "type": "text", "encoding": "", "eof_action": ""}
"""Options of ``open/4`` that have an effect, with their defaults."""

_PYTHON_ENCODINGS = {"octet": "latin-1", "iso_latin_1": "latin-1", "ascii": "latin-1"}


@deterministic("close/1")
def close(machine: ProgramMachine, stream: Term) -> bool:
    """Close a stream; standard streams stay open."""
    streams = streams_of(machine)
    open_stream = streams.find(stream)
    # `find` returns the name of a standard stream.
    if not isinstance(open_stream, str):
        streams.close(open_stream)
    return True


@deterministic("close/2")
def close_with(machine: ProgramMachine, stream: Term, options: Term) -> bool:
    """Close a stream; the option ``force`` has no effect."""
    for option in option_values(options):
        if not isinstance(option, tuple) or option[0].name != "force":
            raise domain_error("close_option", option)
    return close(machine, stream)


@deterministic("set_input/1")
def set_input(machine: ProgramMachine, stream: Term) -> bool:
    """Set the current input."""
    streams = streams_of(machine)
    streams.input = streams.find_input(stream)
    return True


@deterministic("set_output/1")
def set_output(machine: ProgramMachine, stream: Term) -> bool:
    """Set the current output."""
    streams = streams_of(machine)
    streams.set_output(streams.find_output(stream))
    return True


@deterministic("see/1")
def see(machine: ProgramMachine, name: Term) -> bool:
    """Set the current input to a stream or a file."""
    return set_input(machine, _open_by_name(machine, name, "read"))


@deterministic("tell/1")
def tell(machine: ProgramMachine, name: Term) -> bool:
    """Set the current output to a stream or a file."""
    return set_output(machine, _open_by_name(machine, name, "write"))


@deterministic("append/1")
def append(machine: ProgramMachine, name: Term) -> bool:
    """Set the current output to a file, to which text is appended."""
    return set_output(machine, _open_by_name(machine, name, "append"))


def _open_by_name(machine: ProgramMachine, name: Term, mode: str) -> Term:
    """Return a stream term for a stream term, an alias, or the name of a file, which is opened if necessary."""
    streams, name = streams_of(machine), deref(name)
    if isinstance(name, tuple) and name[0].name == "$stream":
        return name
    alias = atom_of(name).name if name.__class__ is Atom else ""
    if alias in streams.aliases or alias in ("user", "user_input", "user_output", "user_error"):
        return name
    # A file that was opened by `see` or `tell` before is continued, not opened again (Edinburgh input and output).
    streams_by_name = {
        open_stream.opening_name: open_stream
        for open_stream in streams.open_streams.values()
        if open_stream.mode == mode
    }
    if alias in streams_by_name:
        return streams_by_name[alias].stream_term
    open_stream = streams.open(name, mode)
    streams.find_open(open_stream).opening_name = alias
    return open_stream


@deterministic("seen/0")
def seen(machine: ProgramMachine) -> bool:
    """Close the current input, and set it to the user's."""
    streams = streams_of(machine)
    if streams.input is not streams.user_input:
        streams.close(streams.input)
    return True


@deterministic("told/0")
def told(machine: ProgramMachine) -> bool:
    """Close the current output, and set it to the user's."""
    streams = streams_of(machine)
    if streams.output is not None:
        streams.close(streams.output)
    return True


def _require_stream(machine: ProgramMachine, stream: Term) -> None:
    """Check that a term is an open stream or a variable.

    Raises:
        PrologError: for any other term.
    """
    if deref(stream).__class__ is not Var:
        streams_of(machine).find(stream)


@deterministic("current_input/1", "seeing/1")
def current_input(machine: ProgramMachine, stream: Term) -> bool:
    """Unify with the current input."""
    _require_stream(machine, stream)
    return unify(stream, streams_of(machine).input.stream_term, machine.trail)


@deterministic("current_output/1", "telling/1")
def current_output(machine: ProgramMachine, stream: Term) -> bool:
    """Unify with the current output."""
    _require_stream(machine, stream)
    streams = streams_of(machine)
    return unify(stream, streams.current_output(), machine.trail)


@deterministic("flush_output/1")
def flush_output_of(machine: ProgramMachine, stream: Term) -> bool:
    """Write the buffered text of a stream to its file."""
    open_stream = streams_of(machine).find_output(stream)
    if isinstance(open_stream, OutputStream):
        open_stream.flush()
    else:
        flush_standard_streams(machine.budget)
    return True


@deterministic("set_stream/2")
def set_stream(machine: ProgramMachine, stream: Term, setting: Term) -> bool:
    """Set a property of a stream; properties other than ``alias`` are ignored."""
    streams, property_term = streams_of(machine), deref(setting)
    open_stream = streams.find(stream)
    if (
        isinstance(property_term, tuple)
        and property_term[0].name == "alias"
        and not isinstance(open_stream, str)
    ):
        number = next(
            number for number, candidate in streams.open_streams.items() if candidate is open_stream
        )
        streams.aliases[atom_of(property_term[1]).name] = number
    return True


# Terms


def _read(machine: ProgramMachine, stream: Optional[Term], options: List[CompoundTerm], term: Term) -> bool:
    source = streams_of(machine).find_input(stream)
    result = source.read_term(machine.logic.operators, flags_of(machine, options))
    # The reader has skipped the invalid term, so the next read continues after it.
    if isinstance(result, SyntaxFault):
        raise syntax_error_in(source, source.stream_term, result)
    if result is None:
        result = end_of_file(machine)
    return unify(term, result.term, machine.trail) and unify_options(machine, result, options)


@deterministic("read/1")
def read(machine: ProgramMachine, term: Term) -> bool:
    """Read a term from the current input."""
    return _read(machine, None, [], term)


@deterministic("read/2")
def read_from(machine: ProgramMachine, stream: Term, term: Term) -> bool:
    """Read a term from a stream."""
    return _read(machine, stream, [], term)


@deterministic("read_term/2")
def read_term(machine: ProgramMachine, term: Term, options: Term) -> bool:
    """Read a term from the current input with options."""
    return _read(machine, None, _compound_options(options), term)


@deterministic("read_term/3")
def read_term_from(machine: ProgramMachine, stream: Term, term: Term, options: Term) -> bool:
    """Read a term from a stream with options."""
    requested = _compound_options(options)
    return _read(machine, stream, requested, term)


def _compound_options(options: Term) -> List[CompoundTerm]:
    values = option_values(options)
    return [option for option in values if isinstance(option, tuple)]


# Characters


def _define_reader(
    name: str, is_consumed: bool, to_term: Callable[[str], Term], check_output: Callable[[Term], None]
) -> None:
    """Define a predicate such as ``get_char``, with one argument and with two.

    Args:
        name: the name of the predicate.
        is_consumed: whether it consumes the character.
        to_term: converts a character to a term; "" is the end of the stream.
        check_output: raises an error for an invalid output argument.
    """
    stream_type = "binary" if name.endswith("byte") else "text"

    def read_character(machine: ProgramMachine, source: InputStream, value: Term) -> bool:
        # Checked before a character is consumed, so that an error loses no input.
        check_output(deref(value))
        _require_type(source, stream_type)
        return unify(value, to_term(source.read_character(is_consumed)), machine.trail)

    @deterministic(f"{name}/1")
    def one_argument(machine: ProgramMachine, value: Term) -> bool:
        return read_character(machine, streams_of(machine).input, value)

    @deterministic(f"{name}/2")
    def two_arguments(machine: ProgramMachine, stream: Term, value: Term) -> bool:
        return read_character(machine, streams_of(machine).find_input(stream), value)


def _require_type(source: InputStream, stream_type: str) -> None:
    """Check that a stream is binary if bytes are read from it. Characters may be read from any stream.

    Raises:
        PrologError: a permission error for a text stream.
    """
    if stream_type == "binary" and source.stream_type == "text":
        raise permission_error("input", "text_stream", source.stream_term)


def _to_code(character: str) -> Term:
    return ord(character) if character else -1


def _to_atom(character: str) -> Term:
    return atom(character) if character else _END_OF_FILE


def _check_character(value: Term) -> None:
    if value.__class__ is not Var and not (
        isinstance(value, Atom) and (len(value.name) == 1 or value is _END_OF_FILE)
    ):
        raise type_error("character", value)


def _check_code(value: Term) -> None:
    if value.__class__ is Var:
        return
    if value.__class__ is not int:
        raise type_error("integer", value)
    if not -1 <= value <= MAX_CODE:
        raise representation_error("character_code")


def _check_byte(value: Term) -> None:
    if value.__class__ is not Var and not (isinstance(value, int) and -1 <= value <= 255):
        raise type_error("in_byte", value)


for _name, _to_term, _check in (
    ("char", _to_atom, _check_character),
    ("code", _to_code, _check_code),
    ("byte", _to_code, _check_byte),
):
    _define_reader(f"get_{_name}", True, _to_term, _check)
    _define_reader(f"peek_{_name}", False, _to_term, _check)


@deterministic("peek_string/3")
def peek_string(machine: ProgramMachine, stream: Term, length: Term, text: Term) -> bool:
    """Unify with the next characters of a stream, without consuming them."""
    source, count = streams_of(machine).find_input(stream), natural(length)
    return unify(text, String(source.peek_text(count)), machine.trail)


@deterministic("get0/1")
def get_any(machine: ProgramMachine, code: Term) -> bool:
    """Read the code of a character."""
    return unify(code, _to_code(streams_of(machine).input.read_character(True)), machine.trail)


@deterministic("get/1")
def get_visible(machine: ProgramMachine, code: Term) -> bool:
    """Read the code of the next character that is not white space."""
    source = streams_of(machine).input
    char = source.read_character(True)
    while char and char.isspace():
        char = source.read_character(True)
    return unify(code, _to_code(char), machine.trail)


@deterministic("skip/1")
def skip(machine: ProgramMachine, character: Term) -> bool:
    """Read up to and including a character."""
    return _skip(machine, None, character)


@deterministic("skip/2")
def skip_in(machine: ProgramMachine, stream: Term, character: Term) -> bool:
    """Read up to and including a character of a stream."""
    return _skip(machine, stream, character)


def _skip(machine: ProgramMachine, stream: Optional[Term], character: Term) -> bool:
    source, stop = streams_of(machine).find_input(stream), character_of(machine, character)
    steps = 0
    while source.read_character(True) not in (stop, ""):
        steps += 1
        # The whole input may be skipped in one step of the machine.
        if not steps & 1023:
            check_limits()
    return True


@deterministic("at_end_of_stream/0")
def at_end(machine: ProgramMachine) -> bool:
    """Test for the end of the current input."""
    return not streams_of(machine).input.read_character(False)


@deterministic("at_end_of_stream/1")
def at_end_of(machine: ProgramMachine, stream: Term) -> bool:
    """Test for the end of a stream."""
    return not streams_of(machine).find_input(stream).read_character(False)
