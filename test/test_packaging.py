"""Packages for pip: a source archive, a wheel built from it, and an installation without the clone."""

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
from typing import Any
from xml.etree import ElementTree

import pytest
from asserting_accessors import required

pytest.importorskip("setuptools")
pytest.importorskip("wheel")
pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parent.parent


def run(*command: Any, cwd: Any, **variables: Any) -> str:
    """Run a command without variables of this clone and of ROS; return its output."""
    inherited = {
        name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "CATKIN"))
    }
    process = subprocess.run(
        [str(word) for word in command],
        cwd=cwd,
        env={**inherited, **variables},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=300,
        check=False,
    )
    assert process.returncode == 0, process.stdout
    return process.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return the source archive of the clone, and a wheel that this Python builds from that archive.

    Installed packages of catkin make no difference.
    """
    folder = tmp_path_factory.mktemp("built")
    sources = folder / "sources"
    for name in (
        "src",
        "application_source",
        "docs",
        "examples",
        "launch",
        "msg",
        "srv",
        "nodes",
        "env-hooks",
        "cmake",
    ):
        shutil.copytree(
            ROOT / name, sources / name, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info")
        )
    for path in ROOT.iterdir():
        if path.is_file() and not path.name.startswith("."):
            shutil.copy(path, sources)
    # Two pages and a file of the cache of Sphinx replace a built site.
    shutil.rmtree(sources / "docs" / "_build", ignore_errors=True)
    for page in ("html/index.html", "html/reference/index.html", "doctrees/index.doctree"):
        (sources / "docs" / "_build" / page).parent.mkdir(parents=True, exist_ok=True)
        (sources / "docs" / "_build" / page).write_text(page)
    search_path = os.pathsep.join(filter(None, sys.path))  # has setuptools and wheel
    run(sys.executable, "setup.py", "-q", "sdist", "-d", folder, cwd=sources, PYTHONPATH=search_path)
    (archive,) = folder.glob("*.tar.gz")
    with tarfile.open(archive) as file:
        file.extractall(folder / "unpacked")
    (unpacked,) = (folder / "unpacked").iterdir()
    run(sys.executable, "setup.py", "-q", "bdist_wheel", "-d", folder, cwd=unpacked, PYTHONPATH=search_path)
    (wheel,) = folder.glob("*.whl")
    return SimpleNamespace(archive=archive, wheel=wheel)


@pytest.fixture(scope="module")
def installed(built: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a virtual environment with the wheel, and with the dependencies of this Python."""
    folder = tmp_path_factory.mktemp("installed")
    run(sys.executable, "-m", "venv", "--without-pip", folder, cwd=folder)
    (packages,) = folder.glob("lib/*/site-packages")
    other_folders = [
        path for path in sys.path if path.endswith("-packages") and not Path(path, "retalis").exists()
    ]
    (packages / "others.pth").write_text("".join(f"{path}\n" for path in other_folders))
    install = ("-m", "pip", "install", "-q", "--no-index", "--no-deps", "--ignore-installed", built.wheel)
    run(folder / "bin" / "python", *install, cwd=folder, PYTHONPATH=os.pathsep.join(other_folders))
    return folder


def test_metadata_agrees_with_package_manifest() -> None:
    manifest = ElementTree.parse(ROOT / "package.xml").getroot()
    metadata = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    for name in ("name", "version"):
        assert re.findall(f'(?m)^{name} = "(.*)"$', metadata) == [manifest.findtext(name)]
    for fact in (
        manifest.findtext("license"),
        manifest.findtext("author"),
        required(manifest.find("maintainer")).get("email"),
    ):
        assert f'"{fact}"' in metadata
    urls = manifest.findall("url")
    assert urls
    for url in urls:
        assert f'{url.attrib["type"].capitalize()} = "{url.text}"' in metadata


