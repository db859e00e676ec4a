"""``retalis docs``: the documentation site in the browser."""

import pytest

from retalis.cli import docs_command
from retalis.cli.command_line import main


@pytest.fixture(params=[docs_command.SOURCE_SITE, docs_command.INSTALLED_SITE], ids=["clone", "installation"])
def page(request, tmp_path, monkeypatch):
    """Start page of a built site, in a clone and in an installation."""
    module = tmp_path / "lib" / "python3" / "site-packages" / "retalis" / "cli" / "docs_command.py"
    monkeypatch.setattr(docs_command, "__file__", str(module))
    page = tmp_path / request.param / "index.html"
    page.parent.mkdir(parents=True)
    page.touch()
    return page


def test_the_start_page_is_opened(page, monkeypatch, capsys):
    opened = []
    monkeypatch.setattr(docs_command.webbrowser, "open", lambda url: opened.append(url) or True)
    assert main(["docs"]) == 0
    assert opened == [page.as_uri()]
    assert capsys.readouterr() == ("", "")


def test_the_path_is_printed(page, capsys):
    assert main(["docs", "--print-path"]) == 0
    assert capsys.readouterr() == (f"{page}\n", "")


def test_without_a_browser_the_path_is_an_error_message(page, monkeypatch, capsys):
    monkeypatch.setattr(docs_command.webbrowser, "open", lambda url: False)
    assert main(["docs"]) == 1
    assert capsys.readouterr().err == f"retalis docs: no browser can be started: open {page}\n"


def test_without_a_site_the_message_names_the_command_that_builds_it(page, capsys):
    page.unlink()
    assert main(["docs", "--print-path"]) == 1
    assert "the documentation site is not built: run ./install.py docs" in capsys.readouterr().err
