"""Atoms and functors: one object per name, which is released with its last reference."""

import copy
import gc
import pickle
import sys
import threading
from typing import Any, List

import pytest
from reachable_objects import reachable

from retalis import atom, functor
from retalis.prolog.terms import types


def test_equal_names_have_same_atom() -> None:
    assert atom("base_link") is atom("base_link")
    assert atom("a") is not atom("b")
    assert copy.deepcopy(atom("a")) is pickle.loads(pickle.dumps(atom("a"))) is atom("a")


def test_functor_of_atom_is_created_on_demand() -> None:
    name = atom("some name")
    assert name.functor is functor("some name", 0) is name.functor
    with pytest.raises(AttributeError):
        name.other  # noqa: B018


@pytest.mark.slow
def test_unreferenced_atoms_are_released() -> None:
    kept = atom("kept text")
    for number in range(1000):
        atom(f"text {number}")
    gc.collect()
    names = reachable(list(vars(types).values()), str)
    assert "kept text" in names
    assert not any(name.startswith("text ") for name in names)
    assert atom("kept text") is kept


def test_threads_create_same_atom() -> None:
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    differing: List[Any] = []

    def work() -> None:
        for number in range(3000):
            name = f"name {number % 3}"
            created = atom(name)
            if atom(name) is not created or created.name != name:
                differing.append(name)

    threads = [threading.Thread(target=work) for _ in range(4)]
    try:
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        sys.setswitchinterval(interval)
    assert not differing


def test_unreferenced_functors_are_released() -> None:
    first = functor("for_a_moment", 2)
    assert functor("for_a_moment", 2) is first
    kept = (first, 1, 2)
    del first
    gc.collect()
    assert kept[0] is functor("for_a_moment", 2)
    del kept
    gc.collect()
    assert ("for_a_moment", 2) not in reachable(list(vars(types).values()), tuple)
