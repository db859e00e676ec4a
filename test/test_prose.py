"""Wording of pages, docstrings, messages and names of tests: rules of style that a program can check, and lengths."""

import ast
import re
from functools import lru_cache
from typing import Any, Dict, Iterator, List

import pytest
from parsed_sources import NODES, ROOT

pytestmark = [pytest.mark.docs, pytest.mark.nightly]

DOCS = ROOT / "docs"
PAGES = {
    page.relative_to(ROOT).as_posix(): page.read_text(encoding="utf-8")
    for page in [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
    if DOCS / "_build" not in page.parents
}
CODE = re.compile(r"^```.*?^```|<!--.*?-->|`[^`\n]*`", re.DOTALL | re.MULTILINE)

MAX_WORDS_OF_PAGE = 3_500
MAX_WORDS = 72_000
"""Words of all pages together."""

UNBOUNDED = "docs/reference/predicates.md"
"""The page that is searched instead of read: its words do not count."""

OPENING = re.compile(r"(?:What|Who|Whom|Whose|Where|How|When|Which|Whether|For how long)\b")
"""Words with which a docstring does not begin."""

BANNED = re.compile(
    r"\b(?:"
    # Verbs.
    r"(?:gives?|given|gave|hands?|handed) on|(?:tells?|told) of|look(?:s|ed|ing)? at|(?:keeps?|kept) back|"
    r"lets? go|letting go|(?:is|are|was|were|be|been) woken|at work|stands? in|stood in|"
    # Nouns.
    r"what waits|what is left|who listens|one of them|such a thing|"
    # Ellipses and decoration.
    r"of which|thereof|nothing else|hardly meant|rid of|as many as|in turn"
    r")\b",
    re.IGNORECASE,
)
"""Phrases for which the style has plain words."""


def words(text: Any) -> Any:
    """Return the words of a page, which contain a letter, without code (in fences or indented)."""
    prose = re.sub(r"^```.*?^```|<!--.*?-->|^    [^\n]*", "", text, flags=re.DOTALL | re.MULTILINE)
    return re.findall(r"\S*[^\W\d_]\S*", prose)


@pytest.mark.parametrize("page", sorted(set(PAGES) - {UNBOUNDED}))
def test_page_is_short(page: Any) -> None:
    assert len(words(PAGES[page])) <= MAX_WORDS_OF_PAGE


def test_total_length_of_pages_is_limited() -> None:
    assert sum(len(words(text)) for page, text in PAGES.items() if page != UNBOUNDED) <= MAX_WORDS


@pytest.mark.parametrize("page", sorted(PAGES))
def test_page_has_no_banned_phrase(page: Any) -> None:
    assert BANNED.findall(CODE.sub("", PAGES[page])) == []


@lru_cache(maxsize=1)
def nodes_of_tests() -> Dict[str, List[ast.AST]]:
    """Return the nodes of the syntax tree of each file of the tests."""
    return {
        path.relative_to(ROOT).as_posix(): list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
        for path in sorted((ROOT / "test").rglob("*.py"))
    }


def docstrings() -> Iterator[Any]:
    """Yield the file and line, and the docstring, of each module, class and function of package and tests."""
    for path, nodes in [*NODES.items(), *nodes_of_tests().items()]:
        for node in nodes:
            if isinstance(node, (ast.FunctionDef, ast.ClassDef, ast.Module)):
                text = ast.get_docstring(node)
                if text:
                    yield f"{path}:{getattr(node, 'lineno', 1)}", text


def test_docstrings_begin_with_no_question_word() -> None:
    assert [place for place, text in docstrings() if OPENING.match(text)] == []


def test_docstrings_have_no_banned_phrase() -> None:
    assert [place for place, text in docstrings() if BANNED.search(text)] == []


BANNED_NAME = re.compile(
    r"test_(?:what|whatever|who|how|where|that|when|which|whether|an?|the)_|"
    r"\w*_(?:said|told|comes?|goes|made|nobody|somebody)(?:_|$)"
)
"""Names of tests that are questions or sentences of everyday language."""


def test_names_of_tests_have_no_banned_word() -> None:
    names = {
        node.name
        for nodes in nodes_of_tests().values()
        for node in nodes
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
    }
    assert len(names) > 2_000
    assert [name for name in sorted(names) if BANNED_NAME.match(name)] == []


def test_messages_and_help_have_no_banned_phrase() -> None:
    texts = (
        (f"{path}:{node.lineno}", node.value)
        for path, nodes in NODES.items()
        for node in nodes
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value
    )
    assert [place for place, text in texts if BANNED.search(text)] == []
