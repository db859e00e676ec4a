"""Each mechanism of the operators on streams, states and timers is noticed where it is switched off."""

from itertools import count

import pytest

from .mechanisms import MECHANISMS, noticing


@pytest.mark.slow
@pytest.mark.parametrize("name", list(MECHANISMS))
def test_cases_differ_without_it_and_only_then(name):
    tried, differing, wrong = noticing(name, count(), 300, enough=1)
    assert differing == 1, f"{tried} cases did not notice"
    assert not wrong
