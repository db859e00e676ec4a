"""What a goal writes, caught; and ``portray/1``, by which a program says how terms of its own are printed.

Interpretation of format strings, with column stops, as SWI-Prolog's ``format/2``.
"""

from itertools import count
from typing import Callable, Dict, List, Optional, Tuple

from ...foundation.cancellation import look
from ..compiler.clause_nodes import NOT
from ..machine.arithmetic import bounded, evaluate
from ..machine.errors import domain_error, error, existence_error, resource_error
from ..syntax.term_writer import write_term
from ..terms.types import Atom, String, Term, atom, deref, functor
from .builtin_registry import Machine
from .text_arguments import MAX_CODE, constant_text, is_text_list, joined, long_text, number_text, text_of
from .text_streams import OutputCapture

_PORTRAY = functor("portray", 1)


def caught(machine: Machine, goal: Term) -> Tuple[bool, str]:
    """Return whether a goal succeeds, and what it writes."""
    logic = machine.logic
    capture = OutputCapture(logic)
    try:
        succeeded = logic.once(goal)
    finally:
        capture.end()
    return succeeded, joined(capture.texts)


def portray_of(machine: Machine) -> Optional[Callable[[Term], Optional[str]]]:
    """Return what gives the text of a term by the program's ``portray/1``; None where it has none."""
    if not machine.logic.defines(_PORTRAY):
        return None

    def portray(term: Term) -> Optional[str]:
        succeeded, text = caught(machine, (NOT, (NOT, (_PORTRAY, term))))  # without its bindings
        return text if succeeded else None

    return portray


def printed(machine: Machine, term: Term) -> str:
    """Return the text of a term as ``print/1`` writes it."""
    return write_term(term, machine.logic.operators, numbervars=True, portray=portray_of(machine))


_FORMAT = functor("format", 1)
_ARGUMENT_TYPE = functor("format_argument_type", 2)
_WIDEST = 10_000_000
_NUMERAL = 20
"""Digits of the longest number of a directive."""


def argument_error(letter: str, argument: Term) -> Exception:
    """Return the error of an argument that a directive cannot write."""
    return error((_ARGUMENT_TYPE, atom(letter), argument))


def format_error(message: str) -> Exception:
    """Return the error of a format string and arguments that do not fit."""
    return error((_FORMAT, atom(message)))


class ColumnLine:
    """The text so far, with the column stops of its last line.

    Args:
        column: where the output stands before it.
    """

    def __init__(self, column: int):
        self.done: List[str] = []
        self._begin()
        self.start = column
        self.column = column
        self.size = 0

    def add(self, text: str) -> None:
        """Add text to the segment between two column stops."""
        if not text:
            return
        self.size += len(text)
        long_text(self.size, text)
        self.segment.append(text)
        self.width += len(text)
        newline = text.rfind("\n")
        if newline >= 0:
            self.done += self.segment
            self._begin()
            self.column = self.start = len(text) - newline - 1
        else:
            self.column += len(text)

    def fill(self, char: str) -> None:
        """Note that blanks of the column go here."""
        self.fills.append((self.width, char))

    def stop(self, target: int) -> None:
        """End the segment at a column, putting the missing characters where the fills are."""
        text = "".join(self.segment)
        missing = target - self.column
        if missing > 0:
            self.size += missing
            long_text(self.size)
            text = _spread(text, self.fills or [(len(text), " ")], missing)
            self.column = target
        self.done.append(text)
        self._begin()
        self.start = self.column

    def _begin(self) -> None:
        """Begin a segment."""
        self.segment: List[str] = []
        self.fills: List[Tuple[int, str]] = []
        self.width = 0  # of the segment

    def text(self) -> str:
        """Return everything."""
        return joined(self.done + self.segment)


def _spread(text: str, fills: List[Tuple[int, str]], missing: int) -> str:
    """Insert ``missing`` characters at the fills in equal shares; the last takes the rest."""
    share, rest = divmod(missing, len(fills))
    out = []
    last = 0
    for number, (at, char) in enumerate(fills):
        out.append(text[last:at])
        out.append(char * (share + (rest if number == len(fills) - 1 else 0)))
        last = at
    out.append(text[last:])
    return "".join(out)


