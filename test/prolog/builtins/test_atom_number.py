"""Conversion of atoms."""

import pytest
from prolog.goal_answers import answers, prolog


@pytest.mark.parametrize("text", ["' 12'", "'\\n12'", '" 12"', "'12 '", "'+ 12'"])
def test_atom_number_fails_for_white_space(text: str) -> None:
    assert answers(prolog(), f"atom_number({text}, X)") == []
