"""Command ``help``: a search by words over situations, the sections of the pages, programs, and the predicates.

An entry scores for each word of the search that it has: more in its title than in its keywords and its text, and more
the fewer entries have the word (inverse document frequency, see Manning, Raghavan and Schuetze, Introduction to
Information Retrieval, chapter 6). Words are compared by their stems, so that other forms of a word are found.
"""

import argparse
import posixpath
import re
import textwrap
from collections import Counter
from difflib import get_close_matches
from math import log
from pathlib import Path
from typing import Callable, Dict, FrozenSet, Iterable, Iterator, List, NamedTuple, Optional, Tuple

from ..foundation.errors import UsageError
from ..foundation.output_files import print_json

MAX_MATCHES = 10
"""Maximum number of entries that are printed for a search."""

MIN_RELATIVE_SCORE = 0.15
"""Minimum score of a printed entry, as a fraction of the best score."""

USAGE = """\
retalis help WORD ... searches situations, pages, programs and predicates, best matches first.
The order and the endings of the words do not matter. For example:

  retalis help missing message
  retalis help battery low
  retalis help count in the last hour

All situations are in docs/reference/situations.md. For the options of a command,
see retalis COMMAND --help; for predicates, the goal help(NAME) of retalis console."""

JSON_HELP = """\
With --json each match is one line:
{"title": TEXT, "kind": KIND, "excerpt": TEXT, "example": TEXT or null, "page": PATH}.
KIND is "situation", "section", "program" or "predicate".
"""

_FOLDERS = ("how-to", "tutorials", "reference", "explanation")
"""Folders of the searched pages, below ``docs``."""

_COOKBOOK = "examples/cookbook"
"""Folder of the searched programs, beside ``docs``."""

_SITUATIONS_PAGE = "reference/situations.md"
"""Page with the situations, which are stated there only."""

_SITUATION_ROW = re.compile(
    r"^\| ([^|\n]+) \| \[([^|\n]+)\]\(([^()|\n]+)\) \| `([^`|\n]+)` <!-- ([^|\n]+) --> \|$", re.MULTILINE
)
"""Row of a table of situations: need, solution, link to the page that explains it, example, and keywords."""

_MAX_SECTION_WORDS = 60
"""Number of words of a section that are searched."""

_TITLE_WEIGHT, _KEYWORD_WEIGHT, _TEXT_WEIGHT = 3.0, 2.0, 1.0
_SITUATION_FACTOR, _GUIDE_FACTOR, _PREDICATE_FACTOR = 1.5, 1.2, 0.7
"""Factors of the scores of situations, of how-to guides and programs, which show what to do, and of the many
predicates."""

_PROGRAM_ROW = re.compile(r"^\| \[(\w+)\]\((\w+/README\.md)\) \| (.+) \|$", re.MULTILINE)
"""Row of the cookbook's table: the name of a program, its page, and the situation that it detects."""

_LINK = re.compile(r"\[([^\[\]]*)\]\([^()]*\)")

_STOP_WORDS = frozenset(
    (
        "a",
        "an",
        "and",
        "are",
        "be",
        "for",
        "from",
        "i",
        "in",
        "is",
        "it",
        "of",
        "on",
        "or",
        "the",
        "to",
        "want",
        "with",
    )
)
"""Words that are ignored in a search, unless it has no others."""

_SUFFIXES = (
    "ations",
    "ation",
    "ating",
    "ated",
    "ates",
    "ate",
    "ings",
    "ing",
    "ies",
    "ied",
    "ed",
    "es",
    "er",
    "s",
    "e",
    "y",
)
"""Suffixes that are removed from a word to obtain its stem; a suffix stands before its own endings."""

_MIN_STEM_LETTERS = 3
"""Minimum number of letters of a stem."""

MAX_SUGGESTIONS = 5
"""Maximum number of similar words that are suggested if nothing matches."""


def split_words(text: str) -> List[str]:
    """Return the words of a text in lower case, without duplicates."""
    return list(dict.fromkeys(re.findall(r"[a-z][a-z0-9_+]*", text.lower())))