def test_archive_has_files_for_build(built: Any) -> None:
    with tarfile.open(built.archive) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert names >= {
        "package.xml",
        "requirements.txt",
        "setup.py",
        "examples/nao/make_bag.py",
        "application_source/pub_sub.xml",
        "srv/AddMemory.srv",
        "cmake/ros2.cmake",
        "install_apt.py",
        "examples/cookbook/door/eventRules.txt",
    }
    assert not [name for name in names if name.startswith("docs/cookbook")]  # a link in a built site


def test_wheel_has_package_and_examples(built: Any) -> None:
    with zipfile.ZipFile(built.wheel) as wheel:
        names = wheel.namelist()
        (metadata_name,) = [name for name in names if name.endswith("/METADATA")]
        metadata = Parser().parsestr(wheel.read(metadata_name).decode())
    for path in (ROOT / "src" / "retalis").rglob("*"):
        if path.is_file() and "__pycache__" not in path.parts:
            assert path.relative_to(ROOT / "src").as_posix() in names
    for folder in ("application_source", "examples/nao", "examples/cookbook", "examples/cookbook/door"):
        for path in (ROOT / folder).iterdir():
            if path.is_file() and path.suffix != ".bag":
                assert any(name.endswith(f"/share/retalis/{folder}/{path.name}") for name in names)
    assert metadata["Author"]
    assert metadata["Maintainer-email"]
    assert metadata["Description-Content-Type"] == "text/markdown"
    page = str(metadata.get_payload() or metadata["Description"])
    assert page.lstrip().startswith("# retalis")
    assert set(metadata.get_all("Provides-Extra", [])) == {
        "dashboard",
        "dask",
        "flink",
        "lsp",
        "mcap",
        "mqtt",
        "parquet",
        "plot",
        "s3",
    }
    assert metadata["Requires-Python"] == ">=3.8"
    assert metadata["Project-URL"] == "Website, http://wiki.ros.org/retalis"
    assert {"ROS", "Prolog"} <= set(metadata["Keywords"].split(","))
    assert "Programming Language :: Python :: 3.8" in metadata.get_all("Classifier", [])
    assert "Typing :: Typed" in metadata.get_all("Classifier", [])
    assert re.findall(r"\]\((?!https?://)[^)]*\)", page) == []  # it has no files beside it
    assert "*(Image: A map: the robot's path" in page
    assert "Start at docs/index.md." in page


def test_archive_and_wheel_have_site(built: Any) -> None:
    with tarfile.open(built.archive) as file:
        names = {
            name.partition("/docs/_build/")[2] for name in file.getnames() if file.getmember(name).isfile()
        }
    assert names == {"", "html/index.html", "html/reference/index.html"}
    with zipfile.ZipFile(built.wheel) as file:
        pages = [name for name in file.namelist() if "/share/retalis/docs/html/" in name]
    assert [name.partition("/docs/")[2] for name in pages] == ["html/index.html", "html/reference/index.html"]


def test_wheel_is_built_without_site(tmp_path: Path) -> None:
    shutil.copytree(
        ROOT, tmp_path / "sources", ignore=shutil.ignore_patterns(".*", "_build", "test", "bench", "build")
    )
    search_path = os.pathsep.join(place for place in sys.path if place)
    run(
        sys.executable,
        "setup.py",
        "-q",
        "bdist_wheel",
        "-d",
        tmp_path,
        cwd=tmp_path / "sources",
        PYTHONPATH=search_path,
    )
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as file:
        assert not [name for name in file.namelist() if "/docs/html" in name]


def test_installed_command_is_complete(installed: Path, tmp_path: Path) -> None:
    command = installed / "bin" / "retalis"
    version = ElementTree.parse(ROOT / "package.xml").getroot().findtext("version")
    assert run(command, "--version", cwd=tmp_path) == f"retalis {version}\n"
    assert "4x4_1" in run(command, "demo", "--seconds", "3", cwd=tmp_path)
    site = installed / "share" / "retalis" / "docs" / "html" / "index.html"
    assert run(command, "docs", "--print-path", cwd=tmp_path) == f"{site}\n"
    assert site.exists()
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
    output = run("bash", "-c", script, cwd=tmp_path, PATH=path)
    assert output == "events\n--max-skew --max-seconds\n\n"
