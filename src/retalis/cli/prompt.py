"""Answers of a goal as a top level shows them: ``X = f(Y), Z = 1``.

Where a top level reads: a terminal with history and completion, or a pipe.
"""

import atexit
import re
import sys
from pathlib import Path
from typing import IO, Callable, Dict, Iterable, Iterator, List, NamedTuple, Optional, Union

from ..foundation.errors import SyntaxFault
from ..prolog.syntax.operators import Operators
from ..prolog.syntax.term_reader import ReadTerm, read_program
from ..prolog.syntax.term_writer import write_term
from ..prolog.syntax.tokenizer import ReadFlags
from ..prolog.system.prolog_system import PrologSystem
from ..prolog.terms.term_traversal import variables
from ..prolog.terms.types import Atom, Term, Var, deref, functor
from ..prolog.terms.unification import compare

_BINDING = 699
"""The highest priority that the right side of ``=`` may have."""

_MAX_NODES = 1_000_000


class _Group(NamedTuple):
    """Variables of the goal that have the same value."""

    names: List[str]
    value: Term


def bindings(names: Dict[str, Var], operators: Operators) -> str:
    """Return the values of a goal's variables as text; empty where there is nothing to say.

    Variables whose names begin with ``_`` are not shown. Variables with the same value share a line. Those
    that the goal has no name for are ``_`` where they stand once, else ``_A``, ``_B`` and so on.
    """
    groups = _grouped(names)
    if any(_is_endless(group.value) for group in groups):
        return "% the answer is a cyclic term, or too large to be shown"
    named = _variable_names(groups)
    lines = []
    for group in groups:
        chain = [f"{left} = {right}" for left, right in zip(group.names, group.names[1:])]
        if group.value.__class__ is not Var:
            text = write_term(
                group.value,
                operators,
                quoted=True,
                numbervars=True,
                spacing=True,
                variable_names=named,
                priority=_BINDING,
            )
            chain.append(f"{group.names[-1]} = {text}")
        if chain:
            lines.append(", ".join(chain))
    return ",\n".join(lines)


def _grouped(names: Dict[str, Var]) -> List[_Group]:
    groups: List[_Group] = []
    for name, var in names.items():
        if name.startswith("_"):
            continue
        value = deref(var)
        for group in groups:
            if group.value is value or (value.__class__ is not tuple and compare(group.value, value) == 0):
                group.names.append(name)
                break
        else:
            groups.append(_Group([name], value))
    return groups


def _variable_names(groups: List[_Group]) -> Dict[Var, str]:
    """Return how the variables inside the values are shown."""
    named = {group.value: group.names[-1] for group in groups if group.value.__class__ is Var}
    counts: Dict[Var, int] = {}
    _count((functor("", len(groups)), *[group.value for group in groups]), counts)
    taken = {name for group in groups for name in group.names}
    letters = (f"_{letter}" for letter in _letters() if f"_{letter}" not in taken)
    for var, count in counts.items():
        if var not in named:
            named[var] = "_" if count == 1 else next(letters)
    return named


def _letters() -> Iterator[str]:
    number = 0
    while True:
        yield f"{chr(65 + number % 26)}{number // 26 or ''}"
        number += 1


def _walk(term: Term, visit: Callable[[Term], None]) -> bool:
    """Visit the leaves of a term from left to right; False where it has too many parts."""
    stack = [term]
    nodes = 0
    while stack:
        item = deref(stack.pop())
        nodes += 1
        if nodes > _MAX_NODES:
            return False
        if item.__class__ is tuple:
            stack.extend(reversed(item[1:]))
        else:
            visit(item)
    return True


def _count(term: Term, counts: Dict[Var, int]) -> None:
    for var in variables(term):
        counts[var] = 0

    def visit(leaf: Term) -> None:
        if leaf.__class__ is Var:
            counts[leaf] += 1

    _walk(term, visit)


def _is_endless(term: Term) -> bool:
    return not _walk(term, lambda leaf: None)


HISTORY = Path.home() / ".retalis_history"

LEAVE = ("halt", "quit", "exit", "end_of_file")
"""What ends a top level."""

_WORD = re.compile(r"[a-z]\w*\Z")

Read = Union[ReadTerm, SyntaxFault]


class Lines:
    """Lines of a pipe or a file."""

    is_terminal = False

    def __init__(self, file: IO[str]):
        self._file = file
        self.rest = ""
        """What stands after the full stop in the line that was read last."""

    def line(self, prompt: str) -> Optional[str]:
        """Return the next line, or None at the end."""
        return self._file.readline() or None

    def wants_more(self) -> bool:
        """Tell whether another solution is wanted: in a pipe all are."""
        return True


