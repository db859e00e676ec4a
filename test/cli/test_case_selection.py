"""Selection of cases by the expression of option ``-k``."""

import pytest

from retalis.cli.program_test_command import parse_selection
from retalis.foundation.errors import UsageError


@pytest.mark.parametrize(
    ("expression", "name", "expected"),
    [
        ("fever", "a_test.yaml: Fever at night", True),
        ("at night", "a_test.yaml: fever at night", True),
        ("fever and not night", "fever at night", False),
        ("fever and not night", "fever at noon", True),
        ("cold or noon", "fever at noon", True),
        ("cold or noon and day", "noon", False),
        ("not not fever", "fever", True),
        ("notice", "a notice", True),
    ],
)
def test_expression_selects_names(expression: str, name: str, expected: bool) -> None:
    assert parse_selection(expression)(name) is expected


@pytest.mark.parametrize("expression", ["and", "a or", "not", "a and not", "or a"])
def test_missing_text_is_an_error(expression: str) -> None:
    with pytest.raises(UsageError, match="expected a text"):
        parse_selection(expression)
