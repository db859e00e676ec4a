"""Format strings of ``format/1,2,3``, with column stops, and printing of terms with ``portray/1``.

The directives are those of SWI-Prolog. A line is divided into segments by column stops (``~|`` and ``~+``). A segment
is buffered until its column stop, where the missing characters are inserted at its fill points (``~t``), or at its
end if it has none.
"""

from itertools import count
from typing import Callable, Dict, List, Optional, Tuple

from ...foundation.limit_checks import check_limits
from ..compiler.clause_nodes import NOT
from ..machine.arithmetic import check_bit_product, evaluate
from ..machine.errors import domain_error, error, existence_error, resource_error
from ..syntax.term_writer import write_term
from ..terms.types import Atom, String, Term, atom, deref, functor
from .builtin_registry import ProgramMachine
from .text_arguments import (
    MAX_CODE,
    check_text_length,
    constant_text,
    is_text_list,
    join_texts,
    number_text,
    text_of,
)
from .text_streams import OutputCapture

_PORTRAY = functor("portray", 1)


def run_captured(machine: ProgramMachine, goal: Term) -> Tuple[bool, str]:
    """Run a goal once; return whether it succeeds, and its output."""
    logic = machine.logic
    # The capture ends in any case; otherwise, the program's output would go to it after an error.
    capture = OutputCapture(machine)
    try:
        succeeded = logic.once(goal)
    finally:
        capture.end()
    return succeeded, join_texts(capture.texts)


def make_portray(machine: ProgramMachine) -> Optional[Callable[[Term], Optional[str]]]:
    """Return a function that prints a term with the program's ``portray/1``, or None if the program defines none."""
    if not machine.logic.defines(_PORTRAY):
        return None

    def portray(term: Term) -> Optional[str]:
        # The double negation discards the bindings of the goal, so that printing does not change the term.
        succeeded, text = run_captured(machine, (NOT, (NOT, (_PORTRAY, term))))
        return text if succeeded else None

    return portray


def print_to_text(machine: ProgramMachine, term: Term) -> str:
    """Return the text of a term as ``print/1`` writes it."""
    return write_term(term, machine.logic.operators, numbervars=True, portray=make_portray(machine))


_FORMAT_ERROR = functor("format", 1)
_ARGUMENT_TYPE = functor("format_argument_type", 2)
_MAX_COLUMN = 10_000_000
"""Limit for the numeric argument of a directive."""

_MAX_NUMBER_DIGITS = 20
"""Limit for the digits of the numeric argument of a directive."""


def argument_error(letter: str, argument: Term) -> Exception:
    """Return the error for an argument of the wrong type for a directive."""
    return error((_ARGUMENT_TYPE, atom(letter), argument))


def format_error(message: str) -> Exception:
    """Return the error for a format string that does not fit its arguments."""
    return error((_FORMAT_ERROR, atom(message)))


class ColumnLine:
    """The text of a formatted output, with the column stops of its last line.

    Attributes:
        finished_parts: the text before the segment.
        segment: parts of the segment between two column stops.
        segment_column: column at which the segment starts.
        segment_width: number of its characters.
        fill_points: position in the segment and character of each fill point.
        column: column after the text.
        size: number of characters of the whole text.
    """

    def __init__(self, column: int):
        self.finished_parts: List[str] = []
        self._start_segment()
        self.segment_column = column
        self.column = column
        self.size = 0

    def append(self, text: str) -> None:
        """Add text to the segment between two column stops."""
        if not text:
            return
        self.size += len(text)
        check_text_length(self.size, text)
        self.segment.append(text)
        self.segment_width += len(text)
        newline = text.rfind("\n")
        # A newline ends the segment without a column stop, so its fill points have no effect.
        if newline >= 0:
            self.finished_parts += self.segment
            self._start_segment()
            self.column = self.segment_column = len(text) - newline - 1
        else:
            self.column += len(text)

    def add_fill_point(self, char: str) -> None:
        """Add a fill point: characters that are missing at the next column stop are inserted here."""
        self.fill_points.append((self.segment_width, char))

    def end_segment(self, target_column: int) -> None:
        """End the segment at a column, and insert the missing characters at its fill points."""
        text = "".join(self.segment)
        missing_count = target_column - self.column
        if missing_count > 0:
            self.size += missing_count
            check_text_length(self.size)
            text = _insert_fill(text, self.fill_points or [(len(text), " ")], missing_count)
            self.column = target_column
        self.finished_parts.append(text)
        self._start_segment()
        self.segment_column = self.column

    def _start_segment(self) -> None:
        self.segment: List[str] = []
        self.fill_points: List[Tuple[int, str]] = []
        self.segment_width = 0

    def text(self) -> str:
        """Return the whole text, with the incomplete segment."""
        return join_texts(self.finished_parts + self.segment)


