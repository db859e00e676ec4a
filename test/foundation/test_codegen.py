"""Generation of code: only this module creates code from text, with restricted names."""

import ast
import gc
import sys
import traceback
import weakref
from pathlib import Path
from typing import Any, Iterator

import pytest

from retalis.foundation import codegen

IS_REFERENCE_COUNTED = getattr(sys, "_is_gil_enabled", lambda: True)()
"""Whether objects are freed with their last reference; free-threaded Python leaves functions to the collector."""

ROOT = Path(__file__).resolve().parents[2]
SOURCES = [
    *(path for path in (ROOT / "src").rglob("*.py") if path.name != "codegen.py"),
    *(ROOT / "examples").rglob("*.py"),
    *(path for path in (ROOT / "nodes").iterdir() if path.is_file()),
    ROOT / "install.py",
    ROOT / "install_shell.py",
    ROOT / "setup.py",
]
FORBIDDEN_BUILTINS = {"exec", "eval", "compile", "__import__", "execfile"}
FORBIDDEN_MODULES = {
    "os.system",
    "os.popen",
    "pickle",
    "marshal",
    "copyreg",
    "shelve",
    "code",
    "codeop",
    "runpy",
}


def used_names_of(tree: Any) -> Iterator[Any]:
    """Yield the names of forbidden built-ins and attributes in use, and of imported modules."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and node.id in FORBIDDEN_BUILTINS:
            yield node.id
        elif isinstance(node, ast.Attribute):
            yield dotted(node)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module


def dotted(node: Any) -> str:
    inner = node.value
    return f"{inner.id}.{node.attr}" if isinstance(inner, ast.Name) else f"?.{node.attr}"


@pytest.mark.slow
@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_code_is_generated_by_codegen_only(path: Path) -> None:
    used_names = set(used_names_of(ast.parse(path.read_text(encoding="utf-8"))))
    forbidden_names = used_names & (
        FORBIDDEN_BUILTINS | FORBIDDEN_MODULES | {"builtins." + name for name in FORBIDDEN_BUILTINS}
    )
    assert not forbidden_names


def test_search_finds_forbidden_names() -> None:
    tree = ast.parse("import pickle\nx = eval\nos.system('')\nbuiltins.exec('')\nre.compile('a')")
    assert {"pickle", "eval", "os.system", "builtins.exec"} <= set(used_names_of(tree))


def test_generated_function_uses_given_names() -> None:
    generated = codegen.function(["def generated(x):", "    return x + k1"], {"k1": 2}, "sum")
    assert generated(1) == 3


@pytest.mark.parametrize(
    "name", ["open", "__import__", "eval", "exec", "compile", "getattr", "globals", "vars"]
)
def test_generated_function_has_no_builtins(name: str) -> None:
    with pytest.raises(NameError):
        codegen.function(["def generated():", f"    return {name}"], {}, "unknown name")()


@pytest.mark.parametrize("name", ["a b", "é", "", "x\0", "1x", "a" * 40, "x\n", "\u212a"])
def test_invalid_name_for_generated_source_is_refused(name: str) -> None:
    for make in (codegen.shared_function, lambda s, n, t: codegen.function([s], n, t)):
        with pytest.raises(ValueError, match="is not a name for generated source"):
            make("def generated(): return 1\n", {name: 1}, "invalid name")


@pytest.mark.parametrize("text", ["é", "\ud800", "ª"])
def test_source_that_is_not_ascii_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="ASCII"):
        codegen.function([f"def generated(): return '{text}'"], {}, "invalid source")


@pytest.mark.parametrize("title", ["p/2", "a\0b", "\ud800", "x\ny", "'é'", "x" * 100_000, ""])
def test_traceback_shows_generated_source(title: str) -> None:
    generated = codegen.function(["def generated():", "    return missing_thing"], {}, title)
    with pytest.raises(NameError) as error:
        generated()
    text = "".join(traceback.format_exception(NameError, error.value, error.tb))
    assert "return missing_thing" in text
    assert len(text) < 5000


def test_functions_of_equal_source_share_code() -> None:
    first, second = (
        codegen.shared_function("def generated():\n    return k\n", {"k": k}, "constant") for k in (1, 2)
    )
    assert (first(), second()) == (1, 2)
    assert first.__code__ is second.__code__


def test_long_source_is_not_cached() -> None:
    source = "def generated():\n" + "    k\n" * 3000 + "    return k\n"
    first, second = (codegen.shared_function(source, {"k": k}, "constant") for k in (1, 2))
    assert (first(), second()) == (1, 2)
    assert first.__code__ is not second.__code__


@pytest.mark.parametrize("make", ["function", "shared_function"])
def test_unreferenced_function_is_freed_at_once(make: str) -> None:
    gc.disable()
    try:
        if make == "function":
            generated = codegen.function(["def generated(x):", "    return x + k"], {"k": 1}, "test")
        else:
            generated = codegen.shared_function("def generated(x):\n    return x + k\n", {"k": 1}, "test")
        assert generated(1) == 2
        reference = weakref.ref(generated)
        globals_of_function = generated.__globals__
        assert generated not in globals_of_function.values()
        del generated
        if not IS_REFERENCE_COUNTED:
            gc.collect()
        assert reference() is None
    finally:
        gc.enable()


def test_new_names_are_unique_per_key() -> None:
    names = codegen.BoundNames({"given": 1})
    assert names.name("v") == "v1"
    assert names.name("k", "text") == "k2"
    assert names.constant(None, "a") == names.constant(None, "a") == "k3"
    assert names.constant(2.0, "b") == "k4"
    assert names.values == {"given": 1, "k2": "text", "k3": None, "k4": 2.0}
