"""Configuration of Sphinx for the documentation site; ``./install.py docs`` builds the site.

The pages are plain Markdown that can be read without Sphinx. This file therefore adds what would need markup of MyST
in the pages:

* The contents of a section are the pages that its ``index.md`` links to, in the order of their first links.
* The words that ``how-to/index.md`` lists for a guide are index entries of the guide, which the search ranks first.
* The comment ``<!-- rules.txt -->`` before a code block is the block's caption.
* The pages of ``examples/cookbook`` are pages of the site, by a symbolic link, and end with all files of a program.
* A link to a file of the repository that is not a page of the site is a download.
* ``search_texts.js`` has the texts of all sections, from which ``search_excerpts.js`` takes the excerpts of the hits.
* If ``package.xml`` has a ``<url type="repository">``, the site links to it, and each page to its source.
"""

import json
import os
import re
import sys
import zlib
from pathlib import Path
from typing import Any, Dict, Iterator, List, Optional, Tuple
from urllib.parse import urlsplit
from xml.etree import ElementTree

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.transforms import SphinxTransform
from sphinx.util import logging

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
COOKBOOK = ROOT / "examples" / "cookbook"

sys.path[:0] = [str(ROOT / "src"), str(DOCS)]

from rule_lexer import RuleLexer  # noqa: E402 - beside this file

MANIFEST = ElementTree.parse(ROOT / "package.xml").getroot()
REPOSITORY = (MANIFEST.findtext("url[@type='repository']") or "").strip().rstrip("/")
"""Address of the repository, or an empty text if it has none."""

project = "retalis"
author = "retalis contributors"
release = version = str(MANIFEST.findtext("version"))

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
# Sphinx reads the page of each hit for its summary, which browsers refuse if the site is opened from files; see
# `write_search_texts`.
html_show_search_summary = False
html_static_path = ["site.css", "site.js", "search_excerpts.js"]
html_css_files = ["site.css"]
html_js_files = ["site.js"]

# Copy the commands of a console block without their prompts and their output.
copybutton_prompt_text = r"\$ |\?- |>>> |\.\.\. "
copybutton_prompt_is_regexp = True

RULE_LANGUAGES = ("prolog", "goals", "outputs", "stream")
"""Languages of code blocks with Prolog terms, which the tests of the pages distinguish."""

INDEX_NAMES = ("index", "README")
"""Names of the pages that list the other pages of their folders."""

LINK = re.compile(r"\]\((?!https?:)([^)#\s]+\.md)")
"""Link to a page in Markdown, with the path of the page."""

FILE_COMMENT = re.compile(r"<!-- (\S+) -->\s*")
"""Comment that names the file of the code block after it; the tests of the pages write these files."""

HTML_COMMENT = re.compile(r"<!--.*?-->")

COOKBOOK_FILES = {
    "eventRules.txt": ("prolog", "The rules."),
    "goalPredicates.txt": ("prolog", "The goals that are called at the start."),
    "pub_sub.xml": ("xml", "The topics."),
    "tests/{program}.yaml": ("yaml", "The test cases, with the expected outputs."),
    "messages.py": ("python", "The messages of a bag."),
    "node.py": ("python", "The same as a rospy node."),
}
"""Files of a cookbook program in the order of its page, with their languages and descriptions.

``{program}`` stands for the name of the program.
"""

PAGES_ELSEWHERE = {ROOT / "CONTRIBUTING.md": "contributing"}
"""Files that a page of the site includes, and the names of these pages."""

BRANCH = "main"
"""Branch of the repository to which the links to the sources lead."""

FORGES = {
    "github.com": ("blob", "edit"),
    "gitlab.com": ("-/blob", "-/edit"),
    "codeberg.org": ("src/branch", "_edit"),
}
"""Hosts of repositories, with the first parts of the paths that show and edit a file."""

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


