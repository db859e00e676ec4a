"""Types say what things are: mypy checks them strictly, and this test that they do not evade it by `Any`."""

import re

from source import ROOT

MOST = 10
"""Lines in a thousand that may say `Any`, imports of the name left out."""

SAYS_ANY = re.compile(r"\bAny\b")


def lines():
    for path in sorted((ROOT / "src").rglob("*.py")):
        for line in path.read_text(encoding="utf-8").splitlines():
            if not line.startswith(("from ", "import ")):
                yield line


def test_few_lines_say_any():
    found = list(lines())
    evading = sum(1 for line in found if SAYS_ANY.search(line) and line.strip() != "Any,")
    assert 0 < evading * 1000 <= MOST * len(found), f"{evading} of {len(found)} lines say Any"
