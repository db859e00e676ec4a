"""Run campaigns of random and mutated inputs: see README.md.

Usage (with ``test`` on the path): python -m fuzz [--kind KIND] [--inputs N] [--seed S] [--minutes M] [--jobs J]
"""

import argparse
import sys
from pathlib import Path
from typing import Any

from .campaign import Campaign, known_reason
from .kinds import NAMES


def arguments(argv: Any) -> Any:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="fuzz", description=__doc__.split("\n")[0])
    parser.add_argument(
        "--kind", action="append", choices=NAMES, help="may come several times; all by default"
    )
    parser.add_argument("--inputs", type=int, default=20_000, help="of each kind (default: %(default)s)")
    parser.add_argument("--first", type=int, default=0, help="number of the first input, to go on with a run")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=0, help="at most, for each kind")
    parser.add_argument("--jobs", type=int, default=1, help="processes at a time")
    parser.add_argument("--save", type=Path, metavar="DIR", help="a folder for the inputs of findings")
    parser.add_argument(
        "--replay", metavar="KIND:SEED:SINCE-NUMBER|KIND:FILE", help="inputs of a finding once more"
    )
    return parser.parse_args(argv)


def show(campaign: Any, save: Any = None) -> None:
    """Print the findings of a campaign; save their inputs."""
    print(
        f"{campaign.kind}: {campaign.done} inputs, {campaign.accepted_count} steps taken, "
        f"{campaign.refused_count} refused, "
        f"slowest {campaign.slowest:.2f} s, at most {campaign.peak} MB, {len(campaign.counted)} findings, "
        f"{len(campaign.known)} known",
        flush=True,
    )
    for number, line in enumerate(campaign.findings.values(), 1):
        cause = known_reason(line)
        if cause:
            print(f"  known: {line['category']} at {line['place']} ({line['times']} times): {cause}")
            continue
        print(f"  {line['category']} at {line['place']} ({line['times']} times): {line['detail']}")
        print(f"    --replay {line['kind']}:{line['seed']}:{line['since']}-{line['number']}")
        if "input" in line:
            data = bytes.fromhex(line["input"])
            print(f"    {data[:300]!r}", flush=True)
            if save is not None:
                folder = save / line["kind"]
                folder.mkdir(parents=True, exist_ok=True)
                (folder / f"{line['seed']}-{line['number']}-{number}").write_bytes(data)


def replay_campaign(text: str) -> Campaign:
    """Return the campaign of inputs that are named as ``show`` prints them."""
    kind, _, source = text.partition(":")
    seed, _, numbers = source.partition(":")
    since, _, number = numbers.partition("-")
    if not (seed.isdigit() and since.isdigit() and number.isdigit()):
        campaign = Campaign(kind)
        campaign.file(source)
        return campaign
    campaign = Campaign(kind, int(seed))
    campaign.replay(int(since), int(number))
    return campaign


def main(argv: Any) -> int:
    """Run the command line; return the number of findings, at most 100, as exit status."""
    options = arguments(argv)
    if options.replay:
        campaign = replay_campaign(options.replay)
        show(campaign)
        return min(len(campaign.counted), 100)
    finding_count = 0
    for kind in options.kind or NAMES:
        campaign = Campaign(kind, options.seed)
        campaign.run(options.inputs, options.jobs, options.minutes, options.first)
        show(campaign, options.save)
        finding_count += len(campaign.counted)
    return min(finding_count, 100)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