def stem_word(word: str) -> str:
    """Return a word without its suffix and without a doubled last letter, so that forms of a word agree.

    >>> [stem_word(word) for word in ("stop", "stopped", "stopping", "retries", "retry", "rate", "rates")]
    ['stop', 'stop', 'stop', 'retr', 'retr', 'rat', 'rat']
    """
    for suffix in _SUFFIXES:
        if word.endswith(suffix) and len(word) - len(suffix) >= _MIN_STEM_LETTERS:
            word = word[: -len(suffix)]
            break
    return word[:-1] if len(word) > _MIN_STEM_LETTERS and word[-1] == word[-2] else word


_SITUATION, _SECTION, _PROGRAM, _PREDICATE = "situation", "section", "program", "predicate"
"""Kinds of entries."""

_EXCERPT_LABELS = {_SITUATION: "take", _SECTION: "text", _PROGRAM: "detects", _PREDICATE: "meaning"}
"""Labels of the printed excerpts by the kind of the entry."""

_EXCERPT_WIDTH = 69
"""Width of the printed text of a section in characters, so that its line has at most 80."""


class HelpEntry(NamedTuple):
    """An entry of the search.

    Attributes:
        kind: a situation, a section of a page, a program, or a predicate.
        title: need, heading or call.
        excerpt: operators that meet the need, first words of the section, situation that the program detects,
            or meaning of the predicate.
        example: an example; None for a section and a program.
        page: page with the details.
        keyword_stems: stems of keywords, which users have in mind.
        factor: factor of the score.
    """

    kind: str
    title: str
    excerpt: str
    example: Optional[str]
    page: str
    title_stems: FrozenSet[str]
    keyword_stems: FrozenSet[str]
    text_stems: FrozenSet[str]
    factor: float = 1.0

    def stems(self) -> FrozenSet[str]:
        """Return all stems by which the entry is found."""
        return self.title_stems | self.keyword_stems | self.text_stems

    def lines(self) -> List[str]:
        """Return the lines that are printed."""
        excerpt = self.excerpt
        if self.kind == _SECTION:
            excerpt = textwrap.shorten(excerpt, _EXCERPT_WIDTH, placeholder=" ...")
        fields = {_EXCERPT_LABELS[self.kind]: excerpt, "example": self.example, "page": self.page}
        return [self.title, *(f"  {label:<7}  {text}" for label, text in fields.items() if text)]

    def record(self) -> Dict[str, Optional[str]]:
        """Return what option ``--json`` prints."""
        return {
            "title": self.title,
            "kind": self.kind,
            "excerpt": self.excerpt,
            "example": self.example,
            "page": self.page,
        }


def _stems_of(text: str) -> FrozenSet[str]:
    return frozenset(map(stem_word, split_words(text)))


class Situation(NamedTuple):
    """A situation in the words of a user, and what solves it.

    Attributes:
        need: continues "I want to ...".
        solution: operator, predicate or command.
        example: one line: a rule, a directive (``:- ``), a goal (``?- ``) or a command (``$ ``).
        page: page that explains it.
        keywords: further words by which users search for it.
    """

    need: str
    solution: str
    example: str
    page: str
    keywords: str


def read_situations() -> List[Situation]:
    """Return the situations of the documentation; none if it is not installed."""
    folder = docs_folder()
    if folder is None:
        return []
    text = (folder / _SITUATIONS_PAGE).read_text(encoding="utf-8")
    base = posixpath.dirname(f"docs/{_SITUATIONS_PAGE}")
    return [
        Situation(need, _plain(solution), example, posixpath.normpath(f"{base}/{link}"), keywords)
        for need, solution, link, example, keywords in _SITUATION_ROW.findall(text)
    ]


def _situation_entry(situation: Situation) -> HelpEntry:
    return HelpEntry(
        kind=_SITUATION,
        title=situation.need,
        excerpt=situation.solution,
        example=situation.example,
        page=situation.page,
        title_stems=_stems_of(situation.need),
        keyword_stems=_stems_of(f"{situation.solution} {situation.keywords}"),
        text_stems=frozenset(),
        factor=_SITUATION_FACTOR,
    )


