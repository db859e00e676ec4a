"""Tests of the garbage collector's settings, in a process without the objects of other tests."""

import gc
import sys
import weakref
from typing import Any, Callable, Iterator, List, Tuple

import pytest

from retalis import Engine, collect_when_idle, limit_gc_pauses, restore_gc
from retalis.events.matches.interval_index import gc_paused
from retalis.foundation import garbage_collection
from retalis.foundation.garbage_collection import YoungCollector
from retalis.node import node_process
from retalis.node.node_process import wait_while


class Linked:
    """An object in a reference cycle of its own."""

    def __init__(self) -> None:
        self.itself = self


def settings() -> Tuple[Any, ...]:
    return gc.get_threshold(), list(gc.callbacks)


@pytest.fixture(autouse=True)
def _restored_collector(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(garbage_collection, "gc", gc)
    thresholds = gc.get_threshold()
    gc.set_threshold(700, 10, 10)
    yield
    restore_gc()
    gc.set_threshold(*thresholds)


@pytest.fixture
def _limited() -> None:
    limit_gc_pauses()


def test_limits_change_only_thresholds() -> None:
    thresholds, callbacks = settings()
    limit_gc_pauses()
    limit_gc_pauses()
    assert gc.get_threshold()[0] > 700
    assert gc.callbacks == callbacks
    restore_gc()
    restore_gc()
    assert settings() == (thresholds, callbacks)


def test_engine_keeps_settings_of_collector() -> None:
    before = settings()
    engine = Engine()
    engine.load(rules="fever(X) <- hot(X) seq hot(X).")
    for number in range(2000):
        engine.event(f"hot({number})", number)
    assert settings() == before


@pytest.mark.usefixtures("_limited")
def test_collection_visits_bounded_number_of_objects() -> None:
    object_counts: List[Any] = []

    def count_objects(phase: Any, info: Any) -> None:
        if phase == "start" and info["generation"]:
            generations = range(info["generation"] + 1)
            object_counts.append(sum(len(gc.get_objects(generation)) for generation in generations))

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
    """Return finalizers of cycles that were in the oldest generation before they became garbage."""
    cycles = [Linked() for _ in range(100_000)]
    finalizers = [weakref.finalize(linked, int) for linked in cycles[:20_000]]
    del cycles
    assert all(linked.alive for linked in finalizers)
    return finalizers


@pytest.mark.usefixtures("_limited")
def test_late_garbage_is_collected_when_idle(monkeypatch: pytest.MonkeyPatch) -> None:
    assert not collect_when_idle()
    finalizers = late_garbage()
    monkeypatch.setattr(YoungCollector, "MAX_GARBAGE_BLOCKS_IDLE", -(10**9))
    assert collect_when_idle()
    assert not any(finalizer.alive for finalizer in finalizers)


def run_goal(engine: Engine) -> None:
    assert engine.call("forall(between(1, 10000, X), integer(X))")


def wait_at_load(engine: Engine) -> None:
    """Wait as the main thread of a node does that has work without events."""
    states = iter([True, False])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(node_process, "MAX_IDLE_LOAD", -1.0)
        patch.setattr(node_process, "SHUTDOWN_CHECK_SECONDS", 0.01)
        wait_while(lambda: next(states))


@pytest.mark.usefixtures("_limited")
@pytest.mark.parametrize("work", [run_goal, wait_at_load])
def test_late_garbage_is_collected_by_work(
    monkeypatch: pytest.MonkeyPatch, work: Callable[[Engine], None]
) -> None:
    engine = Engine()
    finalizers = late_garbage()
    work(engine)
    assert all(finalizer.alive for finalizer in finalizers)
    monkeypatch.setattr(YoungCollector, "MAX_GARBAGE_BLOCKS", -(10**9))
    monkeypatch.setattr(YoungCollector, "COLLECTIONS_PER_CHECK", 1)
    alive = [[number] for number in range(50_000)]  # some collections of the second generation
    work(engine)
    assert not any(finalizer.alive for finalizer in finalizers)
    assert len(alive) == 50_000


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
