"""The lists of files in CONTRIBUTING.md: what they name as an example stands in each of these files."""

import re
from pathlib import Path

import pytest

pytestmark = pytest.mark.docs

ROOT = Path(__file__).resolve().parent.parent
PAGE = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
QUOTED = re.compile(r"`([^`\n]+)`")
SECTIONS = re.compile(r"^### ([^\n]*)\(([^\n]*)\)\n(.*?)(?=^##)", re.MULTILINE | re.DOTALL)
NOT_OF_EACH = {
    "src/retalis/prolog/system/predicate_resolution.py",
    "src/retalis/events/language/pattern_parser.py",
    "src/retalis/events/network/rule_compiler.py",
    "src/retalis/prolog/builtins/builtin_registry.py",
    "src/retalis/prolog/builtins/__init__.py",
    "src/retalis/prolog/library/",
}
"""Files that say how it is done, or where others of the kind stand."""


def is_path(text):
    return "/" in text and " " not in text


def listed():
    for title, examples, body in SECTIONS.findall(PAGE):
        names = QUOTED.findall(examples)
        paths = [one for one in QUOTED.findall(body) if is_path(one) or (ROOT / one).is_file()]
        assert names and paths, title
        for path in paths:
            if path not in NOT_OF_EACH:
                yield pytest.param(path, names, id=f"{names[0]}-{path}")


@pytest.mark.parametrize("path, names", list(listed()))
def test_the_example_stands_in_each_file_of_its_list(path, names):
    found = ROOT / path
    files = [one for one in found.rglob("*") if one.is_file()] if found.is_dir() else [found]
    texts = [path, *(one.read_text(encoding="utf-8") for one in files)]
    assert any(re.search(rf"(?<![A-Za-z]){name}(?![A-Za-z])", text) for name in names for text in texts)
    assert files


def test_all_files_are_there():
    paths = [one for one in QUOTED.findall(PAGE) if is_path(one)]
    assert [one for one in paths if not (ROOT / one).exists()] == []


def test_marks_and_runs_are_those_that_are_named():
    for mark in re.findall(r'pytest -m "?(?:not )?(\w+)', PAGE):
        assert f'"{mark}: ' in (ROOT / "pyproject.toml").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", ["CONTRIBUTING.md", "noxfile.py", ".pre-commit-config.yaml"])
def test_options_for_an_old_mypy_are_named_wherever_types_are_checked(name):
    options = re.search(
        r"^MYPY_38_OPTIONS = \((.*)\)$", (ROOT / "install.py").read_text(encoding="utf-8"), re.MULTILINE
    )
    for option in re.findall(r'"([^"]+)"', options.group(1)):
        assert option in (ROOT / name).read_text(encoding="utf-8")
