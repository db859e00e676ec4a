"""Fixture of the tests of command ``events``."""

from pathlib import Path
from typing import Any, Tuple

import pytest

from retalis.cli.command_line import main


@pytest.fixture
def run_events(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Any:
    """Return a function that runs the command over texts and returns its status, output lines and errors."""

    def call(*options: Any, **files: Any) -> Tuple[Any, ...]:
        arguments = ["events"]
        for name, text in files.items():
            option = name.replace("_", "-")
            if text is None:
                arguments += [f"--{option}", str(tmp_path / f"{name}.out")]
            else:
                path = tmp_path / f"{name}.txt"
                path.write_text(text, encoding="utf-8")
                arguments += [f"--{option}", str(path)]
        status = main([*arguments, *options])
        captured = capsys.readouterr()
        return status, captured.out.splitlines(), captured.err

    return call
