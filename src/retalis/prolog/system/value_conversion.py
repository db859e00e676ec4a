"""Conversion between terms, Python values, and JSON.

Terms from a program may be deep or huge, so all conversions of terms are iterative, check for cancellation regularly,
and are bounded: `to_python` by the number of parts, `to_json` by the length of the text, which services send to
clients.
"""

import json
import math
import numbers
from typing import (
    Any,
    Callable,
    Dict,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
    Union,
    get_args,
    get_origin,
)

from ...foundation.errors import TermTooLarge, UsageError
from ...foundation.limit_checks import STEPS_PER_ROUND, check_limits
from ..builtins.argument_checks import array_of
from ..machine.errors import instantiation_error, type_error
from ..syntax.term_writer import writeq
from ..terms.array_terms import array_term
from ..terms.list_terms import list_items, make_list
from ..terms.term_traversal import MAX_STEPS, check_steps
from ..terms.types import (
    CONS,
    FALSE,
    NIL,
    TRUE,
    Atom,
    CompoundTerm,
    Functor,
    Lazy,
    String,
    Term,
    Var,
    atom,
    deref,
    functor,
)

_CHECK_MASK = len(STEPS_PER_ROUND) - 1


class Compound(NamedTuple):
    """Compound term as a Python value: a name and arguments, which are Python values.

    >>> @foreign
    ... def corner(width: float, height: float) -> Compound:
    ...     return Compound("point", [width / 2, height / 2])
    >>> engine = Engine()
    >>> corners = engine.add_foreign(corner)
    >>> engine.show(engine.query("corner(4, 2, P)")[0]["P"])
    'point(2.0,1.0)'
    """

    name: str
    args: Sequence[Any]


def to_python(term: Term) -> Any:
    """Return a term as a Python value.

    ========================  =============================
    term                      value
    ========================  =============================
    integer, float            int, float
    ``true``, ``false``       True, False
    atom, string              str
    list                      list
    compound term             `Compound`
    ========================  =============================

    >>> (solution,) = Engine().query("X = [a, 1, true, point(2, 3.5)]")
    >>> to_python(solution["X"])
    ['a', 1, True, Compound(name='point', args=[2, 3.5])]

    Raises:
        PrologError: an instantiation error if the term contains an unbound variable.
    """
    # Postorder traversal without recursion: a pending entry below the parts of a term joins their values afterwards.
    values: List[object] = []
    stack: List[Union[Term, _PendingParts]] = [term]
    steps = 0
    while stack:
        steps += 1
        if not steps & _CHECK_MASK:
            check_steps(steps)
        top = stack.pop()
        # The values of its parts are the last ones, and are replaced by the value of the whole.
        if isinstance(top, _PendingParts):
            values[len(values) - top.count :] = [top.join(values[len(values) - top.count :])]
            continue
        item = deref(top)
        if item.__class__ is tuple:
            # A term that only begins like a list, such as [a|b], is a compound.
            items = list_items(item) if item[0] is CONS else None
            parts = list(item[1:]) if items is None else items
            stack.append(_PendingParts(len(parts), None if items is not None else item[0].name))
            stack.extend(reversed(parts))
        else:
            values.append(_python_constant(item))
    return values[0]


class _PendingParts:
    """Stack entry of `to_python` below the parts of a compound term, or of a list (without a name)."""

    __slots__ = ("count", "name")

    def __init__(self, count: int, name: Optional[str]):
        self.count = count
        self.name = name

    def join(self, values: List[object]) -> object:
        """Return the value of the term from the values of its parts."""
        return values if self.name is None else Compound(self.name, values)


def _python_constant(item: Term) -> object:
    if item.__class__ is Var:
        raise instantiation_error()
    if item is TRUE or item is FALSE:
        return item is TRUE
    if item.__class__ is Atom:
        return [] if item is NIL else item.name
    if item.__class__ is String:
        return item.text
    return int(item) if isinstance(item, int) else item


