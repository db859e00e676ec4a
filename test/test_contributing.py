"""Lists of files in ``CONTRIBUTING.md``: each listed file contains the example of its list."""

import re
from pathlib import Path
from typing import Any, Iterator

import pytest
from asserting_accessors import search
from contributing_snippets import SNIPPETS, Snippet

pytestmark = pytest.mark.docs

ROOT = Path(__file__).resolve().parent.parent
PAGE = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
QUOTED = re.compile(r"`([^`\n]+)`")
SECTIONS = re.compile(r"^### ([^\n]*)\(([^\n]*)\)\n(.*?)(?=^##)", re.MULTILINE | re.DOTALL)
WITHOUT_EXAMPLE = {
    "src/retalis/prolog/system/predicate_resolution.py",
    "src/retalis/events/language/pattern_parser.py",
    "src/retalis/events/network/rule_compiler.py",
    "src/retalis/prolog/builtins/builtin_registry.py",
    "src/retalis/prolog/builtins/__init__.py",
    "src/retalis/prolog/library/",
    "test/prolog/builtins",
    "src/retalis/serialization/stored_field_types.py",
    "src/retalis/serialization/state_file_format.py",
}
"""Files that define the mechanism, or folders with further files."""


def is_path(text: Any) -> bool:
    return "/" in text and " " not in text


def listed_files() -> Iterator[Any]:
    for title, examples, body in SECTIONS.findall(PAGE):
        names = QUOTED.findall(examples)
        paths = [text for text in QUOTED.findall(body) if is_path(text) or (ROOT / text).is_file()]
        assert names, title
        assert paths, title
        for path in paths:
            if path not in WITHOUT_EXAMPLE:
                yield pytest.param(path, names, id=f"{names[0]}-{path}")


@pytest.mark.parametrize(("path", "names"), list(listed_files()))
def test_listed_file_contains_example(path: Any, names: Any) -> None:
    listed = ROOT / path
    files = [file for file in listed.rglob("*") if file.is_file()] if listed.is_dir() else [listed]
    texts = [path, *(file.read_text(encoding="utf-8") for file in files)]
    assert files
    assert any(re.search(rf"(?<![A-Za-z]){name}(?![A-Za-z])", text) for name in names for text in texts)


def test_named_files_exist() -> None:
    paths = [text for text in QUOTED.findall(PAGE) if is_path(text)]
    assert len(paths) > 20
    assert [path for path in paths if not (ROOT / path).exists()] == []


@pytest.mark.parametrize(
    "snippet",
    [snippet for snippets in SNIPPETS.values() for snippet in snippets],
    ids=lambda snippet: snippet.path,
)
def test_place_of_snippet_is_unique(snippet: Snippet) -> None:
    path = ROOT / snippet.path
    assert path.exists() != snippet.place.endswith(", a new file")
    if snippet.relation is not None:
        snippet.find_line(path.read_text(encoding="utf-8").splitlines())


def test_named_marks_exist() -> None:
    marks = re.findall(r'pytest -m "?(?:not )?(\w+)', PAGE)
    assert marks
    for mark in marks:
        assert f'"{mark}: ' in (ROOT / "pyproject.toml").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", ["CONTRIBUTING.md", "noxfile.py", ".pre-commit-config.yaml"])
def test_options_of_old_mypy_are_named(name: str) -> None:
    options = search(
        r"^MYPY_38_OPTIONS = \((.*)\)$", (ROOT / "install.py").read_text(encoding="utf-8"), re.MULTILINE
    )
    names = re.findall(r'"([^"]+)"', options.group(1))
    assert names
    for option in names:
        assert option in (ROOT / name).read_text(encoding="utf-8")
