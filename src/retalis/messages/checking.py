"""The careful way from a term to a message: slot by slot, with every form that is allowed."""

from struct import error as StructError
from struct import pack
from typing import Callable, Dict, List

from ..foundation import MessageError, counted
from ..prolog.terms import (
    FALSE,
    NIL,
    TRUE,
    Atom,
    Functor,
    Term,
    Var,
    atom,
    deref,
    functor,
    list_items,
    make_list,
    timestamps,
)
from ..prolog.terms import String as PrologString
from .definition import Definition, Field
from .parsing import integer_range
from .slots import PRIMITIVES, TIMES, VARIABLE
from .text import text_bytes

_BOOLS: Dict[Atom, bool] = {TRUE: True, atom("True"): True, FALSE: False, atom("False"): False}
_SPECIAL = {atom("nan"): float("nan"), atom("inf"): float("inf"), atom("infinite"): float("inf")}
_NEGATIVE = functor("-", 1)
_SHOWN = 60


class CheckingEncoder:
    """Encodes the terms of one type, saying what is wrong with those that do not fit."""

    def __init__(self, definition: Definition):
        self.definition = definition

    def encode(self, term: Term, topic: str = "") -> bytes:
        """Return the bytes of the message that ``term`` stands for.

        Raises:
            MessageError: naming the topic, the slot and what was expected.
        """
        chunks: List[bytes] = []
        try:
            _message(self.definition, term, "", chunks)
        except _Misfit as misfit:
            where = [f"topic {topic}"] if topic else []
            where.append(self.definition.name)
            if misfit.path:
                where.append(f"slot {misfit.path}")
            raise MessageError(f"{', '.join(where)}: {misfit.reason}") from None
        return b"".join(chunks)


class _Misfit(Exception):
    def __init__(self, path: str, reason: str):
        super().__init__(path, reason)
        self.path = path
        self.reason = reason


def _expected(path: str, what: str, term: Term) -> _Misfit:
    return _Misfit(path, f"expected {what}, got {describe(term)}")


def _message(definition: Definition, term: Term, path: str, chunks: List[bytes]) -> None:
    term = deref(term)
    slots = definition.fields
    if not slots:
        if not _is_empty(term, definition.functor_name):
            raise _expected(path, f"the atom {definition.functor_name}", term)
        return
    if term.__class__ is not tuple or term[0].name != definition.functor_name or term[0].arity != len(slots):
        raise _expected(path, f"{definition.functor_name}/{len(slots)}", term)
    for slot, value in zip(slots, term[1:]):
        _slot(slot, value, f"{path}.{slot.name}" if path else slot.name, chunks)


def _is_empty(term: Term, name: str) -> bool:
    if term.__class__ is tuple:
        return len(term) == 1 and term[0].name == name
    return term.__class__ is Atom and term.name == name


def _slot(slot: Field, term: Term, path: str, chunks: List[bytes]) -> None:
    if slot.length is None:
        _single(slot, term, path, chunks)
        return
    if slot.is_bytes:
        raw = _bytes(slot, term, path)
        if slot.length == VARIABLE:
            chunks.append(pack("<I", len(raw)))
        chunks.append(raw)
        return
    items = _items(slot, term, path)
    if slot.length == VARIABLE:
        chunks.append(pack("<I", len(items)))
    element = slot._replace(length=None)
    for index, item in enumerate(items):
        _single(element, item, f"{path}[{index}]", chunks)


def _items(slot: Field, term: Term, path: str) -> List[Term]:
    items = list_items(term)
    if items is None:
        raise _expected(path, f"a list ({slot.describe()})", deref(term))
    _check_length(slot, len(items), path)
    return items


def _check_length(slot: Field, number: int, path: str) -> None:
    if slot.length != VARIABLE and number != slot.length:
        raise _Misfit(
            path, f"expected {counted(slot.length or 0, 'element')} ({slot.describe()}), got {number}"
        )


