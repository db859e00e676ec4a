"""What those who write code know of predicates; the rooms above have them."""

from typing import Any, Callable, Iterator, Mapping, NamedTuple, Optional, Protocol, Sequence, Tuple

from ...foundation import Place
from ..machine import Machine, Step
from ..terms import CompoundTerm, Functor, Term

Finder = Callable[..., Optional[bool]]
"""A predicate as a function of its arguments: whether there is a solution, None where it cannot tell."""


class KnownClause(Protocol):
    """A clause."""

    head: Term
    body: Term
    place: Optional[Place]

    @property
    def is_large(self) -> bool:
        """Whether it is so large that it is interpreted always."""


class JoinedGoals(NamedTuple):
    """Goals in a row that one function does; see `joining`.

    Attributes:
        length: how many goals.
        function: takes the inputs; returns the output, or None where a goal fails.
        inputs: arguments of the goals.
        output: the argument that the last goal gives.
    """

    length: int
    function: Callable[..., Optional[Term]]
    inputs: Tuple[Term, ...]
    output: Term


Joins = Callable[[Sequence[CompoundTerm], Mapping[Any, int]], Optional[JoinedGoals]]
"""Takes goals in a row, the first that of the predicate itself, and how often variables occur in the clause."""


class KnownFunction(Protocol):
    """What a predicate computes that is a function of some of its arguments; see `Functional`."""

    @property
    def function(self) -> Callable[..., Any]:
        """Takes the inputs, returns the outputs."""

    @property
    def inputs(self) -> Tuple[int, ...]:
        """Positions of the inputs."""

    @property
    def outputs(self) -> Tuple[int, ...]:
        """Positions of the outputs."""

    @property
    def shows(self) -> Tuple[Optional[Callable[..., Term]], ...]:
        """What makes the terms of the outputs."""

    @property
    def single(self) -> bool:
        """Whether there is one output."""

    @property
    def joins(self) -> Optional[Joins]:
        """What tells which goals after one of it go together with it."""


class KnownFinders(Protocol):
    """The functions of a predicate; see `Direct`."""

    first: Finder
    only: Finder

    def prepare(self, once: bool) -> None:
        """Generate a function before it is called."""


class KnownPredicate(Protocol):
    """A predicate; see `Predicate`."""

    functor: Functor
    kind: str
    function: Optional[Callable[..., Any]]
    gate: Optional[Callable[[Functor, Tuple[int, ...]], object]]
    known: Optional[Functor]
    compiled: bool
    steady: bool
    dynamic: bool
    library: bool
    system: bool
    ground: bool

    @property
    def run(self) -> Step:
        """The function that does a call."""

    @property
    def functional(self) -> Optional[KnownFunction]:
        """What it computes."""

    @property
    def tabled(self) -> object:
        """The predicate that its clauses belong to where tables answer its calls."""

    def live(self) -> Iterator[KnownClause]:
        """Yield its clauses."""

    def fact_finder(self, once: bool) -> Finder:
        """Return a function of the arguments that looks a ground fact up."""

    def __len__(self) -> int: ...


class KnownModules(Protocol):
    """The modules of a program; see `Modules`."""

    def named(self, term: Term, /) -> Optional[object]:
        """Return the module that a term names."""

    def goal(self, goal: CompoundTerm, /) -> Term:
        """Return what ``Module:Goal`` calls."""


class KnownDatabase(Protocol):
    """All predicates; see `Database` and `Library`."""

    machine: Machine

    @property
    def modules(self) -> KnownModules:
        """The modules of the program."""

    @property
    def is_library(self) -> bool:
        """Whether these are the predicates as the library sees them."""

    @property
    def interprets(self) -> bool:
        """Whether nothing of the program is compiled."""

    @property
    def interpret(self) -> object:
        """The code that runs a goal from its term."""

    def predicate(self, key: Functor, /) -> KnownPredicate:
        """Return the predicate of a functor."""

    def is_inline(self, key: Functor, /) -> bool:
        """Tell whether a predicate is a deterministic built-in."""

    def direct(self, key: Functor, /) -> KnownFinders:
        """Return the functions of a predicate."""
