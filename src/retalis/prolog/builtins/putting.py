"""Output of single characters by their codes, and of bytes."""

from typing import Union

from ..machine import instantiation_error, permission_error, representation_error, type_error
from ..terms import Term, Var, atom, deref
from .arguments import integer
from .output import write_to
from .program import Machine
from .registry import deterministic
from .streams import OutputCapture, OutputStream, streams_of
from .text import LARGEST_CODE


def _code_of(code: Term) -> str:
    found = integer(code)
    if not 0 <= found <= LARGEST_CODE:
        raise representation_error("character_code")
    return chr(found)


@deterministic("put_code/1")
def put_code(machine: Machine, code: Term) -> bool:
    """Write a character by its code."""
    machine.logic.write(_code_of(code))
    return True


@deterministic("put_code/2")
def put_code_to(machine: Machine, stream: Term, code: Term) -> bool:
    """Write a character by its code to a stream."""
    write_to(machine, stream, _code_of(code))
    return True


def _put_byte(stream: Union[OutputStream, OutputCapture, str, None], named: Term, byte: Term) -> bool:
    byte = deref(byte)
    if byte.__class__ is Var:
        raise instantiation_error()
    if not isinstance(byte, int) or not 0 <= byte <= 255:
        raise type_error("byte", byte)
    if not isinstance(stream, OutputStream) or stream.kind != "binary":
        raise permission_error("output", "text_stream", deref(named))
    stream.write(chr(byte))
    return True


@deterministic("put_byte/1")
def put_byte(machine: Machine, byte: Term) -> bool:
    """Write a byte to a binary file."""
    return _put_byte(streams_of(machine).output, atom("current_output"), byte)


@deterministic("put_byte/2")
def put_byte_to(machine: Machine, stream: Term, byte: Term) -> bool:
    """Write a byte to a binary file."""
    return _put_byte(streams_of(machine).to_write(stream), stream, byte)
