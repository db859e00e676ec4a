#!/usr/bin/env python3
"""Write docs/reference/situations.md from the list that ``retalis help`` searches."""

import sys
from pathlib import Path

DOCS = Path(__file__).resolve().parent
sys.path.insert(0, str(DOCS.parent / "src"))

from retalis.cli.situations import page_text  # noqa: E402

PAGE = DOCS / "reference" / "situations.md"

if __name__ == "__main__":
    PAGE.write_text(page_text(), encoding="utf-8")
