"""Invalid arguments of benchmarks, which are reported in one line before any measurement."""

import subprocess
import sys
from pathlib import Path

import pytest

BENCH = Path(__file__).resolve().parents[2] / "bench"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        ("partial_matches.py --from nofile", "there is no nofile"),
        ("partial_matches.py --json nofolder/figures.json", "there is no folder nofolder"),
        ("curves.py --runs 0", "0 is not a whole number above zero"),
        ("engine.py --all --python nosuch", "there is no program nosuch"),
        ("engine.py --all --against nofolder", "there is no nofolder"),
        ("logic.py --one nosuch nrev", "there is no engine nosuch"),
        ("logic.py --one retalis nosuch", "there is no case nosuch"),
        ("offline.py --seconds 0", "0 is not a number above zero"),
        ("offline.py --runs many", "many is not a whole number above zero"),
        ("live_node.py --speed fast", "fast is not a number above zero"),
        ("performance.py --ros nofile", "there is no nofile"),
    ],
)
def test_invalid_argument_is_reported(arguments: str, problem: str, tmp_path: Path) -> None:
    program, *rest = arguments.split()
    process = subprocess.run(
        [sys.executable, str(BENCH / program), *rest], cwd=tmp_path, stderr=subprocess.PIPE, text=True
    )
    assert process.returncode == 2
    assert problem in process.stderr.splitlines()[-1]
    assert "Traceback" not in process.stderr


@pytest.mark.slow
def test_file_without_figures_is_reported(tmp_path: Path) -> None:
    (tmp_path / "wrong.json").write_text('{"python": "3.11"}')
    command = [sys.executable, str(BENCH / "partial_matches.py"), "--from", "wrong.json"]
    process = subprocess.run(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    assert process.returncode == 1
    assert process.stderr == "wrong.json has not the figures that --json writes: KeyError('rows')\n"
