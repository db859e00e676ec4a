"""Some inputs of each kind; the command makes as many as one likes."""

import pytest

from fuzz.campaign import Campaign
from fuzz.kinds import NAMES

INPUTS = 20_000
JOBS = 2


@pytest.mark.parametrize("kind", NAMES)
def test_nothing_is_found(kind):
    campaign = Campaign(kind)
    campaign.run(INPUTS, JOBS)
    shown = [
        f"{line['what']} at {line['where']}, {line['times']} times: {line['detail']}\n"
        f"  --replay {kind}:{line['seed']}:{line['since']}-{line['number']} {bytes.fromhex(line.get('input', ''))!r}"
        for line in campaign.counted
    ]
    assert not shown, "\n".join(shown)
    assert campaign.done == INPUTS
    assert campaign.taken > INPUTS // 50
    assert campaign.refused > INPUTS // 50
