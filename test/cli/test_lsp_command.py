"""Command ``lsp``: the package that it needs, and the documentation that it passes to the server."""

import sys
from typing import Any

import pytest

from retalis.cli.command_line import main


def test_missing_pygls_is_named(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setitem(sys.modules, "pygls", None)
    monkeypatch.setitem(sys.modules, "lsprotocol", None)
    monkeypatch.delitem(sys.modules, "retalis.editing.language_server", raising=False)
    assert main(["lsp"]) == 1
    expected = "retalis: lsp: needs the Python package pygls (pip install 'retalis[lsp]')\n"
    assert capsys.readouterr().err == expected


def test_server_gets_documentation(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pygls")
    passed: Any = []
    monkeypatch.setattr("retalis.editing.language_server.serve", passed.append)
    assert main(["lsp", "--stdio"]) == 0
    (settings,) = passed
    assert settings.error_page("RT1201").endswith("docs/reference/errors.md#rt1201-event-without-a-source")
    assert settings.error_page("RT9999") == ""
    (entry,) = settings.predicates["atom_length"]
    assert (entry.call, entry.page) == ("atom_length(+Text, ?Length)", "docs/reference/predicates.md")
    assert settings.engine.limits.seconds == 5
