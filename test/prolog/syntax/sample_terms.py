"""Strategies for random terms, and their comparison."""

import struct
from typing import Any, Dict, List, Tuple

from hypothesis import strategies as st

from retalis import String, Var, atom, deref, functor
from retalis.prolog.terms.types import CONS, NIL


def shape(term: Any) -> Any:
    """Return a hashable value that is equal for terms that differ in the names of variables only."""
    numbers: Dict[Any, Any] = {}
    flat: List[Any] = []
    stack = [term]
    while stack:
        item = deref(stack.pop())
        if isinstance(item, tuple):
            flat.append(item[0])
            stack.extend(reversed(item[1:]))
        elif isinstance(item, Var):
            flat.append(("var", numbers.setdefault(item, len(numbers))))
        elif isinstance(item, float):
            flat.append(("float", struct.pack("d", item) if item == item else "nan"))
        else:
            flat.append((type(item).__name__, item))
    return tuple(flat)


names = st.one_of(
    st.sampled_from(["a", "foo", "tf__0__tfMessage", "x1", "[]", "{}", "!", ";", ",", "|", "-", "+", "\\+"]),
    st.sampled_from(
        ["dynamic", "seq", "not", "do", "<-", ":", ":-", "nan", "inf", "is", "mod", "*", "$", "."]
    ),
    st.sampled_from(
        ['"/odom"', '""', "it's", "", " ", "A", "_", "a b", "é", "É", "→", "\n", "\\", "/*", "%", "1"]
    ),
    st.text(max_size=5),
)
atoms = names.map(atom)
variables = st.sampled_from([Var() for _ in range(3)])
numbers = st.one_of(
    st.integers(), st.integers(-9, 9), st.floats(), st.sampled_from([0.0, -0.0, 1e15, 1e22, 1e-7])
)
leaves = st.one_of(atoms, numbers, variables, st.text(max_size=4).map(String))


def _compound(children: Any) -> Any:
    def build(pair: Any) -> Tuple[Any, ...]:
        name, arguments = pair
        return (functor(name, len(arguments)), *arguments)

    def make(pair: Any) -> Any:
        items, tail = pair
        for item in reversed(items):
            tail = (CONS, item, tail)
        return tail

    return st.one_of(
        st.tuples(names, st.lists(children, min_size=1, max_size=3)).map(build),
        st.tuples(names, st.lists(children, min_size=1, max_size=2)).map(build),
        st.tuples(st.lists(children, min_size=1, max_size=3), st.one_of(st.just(NIL), children)).map(make),
    )


terms = st.recursive(leaves, _compound, max_leaves=12)
