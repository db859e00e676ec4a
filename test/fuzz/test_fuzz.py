"""Some inputs of each kind; the command makes as many as one likes."""

import sys

import pytest

from fuzz.campaign import Campaign
from fuzz.kinds import NAMES

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
"""Of each kind 20,000, but where they take too long for that."""

USUAL = 20_000 if sys.version_info >= (3, 9) else 5000
"""Python 3.8 takes nearly twice as long."""

JOBS = 2


@pytest.mark.slow
@pytest.mark.parametrize("kind", NAMES)
def test_nothing_is_found(kind, monkeypatch):
    monkeypatch.setenv("FUZZ_SLACK", "2.5")  # other work on the machine makes all slower
    inputs = min(INPUTS.get(kind, USUAL), USUAL)
    campaign = Campaign(kind)
    campaign.run(inputs, JOBS)
    shown = [
        f"{line['what']} at {line['where']}, {line['times']} times: {line['detail']}\n"
        f"  --replay {kind}:{line['seed']}:{line['since']}-{line['number']} {bytes.fromhex(line.get('input', ''))!r}"
        for line in campaign.counted
    ]
    assert not shown, "\n".join(shown)
    assert campaign.done == inputs
    assert campaign.accepted_count > inputs // 50
    assert campaign.refused_count > inputs // 50
