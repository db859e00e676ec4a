"""Public names of the package: each has a docstring with an example, and the examples are run."""

import ast
import doctest
import importlib
import inspect
import subprocess
import sys
from pathlib import Path
from typing import Any, Dict, Iterator, List

import pytest

import retalis
from retalis.prolog.terms import types

PROGRAM = """\
<publish_subscribe>
  <subscribe_to name="chatter" msg_type="std_msgs/String"/>
  <publish_to name="echo" msg_type="std_msgs/String"/>
</publish_subscribe>
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with a program that publishes received texts, and with a bag."""
    (tmp_path / "pub_sub.xml").write_text(PROGRAM)
    (tmp_path / "goalPredicates.txt").write_text("subscribe(std_msgs__0__String(_), [], _, echo, e)\n")
    with retalis.BagWriter(tmp_path / "talk.bag") as bag:
        text = bag.add("/chatter", retalis.Definitions().find("std_msgs/String"))
        bag.write(text, 10**9, bytes([5, 0, 0, 0]) + b"hello")
    return tmp_path


PUBLIC = {name: getattr(retalis, name) for name in retalis.__all__}
METHODS = {
    f"{name}.{member}": getattr(public, member)
    for name, public in PUBLIC.items()
    if inspect.isclass(public)
    for base in inspect.getmro(public)
    if base is public or base.__module__.startswith("retalis.engine.")
    for member, value in vars(base).items()
    if not member.startswith("_") and (inspect.isroutine(value) or isinstance(value, (property, classmethod)))
}
"""Public methods and properties of the public classes."""
WITH_CLASS_EXAMPLES = {name for name in PUBLIC if name != "Engine"}
"""Classes whose own examples may show their methods."""


def docstring(name: Any, public: Any) -> Any:
    """Return the docstring of a name; that of a type alias is below it in its file."""
    if inspect.isclass(public) or inspect.isroutine(public):
        return inspect.getdoc(public)
    body = ast.parse(Path(types.__file__).read_text(encoding="utf-8")).body
    for statement, after in zip(body, body[1:]):
        bound = {node.id for node in ast.walk(statement) if isinstance(node, ast.Name)}
        if isinstance(statement, (ast.If, ast.Assign)) and name in bound and isinstance(after, ast.Expr):
            return ast.literal_eval(after.value)
    return ""


def run(name: Any, text: Any, folder: Any) -> None:
    example = doctest.DocTestParser().get_doctest(
        text or "", {**PUBLIC, "folder": folder, "Iterator": Iterator}, name, None, None
    )
    assert example.examples, "no example"
    failures: List[Any] = []
    doctest.DocTestRunner(verbose=False).run(example, out=failures.append)
    assert not failures, "".join(failures)


@pytest.mark.parametrize("name", retalis.__all__)
def test_each_name_has_valid_example(name: Any, folder: Path) -> None:
    run(name, docstring(name, PUBLIC[name]), folder)


@pytest.mark.parametrize("name", METHODS)
def test_each_method_has_valid_example(name: str, folder: Path) -> None:
    class_name, _, member = name.partition(".")
    text = inspect.getdoc(METHODS[name]) or ""
    if class_name in WITH_CLASS_EXAMPLES and ">>>" not in text:
        example_lines = [
            line
            for line in docstring(class_name, PUBLIC[class_name]).splitlines()
            if line.startswith((">>>", "..."))
        ]
        assert any(f".{member}" in line for line in example_lines), "no example"
    else:
        run(name, text, folder)


def test_imports_for_type_checkers_equal_names() -> None:
    """The imports under `TYPE_CHECKING` are never executed."""
    tree = ast.parse(Path(retalis.__file__).read_text(encoding="utf-8"))
    (block,) = [node for node in tree.body if isinstance(node, ast.If)]
    names = {
        alias.name: getattr(importlib.import_module(f"retalis.{statement.module}"), alias.name)
        for statement in block.body
        if isinstance(statement, ast.ImportFrom)
        for alias in statement.names
    }
    assert sorted(names) == sorted(retalis.__all__)
    assert [name for name, value in names.items() if getattr(retalis, name) is not value] == []


def test_names_are_imported_when_used() -> None:
    script = "import sys, retalis; print(*[name for name in sys.modules if name.startswith('retalis.')])"
    process = subprocess.run(
        [sys.executable, "-c", script],
        cwd=Path(retalis.__file__).parent.parent,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    assert process.stdout.split() == []


def test_engine_imports_few_modules() -> None:
    script = (
        "import gc, sys, retalis\n"
        "assert retalis.Engine and gc.isenabled()\n"
        "retalis.Engine()\n"
        "assert not {'hashlib', 'multiprocessing', 'retalis.playback'} & set(sys.modules)\n"
        "gc.disable()\n"
        "assert retalis.Playback and not gc.isenabled()\n"
    )
    subprocess.run([sys.executable, "-c", script], cwd=Path(retalis.__file__).parent.parent, check=True)


def test_names_are_sorted_and_others_are_errors() -> None:
    assert retalis.__all__ == sorted(retalis.__all__, key=str.lower)
    with pytest.raises(AttributeError, match="has no attribute 'Nothing'"):
        retalis.Nothing  # noqa: B018


def test_engine_has_summary_and_operators() -> None:
    engine = retalis.Engine()
    engine.load(goals="memorize(a, [], _, m, 3)\nsubscribe(a, [], _, out, s)", rules="b <- a.")
    topic, name, memory = (engine.query(f"X = {text}")[0]["X"] for text in ("out", "s", "m"))
    assert engine.summary() == "1 event rule, 1 memory, 1 subscription"
    assert engine.has_memory(memory)
    assert not engine.has_memory(name)
    assert engine.has_subscription(topic, name)
    assert not engine.has_subscription(name, topic)
    assert engine.delete_subscription(topic, name)
    assert not engine.delete_subscription(topic, name)
    engine.call("op(700, xfx, near)")
    assert engine.operators is engine.operators
    assert engine.show(engine.query("X = (a near b)")[0]["X"]) == "a near b"
    assert engine.brief(topic) == "out"


@pytest.mark.slow
def test_dir_and_star_import_have_names() -> None:
    assert {*retalis.__all__} <= {*dir(retalis)}
    names: Dict[Any, Any] = {}
    exec("from retalis import *", names)
    assert {*retalis.__all__} <= {*names}
