"""``docs/reference/python-api.md``: it has each public name once; ``test_api.py`` runs their examples."""

import re

import pytest
from page_snippet_runner import ROOT

import retalis

pytestmark = pytest.mark.docs

PAGE = (ROOT / "docs" / "reference" / "python-api.md").read_text(encoding="utf-8")


def test_each_public_name_is_on_page_once() -> None:
    names = re.findall(r"^\.\. auto(?:class|function|data):: retalis\.(\w+)$", PAGE, re.MULTILINE)
    assert sorted(names) == sorted(retalis.__all__)
