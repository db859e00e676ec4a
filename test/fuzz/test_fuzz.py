"""Short fuzz campaigns of each kind of input have no finding."""

from typing import Any

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
    "incremental_tabling": 200,
    "bags": 8000,
    "hostile_names": 10_000,
    "goals": 10_000,
}
"""Numbers of inputs in long campaigns of kinds with slow inputs."""

SHORT_INPUTS = {"states": 60}
"""Numbers of inputs in short campaigns of kinds that refuse nearly all inputs."""

MIN_SHORT_INPUTS = 10
SHORT_SHARE = 1 / 80
"""Inputs of a short campaign as share of those of a long one."""


def check_campaign(kind: Any, inputs: Any, jobs: int) -> None:
    """Run a campaign; fail if it has a finding, or if nearly all of its inputs are accepted or refused."""
    campaign = Campaign(kind)
    campaign.run(inputs, jobs)
    findings = [
        f"{line['category']} at {line['place']}, {line['times']} times: {line['detail']}\n"
        f"  --replay {kind}:{line['seed']}:{line['since']}-{line['number']} {bytes.fromhex(line.get('input', ''))!r}"
        for line in campaign.counted
    ]
    assert not findings, "\n".join(findings)
    assert campaign.done == inputs
    assert campaign.accepted_count > inputs // 50
    assert campaign.refused_count > inputs // 50


@pytest.fixture(autouse=True)
def time_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Extend the time limit of an input, because other work on the machine may slow it down."""
    monkeypatch.setenv("FUZZ_SLACK", "2.5")


@pytest.mark.slow
@pytest.mark.parametrize("kind", NAMES)
def test_short_campaign_has_no_finding(kind: Any) -> None:
    inputs = INPUTS.get(kind, DEFAULT_INPUTS)
    share = max(MIN_SHORT_INPUTS, round(inputs * SHORT_SHARE))
    check_campaign(kind, SHORT_INPUTS.get(kind, share), jobs=1)
