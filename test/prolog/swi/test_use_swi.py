"""``use_swi``: loaded files, permissions, and snapshots."""

import ctypes
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from parsed_sources import ROOT
from subprocess_python_path import python_path

from retalis import Engine, ProgramErrors, RetalisError, Settings, UsageError
from retalis.prolog.swi import libswipl
from retalis.prolog.swi.libswipl import SwiLibrary

ALLOWED = Settings(allow_swi=True)


def test_use_swi_requires_permission(tmp_path: Path) -> None:
    (tmp_path / "any.pl").write_text(":- module(any, [any/1]).\nany(1).\n")
    with pytest.raises(ProgramErrors, match="load swi_file .*: the setting allow_swi is off"):
        Engine().load(rules=":- use_swi('any.pl').", folder=tmp_path)


def test_use_swi_at_run_time_is_refused(folder: Path) -> None:
    engine = Engine(settings=ALLOWED)
    engine.load(rules="near(a).", folder=folder)
    with pytest.raises(RetalisError, match="load swi_file .* only what the program's own files ask for"):
        engine.query("use_swi('kb.pl')")


def test_missing_swi_prolog_is_reported(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "any.pl").write_text(":- module(any, [any/1]).\nany(1).\n")
    libswipl.find_library.cache_clear()
    session = pytest.importorskip("retalis.prolog.swi.swi_session")
    monkeypatch.setattr(session, "_start_runtime", session._start_runtime.__wrapped__)  # noqa: SLF001
    monkeypatch.setattr(libswipl, "LIBRARY_NAMES", ("libswipl_that_is_not_there.so",))
    monkeypatch.setattr(libswipl, "LIBRARY_PATTERNS", ())
    with pytest.raises(ProgramErrors, match="SWI-Prolog, which is not installed here: .* swi-prolog-nox"):
        Engine(settings=ALLOWED).load(rules=":- use_swi('any.pl').", folder=tmp_path)


def test_function_missing_in_older_version_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    class OldLibrary(ctypes.PyDLL):
        """A library that has not all of the functions."""

        def __init__(self, name: str, **options: Any) -> None:
            super().__init__("libc.so.6", **options)

        def __getitem__(self, name: Any) -> Any:
            return super().__getitem__("abs" if name != "PL_is_acyclic" else name)

    find = libswipl.find_library.__wrapped__
    monkeypatch.setattr(libswipl, "LIBRARY_PATTERNS", ())
    monkeypatch.setattr(libswipl, "LIBRARY_NAMES", ("libswipl_that_is_not_there.so", "libc.so.6"))
    with pytest.raises(
        UsageError, match=r"SWI-Prolog 7\.6\.4 or later: 'libc\.so\.6' is older.*PL_initialise"
    ):
        find()
    monkeypatch.setattr(ctypes, "PyDLL", OldLibrary)
    monkeypatch.setattr(ctypes, "CDLL", OldLibrary)
    with pytest.raises(UsageError, match="PL_is_acyclic"):
        find()


@pytest.mark.slow
def test_engine_without_use_swi_loads_no_bridge() -> None:
    environment = {**os.environ, "PYTHONPATH": python_path()}
    script = (
        "import sys, retalis; retalis.Engine(); "
        "print(any(name.startswith('retalis.prolog.swi.s') for name in sys.modules))"
    )
    process = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, env=environment
    )
    assert process.stdout == "False\n"


@pytest.mark.slow
def test_enabled_tests_fail_without_swi_prolog() -> None:
    script = (
        "import sys, pytest; from retalis.prolog.swi import libswipl; "
        "libswipl.LIBRARY_NAMES = libswipl.LIBRARY_PATTERNS = (); "
        f"sys.exit(pytest.main([{os.path.dirname(__file__)!r} + '/test_swi_terms.py']))"
    )
    environment = {**os.environ, "PYTHONPATH": python_path(), "RETALIS_TEST_SWI": "1"}
    process = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, cwd=ROOT, env=environment
    )
    assert process.returncode == 1
    assert "RETALIS_TEST_SWI is set: use_swi needs SWI-Prolog" in process.stdout
    assert "skipped" not in process.stdout


def test_named_predicates_are_defined(swi: SwiLibrary, folder: Path) -> None:
    (folder / "plain.pl").write_text("near(a, b).\nnear(b, c).\nnext_to(X, Y) :- near(X, Y).\n")
    engine = Engine(settings=ALLOWED)
    engine.load(rules=":- use_swi('plain.pl', [next_to/2, near/2 as close_by]).", folder=folder)
    assert len(engine.query("next_to(X, Y), close_by(X, Y)")) == 2
    with pytest.raises(RetalisError, match="near/2"):
        engine.query("near(a, X)")


