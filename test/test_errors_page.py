"""``docs/reference/errors.md``: each code of ``retalis check`` with an example that has this finding."""

import re
from pathlib import Path
from typing import Any

import pytest
from page_snippet_runner import FENCE, ROOT, PageRun

from retalis.events.checks.check_runner import CHECKS, LOAD_CODES

pytestmark = pytest.mark.docs

PAGE = ROOT / "docs" / "reference" / "errors.md"
SECTIONS = re.findall(
    r"^### (RT\d{4}): [^\n]*\n(.*?)(?=^##|\Z)", PAGE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE
)
ROW = re.compile(r"^\| \[`(RT\d{4})`\]\(#[\w-]+\) \| `([\w-]+)` \| ([\w ]+) \| ([^|]+) \|$", re.MULTILINE)


def test_each_code_has_row_and_section() -> None:
    rows = [
        (code, check, severity) for code, check, severity, _ in ROW.findall(PAGE.read_text(encoding="utf-8"))
    ]
    loading = {code for _, code in LOAD_CODES}
    assert rows == sorted(rows)
    assert {row for row in rows if row[0] not in loading} == {
        (check.code, check.name, check.severity) for check in CHECKS
    }
    assert {code for code, check, _ in rows if check == "load"} == loading
    assert [code for code, _ in SECTIONS] == [code for code, _, _ in rows]


def test_rows_have_titles_of_sections() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert [f"### {code}: {title}" for code, _, _, title in ROW.findall(text)] == re.findall(
        r"^### .*$", text, re.MULTILINE
    )


@pytest.mark.slow
@pytest.mark.parametrize(("code", "section"), SECTIONS, ids=[code for code, _ in SECTIONS])
def test_example_has_code_and_output_of_page(code: Any, section: Any, tmp_path: Path) -> None:
    run = PageRun(tmp_path)
    fences = list(FENCE.finditer(section))
    for fence in fences:
        assert run.result(fence) == fence["text"]
    assert set(re.findall(r"\[(RT\d{4})\]$", fences[-1]["text"], re.MULTILINE)) == {code}
    assert "\n**Remedy**: " in section
