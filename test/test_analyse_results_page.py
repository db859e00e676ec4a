"""Questions of ``docs/how-to/analyse-results.md``: DuckDB and pandas have the answer on the page."""

import datetime
import re
import shutil
from pathlib import Path
from typing import Any, Dict, List, Tuple

import pytest
from page_snippet_runner import FENCE, ROOT, run_commands

pytestmark = [pytest.mark.docs, pytest.mark.slow]

PAGE = (ROOT / "docs" / "how-to" / "analyse-results.md").read_text(encoding="utf-8")
SECTIONS = re.split(r"^## ", PAGE, flags=re.MULTILINE)[1:]
QUESTIONS = [section for section in SECTIONS if section.partition("\n")[0].endswith("?")]


class Results:
    """The results of the page, in DuckDB and in pandas."""

    def __init__(self, folder: Path):
        self.printed: List[Tuple[str, str]] = []
        self.connection = pytest.importorskip("duckdb").connect()
        self.connection.execute("SET TimeZone = 'UTC'")
        pytest.importorskip("pandas", minversion="2.2")
        pytest.importorskip("pyarrow")
        self.names: Dict[str, Any] = {}
        (section,) = (section for section in SECTIONS if section.startswith("The results"))
        for fence in FENCE.finditer(section):
            if fence["kind"] == "console":
                self.printed.append((run_commands(fence["text"], folder), fence["text"]))
            elif fence["kind"] == "sql":
                self.connection.execute(fence["text"])
            else:
                exec(compile(fence["text"], "page", "exec"), self.names)


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Any:
    folder = tmp_path_factory.mktemp("page")
    shutil.copytree(ROOT / "examples" / "stops", folder / "examples" / "stops")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        yield Results(folder)


def format_value(value: Any) -> str:
    """Return the text of a value on the page."""
    if isinstance(value, datetime.datetime):
        return value.astimezone(datetime.timezone.utc).strftime("%Y-%m-%d %H:%M:%S")
    return f"{value:g}" if isinstance(value, float) else str(value)


def make_table(names: Any, rows: Any) -> str:
    """Return a table in Markdown."""
    lines = [list(names), ["---"] * len(names), *([format_value(value) for value in row] for row in rows)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def test_commands_have_output_of_page(results: Any) -> None:
    for output, expected in results.printed:
        assert output == expected


def test_page_has_ten_questions() -> None:
    assert len(QUESTIONS) == 10


@pytest.mark.parametrize("question", QUESTIONS, ids=lambda question: question.partition("\n")[0])
def test_answers_are_those_of_page(results: Any, question: str) -> None:
    expected = "".join(re.findall(r"^\|.*\n", question, re.MULTILINE))
    (query,) = (fence["text"] for fence in FENCE.finditer(question) if fence["kind"] == "sql")
    (code,) = (fence["text"] for fence in FENCE.finditer(question) if fence["kind"] == "python")
    answer = results.connection.execute(query)
    assert make_table([column[0] for column in answer.description], answer.fetchall()) == expected
    names = dict(results.names)
    exec(compile(code, "page", "exec"), names)
    assert make_table(names["answer"].columns, names["answer"].itertuples(index=False)) == expected
