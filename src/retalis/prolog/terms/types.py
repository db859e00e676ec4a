"""Term classes, the atom and functor tables, and the shared type aliases.

=============== =============================================================================
type            meaning
=============== =============================================================================
`Term`          any term: what programs, events and messages consist of
`CompoundTerm`  a term with arguments: a tuple whose first item is its `Functor`
`Values`        the arguments of a goal, or the values of the variables of a clause or rule
`Trail`         the bindings to undo on backtracking
`Frame`         a continuation: a step, its arguments, and the frame that follows
`Step`          the function that executes a frame
`EventAction`   the action for an event that matches a pattern
=============== =============================================================================

Representation: numbers are Python numbers, a compound term is a tuple, and every other term has a class of its own.
Atoms and functors are interned, so identity tests replace comparisons of names. The intern tables hold weak
references: the texts of messages become atoms, and they must not accumulate for the life of the process.

Walks over terms never recurse in Python, because a term can be nested deeper than Python's stack. They test
``term.__class__`` instead of calling ``isinstance``: no term class has subclasses, and the test is the innermost
operation of the system.

`Frame`, `Step` and `EventAction` are defined here because every higher package refers to them: the
machine executes frames, and event listeners and network nodes return them. They depend on nothing above this module.
"""

import sys
from _weakref import _remove_dead_weakref as remove_dead_reference  # type: ignore[attr-defined]
from itertools import count
from typing import TYPE_CHECKING, Any, Callable, Dict, List, Optional, Protocol, Tuple, Union
from weakref import ref


class TrailEntry(Protocol):
    """An entry of a trail: a variable, or an object that is undone by setting its ``ref`` to None."""

    ref: Any


Trail = List[TrailEntry]
"""Bindings since the oldest choice point, oldest first."""


class Atom:
    """A constant. `atom` returns the same object for the same name.

    ``functor`` is the `Functor` of the name with arity 0, created on first access.

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
        own_functor = self.functor = functor(self.name, 0)
        return own_functor

    def __repr__(self) -> str:
        return f"atom({self.name!r})"

    def __reduce__(self) -> Tuple[object, ...]:
        return atom, (self.name,)


class Functor:
    """The name and arity of a compound term. `functor` returns one object for each pair.

    Call a functor to build a term, a tuple that begins with the functor:

    >>> point = functor("point", 2)
    >>> term = point(1, 2)
    >>> term[0] is point, term[0].name, term[1:]
    (True, 'point', (1, 2))

    ``atom`` is the `Atom` of the functor's name, created on first access.
    """

    __slots__ = ("name", "arity", "atom", "__weakref__")

    name: str
    arity: int
    atom: Atom

    def __getattr__(self, attribute: str) -> Atom:
        if attribute != "atom":
            raise AttributeError(attribute)
        own_atom = atom(self.name)
        # An atom refers to its functor of arity 0. If that functor referred back, the cycle would keep both alive
        # until the garbage collector runs, and the intern tables would grow with every text of a message.
        if self.arity:
            self.atom = own_atom
        return own_atom

    def __call__(self, *args: "Term") -> "CompoundTerm":
        """Return the compound term with these arguments; their number must equal the arity."""
        return (self, *args)

    def __repr__(self) -> str:
        return f"functor({self.name!r}, {self.arity})"

    def __str__(self) -> str:
        return f"{self.name}/{self.arity}"

    def __reduce__(self) -> Tuple[object, ...]:
        return functor, (self.name, self.arity)


class String:
    """A Prolog string: text that is not an atom. Strings with equal text are equal terms.

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
    """A logic variable: ``ref`` is None while it is unbound, and the term that it is bound to otherwise.

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


class ArrayDecoder:
    """The ``decoder`` of an array term, see `array_terms`: a function, and the type of the numbers that it reads.

    Attributes:
        dtype: numpy's name of the type, such as ``"<f4"``.
        decode: returns the list, or the atom, that the bytes stand for.
    """

    __slots__ = ("dtype", "decode")

    def __init__(self, dtype: str, decode: "Callable[[bytes], Term]"):
        self.dtype = dtype
        self.decode = decode

    def __call__(self, source: bytes) -> "Term":
        """Return the list, or the atom, of the bytes."""
        return self.decode(source)

    def __repr__(self) -> str:
        return f"ArrayDecoder({self.dtype!r})"


class Lazy:
    """A term that is built on first access, once; its functor is known in advance.

    Attributes:
        functor: the `Functor` of the term. It has the empty name and arity 0 if the term will be an atom whose name
            is not known yet.
        decoder: function that builds the term from ``source``.
        source: data of the term; None after the term has been built, except in an array term.
        decoded_term: the term after it has been built, or None.
    """

    __slots__ = ("functor", "decoder", "source", "decoded_term")

    def __init__(self, functor: Functor, decoder: "Callable[[Any], Term]", source: Any):
        self.functor = functor
        self.decoder = decoder
        self.source = source
        self.decoded_term: Optional[Term] = None

    def term(self) -> "Term":
        """Return the term, and build it on the first call; its arguments may be lazy as well."""
        decoded = self.decoded_term
        if decoded is None:
            # Read `source` before `decoded_term`: another thread may build the term between the two reads, and it
            # stores `decoded_term` before it clears `source`. In the other order this thread could decode None.
            source, decoded = self.source, self.decoded_term
            if decoded is None:
                decoder = self.decoder
                decoded = self.decoded_term = decoder(source)
                if decoder.__class__ is not ArrayDecoder:
                    self.source = None
        return decoded

    def __repr__(self) -> str:
        return f"Lazy({self.functor})"


CompoundTerm = Tuple[Any, ...]
"""A functor and its arguments. The functor determines their number, so a type checker cannot verify it."""

if not TYPE_CHECKING or sys.version_info >= (3, 9):
    Term = Union[int, float, Atom, String, Var, Lazy, CompoundTerm]
else:  # the last mypy for Python 3.8 cannot narrow a term by its class
    Term = Any
"""Any term: what programs, events and messages consist of.

