"""Search of the documentation site in a browser: guides are found by words of their task, and hits have excerpts."""

import re
from typing import Any, Iterator
from urllib.parse import quote

import pytest
from built_site import COOKBOOK, DOCS, NEEDS_SITE, SITE

pytestmark = NEEDS_SITE

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


EXCERPTS = """
    [...document.querySelectorAll("ul.search > li")].map(hit => ({
      title: hit.querySelector("a").innerText,
      excerpt: hit.querySelector("p.context")?.innerText || "",
      marked: [...hit.querySelectorAll("p.context mark")].map(mark => mark.innerText.toLowerCase()),
    }))
"""
MAX_EXCERPT_LETTERS = 260


def search(browser: Any, query: str) -> None:
    """Open the hits of a query."""
    browser.open(f"{SITE.as_uri()}/search.html?q={quote(query)}")
    browser.wait_for(SEARCH_IS_FINISHED.format(query=repr(query)))


def queries() -> Iterator[Any]:
    """Yield words that people search for, with the guide that they look for: its heading, and its first words."""
    table = (DOCS / "how-to" / "index.md").read_text(encoding="utf-8")
    for words, title, guide in GUIDE_ROW.findall(table):
        yield title, guide
        yield words.split(", ")[0], guide
    yield "a picture's time", "transform-at-time"


@pytest.mark.parametrize(("query", "guide"), list(queries()))
def test_guide_is_among_first_hits(browser: Any, query: Any, guide: Any) -> None:
    search(browser, query)
    pages = list(dict.fromkeys(browser.ask(FOUND_PAGES)))
    assert f"how-to/{guide}.html" in pages[:MAX_HITS]


def test_programs_of_cookbook_are_found(browser: Any) -> None:
    for program in ("debounce", "docking", "slip"):
        assert (COOKBOOK / program).is_dir()
        search(browser, program)
        assert f"cookbook/{program}/README.html" in browser.ask(FOUND_PAGES)


def test_hits_have_excerpts_with_searched_words(browser: Any) -> None:
    search(browser, "heartbeats of robots")
    hits = browser.ask(EXCERPTS)
    assert len(hits) > MAX_HITS
    for hit in hits:
        assert 0 < len(hit["excerpt"]) <= MAX_EXCERPT_LETTERS, hit
        assert all(word.startswith(("heartbeat", "robot")) for word in hit["marked"]), hit
    # The title alone may have a word, but most hits are found by their text.
    assert sum(bool(hit["marked"]) for hit in hits) > len(hits) / 2
    assert {word.rstrip("s") for word in hits[0]["marked"]} == {"heartbeat", "robot"}


def test_excerpt_is_from_section_of_hit(browser: Any) -> None:
    search(browser, "The instant of a match")
    hits = [hit for hit in browser.ask(EXCERPTS) if "The instant of a match" in hit["title"]]
    assert any("has the interval of its parts" in hit["excerpt"] for hit in hits)


def test_excerpts_show_markup_as_text(browser: Any) -> None:
    search(browser, "publish_subscribe")
    excerpts = [hit["excerpt"] for hit in browser.ask(EXCERPTS)]
    assert any("<publish_subscribe>" in excerpt for excerpt in excerpts)


def test_page_marks_words_of_last_search(browser: Any) -> None:
    # The words are also those of titles of the theme's icons, which a browser cannot mark.
    search(browser, "light mode")
    browser.open(f"{SITE.as_uri()}/how-to/count-changes.html")
    browser.wait_for("document.querySelectorAll('article span.highlighted').length")
    marked = browser.ask(
        "[...document.querySelectorAll('article span.highlighted')].map(word => word.innerText)"
    )
    assert {word.lower() for word in marked} == {"mode"}


def test_comments_of_pages_are_not_searched() -> None:
    page = (DOCS / "reference" / "situations.md").read_text(encoding="utf-8")
    texts = (SITE / "_static" / "search_texts.js").read_text(encoding="utf-8")
    assert "hysteresis threshold noise noisy schmitt" in page
    assert "schmitt" not in texts
    assert "switch at two limits without flicker" in texts
