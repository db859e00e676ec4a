"""The soak, for half a minute; by itself it takes as long as it is told."""

import subprocess
import sys
from pathlib import Path

import pytest

SOAK = Path(__file__).with_name("soak.py")


@pytest.mark.slow
def test_nothing_is_lost_but_what_is_counted(devel, tmp_path):
    command = [sys.executable, str(SOAK), "--minutes", "0.5", "--speed", "2", "--restarts", "12"]
    log = tmp_path / "soak.csv"
    done = subprocess.run(
        devel.command(*command, "--size", "160x120", "--log", str(log)),
        env=devel.env,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, done.stdout
    assert len(log.read_text().splitlines()) > 20
