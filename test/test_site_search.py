"""Search of the documentation site in a browser: the words of a task lead to its guide."""

import re
from urllib.parse import quote

import pytest
from source import ROOT

DOCS = ROOT / "docs"
SITE = DOCS / "_build" / "html"
GUIDE_ROW = re.compile(r"^\| ([^|]+) \| \[([^]]+)\]\(([\w-]+)\.md\) \|$", re.MULTILINE)
MAX_HITS = 3
"""Hits in which a guide must be."""

SEARCH_IS_FINISHED = """
    new URLSearchParams(location.search).get("q") === {query} && document.querySelector("p.search-summary") &&
    !document.querySelector("#search-results").innerText.startsWith("Searching")
"""
FOUND_PAGES = """
    [...document.querySelectorAll("ul.search li > a")].map(link => link.getAttribute("href").split(/[?#]/)[0])
"""


def site_is_built():
    """Return whether ``./install.py docs`` has built the site from the present pages."""
    search = SITE / "searchindex.js"
    pages = [path for path in DOCS.rglob("*.md") if DOCS / "_build" not in path.parents]
    return search.exists() and search.stat().st_mtime > max(page.stat().st_mtime for page in pages)


pytestmark = [
    pytest.mark.docs,
    pytest.mark.slow,
    pytest.mark.skipif(
        not site_is_built(), reason="the site is not built from the present pages (./install.py docs)"
    ),
]


def queries():
    """Yield words that people search for, with the guide that they look for: its heading, and its first words."""
    table = (DOCS / "how-to" / "index.md").read_text(encoding="utf-8")
    for words, title, guide in GUIDE_ROW.findall(table):
        yield title, guide
        yield words.split(", ")[0], guide
    yield "a picture's time", "transform-at-time"


@pytest.mark.parametrize(("query", "guide"), list(queries()))
def test_a_guide_is_among_the_first_hits(browser, query, guide):
    browser.open(f"{SITE.as_uri()}/search.html?q={quote(query)}")
    browser.wait_for(SEARCH_IS_FINISHED.format(query=repr(query)))
    pages = list(dict.fromkeys(browser.ask(FOUND_PAGES)))
    assert f"how-to/{guide}.html" in pages[:MAX_HITS]
