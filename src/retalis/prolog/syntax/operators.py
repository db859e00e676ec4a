"""Operator tables: Prolog's operators, those of the event language, and those that programs declare.

The reader knows no event operator by itself. The event language registers them in `EVENT_SYNTAX` when its module
`event_operators` is imported; a Prolog system without the event language has Prolog's operators only.
"""

from functools import lru_cache
from typing import (
    TYPE_CHECKING,
    AbstractSet,
    Dict,
    Iterable,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
)

from ...foundation.errors import UsageError
from ..terms.types import Functor, functor

if TYPE_CHECKING:
    from .named_slots import MessageTypes


class Operator(NamedTuple):
    """A definition of an operator.

    Attributes:
        priority: 1 to 1200.
        left: highest priority of the left argument; 0 for prefix operators.
        right: highest priority of the right argument; 0 for postfix operators.
        functor: functor of the terms that it builds.
        type: ``xfx``, ``xfy``, ``yfx``, ``fy``, ``fx``, ``xf`` or ``yf``.
    """

    priority: int
    left: int
    right: int
    functor: Functor
    type: str


class OperatorChange(NamedTuple):
    """Operator that differs from the standard one, see `Operators.changes`.

    Attributes:
        priority: 1 to 1200; 0 if the operator is removed.
        type: see `Operator`.
    """

    priority: int
    type: str
    name: str


DECLARE_EVENT = functor("declare_event", 1)
DECLARING = Operator(1150, 0, 1149, DECLARE_EVENT, "fx")
"""The operator ``event`` of a declaration, ``:- event E.``.

It is in no table, and applies only at the beginning of a directive or goal, before a name. So ``event(E)`` remains an
ordinary term everywhere else, and is written as one.
"""

_INFIX, _PREFIX, _POSTFIX = ("xfx", "xfy", "yfx"), ("fy", "fx"), ("xf", "yf")
TYPES = _INFIX + _PREFIX + _POSTFIX
"""Operator types of ISO 13211-1, 6.3.4."""

_ISO = """
1200 xfx :- -->
1200 fx :- ?-
1100 xfy ;
1050 xfy ->
1000 xfy ,
900 fy \\+
700 xfx = \\= == \\== @< @=< @> @>= =.. is =:= =\\= < =< > >=
500 yfx + - /\\ \\/
400 yfx * / // mod rem div << >>
200 xfx **
200 xfy ^
200 fy - + \\
"""
"""Operators of ISO 13211-1, 6.3.4.4: priority, type and names."""

_SWI = """
1200 xfx =>
1150 fx dynamic discontiguous initialization meta_predicate module_transparent multifile public table
1150 fx thread_initialization thread_local volatile
1105 xfy |
1050 xfy *->
800 xfx :=
700 xfx =@= \\=@= >:< :< as
600 xfy :
400 yfx rdiv xor
1 fx $
"""
"""Further operators of SWI-Prolog 9."""


