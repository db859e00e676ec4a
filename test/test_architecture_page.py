"""Page on the architecture: each file, class and function that it mentions exists."""

import ast
import re
from typing import Any, Iterator, List, Set, Tuple

import pytest
from parsed_sources import NODES, ROOT, SOURCE

pytestmark = pytest.mark.docs

PAGE = ROOT / "docs" / "explanation" / "architecture.md"
QUOTED = re.compile(r"`([^`\n]+)`")
FENCED_BLOCK = re.compile(r"^```.*?^```\n", re.MULTILINE | re.DOTALL)
INDENTED_BLOCK = re.compile(r"(?<=\n\n)(?: {4}.*\n|\n(?= {4}))+")
"""Lines of code after a blank line; indented lines after others continue an item of a list."""
OTHER_NAMES = {
    *("float", "int", "struct"),  # of Python
    *("split_tf", "new_event(tf(Parent, Child, V, Q), Sec, NSec)"),  # of the example
    *("synchronized(Event, Query, Conditions)", "geometry_msgs__0__PoseStamped"),
    *("fever", "temperature(anna, 39.5)", "temperature(anna, 38.2)", '("anna", 39.5)', "Who", "T1"),
    *("seq", "within"),
    *("tf", "retalisInputEvents", "receive_once", "RETALIS_TEST_FUSED=1", "retalis"),  # of ROS
}
"""Quoted texts that are no names of the package."""


def quoted_paths_and_names() -> Tuple[Any, ...]:
    """Return the quoted paths and names in the sentences and tables of the page."""
    text = INDENTED_BLOCK.sub("", FENCED_BLOCK.sub("", PAGE.read_text(encoding="utf-8")))
    quoted = dict.fromkeys(QUOTED.findall(text))
    paths = [text for text in quoted if "/" in text or text.endswith(".py")]
    return paths, [text for text in quoted if text not in paths and text not in OTHER_NAMES]


PATHS, NAMES = quoted_paths_and_names()


@pytest.fixture(scope="module")
def names() -> Any:
    """Return the names that the package defines; those in classes also with the name of the class."""
    names: Set[Any] = set()
    for nodes in NODES.values():
        for node in nodes:
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
                names.add(node.name)
            if isinstance(node, ast.ClassDef):
                names |= {f"{node.name}.{name}" for name in member_names(node)}
    return names


def member_names(node: Any) -> Iterator[str]:
    """Yield the names of the methods and attributes of a class."""
    for inner in ast.walk(node):
        if isinstance(inner, ast.FunctionDef):
            yield inner.name
        elif isinstance(inner, ast.Attribute) and getattr(inner.value, "id", "") == "self":
            yield inner.attr


@pytest.mark.parametrize("path", PATHS)
def test_path_exists(path: Any) -> None:
    assert (SOURCE / path).exists() or (ROOT / path).exists()


@pytest.mark.parametrize("name", NAMES)
def test_name_exists(name: Any, names: Any) -> None:
    assert name in names


def test_page_has_all_other_names() -> None:
    assert set(QUOTED.findall(PAGE.read_text(encoding="utf-8"))) >= OTHER_NAMES


def test_page_has_all_packages() -> None:
    text = PAGE.read_text(encoding="utf-8")
    package_names = {path.relative_to(SOURCE).parts[0] for path in SOURCE.glob("*/**/*.py")}
    assert len(package_names) > 10
    assert [package for package in package_names if f"| `{package}/` |" not in text] == []


EXCERPT = re.compile(r"```python\n# (?P<path>[\w/]+\.py), (?P<name>[\w.]+)\n(?P<text>.*?)```", re.DOTALL)


def excerpts() -> List[Tuple[Any, ...]]:
    """Return the path, function and lines of each excerpt of the source."""
    text = PAGE.read_text(encoding="utf-8")
    assert len(EXCERPT.findall(text)) == text.count("```python")
    return [(match["path"], match["name"], match["text"].splitlines()) for match in EXCERPT.finditer(text)]


def find_definition(path: Any, name: str) -> Any:
    """Return the syntax node of a function or method."""
    node = ast.parse((SOURCE / path).read_text(encoding="utf-8"))
    for part in name.split("."):
        (node,) = (child for child in node.body if getattr(child, "name", None) == part)
    return node


@pytest.mark.parametrize(("path", "name", "lines"), excerpts())
def test_excerpts_are_lines_of_the_source(path: Any, name: Any, lines: Any) -> None:
    node = find_definition(path, name)
    source = (SOURCE / path).read_text(encoding="utf-8").splitlines()[node.lineno - 1 : node.end_lineno]
    remaining = iter([line.strip() for line in source])
    for line in lines:
        assert line == "..." or line.strip() in remaining, line
