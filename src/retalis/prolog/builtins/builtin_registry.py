"""Registry of built-in predicates that are written in Python.

Each module of this package registers its predicates with a decorator when it is imported (`all_builtins` imports them
all); `PredicateTable` defines every entry of `ENTRIES` in each new program. The decorator states how a predicate is
called:

* `deterministic`: a function that unifies its arguments and returns whether the predicate succeeds;
* `function`: a function of the inputs that returns the value of the last argument, so that compiled clauses can call
it
  without a machine;
* `nondeterministic`: a generator that yields at each solution;
* `control`: a function that returns the next frame of the machine, for predicates that call goals.
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
"""Solutions of a nondeterministic predicate: it yields None at each, or `LAST` if it is known to be the last one."""

Outcome = Union[bool, Solutions]
"""Solutions, or a boolean if the arguments allow at most one solution."""


class StreamFiles(Protocol):
    """Access to the files that goals may open."""

    def to_read(self, name: Term, encoding: str = "utf-8") -> Tuple[str, str]:
        """Return the path of a file and its text; with latin-1, each byte is a character."""

    def to_write(self, name: Term, more: bool) -> str:
        """Return the path of a file that may be written; it is emptied unless ``more``, which appends."""

    def add(self, path: str, text: str, encoding: str = "utf-8") -> None:
        """Append a text to a file."""

    def absolute(self, name: str) -> str:
        """Return an absolute path; relative names start at the program's folder."""

    def is_readable(self, path: str) -> bool:
        """Return whether a file exists and goals may read it."""

    def is_folder(self, path: str) -> bool:
        """Return whether a folder exists and goals may read its files."""


class MachineProgram(Protocol):
    """The program that a machine runs; implemented by `PrologSystem`."""

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
        """Raise a permission error if the running goal may not change a flag."""

    def once(self, goal: Term) -> bool:
        """Run a goal for its first solution, and keep its bindings."""

    def write(self, text: str) -> None:
        """Write to the current output."""

    def show(self, term: Term, quoted: bool = True) -> str:
        """Return the text of a term."""

    def add_clause(
        self, term: Term, place: Optional[Place] = None, first: bool = False, asserted: bool = False
    ) -> Clause:
        """Add a clause."""

    def defines(self, key: Functor) -> bool:
        """Return whether a predicate is defined."""

    def lookup(self, key: Functor) -> Optional[Predicate]:
        """Return the predicate of a functor, or None if it is not defined."""


class Machine(Protocol):
    """The interface of the machine for predicates in Python."""

    trail: Trail
    choices: List[Frame]
    budget: Budget
    logic: MachineProgram

    def unify(self, left: Term, right: Term) -> bool:
        """Unify two terms; nothing is bound on failure."""

    def unify_all(self, *pairs: Tuple[Term, Term]) -> bool:
        """Unify pairs of terms; nothing is bound on failure."""


Function = TypeVar("Function", bound=Callable[..., object])
Test = TypeVar("Test", bound=Callable[..., bool])
Search = TypeVar("Search", bound=Callable[..., Outcome])
Jump = TypeVar("Jump", bound=Callable[..., Optional[Frame]])


class Entry(NamedTuple):
    """A registered predicate.

    Attributes:
        kind: "deterministic", "function", "nondeterministic" or "control".
        function: see `PredicateTable.define`, `define_function`, `define_nondeterministic` and `define_control`.
        locked: whether goals that access its clauses or add some raise a permission error; see `Predicate.system`.
    """

    kind: str
    function: Callable[..., object]
    locked: bool


ENTRIES: Dict[Tuple[str, int], Entry] = {}


def _register(kind: str, names: Tuple[str, ...], locked: bool) -> Callable[[Function], Function]:
    """Return a decorator that adds a function to `ENTRIES` under each of some predicate indicators."""
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
    """Register ``function(*inputs)``, which returns the value of the last argument, or None for failure."""
    return _register("function", names, locked)


def nondeterministic(*names: str, locked: bool = True) -> Callable[[Search], Search]:
    """Register a generator ``function(machine, *args)``; see `PredicateTable.define_nondeterministic`."""
    return _register("nondeterministic", names, locked)


def control(*names: str, locked: bool = True) -> Callable[[Jump], Jump]:
    """Register ``function(machine, args, next) -> frame or None``, where None is failure."""
    return _register("control", names, locked)
