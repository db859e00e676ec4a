"""``docs/reference/commands.md``, which docs/commands.py writes from the parsers of the command line."""

import pytest
from page_snippet_runner import ROOT
from script_modules import load_script

from retalis.cli.command_line import COMMANDS

pytestmark = pytest.mark.docs

PAGE = (ROOT / "docs" / "reference" / "commands.md").read_text(encoding="utf-8")
commands = load_script(ROOT / "docs" / "commands.py")


def test_page_equals_text_of_parsers() -> None:
    assert commands.page_text() == PAGE, "run docs/commands.py"


def test_each_command_has_section() -> None:
    assert [f"## retalis {name}" for name in COMMANDS] == [
        line for line in PAGE.splitlines() if line.startswith("## retalis ")
    ]
