"""Input: a program has none, so every stream of it is at its end."""

from ..machine import domain_error, existence_error, instantiation_error, permission_error
from ..terms import Atom, Term, Var, atom, deref, unify
from .arguments import option_values
from .program import Machine, Solutions
from .registry import deterministic, nondeterministic

_END = atom("end_of_file")
_INPUT, _OUTPUT, _ERROR = (atom(name) for name in ("user_input", "user_output", "user_error"))


def _check(stream: Term) -> None:
    """Raise an error for what is not an input stream."""
    stream = deref(stream)
    if stream.__class__ is Var:
        raise instantiation_error()
    if stream.__class__ is not Atom:
        raise domain_error("stream_or_alias", stream)
    if stream in (_OUTPUT, _ERROR):
        raise permission_error("input", "stream", stream)
    if stream is not _INPUT:
        raise existence_error("stream", stream)


def _define(names: str, end: Term) -> None:
    for name in names.split():

        @deterministic(f"{name}/1")
        def read(machine: Machine, value: Term) -> bool:
            return unify(value, end, machine.trail)

        @deterministic(f"{name}/2")
        def read_from(machine: Machine, stream: Term, value: Term) -> bool:
            _check(stream)
            return unify(value, end, machine.trail)


_define("read get_char peek_char", _END)
_define("get_code peek_code get_byte peek_byte", -1)


@deterministic("read_term/2")
def read_term(machine: Machine, term: Term, options: Term) -> bool:
    """Find the end of input."""
    option_values(options)
    return unify(term, _END, machine.trail)


@deterministic("read_term/3")
def read_term_from(machine: Machine, stream: Term, term: Term, options: Term) -> bool:
    """Find the end of input."""
    _check(stream)
    return read_term(machine, term, options)


@deterministic("at_end_of_stream/0")
def at_end(machine: Machine) -> bool:
    """Succeed: there is no input."""
    return True


@deterministic("at_end_of_stream/1")
def at_end_of(machine: Machine, stream: Term) -> bool:
    """Succeed for the input stream."""
    _check(stream)
    return True


@nondeterministic("current_input/1")
def current_input(machine: Machine, stream: Term) -> Solutions:
    """Give the alias of the input stream."""
    if machine.unify(stream, _INPUT):
        yield None


@nondeterministic("current_output/1")
def current_output(machine: Machine, stream: Term) -> Solutions:
    """Give the alias of the output stream."""
    if machine.unify(stream, _OUTPUT):
        yield None
