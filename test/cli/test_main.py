import subprocess
import sys
from pathlib import Path

SOURCES = Path(__file__).resolve().parents[2] / "src"


def test_without_lark_it_says_what_to_install(tmp_path):
    (tmp_path / "lark.py").write_text("raise ModuleNotFoundError('No module named lark', name='lark')")
    result = subprocess.run(
        [sys.executable, "-m", "retalis", "bag"],
        env={"PYTHONPATH": f"{tmp_path}:{SOURCES}", "PATH": "/usr/bin:/bin"},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert result.returncode == 1
    assert result.stderr == "retalis: the Python package lark is missing: pip install lark\n"
