"""Input and answers of a Prolog top level.

Input comes from a pipe (`PipedInput`), or from a terminal with history and completion (`TerminalInput`);
`read_clause` reads lines until they contain a complete term. Answers have the form ``X = f(Y), Z = 1``
(`format_bindings`).
"""

import atexit
import re
import sys
from collections import deque
from io import StringIO
from pathlib import Path
from typing import IO, Callable, Dict, Iterable, Iterator, List, NamedTuple, Optional, Union

from ..foundation.errors import SyntaxFault
from ..foundation.interrupts import interruptible
from ..prolog.syntax.operators import Operators
from ..prolog.syntax.term_reader import ReadTerm, read_program
from ..prolog.syntax.term_writer import write_term
from ..prolog.syntax.tokenizer import END, ReadFlags, Source, tokenize
from ..prolog.system.prolog_system import PrologSystem
from ..prolog.terms.term_traversal import variables
from ..prolog.terms.types import Atom, Term, Var, deref, functor
from ..prolog.terms.unification import compare

_MAX_BINDING_PRIORITY = 699
"""Maximum priority of the right side of ``=``."""

_MAX_SUBTERMS = 1_000_000
"""Maximum number of subterms of a value that is shown; cyclic terms exceed it."""


class _VariableGroup(NamedTuple):
    """Variables of a goal with the same value."""

    names: List[str]
    value: Term


def format_bindings(names: Dict[str, Var], operators: Operators) -> str:
    """Return the values of a goal's variables as text; empty if there are none to show.

    Variables whose names begin with ``_`` are not shown. Variables with the same value share a line. Variables in
    values that have no name in the goal are written ``_`` if they occur once, otherwise ``_A``, ``_B`` and so on.
    """
    groups = _group_variables(names)
    # Checked before writing: the writer would not terminate for a cyclic term.
    if any(_is_too_large(group.value) for group in groups):
        return "% the answer is a cyclic term, or too large to be shown"
    variable_names = _name_variables(groups)
    lines = []
    for group in groups:
        chain = [f"{name} = {next_name}" for name, next_name in zip(group.names, group.names[1:])]
        if group.value.__class__ is not Var:
            text = write_term(
                group.value,
                operators,
                quoted=True,
                numbervars=True,
                spacing=True,
                variable_names=variable_names,
                priority=_MAX_BINDING_PRIORITY,
            )
            chain.append(f"{group.names[-1]} = {text}")
        if chain:
            lines.append(", ".join(chain))
    return ",\n".join(lines)


def _group_variables(names: Dict[str, Var]) -> List[_VariableGroup]:
    groups: List[_VariableGroup] = []
    for name, var in names.items():
        if name.startswith("_"):
            continue
        value = deref(var)
        for group in groups:
            # Compound terms are grouped only if they are the same object: a comparison of large terms would take
            # too long.
            if group.value is value or (value.__class__ is not tuple and compare(group.value, value) == 0):
                group.names.append(name)
                break
        else:
            groups.append(_VariableGroup([name], value))
    return groups


def _name_variables(groups: List[_VariableGroup]) -> Dict[Var, str]:
    """Return the names of the variables inside the values."""
    names_by_variable = {group.value: group.names[-1] for group in groups if group.value.__class__ is Var}
    counts: Dict[Var, int] = {}
    _count_occurrences((functor("", len(groups)), *[group.value for group in groups]), counts)
    # Generated names must not coincide with names of the goal.
    goal_names = {name for group in groups for name in group.names}
    generated_names = (f"_{suffix}" for suffix in _generate_name_suffixes() if f"_{suffix}" not in goal_names)
    for var, count in counts.items():
        if var not in names_by_variable:
            names_by_variable[var] = "_" if count == 1 else next(generated_names)
    return names_by_variable


def _generate_name_suffixes() -> Iterator[str]:
    """Yield A, B, ..., Z, A1, B1, ...."""
    index = 0
    while True:
        yield f"{chr(65 + index % 26)}{index // 26 or ''}"
        index += 1


