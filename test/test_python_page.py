"""``docs/reference/python.md``: the session is run, and it has all public names."""

import doctest
import re
from pathlib import Path
from typing import Any, List

import pytest

import retalis

pytestmark = pytest.mark.docs

PAGE = (Path(__file__).resolve().parent.parent / "docs" / "reference" / "python.md").read_text(
    encoding="utf-8"
)


@pytest.mark.slow
def test_session_has_output_of_page(tmp_path: Path) -> None:
    session = doctest.DocTestParser().get_doctest(PAGE, {"folder": tmp_path}, "python.md", "python.md", 0)
    assert len(session.examples) > 50
    failures: List[Any] = []
    doctest.DocTestRunner(verbose=False).run(session, out=failures.append)
    assert not failures, "".join(failures)


def test_page_has_all_public_names() -> None:
    assert set(retalis.__all__) <= set(re.findall(r"\w+", PAGE))
