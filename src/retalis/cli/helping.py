"""What a top level says of itself and of predicates: the page of these is looked through."""

from pathlib import Path
from typing import Iterable, Iterator, List, NamedTuple

from ..foundation import UsageError

PAGE = "docs/predicates.md"
MOST = 50
"""Lines of an answer."""

CONSOLE = """\
GOAL.                 ask a goal; ";" asks for another solution, return for none
[FILE].               load a file or a program's folder; again, it replaces what it said before
make.                 load again all files that have changed
[user].               read clauses and rules that are typed, up to end_of_file.
event(E).             take an event that happens now; event(E,[T1,T2]) one with an interval
trace(GOAL).          show the ports that a goal passes; trace. and notrace. for all goals
help(NAME).           what a predicate does, as help(append) or help('append/3')
apropos(WORD).        the predicates with a word in their name or description
ctrl-C                end a goal
quit.                 end the console; so do exit., halt. and ctrl-D"""


class _Described(NamedTuple):
    """Predicates of one row of the page: their indicators, how they are called, what they do."""

    keys: List[str]
    call: str
    what: str


def described(name: str, defined: Iterable[str]) -> List[str]:
    """Return what is to be said of predicates of a name, or an indicator as ``append/3``.

    Args:
        name: of the predicates.
        defined: the indicators of all that there are, those of the program too.
    """
    rows = [row for row in _rows() if any(_is_of(name, key) for key in row.keys)]
    lines = [f"{row.call}\n    {row.what}" for row in rows]
    known = {key for row in rows for key in row.keys}
    return [*lines, *(key for key in sorted(defined) if _is_of(name, key) and key not in known)][:MOST]


def mentioned(word: str, defined: Iterable[str]) -> List[str]:
    """Return a line for each predicate with a word in its name or description; see `described`."""
    low, known, lines = word.lower(), set(), []
    for row in _rows():
        if low in row.what.lower() or any(low in key.lower() for key in row.keys):
            known.update(row.keys)
            lines.append(f"{', '.join(row.keys)}: {row.what}")
    own = [key for key in sorted(defined) if low in key.lower() and key not in known and key[0] != "$"]
    lines += own
    return lines if len(lines) <= MOST else [*lines[:MOST], f"% and {len(lines) - MOST} more"]


def _is_of(name: str, key: str) -> bool:
    return name in (key, key.rpartition("/")[0])


def _rows() -> Iterator[_Described]:
    for line in _page().read_text(encoding="utf-8").split("\n"):
        if line.startswith("| ``"):
            cells = [cell.replace("\0", "|") for cell in line.replace("\\|", "\0").split(" | ")]
            keys = [key.strip() for key in cells[0].split("``")[1::2]]
            yield _Described(keys, cells[1].replace("``", "").strip(), cells[2].strip())


def _page() -> Path:
    """Return the page of predicates: in the source tree, or where the package is installed.

    Raises:
        UsageError: where it is in neither.
    """
    for root in Path(__file__).resolve().parents:
        for place in (root / PAGE, root / "share" / "retalis" / PAGE):
            if place.is_file():
                return place
    raise UsageError(f"{PAGE} is neither in the source tree nor in an installed package")
