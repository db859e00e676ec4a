"""What interpreters differ in: it stands in one file, and both versions of it do the same."""

import ast
import gc
import re
import subprocess
import sys
import weakref
from pathlib import Path

import pytest

from retalis.foundation.cpython_and_pypy import (
    PYPY,
    drop_unshared,
    make_releasing_list,
    remove_dead_reference,
    restrict_builtins,
    text_size,
)

PACKAGE = Path(__file__).resolve().parents[2] / "src" / "retalis"

ONE_PLACE = PACKAGE / "foundation" / "cpython_and_pypy.py"

ELSEWHERE = {"PyDLL": "prolog/swi/libswipl.py"}
"""What stands where it is used: that file says what PyPy has no way for."""

OF_ONE_KIND = {
    *("_weakref", "_remove_dead_weakref", "__pypy__", "_decimal", "_ctypes", "PyDLL", "pythonapi"),
    *("getrefcount", "getsizeof", "getallocatedblocks", "_is_gil_enabled", "implementation", "O_PATH"),
    *("freeze", "unfreeze", "get_freeze_count", "set_threshold", "get_threshold", "get_count"),
}
"""Modules, and names in others, that one interpreter has and the other has not."""

ANY = re.compile(rf"\b({'|'.join(OF_ONE_KIND)})\b")

OF = {"os", "sys", "gc", "ctypes", "platform", "weakref"}


def named(tree):
    """Yield what a module names of an interpreter."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            yield node.module
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in OF:
            yield node.attr


def test_the_search_finds_them():
    tree = ast.parse("import _weakref\nfrom sys import getrefcount\ngc.freeze()\nself.freeze()\nimport gc")
    assert OF_ONE_KIND & set(named(tree)) == {"_weakref", "getrefcount", "freeze"}
    assert {"getrefcount", "__pypy__", "freeze"} < set(
        named(ast.parse(ONE_PLACE.read_text(encoding="utf-8")))
    )


def test_they_are_named_in_one_place():
    wrong = []
    for path in sorted(PACKAGE.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if path != ONE_PLACE and ANY.search(text):
            found = OF_ONE_KIND & set(named(ast.parse(text)))
            place = path.relative_to(PACKAGE).as_posix()
            wrong += [f"{place}: {name}" for name in sorted(found) if ELSEWHERE.get(name) != place]
    assert wrong == []


class Thing:
    """What can be held."""


class Other(Thing):
    """Something else."""


def test_what_nothing_else_holds_is_dropped():
    kept, chained = Thing(), Thing()
    chained.next = Thing()
    objects = [Thing(), kept, Other(), chained.next, Thing()]
    objects[4].next = Thing()
    objects.append(objects[4].next)  # held by one that goes
    left = drop_unshared(objects, Thing)
    assert objects == []
    assert [type(one) for one in left] == [Thing, Other, Thing]
    assert left[0] is kept and left[2] is chained.next


def test_what_is_taken_off_a_list_ends_there():
    ended = []

    class Ending:
        def __init__(self, name):
            self.name = name

        if not PYPY:

            def __del__(self):
                ended.append(self.name)

    items = make_releasing_list(lambda item: ended.append(item.name))
    for name in "abcde":
        items.append(Ending(name))
    items.pop().name = "popped"
    del items[3:]
    del items[1:]
    del items[1:]
    assert ended[not PYPY :] == ["d", "c", "b"]
    assert [item.name for item in items] == ["a"]


def test_only_what_is_gone_is_taken_out():
    one, other = Thing(), Thing()
    table = {"one": weakref.ref(one), "other": weakref.ref(other)}
    remove_dead_reference(table, "one")
    assert set(table) == {"one", "other"}
    del one
    gc.collect()
    for key in ("one", "other", "none"):
        try:
            remove_dead_reference(table, key)
        except KeyError:  # CPython up to 3.8: nobody asks for what is not there
            assert key == "none"
    assert set(table) == {"other"}


@pytest.mark.parametrize("text", ["", "a", "\xe9" * 30, "\u0416" * 300, "\U0001f916" * 5])
def test_texts_are_not_taken_for_smaller_than_they_are(text):
    assert text_size(text) >= len(text.encode())
    if not PYPY:
        assert text_size(text) == sys.getsizeof(text)


@pytest.mark.parametrize(
    ("source", "seen"),
    [
        ("def made(): return open", False),
        ("def made(): return (lambda: [eval for _ in len('a') * 'b'])()", False),
        ("def made(): return len('a'), given, 'x'.format", True),
        ("def made(open): return open", True),
    ],
)
def test_code_finds_no_other_functions(source, seen):
    names = {"given": 1}
    code = compile(source, "test", "exec")

    def run():
        restrict_builtins(code, names, {"len": len})
        exec(code, names)
        names["made"](*[1] * names["made"].__code__.co_argcount)

    if seen:
        run()
    else:
        with pytest.raises(NameError, match="is not defined"):
            run()


@pytest.mark.skipif(PYPY, reason="PyPy exits without a collection")
def test_nothing_is_collected_once_a_process_is_about_to_exit():
    source = """
import gc
from retalis.foundation.cpython_and_pypy import stop_collecting
cycle = []
cycle.append(cycle)
del cycle
stop_collecting()
print(gc.collect(), gc.isenabled(), gc.get_count()[1:])
"""
    path = str(PACKAGE.parent)
    printed = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path.insert(0, {path!r}){source}"],
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert printed.stdout.split()[:2] == ["0", "False"]