def to_term(value: object) -> Term:
    """Return a Python value as a term.

    The inverse of `to_python`: str becomes an atom (a `retalis.String` remains a string), a tuple or any other
    iterable except str becomes a list, and a dict becomes a list of ``Key-Value``. A one-dimensional numpy array of
    numbers becomes an array term, which is a list as well. Terms are returned unchanged.

    >>> Engine().show(to_term({"kitchen": [21.5, True]}))
    '[kitchen-[21.5,true]]'

    Raises:
        UsageError: if the value has another type.
        TermTooLarge: if the value has too many parts, as a list that contains itself.
    """
    term = _to_constant(value)
    if term is not None:
        return term
    # As in `to_python`: a pending entry below the parts of a collection joins their terms afterwards.
    terms: List[Term] = []
    stack: List[Any] = [value]
    steps = 0
    while stack:
        steps += 1
        if not steps & _CHECK_MASK:
            check_limits()
        if steps + len(stack) > MAX_STEPS:
            raise TermTooLarge
        top = stack.pop()
        if isinstance(top, _PendingTerm):
            terms[len(terms) - top.count :] = [top.join(terms[len(terms) - top.count :])]
            continue
        term = _to_constant(top)
        if term is not None:
            terms.append(term)
        elif isinstance(top, Compound):
            stack.append(_PendingTerm(len(top.args), functor(top.name, len(top.args))))
            stack.extend(reversed(top.args))
        else:
            items = _read_items(top)
            stack.append(_PendingTerm(len(items), None))
            stack.extend(reversed(items))
    return terms[0]


class _PendingTerm:
    """Stack entry of `to_term` below the parts of a compound term, or of a list (without a functor)."""

    __slots__ = ("count", "functor")

    def __init__(self, count: int, term_functor: Optional[Functor]):
        self.count = count
        self.functor = term_functor

    def join(self, terms: List[Term]) -> Term:
        """Return the term with these parts."""
        return make_list(terms) if self.functor is None else (self.functor, *terms)


def _to_constant(value: Any) -> Optional[Term]:
    """Return a value without parts, or a term, as a term; None for a collection."""
    if value is None:
        raise UsageError("None is not a term")
    # bool is a subclass of int, so it is tested before the numbers.
    if isinstance(value, bool) or _is_numpy_bool(value.__class__):
        return TRUE if value else FALSE
    if isinstance(value, (Atom, String, Var, Lazy)):
        return value
    if isinstance(value, str):
        return atom(value)
    if isinstance(value, numbers.Integral):
        return int(value)
    if isinstance(value, numbers.Real):
        return float(value)
    if isinstance(value, Compound):
        return None if value.args else atom(value.name)
    # Compound terms are tuples that begin with a functor; any other tuple is a list.
    if isinstance(value, tuple) and value and isinstance(value[0], Functor):
        return value
    if _is_ndarray(value.__class__) and value.ndim == 1 and value.dtype.kind in "iuf":
        return array_term(value)
    return None


def _read_items(value: Any) -> List[Any]:
    """Return the items of an iterable; those of a dict are ``Key-Value``."""
    if isinstance(value, dict):
        return [Compound("-", pair) for pair in value.items()]
    try:
        iterator = iter(value)
    except TypeError:
        raise UsageError(f"a {type(value).__name__} is not a term: {value!r}") from None
    items = []
    for count, item in enumerate(iterator, 1):
        items.append(item)
        if not count & _CHECK_MASK:
            check_steps(count)
    return items


def _is_numpy_bool(value_class: type) -> bool:
    # Its name depends on the version of numpy.
    return value_class.__module__ == "numpy" and value_class.__name__ in ("bool_", "bool")


def _is_ndarray(value_class: object) -> bool:
    """Return whether a class is that of numpy's arrays; numpy is not imported for the answer."""
    return getattr(value_class, "__name__", "") == "ndarray" and value_class.__module__ == "numpy"


def argument_converter(hint: object) -> Callable[[Term], object]:
    """Return the conversion of a term to the argument of a parameter with an annotation."""
    if hint in (Any, Term, Var):
        return deref
    origin, types = get_origin(hint), [item for item in get_args(hint) if item is not type(None)]
    # `numpy.ndarray`, or `numpy.typing.NDArray` with a type of elements.
    if _is_ndarray(origin or hint):
        return array_of
    # No term is None.
    if origin is Union and len(types) == 1:
        return argument_converter(types[0])
    if origin is list and types:
        return _list_converter(argument_converter(types[0]))
    return _CONVERTERS_BY_TYPE.get(hint, to_python)


def _list_converter(convert_item: Callable[[Term], object]) -> Callable[[Term], object]:
    """Return the conversion of a list with items of one type."""

    def convert_list(term: Term) -> object:
        items = list_items(deref(term))
        if items is None:
            raise type_error("list", deref(term))
        return [convert_item(item) for item in items]

    return convert_list


