"""Predicates that write terms, formatted text, characters and bytes, and capture output as text.

Each predicate writes to the current output or, with one more argument, to a stream. Captures (``with_output_to/2``)
are ended by a guard on the stack of choice points, so that an exception restores the output too.
"""

from typing import Any, Callable, Dict, List, Optional, Union

from ...foundation.limit_checks import check_limits
from ..machine.arithmetic import evaluate
from ..machine.errors import (
    domain_error,
    existence_error,
    instantiation_or_type_error,
    permission_error,
    representation_error,
    resource_error,
    type_error,
)
from ..machine.machine import Code, Guard
from ..syntax.term_writer import write_term
from ..terms.list_terms import list_items, make_list
from ..terms.term_traversal import resolve
from ..terms.types import CONS, NIL, Atom, CompoundTerm, Frame, String, Term, Values, Var, atom, deref
from ..terms.unification import unify
from .argument_checks import bound, integer, is_iso, option_values
from .builtin_registry import ProgramMachine, control, deterministic
from .format_strings import Formatter, make_portray, print_to_text
from .text_arguments import (
    MAX_CODE,
    check_text_length,
    fill_sink,
    is_sink,
    join_texts,
    make_text,
    read_with_options,
    text_of,
    whole_text,
)
from .text_streams import (
    OutputCapture,
    OutputStream,
    flush_standard_streams,
    is_stream_term,
    streams_of,
)

_ELLIPSIS = atom("...")
_MAX_TERM_DEPTH = 200
"""Limit for the recursion of `limit_depth`. Parts that are deeper are written in full, except for long lists."""


def limit_depth(term: Term, max_depth: int, depth: int = 1) -> Term:
    """Return a term with ``...`` for parts at a greater depth than ``max_depth``.

    The depth of an item of a list is its position, as in SWI-Prolog, which shortens long lists.
    """
    term = deref(term)
    if depth > max_depth:
        return _ELLIPSIS
    if term.__class__ is not tuple or depth > _MAX_TERM_DEPTH:
        return term
    # Arguments are one level deeper than the term.
    if term[0] is not CONS:
        return (term[0], *[limit_depth(argument, max_depth, depth + 1) for argument in term[1:]])
    items: List[Term] = []
    remaining: Any = term
    while remaining.__class__ is tuple and remaining[0] is CONS:
        items.append(limit_depth(remaining[1], max_depth, min(depth, _MAX_TERM_DEPTH) + 1))
        depth += 1
        remaining = deref(remaining[2])
        if remaining is NIL:
            return make_list(items)
        if depth >= max_depth:
            return make_list(items, _ELLIPSIS)
    return make_list(items, limit_depth(remaining, max_depth, min(depth, _MAX_TERM_DEPTH) + 1))


_MAX_BLANKS = 10_000_000
"""Limit for the blanks that ``tab/1`` writes."""


def write_to(machine: ProgramMachine, stream: Term, text: str) -> None:
    """Write text to a stream.

    Raises:
        PrologError: if it is not an output stream.
    """
    streams_of(machine).write(stream, text)


def _writer(**options: bool) -> Callable[[ProgramMachine, Term], str]:
    """Return a function that returns the text of a term, written with some options."""

    def write(machine: ProgramMachine, term: Term) -> str:
        return write_term(term, machine.logic.operators, **options)

    return write


