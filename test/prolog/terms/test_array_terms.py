"""Array terms against the lists that they stand for."""

import math
from typing import Any

import numpy as np
import pytest
from asserting_accessors import lazy

from retalis import PrologError, String, Var, atom, deref, make_list
from retalis.prolog.builtins.argument_checks import array_of
from retalis.prolog.syntax.term_writer import writeq
from retalis.prolog.terms.array_terms import BLOB, CODES, LAZY_STRING_FUNCTOR, array_term, lazy_array
from retalis.prolog.terms.types import NIL, Lazy


@pytest.mark.parametrize("dtype", CODES)
def test_array_term_keeps_numbers_and_type(dtype: Any) -> None:
    numbers = np.arange(1, 21).astype(dtype) * (1 if dtype.endswith("1") else 3)
    term = array_term(numbers)
    array = array_of(term)
    assert array.dtype == numbers.dtype
    assert array.tolist() == numbers.tolist()
    assert not array.flags.writeable
    assert lazy(term).decoded_term is None
    assert writeq(term) == writeq(make_list(numbers.tolist()))


@pytest.mark.parametrize("numbers", [np.arange(9, dtype=">i4"), np.arange(18, dtype="i4")[::2]])
def test_byte_order_and_strides_are_normalized(numbers: Any) -> None:
    assert array_of(array_term(numbers)).tolist() == numbers.tolist()


def test_decoded_array_term_keeps_its_bytes() -> None:
    term = array_term(np.arange(9.0))
    deref(term)
    assert lazy(term).decoded_term is not None
    assert array_of(term).tolist() == list(range(9))


def test_array_term_is_a_copy() -> None:
    numbers = np.arange(9.0)
    term = array_term(numbers)
    numbers[0] = 5
    assert array_of(term)[0] == 0


@pytest.mark.parametrize("count", range(7))
def test_short_array_is_a_list(count: int) -> None:
    term = array_term(np.arange(count))
    assert (term.__class__ is Lazy) == (count > 4)
    assert array_of(term).tolist() == list(range(count))


def test_wide_floats_are_converted_to_doubles() -> None:
    assert array_of(array_term(np.arange(9, dtype="g"))).dtype == np.dtype("f8")


@pytest.mark.parametrize(
    "array", [np.zeros((2, 2)), np.array(1.0), np.array(["a"] * 9), np.array([True] * 9)]
)
def test_array_of_other_items_is_refused(array: Any) -> None:
    with pytest.raises(ValueError, match="not a list of numbers"):
        array_term(array)


@pytest.mark.parametrize(
    ("items", "dtype"),
    [
        ([], "i8"),
        ([1, -2, 2**63 - 1], "i8"),
        ([1, 2.5], "f8"),
        ([2**63], "u8"),
        ([2**63, -1], "f8"),
        ([10**30, 0], "f8"),
        ([1.5, math.inf, math.nan], "f8"),
    ],
)
def test_list_is_converted_to_array(items: Any, dtype: str) -> None:
    array = array_of(make_list(items))
    assert array.dtype == np.dtype(dtype)
    np.testing.assert_array_equal(array, np.array(items, dtype))


def test_bound_variables_are_dereferenced() -> None:
    item, tail, whole = Var(), Var(), Var()
    item.ref, tail.ref = 2, make_list([3.5])
    whole.ref = make_list([1, item], tail)
    assert array_of(whole).tolist() == [1, 2, 3.5]
    whole.ref = array_term(np.arange(9))
    assert array_of(whole).tolist() == list(range(9))
    assert lazy(whole.ref).decoded_term is None


@pytest.mark.parametrize("data", [b"", b"text", b"\x00\xff", bytes(range(256)) * 8])
def test_byte_array_is_converted_to_array(data: bytes) -> None:
    lazy = Lazy(LAZY_STRING_FUNCTOR, BLOB, data)
    assert array_of(lazy).tobytes() == data
    assert lazy.decoded_term is None
    assert array_of(deref(lazy)).tobytes() == data
    assert array_of(lazy).tobytes() == data


@pytest.mark.parametrize("term", [Var(), make_list([1, Var()]), make_list([1], Var())])
def test_unbound_part_is_an_instantiation_error(term: Any) -> None:
    with pytest.raises(PrologError, match="not sufficiently instantiated"):
        array_of(term)


@pytest.mark.parametrize(
    ("term", "error"),
    [
        (1, "`list' expected, found `1'"),
        (atom("ranges"), "`list' expected, found `ranges'"),
        (String("ab"), "`list' expected"),
        (make_list([1], 2), "`list' expected"),
        (atom('"FFFFFFFFFFx"'), "expected base64"),
        (make_list([1, 2, atom("a")]), "`number' expected, found `a': item 2 of a list of numbers"),
        (make_list([NIL]), r"`number' expected, found `\[\]': item 0"),
    ],
)
def test_term_that_is_no_array_is_a_type_error(term: Any, error: str) -> None:
    with pytest.raises(PrologError, match=error):
        array_of(term)


def test_other_lazy_terms_are_no_arrays() -> None:
    assert lazy_array(Lazy(LAZY_STRING_FUNCTOR, lambda data: NIL, b"")) is None
    assert lazy_array(Var()) is None
    assert lazy_array(1) is None
