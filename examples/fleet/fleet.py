#!/usr/bin/env python3
"""The fleet as a job of Apache Flink, from a file of events to files of results.

fleet.py EVENTS RESULTS CHECKPOINTS [CHECKPOINT]    CHECKPOINT is one of CHECKPOINTS/*/chk-* to resume from
"""

import sys
from pathlib import Path

from retalis.fleet.flink_job import create_environment, read_file, run_robots, write_files


def main(events, results, checkpoints, resume=None):
    """Run the job to the end of the events."""
    environment = create_environment(checkpoints, interval=1, resume=resume)
    streams = run_robots(read_file(environment, events), Path(__file__).resolve().parent)
    for name, lines in streams._asdict().items():
        write_files(lines, Path(results) / name, name)
    environment.execute("fleet")


if __name__ == "__main__":
    main(*sys.argv[1:])