def make_variable_names(term: Term) -> Dict[Var, str]:
    """Return new names for the variables of a term: A, B, ..., or ``_`` for those that occur once."""
    counts: Dict[Var, int] = {}
    # Resolved first, so that the walk meets no bound variables and no cycles.
    stack = [resolve(term)]
    steps = 0
    while stack:
        steps += 1
        if not steps & 1023:
            check_limits()
        item = stack.pop()
        if item.__class__ is Var:
            counts[item] = counts.get(item, 0) + 1
        elif item.__class__ is tuple:
            stack.extend(item[:0:-1])
    names: Dict[Var, str] = {}
    number = 0
    for var, count in counts.items():
        if count == 1:
            names[var] = "_"
        else:
            names[var] = chr(65 + number % 26) + (str(number // 26) if number > 25 else "")
            number += 1
    return names


def _canonical_text(machine: ProgramMachine, term: Term) -> str:
    operators = machine.logic.operators
    names = make_variable_names(term)
    return write_term(term, operators, ignore_ops=True, brace_terms=False, variable_names=names)


_WRITERS: Dict[str, Callable[[ProgramMachine, Term], str]] = {
    "write": _writer(quoted=False, numbervars=True),
    "print": print_to_text,
    "writeln": _writer(quoted=False, numbervars=True),
    "writeq": _writer(quoted=True, numbervars=True),
    "write_canonical": _canonical_text,
}


def _define_writer(name: str, to_text: Callable[[ProgramMachine, Term], str]) -> None:
    """Define a predicate such as ``write``, with one argument and, for a stream, with two."""
    end = "\n" if name == "writeln" else ""

    def one_argument(machine: ProgramMachine, term: Term) -> bool:
        machine.logic.write(to_text(machine, term) + end)
        return True

    def two_arguments(machine: ProgramMachine, stream: Term, term: Term) -> bool:
        write_to(machine, stream, to_text(machine, term) + end)
        return True

    deterministic(f"{name}/1")(one_argument)
    deterministic(f"{name}/2")(two_arguments)


for _name, _to_text in _WRITERS.items():
    _define_writer(_name, _to_text)


@deterministic("nl/0")
def nl(machine: ProgramMachine) -> bool:
    """Write a newline."""
    machine.logic.write("\n")
    return True


@deterministic("nl/1")
def nl_to(machine: ProgramMachine, stream: Term) -> bool:
    """Write a newline to a stream."""
    write_to(machine, stream, "\n")
    return True


def _blanks(count: Term) -> str:
    # SWI-Prolog evaluates the argument, so expressions are accepted.
    number = evaluate(count)
    if not isinstance(number, int):
        raise type_error("integer_expression", deref(count))
    if number > _MAX_BLANKS:
        raise resource_error("memory")
    check_text_length(number)
    return " " * number


@deterministic("tab/1")
def tab(machine: ProgramMachine, count: Term) -> bool:
    """Write blanks."""
    machine.logic.write(_blanks(count))
    return True


@deterministic("tab/2")
def tab_to(machine: ProgramMachine, stream: Term, count: Term) -> bool:
    """Write blanks to a stream."""
    write_to(machine, stream, _blanks(count))
    return True


def character_of(machine: ProgramMachine, char: Term) -> str:
    """Return the character of an argument; a character code is accepted too, unless the flag ``iso`` is set.

    Raises:
        PrologError: an instantiation or type error.
    """
    value = bound(char)
    if value.__class__ is int and not is_iso(machine) and 0 <= value <= MAX_CODE:
        return chr(value)
    if value.__class__ is not Atom or len(value.name) != 1:
        raise type_error("character", value)
    return str(value.name)


@deterministic("put_char/1", "put/1")
def put_char(machine: ProgramMachine, char: Term) -> bool:
    """Write a character."""
    machine.logic.write(character_of(machine, char))
    return True


@deterministic("put_char/2")
def put_char_to(machine: ProgramMachine, stream: Term, char: Term) -> bool:
    """Write a character to a stream."""
    write_to(machine, stream, character_of(machine, char))
    return True


@deterministic("flush_output/0", "ttyflush/0")
def flush_output(machine: ProgramMachine) -> bool:
    """Write the buffered text of the current output to its file."""
    output = streams_of(machine).output
    if output is None:
        flush_standard_streams(machine.budget)
    else:
        output.flush()
    return True


# Writing with options


def write_options(machine: ProgramMachine, options: Term, quoted: bool = False) -> Dict[str, object]:
    """Return the options of ``write_term/2`` as keyword arguments of the writer.

    Args:
        machine: the machine.
        options: list of options.
        quoted: value of the option ``quoted`` if the list does not contain it.
    """
    values: Dict[str, object] = {"quoted": quoted}
    iso = is_iso(machine)
    for option in option_values(options):
        if option.__class__ is not tuple or len(option) != 2:
            raise domain_error("write_option", option) if iso else type_error("option", option)
        name, value = option[0].name, bound(option[1])
        convert = _OPTION_CONVERTERS.get(name)
        if convert is not None:
            values[name] = convert(option, value, iso)
    # The writer takes a function instead of a boolean; it is None if the program does not define `portray/1`.
    if "portray" in values:
        values["portray"] = make_portray(machine) if values["portray"] else None
    return values


def _convert_boolean(option: CompoundTerm, value: Term, iso: bool) -> bool:
    if value.__class__ is not Atom or value.name not in ("true", "false"):
        raise domain_error("write_option", option) if iso else type_error("bool", value)
    return value.name == "true"


def _convert_spacing(option: CompoundTerm, value: Term, iso: bool) -> bool:
    if value.__class__ is not Atom or value.name not in ("standard", "next_argument"):
        raise domain_error("spacing", value)
    return value.name == "next_argument"


_OPTION_CONVERTERS: Dict[str, Callable[[CompoundTerm, Term, bool], object]] = {
    "quoted": _convert_boolean,
    "ignore_ops": _convert_boolean,
    "numbervars": _convert_boolean,
    "brace_terms": _convert_boolean,
    "portray": _convert_boolean,
    "spacing": _convert_spacing,
    "max_depth": lambda option, value, iso: integer(value),
    "priority": lambda option, value, iso: integer(value),
    "variable_names": lambda option, value, iso: _convert_variable_names(option),
}
"""Functions that convert an option's value; arguments are the option, its value, and the flag ``iso``."""


def _convert_variable_names(option: CompoundTerm) -> Dict[Var, str]:
    names: Dict[Var, str] = {}
    for pair in option_values(option[1]):
        if pair.__class__ is not tuple or str(pair[0]) != "=/2":
            raise domain_error("write_option", option)
        var = deref(pair[2])
        name = bound(pair[1])
        if name.__class__ is not Atom:
            raise domain_error("write_option", option)
        if var.__class__ is Var:
            # The first name of a variable is used.
            names.setdefault(var, name.name)
    return names


def _text_with_options(machine: ProgramMachine, term: Term, options: Term, quoted: bool = False) -> str:
    values: Dict[str, Any] = write_options(machine, options, quoted)
    depth = values.pop("max_depth", 0)
    return write_term(limit_depth(term, depth) if depth > 0 else term, machine.logic.operators, **values)


@deterministic("write_term/2")
def write_term_2(machine: ProgramMachine, term: Term, options: Term) -> bool:
    """Write a term with options."""
    machine.logic.write(_text_with_options(machine, term, options))
    return True


@deterministic("write_term/3")
def write_term_3(machine: ProgramMachine, stream: Term, term: Term, options: Term) -> bool:
    """Write a term with options to a stream."""
    write_to(machine, stream, _text_with_options(machine, term, options))
    return True


@deterministic("term_string/2")
def term_string(machine: ProgramMachine, term: Term, text: Term) -> bool:
    """Convert between a term and its text as a string."""
    return term_string_options(machine, term, text, NIL)


@deterministic("term_string/3")
def term_string_options(machine: ProgramMachine, term: Term, text: Term, options: Term) -> bool:
    """Convert between a term and its text as a string.

    The options are those of ``read_term/2`` if the text is given, otherwise those of ``write_term/2``; ``quoted``
    is true by default.
    """
    text_term = deref(text)
    if text_term.__class__ is not Var:
        return read_with_options(machine, text_of(text_term), term, options)
    return unify(text, String(_text_with_options(machine, term, options, quoted=True)), machine.trail)


# Formatted text


def _format_arguments(term: Term) -> List[Term]:
    term = deref(term)
    if term is NIL:
        return []
    # A term that is not a proper list is a single argument, as by SWI-Prolog.
    if term.__class__ is tuple and term[0] is CONS:
        arguments = list_items(term)
        if arguments is not None:
            return arguments
    return [term]


def _format_text(format_term: Term) -> str:
    format_term = deref(format_term)
    if format_term.__class__ in (int, float):
        raise type_error("text", format_term)
    return whole_text(format_term, "text")


def format_to_text(machine: ProgramMachine, format_term: Term, arguments: Term) -> str:
    """Return the text of ``format(Format, Arguments)`` at the beginning of a line."""
    return Formatter(machine, 0).format(_format_text(format_term), _format_arguments(arguments))


@deterministic("format/1")
def format_1(machine: ProgramMachine, format_term: Term) -> bool:
    """Write formatted text without arguments."""
    return format_2(machine, format_term, NIL)


@deterministic("format/2")
def format_2(machine: ProgramMachine, format_term: Term, arguments: Term) -> bool:
    """Write formatted text."""
    logic = machine.logic
    formatter = Formatter(machine, logic.column)
    try:
        formatter.format(_format_text(format_term), _format_arguments(arguments))
    # The text before an error is written, as by SWI-Prolog.
    finally:
        logic.write(formatter.line.text())
    return True


@deterministic("format/3")
def format_3(machine: ProgramMachine, sink: Term, format_term: Term, arguments: Term) -> bool:
    """Write formatted text to a stream, or unify it with an output specification such as ``atom(A)``."""
    sink = deref(sink)
    if is_sink(sink):
        return fill_sink(machine, sink, format_to_text(machine, format_term, arguments))
    if sink.__class__ not in (Var, Atom) and not is_stream_term(sink):
        raise type_error("output", sink)
    # Checks the stream before the arguments are formatted, which may have side effects.
    write_to(machine, sink, "")
    write_to(machine, sink, format_to_text(machine, format_term, arguments))
    return True


@deterministic("sformat/3")
def sformat(machine: ProgramMachine, text: Term, format_term: Term, arguments: Term) -> bool:
    """Unify with formatted text as a string."""
    return unify(text, make_text("string", format_to_text(machine, format_term, arguments)), machine.trail)


@deterministic("sformat/2")
def sformat_2(machine: ProgramMachine, text: Term, format_term: Term) -> bool:
    """Unify with formatted text without arguments as a string."""
    return sformat(machine, text, format_term, NIL)


# Captured output


@control("with_output_to/2")
def with_output_to(machine: ProgramMachine, args: Values, continuation: Frame) -> Optional[Frame]:
    """Run a goal once, and unify its output with an output specification such as ``atom(A)``."""
    sink = bound(args[0])
    if not is_sink(sink):
        raise existence_error("stream", sink) if sink.__class__ is Atom else type_error("output", sink)
    logic = machine.logic
    height = len(machine.choices)
    capture = OutputCapture(machine)
    machine.choices.append((_CAPTURE_GUARD, capture, len(machine.trail)))
    return logic.control.call(args[1], (_UNIFY_CAPTURED, machine, height, sink, capture.texts, continuation))


def _end_capture(entry: Frame) -> None:
    capture: OutputCapture = entry[1]
    capture.end()


def _unify_captured(frame: Frame) -> Optional[Frame]:
    machine: ProgramMachine
    continuation: Frame
    _, machine, height, sink, captured, continuation = frame
    _end_capture(machine.choices[height])
    del machine.choices[height:]
    return continuation if fill_sink(machine, sink, join_texts(captured)) else None


_CAPTURE_GUARD = Guard("with_output_to", _end_capture)
_UNIFY_CAPTURED = Code("with_output_to", _unify_captured)


def _parse_code(code: Term) -> str:
    value = integer(code)
    if not 0 <= value <= MAX_CODE:
        raise representation_error("character_code")
    return chr(value)


@deterministic("put_code/1")
def put_code(machine: ProgramMachine, code: Term) -> bool:
    """Write a character by its code."""
    machine.logic.write(_parse_code(code))
    return True


@deterministic("put_code/2")
def put_code_to(machine: ProgramMachine, stream: Term, code: Term) -> bool:
    """Write a character by its code to a stream."""
    write_to(machine, stream, _parse_code(code))
    return True


def _put_byte(stream: Union[OutputStream, OutputCapture, str, None], stream_term: Term, byte: Term) -> bool:
    byte = deref(byte)
    if not isinstance(byte, int) or not 0 <= byte <= 255:
        raise instantiation_or_type_error("byte", byte)
    # Standard streams and captures are text streams.
    if not isinstance(stream, OutputStream) or stream.stream_type != "binary":
        raise permission_error("output", "text_stream", deref(stream_term))
    stream.write(chr(byte))
    return True


@deterministic("put_byte/1")
def put_byte(machine: ProgramMachine, byte: Term) -> bool:
    """Write a byte to the current output, which has to be a binary file."""
    return _put_byte(streams_of(machine).output, atom("current_output"), byte)


@deterministic("put_byte/2")
def put_byte_to(machine: ProgramMachine, stream: Term, byte: Term) -> bool:
    """Write a byte to a binary stream."""
    return _put_byte(streams_of(machine).find_output(stream), stream, byte)