class EventSyntax:
    """Syntax of the operators of the event language; empty until they are registered.

    Attributes:
        canonical: spelling of an operator -> its canonical name.
        signs: event operators denoted by signs within patterns; elsewhere the signs are Prolog's operators.
        canonical_in_patterns: `canonical` and `signs` together.
        markers: names without which a clause contains no event rule, so that most clauses are not analysed.
        arrows: names of the operators between the head and the pattern of a rule.
        goal_right: operators of patterns whose right argument is a goal or a number; Prolog's operators apply in it.
        pattern_arguments: for operators in functional notation within a pattern, which arguments are patterns.
        joining: names of the operators between two patterns, for error messages.
        advice: words that users mistake for event operators, with the notation to use.
    """

    def __init__(self) -> None:
        self.canonical: Mapping[str, str] = {}
        self.signs: Mapping[str, str] = {}
        self.canonical_in_patterns: Mapping[str, str] = {}
        self.markers: AbstractSet[str] = frozenset()
        self.arrows: AbstractSet[str] = frozenset()
        self.goal_right: AbstractSet[Functor] = frozenset()
        self.pattern_arguments: Mapping[Functor, Tuple[bool, ...]] = {}
        self.joining: Sequence[str] = ()
        self.advice: Mapping[str, str] = {}

    def register(
        self,
        operators: Iterable[Tuple[int, str, str]],
        *,
        canonical: Mapping[str, str],
        signs: Mapping[str, str],
        arrows: AbstractSet[str],
        goal_right: AbstractSet[Functor],
        pattern_arguments: Mapping[Functor, Tuple[bool, ...]],
        joining: Sequence[str],
        advice: Mapping[str, str],
    ) -> None:
        """Set the syntax, and add the operators to the standard table.

        Tables that were copied from the standard table before do not change.

        Args:
            operators: priority, type and canonical name of each operator.
            canonical: see `EventSyntax`, as for the other arguments.
            signs: see `EventSyntax`.
            arrows: see `EventSyntax`.
            goal_right: see `EventSyntax`.
            pattern_arguments: see `EventSyntax`.
            joining: see `EventSyntax`.
            advice: see `EventSyntax`.
        """
        self.canonical = canonical
        self.signs = signs
        self.canonical_in_patterns = {**canonical, **signs}
        self.markers = frozenset(
            name for name, canonical_name in canonical.items() if canonical_name in ("<-", "do", "rule:")
        )
        self.arrows = arrows
        self.goal_right = goal_right
        self.pattern_arguments = pattern_arguments
        self.joining = joining
        self.advice = advice
        table = standard_operators()
        for priority, op_type, name in operators:
            table.add(priority, op_type, name)
        for spelling, name in canonical.items():
            for definitions in (table.infix, table.postfix):
                if name in definitions:
                    definitions[spelling] = definitions[name]


EVENT_SYNTAX = EventSyntax()
"""The syntax of the event language in this process."""


