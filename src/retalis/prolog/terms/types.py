"""The kinds of terms, the types that all floors share, and the few terms that everybody names.

=============== =============================================================================
type            what it is
=============== =============================================================================
`Term`          anything that programs, events and messages are made of
`CompoundTerm`  a term with arguments: a tuple whose first item is its `Functor`
`Values`        arguments of a goal, or what the variables of a clause or a rule stand for
`Trail`         what was bound, to be taken back
`Frame`         a step with what it needs, and the frame that follows it
`Step`          the function that does a step
`Runs`          what a frame begins with
`EventAction`   what is done with an event that fits a pattern
=============== =============================================================================

The last four stand here, though no term is a frame, because they are written in terms of the first ones and of one
another, and because every room above names them: the machine runs frames, listeners and nodes return them. They name
nothing of those rooms; what does is described where it is used.
"""

import sys
from itertools import count
from typing import TYPE_CHECKING, Any, Callable, Dict, List, Optional, Protocol, Tuple, Union
from weakref import ref

from ...foundation.python_interpreter import remove_dead


class Bound(Protocol):
    """What stands on a trail: a variable, or something else that is taken back by setting its ``ref`` to None."""

    ref: Any


Trail = List[Bound]
"""What was bound since the choice points were pushed, oldest first."""


class Atom:
    """A constant; made by `atom`, which gives the same object for the same name.

    ``functor`` is the `Functor` of the name and arity 0, made when it is asked for.

    >>> (solution,) = Engine().query("X = red")
    >>> solution["X"].name, isinstance(solution["X"], Atom), solution["X"] is atom("red")
    ('red', True, True)
    """

    __slots__ = ("name", "functor", "__weakref__")

    name: str
    functor: "Functor"

    def __getattr__(self, attribute: str) -> "Functor":
        if attribute != "functor":
            raise AttributeError(attribute)
        made = self.functor = functor(self.name, 0)
        return made

    def __repr__(self) -> str:
        return f"atom({self.name!r})"

    def __reduce__(self) -> Tuple[object, ...]:
        return atom, (self.name,)


class Functor:
    """Name and arity of a compound term; made by `functor`, one object for each pair.

    Call it to build a term. The term is a tuple that begins with it:

    >>> point = functor("point", 2)
    >>> term = point(1, 2)
    >>> term[0] is point, term[0].name, term[1:]
    (True, 'point', (1, 2))

    ``atom`` is the `Atom` of its name, made when it is asked for.
    """

    __slots__ = ("name", "arity", "atom", "__weakref__")

    name: str
    arity: int
    atom: Atom

    def __getattr__(self, attribute: str) -> Atom:
        if attribute != "atom":
            raise AttributeError(attribute)
        made = atom(self.name)
        if self.arity:  # an atom holds the functor without arguments
            self.atom = made
        return made

    def __call__(self, *args: "Term") -> "CompoundTerm":
        """Return the compound term with these arguments (as many as the arity says)."""
        return (self, *args)

    def __repr__(self) -> str:
        return f"functor({self.name!r}, {self.arity})"

    def __str__(self) -> str:
        return f"{self.name}/{self.arity}"

    def __reduce__(self) -> Tuple[object, ...]:
        return functor, (self.name, self.arity)


class String:
    """A Prolog string: text that is not an atom. Equal strings are equal terms.

    >>> Engine().show(String("two words"))
    '"two words"'
    """

    __slots__ = ("text",)

    def __init__(self, text: str):
        self.text = text

    def __eq__(self, other: Any) -> bool:
        return other.__class__ is String and other.text == self.text

    def __hash__(self) -> int:
        return hash((String, self.text))

    def __repr__(self) -> str:
        return f"String({self.text!r})"


class Var:
    """A logic variable: ``ref`` is None while it is unbound, the term it stands for afterwards.

    >>> engine = Engine()
    >>> engine.load(rules="near(kitchen, hall). near(garden, hall).")
    >>> goal = functor("near", 2)(Var(), atom("hall"))
    >>> [engine.show(found["_0"]) for found in engine.query(goal)]
    ['kitchen', 'garden']
    """

    __slots__ = ("ref", "serial")

    ref: "Optional[Term]"
    serial: int

    def __init__(self) -> None:
        self.ref = None

    def __repr__(self) -> str:
        return f"Var(_G{serial(self)})" if self.ref is None else f"Var({self.ref!r})"


class Lazy:
    """A term that is made when it is looked at, once; its functor is known before.

    Attributes:
        functor: the `Functor` that the term will have; of the empty name and arity 0 where the term will be
            an atom whose name is not known yet.
        make: called with ``source`` to make the term.
    """

    __slots__ = ("functor", "make", "source", "made")

    def __init__(self, functor: Functor, make: "Callable[[Any], Term]", source: Any):
        self.functor = functor
        self.make = make
        self.source = source
        self.made: Optional[Term] = None

    def term(self) -> "Term":
        """Return the compound term (its arguments may be lazy in turn)."""
        made = self.made
        if made is None:
            source, made = self.source, self.made  # in this order: another thread may be making it
            if made is None:
                made = self.made = self.make(source)
                self.source = None
        return made

    def __repr__(self) -> str:
        return f"Lazy({self.functor})"


CompoundTerm = Tuple[Any, ...]
"""A functor and its arguments. How many there are says the functor, so a type checker cannot tell what they are."""

