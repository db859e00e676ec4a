"""What built-ins are called with: the machine, and the program that it runs, as far as they need to know them.

Registration of predicates that are written in Python.

Modules of this package register theirs when they are imported; `Logic` defines all of them.
"""

from typing import (
    Any,
    Callable,
    Dict,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Protocol,
    Tuple,
    TypeVar,
    Union,
)

from ...foundation.errors import Place
from ..database.clause_index import Clause
from ..database.control_constructs import Control
from ..database.database import Database
from ..database.predicate import Predicate
from ..machine.resource_limits import Budget
from ..syntax.operators import Operators
from ..terms.types import Frame, Functor, Term, Trail

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


Function = TypeVar("Function", bound=Callable[..., object])
Test = TypeVar("Test", bound=Callable[..., bool])
Search = TypeVar("Search", bound=Callable[..., Outcome])
Jump = TypeVar("Jump", bound=Callable[..., Optional[Frame]])


class Entry(NamedTuple):
    """A predicate in Python.

    Attributes:
        kind: "deterministic", "function", "nondeterministic" or "control".
        function: see `Logic.define` and its sisters.
        locked: goals that look its clauses up, or assert some, get an error; see `Predicate.system`.
    """

    kind: str
    function: Callable[..., object]
    locked: bool


ENTRIES: Dict[Tuple[str, int], Entry] = {}


def _register(kind: str, names: Tuple[str, ...], locked: bool) -> Callable[[Function], Function]:
    keys: List[Tuple[str, int]] = []
    for text in names:
        name, _, arity = text.rpartition("/")
        keys.append((name, int(arity)))

    def register(function: Function) -> Function:
        for key in keys:
            ENTRIES[key] = Entry(kind, function, locked)
        return function

    return register


def deterministic(*names: str, locked: bool = True) -> Callable[[Test], Test]:
    """Register ``function(machine, *args) -> bool`` under indicators such as ``"atom_length/2"``."""
    return _register("deterministic", names, locked)


def function(*names: str, locked: bool = True) -> Callable[[Function], Function]:
    """Register ``function(*inputs)``, which returns what the last argument is, or None where it fails."""
    return _register("function", names, locked)


def nondeterministic(*names: str, locked: bool = True) -> Callable[[Search], Search]:
    """Register a generator ``function(machine, *args)``; see `Logic.define_nondeterministic`."""
    return _register("nondeterministic", names, locked)


def control(*names: str, locked: bool = True) -> Callable[[Jump], Jump]:
    """Register ``function(machine, args, next) -> frame or None``."""
    return _register("control", names, locked)
