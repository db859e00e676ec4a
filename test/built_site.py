"""The documentation site that ``./install.py docs`` has built, for tests that open its pages in a browser."""

from typing import Any, List

import pytest
from page_snippet_runner import ROOT

DOCS = ROOT / "docs"
SITE = DOCS / "_build" / "html"
COOKBOOK = ROOT / "examples" / "cookbook"
SOURCE_SUFFIXES = (".md", ".py", ".css", ".js", ".txt", ".xml")


def source_files() -> List[Any]:
    """Return the files that the site is built from, without the docstrings of the package."""
    files = [
        path
        for path in DOCS.rglob("*")
        if path.suffix in SOURCE_SUFFIXES and DOCS / "_build" not in path.parents
    ]
    programs = [path for path in COOKBOOK.rglob("*") if path.suffix in SOURCE_SUFFIXES]
    return [*files, *programs, ROOT / "CONTRIBUTING.md", ROOT / "package.xml"]


def site_is_built() -> Any:
    """Return whether ``./install.py docs`` has built the site from the present pages."""
    search = SITE / "searchindex.js"
    return search.exists() and search.stat().st_mtime > max(path.stat().st_mtime for path in source_files())


NEEDS_SITE = [
    pytest.mark.docs,
    pytest.mark.slow,
    pytest.mark.skipif(
        not site_is_built(), reason="the site is not built from the present pages (./install.py docs)"
    ),
]
"""Marks of the tests that open the site."""
