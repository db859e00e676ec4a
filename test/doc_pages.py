"""Snippets of the documentation: running the fences of a page, and loading its scripts."""

import contextlib
import importlib.util
import io
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

from retalis import Engine, PrologError
from retalis.cli.toplevel_io import format_bindings
from retalis.prolog.syntax.term_reader import read_program, read_term
from retalis.prolog.syntax.term_writer import write_term

ROOT = Path(__file__).resolve().parent.parent
FENCE = re.compile(
    r"(?:^<!-- (?P<name>\S+) -->\n)?^```(?P<kind>\w*)\n(?P<text>.*?)^```", re.DOTALL | re.MULTILINE
)
SEARCH_PATH = os.pathsep.join([str(ROOT / "src"), *filter(None, sys.path)])
"""Search path of the commands: packages such as rosbags may lie in a folder that only the tests' own path has."""

WORDS = {"retalis": [sys.executable, "-m", "retalis"], "python3": [sys.executable]}


def run_commands(text, folder):
    """Return a console block with the output of its commands, as they print it now."""
    shown = []
    for line in text.splitlines():
        if line.startswith("$ "):
            first, *arguments = shlex.split(line[2:])
            done = subprocess.run(
                [*WORDS[first], *arguments],
                cwd=str(folder),
                env={"PYTHONPATH": SEARCH_PATH, "PATH": "/usr/bin:/bin", "PYTHONUNBUFFERED": "1"},
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
        assert goal.startswith("?- ")
        read = read_term(goal[3:], engine.operators)
        try:
            answers = [
                format_bindings(read.names, engine.operators).replace(",\n", ", ") or "true"
                for _ in engine.logic.solutions(read.term)
            ]
            answer = (" ;\n".join(answers) or "false") + "."
        except PrologError as error:
            answer = write_term(error.term[1], engine.operators, quoted=True, spacing=True)
        shown.append(f"{goal}\n{answer}")
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

    def check_fences(self, text):
        """Run all fences of a text, and compare each with what happens."""
        for fence in FENCE.finditer(text):
            assert self.result(fence) == fence["text"]

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
        elif kind == "prolog":
            self.engine.load(rules=text)
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


def load_script(name):
    """Return a script of the documentation as a module."""
    spec = importlib.util.spec_from_file_location(name, str(ROOT / "docs" / f"{name}.py"))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
