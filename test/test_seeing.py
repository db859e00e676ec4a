"""The commands of docs/seeing.md, in the folder that the page says."""

import re
import shlex
import shutil
import sys
from pathlib import Path

import pytest

from retalis.cli import main

ROOT = Path(__file__).resolve().parent.parent
PAGE = (ROOT / "docs" / "seeing.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^    python3 -m retalis (.*)$", PAGE, re.MULTILINE)

sys.path.append(str(ROOT / "examples" / "nao"))
from make_bag import make_bag  # noqa: E402


@pytest.mark.slow
@pytest.mark.docs
def test_the_commands_of_the_page_do_what_they_say(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(ROOT / "application_source", "application_source")
    make_bag("nao.bag", 1.0, 1)
    assert COMMANDS
    for command in COMMANDS:
        words, _, file = command.partition(" > ")
        assert main(shlex.split(words)) == 0, command
        shown = capsys.readouterr()
        assert shown.err == "", command
        if file:
            Path(file).write_text(shown.out, encoding="utf-8")
