"""What files are loaded into, as those who load or check them know it."""

from typing import Dict, Hashable, List, Protocol

from ...prolog.terms import Term
from ..language import Declarations, Property, RuleDefinition
from ..network import Network, Rule
from .files import Files


class KnownDeclarations(Protocol):
    """The events that a program has declared, as what loads its files sees them."""

    def now(self) -> Declarations:
        """Return the declarations that hold, to which others may be added without anybody seeing it."""


class Loaded(Network, Protocol):
    """All rules of a program, as what loads them sees them.

    Attributes:
        warn_singletons: whether variables that stand in a clause only once are worth a warning.
        serial: how many rules there have been.
    """

    warn_singletons: bool
    serial: int

    @property
    def files(self) -> Files:
        """The files of the program."""

    @property
    def declared(self) -> "KnownDeclarations":
        """The events that have been declared."""

    @property
    def rules(self) -> List[Rule]:
        """The rules that take events."""

    def terms(self) -> List[Term]:
        """Return the rules as they were written, and the bodies of the program's clauses."""

    def compile(self, definition: RuleDefinition) -> Rule:
        """Build a rule without having it take events."""

    def activate(self, rule: Rule) -> None:
        """Have a rule take events."""

    def remove(self, rule: Rule) -> None:
        """Take a rule out, with its partial matches."""

    def set_property(self, one: Property) -> None:
        """Give a label a property."""

    def all_properties(self) -> Dict[Hashable, List[Property]]:
        """Return the properties of all labels."""

    def restore_properties(self, properties: Dict[Hashable, List[Property]]) -> None:
        """Have the labels have these properties and no others."""
