"""Options of reading terms from texts."""

import pytest
from prolog.goal_answers import first, prolog


@pytest.mark.parametrize(
    ("options", "term"),
    [
        ("[]", '"ab"'),
        ("[double_quotes(atom)]", "ab"),
        ("[double_quotes(codes)]", "[97,98]"),
        ("[double_quotes(chars), other(x)]", "[a,b]"),
        ("[double_quotes(none)]", "domain_error(double_quotes,none)"),
    ],
)
def test_double_quotes_option_changes_read_term(options: str, term: str) -> None:
    assert first(prolog(), f"read_term_from_atom('\"ab\"', T, {options})") == term