def all_entries() -> List[HelpEntry]:
    """Return the entries of situations, sections, programs and predicates.

    Raises:
        UsageError: if the documentation is not installed.
    """
    folder = docs_folder()
    if folder is None:
        raise UsageError(
            "help: the documentation is not installed: expected the folder share/retalis/docs of an installation, "
            "or docs of a clone"
        )
    entries = [_situation_entry(situation) for situation in read_situations()]
    for page in sorted(page for name in _FOLDERS for page in (folder / name).rglob("*.md")):
        name = page.relative_to(folder).as_posix()
        if page.name == "predicates.md":
            entries += _predicate_entries(name, page.read_text(encoding="utf-8"))
        elif name != _SITUATIONS_PAGE and page.name != "index.md":
            entries += _section_entries(name, page.read_text(encoding="utf-8"))
    entries += _program_entries(folder.parent)
    return entries


def docs_folder() -> Optional[Path]:
    """Return the folder ``docs`` of the source tree or of the installation."""
    for root in Path(__file__).resolve().parents:
        for folder in (root / "docs", root / "share" / "retalis" / "docs"):
            if (folder / "how-to").is_dir():
                return folder
    return None


def _section_entries(page: str, text: str) -> Iterator[HelpEntry]:
    factor = _GUIDE_FACTOR if page.startswith("how-to/") else 1.0
    page_title = ""
    for heading, body in _sections(text):
        page_title = page_title or heading
        title = heading if heading == page_title else f"{page_title}: {heading}"
        words = " ".join(_plain(body).split()[:_MAX_SECTION_WORDS])
        yield HelpEntry(
            kind=_SECTION,
            title=title,
            excerpt=words,
            example=None,
            page=f"docs/{page}",
            title_stems=_stems_of(title),
            keyword_stems=frozenset(),
            text_stems=_stems_of(words),
            factor=factor,
        )


def _program_entries(root: Path) -> Iterator[HelpEntry]:
    """Yield an entry for each program of the cookbook, if the cookbook is below a folder."""
    cookbook = root / _COOKBOOK
    index = cookbook / "README.md"
    if not index.is_file():
        return
    for name, page, situation in _PROGRAM_ROW.findall(index.read_text(encoding="utf-8")):
        text = (cookbook / page).read_text(encoding="utf-8")
        heading = text.partition("\n")[0].lstrip("# ")
        words = " ".join(body for _, body in _sections(text))
        yield HelpEntry(
            kind=_PROGRAM,
            title=f"Program {name}",
            excerpt=situation,
            example=None,
            page=f"{_COOKBOOK}/{page}",
            title_stems=_stems_of(f"{name} {heading}".replace("_", " ")),
            keyword_stems=_stems_of(situation),
            text_stems=_stems_of(" ".join(_plain(words).split()[:_MAX_SECTION_WORDS])),
            factor=_GUIDE_FACTOR,
        )


def _sections(text: str) -> Iterator[Tuple[str, str]]:
    """Yield the heading and the text of each section of a page, without code blocks and comments."""
    heading, body, is_code = "", "", False
    for line in text.splitlines():
        if line.startswith("```"):
            is_code = not is_code
        elif is_code or line.startswith("<!--"):
            continue
        elif line.startswith("#"):
            if heading:
                yield heading, body
            heading, body = _plain(line.lstrip("# ")), ""
        else:
            body += f"{line}\n"
    if heading:
        yield heading, body


def _predicate_entries(page: str, text: str) -> Iterator[HelpEntry]:
    """Yield an entry for each row of a table: indicators, call, meaning, errors, example, answer."""
    for line in text.splitlines():
        # A vertical bar inside a cell is escaped, and replaced by a zero byte while the row is split.
        cells = [_plain(cell.replace("\0", "|")) for cell in line.replace("\\|", "\0").split("|")[1:-1]]
        if len(cells) >= 5 and cells[0].partition("/")[2][:1].isdigit():
            yield HelpEntry(
                kind=_PREDICATE,
                title=cells[1],
                excerpt=cells[2],
                example=f"?- {cells[4]}.",
                page=f"docs/{page}",
                title_stems=_stems_of(cells[0].replace("_", " ")),
                keyword_stems=frozenset((stem_word(cells[0].partition("/")[0]),)),
                text_stems=_stems_of(cells[2]),
                factor=_PREDICATE_FACTOR,
            )


