"""A long run, shortened to half a minute."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

SOAK = Path(__file__).with_name("soak.py")


@pytest.mark.nightly
@pytest.mark.slow
def test_short_run_loses_no_uncounted_message(devel: Any, tmp_path: Path) -> None:
    command = [sys.executable, str(SOAK), "--minutes", "0.5", "--speed", "2", "--restarts", "12"]
    log = tmp_path / "soak.csv"
    process = subprocess.run(
        devel.command(*command, "--size", "160x120", "--log", str(log)),
        env=devel.env,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=600,
    )
    assert process.returncode == 0, process.stdout
    assert len(log.read_text().splitlines()) > 20