def _typed_converter(
    accepts: Tuple[type, ...], name: str, convert: Callable[[Any], object]
) -> Callable[[Term], object]:
    """Return the conversion of a term to an argument of some types; other terms are a type error with ``name``."""

    def convert_argument(term: Term) -> object:
        value = to_python(term)
        # The atoms true and false are texts for a parameter of type str, and bool must not pass as an integer.
        if isinstance(value, bool) and bool not in accepts:
            value = "true" if value else "false"
        if not isinstance(value, accepts):
            raise type_error(name, deref(term))
        return convert(value)

    return convert_argument


_CONVERTERS_BY_TYPE: Dict[object, Callable[[Term], object]] = {
    int: _typed_converter((int,), "integer", int),
    float: _typed_converter((int, float), "number", float),
    str: _typed_converter((str,), "atom", str),
    bool: _typed_converter((bool,), "bool", bool),
    list: _typed_converter((list,), "list", list),
}


class _ReadyText(str):
    """Stack entry of `to_json`: text that is written unchanged."""

    __slots__ = ()


def to_json(term: Term, names: Dict[Var, str], max_length: int) -> str:
    """Return a term as JSON.

    ========================  ==========================================
    term                      JSON
    ========================  ==========================================
    integer, float            number; ``"nan"``, ``"inf"``, ``"-inf"``
    ``true``, ``false``       true, false
    atom, string              string
    list                      array
    compound term             ``{"functor": "f", "args": [...]}``
    variable                  ``{"variable": "_1"}``
    ========================  ==========================================

    Args:
        term: the term.
        names: names of variables; missing ones are added.
        max_length: maximum length in characters.

    Raises:
        UsageError: if the text would be longer.
    """
    parts: List[str] = []
    stack: List[Union[Term, _ReadyText]] = [term]
    length = steps = 0
    while stack:
        steps += 1
        if not steps & _CHECK_MASK:
            check_limits()
        top = stack.pop()
        if isinstance(top, _ReadyText):
            text: str = top
        else:
            item = deref(top)
            if item.__class__ is tuple:
                # Each entry of the stack becomes at least one character.
                if length + len(stack) > max_length:
                    raise _length_error(max_length)
                stack.extend(_json_parts(item, max_length))
                continue
            text = _json_constant(item, names, max_length)
        length += len(text)
        if length > max_length:
            raise _length_error(max_length)
        parts.append(text)
    return "".join(parts)


def _length_error(max_length: int) -> UsageError:
    """Return the error for a solution whose JSON is too long."""
    return UsageError(f"a solution has more than {max_length} characters")


def _json_parts(item: CompoundTerm, max_length: int) -> List[Union[Term, _ReadyText]]:
    """Return the parts and punctuation of a list or compound term, in reverse order."""
    items = list_items(item) if item[0] is CONS else None
    parts = list(item[1:]) if items is None else items
    if len(parts) > max_length:
        raise _length_error(max_length)
    entries: List[Union[Term, _ReadyText]] = [_ReadyText("]" if items is not None else "]}")]
    for index, part in enumerate(reversed(parts)):
        if index:
            entries.append(_ReadyText(", "))
        entries.append(part)
    prefix = "" if items is not None else f'{{"functor": {json.dumps(item[0].name)}, "args": '
    entries.append(_ReadyText(f"{prefix}["))
    return entries


def _json_constant(item: Term, names: Dict[Var, str], max_length: int) -> str:
    if isinstance(item, Var):
        return json.dumps({"variable": names.setdefault(item, f"_{len(names) + 1}")})
    if item is TRUE or item is FALSE:
        return "true" if item is TRUE else "false"
    if item is NIL:
        return "[]"
    if isinstance(item, (Atom, String)):
        text = item.name if isinstance(item, Atom) else item.text
        if len(text) > max_length:
            raise _length_error(max_length)
        return json.dumps(text, ensure_ascii=False)
    if isinstance(item, float) and not math.isfinite(item):
        return f'"{item}"'
    # Conversion of a long integer to decimal takes quadratic time, so its length is estimated from its bits.
    if isinstance(item, int) and item.bit_length() > 4 * max_length:
        raise _length_error(max_length)
    return writeq(item)
