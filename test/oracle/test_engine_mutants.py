"""Detection of disabled mechanisms of stream operators, states and timers by the comparison with the oracle."""

from itertools import count
from typing import Any

import pytest

from .engine_mutants import MECHANISMS, count_detections


@pytest.mark.slow
@pytest.mark.parametrize("name", list(MECHANISMS))
def test_disabled_mechanism_changes_results(name: Any) -> None:
    compared, differing, unexpected = count_detections(name, count(), 300, max_differing=1)
    assert differing == 1, f"{compared} cases did not notice"
    assert not unexpected
