"""Lists of array elements, made from the bytes of the array."""

from functools import lru_cache
from struct import Struct, calcsize, unpack
from struct import error as StructError
from typing import Callable, Dict, List, Tuple

from ..foundation import codegen
from ..prolog.terms import CONS, NIL, Term

SMALL = 4
"""Arrays up to this length are decoded with the message: a lazy term would cost as much."""

Make = Callable[[bytes], Term]


@lru_cache(maxsize=None)
def array_maker(code: str) -> Make:
    """Return the function that makes the list of the numbers of a `struct` code."""
    size = calcsize("<" + code)

    def make(source: bytes) -> Term:
        term: Term = NIL
        for value in reversed(unpack(f"<{len(source) // size}{code}", source)):
            term = (CONS, value, term)
        return term

    return make


def alike(element: Term, number: int) -> Term:
    """Return the list of so many elements that are one term."""
    term: Term = NIL
    for _ in range(number):
        term = (CONS, element, term)
    return term


def record_maker(
    title: str, layout: Struct, targets: List[str], element: str, names: Dict[str, object]
) -> Make:
    """Return the function that makes the list of elements of one size.

    Args:
        title: the type, for tracebacks.
        layout: how one element lies in the bytes.
        targets: the variables of its values.
        element: the source of the term of one element, from these variables.
        names: the globals of that source.
    """
    lines = [
        "def make(source):",
        "  term = N",
        f"  for {', '.join(targets)}, in reversed(list(unpack(source))):",
        f"    term = (C, {element}, term)",
        "  return term",
    ]
    given = {**names, "unpack": layout.iter_unpack}
    made: Make = codegen.function(lines, given, f"decode {title}", "make")
    return made


def variable_array(
    element: Callable[[bytes, int], Tuple[Term, int]], least: int
) -> Callable[[bytes, int, int], Tuple[Term, int]]:
    """Return the function that decodes elements of different sizes.

    Args:
        element: decodes the element at a place; returns it and the place after it.
        least: the size of the shortest element.
    """

    def decode(data: bytes, at: int, number: int) -> Tuple[Term, int]:
        if number * least > len(data) - at:  # before anything is made
            raise StructError
        items = []
        for _ in range(number):
            item, at = element(data, at)
            items.append(item)
        term: Term = NIL
        while items:
            term = (CONS, items.pop(), term)
        return term, at

    return decode
