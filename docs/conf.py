"""Configuration of Sphinx for the documentation site; ``./install.py docs`` builds the site.

The pages are plain Markdown that can be read without Sphinx. This file therefore adds three things that would need
markup of MyST in the pages:

* The contents of a section are the pages that its ``index.md`` links to, in the order of their first links.
* The words that ``how-to/index.md`` lists for a guide are index entries of the guide, which the search ranks first.
* A link to a file of the repository that is not a page of the site is a download.
"""

import os
import re
import sys
import zlib
from pathlib import Path
from typing import Any, List, Optional
from xml.etree import ElementTree

from pygments.lexers.prolog import PrologLexer
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.transforms import SphinxTransform
from sphinx.util import logging

DOCS = Path(__file__).resolve().parent

sys.path.insert(0, str(DOCS.parent / "src"))

project = "retalis"
author = "retalis contributors"
release = version = str(ElementTree.parse(DOCS.parent / "package.xml").getroot().findtext("version"))

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton"]
exclude_patterns = ["_build"]
nitpicky = True
# Annotations name types of Python and of private modules, which have no page.
nitpick_ignore_regex = [("py:.*", ".*")]
autodoc_member_order = "bysource"
# The section Attributes of a docstring describes the attributes; each has no entry of its own.
napoleon_use_ivar = True

myst_heading_anchors = 4

# A search for "picture's" finds only the straight apostrophe.
smartquotes = False

html_theme = "furo"
html_title = f"retalis {release}"
# The site is a part of the wheel: leave out copies of the pages' sources.
html_copy_source = False
html_show_sourcelink = False
html_show_copyright = False
# A browser refuses to read summaries of search results from files.
html_show_search_summary = False
html_static_path = ["site.css"]
html_css_files = ["site.css"]

# Copy the commands of a console block without their prompts and their output.
copybutton_prompt_text = r"\$ |\?- |>>> |\.\.\. "
copybutton_prompt_is_regexp = True

OWN_LANGUAGES = ("goals", "outputs", "stream")
"""Languages of code blocks that the tests of the pages distinguish; all of them contain Prolog terms."""

LINK = re.compile(r"\]\((?!https?:)([^)#\s]+\.md)")
"""Link to a page in Markdown, with the path of the page."""


GUIDES = DOCS / "how-to" / "index.md"
"""Page with a table of the guides: words that people search for, and the guide."""

GUIDE_ROW = re.compile(r"^\| ([^|]+) \| \[[^]]+\]\(([\w-]+)\.md\) \|$", re.MULTILINE)


REMOTE = re.compile(
    r"""<(?:script|img|iframe)\b[^>]*\bsrc=["']?(?:https?:)?//|<link\b[^>]*\bhref=["']?(?:https?:)?//"""
    r"""|(?:url\(|@import)\s*["']?(?:https?:)?//"""
)
"""Reference of a page or a style sheet that makes a browser load a file from the network."""

MAX_SITE_BYTES = 5_000_000

logger = logging.getLogger(__name__)


def linked_pages(text: str, folder: Path) -> List[str]:
    """Return the pages of a section in the order of their first links.

    Args:
        text: Text of the section's index page.
        folder: Folder of the section, relative to the folder of the documentation.

    Returns:
        Paths relative to `folder`, without suffix: the pages of the folder itself, and the index pages (``index`` or
        ``README``) of the folders in it.
    """
    pages = []
    for link in LINK.findall(text):
        path = os.path.normpath(link)
        is_page = "/" not in path and path != "index.md"
        is_section = (
            path.count("/") == 1 and not path.startswith("..") and path.endswith(("/index.md", "/README.md"))
        )
        if (is_page or is_section) and (DOCS / folder / path).exists():
            pages.append(path[: -len(".md")])
    return list(dict.fromkeys(pages))


def add_contents(app: Sphinx, name: str, source: List[str]) -> None:
    """Append the table of contents to the text of an index page.

    Args:
        app: Running Sphinx.
        name: Name of the page: its path relative to the folder of the documentation, without suffix.
        source: List of one element, the text of the page.
    """
    path = Path(name)
    if path.name != "index":
        return
    pages = linked_pages(source[0], path.parent)
    source[0] += "\n".join(["", "```{toctree}", ":hidden:", ":maxdepth: 1", "", *pages, "```", ""])


def add_search_words(app: Sphinx, name: str, source: List[str]) -> None:
    """Add the words for a guide to its text as main index entries, after its heading.

    Args:
        app: Running Sphinx.
        name: Name of the page: its path relative to the folder of the documentation, without suffix.
        source: List of one element, the text of the page.
    """
    folder, _, guide = name.rpartition("/")
    if folder != GUIDES.parent.name or guide == GUIDES.stem:
        return
    words = {row[2]: row[1] for row in GUIDE_ROW.finditer(GUIDES.read_text(encoding="utf-8"))}.get(guide)
    if words is None:
        logger.warning("%s has no row for the guide '%s': expected words for the search", GUIDES, guide)
        return
    heading, _, text = source[0].partition("\n")
    entries = ", ".join(f"! {word}" for word in words.split(", "))
    source[0] = f"{heading}\n\n```{{index}} {entries}\n```\n{text}"


class DownloadOtherFiles(SphinxTransform):
    """Replaces links to files of the repository outside of the site by downloads of these files.

    It runs before Sphinx collects the downloads of a page.
    """

    default_priority = 5

    def apply(self, **options: Any) -> None:
        """Replace the links of a page."""
        for link in list(self.document.findall(addnodes.pending_xref)):
            # MyST takes any file in Markdown for a page; the name of one outside of the site is an absolute path.
            file = (DOCS / f"{link.get('reftarget')}.md").resolve()
            if link.get("refdomain") == "doc" and DOCS not in file.parents:
                path = os.path.relpath(str(file), str(DOCS / self.env.docname / ".."))
                link.replace_self(addnodes.download_reference("", "", *link.children, reftarget=path))


def skip_field(
    app: Sphinx, kind: str, name: str, member: object, skip: bool, options: object
) -> Optional[bool]:
    """Return True for a field of a named tuple, whose class describes it, and None for any other member.

    Args:
        app: Running Sphinx.
        kind: Kind of the object that has the member.
        name: Name of the member.
        member: The member.
        skip: Whether Sphinx would leave it out.
        options: Options of the directive.
    """
    return True if str(getattr(member, "__doc__", "")).startswith("Alias for field number") else None


def check_site(app: Sphinx, error: Optional[Exception]) -> None:
    """Warn if the site needs the network, or is too large for the wheel.

    Args:
        app: Sphinx after the build.
        error: Exception that has ended the build, or None.
    """
    if error is not None or app.builder.name != "html":
        return
    site = Path(app.outdir)
    for path in sorted(site.rglob("*")):
        if path.suffix in (".html", ".css") and REMOTE.search(path.read_text(encoding="utf-8")):
            logger.warning("%s loads a file from the network: expected only files of the site", path)
    size = sum(len(zlib.compress(path.read_bytes())) for path in site.rglob("*") if path.is_file())
    if size > MAX_SITE_BYTES:
        logger.warning("the compressed site has %d bytes: expected at most %d", size, MAX_SITE_BYTES)


def setup(app: Sphinx) -> None:
    """Register the additions of this file with Sphinx."""
    app.connect("source-read", add_contents)
    app.connect("source-read", add_search_words)
    app.connect("autodoc-skip-member", skip_field)
    app.connect("build-finished", check_site)
    app.add_transform(DownloadOtherFiles)
    for language in OWN_LANGUAGES:
        app.add_lexer(language, PrologLexer)
