"""Fixtures of the tests of benchmarks."""

import importlib
import sys
from pathlib import Path
from types import ModuleType
from typing import Any, Callable, Iterator

import pytest

from retalis.foundation.garbage_collection import stop_limiting_gc_pauses

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = (ROOT / "bench", ROOT / "examples" / "nao")


def _is_in_folders(module: ModuleType) -> bool:
    return Path(getattr(module, "__file__", None) or "").parent in FOLDERS


@pytest.fixture
def import_benchmark(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], ModuleType]]:
    """Return a function that imports the module of a benchmark; after the test, its modules are removed."""
    monkeypatch.setattr(sys, "path", [*map(str, FOLDERS), *sys.path])
    modules_before = dict(sys.modules)

    def import_benchmark(name: str) -> ModuleType:
        # A package of the tests may have the same name.
        if name in sys.modules and not _is_in_folders(sys.modules[name]):
            monkeypatch.delitem(sys.modules, name)
        return importlib.import_module(name)

    yield import_benchmark
    for name, module in list(sys.modules.items()):
        if _is_in_folders(module) and module is not modules_before.get(name):
            del sys.modules[name]


@pytest.fixture
def bench(import_benchmark: Callable[[str], Any]) -> Iterator[Callable[[str], Any]]:
    """Return the function that imports the module of a benchmark, and restore the garbage collector."""
    yield import_benchmark
    stop_limiting_gc_pauses()  # the benchmark limits them
