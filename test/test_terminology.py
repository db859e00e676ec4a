"""One word for a thing, and one thing for a word: class names, and the glossary that explains them."""

import ast
import re
from collections import defaultdict
from functools import lru_cache

from source import NODES, ROOT, TREES

GLOSSARY = ROOT / "docs" / "reference" / "glossary.md"

# Names that are defined more than once, each with the reason.
TWICE: "dict[str, str]" = {}


@lru_cache(maxsize=None)
def classes():
    """Return the files that define each class, by its name without a leading underscore."""
    found = defaultdict(list)
    for path, nodes in NODES.items():
        for node in nodes:
            if isinstance(node, ast.ClassDef):
                found[node.name.lstrip("_")].append(path)
    return dict(found)


def aliases():
    """Return the files that give each class name to a type."""
    found = defaultdict(list)
    for path, tree in TREES.items():
        for node in tree.body:
            if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
                name = node.targets[0].id.lstrip("_")
                if name[:1].isupper() and not name.isupper():
                    found[name].append(path)
    return found


def named():
    """Return the classes in the third column of the glossary."""
    rows = [line for line in GLOSSARY.read_text(encoding="utf-8").splitlines() if line.startswith("| ")]
    return [name for row in rows for name in re.findall(r"`(\w+)`", row.split("|")[3])]


def test_no_class_name_is_defined_twice():
    assert {name: files for name, files in classes().items() if len(files) > 1 and name not in TWICE} == {}


def test_no_type_alias_has_the_name_of_a_class():
    names = classes()
    assert {name: files for name, files in aliases().items() if name in names} == {}


def test_exceptions_are_still_needed():
    assert [name for name in TWICE if len(classes().get(name, ())) < 2] == []


def test_the_glossary_names_classes_that_exist():
    names = classes()
    assert len(named()) > 50
    assert [name for name in named() if name not in names] == []


def test_the_glossary_explains_a_term_once():
    terms = [
        term.strip()
        for line in GLOSSARY.read_text(encoding="utf-8").splitlines()
        if line.startswith("| ") and not line.startswith(("| ---", "| term |"))
        for term in line.split("|")[1].split(",")
    ]
    assert sorted(set(terms)) == sorted(terms)
