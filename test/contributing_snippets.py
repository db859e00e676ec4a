"""Snippets of ``CONTRIBUTING.md``: the code of an extension, each with its place in the source tree."""

import re
import textwrap
from pathlib import Path
from typing import Dict, List, NamedTuple, Optional

ROOT = Path(__file__).resolve().parent.parent
PAGE = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
SECTION = re.compile(r"^### ([^\n]*)\n(.*?)(?=^##)", re.MULTILINE | re.DOTALL)
SNIPPET = re.compile(r"^  ```\w+\n(.*?)^  ```\n", re.MULTILINE | re.DOTALL)
HEADER = re.compile(r"(?:# )?(\S+), (?:(after|before): (.+)|at the end|a new file)")


class Snippet(NamedTuple):
    """A snippet of the page.

    Attributes:
        path: path of its file in the source tree.
        place: the first line of the snippet.
        relation: "after" or "before" the line that begins with ``neighbour``; None for a place that is the end.
        neighbour: beginning of a line.
        text: text that is added.
    """

    path: str
    place: str
    relation: Optional[str]
    neighbour: Optional[str]
    text: str

    def find_line(self, lines: List[str]) -> int:
        """Return the index of the line before or after which the text is added.

        Raises:
            ValueError: if no line, or more than one, begins with the text that the place names.
        """
        (position,) = (
            number for number, line in enumerate(lines) if line.lstrip().startswith(self.neighbour or "")
        )
        return position

    def add_to(self, tree: Path) -> None:
        """Add the text at its place in a source tree."""
        path = tree / self.path
        if self.place.endswith(", a new file"):
            with path.open("x", encoding="utf-8") as file:
                file.write(self.text)
            return
        lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
        position, indent = len(lines), ""
        if self.relation is not None:
            position = self.find_line(lines)
            indent = lines[position][: -len(lines[position].lstrip())]
            position += self.relation == "after"
        lines.insert(position, textwrap.indent(self.text, indent))
        path.write_text("".join(lines), encoding="utf-8")


def snippets_by_section() -> Dict[str, List[Snippet]]:
    """Return the snippets below each heading of the third level."""
    snippets: Dict[str, List[Snippet]] = {}
    for title, body in SECTION.findall(PAGE):
        for block in SNIPPET.findall(body):
            place, _, text = textwrap.dedent(block).partition("\n")
            header = HEADER.fullmatch(place)
            assert header, place
            path, relation, neighbour = header.groups()
            snippets.setdefault(title, []).append(Snippet(path, place, relation, neighbour, text))
    return snippets


SNIPPETS = snippets_by_section()
