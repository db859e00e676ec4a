"""``docs/tutorials/first-rule.md``: its files are written, its commands run, and they print what it shows."""

import io
import re
import runpy
import shlex
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import pytest

from retalis.cli.command_line import main

pytestmark = pytest.mark.docs

PAGE = Path(__file__).resolve().parent.parent / "docs" / "tutorials" / "first-rule.md"
BLOCK = re.compile(r"(?:<!-- (?P<name>[\w./]+) -->\n)?```(?P<kind>\w*)\n(?P<text>.*?)```", re.DOTALL)
RETALIS = ["python3", "-m", "retalis"]


@pytest.mark.slow
def test_each_step_does_what_the_page_says(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    commands = 0
    for block in BLOCK.finditer(PAGE.read_text(encoding="utf-8")):
        if block["name"]:
            path = tmp_path / block["name"]
            path.parent.mkdir(exist_ok=True)
            path.write_text(block["text"], encoding="utf-8")
        else:
            assert block["kind"] == "console"
            command, _, wanted = block["text"].partition("\n")
            assert printed(shlex.split(command)) == ("$", wanted), command
            commands += 1
    assert commands == 11


def printed(words):
    shown = io.StringIO()
    with redirect_stdout(shown), redirect_stderr(shown):
        if words[1:4] == RETALIS:
            main(words[4:])
        else:
            assert words[1] == "python3"
            runpy.run_path(words[2], run_name="__main__")
    return words[0], shown.getvalue()
