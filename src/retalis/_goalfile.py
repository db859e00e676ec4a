"""Goal files (``goalPredicates.txt``): one goal a line, the full stop left out more often than not."""

from typing import Iterator, List, Optional, Union

from .errors import SyntaxFault
from .syntax import Operators, ReadTerm, read_term

Read = Union[ReadTerm, SyntaxFault]


def read_goals(text: str, operators: Operators, source: str) -> Iterator[Read]:
    """Yield the goals of a goal file, and a `SyntaxFault` for each that does not read.

    A line is a goal of its own where it reads as one, with or without a full stop. Where it does not, the
    goal goes on to a line that ends in a full stop.
    """
    lines = text.split("\n")
    at = 0
    while at < len(lines):
        if _is_blank(lines[at]):
            at += 1
            continue
        goal = _read(lines, at, at + 1, operators, source)
        end = at + 1
        stop = _full_stop(lines, end) if isinstance(goal, SyntaxFault) else None
        if stop is not None:
            longer = _read(lines, at, stop, operators, source)
            # Where the longer one fails behind the first line, its lines belong together: none is a goal.
            if not isinstance(longer, SyntaxFault) or _line(longer) > at + 1:
                goal, end = longer, stop
        yield goal
        at = end


def _is_blank(line: str) -> bool:
    code = line.strip()
    return not code or code.startswith("%")


def _full_stop(lines: List[str], start: int) -> Optional[int]:
    """Return where a goal that began before ``start`` may end: behind the next line with a full stop."""
    for index in range(start, len(lines)):
        if lines[index].rstrip().endswith(".") or lines[index].split("%")[0].rstrip().endswith("."):
            return index + 1
    return None


def _line(fault: SyntaxFault) -> int:
    return 0 if fault.place is None else fault.place.line


def _read(lines: List[str], start: int, end: int, operators: Operators, source: str) -> Read:
    try:
        return read_term("\n".join(lines[start:end]), operators, source, first_line=start + 1)
    except SyntaxFault as fault:
        return fault
