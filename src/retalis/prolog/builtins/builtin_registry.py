"""Registry of built-in predicates that are written in Python.

Each module of this package registers its predicates with a decorator when it is imported; `predicate_resolution`
imports them all, and `PredicateTable` defines every entry of `ENTRIES` in each new program. The decorator states how
a predicate is called:

* `deterministic`: a function that unifies its arguments and returns whether the predicate succeeds;
* `function`: a function of the inputs that returns the value of the last argument, so that compiled clauses can
  call it without a machine;
* `nondeterministic`: a generator that yields at each solution;
* `control`: a function that returns the next frame of the machine, for predicates that call goals.

Functions get a `ProgramMachine`; by its attribute ``logic`` they read the program, and print or call for it.
"""

from typing import (
    TYPE_CHECKING,
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

from ..database.clause_index import Clause
from ..database.goal_interpreter import Control
from ..database.predicate import Predicate
from ..database.predicate_database import Database
from ..machine.machine import Machine
from ..machine.resource_limits import Budget
from ..syntax.operators import Operators
from ..terms.types import Frame, Functor, Term

if TYPE_CHECKING:
    from ..files.source_files import SourceFiles

Solutions = Iterator[object]
"""Solutions of a nondeterministic predicate: it yields None at each, or `LAST` if it is known to be the last one."""

Outcome = Union[bool, Solutions]
"""Solutions, or a boolean if the arguments allow at most one solution."""


Function = TypeVar("Function", bound=Callable[..., object])
DeterministicFunction = TypeVar("DeterministicFunction", bound=Callable[..., bool])
NondeterministicFunction = TypeVar("NondeterministicFunction", bound=Callable[..., Outcome])
ControlFunction = TypeVar("ControlFunction", bound=Callable[..., Optional[Frame]])


class ProgramInterface(Protocol):
    """A program as built-in predicates use it; see the attributes and methods of `PrologSystem`."""

    database: Database
    control: Control
    operators: Operators
    flags: Dict[str, Term]
    globals: Dict[str, Term]
    state: Dict[str, Any]
    output: Callable[[str], None]
    error_output: Callable[[str], None]
    column: int
    now: Callable[[], int]
    ask: Optional[Callable[[], Optional[str]]]
    files: "Optional[SourceFiles]"
    environment: Optional[Mapping[str, str]]

    def add_clause(self, term: Term, *, first: bool, asserted: bool) -> Clause:
        """Add a copy of a clause."""

    def lookup(self, key: Functor) -> Optional[Predicate]:
        """Return the predicate of a functor, or None."""

    def defines(self, key: Functor) -> bool:
        """Return whether a predicate is defined."""

    def once(self, goal: Term) -> bool:
        """Run a goal for its first solution; return whether there is one."""

    def require_flags(self, flag: Term) -> None:
        """Require that the running goal may change a flag."""

    def redirect(self, output: Callable[[str], None], column: int) -> None:
        """Set the current output, and the column of its next text."""

    def write(self, text: str) -> None:
        """Write to the current output."""

    def message(self, kind: str, text: str) -> None:
        """Print a message of a kind."""

    def show(self, term: Term, quoted: bool = True) -> str:
        """Return a term as text."""


class ProgramMachine(Machine):
    """Machine of a program, the first argument of built-in predicates."""

    def __init__(self, logic: ProgramInterface, budget: Budget):
        super().__init__(budget)
        self.logic = logic


class Entry(NamedTuple):
    """A registered predicate.

    Attributes:
        kind: "deterministic", "function", "nondeterministic" or "control".
        function: see `PredicateTable.define`, `define_function`, `define_nondeterministic` and `define_control`.
        is_protected: whether access to its clauses raises a permission error; see `Predicate.is_protected`.
    """

    kind: str
    function: Callable[..., object]
    is_protected: bool


ENTRIES: Dict[Tuple[str, int], Entry] = {}


def _register(kind: str, names: Tuple[str, ...], is_protected: bool) -> Callable[[Function], Function]:
    """Return a decorator that adds a function to `ENTRIES` under each of some predicate indicators."""
    keys: List[Tuple[str, int]] = []
    for text in names:
        # Split at the last slash, since a name may contain slashes itself, as in `//2`.
        name, _, arity = text.rpartition("/")
        keys.append((name, int(arity)))

    def register(function: Function) -> Function:
        for key in keys:
            ENTRIES[key] = Entry(kind, function, is_protected)
        return function

    return register


def deterministic(
    *names: str, is_protected: bool = True
) -> Callable[[DeterministicFunction], DeterministicFunction]:
    """Register ``function(machine, *args) -> bool`` under indicators such as ``"atom_length/2"``."""
    return _register("deterministic", names, is_protected)


def function(*names: str, is_protected: bool = True) -> Callable[[Function], Function]:
    """Register ``function(*inputs)``, which returns the value of the last argument, or None for failure."""
    return _register("function", names, is_protected)


def nondeterministic(
    *names: str, is_protected: bool = True
) -> Callable[[NondeterministicFunction], NondeterministicFunction]:
    """Register a generator ``function(machine, *args)``; see `PredicateTable.define_nondeterministic`."""
    return _register("nondeterministic", names, is_protected)


def control(*names: str, is_protected: bool = True) -> Callable[[ControlFunction], ControlFunction]:
    """Register ``function(machine, args, next) -> frame or None``, where None is failure."""
    return _register("control", names, is_protected)
