"""Fixture of the tests of program files."""

from pathlib import Path

import pytest
from events.program_runner import ProgramRunner


@pytest.fixture
def program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ProgramRunner:
    """A program that may read the files of the current folder, which is `tmp_path`."""
    monkeypatch.chdir(tmp_path)
    return ProgramRunner(folder=tmp_path)