class Operators:
    """A table of operators.

    `prolog` returns the usual one; programs change their own copy with `add`. A name may be a prefix operator and, at
    the same time, an infix or postfix one.

    Attributes:
        message_types: the message types that parsers with this table know; None if there are no messages.

    >>> engine = Engine()
    >>> engine.call("op(700, xfx, near)")
    True
    >>> "near" in engine.operators
    True
    """

    __slots__ = ("prefix", "infix", "postfix", "message_types", "_patterns")

    def __init__(self, message_types: "Optional[MessageTypes]" = None) -> None:
        self.prefix: Dict[str, Operator] = {}
        self.infix: Dict[str, Operator] = {}
        self.postfix: Dict[str, Operator] = {}
        self.message_types = message_types
        self._patterns: Optional[Dict[str, Operator]] = None

    @classmethod
    def prolog(cls, message_types: "Optional[MessageTypes]" = None) -> "Operators":
        """Return a table with the operators of ISO Prolog, SWI-Prolog 9 and, if it is loaded, the event language.

        Args:
            message_types: the message types that parsers with this table know; None if there are no messages.

        >>> "seq" in Operators.prolog()
        True
        """
        table = cls(message_types)
        table.become(standard_operators())
        return table

    @classmethod
    def iso(cls) -> "Operators":
        """Return a table with the operators of ISO 13211-1 only.

        >>> "seq" in Operators.iso(), "mod" in Operators.iso()
        (False, True)
        """
        return _read_table(_ISO)

    def copy(self) -> "Operators":
        """Return an independent table with the same operators.

        >>> operators = Operators.prolog()
        >>> operators.copy().add(0, "yfx", "mod")
        >>> "mod" in operators
        True
        """
        table = Operators(self.message_types)
        table.become(self)
        return table

    def become(self, source: "Operators") -> None:
        """Replace the operators by those of another table.

        >>> operators = Operators.prolog()
        >>> operators.become(Operators.iso())
        >>> "seq" in operators
        False
        """
        # In place, because the readers and writers of a program refer to this object.
        self.prefix, self.infix, self.postfix = dict(source.prefix), dict(source.infix), dict(source.postfix)
        self._patterns = None

    def add(self, priority: int, op_type: str, name: str) -> None:
        """Define an operator, or remove it if ``priority`` is 0.

        >>> operators = Operators.prolog()
        >>> operators.add(700, "xfx", "near")
        >>> operators.find("near")[0].priority
        700

        Args:
            priority: 0 to 1200.
            op_type: one of ``xfx xfy yfx fy fx xf yf``.
            name: the name; another spelling of an event operator builds the same terms as that operator.

        Raises:
            UsageError: if the priority or type is invalid.
        """
        if not 0 <= priority <= 1200:
            raise UsageError(f"{priority} is not an operator priority: expected 0 to 1200")
        if op_type not in TYPES:
            raise UsageError(f"{op_type} is not an operator type: expected one of {' '.join(TYPES)}")
        table, arity = self._table(op_type)
        self._patterns = None
        if priority == 0:
            table.pop(name, None)
            return
        # `x` stands for an argument of a lower priority, `y` for one of at most the same priority.
        place = op_type.index("f")
        left = 0 if place == 0 else priority - (op_type[0] == "x")
        right = 0 if place == len(op_type) - 1 else priority - (op_type[-1] == "x")
        table[name] = Operator(
            priority, left, right, functor(EVENT_SYNTAX.canonical.get(name, name), arity), op_type
        )

    def _table(self, op_type: str) -> Tuple[Dict[str, Operator], int]:
        if op_type in _INFIX:
            return self.infix, 2
        return (self.prefix, 1) if op_type in _PREFIX else (self.postfix, 1)

    def patterns(self) -> Dict[str, Operator]:
        """Return the infix operators within patterns, where ``*`` is ``seq`` and so on.

        >>> Operators.prolog().patterns()["*"].functor
        functor('seq', 2)
        """
        table = self._patterns
        if table is None:
            table = self._patterns = dict(self.infix)
            # A program may have changed the priority of the event operator; its sign has the same one.
            for sign, name in EVENT_SYNTAX.signs.items():
                standard = standard_operators().infix[name]
                table[sign] = self.infix.get(name, standard)._replace(functor=standard.functor)
        return table

    def find(self, name: str) -> List[Operator]:
        """Return the definitions of a name: prefix, infix, postfix, as far as defined.

        >>> [found.type for found in Operators.prolog().find("-")]
        ['fy', 'yfx']
        """
        tables = (self.prefix, self.infix, self.postfix)
        return [table[name] for table in tables if name in table]

    def __contains__(self, name: str) -> bool:
        return name in self.infix or name in self.prefix or name in self.postfix

    def __iter__(self) -> Iterator[Tuple[int, str, str]]:
        """Yield priority, type and name of every operator, as ``current_op/3`` does."""
        for table in (self.prefix, self.infix, self.postfix):
            for name, operator in table.items():
                yield operator.priority, operator.type, name

    def changes(self) -> List[OperatorChange]:
        """Return each operator that differs from `prolog`; with priority 0 for one that it lacks.

        >>> operators = Operators.prolog()
        >>> operators.add(700, "xfx", "near")
        >>> operators.add(0, "fx", "dynamic")
        >>> [(change.name, change.priority) for change in operators.changes()]
        [('dynamic', 0), ('near', 700)]
        """
        standard = standard_operators()
        changes = []
        for table, standard_table in (
            (self.prefix, standard.prefix),
            (self.infix, standard.infix),
            (self.postfix, standard.postfix),
        ):
            if table != standard_table:
                changes += [
                    OperatorChange(operator.priority, operator.type, name)
                    for name, operator in table.items()
                    if standard_table.get(name) != operator
                ]
                changes += [
                    OperatorChange(0, operator.type, name)
                    for name, operator in standard_table.items()
                    if name not in table
                ]
        return changes


def _read_table(text: str) -> Operators:
    operators = Operators()
    for line in text.strip().split("\n"):
        priority, op_type, *names = line.split()
        for name in names:
            operators.add(int(priority), op_type, name)
    return operators


@lru_cache(maxsize=1)
def standard_operators() -> Operators:
    """Return the shared table behind `Operators.prolog`, which must not be changed."""
    return _read_table(_ISO + _SWI.strip())
