import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from retalis.cli import main, version

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


def test_the_version_is_that_of_the_manifest(capsys, monkeypatch, tmp_path):
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    manifest = ElementTree.parse(SOURCES.parent / "package.xml").getroot()
    assert (ended.value.code, capsys.readouterr().out) == (0, f"retalis {manifest.findtext('version')}\n")
    monkeypatch.setattr(version, "MANIFEST", tmp_path / "package.xml")
    monkeypatch.setattr(version.metadata, "version", lambda name: f"9 of {name}")
    assert version.version() == "9 of retalis"
    (tmp_path / "package.xml").write_text("<package><name>other</name><version>5</version></package>")
    assert version.version() == "9 of retalis"
