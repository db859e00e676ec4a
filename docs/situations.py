#!/usr/bin/env python3
"""Write docs/reference/situations.md from the list that ``retalis help`` searches."""

import sys
from pathlib import Path

DOCS = Path(__file__).resolve().parent
sys.path.insert(0, str(DOCS.parent / "src"))

from retalis.cli.situation_guide import SITUATIONS  # noqa: E402

PAGE = DOCS / "reference" / "situations.md"


def page_text() -> str:
    """Return the text of ``docs/reference/situations.md``."""
    count = sum(map(len, SITUATIONS.values()))
    lines = [
        "# I want ... take ...",
        "",
        "For people who know the situation but not the operator. The command `retalis help WORD ...` "
        "searches this list, the pages and the predicates.",
        "",
        f"<!-- The {count} situations are in src/retalis/cli/situation_guide.py; "
        "docs/situations.py writes this page. -->",
    ]
    for title, section in SITUATIONS.items():
        lines += ["", f"## {title}", "", "| I want to ... | take | example |", "| --- | --- | --- |"]
        for situation in section:
            page = situation.page
            path = page[len("reference/") :] if page.startswith("reference/") else f"../{page}"
            lines.append(
                f"| {situation.need} | [{in_code_font(situation.solution)}]({path}) | `{situation.example}` |"
            )
    lines += [
        "",
        "**See also**: [the event language](language/index.md), [how-to guides](../how-to/index.md).",
    ]
    return "\n".join(lines) + "\n"


def in_code_font(take: str) -> str:
    """Return a text in code font, unless it is plain words."""
    return take if take.startswith(("a ", "an ")) else f"`{take}`"


if __name__ == "__main__":
    PAGE.write_text(page_text(), encoding="utf-8")