def link_cookbook() -> None:
    """Make the cookbook a folder of the documentation, because Sphinx reads pages of one folder only."""
    link = DOCS / "cookbook"
    if not link.exists():
        link.symlink_to(os.path.relpath(COOKBOOK, DOCS))


def page_name(file: Path) -> Optional[str]:
    """Return the name of the page that shows a file of the repository, or None if the site has no such page.

    Args:
        file: Path without symbolic links.
    """
    if file in PAGES_ELSEWHERE:
        return PAGES_ELSEWHERE[file]
    if file.suffix != ".md" or not file.exists():
        return None
    for folder, section in ((DOCS, ""), (COOKBOOK, "cookbook/")):
        if folder in file.parents:
            return section + file.relative_to(folder).with_suffix("").as_posix()
    return None


def source_file(app: Sphinx, name: str) -> Path:
    """Return the file of the repository with the text of a page."""
    files = {page: file for file, page in PAGES_ELSEWHERE.items()}
    return files.get(name) or Path(app.env.doc2path(name)).resolve()


def linked_pages(text: str, folder: Path) -> List[str]:
    """Return the pages of a section in the order of their first links.

    Args:
        text: Text of the section's index page.
        folder: Folder of the section, relative to the folder of the documentation.

    Returns:
        Names of the pages of the folder itself, and of the index pages (see `INDEX_NAMES`) of the folders in it.
    """
    pages = []
    for link in LINK.findall(text):
        name = page_name((DOCS / folder / link).resolve())
        if name is None:
            continue
        page = Path(name)
        is_index = page.name in INDEX_NAMES
        if (page.parent == folder and not is_index) or (
            page.parent.parent == folder != page.parent and is_index
        ):
            pages.append(name)
    return list(dict.fromkeys(pages))


def add_contents(app: Sphinx, name: str, source: List[str]) -> None:
    """Append the table of contents to the text of an index page.

    Args:
        app: Running Sphinx.
        name: Name of the page: its path relative to the folder of the documentation, without suffix.
        source: List of one element, the text of the page.
    """
    path = Path(name)
    if path.name not in INDEX_NAMES:
        return
    entries = [f"/{page}" for page in linked_pages(source[0], path.parent)]
    if name == "index" and REPOSITORY:
        entries.append(f"Repository <{REPOSITORY}>")
    if entries:
        source[0] += "\n".join(["", "```{toctree}", ":hidden:", ":maxdepth: 1", "", *entries, "```", ""])


def add_program_files(app: Sphinx, name: str, source: List[str]) -> None:
    """Append all files of a cookbook program to its page.

    Args:
        app: Running Sphinx.
        name: Name of the page: its path relative to the folder of the documentation, without suffix.
        source: List of one element, the text of the page.
    """
    folder = source_file(app, name).parent
    if folder.parent != COOKBOOK:
        return
    path = folder.relative_to(ROOT).as_posix()
    source[0] += (
        "\n## Files\n\nTo try the program in a clone:\n\n```bash\n"
        f"python3 examples/cookbook/make_bag.py {path}\n"
        f"PYTHONPATH=src python3 -m retalis bag {path}/{folder.name}.bag --program {path}\n"
        f"PYTHONPATH=src python3 -m retalis test {path}\n```\n"
    )
    for file_pattern, (language, description) in COOKBOOK_FILES.items():
        file = file_pattern.format(program=folder.name)
        source[0] += (
            f"\n{description}\n\n```{{literalinclude}} {file}\n:language: {language}\n:caption: {file}\n```\n"
        )


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


class ResolveFileLinks(SphinxTransform):
    """Resolves links to files in Markdown that are not below the folder of the documentation.

    A link to the file of a page leads to the page. Any other file is a download. It runs before Sphinx collects the
    downloads of a page.
    """

    default_priority = 5

    def apply(self, **options: Any) -> None:
        """Replace the links of a page."""
        for link in list(self.document.findall(addnodes.pending_xref)):
            if link.get("refdomain") != "doc":
                continue
            # MyST takes any file in Markdown for a page; the name of one outside of the site is an absolute path.
            file = (DOCS / f"{link.get('reftarget')}.md").resolve()
            page = page_name(file)
            if page is not None:
                link["reftarget"] = page
            elif DOCS not in file.parents:
                path = os.path.relpath(str(file), str(DOCS / self.env.docname / ".."))
                link.replace_self(addnodes.download_reference("", "", *link.children, reftarget=path))


