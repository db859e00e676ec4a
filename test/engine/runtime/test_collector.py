import gc

import pytest

from retalis.engine.runtime import relax, tighten
from retalis.events.matches.timeindex import paused
from retalis.foundation import PYPY


@pytest.mark.slow
@pytest.mark.skipif(PYPY, reason="PyPy has no generations to freeze: nothing is set there")
def test_what_is_loaded_is_not_walked_again():
    thresholds = gc.get_threshold()
    try:
        gc.unfreeze()
        gc.set_threshold(700, 10, 10)
        relax()
        assert gc.get_freeze_count() > 10_000
        assert gc.get_threshold()[0] > 700
        tighten()
        assert gc.get_freeze_count() == 0
        assert gc.get_threshold()[0] < 50_000
    finally:
        gc.freeze()  # as all tests begin
        gc.set_threshold(*thresholds)


def test_paused_while_something_is_built_and_as_before_then():
    assert gc.isenabled()
    with paused():
        assert not gc.isenabled()
        with paused():
            pass
        assert not gc.isenabled()
    assert gc.isenabled()