def _plain(text: str) -> str:
    """Return a text without links and code marks."""
    return _LINK.sub(r"\1", text).replace("`", "").strip()


def search(text: str, entries: Iterable[HelpEntry]) -> List[HelpEntry]:
    """Return the entries that fit a text best, best first."""
    entries = list(entries)
    stems = _searched_stems(text)
    if _STOP_WORDS.issuperset(split_words(text)):
        # Stop words alone mean operators, such as `and`: the pattern of a situation has them.
        entries = [entry for entry in entries if entry.kind == _SITUATION]
        entries = [
            entry for entry in entries if stems.intersection(map(stem_word, split_words(entry.excerpt)))
        ]
    frequencies: Dict[str, int] = Counter(
        stem for entry in entries for stem in entry.stems().intersection(stems)
    )
    rarity = {stem: log(1 + len(entries) / count) for stem, count in frequencies.items()}
    scores = [(_score(entry, rarity), entry) for entry in entries]
    best = max((score for score, _ in scores), default=0.0)
    # `sorted` is stable: situations precede pages with the same score.
    ranked = sorted((pair for pair in scores if pair[0] > 0), key=lambda pair: -pair[0])
    return [entry for score, entry in ranked if score >= MIN_RELATIVE_SCORE * best][:MAX_MATCHES]


def _searched_stems(text: str) -> FrozenSet[str]:
    """Return the stems of the words of a search without stop words, or of all words if there are no others."""
    words = split_words(text)
    # `and` is an operator as well as a stop word.
    return frozenset(stem_word(word) for word in words if word not in _STOP_WORDS) or frozenset(
        map(stem_word, words)
    )


def _score(entry: HelpEntry, rarity: Dict[str, float]) -> float:
    """Return the score of an entry for the stems of a search with their rarity."""
    score, match_count = 0.0, 0
    for stem, weight in rarity.items():
        for stems, factor in (
            (entry.title_stems, _TITLE_WEIGHT),
            (entry.keyword_stems, _KEYWORD_WEIGHT),
            (entry.text_stems, _TEXT_WEIGHT),
        ):
            if stem in stems:
                score += weight * factor
                match_count += 1
                break
    # An entry with all words precedes one that has a single rare word.
    return score * entry.factor * match_count / max(1, len(rarity))


def suggest_words(text: str) -> List[str]:
    """Return words of situations that are similar to those of a text."""
    words = sorted(
        {
            word
            for situation in read_situations()
            for word in split_words(f"{situation.need} {situation.keywords}")
        }
    )
    suggestions = [
        match for word in split_words(text) for match in get_close_matches(word, words, n=3, cutoff=0.7)
    ]
    return list(dict.fromkeys(suggestions))[:MAX_SUGGESTIONS]


def add_parser(add_command: Callable[..., argparse.ArgumentParser]) -> None:
    """Add the parser of command ``help``."""
    parser = add_command(
        "help",
        help="search situations, pages, programs and predicates by words",
        description="Search the situations, the sections of the documentation, the programs of the cookbook and the "
        "predicates by words, and print the best matches first, each with an example or its first words, and its "
        "page. Exit status 1 if there are none.",
        epilog=JSON_HELP,
    )
    parser.add_argument("words", nargs="*", metavar="WORD", help="words to search, such as missing message")
    parser.add_argument("--json", action="store_true", help="print one JSON object per match")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command; return its exit status."""
    text = " ".join(options.words)
    if not text.strip():
        if options.json:
            raise UsageError("help --json: expected words to search")
        print(USAGE)
        return 0
    matches = search(text, all_entries())
    if not matches:
        suggestions = suggest_words(text)
        hint = (
            f"did you mean {' or '.join(suggestions)}?" if suggestions else "see docs/reference/situations.md"
        )
        raise UsageError(f"help: nothing is found for '{text}': {hint}")
    for entry in matches:
        if options.json:
            print_json(entry.record())
        else:
            print("\n".join([*entry.lines(), ""]))
    return 0
