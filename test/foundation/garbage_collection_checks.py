"""Tests of the garbage collector's settings, in a process without the objects of other tests."""

import gc
import sys
import weakref
from typing import Any, Iterator, List, Tuple

import pytest

from retalis import Engine, collect_when_idle, limit_gc_pauses, restore_gc
from retalis.events.matches.interval_index import gc_paused
from retalis.foundation import garbage_collection
from retalis.foundation.garbage_collection import YoungCollector


class Linked:
    """An object in a reference cycle of its own."""

    def __init__(self) -> None:
        self.itself = self


def settings() -> Tuple[Any, ...]:
    return gc.get_threshold(), len(gc.callbacks)


@pytest.fixture(autouse=True)
def _restored_collector(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(garbage_collection, "gc", gc)
    thresholds = gc.get_threshold()
    gc.unfreeze()
    gc.set_threshold(700, 10, 10)
    yield
    restore_gc()
    gc.collect()
    gc.freeze()  # the state before each test
    gc.set_threshold(*thresholds)


@pytest.fixture
def _limited() -> None:
    limit_gc_pauses()


def test_loaded_objects_are_frozen() -> None:
    before = settings()
    limit_gc_pauses()
    limit_gc_pauses()
    assert gc.get_freeze_count() > 10_000
    assert gc.get_threshold()[0] > 700
    restore_gc()
    restore_gc()
    assert gc.get_freeze_count() == 0
    assert settings() == before


def test_engine_keeps_settings_of_collector() -> None:
    before = settings()
    engine = Engine()
    engine.load(rules="fever(X) <- hot(X) seq hot(X).")
    for number in range(2000):
        engine.event(f"hot({number})", number)
    assert settings() == before
    assert gc.get_freeze_count() == 0


@pytest.mark.usefixtures("_limited")
def test_collection_visits_bounded_number_of_objects() -> None:
    object_counts: List[Any] = []

    def count_objects(phase: Any, info: Any) -> None:
        if phase == "start" and info["generation"]:
            object_counts.append(len(gc.get_objects()))

    gc.callbacks.append(count_objects)
    try:
        alive = [[number] for number in range(300_000)]
    finally:
        gc.callbacks.remove(count_objects)
    assert len(alive) == 300_000
    assert len(object_counts) > 3
    assert max(object_counts) < 70_000


@pytest.mark.usefixtures("_limited")
def test_young_garbage_is_collected() -> None:
    freed: List[Any] = []
    for _ in range(1000):
        weakref.finalize(Linked(), freed.append, None)
    alive = [[number] for number in range(50_000)]
    assert len(alive) == 50_000
    assert len(freed) == 1000


def late_garbage() -> Any:
    """Return finalizers of cycles that were frozen before they became garbage."""
    frozen = [Linked() for _ in range(100_000)]
    finalizers = [weakref.finalize(linked, int) for linked in frozen[:20_000]]
    del frozen
    assert all(linked.alive for linked in finalizers)
    return finalizers


@pytest.mark.usefixtures("_limited")
def test_late_garbage_is_collected_when_idle(monkeypatch: pytest.MonkeyPatch) -> None:
    assert not collect_when_idle()
    finalizers = late_garbage()
    monkeypatch.setattr(YoungCollector, "MAX_GARBAGE_BLOCKS_IDLE", -(10**9))
    assert collect_when_idle()
    assert not any(finalizer.alive for finalizer in finalizers)
    assert gc.get_freeze_count() > 10_000


@pytest.mark.usefixtures("_limited")
def test_late_garbage_is_collected_if_heap_grows(monkeypatch: pytest.MonkeyPatch) -> None:
    finalizers = late_garbage()
    monkeypatch.setattr(YoungCollector, "MAX_GARBAGE_BLOCKS", -(10**9))
    alive: List[Any] = []
    while any(finalizer.alive for finalizer in finalizers):
        alive += [[number] for number in range(10_000)]
        assert len(alive) < 1_000_000
    assert gc.get_freeze_count() > 10_000  # the other objects are frozen again
    assert gc.get_threshold()[2] > 0


@pytest.mark.usefixtures("_limited")
def test_growth_by_records_of_engines_is_accepted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(YoungCollector, "BLOCKS_PER_RECORD", 40)
    engine = Engine()
    engine.load(rules="fever(X) <- hot(X) seq cold(X).")
    limit_gc_pauses()
    # The limit is a quarter of the heap and these blocks; other tests may have left a large heap.
    monkeypatch.setattr(YoungCollector, "MAX_GARBAGE_BLOCKS_IDLE", 20_000 - sys.getallocatedblocks() // 4)
    for number in range(100_000):
        engine.event(f"hot({number})", number)
    assert not collect_when_idle()
    monkeypatch.setattr(YoungCollector, "BLOCKS_PER_RECORD", 0)
    assert collect_when_idle()


def test_collector_is_paused_in_context() -> None:
    assert gc.isenabled()
    with gc_paused():
        assert not gc.isenabled()
        with gc_paused():
            pass
        assert not gc.isenabled()
    assert gc.isenabled()
