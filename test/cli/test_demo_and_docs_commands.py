"""Command ``demo``, the NAO example without ROS, and ``docs``, the documentation site in the browser."""

import json
import math
import sys
from pathlib import Path
from typing import Any, List

import pytest

from retalis.cli import demo_and_docs_commands as commands
from retalis.cli.command_line import main

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "examples" / "nao"))
from make_bag import make_bag  # noqa: E402


def test_demo_locates_markers(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--seconds", "4", "--seed", "3"]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    assert "4x4_1" in captured.out


def test_demo_plays_given_bag(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = tmp_path / "nao.bag"
    make_bag(bag, 3.0, 2)
    assert main(["demo", "--bag", str(bag)]) == 0
    assert "4x4_1" in capsys.readouterr().out


def test_json_of_demo_has_outputs_and_markers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = tmp_path / "nao.bag"
    make_bag(bag, 3.0, 2)
    assert main(["demo", "--bag", str(bag), "--json"]) == 0
    lines = capsys.readouterr().out.splitlines()
    markers = [json.loads(line) for line in lines if line.startswith('{"marker"')]
    assert main(["bag", str(bag), "--program", str(ROOT / "application_source"), "--json"]) == 0
    assert lines[: -len(markers)] == capsys.readouterr().out.splitlines()
    (marker,) = (marker for marker in markers if marker["marker"] == "4x4_1")
    assert math.dist(marker["located"], marker["true"]) == pytest.approx(marker["error"])


def test_missing_bag_is_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--bag", str(tmp_path / "no.bag")]) == 1
    assert "no.bag: there is no such file" in capsys.readouterr().err
    (tmp_path / "no.bag").touch()
    assert main(["demo", "--bag", str(tmp_path / "no.bag")]) == 1
    assert "no.truth.json" in capsys.readouterr().err


def test_example_is_found_in_source_tree() -> None:
    assert commands.example_folder() == ROOT / "examples" / "nao"


def test_invalid_options_are_usage_errors(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in (["demo", "--seconds", "soon"], ["demonstrate"]):
        with pytest.raises(SystemExit) as raised:
            main(arguments)
        assert raised.value.code == 2
    assert "usage: retalis" in capsys.readouterr().err


@pytest.mark.parametrize("seconds", ["-1", "0", "nan", "inf", "some"])
def test_invalid_duration_is_a_usage_error(seconds: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as raised:
        main(["demo", "--seconds", seconds])
    assert raised.value.code == 2
    assert f"expected a positive number of seconds, found {seconds}" in capsys.readouterr().err


@pytest.fixture(params=[commands.SOURCE_SITE, commands.INSTALLED_SITE], ids=["clone", "installation"])
def page(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return the start page of a built site, in a clone and in an installation."""
    module = tmp_path / "lib" / "python3" / "site-packages" / "retalis" / "cli" / "demo_and_docs_commands.py"
    monkeypatch.setattr(commands, "__file__", str(module))
    page = tmp_path / request.param / "index.html"
    page.parent.mkdir(parents=True)
    page.touch()
    return page


def test_start_page_is_opened(
    page: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    urls: List[str] = []

    def open_page(url: str) -> bool:
        urls.append(url)
        return True

    monkeypatch.setattr("webbrowser.open", open_page)
    assert main(["docs"]) == 0
    assert urls == [page.as_uri()]
    assert capsys.readouterr() == ("", "")


def test_path_of_site_is_printed(page: Any, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["docs", "--print-path"]) == 0
    assert capsys.readouterr() == (f"{page}\n", "")


def test_json_has_path_of_site(page: Any, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["docs", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"path": str(page)}


def test_missing_browser_is_an_error_with_path(
    page: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("webbrowser.open", lambda url: False)
    assert main(["docs"]) == 1
    assert capsys.readouterr().err == f"retalis docs: no browser can be started: open {page}\n"


def test_missing_site_is_an_error_with_command(page: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page.unlink()
    assert main(["docs", "--print-path"]) == 1
    assert "the documentation site is not built: run ./install.py docs" in capsys.readouterr().err