def _visit_leaves(term: Term, visit: Callable[[Term], None]) -> bool:
    """Visit the leaves of a term from left to right; return False if it has more than `_MAX_SUBTERMS` subterms."""
    # Iterative, because a term may be deeper than Python's recursion limit.
    stack = [term]
    count = 0
    while stack:
        subterm = deref(stack.pop())
        count += 1
        if count > _MAX_SUBTERMS:
            return False
        if subterm.__class__ is tuple:
            stack.extend(reversed(subterm[1:]))
        else:
            visit(subterm)
    return True


def _count_occurrences(term: Term, counts: Dict[Var, int]) -> None:
    for var in variables(term):
        counts[var] = 0

    def visit(leaf: Term) -> None:
        if leaf.__class__ is Var:
            counts[leaf] += 1

    _visit_leaves(term, visit)


def _is_too_large(term: Term) -> bool:
    return not _visit_leaves(term, lambda leaf: None)


HISTORY_PATH = Path.home() / ".retalis_history"
"""File with the lines of former sessions."""

MAX_HISTORY_LINES = 2000

QUIT_GOALS = ("halt", "quit", "exit", "end_of_file")
"""Goals that end a top level."""

_UNQUOTED_ATOM = re.compile(r"[a-z]\w*\Z")

ParsedTerm = Union[ReadTerm, SyntaxFault]


class PipedInput:
    """Input lines of a pipe or a file."""

    is_terminal = False

    def __init__(self, file: IO[str]):
        self._file = file
        self.unread_text = ""
        """Text after the full stop in the last line, from which the next term is read."""

    def read_line(self, prompt: str) -> Optional[str]:
        """Return the next line, or None at the end."""
        with interruptible():
            return self._file.readline() or None

    def wants_more(self) -> bool:
        """Return True: with a pipe, all solutions are requested."""
        return True


class TerminalInput:
    """Input lines of a terminal, edited with readline if it is available."""

    is_terminal = True

    def __init__(self, list_names: Callable[[], Iterable[str]]):
        self._list_names = list_names
        self.unread_text = ""
        self._candidates: List[str] = []
        self._set_up_readline()

    def _set_up_readline(self) -> None:
        try:
            import readline  # noqa: PLC0415 - not every Python has it
        except ImportError:
            # Without readline, lines are read without editing.
            return
        readline.set_completer(self._complete)
        # All characters that cannot be part of an unquoted atom.
        readline.set_completer_delims(" \t\n()[]{}|,;:.!&'\"`+-*/\\<>=")
        readline.parse_and_bind("tab: complete")
        try:
            readline.read_history_file(str(HISTORY_PATH))
        except OSError:
            # There is no history yet.
            pass
        except Exception:
            # Other readline libraries raise other errors on unsupported terminals.
            return
        readline.set_history_length(MAX_HISTORY_LINES)
        atexit.register(_save_history)

    def _complete(self, text: str, index: int) -> Optional[str]:
        if index == 0:
            self._candidates = find_completions(text, self._list_names())
        return self._candidates[index] if index < len(self._candidates) else None

    def read_line(self, prompt: str) -> Optional[str]:
        """Return the next line, or None at the end (ctrl-D)."""
        try:
            with interruptible():
                return input(prompt) + "\n"
        except EOFError:
            print()
            return None

    def wants_more(self) -> bool:
        """Wait for a key; return whether it is ``;``, space, tab, ``n`` or ``r``, which request another solution."""
        while True:
            key = _read_key()
            if key in ("h", "?"):
                print("\n; or blank: more solutions, return or . : stop")
            else:
                return key in (";", " ", "\t", "n", "r")


def _save_history() -> None:
    import readline  # noqa: PLC0415 - not every Python has it

    try:
        readline.write_history_file(str(HISTORY_PATH))
    except OSError as error:
        print(f"% the history cannot be saved: {error.strerror}", file=sys.stderr)


