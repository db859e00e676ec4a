"""Annotations of the package: `mypy` checks them strictly, and this test limits the use of `Any`."""

import re
from typing import Any, Iterator

from source import ROOT

MAX_ANY_PER_THOUSAND = 10
"""Lines in a thousand that may contain `Any`, without imports of the name."""

ANY = re.compile(r"\bAny\b")


def lines() -> Iterator[Any]:
    for path in sorted((ROOT / "src").rglob("*.py")):
        for line in path.read_text(encoding="utf-8").splitlines():
            if not line.startswith(("from ", "import ")):
                yield line


def test_few_lines_contain_any() -> None:
    package_lines = list(lines())
    any_count = sum(1 for line in package_lines if ANY.search(line) and line.strip() != "Any,")
    assert 0 < any_count * 1000 <= MAX_ANY_PER_THOUSAND * len(package_lines), (
        f"{any_count} of {len(package_lines)} lines contain Any"
    )
