"""``docs/reference/python.md``: the session is run as it stands, and names all that the package offers."""

import doctest
import re
from pathlib import Path

import pytest

import retalis

pytestmark = pytest.mark.docs

PAGE = (Path(__file__).resolve().parent.parent / "docs" / "reference" / "python.md").read_text(
    encoding="utf-8"
)


@pytest.mark.slow
def test_the_session_runs(tmp_path):
    found = doctest.DocTestParser().get_doctest(PAGE, {"folder": tmp_path}, "python.md", "python.md", 0)
    assert len(found.examples) > 50
    said = []
    doctest.DocTestRunner(verbose=False).run(found, out=said.append)
    assert not said, "".join(said)


def test_all_names_are_there():
    assert set(retalis.__all__) <= set(re.findall(r"\w+", PAGE))
