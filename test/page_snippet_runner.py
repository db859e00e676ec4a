"""Snippets of the documentation: running the fences of a page, and loading its scripts."""

import contextlib
import io
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any, Dict, List, Optional

from asserting_accessors import compound
from subprocess_python_path import python_path

from retalis import Engine, PrologError
from retalis.cli.command_line import main
from retalis.cli.toplevel_io import format_bindings
from retalis.prolog.syntax.term_reader import ReadTerm, read_program, read_term
from retalis.prolog.syntax.term_writer import write_term

ROOT = Path(__file__).resolve().parent.parent
FENCE = re.compile(
    r"(?:^<!-- (?P<name>\S+) -->\n)?^```(?P<kind>\w*)\n(?P<text>.*?)^```", re.DOTALL | re.MULTILINE
)
PROGRAMS = {"retalis": [sys.executable, "-m", "retalis"], "python3": [sys.executable], "cat": ["cat"]}
"""The command line of each program that pages call."""

COMMANDS_IN_PROCESS = ("check", "events")
"""Commands that run in the process of the tests, because most pages call them and the start of a process is slow."""


def run_process(command: List[str], folder: Any) -> str:
    """Run a command in a process of its own; return its output, with that on standard error."""
    return subprocess.run(
        command,
        cwd=str(folder),
        env={"PYTHONPATH": python_path(), "PATH": "/usr/bin:/bin", "PYTHONUNBUFFERED": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=120,
    ).stdout


def run_in_process(arguments: List[str], folder: Any) -> str:
    """Run a command of ``retalis`` in this process; return its output, with that on standard error."""
    output = io.StringIO()
    working_folder = os.getcwd()
    os.chdir(str(folder))
    try:
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output):
            main(arguments)
    finally:
        os.chdir(working_folder)
    return output.getvalue()


def run_commands(text: str, folder: Any) -> str:
    """Run the commands of a console block; return the block with their present output."""
    blocks: List[str] = []
    for line in text.splitlines():
        if line.startswith("$ "):
            program, *arguments = shlex.split(line[2:])
            if program == "retalis" and arguments[0] in COMMANDS_IN_PROCESS:
                output = run_in_process(arguments, folder)
            else:
                output = run_process([*PROGRAMS[program], *arguments], folder)
            blocks.append(f"{line}\n{output}")
    return "".join(blocks)


def call_goals(text: str, engine: Any) -> str:
    """Call the goals of a console block; return the block with the present answers of the engine."""
    blocks: List[Any] = []
    for block in text.strip().split("\n\n"):
        goal = block.partition("\n")[0]
        assert goal.startswith("?- ")
        parsed = read_term(goal[3:], engine.operators)
        try:
            answers = [
                format_bindings(parsed.names, engine.operators).replace(",\n", ", ") or "true"
                for _ in engine.logic.solutions(parsed.term)
            ]
            answer = (" ;\n".join(answers) or "false") + "."
        except PrologError as error:
            answer = write_term(compound(error.term)[1], engine.operators, quoted=True, spacing=True)
        blocks.append(f"{goal}\n{answer}")
    return "\n\n".join(blocks) + "\n"


class PageRun:
    """The state of a page while its fences are run: an engine, its outputs, and Python names."""

    def __init__(self, folder: Any) -> None:
        self.folder = folder
        self.names: Dict[Any, Any] = {}
        self.printed: Optional[str] = None
        self.start_section()

    def start_section(self) -> None:
        self.engine = Engine()
        self.outputs: List[Any] = []
        self.engine.on_output(
            lambda term, topic, name: self.outputs.append(f"{self.engine.show(term)} to {topic}\n")
        )

    def check_fences(self, text: Any) -> None:
        """Run all fences of a text, and compare each with what happens."""
        for fence in FENCE.finditer(text):
            assert self.result(fence) == fence["text"]

    def result(self, fence: Any) -> Any:
        """Run a fence; return the text that the page should show in it."""
        language, text, printed = fence["kind"], fence["text"], self.printed
        self.printed = None
        if fence["name"]:
            path = self.folder / fence["name"]
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        elif language == "console":
            return (
                call_goals(text, self.engine) if text.startswith("?- ") else run_commands(text, self.folder)
            )
        elif language == "prolog":
            self.engine.load(rules=text)
        elif language == "goals":
            self.engine.load(goals=text)
        elif language == "stream":
            for clause in read_program(text, self.engine.operators):
                assert isinstance(clause, ReadTerm), clause
                self.engine.call(clause.term)
        elif language == "outputs":
            return "".join(self.outputs)
        elif language == "python":
            with contextlib.redirect_stdout(io.StringIO()) as output:
                exec(compile(text, "page", "exec"), self.names)
            self.printed = output.getvalue()
        elif language == "text" and printed:
            return printed
        return text
