"""Array terms: lists of numbers, and byte arrays, that are backed by bytes.

An array term is a `Lazy` term whose ``make`` is an `ArrayDecoder`. It is the list of its numbers, or the atom of its
bytes (see `byte_texts`), for all code that reads it as a term: the first access builds the list. Code that works
on arrays reads the bytes instead, as a numpy array (`view`), and never builds the list. The bytes stay with the
term after the list has been built, so that this holds for each later access.

numpy is imported by the first function that needs an array, because most programs do not use arrays.
"""

from struct import Struct, calcsize, unpack
from typing import TYPE_CHECKING, Any, Callable, Dict, Optional

from .byte_texts import blob_atom
from .list_terms import make_list
from .types import CONS, NIL, ArrayDecoder, Functor, Lazy, Term, Var, functor

if TYPE_CHECKING:
    import numpy as np

    Array = np.ndarray[Any, Any]

MAX_EAGER_ELEMENTS = 4
"""Arrays up to this length are lists from the start, because a lazy term would cost as much."""

ELEMENTS_PER_INFERENCE = 64
"""Elements that numpy processes in about the time of an inference."""

LAZY_STRING_FUNCTOR: Functor = functor("", 0)
"""Functor of a lazy string: an atom whose name is not known yet. No pattern has this functor."""

BLOB = ArrayDecoder("|u1", blob_atom)
"""The decoder of a long byte array of a message (``uint8[]``), which is an atom as a term."""

CODES = {
    "|i1": "b",
    "|u1": "B",
    "<i2": "h",
    "<u2": "H",
    "<i4": "i",
    "<u4": "I",
    "<i8": "q",
    "<u8": "Q",
    "<f2": "e",
    "<f4": "f",
    "<f8": "d",
}
"""`struct` codes by numpy's data types, which name the byte order."""


def _list_decoder(code: str) -> Callable[[bytes], Term]:
    """Return the function that decodes numbers of a `struct` code into a list."""
    size = calcsize("<" + code)

    def decode(source: bytes) -> Term:
        term: Term = NIL
        # A list is built from its end, because each cell contains the rest.
        for value in reversed(unpack(f"<{len(source) // size}{code}", source)):
            term = (CONS, value, term)
        return term

    return decode


LIST_DECODERS: Dict[str, ArrayDecoder] = {
    dtype: ArrayDecoder(dtype, _list_decoder(code)) for dtype, code in CODES.items()
}
"""Decoders of lists of numbers by data type. Two array terms of one data type have the same decoder."""

_LAYOUTS = {dtype: Struct("<" + code) for dtype, code in CODES.items()}

_DECODERS_OF_CODES = {code: LIST_DECODERS[dtype] for dtype, code in CODES.items()}


def decoder_of_code(code: str) -> ArrayDecoder:
    """Return the decoder of lists of numbers of a `struct` code."""
    return _DECODERS_OF_CODES[code]


def lazy_array(term: Term) -> Optional[Lazy]:
    """Return the array term that a term is, or is bound to; None for other terms. The list is not built."""
    # Not `deref`, which would build the list.
    while term.__class__ is Var:
        ref: Any = term.ref
        if ref is None:
            return None
        term = ref
    return term if term.__class__ is Lazy and term.decoder.__class__ is ArrayDecoder else None


def list_array(term: Term) -> Optional[Lazy]:
    """Return the array term that a term is, or is bound to, if it stands for a list; None for other terms."""
    lazy = lazy_array(term)
    return lazy if lazy is not None and lazy.functor is CONS else None


def view(lazy: Lazy) -> "Array":
    """Return the numbers of an array term as a read-only array of its bytes."""
    import numpy as np  # noqa: PLC0415 - see the module docstring

    return np.frombuffer(lazy.source, lazy.decoder.dtype)  # type: ignore[attr-defined]


def element_count(lazy: Lazy) -> int:
    """Return the number of elements of an array term."""
    return len(lazy.source) // _LAYOUTS[lazy.decoder.dtype].size  # type: ignore[attr-defined]


def element(lazy: Lazy, position: int) -> Optional[Term]:
    """Return the element of an array term at a position of at least 0; None after the last one."""
    layout = _LAYOUTS[lazy.decoder.dtype]  # type: ignore[attr-defined]
    offset = position * layout.size
    return layout.unpack_from(lazy.source, offset)[0] if offset < len(lazy.source) else None


def sum_of_integers(array: "Array") -> int:
    """Return the exact sum of an array of integers, which may have more than 64 bits."""
    # Integers of 32 bits cannot exceed 64 bits: that would take more elements than a message can have.
    return int(array.sum(dtype="i8")) if array.dtype.itemsize < 8 else sum(array.tolist())  # noqa: PLR2004


def array_term(array: "Array") -> Term:
    """Return the term of a one-dimensional array of integers or floats; the numbers are copied.

    The term is the list of ``array.tolist()`` for all code that reads it.

    Raises:
        ValueError: if the array has several dimensions, or elements of another type.
    """
    if array.ndim != 1 or array.dtype.kind not in "iuf":
        raise ValueError(f"an array of {array.ndim} dimensions of {array.dtype} is not a list of numbers")
    if len(array) <= MAX_EAGER_ELEMENTS:
        return make_list(array.tolist())
    # A list contains Python floats, which have 64 bits.
    dtype = array.dtype.newbyteorder("<") if array.dtype.itemsize <= 8 else "<f8"  # noqa: PLR2004
    array = array.astype(dtype, copy=False)
    return Lazy(CONS, LIST_DECODERS[array.dtype.str], array.tobytes())
