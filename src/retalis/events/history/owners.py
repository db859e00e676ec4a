"""The program whose events are kept, as far as what keeps them looks at it."""

from typing import Callable, Optional, Protocol, Sequence

from ...foundation import Place, RetalisError
from ...prolog.foreign import NamedFiles
from ...prolog.logic import Logic
from ...prolog.machine import Frame
from ...prolog.terms import Term
from ..dispatch import Dispatcher
from ..language import RuleDefinition
from ..matches import Bounds


class Fired(Protocol):
    """A rule that fires events."""

    @property
    def definition(self) -> RuleDefinition:
        """What it says."""

    @property
    def label(self) -> Optional[Term]:
        """Its label, or None."""

    @property
    def name(self) -> str:
        """What reports call it."""

    @property
    def place(self) -> Optional[Place]:
        """Where it stands."""

    def fire(self, head: Term, start: int, end: int, after: Frame, token: object = None) -> Frame:
        """Return the frame that dispatches the head and goes on with ``after``."""

    def add_those_of_other_events(self, event: object) -> None:
        """Let those matches wait that were to wait when another event comes."""


class Switches(Protocol):
    """The flags of the program."""

    def is_on(self, name: str) -> bool:
        """Tell whether a switch is on."""


class Remembered(Bounds, Protocol):
    """All rules of a program, as what keeps their events sees them."""

    @property
    def on_warning(self) -> Callable[[RetalisError], None]:
        """Called with each warning."""

    @property
    def logic(self) -> Logic:
        """Where its clauses are."""

    @property
    def dispatcher(self) -> Dispatcher:
        """Whose events they are."""

    @property
    def flags(self) -> Switches:
        """Its flags."""

    @property
    def files(self) -> NamedFiles:
        """Its files."""

    @property
    def rules(self) -> Sequence[Fired]:
        """The rules that take events, oldest first."""

    def took_nothing_back(self, term: Term, rule: Optional[Fired]) -> None:
        """Report an event ``rev(E)`` where there is no E to take back."""
