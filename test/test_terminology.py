"""Terminology: unique class names, and the glossary that explains them."""

import ast
import re
from collections import defaultdict
from functools import lru_cache
from typing import Any, List

from parsed_sources import NODES, ROOT, TREES

GLOSSARY = ROOT / "docs" / "reference" / "glossary.md"

# Class names that are defined more than once, each with the reason.
REPEATED: "dict[str, str]" = {}


@lru_cache(maxsize=None)
def classes() -> Any:
    """Return the files that define each class, by its name without a leading underscore."""
    paths_by_class = defaultdict(list)
    for path, nodes in NODES.items():
        for node in nodes:
            if isinstance(node, ast.ClassDef):
                paths_by_class[node.name.lstrip("_")].append(path)
    return dict(paths_by_class)


def aliases() -> Any:
    """Return the files that define each type alias, by its name."""
    paths_by_alias = defaultdict(list)
    for path, tree in TREES.items():
        for node in tree.body:
            if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
                name = node.targets[0].id.lstrip("_")
                if name[:1].isupper() and not name.isupper():
                    paths_by_alias[name].append(path)
    return paths_by_alias


def glossary_classes() -> List[Any]:
    """Return the classes in the third column of the glossary."""
    rows = [line for line in GLOSSARY.read_text(encoding="utf-8").splitlines() if line.startswith("| ")]
    return [name for row in rows for name in re.findall(r"`(\w+)`", row.split("|")[3])]


def test_class_names_are_unique() -> None:
    assert {name: files for name, files in classes().items() if len(files) > 1 and name not in REPEATED} == {}


def test_no_alias_has_name_of_class() -> None:
    names = classes()
    assert {name: files for name, files in aliases().items() if name in names} == {}


def test_repeated_names_exist() -> None:
    assert [name for name in REPEATED if len(classes().get(name, ())) < 2] == []


def test_classes_of_glossary_exist() -> None:
    names = classes()
    assert len(glossary_classes()) > 50
    assert [name for name in glossary_classes() if name not in names] == []


def test_terms_of_glossary_are_unique() -> None:
    terms = [
        term.strip()
        for line in GLOSSARY.read_text(encoding="utf-8").splitlines()
        if line.startswith("| ") and not line.startswith(("| ---", "| term |"))
        for term in line.split("|")[1].split(",")
    ]
    assert len(terms) > 50
    assert sorted(set(terms)) == sorted(terms)
