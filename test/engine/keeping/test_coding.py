"""Data and terms as bytes."""

import pickle
import subprocess

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retalis.engine.keeping import coding, from_bytes, to_bytes
from retalis.engine.keeping.coding import make_atom
from retalis.foundation import UsageError
from retalis.prolog.terms import Lazy, String, Var, WholeSeconds, atom, functor, make_list, term_key

ATOMS = st.text(max_size=5).map(atom)
LEAVES = st.one_of(
    ATOMS, st.integers(), st.floats(allow_nan=False), st.text(max_size=5).map(String), st.builds(Var)
)
TERMS = st.recursive(
    LEAVES,
    lambda inner: st.tuples(ATOMS, st.lists(inner, min_size=1, max_size=3)).map(
        lambda made: (functor(made[0].name, len(made[1])), *made[1])
    ),
    max_leaves=20,
)


@given(TERMS)
def test_terms_come_back(term):
    assert term_key(from_bytes(to_bytes(term))) == term_key(term)


@given(
    st.lists(
        st.one_of(st.integers(), st.floats(allow_nan=False), st.text(), st.binary(), st.none(), st.booleans())
    )
)
def test_data_comes_back(data):
    assert from_bytes(to_bytes([data, tuple(data), {"x": data}])) == [data, tuple(data), {"x": data}]


def test_a_variable_stays_one():
    var, bound = Var(), Var()
    bound.ref = atom("x")
    one, two, three = from_bytes(to_bytes([var, (functor("f", 1), var), bound]))
    assert one is two[1]
    assert three is atom("x")


def test_what_is_lazy_is_made():
    point = functor("p", 1)
    assert from_bytes(to_bytes([Lazy(point, lambda source: point(source), 3)])) == [point(3)]


def test_instants_keep_their_forms():
    found = from_bytes(to_bytes(WholeSeconds(5)))
    assert found == 5
    assert found.__class__ is WholeSeconds


@pytest.mark.parametrize("turned", [False, True])
def test_deep_terms_come_back(turned):
    var = Var()
    term = make_list([var, *range(5_000), var])
    if turned:
        for number in range(5_000):
            term = functor("s", 2)(term, number)
    data = {"x": [term, (term, 1)]}
    found = from_bytes(to_bytes(data))["x"][0]
    assert term_key(found) == term_key(term)


def test_what_stands_twice_is_written_once():
    term = atom("x")
    for _ in range(3000):
        term = functor("f", 2)(term, term)
    assert len(to_bytes(term)) < 200_000
    from_bytes(to_bytes(term))


def test_a_pickler_in_python_writes_the_same(monkeypatch):
    """It asks what to do with plain data, too, which may have no hash; that in C does not."""
    members = {"reducer_override": coding._StateWriter.reducer_override}  # noqa: SLF001
    monkeypatch.setattr(coding, "_StateWriter", type("Writer", (pickle._Pickler,), members))  # noqa: SLF001
    term = functor("f", 2)(atom("x"), String("y"))
    data = {"x": [term, (1, 2.5, None, True, b"z")], "float": float}
    assert from_bytes(to_bytes(data)) == data
    with pytest.raises(TypeError, match="complex cannot be kept"):
        to_bytes([1j])


class Evil:
    def __reduce__(self):
        return subprocess.call, (["false"],)


def reduced(*how):
    class Made:
        def __reduce__(self):
            return how

    return pickle.dumps(Made(), 4)


@pytest.mark.parametrize(
    "data",
    [
        pickle.dumps(Evil(), 4),
        pickle.dumps(Evil(), 0),
        pickle.dumps(eval, 4),
        pickle.dumps(getattr, 2),
        b"cos\nsystem\n(S'false'\ntR.",
        b"(S'false'\nios\nsystem\n.",
        b"\x80\x04\x95",
        b"",
        b".",
        to_bytes([1])[:-1],
    ],
)
def test_nothing_is_looked_up(data):
    with pytest.raises(UsageError):
        from_bytes(data)


@pytest.mark.parametrize(
    "state",
    [{"name": "other"}, (None, {"name": "other"}), (None, {"functor": functor("halt", 0)})],
)
def test_atoms_cannot_be_changed(state):
    data = reduced(make_atom, ("kept_as_it_is",), state)
    with pytest.raises(UsageError):
        from_bytes(data)
    assert atom("kept_as_it_is").name == "kept_as_it_is"
    assert atom("other").name == "other"
    assert atom("kept_as_it_is").functor is functor("kept_as_it_is", 0)


def test_makers_cannot_be_changed():
    data = b"\x80\x04\x8c\x06moduleX"  # not whole
    with pytest.raises(UsageError):
        from_bytes(data)
    stolen = pickle.dumps(make_atom, 4)[:-1] + b"}(\x8c\x08__doc__\x8c\x04evilub."
    try:
        from_bytes(stolen)
    except UsageError:
        pass
    assert make_atom.__doc__ == "Return an atom."


def test_what_has_no_place_in_a_state_is_an_error():
    with pytest.raises(TypeError, match="object cannot be kept"):
        to_bytes([object()])
    with pytest.raises(TypeError):
        to_bytes([print])


def test_deep_terms_in_lists_in_tuples_come_back():
    term = atom("z")
    for _ in range(5_000):
        term = functor("s", 1)(term)
    found = from_bytes(
        to_bytes([(functor("p", 1), (True,), [((functor("p", 1), term), atom("true"), None)])])
    )
    assert term_key(found[0][2][0][0][1]) == term_key(term)
