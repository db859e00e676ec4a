"""Annotations of the package: `mypy` checks them strictly, and these tests limit the use of `Any`."""

import re
from typing import Iterator

import pytest
from parsed_sources import ROOT

MAX_ANY_PER_THOUSAND = 10
"""Lines in a thousand that may contain `Any`, without imports of the name."""

ANY = re.compile(r"\bAny\b")


def lines(folder: str) -> Iterator[str]:
    for path in sorted((ROOT / folder).rglob("*.py")):
        for line in path.read_text(encoding="utf-8").splitlines():
            if not line.startswith(("from ", "import ")):
                yield line


# The limit holds for serialization alone, too, because its types declare what their checks return.
@pytest.mark.parametrize("folder", ["src", "src/retalis/serialization"])
def test_few_lines_contain_any(folder: str) -> None:
    package_lines = list(lines(folder))
    any_count = sum(1 for line in package_lines if ANY.search(line) and line.strip() != "Any,")
    assert 0 < any_count * 1000 <= MAX_ANY_PER_THOUSAND * len(package_lines), (
        f"{any_count} of {len(package_lines)} lines contain Any"
    )


def test_any_has_no_other_name_in_serialization() -> None:
    package_lines = list(lines("src/retalis/serialization"))
    assert any(ANY.search(line) for line in package_lines)
    assert [line for line in package_lines if re.match(r"\w+ = Any\b", line)] == []
