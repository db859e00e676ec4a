"""Bytes of plain data and terms, and back: nothing that is read is ever called but what makes terms.

What is written is Python's pickle, protocol 4: all Pythons read it, and it is made at the speed of C. It is read by a
reader of our own that knows the names of `MAKERS` and no others. None is ever looked up in a module, so a file can
name no code. What it makes are numbers, texts, bytes, lists, tuples, dictionaries and terms.
"""

import io
import pickle
from typing import Any, Callable, Dict, List, Optional, Tuple

from ...events.language import PATTERNS, Property, RuleDefinition, StepForm, WindowForm
from ...events.matches import Found
from ...foundation import Place, UsageError
from ...prolog.terms import (
    Atom,
    Functor,
    Lazy,
    Stamp,
    String,
    Term,
    Var,
    WholeSeconds,
    atom,
    deref,
    functor,
)

PROTOCOL = 4
"""The newest that Python 3.8 reads as well as all later ones."""

_DEEP = 50
"""How deep tuples may lie in each other where they have to be written flat."""

_TUPLES: Dict[str, Any] = {
    kind.__name__: kind for kind in (*PATTERNS, Found, Place, Property, RuleDefinition, StepForm, WindowForm)
}
"""Tuples with names for their items that are written as such."""


class Ref:
    """Stands for an object of a `Graph`, by its number."""

    __slots__ = ("number",)

    def __init__(self, number: int):
        self.number = number


class _Flat:
    """A tuple that is too deep to be written as it is, as steps that make it from the inside out."""

    __slots__ = ("steps",)

    def __init__(self, steps: List[Tuple[Any, ...]]):
        self.steps = steps


def make_atom(name: str) -> Atom:
    """Return an atom."""
    return atom(name)


def make_functor(name: str, arity: int) -> Functor:
    """Return a functor."""
    return functor(name, arity)


def make_string(text: str) -> String:
    """Return a string."""
    return String(text)


def make_variable() -> Var:
    """Return a variable."""
    return Var()


def make_same(term: Term) -> Term:
    """Return what a bound variable or a lazy term stands for."""
    return term


def make_instant(nanoseconds: int) -> WholeSeconds:
    """Return an instant that shows with whole seconds."""
    return WholeSeconds(nanoseconds)


def make_stamp(nanoseconds: int, term: Term) -> Stamp:
    """Return an instant that shows as a term."""
    return Stamp.of(nanoseconds, term)


def make_ref(number: int) -> Ref:
    """Return what stands for an object."""
    return Ref(number)


def make_named(kind: str, items: Tuple[Any, ...]) -> Any:
    """Return a tuple with names for its items."""
    return _TUPLES[kind](*items)


def make_float_kind() -> type:
    """Return what marks a float in keys."""
    return float


def make_deep(steps: List[Tuple[Any, ...]]) -> Any:
    """Return a deep tuple from its steps; see `_flat`."""
    made: List[Any] = []
    for kind, *rest in steps:
        if kind == 0:
            made.append(rest[0])
        else:
            items = [made[at] for at in rest[0]]
            made.append(tuple(items) if kind == 1 else _TUPLES[kind](*items))
    return made[-1]


MAKERS: Dict[str, Callable[..., Any]] = {
    one.__name__: one
    for one in (
        make_atom,
        make_functor,
        make_string,
        make_variable,
        make_same,
        make_instant,
        make_stamp,
        make_ref,
        make_named,
        make_float_kind,
        make_deep,
    )
}
"""All that a text of bytes can have called when it is read, by the names that it uses."""


class _StateWriter(pickle.Pickler):
    """Writes data and terms; anything else is an error of ours."""

    def reducer_override(self, obj: Any) -> Any:
        kind = obj.__class__
        if kind is Atom:
            return make_atom, (obj.name,)
        if kind is Functor:
            return make_functor, (obj.name, obj.arity)
        found = _REDUCED.get(kind)
        if found is not None:
            return found(obj)
        if kind in _PLAIN:
            return NotImplemented
        if kind.__name__ in _TUPLES and _TUPLES[kind.__name__] is kind:
            return make_named, (kind.__name__, tuple(obj))
        if obj is float:
            return make_float_kind, ()
        if obj in _WRITTEN:
            return NotImplemented
        raise TypeError(f"{kind.__name__} cannot be kept")


_REDUCED: Dict[type, Callable[[Any], Any]] = {
    String: lambda one: (make_string, (one.text,)),
    Var: lambda one: (make_variable, ()) if one.ref is None else (make_same, (deref(one),)),
    Lazy: lambda one: (make_same, (deref(one),)),
    WholeSeconds: lambda one: (make_instant, (int(one),)),
    Stamp: lambda one: (make_stamp, (int(one), one.term)),
    Ref: lambda one: (make_ref, (one.number,)),
    _Flat: lambda one: (make_deep, (one.steps,)),
}
_PLAIN = frozenset((None.__class__, bool, int, float, str, bytes, tuple, list, dict, set, frozenset))
"""What a pickler that is written in C never asks about; one in Python, as PyPy has it, does."""