def test_library_predicates_are_defined(swi: SwiLibrary) -> None:
    engine = Engine(settings=ALLOWED)
    engine.load(goals="use_swi(library(ugraphs), [vertices_edges_to_ugraph/3, reachable/3])")
    (answer,) = engine.query("vertices_edges_to_ugraph([], [a-b, b-c], G), reachable(b, G, L)")
    assert engine.show(answer["L"]) == "[b,c]"


@pytest.mark.parametrize(
    ("text", "call", "message"),
    [
        ("near(a).\n", "use_swi('wrong.pl')", "exports nothing: name its predicates"),
        ("near(a).\n", "use_swi('wrong.pl', [far/1])", "Unknown procedure: far/1"),
        ("near(a).\n", "use_swi('wrong.pl', [near])", "predicate_indicator"),
        ("near(a).\n", "use_swi('wrong.pl', near/1)", "`list' expected"),
        ("near(a).\n", "use_swi('not_there.pl', [near/1])", "not_there.pl"),
        ("near(a).\n", "use_swi(_)", "not sufficiently instantiated"),
        ("atom_length(a, b).\n", "use_swi('wrong.pl', [atom_length/2])", "atom_length/2"),
        ("near(a) :- (.\n", "use_swi('wrong.pl', [near/1])", "wrong.pl:1:.*[Ss]yntax error"),
        (":- use_module(library(not_there)).\nnear(a).\n", "use_swi('wrong.pl', [near/1])", "not_there"),
        ("near(a).\n", "use_swi(library(not_there), [near/1])", "not_there"),
    ],
)
def test_invalid_use_is_reported(
    swi: SwiLibrary, folder: Path, tmp_path: Path, text: str, call: str, message: str
) -> None:
    (tmp_path / "wrong.pl").write_text(text)
    with pytest.raises(ProgramErrors, match=message):
        Engine(settings=ALLOWED).load(rules=f":- {call}.", folder=tmp_path)


def test_warning_of_swi_is_logged(swi: SwiLibrary, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "doubtful.pl").write_text(
        ":- module(doubtful, [lonely/1]).\nlonely(X) :- near(Y).\nnear(1).\n"
    )
    engine = Engine(settings=ALLOWED)
    engine.load(rules=":- use_swi('doubtful.pl').", folder=tmp_path)
    assert engine.call("lonely(_)")
    assert "doubtful.pl:2: Singleton variables" in caplog.text


def test_changed_file_is_loaded_again(swi: SwiLibrary, tmp_path: Path) -> None:
    path = tmp_path / "changing.pl"
    text = (
        ":- module(changing, [version/1, to/2]).\n:- table to/2.\nto(X, Y) :- to(X, Z), Y is Z + 1, Y < 5.\n"
    )
    path.write_text(f"{text}to(X, X).\nversion(1).\n")
    first = Engine(settings=ALLOWED)
    first.load(rules=":- use_swi('changing.pl').", folder=tmp_path)
    assert len(first.query("to(1, X)")) == 4
    path.write_text(f"{text}to(X, X).\nversion(2).\n")
    os.utime(path, (2e9, 2e9))
    second = Engine(settings=ALLOWED)
    second.load(rules=":- use_swi('changing.pl').", folder=tmp_path)
    assert [engine.query("version(X)") for engine in (first, second)] == [[{"X": 2}], [{"X": 2}]]
    assert len(first.query("to(1, X)")) == 4


def test_restored_engine_loads_swi_file_again(swi: SwiLibrary, tmp_path: Path) -> None:
    (tmp_path / "kept.pl").write_text(
        ":- module(kept, [learn/1, known/1]).\n:- dynamic known/1.\nknown(0).\nlearn(X) :- assertz(known(X)).\n"
    )
    engine = Engine(settings=ALLOWED)
    engine.load(
        rules=":- use_swi('kept.pl', [learn/1, known/1]).\nlearnt(X) <- taught(X) where known(X).",
        folder=tmp_path,
    )
    data = engine.snapshot()
    restored = Engine.restore(data, settings=ALLOWED, folder=tmp_path)
    assert restored.query("known(X)") == [{"X": 0}]
    with pytest.raises(UsageError, match="outside of the program's folder"):
        Engine.restore(data, settings=ALLOWED)
    with pytest.raises(UsageError, match="allow_swi is off"):
        Engine.restore(data, folder=tmp_path)
