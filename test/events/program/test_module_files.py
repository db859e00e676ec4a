"""Module files: loading once, circular imports, use by rules, and reloading."""

import pytest

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
def folder(tmp_path):
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    return tmp_path


def values(engine, goal):
    return [engine.show(found["X"]) for found in engine.query(goal)]


def check(engine):
    assert values(engine, "main(X)") == ["a(b)"]
    assert values(engine, "a:help(1, X)") == ["a(1)"]
    assert values(engine, "b:help(X)") == ["b"]
    assert values(engine, "help(X)") == ["part"]


def test_each_is_loaded_once_and_keeps_its_names(folder):
    engine = Engine()
    engine.load_program(folder / "main.pl")
    check(engine)
    assert values(engine, "shared(X)") == ["first", "0"]


def test_they_are_modules_in_a_state_that_was_kept_and_when_they_are_read_again(folder):
    engine = Engine()
    engine.load_program(folder / "main.pl")
    restored = Engine.restore(engine.snapshot())
    check(restored)
    assert values(restored, "add(9), shared(X)") == ["first", "0", "9"]
    (folder / "b.pl").write_text(FILES["b.pl"].replace("help(b)", "help(new)"))
    engine.reload(folder / "main.pl")
    assert values(engine, "main(X)") == ["a(new)"]
    assert values(engine, "b:help(X)") == ["new"]


def test_rules_use_them(folder):
    engine, heard = Engine(), []
    engine.on_event(lambda term, start, end: heard.append(engine.show(term)))
    engine.load_rules((folder / "eventRules.txt").read_text(), str(folder / "eventRules.txt"), folder)
    engine.event("e(1)", 1)
    assert heard == ["e(1)", "seen(b)"]
    assert values(engine, "help(X)") == ["rules"]


def test_a_file_of_event_rules_is_none(folder):
    engine, said = Engine(), []
    engine.logic.message = lambda kind, text: said.append(text)
    engine.load_rules(":- module(m, []).\nb <- a where own.\nown.\n")
    assert "module/2 has no effect" in said[0]
    assert engine.call("own")


def test_one_that_fails_half_way_is_left(folder):
    engine = Engine()
    (folder / "wrong.pl").write_text(":- module(wrong, [w/1]).\n:- throw(no).\nw(X) :- v(X).\nv(1).\n")
    engine.rules.on_warning = lambda warning: None
    engine.load_program(folder / "wrong.pl")
    engine.load_rules("v(2).\n")
    assert values(engine, "w(X)") == ["1"]
    assert values(engine, "v(X)") == ["2"]