_WRITTEN = frozenset(MAKERS.values())


def to_bytes(data: Any) -> bytes:
    """Return data as bytes."""
    try:
        return _written(data)
    except RecursionError:  # a long list of Prolog's lies as deep as it is long
        return _written(_shallow(data))


def _written(data: Any) -> bytes:
    out = io.BytesIO()
    _StateWriter(out, PROTOCOL).dump(data)
    return out.getvalue()


class _StateReader(pickle.Unpickler):
    """Reads what a `_StateWriter` has written, and calls nothing but makers of this one reading."""

    def __init__(self, data: bytes):
        super().__init__(io.BytesIO(data))
        self.atoms: Dict[str, Atom] = {}
        self.functors: Dict[Tuple[str, int], Functor] = {}

    def find_class(self, module: str, name: str) -> Any:
        if name == "make_atom":
            return self._atom
        if name == "make_functor":
            return self._functor
        maker = MAKERS.get(name)
        if maker is None:
            raise UsageError(f"it names {module}.{name}, which no state has")
        return lambda *items: maker(
            *items
        )  # another one each time: what a file may do to it is of no account

    def _atom(self, name: str) -> Atom:
        made = self.atoms[name] = atom(name)
        return made

    def _functor(self, name: str, arity: int) -> Functor:
        made = self.functors[name, arity] = functor(name, arity)
        return made

    def check(self) -> None:
        """Check that nothing that all programs share was changed: a pickle can set attributes.

        Raises:
            UsageError: where it was; it is put right.
        """
        changed = False
        for key, kind in self.functors.items():
            if (kind.name, kind.arity) != key:
                (kind.name, kind.arity), changed = key, True
        for name, one in self.atoms.items():
            if one.name != name:
                one.name, changed = name, True
            if one.functor is not functor(name, 0):
                one.functor, changed = functor(name, 0), True
        if changed:
            raise UsageError("it changes what it does not own")


def from_bytes(data: bytes) -> Any:
    """Return the data of bytes.

    Raises:
        UsageError: where they are damaged, or were never made by `to_bytes`.
    """
    reader = _StateReader(data)
    try:
        return reader.load()
    except UsageError:
        raise
    except Exception as error:  # whatever pickle stumbles over
        raise UsageError(f"it does not read ({type(error).__name__}: {error})") from error
    finally:
        reader.check()


# ---- what is deep ------------------------------------------------------------------------------------


def _shallow(data: Any) -> Any:
    """Return data in which tuples that lie too deep in each other are written flat."""
    kind = data.__class__
    if kind is list:
        return [_shallow(item) for item in data]
    if kind is dict:
        return {_shallow(key): _shallow(value) for key, value in data.items()}
    if kind in (Var, Lazy):
        data = deref(data)
    if not isinstance(data, tuple):
        return data
    if not _is_deep(data):
        return data
    if data.__class__ is tuple and not (data and data[0].__class__ is Functor):
        return tuple([_shallow(item) for item in data])
    return _Flat(_flat(data))


def _is_deep(data: Any) -> bool:
    """Tell whether tuples lie deeper in each other than can be written."""
    level, depth = [data], 0
    seen: Dict[int, None] = {}
    while level:
        depth += 1
        if depth > _DEEP:
            return True
        below = []
        for one in level:
            if isinstance(one, (list, dict)):
                return True
            for item in one:
                item = deref(item) if item.__class__ in (Var, Lazy) else item
                if isinstance(item, (tuple, list, dict)) and id(item) not in seen:
                    seen[id(item)] = None
                    below.append(item)
        level = below
    return False


def _flat(data: Any) -> List[Tuple[Any, ...]]:
    """Return the steps that make a tuple: ``(0, item)``, ``(1, places)``, ``(name of a kind, places)``.

    What stands in it more than once is made once.
    """
    steps: List[Tuple[Any, ...]] = []
    places: Dict[int, int] = {}
    kept: List[Any] = []  # so that no id is given to another meanwhile
    stack: List[Tuple[Any, Optional[List[Any]]]] = [(data, None)]
    while stack:
        one, items = stack.pop()
        one = deref(one) if one.__class__ in (Var, Lazy) else one
        if id(one) in places:
            continue
        if isinstance(one, tuple):
            if items is None:
                items = [deref(item) if item.__class__ in (Var, Lazy) else item for item in one]
                stack.append((one, items))
                stack += [(item, None) for item in items]
                continue
            kind = 1 if one.__class__ is tuple else one.__class__.__name__
            steps.append((kind, [places[id(item)] for item in items]))
            kept.append(items)
        else:
            steps.append((0, _shallow(one) if isinstance(one, (list, dict)) else one))
        kept.append(one)
        places[id(one)] = len(steps) - 1
    return steps
