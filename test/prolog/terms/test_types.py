import copy
import gc
import pickle
import sys
import threading

import pytest
from reachability import reachable

from retalis import atom, functor
from retalis.prolog.terms import types


def test_one_atom_for_a_name():
    assert atom("base_link") is atom("base_link")
    assert atom("a") is not atom("b")
    assert copy.deepcopy(atom("a")) is pickle.loads(pickle.dumps(atom("a"))) is atom("a")


def test_the_functor_of_an_atom_is_made_at_need():
    one = atom("some name")
    assert one.functor is functor("some name", 0) is one.functor
    with pytest.raises(AttributeError):
        one.other  # noqa: B018


@pytest.mark.slow
def test_atoms_that_no_term_holds_are_forgotten():
    kept = atom("kept text")
    for number in range(1000):
        atom(f"text {number}")
    gc.collect()
    assert not any(name.startswith("text ") for name in reachable(list(vars(types).values()), str))
    assert atom("kept text") is kept


def test_threads_get_the_same_atom():
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    wrong = []

    def work():
        for number in range(3000):
            name = f"name {number % 3}"
            one = atom(name)
            if atom(name) is not one or one.name != name:
                wrong.append(name)

    threads = [threading.Thread(target=work) for _ in range(4)]
    try:
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        sys.setswitchinterval(interval)
    assert not wrong


def test_functors_that_nothing_holds_are_forgotten():
    first = functor("for_a_moment", 2)
    assert functor("for_a_moment", 2) is first
    kept = (first, 1, 2)
    del first
    gc.collect()
    assert kept[0] is functor("for_a_moment", 2)
    del kept
    gc.collect()
    assert ("for_a_moment", 2) not in reachable(list(vars(types).values()), tuple)
