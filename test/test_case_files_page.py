"""The tables of ``docs/reference/test-files.md``, and the JSON Schema, which docs/case_file_tables.py writes."""

import re

import pytest
from parsed_sources import ROOT
from script_modules import load_script

pytestmark = pytest.mark.docs
tables = load_script(ROOT / "docs" / "case_file_tables.py")


def test_page_has_keys_of_reader() -> None:
    text = tables.PAGE.read_text(encoding="utf-8")
    assert tables.make_page(text) == text, "run docs/case_file_tables.py"
    assert set(re.findall(r"<!-- keys: (\w+) -->", text)) == set(tables.TABLES)


def test_file_has_schema_of_reader() -> None:
    assert tables.SCHEMA.read_text(encoding="utf-8") == tables.make_schema_text(), (
        "run docs/case_file_tables.py"
    )