if not TYPE_CHECKING or sys.version_info >= (3, 9):
    Term = Union[int, float, Atom, String, Var, Lazy, CompoundTerm]
else:  # the last mypy for Python 3.8 cannot tell the kind of a term by its class
    Term = Any
"""What programs, events and messages are made of.

>>> def is_hot(term: Term) -> bool:
...     return isinstance(term, tuple) and term[0].name == "fire"
>>> is_hot(functor("fire", 1)(atom("kitchen"))), is_hot(atom("kitchen"))
(True, False)

What callbacks and queries get is looked at through `deref`, which makes what is made only when somebody asks.
"""

Values = Tuple[Term, ...]
"""Arguments of a goal, or what the variables of a clause or a rule stand for."""

Frame = Tuple[Any, ...]
"""A tuple ``(runs, argument..., next)``: a step with what it needs, and the frame that follows it.

The first item is a `Runs`, the last one a frame (None in the frame that ends a run); of what kinds those between are
is up to the first. A choice point has one more item, the length of the trail. Where a step fails there is no next
frame: what may fail returns ``Optional[Frame]``. A class for each step would say more and cost time in all of them.
"""

Step = Callable[[Frame], Optional[Frame]]
"""What does a step, as a function: what a `Runs` has as its ``run``."""


class Runs(Protocol):
    """What frames begin with: a `Code`, a predicate, or whatever else does steps."""

    @property
    def run(self) -> Step:
        """What does the step."""


EventAction = Callable[[Term, Values, int, int, Frame], Frame]
"""Takes an event, the values of the variables of the pattern that it fits, its start, its end and the next frame;
gives a frame that goes on with that one, or that one itself where there is nothing left to do."""


class _AtomRef(ref):  # type: ignore[type-arg]
    """The table's reference to an atom: it goes when the last term with the atom goes."""

    __slots__ = ("name",)

    name: str


class _FunctorRef(ref):  # type: ignore[type-arg]
    """The same of a functor."""

    __slots__ = ("key",)

    key: Tuple[str, int]


_atoms: Dict[str, _AtomRef] = {}
_functors: Dict[Tuple[str, int], "_FunctorRef"] = {}
_serials = count(1)

NUMBERED: List[bool] = []
"""Holds something once any variable has a number: many processes never give one."""


def functor(name: str, arity: int) -> Functor:
    """Return the one `Functor` of this name and arity; as atoms, those that nothing holds are forgotten.

    >>> Engine().show(functor("point", 2)(1, 2))
    'point(1,2)'
    """
    try:
        found: Optional[Functor] = _functors[name, arity]()
    except KeyError:
        return _new_functor((name, arity))
    return found or _new_functor((name, arity))


def _new_functor(key: Tuple[str, int]) -> Functor:
    """Put a functor into the table; see `_new_atom`."""
    made = Functor()
    made.name, made.arity = key
    reference = _FunctorRef(made, _forget_functor)
    reference.key = key
    while True:
        known = _functors.setdefault(key, reference)
        if known is reference:
            return made
        found: Optional[Functor] = known()
        if found is not None:
            return found
        remove_dead(_functors, key)


def _forget_functor(reference: "_FunctorRef") -> None:
    remove_dead(_functors, reference.key)


def atom(name: str) -> Atom:
    """Return the one `Atom` of this name.

    Atoms that no term holds any more are forgotten: texts of messages do not pile up.

    >>> atom("kitchen") is atom("kitchen")
    True
    """
    try:
        found: Optional[Atom] = _atoms[name]()
    except KeyError:
        return _new_atom(name)
    return found or _new_atom(name)


def _new_atom(name: str) -> Atom:
    """Put an atom into the table, or return the one that got there first; no lock, each step is one."""
    made = Atom()
    made.name = name
    reference = _AtomRef(made, _forget)
    reference.name = name
    while True:
        known = _atoms.setdefault(name, reference)
        if known is reference:
            return made
        found: Optional[Atom] = known()
        if found is not None:
            return found
        remove_dead(_atoms, name)


def _forget(reference: _AtomRef) -> None:
    remove_dead(_atoms, reference.name)


def serial(var: Var) -> int:
    """Return the number of a variable: it names it in output and orders it; given out at first need."""
    try:
        return var.serial
    except AttributeError:
        if not NUMBERED:
            NUMBERED.append(True)
        var.serial = next(_serials)
        return var.serial


NIL = atom("[]")
TRUE = atom("true")
FALSE = atom("false")
EMPTY_BLOCK = atom("{}")
CONS = functor("[|]", 2)
COMMA = functor(",", 2)
MINUS = functor("-", 2)
SLASH = functor("/", 2)
COLON = functor(":", 2)


def deref(term: Term) -> Term:
    """Follow bound variables and make a lazy term: the result is neither, or an unbound variable.

    >>> definitions = Definitions()
    >>> scan = definitions.add("my_robot/Scan", "float32[] ranges")
    >>> term = definitions.decoder(scan).lazy(bytes(4))
    >>> isinstance(term, tuple), isinstance(deref(term), tuple)
    (False, True)
    """
    while True:
        kind = term.__class__
        if kind is Var:
            ref: Any = term.ref  # type: ignore[union-attr]
            if ref is None:
                return term
            term = ref
        elif kind is Lazy:
            term = term.term()  # type: ignore[union-attr]
        else:
            return term
