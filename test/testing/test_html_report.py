"""HTML page with results of cases and coverage: its contents, and its look in a browser."""

from pathlib import Path
from typing import Any, List

import pytest

from retalis import Definitions
from retalis.foundation.errors import UsageError
from retalis.testing.case_file import parse_case_file
from retalis.testing.case_run import run_case
from retalis.testing.html_report import ReportedCase, write_html_report
from retalis.testing.rule_coverage import CoveredPart, merge_parts

HOSTILE = "<script>alert(1)</script>&\"'"

RULES = """\
% </td> of a comment
hot(X) <-
    t(X)
    where X > 3.

calm <- quiet(_).
size(1, small).
size(_,
     large).
big(_) :- fail.
asked(Y) <- u(X) do size(X, Y).
"""

ROWS = """
    [...document.querySelectorAll("table.source tr")].map(row =>
      [row.className, ...[...row.children].map(cell => cell.innerText)].join("|"))
"""


@pytest.fixture
def page(tmp_path: Path, definitions: Definitions, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the page about a case that has passed and one that has failed."""
    monkeypatch.chdir(tmp_path)
    rules = "".join(f"  {line}\n" for line in RULES.splitlines())
    text = (
        f"rules: |\n{rules}cases:\n"
        "  - {name: a, input: [{at: 1, event: t(4)}, {at: 2, event: u(1)}], expect: {}}\n"
        "  - {name: b, input: [{at: 1, event: u(0)}], expect: {events: {none: [asked(_)]}}}\n"
    )
    path = Path("mine_test.yaml")
    path.write_text(text)
    cases = parse_case_file(text, path)
    results = [run_case(case, definitions, records_coverage=True) for case in cases]
    reported = [
        ReportedCase(
            f"mine_test.yaml:{case.place.line}", f"{case.name} {HOSTILE}", result.seconds, result.failures
        )
        for case, result in zip(cases, results)
    ]
    write_html_report(
        tmp_path / "page.html", HOSTILE, reported, merge_parts(result.coverage for result in results)
    )
    return tmp_path / "page.html"


def test_page_has_colours_signs_and_texts(browser: Any, page: Path) -> None:
    browser.open(page.as_uri())
    rows: List[str] = browser.ask(ROWS)
    assert rows[:15] == [
        "||1||rules: |",
        "||2||  % </td> of a comment",
        "partly|~|3|1|  hot(X) <-",
        "partly||4||      t(X)",
        "partly||5||      where X > 3.",
        "partly missing||||not used: hot(X): condition 1 false, X>3",
        "||6||  ",
        "uncovered|\u2717|7|0|  calm <- quiet(_).",
        "uncovered missing||||not used: rule calm<-quiet(_)",
        "uncovered missing||||not used: calm: pattern 1, quiet(_)",
        "covered|\u2713|8|1|  size(1, small).",
        "covered|\u2713|9|1|  size(_,",
        "covered||10||       large).",
        "uncovered|\u2717|11|0|  big(_) :- fail.",
        "uncovered missing||||not used: clause big(A)",
    ]
    assert browser.ask("document.querySelector('tr.partly').title").splitlines() == [
        "partly covered",
        "not used: hot(X): condition 1 false, X>3",
    ]
    colours = browser.ask(
        "['covered', 'partly', 'uncovered'].map(name => getComputedStyle(document.querySelector(`tr.${name}`)))"
        ".map(style => style.backgroundColor)"
    )
    assert len({*colours, "rgba(0, 0, 0, 0)"}) == 4
    assert browser.ask("document.documentElement.scrollWidth") == 1280


def test_page_lists_cases_with_failures(browser: Any, page: Path) -> None:
    browser.open(page.as_uri())
    assert browser.ask("document.title") == HOSTILE
    assert browser.ask("document.scripts.length") == 0
    text = browser.ask("document.body.innerText")
    assert "1 passed, 1 failed" in text
    assert f"a {HOSTILE}" in text
    assert "1 found that must not occur\n" in browser.ask("document.querySelector('pre').innerText")
    assert "asked(large)" in browser.ask("document.querySelector('pre').innerText")


def test_file_error_is_not_a_failed_case(browser: Any, tmp_path: Path) -> None:
    cases = [
        ReportedCase("a_test.yaml:2", "a", 0.1, ()),
        ReportedCase("b_test.yaml", "", 0.0, ("unknown key 'x'",)),
    ]
    write_html_report(tmp_path / "page.html", "title", cases)
    browser.open((tmp_path / "page.html").as_uri())
    assert "1 passed, 0 failed, 1 file error" in browser.ask("document.body.innerText")
    cells = browser.ask(
        "[...document.querySelectorAll('.list td:first-child')].map((cell) => cell.innerText)"
    )
    assert cells == ["\u2713 passed", "\u2717 file error", ""]


def test_long_texts_are_broken_on_phone(browser: Any, tmp_path: Path) -> None:
    name = "a_long_name_" * 8
    parts = [CoveredPart("memory", "", name, 2), CoveredPart("rule", f"{tmp_path}/{name}:7", name, 0)]
    cases = [ReportedCase(f"tests/{name}.yaml:2", name, 0.1, (name,))]
    write_html_report(tmp_path / "page.html", "title", cases, parts)
    browser.resize(400, 800)
    browser.open((tmp_path / "page.html").as_uri())
    assert browser.ask("document.documentElement.scrollWidth") == 400


def test_page_loads_nothing(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert "<script" not in text
    assert "src=" not in text
    assert "href=" not in text


def test_texts_of_missing_file_are_listed(tmp_path: Path) -> None:
    parts = [CoveredPart("rule", f"{tmp_path}/none.txt:7", "a<-b", 0), CoveredPart("memory", "", "m<1>", 2)]
    write_html_report(tmp_path / "new" / "page.html", "title", (), parts)
    text = (tmp_path / "new" / "page.html").read_text(encoding="utf-8")
    assert "The file cannot be read: No such file or directory." in text
    assert "not used: rule a&lt;-b" in text
    assert "memory m&lt;1&gt;" in text
    assert "Cases" not in text


def test_unwritable_page_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "page.html").mkdir()
    with pytest.raises(UsageError, match="cannot write .*page.html: "):
        write_html_report(tmp_path / "page.html", "title")
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match="cannot write .*page.html: "):
        write_html_report(tmp_path / "file" / "page.html", "title")
