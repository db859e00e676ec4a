"""Texts of errors."""

import pytest
from asserting_accessors import required

from retalis import Operators
from retalis.prolog.syntax.term_reader import read_program


@pytest.mark.slow
def test_error_in_long_line_is_short() -> None:
    (fault,) = read_program("f(" + "a," * 100_000 + "b c).", Operators.prolog(), "file")
    assert required(fault.place).column == 200_005
    assert len(str(fault)) < 1000
