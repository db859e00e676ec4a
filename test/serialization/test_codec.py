"""Encoding of data and terms as bytes."""

import tracemalloc
from functools import partial
from typing import Any, List, Sequence

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from retalis import String, Term, UsageError, Var, atom, functor, make_list
from retalis.prolog.terms.term_traversal import term_key
from retalis.prolog.terms.timestamps import FloatSeconds, Stamp
from retalis.prolog.terms.types import Lazy
from retalis.serialization.codec import from_bytes, to_bytes
from retalis.serialization.stored_field_types import KEY, FlatKey

ATOMS = st.text(max_size=5).map(atom)
LEAVES = st.one_of(
    ATOMS, st.integers(), st.floats(allow_nan=False), st.text(max_size=5).map(String), st.builds(Var)
)
TERMS = st.recursive(
    LEAVES,
    lambda inner: st.tuples(ATOMS, st.lists(inner, min_size=1, max_size=3)).map(
        lambda drawn: (functor(drawn[0].name, len(drawn[1])), *drawn[1])
    ),
    max_leaves=20,
)
F2 = functor("f", 2)


def decoded(data: object) -> Any:
    """Return data as they are after encoding and decoding."""
    return from_bytes(to_bytes(data))


@given(TERMS)
def test_terms_are_decoded(term: Any) -> None:
    assert term_key(decoded(term)) == term_key(term)


@given(
    st.lists(
        st.one_of(st.integers(), st.floats(allow_nan=False), st.text(), st.binary(), st.none(), st.booleans())
    )
)
def test_tuples_and_mappings_are_decoded_as_lists(data: List[Any]) -> None:
    assert from_bytes(to_bytes([data, tuple(data), [["x", data]]])) == [data, data, [["x", data]]]


@given(TERMS)
def test_keys_of_terms_are_decoded(term: Any) -> None:
    assert KEY.check(decoded([term_key(term)])[0]) == term_key(term)


def test_shared_variable_is_decoded_once() -> None:
    var, bound = Var(), Var()
    bound.ref = atom("x")
    first, second, third = decoded([var, (functor("f", 1), var), bound])
    assert first is second[1]
    assert third is atom("x")


def test_lone_surrogates_are_decoded() -> None:
    assert from_bytes(to_bytes([atom("\ud800"), String("\udfff"), "\ud8ff"])) == [
        atom("\ud800"),
        String("\udfff"),
        "\ud8ff",
    ]


def test_lazy_term_is_encoded_as_its_value() -> None:
    point = functor("p", 1)
    assert from_bytes(to_bytes([Lazy(point, lambda source: point(source), 3)])) == [point(3)]


def test_instants_keep_their_types() -> None:
    whole, stamp, plain = decoded([FloatSeconds(5), Stamp.of(7, F2(1, 2)), 9])
    assert (whole, stamp, plain) == (5, 7, 9)
    assert [instant.__class__ for instant in (whole, stamp, plain)] == [FloatSeconds, Stamp, int]
    assert stamp.term == F2(1, 2)


@pytest.mark.parametrize("is_left_nested", [False, True])
def test_deep_terms_are_decoded(is_left_nested: bool) -> None:
    var = Var()
    term = make_list([var, *range(5_000), var])
    if is_left_nested:
        for number in range(5_000):
            term = functor("s", 2)(term, number)
    (pair,) = decoded([["x", [term, (term, 1)]]])
    assert term_key(pair[1][0]) == term_key(term)


def test_shared_subterm_is_encoded_once() -> None:
    term: Term = atom("x")
    for _ in range(3000):
        term = F2(term, term)
    data = to_bytes(term)
    assert len(data) < 200_000
    shared: Any = from_bytes(data)
    assert shared[1] is shared[2]


def test_cyclic_term_is_refused() -> None:
    var = Var()
    var.ref = F2(var, 1)
    with pytest.raises(UsageError, match="contains itself"):
        to_bytes([var])


def test_object_of_other_type_is_an_error() -> None:
    with pytest.raises(TypeError, match="object cannot be stored"):
        to_bytes([object()])
    with pytest.raises(TypeError, match="cannot be stored"):
        to_bytes([print])


def pack_parts(
    data: object,
    atoms: Sequence[object] = (),
    names: Sequence[object] = (),
    arities: Sequence[object] = (),
    nodes: Sequence[object] = (),
) -> bytes:
    """Return bytes in the format of `to_bytes` with arbitrary parts."""
    parts = ((list(atoms), list(names), list(arities), len(nodes)), *nodes, data)
    return b"".join(msgpack.packb(part, use_bin_type=True) for part in parts)


ATOM, FUNCTOR, _, _, _, NODE, _, KIND, _, STAMP = (partial(msgpack.ExtType, code) for code in range(10))


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x80\x04.",
        b"\xc1",
        b"cos\nsystem\n(S'false'\ntR.",
        to_bytes([1])[:-1],
        to_bytes([1]) + b"\x01",
        pack_parts(ATOM(b"\0")),
        pack_parts(ATOM(b"\0\0"), ["a"]),
        pack_parts(1, [1]),
        pack_parts(1, names=["f"]),
        pack_parts(1, names=["f"], arities=[-1]),
        pack_parts(1, names=["f"], arities=[1 << 40]),
        pack_parts(NODE(b"\0")),
        pack_parts(1, nodes=[NODE(b"\0")]),
        pack_parts(1, nodes=[NODE(b"\1"), 1]),
        pack_parts(KIND(b"\x05")),
        pack_parts(STAMP(b"\0\0\0\0\0"), nodes=[[1]]),
        pack_parts(msgpack.ExtType(100, b"")),
        pack_parts({"a": 1}),
    ],
)
def test_malformed_bytes_are_refused(data: Any) -> None:
    with pytest.raises(UsageError):
        from_bytes(data)


@pytest.mark.parametrize(
    "arguments", [[1], [1, 2, 3], [1, None], [1, [2]], [1, "x"], [1, FUNCTOR(b"\0")], [1, b"x"], [1, True]]
)
def test_invalid_arguments_are_not_decoded_as_term(arguments: Any) -> None:
    value = from_bytes(pack_parts([FUNCTOR(b"\0"), *arguments], names=["f"], arities=[2]))
    assert value.__class__ in (list, FlatKey)


@pytest.mark.parametrize("depth", [1, 400])
def test_lengths_without_items_allocate_no_memory(depth: int) -> None:
    head = msgpack.packb(([], [], [], 0))
    data = head + b"\xdd\x00\x80\x00\x00" * depth + bytes(9_000_000)
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        with pytest.raises(UsageError):
            from_bytes(data if depth > 1 else head + b"\xdd\xff\xff\xff\xff")
        assert tracemalloc.get_traced_memory()[1] - before < 40_000_000
    finally:
        tracemalloc.stop()


def test_deep_nesting_is_refused() -> None:
    with pytest.raises(UsageError):
        from_bytes(msgpack.packb(([], [], [], 0)) + b"\x91" * 100_000 + b"\x01")