class Formatter:
    """Formats arguments by a format string.

    Args:
        machine: whose program writes.
        column: where the output stands.
    """

    def __init__(self, machine: Machine, column: int):
        self.machine = machine
        self.line = ColumnLine(column)
        self.arguments: List[Term] = []

    def format(self, text: str, arguments: List[Term]) -> str:
        """Return the formatted text.

        Raises:
            PrologError: where arguments are missing, left over, or of the wrong type.
        """
        self.arguments = arguments[::-1]
        at = 0
        line = self.line
        for directive in count(1):
            if not directive & 255:
                look()
            tilde = text.find("~", at)
            if tilde < 0:
                line.add(text[at:])
                break
            line.add(text[at:tilde])
            at = self._directive(text, tilde + 1)
        if self.arguments:
            raise format_error("too many arguments")
        return line.text()

    def _next(self) -> Term:
        if not self.arguments:
            raise format_error("not enough arguments")
        return self.arguments.pop()

    def _directive(self, text: str, at: int) -> int:
        """Do the directive that starts after the tilde; return where it ends."""
        number, at = self._number(text, at)
        letter = text[at : at + 1]
        if number is not None and number > _WIDEST:
            raise resource_error("memory")
        if not letter:
            raise existence_error("format_character", atom("\0"))
        if letter in "|+t":
            self._lay_out(letter, number)
        elif letter == "i":
            self._next()
        elif letter == "N":
            if self.line.column:
                self.line.add("\n")
        else:
            self.line.add(self._written(letter, number))
        return at + 1

    def _number(self, text: str, at: int) -> Tuple[Optional[int], int]:
        """Return the number of a directive, if it has one, and where its letter stands."""
        if text[at : at + 1] == "`":
            return ord(text[at + 1 : at + 2] or "`"), at + 2
        if text[at : at + 1] == "*":
            given = deref(self._next())
            if given.__class__ is not int or given < 0:
                raise format_error("no or negative integer for `*' argument")
            return given, at + 1
        start = at
        while text[at : at + 1].isdigit():
            at += 1
            if at - start > _NUMERAL:
                raise resource_error("memory")
        return (int(text[start:at]) if at > start else None), at

    def _lay_out(self, letter: str, number: Optional[int]) -> None:
        """Set a column stop, or note that blanks go here."""
        line = self.line
        if letter == "t":
            line.fill(chr(32 if number is None else number))
        elif letter == "+":
            line.stop(line.start + (8 if number is None else number))
        else:
            line.stop(line.column if number is None else number)

    def _written(self, letter: str, number: Optional[int]) -> str:
        """Return the text of a directive that writes one."""
        times = 1 if number is None else number
        if letter == "~":
            return "~"
        if letter == "n":
            return self._repeated("\n", times)
        if letter == "c":
            return self._repeated(_code(self._next()), times)
        convert = _CONVERSIONS.get(letter)
        if convert is None:
            raise existence_error("format_character", atom(letter))
        return convert(self.machine, self._next(), number)

    def _repeated(self, character: str, times: int) -> str:
        long_text(self.line.size + times, character)
        return character * times


def _code(term: Term) -> str:
    code = deref(term)
    if code.__class__ is not int or not 0 <= code <= MAX_CODE:
        raise argument_error("c", code)
    return chr(code)


def _atomic(machine: Machine, term: Term, number: Optional[int]) -> str:
    text = constant_text(deref(term))
    if text is None:
        raise argument_error("a", term)
    return text


def _called(machine: Machine, goal: Term, number: Optional[int]) -> str:
    """Return what a goal writes, whether it succeeds or not."""
    return caught(machine, goal)[1]


def _write(machine: Machine, term: Term, number: Optional[int]) -> str:
    return machine.logic.show(term, quoted=False)


def _quoted(machine: Machine, term: Term, number: Optional[int]) -> str:
    return machine.logic.show(term)


def _printed(machine: Machine, term: Term, number: Optional[int]) -> str:
    return printed(machine, term)


def _text(machine: Machine, term: Term, number: Optional[int]) -> str:
    given = deref(term)
    is_text = given.__class__ in (String, Atom) or is_text_list(given)
    if not is_text:
        raise argument_error("s", given)
    return text_of(given)


def _integer(letter: str, term: Term) -> int:
    value = evaluate(term)
    if not isinstance(value, int):
        raise argument_error(letter, value)
    return value


def group(digits: str, size: int, mark: str) -> str:
    """Return digits in groups of ``size`` from the right."""
    first = len(digits) % size or size
    return mark.join([digits[:first], *[digits[at : at + size] for at in range(first, len(digits), size)]])


def _grouped(machine: Machine, term: Term, number: Optional[int]) -> str:
    """Return an integer with its digits in groups, which reads back."""
    value = _integer("I", term)
    return ("-" if value < 0 else "") + group(number_text(abs(value)), number or 3, "_")


def _decimal(mark: str) -> Callable[..., str]:
    def convert(machine: Machine, term: Term, number: Optional[int]) -> str:
        value = _integer("d", term)
        digits = number_text(abs(value))
        fraction = ""
        if number:
            digits = digits.rjust(number + 1, "0")
            digits, fraction = digits[:-number], "." + digits[-number:]
        if mark:
            digits = group(digits, 3, mark)
        return ("-" if value < 0 else "") + digits + fraction

    return convert


def _float(letter: str) -> Callable[..., str]:
    def convert(machine: Machine, term: Term, number: Optional[int]) -> str:
        value = evaluate(term)
        places = 6 if number is None else number
        if letter == "f" and value.__class__ is int:
            return number_text(value) + ("." + "0" * places if places else "")
        return f"%.{places}{letter}" % value

    return convert


_DIGITS = "0123456789abcdefghijklmnopqrstuvwxyz"


def radix_text(value: int, radix: int) -> str:
    """Return an integer in another base."""
    bounded(value, value)
    powers = [radix]
    while powers[-1] <= abs(value):
        powers.append(powers[-1] * powers[-1])
    parts = [abs(value)]
    for power in reversed(powers):
        parts = [half for part in parts for half in divmod(part, power)]
    digits = "".join([_DIGITS[part] for part in parts]).lstrip("0")
    return ("-" if value < 0 else "") + (digits or "0")


def _radix(change: Callable[[str], str]) -> Callable[..., str]:
    def convert(machine: Machine, term: Term, number: Optional[int]) -> str:
        value = _integer("r", term)
        if number is None:
            number = 8
        if not 2 <= number <= 36:
            raise domain_error("radix", number)
        return change(radix_text(value, number))

    return convert


_CONVERSIONS: Dict[str, Callable[..., str]] = {
    "@": _called,
    "a": _atomic,
    "w": _write,
    "p": _printed,
    "q": _quoted,
    "s": _text,
    "d": _decimal(""),
    "D": _decimal(","),
    "I": _grouped,
    "e": _float("e"),
    "f": _float("f"),
    "g": _float("g"),
    "r": _radix(str),
    "R": _radix(str.upper),
}
