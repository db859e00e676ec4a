"""Module files: loading once, circular imports, use by rules, and reloading."""

from pathlib import Path
from typing import Any, List

import pytest
from recording_reports import RecordingReports

from retalis import Engine

FILES = {
    "a.pl": ":- module(a, [a/1, shared/1]).\n:- use_module(b).\n:- dynamic shared/1.\n"
    "a(X) :- b(Y), help(Y, X).\nhelp(X, Y) :- Y = a(X).\nshared(0).\n",
    "b.pl": ":- module(b, [b/1, add/1]).\n:- use_module(a, [shared/1]).\n:- initialization(go).\n"
    "go :- add(first).\nb(X) :- help(X).\nhelp(b).\nadd(X) :- assertz(shared(X)).\n",
    "part.pl": "help(part).\n",
    "main.pl": ":- use_module(a).\n:- use_module(b).\n:- use_module(a).\n:- ensure_loaded(part).\nmain(X) :- a(X).\n",
    "eventRules.txt": ":- use_module(a).\nseen(Y) <- e(X) where a(a(Y)).\nhelp(rules).\n",
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    return tmp_path


def values(engine: Engine, goal: str) -> List[Any]:
    return [engine.show(answer["X"]) for answer in engine.query(goal)]


def check(engine: Any) -> None:
    assert values(engine, "main(X)") == ["a(b)"]
    assert values(engine, "a:help(1, X)") == ["a(1)"]
    assert values(engine, "b:help(X)") == ["b"]
    assert values(engine, "help(X)") == ["part"]


def test_module_is_loaded_once(folder: Path) -> None:
    engine = Engine()
    engine.load_program(folder / "main.pl")
    check(engine)
    assert values(engine, "shared(X)") == ["first", "0"]


def test_modules_are_restored_and_reloaded(folder: Path) -> None:
    engine = Engine()
    engine.load_program(folder / "main.pl")
    restored = Engine.restore(engine.snapshot())
    check(restored)
    assert values(restored, "add(9), shared(X)") == ["first", "0", "9"]
    (folder / "b.pl").write_text(FILES["b.pl"].replace("help(b)", "help(new)"))
    engine.reload(folder / "main.pl")
    assert values(engine, "main(X)") == ["a(new)"]
    assert values(engine, "b:help(X)") == ["new"]


def test_rules_call_predicates_of_modules(folder: Path) -> None:
    engine, events = Engine(), []
    engine.on_event(lambda term, start, end: events.append(engine.show(term)))
    engine.load_rules((folder / "eventRules.txt").read_text(), str(folder / "eventRules.txt"), folder)
    engine.event("e(1)", 1)
    assert events == ["e(1)", "seen(b)"]
    assert values(engine, "help(X)") == ["rules"]


def test_event_file_is_no_module(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    engine = Engine()
    messages: List[str] = []
    monkeypatch.setattr(engine.logic, "message", lambda kind, text: messages.append(text))
    engine.load_rules(":- module(m, []).\nb <- a where own.\nown.\n")
    assert "module/2 has no effect" in messages[0]
    assert engine.call("own")


def test_module_is_closed_after_error(folder: Path) -> None:
    engine = Engine(reports=RecordingReports())
    (folder / "wrong.pl").write_text(":- module(wrong, [w/1]).\n:- throw(no).\nw(X) :- v(X).\nv(1).\n")
    engine.load_program(folder / "wrong.pl")
    engine.load_rules("v(2).\n")
    assert values(engine, "w(X)") == ["1"]
    assert values(engine, "v(X)") == ["2"]
