"""The page on how it is built: every file, class and function that it mentions is there."""

import ast
import re

import pytest
from source import NODES, ROOT, SOURCE

pytestmark = pytest.mark.docs

PAGE = ROOT / "docs" / "explanation" / "architecture.md"
QUOTED = re.compile(r"`([^`\n]+)`")
NO_NAMES = {
    *("float", "int", "struct"),  # Python's
    *("split_tf", "new_event(tf(Parent, Child, V, Q), Sec, NSec)"),  # the example's
    *("synchronized(Event, Query, Conditions)", "geometry_msgs__0__PoseStamped"),
    *("fever", "temperature(anna, 39.5)", "temperature(anna, 38.2)", '("anna", 39.5)', "Who", "T1"),
    *("seq", "within"),
    *("tf", "retalisInputEvents", "receive_once", "RETALIS_TEST_FUSED=1", "retalis"),  # ROS's
}
"""What the page quotes besides."""


def quoted():
    """Return what the page quotes in its sentences and tables: paths, and the rest."""
    text = re.sub(r"^    .*\n", "", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)
    found = dict.fromkeys(QUOTED.findall(text))
    paths = [one for one in found if "/" in one or one.endswith(".py")]
    return paths, [one for one in found if one not in paths and one not in NO_NAMES]


PATHS, NAMES = quoted()


@pytest.fixture(scope="module")
def names():
    """Return the names that the package's files define; those of a class also with its name before them."""
    found = set()
    for nodes in NODES.values():
        for node in nodes:
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
                found.add(node.name)
            if isinstance(node, ast.ClassDef):
                found |= {f"{node.name}.{name}" for name in own_names(node)}
    return found


def own_names(node):
    """Yield the names of a class's methods and attributes."""
    for inner in ast.walk(node):
        if isinstance(inner, ast.FunctionDef):
            yield inner.name
        elif isinstance(inner, ast.Attribute) and getattr(inner.value, "id", "") == "self":
            yield inner.attr


@pytest.mark.parametrize("path", PATHS)
def test_files_are_there(path):
    assert (SOURCE / path).exists() or (ROOT / path).exists()


@pytest.mark.parametrize("name", NAMES)
def test_names_are_there(name, names):
    assert name in names


def test_what_is_no_name_of_the_code_is_mentioned():
    assert set(QUOTED.findall(PAGE.read_text(encoding="utf-8"))) >= NO_NAMES


def test_all_rooms_are_named():
    text = PAGE.read_text(encoding="utf-8")
    rooms = {path.relative_to(SOURCE).parts[0] for path in SOURCE.glob("*/**/*.py")}
    assert [room for room in rooms if f"| `{room}/` |" not in text] == []


EXCERPT = re.compile(r"```python\n# (?P<path>[\w/]+\.py), (?P<name>[\w.]+)\n(?P<text>.*?)```", re.DOTALL)


def excerpts():
    """Return the path, function and lines of each excerpt of the source."""
    text = PAGE.read_text(encoding="utf-8")
    assert len(EXCERPT.findall(text)) == text.count("```python")
    return [(match["path"], match["name"], match["text"].splitlines()) for match in EXCERPT.finditer(text)]


def find_definition(path, name):
    """Return the syntax node of a function or method."""
    node = ast.parse((SOURCE / path).read_text(encoding="utf-8"))
    for part in name.split("."):
        (node,) = (child for child in node.body if getattr(child, "name", None) == part)
    return node


@pytest.mark.parametrize(("path", "name", "lines"), excerpts())
def test_excerpts_are_lines_of_the_source(path, name, lines):
    node = find_definition(path, name)
    source = (SOURCE / path).read_text(encoding="utf-8").splitlines()[node.lineno - 1 : node.end_lineno]
    remaining = iter([line.strip() for line in source])
    for line in lines:
        assert line == "..." or line.strip() in remaining, line