class CaptionCodeBlocks(SphinxTransform):
    """Shows the name of a file, which stands in a comment before a code block, as the caption of the block."""

    default_priority = 5

    def apply(self, **options: Any) -> None:
        """Replace the comments of a page."""
        for comment in list(self.document.findall(nodes.raw)):
            name = FILE_COMMENT.fullmatch(comment.astext())
            block = comment.next_node(nodes.literal_block, descend=False, siblings=True)
            position = comment.parent.index(comment) + 1
            if name is None or block is None or comment.parent.index(block) != position:
                continue
            figure = nodes.container("", literal_block=True, classes=["literal-block-wrapper"])
            comment.parent.remove(block)
            comment.replace_self(figure)
            figure += [nodes.caption("", name.group(1)), block]


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


def add_page_links(
    app: Sphinx, name: str, template: str, context: Dict[str, Any], doctree: Optional[nodes.document]
) -> None:
    """Add the links to a page's source in the repository, and the scripts of the search page.

    Args:
        app: Running Sphinx.
        name: Name of the page.
        template: Template of the page.
        context: Variables of the template.
        doctree: Content of the page, or None if Sphinx generates the page.
    """
    if name == "search":
        app.add_js_file("search_texts.js")
        app.add_js_file("search_excerpts.js")
    forge = FORGES.get(urlsplit(REPOSITORY).netloc)
    if doctree is not None and forge is not None:
        path = source_file(app, name).relative_to(ROOT).as_posix()
        view, edit = (f"{REPOSITORY}/{action}/{BRANCH}/{path}" for action in forge)
        context.update(theme_source_view_link=view, theme_source_edit_link=edit)


def section_texts(section: nodes.Element) -> Iterator[Tuple[List[str], str]]:
    """Yield the anchors and the text of a section, then those of the sections in it.

    The text has no title, because the search shows it, and no text of the sections in it.
    """
    texts = [
        # Cells of tables have comments, with words for `retalis help`.
        HTML_COMMENT.sub("", child.astext())
        for child in section.children
        if not isinstance(child, (nodes.section, nodes.title, nodes.raw))
    ]
    yield list(section.get("ids", ())), " ".join(" ".join(texts).split())
    for child in section.children:
        if isinstance(child, nodes.section):
            yield from section_texts(child)


def write_search_texts(app: Sphinx, error: Optional[Exception]) -> None:
    """Write the texts of all sections to a script, which a browser loads from files, too.

    Args:
        app: Sphinx after the build.
        error: Exception that has ended the build, or None.
    """
    if error is not None or app.builder.name != "html":
        return
    texts = {}
    for name in sorted(app.env.found_docs):
        sections = [list(pair) for part in app.env.get_doctree(name).children for pair in section_texts(part)]
        texts[name] = sections
    script = f"const SEARCH_TEXTS = {json.dumps(texts, ensure_ascii=False, separators=(',', ':'))};\n"
    (Path(app.outdir) / "_static" / "search_texts.js").write_text(script, encoding="utf-8")


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
    link_cookbook()
    app.connect("source-read", add_contents)
    app.connect("source-read", add_search_words)
    app.connect("source-read", add_program_files)
    app.connect("autodoc-skip-member", skip_field)
    app.connect("html-page-context", add_page_links)
    app.connect("build-finished", write_search_texts)
    app.connect("build-finished", check_site)
    app.add_transform(ResolveFileLinks)
    app.add_transform(CaptionCodeBlocks)
    for language in RULE_LANGUAGES:
        app.add_lexer(language, RuleLexer)