class Terminal:
    """Lines of a terminal, edited with readline where Python has it."""

    is_terminal = True

    def __init__(self, names: Callable[[], Iterable[str]]):
        self._names = names
        self.rest = ""
        self._found: List[str] = []
        self._set_up()

    def _set_up(self) -> None:
        try:
            import readline  # noqa: PLC0415 - not every Python has it
        except ImportError:  # a Python without it: plain lines
            return
        readline.set_completer(self._complete)
        readline.set_completer_delims(" \t\n()[]{}|,;:.!&'\"`+-*/\\<>=")
        readline.parse_and_bind("tab: complete")
        try:
            readline.read_history_file(str(HISTORY))
        except OSError:  # none yet
            pass
        except Exception:  # not GNU's, and the terminal is too simple for it: plain lines
            return
        readline.set_history_length(2000)
        atexit.register(_save_history)

    def _complete(self, text: str, number: int) -> Optional[str]:
        if number == 0:
            self._found = completions(text, self._names())
        return self._found[number] if number < len(self._found) else None

    def line(self, prompt: str) -> Optional[str]:
        """Return the next line, or None at the end (ctrl-D)."""
        try:
            return input(prompt) + "\n"
        except EOFError:
            print()
            return None

    def wants_more(self) -> bool:
        """Wait for a key: ``;``, blank, tab or ``n`` ask for another solution, others do not."""
        while True:
            key = _key()
            if key in ("h", "?"):
                print("\n; or blank: more solutions, return or . : enough")
            else:
                return key in (";", " ", "\t", "n", "r")


def _save_history() -> None:
    import readline  # noqa: PLC0415 - not every Python has it

    try:
        readline.write_history_file(str(HISTORY))
    except OSError as error:
        print(f"% the history is not kept: {error.strerror}", file=sys.stderr)


def _key() -> str:
    """Return the key that is pressed next."""
    try:
        import termios  # noqa: PLC0415 - not every system has it
        import tty  # noqa: PLC0415 - not every system has it
    except ImportError:  # no such terminals: a line
        return input()[:1]
    stdin = sys.stdin.fileno()
    before = termios.tcgetattr(stdin)
    try:
        tty.setcbreak(stdin, termios.TCSADRAIN)  # keeps what was typed ahead
        sys.stdout.flush()
        return sys.stdin.read(1)
    finally:
        termios.tcsetattr(stdin, termios.TCSADRAIN, before)


def completions(text: str, names: Iterable[str]) -> List[str]:
    """Return the names that a text may become."""
    if not _WORD.match(text):
        return []
    return sorted({name for name in names if name.startswith(text) and re.match(r"[a-z]\w*\Z", name)})


def read_clause(lines: Union[Lines, Terminal], logic: PrologSystem, prompt: str) -> Optional[Read]:
    """Return the next term that is typed or piped, a `SyntaxFault`, or None at the end.

    What follows its full stop in the line is kept for the next one; after an error it is left out.
    """
    held, lines.rest = lines.rest, ""
    while True:
        if "." in held:
            program = read_program(held, logic.operators, "user", _flags(logic))
            found = next(iter(program), None)
            if found is None:  # comments only
                held = ""
            elif not _goes_on(found, held):
                if not isinstance(found, SyntaxFault) and held[program.end :].strip():
                    lines.rest = held[program.end :]
                return found
        elif not held.strip():
            held = ""
        line = lines.line("|    " if held.strip() else prompt)
        if line is None:
            return next(iter(read_program(held, logic.operators, "user", _flags(logic))), None)
        held += line


def _goes_on(found: Read, text: str) -> bool:
    """Tell whether a term was cut off by the end of the text."""
    if not isinstance(found, SyntaxFault) or text.rstrip().endswith("."):
        return False
    return found.place is None or found.place.line > text.rstrip("\n").count("\n")


def _flags(logic: PrologSystem) -> ReadFlags:
    return ReadFlags(
        double_quotes=_named(logic.flags["double_quotes"]),
        back_quotes=_named(logic.flags["back_quotes"]),
        iso=_named(logic.flags["iso"]) == "true",
    )


def _named(value: Term) -> str:
    """Return the name of a flag's value, which is an atom."""
    assert isinstance(value, Atom)
    return value.name
