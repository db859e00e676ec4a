"""What built-ins are called with: the machine, and the program that it runs, as far as they need to know them."""

from typing import Any, Callable, Dict, Iterator, List, Mapping, Optional, Protocol, Tuple, Union

from ...foundation import Place
from ..database import Clause, Control, Database, Predicate
from ..machine import Budget, Frame
from ..syntax import Operators
from ..terms import Functor, Term, Trail

Solutions = Iterator[object]
"""What a nondeterministic predicate yields at each solution: None, or `LAST` where there is surely no other."""

Outcome = Union[bool, Solutions]
"""The same, or whether there is a solution where the arguments leave one at most."""


class StreamFiles(Protocol):
    """Opens the files that goals may open."""

    def to_read(self, name: Term, encoding: str = "utf-8") -> Tuple[str, str]:
        """Return the path of a file and its text; with latin-1, each byte is a character."""

    def to_write(self, name: Term, more: bool) -> str:
        """Return the path of a file that may be written; it is empty but where ``more`` is added to it."""

    def add(self, path: str, text: str, encoding: str = "utf-8") -> None:
        """Write a text to the end of a file."""

    def absolute(self, name: str) -> str:
        """Return a path from the root, seen from where relative names start."""

    def is_readable(self, path: str) -> bool:
        """Tell whether there is such a file, which goals may read."""

    def is_folder(self, path: str) -> bool:
        """Tell whether there is such a folder, whose files goals may read."""


class MachineProgram(Protocol):
    """The program that a machine runs, see `Logic`."""

    control: Control
    database: Database
    operators: Operators
    flags: Dict[str, Term]
    globals: Dict[str, Term]
    state: Dict[str, Any]
    column: int
    output: Callable[[str], None]
    error_output: Callable[[str], None]
    message: Callable[[str, str], None]
    files: Optional[StreamFiles]
    ask: Optional[Callable[[], Optional[str]]]
    now: Callable[[], int]
    environment: Optional[Mapping[str, str]]

    def require_flags(self, flag: Term) -> None:
        """Require that the goal at work may change a flag."""

    def once(self, goal: Term) -> bool:
        """Run a goal for its first solution, whose bindings stay."""

    def write(self, text: str) -> None:
        """Write to the current output."""

    def show(self, term: Term, quoted: bool = True) -> str:
        """Return a term as text."""

    def add_clause(
        self, term: Term, place: Optional[Place] = None, first: bool = False, asserted: bool = False
    ) -> Clause:
        """Add a clause."""

    def defines(self, key: Functor) -> bool:
        """Tell whether there is such a predicate."""

    def lookup(self, key: Functor) -> Optional[Predicate]:
        """Return the predicate of a functor if it is defined."""


class Machine(Protocol):
    """The machine, as predicates in Python see it."""

    trail: Trail
    choices: List[Frame]
    budget: Budget
    logic: MachineProgram

    def unify(self, left: Term, right: Term) -> bool:
        """Make two terms equal, or bind nothing."""

    def unify_all(self, *pairs: Tuple[Term, Term]) -> bool:
        """Unify pairs of terms, all or none."""