def _read_key() -> str:
    """Return the next key that is pressed."""
    try:
        import termios  # noqa: PLC0415 - not every system has it
        import tty  # noqa: PLC0415 - not every system has it
    except ImportError:
        # Without termios, the first character of the next line is used.
        return input()[:1]
    stdin = sys.stdin.fileno()
    settings = termios.tcgetattr(stdin)
    try:
        # TCSADRAIN keeps input that was typed ahead; the default TCSAFLUSH would discard it.
        tty.setcbreak(stdin, termios.TCSADRAIN)
        sys.stdout.flush()
        with interruptible():
            return sys.stdin.read(1)
    finally:
        termios.tcsetattr(stdin, termios.TCSADRAIN, settings)


def find_completions(text: str, names: Iterable[str]) -> List[str]:
    """Return the names that begin with a text, except those that need quotes."""
    if not _UNQUOTED_ATOM.match(text):
        return []
    return sorted({name for name in names if name.startswith(text) and _UNQUOTED_ATOM.match(name)})


def discard_unread_text(source: Union[PipedInput, TerminalInput]) -> None:
    """Discard the text after the last term in its line, for example after an interrupt."""
    source.unread_text = ""


def open_goal_text(text: str) -> PipedInput:
    """Return the input of a text of goals; the full stop after the last one may be omitted."""
    # On a line of its own: in the last line, the full stop could be part of a comment.
    return PipedInput(StringIO(text if _last_token_kind(text) in _FINAL_TOKENS else f"{text}\n."))


def read_clause(
    source: Union[PipedInput, TerminalInput], logic: PrologSystem, prompt: str
) -> Optional[ParsedTerm]:
    """Return the next term of the input, a `SyntaxFault`, or None at the end.

    Text after the term's full stop in the same line is stored for the next call; after an error it is discarded.
    """
    unparsed_text, source.unread_text = source.unread_text, ""
    while True:
        # Only a full stop can complete a term.
        if "." in unparsed_text:
            program = read_program(unparsed_text, logic.operators, "user", _get_read_flags(logic))
            term = next(iter(program), None)
            if term is None:
                # Comments only.
                unparsed_text = ""
            elif not _is_incomplete(term, unparsed_text):
                if not isinstance(term, SyntaxFault) and unparsed_text[program.end :].strip():
                    source.unread_text = unparsed_text[program.end :]
                return term
        elif not unparsed_text.strip():
            unparsed_text = ""
        line = source.read_line("|    " if unparsed_text.strip() else prompt)
        if line is None:
            return next(
                iter(read_program(unparsed_text, logic.operators, "user", _get_read_flags(logic))), None
            )
        unparsed_text += line


def _is_incomplete(term: ParsedTerm, text: str) -> bool:
    """Return whether a term is incomplete and may continue in the next line."""
    if not isinstance(term, SyntaxFault):
        return False
    # A point at the end can also belong to a comment or to a character code, such as `0'.`.
    if text.rstrip().endswith(".") and _last_token_kind(text) in _FINAL_TOKENS:
        return False
    return term.place is None or term.place.line > text.rstrip("\n").count("\n")


_FINAL_TOKENS = (END, "bad")
"""Kinds of tokens at the end of a text that no full stop makes valid."""


def _last_token_kind(text: str) -> str:
    """Return the kind of the last token of a text; "" if it has none."""
    last_token = deque(tokenize(Source("user", text), ReadFlags), 1)
    return last_token[0][0] if last_token else ""


def _get_read_flags(logic: PrologSystem) -> ReadFlags:
    return ReadFlags(
        double_quotes=_get_atom_name(logic.flags["double_quotes"]),
        back_quotes=_get_atom_name(logic.flags["back_quotes"]),
        iso=_get_atom_name(logic.flags["iso"]) == "true",
    )


def _get_atom_name(value: Term) -> str:
    """Return the name of a flag's value, which must be an atom."""
    assert isinstance(value, Atom)
    return value.name
