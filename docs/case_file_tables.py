#!/usr/bin/env python3
"""Write the tables of docs/reference/test-files.md and the JSON Schema from the keys that the reader accepts.

docs/case_file_tables.py    # writes the tables of the page, and docs/editors/retalis-test.schema.json
"""

import json
import re
import sys
from pathlib import Path
from typing import Mapping

DOCS = Path(__file__).resolve().parent
sys.path.insert(0, str(DOCS.parent / "src"))

from retalis.testing import case_file  # noqa: E402
from retalis.testing.case_file import MappingKey, make_json_schema  # noqa: E402

PAGE = DOCS / "reference" / "test-files.md"
SCHEMA = DOCS / "editors" / "retalis-test.schema.json"

TABLES = {
    "case": case_file.CASE_KEYS,
    "input": case_file.INPUT_KEYS,
    "service": case_file.SERVICE_KEYS,
    "expectations": case_file.EXPECTATION_KEYS,
    "relations": case_file.RELATION_KEYS,
    "item": case_file.ITEM_KEYS,
    "answer": case_file.ANSWER_KEYS,
    "tolerance": case_file.TOLERANCE_KEYS,
    "count": case_file.COUNT_KEYS,
}
"""Tables by the name in the page's comment ``<!-- keys: NAME -->``."""


def make_page(text: str) -> str:
    """Return the text of the page with its tables written anew."""

    def replace_table(match: "re.Match[str]") -> str:
        return f"{match[1]}{_make_table(TABLES[match[2]])}"

    return re.sub(r"(<!-- keys: (\w+) -->\n)(?:\|.*\n)*", replace_table, text)


def make_schema_text() -> str:
    """Return the text of the file with the JSON Schema."""
    return json.dumps(make_json_schema(), indent=2) + "\n"


def _make_table(keys: Mapping[str, MappingKey]) -> str:
    rows = [f"| `{name}` | {key.description} |" for name, key in keys.items()]
    return "\n".join(("| key | value |", "| --- | --- |", *rows, ""))


if __name__ == "__main__":
    PAGE.write_text(make_page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    SCHEMA.write_text(make_schema_text(), encoding="utf-8")
