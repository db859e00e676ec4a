"""Inputs of each kind have no finding: a short campaign in each run of the tests, a long one at night."""

import pytest

from fuzz.campaign import Campaign
from fuzz.kinds import NAMES

DEFAULT_INPUTS = 20_000

INPUTS = {
    "rules": 4000,
    "joins": 300,
    "limits": 300,
    "states": 400,
    "checkpoints": 400,
    "ros2": 4000,
    "tables": 200,
    "bags": 8000,
    "names": 10_000,
    "goals": 10_000,
}
"""Inputs of long campaigns of the kinds whose inputs take long."""

MIN_SHORT_INPUTS = 10
SHORT_SHARE = 1 / 40
"""Share of the inputs of a long campaign that a short one has."""


def check_campaign(kind, inputs, jobs):
    """Run a campaign; fail if it has a finding, or if nearly all of its inputs are accepted or refused."""
    campaign = Campaign(kind)
    campaign.run(inputs, jobs)
    findings = [
        f"{line['what']} at {line['where']}, {line['times']} times: {line['detail']}\n"
        f"  --replay {kind}:{line['seed']}:{line['since']}-{line['number']} {bytes.fromhex(line.get('input', ''))!r}"
        for line in campaign.counted
    ]
    assert not findings, "\n".join(findings)
    assert campaign.done == inputs
    assert campaign.accepted_count > inputs // 50
    assert campaign.refused_count > inputs // 50


@pytest.fixture(autouse=True)
def time_limit(monkeypatch):
    """Extend the time limit of an input, because other work on the machine makes all slower."""
    monkeypatch.setenv("FUZZ_SLACK", "2.5")


@pytest.mark.slow
@pytest.mark.parametrize("kind", NAMES)
def test_short_campaign_has_no_finding(kind):
    inputs = INPUTS.get(kind, DEFAULT_INPUTS)
    check_campaign(kind, max(MIN_SHORT_INPUTS, round(inputs * SHORT_SHARE)), jobs=1)
