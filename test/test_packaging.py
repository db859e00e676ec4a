"""What is built for pip: a source archive, a wheel made of it, and an installation that needs no checkout."""

import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from email.parser import Parser
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import pytest

pytest.importorskip("setuptools")
pytest.importorskip("wheel")
pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parent.parent


def run(*command, cwd, **variables):
    """Run a command that sees nothing of this clone and of a ROS; return what it prints."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "CATKIN"))}
    done = subprocess.run(
        [str(word) for word in command],
        cwd=cwd,
        env={**kept, **variables},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """The source archive of what is under version control, and a wheel made of that archive, by this Python.

    Where it has catkin's packages, they change nothing.
    """
    there = tmp_path_factory.mktemp("built")
    sources = there / "sources"
    for folder in (
        "src",
        "application_source",
        "docs",
        "examples",
        "launch",
        "msg",
        "srv",
        "nodes",
        "env-hooks",
    ):
        shutil.copytree(
            ROOT / folder, sources / folder, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info")
        )
    for path in ROOT.iterdir():
        if path.is_file() and not path.name.startswith("."):
            shutil.copy(path, sources)
    # Instead of a site that Sphinx has built: two pages, and what Sphinx keeps for its next build.
    shutil.rmtree(sources / "docs" / "_build", ignore_errors=True)
    for page in ("html/index.html", "html/reference/index.html", "doctrees/index.doctree"):
        (sources / "docs" / "_build" / page).parent.mkdir(parents=True, exist_ok=True)
        (sources / "docs" / "_build" / page).write_text(page)
    seen = os.pathsep.join(place for place in sys.path if place)  # where setuptools and wheel are
    run(sys.executable, "setup.py", "-q", "sdist", "-d", there, cwd=sources, PYTHONPATH=seen)
    (archive,) = there.glob("*.tar.gz")
    with tarfile.open(archive) as found:
        found.extractall(there / "unpacked")
    (unpacked,) = (there / "unpacked").iterdir()
    run(sys.executable, "setup.py", "-q", "bdist_wheel", "-d", there, cwd=unpacked, PYTHONPATH=seen)
    (wheel,) = there.glob("*.whl")
    return SimpleNamespace(archive=archive, wheel=wheel)


@pytest.fixture(scope="module")
def installed(built, tmp_path_factory):
    """A virtual environment with the wheel; what it needs is that of this Python."""
    there = tmp_path_factory.mktemp("installed")
    run(sys.executable, "-m", "venv", "--without-pip", there, cwd=there)
    (packages,) = there.glob("lib/*/site-packages")
    others = [
        place for place in sys.path if place.endswith("-packages") and not Path(place, "retalis").exists()
    ]
    (packages / "others.pth").write_text("".join(f"{place}\n" for place in others))
    install = ("-m", "pip", "install", "-q", "--no-index", "--no-deps", "--ignore-installed", built.wheel)
    run(there / "bin" / "python", *install, cwd=there, PYTHONPATH=os.pathsep.join(others))
    return there


def test_metadata_agrees_with_package_manifest():
    manifest = ElementTree.parse(ROOT / "package.xml").getroot()
    metadata = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    for name in ("name", "version"):
        assert re.findall(f'(?m)^{name} = "(.*)"$', metadata) == [manifest.findtext(name)]
    for fact in (
        manifest.findtext("license"),
        manifest.findtext("author"),
        manifest.find("maintainer").get("email"),
    ):
        assert f'"{fact}"' in metadata
    for url in manifest.iterfind("url"):
        assert f'{url.get("type").capitalize()} = "{url.text}"' in metadata


def test_the_archive_has_what_it_is_built_from(built):
    with tarfile.open(built.archive) as found:
        names = {name.partition("/")[2] for name in found.getnames()}
    assert names >= {
        "package.xml",
        "requirements.txt",
        "setup.py",
        "examples/nao/make_bag.py",
        "application_source/pub_sub.xml",
        "srv/AddMemory.srv",
        "install_apt.py",
        "examples/cookbook/door/eventRules.txt",
    }
    assert not [name for name in names if name.startswith("docs/cookbook")]  # a link, when the site is built


def test_the_wheel_has_the_package_and_the_example(built):
    with zipfile.ZipFile(built.wheel) as found:
        names = found.namelist()
        (about,) = [name for name in names if name.endswith("/METADATA")]
        told = Parser().parsestr(found.read(about).decode())
    for path in (ROOT / "src" / "retalis").rglob("*"):
        if path.is_file() and "__pycache__" not in path.parts:
            assert path.relative_to(ROOT / "src").as_posix() in names
    for folder in ("application_source", "examples/nao", "examples/cookbook", "examples/cookbook/door"):
        for path in (ROOT / folder).iterdir():
            if path.is_file() and path.suffix != ".bag":
                assert any(name.endswith(f"/share/retalis/{folder}/{path.name}") for name in names)
    assert told["Author"] and told["Maintainer-email"] and told["Description-Content-Type"] == "text/markdown"
    assert (told.get_payload() or told["Description"]).lstrip().startswith("# retalis")
    assert set(told.get_all("Provides-Extra")) == {"dashboard", "dask", "parquet", "plot", "s3"}
    assert told["Requires-Python"] == ">=3.8"
    assert told["Project-URL"] == "Website, http://wiki.ros.org/retalis"
    assert {"ROS", "Prolog"} <= set(told["Keywords"].split(","))
    assert "Programming Language :: Python :: 3.8" in told.get_all("Classifier")
    assert "Typing :: Typed" in told.get_all("Classifier")
    page = told.get_payload() or told["Description"]
    assert re.findall(r"\]\((?!https?://)[^)]*\)", page) == []  # there are no files beside it
    assert "*(Image: A map: the robot's path" in page and "Start at docs/index.md." in page


def test_the_archive_and_the_wheel_have_the_documentation_site(built):
    with tarfile.open(built.archive) as found:
        names = {
            name.partition("/docs/_build/")[2] for name in found.getnames() if found.getmember(name).isfile()
        }
    assert names == {"", "html/index.html", "html/reference/index.html"}
    with zipfile.ZipFile(built.wheel) as found:
        pages = [name for name in found.namelist() if "/share/retalis/docs/html/" in name]
    assert [name.partition("/docs/")[2] for name in pages] == ["html/index.html", "html/reference/index.html"]


def test_a_wheel_is_built_without_a_site(tmp_path):
    shutil.copytree(
        ROOT, tmp_path / "sources", ignore=shutil.ignore_patterns(".*", "_build", "test", "bench", "build")
    )
    seen = os.pathsep.join(place for place in sys.path if place)
    run(
        sys.executable,
        "setup.py",
        "-q",
        "bdist_wheel",
        "-d",
        tmp_path,
        cwd=tmp_path / "sources",
        PYTHONPATH=seen,
    )
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as found:
        assert not [name for name in found.namelist() if "/docs/html" in name]


def test_an_installation_is_a_command_with_the_example_and_completion(installed, tmp_path):
    command = installed / "bin" / "retalis"
    assert run(command, "--version", cwd=tmp_path) == "retalis 1.0.0\n"
    assert "4x4_1" in run(command, "demo", "--seconds", "3", cwd=tmp_path)
    site = installed / "share" / "retalis" / "docs" / "html" / "index.html"
    assert run(command, "docs", "--print-path", cwd=tmp_path) == f"{site}\n" and site.exists()
    assert "followed by the list" in run(command, "console", "--goal", "help(append)", cwd=tmp_path)
    script = (
        "source <(retalis complete bash);"
        'COMP_WORDS=(retalis ev); COMP_CWORD=1; _retalis_complete; echo "${COMPREPLY[@]}";'
        'COMP_WORDS=(retalis bag --max-s); COMP_CWORD=2; _retalis_complete; echo "${COMPREPLY[@]}";'
        'COMP_WORDS=(retalis bag --program x); COMP_CWORD=3; _retalis_complete; echo "${COMPREPLY[@]}"'
    )
    assert (installed / "share" / "zsh" / "site-functions" / "_retalis").is_file()
    assert (installed / "share" / "fish" / "vendor_completions.d" / "retalis.fish").is_file()
    assert run(command, "complete", "zsh", cwd=tmp_path).startswith("#compdef retalis\n")
    path = f"{command.parent}{os.pathsep}{os.environ['PATH']}"
    said = run("bash", "-c", script, cwd=tmp_path, PATH=path)
    assert said == "events\n--max-skew --max-seconds\n\n"
