"""Long campaigns of each kind have no finding."""

import os
from typing import Any

import pytest

from fuzz.kinds import NAMES

from .test_fuzz import DEFAULT_INPUTS, INPUTS, check_campaign, time_limit  # noqa: F401 -- a fixture


@pytest.mark.nightly
@pytest.mark.parametrize("kind", NAMES)
def test_long_campaign_has_no_finding(kind: Any) -> None:
    check_campaign(kind, INPUTS.get(kind, DEFAULT_INPUTS), jobs=os.cpu_count() or 1)
