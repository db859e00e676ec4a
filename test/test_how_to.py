"""The how-to guides: their files are written, and commands, goals and Python print what the page shows."""

import contextlib
import io
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from retalis import Engine, PrologError
from retalis.cli.toplevel_io import bindings
from retalis.prolog.syntax.term_reader import read_program, read_term
from retalis.prolog.syntax.term_writer import write_term

pytestmark = [pytest.mark.docs, pytest.mark.slow]

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted((ROOT / "docs" / "how-to").glob("*.md"))
FENCE = re.compile(
    r"(?:^<!-- (?P<name>\S+) -->\n)?^```(?P<kind>\w*)\n(?P<text>.*?)^```", re.DOTALL | re.MULTILINE
)
WORDS = {"retalis": [sys.executable, "-m", "retalis"], "python3": [sys.executable]}
MAX_WORDS, MAX_WORDS_OF_PAGE = 9000, 700


def run_commands(text, folder):
    """Return a console block with the output of its commands, as they print it now."""
    shown = []
    for line in text.splitlines():
        if line.startswith("$ "):
            first, *arguments = shlex.split(line[2:])
            done = subprocess.run(
                [*WORDS[first], *arguments],
                cwd=str(folder),
                env={"PYTHONPATH": str(ROOT / "src"), "PATH": "/usr/bin:/bin"},
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                timeout=120,
            )
            shown.append(f"{line}\n{done.stdout}")
    return "".join(shown)


def call_goals(text, engine):
    """Return a console block with the answers to its goals, as the engine gives them now."""
    shown = []
    for block in text.strip().split("\n\n"):
        goal = block.partition("\n")[0]
        read = read_term(goal[3:], engine.operators)
        try:
            answers = [
                bindings(read.names, engine.operators).replace(",\n", ", ") or "true"
                for _ in engine.logic.solutions(read.term)
            ]
            answer = " ;\n".join(answers) or "false"
        except PrologError as error:
            answer = write_term(error.term[1], engine.operators, quoted=True, spacing=True)
        shown.append(f"{goal}\n{answer}.")
    return "\n\n".join(shown) + "\n"


class PageRun:
    """The state of a page while its fences are run."""

    def __init__(self, folder):
        self.folder = folder
        self.names = {}
        self.printed = None
        self.start_section()

    def start_section(self):
        self.engine, self.outputs = Engine(), []
        self.engine.on_output(
            lambda term, topic, name: self.outputs.append(f"{self.engine.show(term)} to {topic}\n")
        )

    def result(self, fence):
        """Run a fence; return the text that the page should show in it."""
        kind, text, printed = fence["kind"], fence["text"], self.printed
        self.printed = None
        if fence["name"]:
            path = self.folder / fence["name"]
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        elif kind == "console":
            return (
                call_goals(text, self.engine) if text.startswith("?- ") else run_commands(text, self.folder)
            )
        elif kind == "goals":
            self.engine.load(goals=text)
        elif kind == "stream":
            for read in read_program(text, self.engine.operators):
                self.engine.call(read.term)
        elif kind == "outputs":
            return "".join(self.outputs)
        elif kind == "python":
            with contextlib.redirect_stdout(io.StringIO()) as output:
                exec(compile(text, "page", "exec"), self.names)
            self.printed = output.getvalue()
        elif kind == "text" and printed:
            return printed
        return text


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_page_shows_what_happens(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = PageRun(tmp_path)
    for section in re.split(r"^(?=## )", page.read_text(encoding="utf-8"), flags=re.MULTILINE):
        run.start_section()
        for fence in FENCE.finditer(section):
            assert run.result(fence) == fence["text"]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_page_ends_with_links_and_is_short(page):
    text = page.read_text(encoding="utf-8")
    assert text.rstrip().splitlines()[-1].startswith("**See also**: ")
    assert len(text.split()) <= MAX_WORDS_OF_PAGE


def test_all_pages_are_in_the_index_and_short_together():
    index = (ROOT / "docs" / "how-to" / "index.md").read_text(encoding="utf-8")
    assert {page.name for page in PAGES} - {"index.md"} == set(re.findall(r"\]\(([\w-]+\.md)\)", index))
    assert sum(len(page.read_text(encoding="utf-8").split()) for page in PAGES) <= MAX_WORDS
