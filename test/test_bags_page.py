"""Commands of ``docs/reference/bags.md``, in a folder with copies of the needed sources."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from subprocess_python_path import python_path

from retalis.cli.command_line import main

ROOT = Path(__file__).resolve().parent.parent
PAGE = (ROOT / "docs" / "reference" / "bags.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^    retalis (.*)$", PAGE, re.MULTILINE)
(MAKE_BAG,) = re.findall(r"^    python3 (\S*make_bag.py .*)$", PAGE, re.MULTILINE)


@pytest.mark.slow
@pytest.mark.docs
def test_commands_of_page_succeed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(ROOT / "application_source", "application_source")
    shutil.copytree(ROOT / "examples" / "nao", "examples/nao")
    make_bag = [sys.executable, *shlex.split(MAKE_BAG), "--seconds", "1"]
    subprocess.run(make_bag, check=True, env={**os.environ, "PYTHONPATH": python_path()})
    assert COMMANDS
    for command in COMMANDS:
        words, _, file = command.partition(" > ")
        assert main(shlex.split(words)) == 0, command
        captured = capsys.readouterr()
        assert captured.err == "", command
        if file:
            Path(file).write_text(captured.out, encoding="utf-8")
