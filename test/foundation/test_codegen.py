"""The one place where text becomes code."""

import ast
import gc
import sys
import traceback
import weakref
from pathlib import Path

import pytest

from retalis.foundation import codegen

AT_ONCE = getattr(sys, "_is_gil_enabled", lambda: True)()
"""Whether functions are freed as soon as nothing holds them; threads without a lock leave them to the collector."""

ROOT = Path(__file__).resolve().parents[2]
SOURCES = [
    *(ROOT / "src").rglob("*.py"),
    *(ROOT / "examples").rglob("*.py"),
    *(path for path in (ROOT / "nodes").iterdir() if path.is_file()),
    ROOT / "install.py",
    ROOT / "install_shell.py",
    ROOT / "setup.py",
]
FORBIDDEN = {"exec", "eval", "compile", "__import__", "execfile"}
RUNS_TEXT = {"os.system", "os.popen", "pickle", "marshal", "copyreg", "shelve", "code", "codeop", "runpy"}


def calls(tree):
    """Yield the names of what is called, and the modules that are imported."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and node.id in FORBIDDEN:
            yield node.id
        elif isinstance(node, ast.Attribute):
            yield dotted(node)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module


def dotted(node):
    inner = node.value
    return f"{inner.id}.{node.attr}" if isinstance(inner, ast.Name) else f"?.{node.attr}"


@pytest.mark.slow
@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_nothing_else_makes_code_of_text(path):
    if path.name == "codegen.py":
        return
    found = set(calls(ast.parse(path.read_text(encoding="utf-8"))))
    wrong = found & (FORBIDDEN | RUNS_TEXT | {"builtins." + name for name in FORBIDDEN})
    assert not wrong


def test_the_search_finds_them():
    tree = ast.parse("import pickle\nx = eval\nos.system('')\nbuiltins.exec('')\nre.compile('a')")
    assert {"pickle", "eval", "os.system", "builtins.exec"} <= set(calls(tree))


def test_a_function_sees_what_it_was_given():
    made = codegen.function(["def generated(x):", "    return x + k1"], {"k1": 2}, "sum")
    assert made(1) == 3


@pytest.mark.parametrize(
    "name", ["open", "__import__", "eval", "exec", "compile", "getattr", "globals", "vars"]
)
def test_a_function_sees_nothing_else(name):
    with pytest.raises(NameError):
        codegen.function(["def generated():", f"    return {name}"], {}, "what is not given")()


@pytest.mark.parametrize("name", ["a b", "é", "", "x\0", "1x", "a" * 40, "x\n", "\u212a"])
def test_names_are_our_own(name):
    for make in (codegen.shared_function, lambda s, n, t: codegen.function([s], n, t)):
        with pytest.raises(ValueError, match="is not a name for generated source"):
            make("def generated(): return 1\n", {name: 1}, "wrong name")


@pytest.mark.parametrize("text", ["é", "\ud800", "ª"])
def test_sources_are_plain(text):
    with pytest.raises(ValueError, match="ASCII"):
        codegen.function([f"def generated(): return '{text}'"], {}, "strange source")


@pytest.mark.parametrize("title", ["p/2", "a\0b", "\ud800", "x\ny", "'é'", "x" * 100_000, ""])
def test_any_title_will_do_and_tracebacks_show_the_source(title):
    made = codegen.function(["def generated():", "    return missing_thing"], {}, title)
    try:
        made()
    except NameError:
        text = traceback.format_exc()
    assert "return missing_thing" in text
    assert len(text) < 5000


def test_functions_of_one_source_share_their_code():
    one, two = (
        codegen.shared_function("def generated():\n    return k\n", {"k": k}, "constant") for k in (1, 2)
    )
    assert (one(), two()) == (1, 2)
    assert one.__code__ is two.__code__


def test_long_sources_are_not_kept():
    source = "def generated():\n" + "    k\n" * 3000 + "    return k\n"
    one, two = (codegen.shared_function(source, {"k": k}, "constant") for k in (1, 2))
    assert (one(), two()) == (1, 2)
    assert one.__code__ is not two.__code__


@pytest.mark.parametrize("make", ["function", "shared_function"])
def test_a_function_that_nothing_holds_is_gone_at_once(make):
    gc.disable()
    try:
        if make == "function":
            made = codegen.function(["def generated(x):", "    return x + k"], {"k": 1}, "test")
        else:
            made = codegen.shared_function("def generated(x):\n    return x + k\n", {"k": 1}, "test")
        assert made(1) == 2
        held = weakref.ref(made)
        space = made.__globals__
        assert made not in space.values()
        del made
        if not AT_ONCE:
            gc.collect()
        assert held() is None
    finally:
        gc.enable()


def test_names_are_new_and_those_of_one_key_the_same():
    names = codegen.BoundNames({"given": 1})
    assert names.name("v") == "v1"
    assert names.name("k", "text") == "k2"
    assert names.constant(None, "a") == names.constant(None, "a") == "k3"
    assert names.constant(2.0, "b") == "k4"
    assert names.values == {"given": 1, "k2": "text", "k3": None, "k4": 2.0}
