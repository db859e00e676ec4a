"""What users get: all names of the package have a docstring with an example, and the examples are true."""

import ast
import doctest
import importlib
import inspect
import subprocess
import sys
from pathlib import Path
from typing import Iterator

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
def folder(tmp_path):
    """Return a folder with a program that says what it hears, and a bag for it."""
    (tmp_path / "pub_sub.xml").write_text(PROGRAM)
    (tmp_path / "goalPredicates.txt").write_text("subscribe(std_msgs__0__String(_), [], _, echo, e)\n")
    with retalis.BagWriter(tmp_path / "talk.bag") as bag:
        text = bag.add("/chatter", retalis.Definitions().find("std_msgs/String"))
        bag.write(text, 10**9, bytes([5, 0, 0, 0]) + b"hello")
    return tmp_path


PUBLIC = {name: getattr(retalis, name) for name in retalis.__all__}
METHODS = {
    f"{name}.{member}": getattr(one, member)
    for name, one in PUBLIC.items()
    if inspect.isclass(one)
    for part in inspect.getmro(one)
    if part is one or part.__module__.startswith("retalis.engine.")
    for member, found in vars(part).items()
    if not member.startswith("_") and (inspect.isroutine(found) or isinstance(found, (property, classmethod)))
}
"""What users call, beside the names themselves."""
OF_THEIR_CLASS = {name for name in PUBLIC if name != "Engine"}
"""Classes whose own examples may show their methods, each in its place."""


def docstring(name, one):
    """Return the text that explains a name; an alias of a type has it below, in its file."""
    if inspect.isclass(one) or inspect.isroutine(one):
        return inspect.getdoc(one)
    body = ast.parse(Path(types.__file__).read_text(encoding="utf-8")).body
    for statement, after in zip(body, body[1:]):
        bound = {node.id for node in ast.walk(statement) if isinstance(node, ast.Name)}
        if isinstance(statement, (ast.If, ast.Assign)) and name in bound and isinstance(after, ast.Expr):
            return ast.literal_eval(after.value)
    return ""


def run(name, text, folder):
    example = doctest.DocTestParser().get_doctest(
        text or "", {**PUBLIC, "folder": folder, "Iterator": Iterator}, name, None, None
    )
    assert example.examples, "no example"
    said = []
    doctest.DocTestRunner(verbose=False).run(example, out=said.append)
    assert not said, "".join(said)


@pytest.mark.parametrize("name", retalis.__all__)
def test_each_name_has_an_example_that_is_true(name, folder):
    run(name, docstring(name, PUBLIC[name]), folder)


@pytest.mark.parametrize("name", METHODS)
def test_each_method_is_shown_by_an_example_that_is_true(name, folder):
    home, _, member = name.partition(".")
    text = inspect.getdoc(METHODS[name]) or ""
    if home in OF_THEIR_CLASS and ">>>" not in text:
        shown = [
            line for line in docstring(home, PUBLIC[home]).splitlines() if line.startswith((">>>", "..."))
        ]
        assert any(f".{member}" in line for line in shown), "no example"
    else:
        run(name, text, folder)


def test_type_checkers_see_the_names_that_programs_get():
    """What they read is imported by nobody: it has to be the same."""
    tree = ast.parse(Path(retalis.__file__).read_text(encoding="utf-8"))
    (seen,) = [node for node in tree.body if isinstance(node, ast.If)]
    found = {
        alias.name: getattr(importlib.import_module(f"retalis.{line.module}"), alias.name)
        for line in seen.body
        for alias in line.names
    }
    assert sorted(found) == sorted(retalis.__all__)
    assert [name for name, one in found.items() if getattr(retalis, name) is not one] == []


def test_names_cost_nothing_before_somebody_asks():
    script = "import sys, retalis; print(*[name for name in sys.modules if name.startswith('retalis.')])"
    loaded = subprocess.run(
        [sys.executable, "-c", script],
        cwd=Path(retalis.__file__).parent.parent,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    assert loaded.stdout.split() == []


def test_an_engine_needs_neither_bags_nor_openssl_and_leaves_the_collector_as_it_was():
    script = (
        "import gc, sys, retalis\n"
        "assert retalis.Engine and gc.isenabled()\n"
        "retalis.Engine()\n"
        "assert not {'hashlib', 'multiprocessing', 'retalis.playback'} & set(sys.modules)\n"
        "gc.disable()\n"
        "assert retalis.Playback and not gc.isenabled()\n"
    )
    subprocess.run([sys.executable, "-c", script], cwd=Path(retalis.__file__).parent.parent, check=True)


def test_names_are_sorted_and_there():
    assert retalis.__all__ == sorted(retalis.__all__, key=str.lower)
    with pytest.raises(AttributeError, match="has no attribute 'Nothing'"):
        retalis.Nothing  # noqa: B018


def test_an_engine_shows_operators_and_what_is_there():
    engine = retalis.Engine()
    engine.load(goals="memorize(a, [], _, m, 3)\nsubscribe(a, [], _, out, s)", rules="b <- a.")
    topic, name, memory = (engine.query(f"X = {text}")[0]["X"] for text in ("out", "s", "m"))
    assert engine.summary() == "1 event rule, 1 memory, 1 subscription"
    assert engine.has_memory(memory) and not engine.has_memory(name)
    assert engine.has_subscription(topic, name) and not engine.has_subscription(name, topic)
    assert engine.delete_subscription(topic, name) and not engine.delete_subscription(topic, name)
    engine.call("op(700, xfx, near)")
    assert engine.operators is engine.operators
    assert engine.show(engine.query("X = (a near b)")[0]["X"]) == "a near b"
    assert engine.brief(topic) == "out"


@pytest.mark.slow
def test_what_there_is_is_shown():
    assert {*retalis.__all__} <= {*dir(retalis)}
    names = {}
    exec("from retalis import *", names)
    assert {*retalis.__all__} <= {*names}