def _insert_fill(text: str, fill_points: List[Tuple[int, str]], missing_count: int) -> str:
    """Insert ``missing_count`` characters at the fill points in equal shares; the last one takes the remainder."""
    share, remainder = divmod(missing_count, len(fill_points))
    parts = []
    previous_position = 0
    for index, (position, char) in enumerate(fill_points):
        parts.append(text[previous_position:position])
        parts.append(char * (share + (remainder if index == len(fill_points) - 1 else 0)))
        previous_position = position
    parts.append(text[previous_position:])
    return "".join(parts)


class Formatter:
    """Interpreter of a format string.

    Args:
        column: current column of the output.
    """

    def __init__(self, machine: ProgramMachine, column: int):
        self.machine = machine
        self.line = ColumnLine(column)
        self.arguments: List[Term] = []

    def format(self, text: str, arguments: List[Term]) -> str:
        """Return the formatted text.

        Raises:
            PrologError: if there are too few or too many arguments, or one has the wrong type.
        """
        # Reversed, so that taking the next argument is a `pop` from the end.
        self.arguments = arguments[::-1]
        position = 0
        line = self.line
        for directive in count(1):
            if not directive & 255:
                check_limits()
            tilde = text.find("~", position)
            if tilde < 0:
                line.append(text[position:])
                break
            line.append(text[position:tilde])
            position = self._execute_directive(text, tilde + 1)
        if self.arguments:
            raise format_error("too many arguments")
        return line.text()

    def _next_argument(self) -> Term:
        if not self.arguments:
            raise format_error("not enough arguments")
        return self.arguments.pop()

    def _execute_directive(self, text: str, position: int) -> int:
        """Execute the directive that starts after the tilde; return the position after it."""
        number, position = self._parse_number(text, position)
        letter = text[position : position + 1]
        # Limits columns and repetitions before any text is created.
        if number is not None and number > _MAX_COLUMN:
            raise resource_error("memory")
        if not letter:
            raise existence_error("format_character", atom("\0"))
        if letter in "|+t":
            self._execute_column_directive(letter, number)
        elif letter == "i":
            self._next_argument()
        elif letter == "N":
            if self.line.column:
                self.line.append("\n")
        else:
            self.line.append(self._text_of_directive(letter, number))
        return position + 1

    def _parse_number(self, text: str, position: int) -> Tuple[Optional[int], int]:
        """Return the numeric argument of a directive, or None, and the position of its letter."""
        if text[position : position + 1] == "`":
            return ord(text[position + 1 : position + 2] or "`"), position + 2
        if text[position : position + 1] == "*":
            argument = deref(self._next_argument())
            if argument.__class__ is not int or argument < 0:
                raise format_error("no or negative integer for `*' argument")
            return argument, position + 1
        start = position
        while text[position : position + 1].isdigit():
            position += 1
            # The conversion of a long numeral takes quadratic time.
            if position - start > _MAX_NUMBER_DIGITS:
                raise resource_error("memory")
        return (int(text[start:position]) if position > start else None), position

    def _execute_column_directive(self, letter: str, number: Optional[int]) -> None:
        """Execute a directive for a column stop or a fill point."""
        line = self.line
        if letter == "t":
            line.add_fill_point(chr(32 if number is None else number))
        elif letter == "+":
            # Relative to the previous column stop, by default 8 columns.
            line.end_segment(line.segment_column + (8 if number is None else number))
        else:
            line.end_segment(line.column if number is None else number)

    def _text_of_directive(self, letter: str, number: Optional[int]) -> str:
        """Return the text of any other directive."""
        times = 1 if number is None else number
        if letter == "~":
            return "~"
        if letter == "n":
            return self._repeat("\n", times)
        if letter == "c":
            return self._repeat(_character_of_code(self._next_argument()), times)
        convert = _CONVERSIONS.get(letter)
        if convert is None:
            raise existence_error("format_character", atom(letter))
        return convert(self.machine, self._next_argument(), number)

    def _repeat(self, character: str, times: int) -> str:
        check_text_length(self.line.size + times, character)
        return character * times


def _character_of_code(term: Term) -> str:
    code = deref(term)
    if code.__class__ is not int or not 0 <= code <= MAX_CODE:
        raise argument_error("c", code)
    return chr(code)


def _atomic_text(machine: ProgramMachine, term: Term, number: Optional[int]) -> str:
    text = constant_text(deref(term))
    if text is None:
        raise argument_error("a", term)
    return text


def _output_of_goal(machine: ProgramMachine, goal: Term, number: Optional[int]) -> str:
    """Return the output of a goal, whether it succeeds or fails."""
    return run_captured(machine, goal)[1]


