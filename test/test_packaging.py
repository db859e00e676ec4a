"""What is built for pip: a source archive from which all can be built, and an installation that can run the demo."""

import shutil
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

pytest.importorskip("setuptools")

ROOT = Path(__file__).resolve().parent.parent
WITHOUT_CATKIN = (
    "import sys, runpy; sys.modules['catkin_pkg'] = None; runpy.run_path('setup.py', run_name='__main__')"
)


@pytest.fixture
def copy(tmp_path):
    """Return a copy of what is under version control and needed: nothing is built in the sources."""
    there = tmp_path / "sources"
    for folder in ("src", "application_source", "examples", "launch", "msg", "srv", "nodes", "env-hooks"):
        shutil.copytree(
            ROOT / folder, there / folder, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info")
        )
    for path in ROOT.iterdir():
        if path.is_file() and not path.name.startswith("."):
            shutil.copy(path, there)
    return there


def setup(folder, *arguments):
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_CATKIN, "--quiet", *arguments],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stdout


@pytest.mark.slow
def test_the_source_archive_has_what_it_is_built_from(copy, tmp_path):
    setup(copy, "sdist", "--dist-dir", str(tmp_path / "dist"))
    (archive,) = (tmp_path / "dist").iterdir()
    with tarfile.open(archive) as found:
        names = {name.partition("/")[2] for name in found.getnames()}
    for name in (
        "package.xml",
        "requirements.txt",
        "setup.py",
        "examples/nao/make_bag.py",
        "application_source/pub_sub.xml",
        "srv/AddMemory.srv",
        "src/retalis/prolog/syntax/tokens.lark",
        "src/retalis/prolog/library/lists.pl",
        "src/retalis/py.typed",
        "src/retalis/engine/dashboard/page/dashboard.js",
        "install_apt.py",
    ):
        assert name in names
    unpacked = tmp_path / "unpacked"
    with tarfile.open(archive) as found:
        found.extractall(unpacked)
    (folder,) = unpacked.iterdir()
    setup(folder, "build")
    built = folder / "build" / "lib" / "retalis"
    assert (built / "prolog" / "syntax" / "tokens.lark").is_file()
    assert (built / "engine" / "dashboard" / "page" / "index.html").is_file()
    assert (built / "py.typed").is_file()  # type checkers look into the package


def test_an_installation_has_the_example(copy, tmp_path):
    setup(copy, "install_data", "--install-dir", str(tmp_path / "there"))
    there = tmp_path / "there" / "share" / "retalis"
    for folder in ("application_source", "examples/nao"):
        wanted = {path.name for path in (ROOT / folder).iterdir() if path.is_file()}
        assert {path.name for path in (there / folder).iterdir()} == wanted