>>> def is_hot(term: Term) -> bool:
...     return isinstance(term, tuple) and term[0].name == "fire"
>>> is_hot(functor("fire", 1)(atom("kitchen"))), is_hot(atom("kitchen"))
(True, False)

Callbacks and solutions may contain lazy terms and bound variables; `deref` resolves them.
"""

Values = Tuple[Term, ...]
"""The arguments of a goal, or the values of the variables of a clause or rule."""

Frame = Tuple[Any, ...]
"""A continuation, ``(code, argument..., next)``: a step with its arguments, and the frame that follows it.

The first item is the code, which defines the types of the arguments: a `Code`, a predicate, or any other object whose
attribute ``run`` is a `Step`. The last item is a frame, or None in the frame that ends a run. A choice point is a
frame with one more item, the length of the trail. A step that fails has no next frame, so functions that can fail
return ``Optional[Frame]``. Classes for frames would be more explicit, and would make every step slower.
"""

Step = Callable[[Frame], Optional[Frame]]
"""The function that executes a frame, the ``run`` of the frame's code."""


EventAction = Callable[[Term, Values, int, int, Frame], Frame]
"""Takes an event, the values of the pattern's variables, the event's start and end (ns), and the next frame.
Returns a frame that continues with the next frame, or the next frame itself if there is nothing to do."""


class _AtomRef(ref):  # type: ignore[type-arg]
    """The weak reference to an atom in the intern table; removed with the last term that contains the atom."""

    __slots__ = ("name",)

    name: str


class _FunctorRef(ref):  # type: ignore[type-arg]
    """The weak reference to a functor in the intern table."""

    __slots__ = ("key",)

    key: Tuple[str, int]


_atoms: Dict[str, _AtomRef] = {}
_functors: Dict[Tuple[str, int], "_FunctorRef"] = {}
_serials = count(1)

NUMBERED: List[bool] = []
"""Not empty if any variable has a number. Many processes never number one, so `unify` tests this first."""


def functor(name: str, arity: int) -> Functor:
    """Return the unique `Functor` of a name and arity. Functors that nothing refers to are forgotten.

    >>> Engine().show(functor("point", 2)(1, 2))
    'point(1,2)'
    """
    try:
        interned: Optional[Functor] = _functors[name, arity]()
    except KeyError:
        return _new_functor((name, arity))
    return interned or _new_functor((name, arity))


def _new_functor(key: Tuple[str, int]) -> Functor:
    """Add a functor to the table, or return the one that another thread has added; see `_new_atom`."""
    new = Functor()
    new.name, new.arity = key
    reference = _FunctorRef(new, _forget_functor)
    reference.key = key
    while True:
        entry = _functors.setdefault(key, reference)
        if entry is reference:
            return new
        existing: Optional[Functor] = entry()
        if existing is not None:
            return existing
        remove_dead_reference(_functors, key)


def _forget_functor(reference: "_FunctorRef") -> None:
    remove_dead_reference(_functors, reference.key)


def atom(name: str) -> Atom:
    """Return the unique `Atom` of a name.

    Atoms that no term contains are forgotten, so the texts of messages do not accumulate.

    >>> atom("kitchen") is atom("kitchen")
    True
    """
    try:
        interned: Optional[Atom] = _atoms[name]()
    except KeyError:
        return _new_atom(name)
    return interned or _new_atom(name)


def _new_atom(name: str) -> Atom:
    """Add an atom to the table, or return the one that another thread has added."""
    new = Atom()
    new.name = name
    reference = _AtomRef(new, _forget)
    reference.name = name
    # No lock: `setdefault` and `remove_dead_reference` are atomic, and the loop ends as soon as the table holds a
    # live reference. The atom of a reference may die between the look-up and the call, therefore the retry.
    while True:
        entry = _atoms.setdefault(name, reference)
        if entry is reference:
            return new
        existing: Optional[Atom] = entry()
        if existing is not None:
            return existing
        remove_dead_reference(_atoms, name)


def _forget(reference: _AtomRef) -> None:
    remove_dead_reference(_atoms, reference.name)


def serial(var: Var) -> int:
    """Return the number of a variable, which names it in output and orders it; assign one on the first call."""
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


def functor_of(term: Any) -> Optional[Functor]:
    """Return the functor of an atom or compound term; None for other terms."""
    term = deref(term)
    return term[0] if term.__class__ is tuple else term.functor if term.__class__ is Atom else None


def functor_name(term: Term) -> str:
    """Return the name of an atom or of the functor of a dereferenced compound term; an empty text for other terms.

    >>> functor_name(atom("a")), functor_name((MINUS, 1, 2)), functor_name(1)
    ('a', '-', '')
    """
    if term.__class__ is Atom:
        return term.name
    return term[0].name if term.__class__ is tuple else ""


def deref(term: Term) -> Term:
    """Follow bound variables and build lazy terms. The result is neither lazy nor a bound variable.

    >>> definitions = Definitions()
    >>> scan = definitions.add("my_robot/Scan", "float32[] ranges")
    >>> term = definitions.decoder(scan).lazy(bytes(4))
    >>> isinstance(term, tuple), isinstance(deref(term), tuple)
    (False, True)
    """
    while True:
        term_class = term.__class__
        if term_class is Var:
            ref: Any = term.ref  # type: ignore[union-attr]
            if ref is None:
                return term
            term = ref
        elif term_class is Lazy:
            term = term.term()  # type: ignore[union-attr]
        else:
            return term