def _unquoted_text(machine: ProgramMachine, term: Term, number: Optional[int]) -> str:
    return machine.logic.show(term, quoted=False)


def _quoted_text(machine: ProgramMachine, term: Term, number: Optional[int]) -> str:
    return machine.logic.show(term)


def _printed_text(machine: ProgramMachine, term: Term, number: Optional[int]) -> str:
    return print_to_text(machine, term)


def _string_text(machine: ProgramMachine, term: Term, number: Optional[int]) -> str:
    value = deref(term)
    # Numbers are not accepted, unlike by most other predicates on texts.
    is_text = value.__class__ in (String, Atom) or is_text_list(value)
    if not is_text:
        raise argument_error("s", value)
    return text_of(value)


def _evaluate_integer(letter: str, term: Term) -> int:
    # SWI-Prolog evaluates the argument, so expressions are accepted.
    value = evaluate(term)
    if not isinstance(value, int):
        raise argument_error(letter, value)
    return value


def group_digits(digits: str, size: int, mark: str) -> str:
    """Return digits in groups of ``size`` from the right."""
    first = len(digits) % size or size
    return mark.join(
        [digits[:first], *[digits[index : index + size] for index in range(first, len(digits), size)]]
    )


def _underscored_integer(machine: ProgramMachine, term: Term, number: Optional[int]) -> str:
    """Return an integer with its digits in groups separated by ``_``, which is valid Prolog syntax."""
    value = _evaluate_integer("I", term)
    return ("-" if value < 0 else "") + group_digits(number_text(abs(value)), number or 3, "_")


def _decimal_converter(mark: str) -> Callable[..., str]:
    """Return the conversion of ``~Nd`` or ``~ND``: an integer with a point before the last N digits.

    Args:
        mark: separator of groups of three digits before the point; "" for none.
    """

    def convert(machine: ProgramMachine, term: Term, number: Optional[int]) -> str:
        value = _evaluate_integer("d", term)
        digits = number_text(abs(value))
        fraction = ""
        if number:
            digits = digits.rjust(number + 1, "0")
            digits, fraction = digits[:-number], "." + digits[-number:]
        if mark:
            digits = group_digits(digits, 3, mark)
        return ("-" if value < 0 else "") + digits + fraction

    return convert


def _float_converter(letter: str) -> Callable[..., str]:
    """Return the conversion of ``~Ne``, ``~Nf`` or ``~Ng``, with N decimal places."""

    def convert(machine: ProgramMachine, term: Term, number: Optional[int]) -> str:
        value = evaluate(term)
        places = 6 if number is None else number
        # Exact, while a conversion to float would round large integers.
        if letter == "f" and value.__class__ is int:
            return number_text(value) + ("." + "0" * places if places else "")
        return f"%.{places}{letter}" % value

    return convert


_DIGITS = "0123456789abcdefghijklmnopqrstuvwxyz"


def format_in_radix(value: int, radix: int) -> str:
    """Return an integer in another base."""
    # Divides by repeated squares of the radix, so that a large number takes less than quadratic time.
    check_bit_product(value, value)
    powers = [radix]
    while powers[-1] <= abs(value):
        powers.append(powers[-1] * powers[-1])
    digit_groups = [abs(value)]
    for power in reversed(powers):
        digit_groups = [half for digit_group in digit_groups for half in divmod(digit_group, power)]
    digits = "".join([_DIGITS[digit_group] for digit_group in digit_groups]).lstrip("0")
    return ("-" if value < 0 else "") + (digits or "0")


def _radix_converter(change_case: Callable[[str], str]) -> Callable[..., str]:
    """Return the conversion of ``~Nr`` or ``~NR``: an integer in base N."""

    def convert(machine: ProgramMachine, term: Term, number: Optional[int]) -> str:
        value = _evaluate_integer("r", term)
        if number is None:
            number = 8
        if not 2 <= number <= 36:
            raise domain_error("radix", number)
        return change_case(format_in_radix(value, number))

    return convert


# Each function gets the machine, the argument, and the numeric argument of the directive.
_CONVERSIONS: Dict[str, Callable[..., str]] = {
    "@": _output_of_goal,
    "a": _atomic_text,
    "w": _unquoted_text,
    "p": _printed_text,
    "q": _quoted_text,
    "s": _string_text,
    "d": _decimal_converter(""),
    "D": _decimal_converter(","),
    "I": _underscored_integer,
    "e": _float_converter("e"),
    "f": _float_converter("f"),
    "g": _float_converter("g"),
    "r": _radix_converter(str),
    "R": _radix_converter(str.upper),
}