def _bytes(slot: Field, term: Term, path: str) -> bytes:
    """Return the bytes of a byte array, given as text or as a list of numbers."""
    value = deref(term)
    if value.__class__ is tuple or value is NIL:
        chunks: List[bytes] = []
        for index, item in enumerate(_items(slot, value, path)):
            _single(slot._replace(length=None), item, f"{path}[{index}]", chunks)
        return b"".join(chunks)
    raw = _text(value, path, f"a string or a list ({slot.describe()})")
    _check_length(slot, len(raw), path)
    return raw


def _text(value: Term, path: str, what: str) -> bytes:
    try:
        raw = text_bytes(value)
    except MessageError as error:
        raise _Misfit(path, error.message) from None
    if raw is None:
        raise _expected(path, what, value)
    return raw


def _single(slot: Field, term: Term, path: str, chunks: List[bytes]) -> None:
    if slot.definition is not None:
        _message(slot.definition, term, path, chunks)
        return
    chunks.append(_READERS[slot.type](slot.type, deref(term), path))


def _string(kind: str, value: Term, path: str) -> bytes:
    raw = _text(value, path, "a string")
    return pack("<I", len(raw)) + raw


def _time(kind: str, value: Term, path: str) -> bytes:
    if (
        kind == "time" and value.__class__ is tuple and timestamps.is_instant(value)
    ):  # a datime, as `t2` gives it
        value = make_list(timestamps.to_parts(timestamps.from_term(value)))
    items = [deref(part) for part in list_items(value) or ()]
    parts = [part for part in items if isinstance(part, int)]
    if len(items) != 2 or len(parts) != 2:
        raise _expected(path, f"{kind} as [Sec,NSec]", value)
    code = TIMES[kind]
    for part, name in zip(parts, ("Sec", "NSec")):
        _check_range(code[0], part, path, f"{kind} as [Sec,NSec], {name}")
    return pack("<" + code, *parts)


def _bool(kind: str, value: Term, path: str) -> bytes:
    if value.__class__ is Atom and value in _BOOLS:
        return pack("<?", _BOOLS[value])
    if isinstance(value, int) and value in (0, 1):
        return pack("<?", value)
    raise _expected(path, "bool (true or false)", value)


def _integer(kind: str, value: Term, path: str) -> bytes:
    if not isinstance(value, int):
        raise _expected(path, kind, value)
    _check_range(PRIMITIVES[kind], value, path, kind)
    return pack("<" + PRIMITIVES[kind], value)


def _float(kind: str, value: Term, path: str) -> bytes:
    if value.__class__ is Atom:
        value = _SPECIAL.get(value, value)
    elif value.__class__ is tuple and value[0] is _NEGATIVE:
        inner = deref(value[1])
        value = -_SPECIAL[inner] if inner.__class__ is Atom and inner in _SPECIAL else value
    if not isinstance(value, (float, int)):
        raise _expected(path, kind, value)
    try:
        return pack("<" + PRIMITIVES[kind], value)
    except (OverflowError, StructError):
        raise _Misfit(path, f"{describe(value)} is too large for {kind}") from None


def _check_range(code: str, value: int, path: str, what: str) -> None:
    low, high = integer_range(code)
    if not low <= value <= high:
        raise _Misfit(path, f"expected {what} from {low} to {high}, got {value}")


_Packer = Callable[[str, Term, str], bytes]
_READERS: Dict[str, _Packer] = {
    **dict.fromkeys(PRIMITIVES, _integer),
    "bool": _bool,
    "float32": _float,
    "float64": _float,
    "string": _string,
    "time": _time,
    "duration": _time,
}


def describe(term: Term) -> str:
    """Return a term in a few words for an error: what it is and how it begins."""
    term = deref(term)
    if term.__class__ is Var:
        return "an unbound variable"
    items = list_items(term)
    if items is not None:
        return f"a list of {len(items)}" if items else "an empty list"
    if term.__class__ is tuple:
        head: Functor = term[0]
        return f"{head.name}/{head.arity}"
    if term.__class__ is Atom:
        return _short("the atom ", term.name)
    if term.__class__ is PrologString:
        return _short("the string ", f'"{term.text}"')
    return _short("", repr(term))


def _short(lead: str, text: str) -> str:
    return lead + (text if len(text) <= _SHOWN else text[:_SHOWN] + "...")
