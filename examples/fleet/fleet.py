#!/usr/bin/env python3
"""The fleet as a job of Apache Flink, from a file of events to files of outputs.

fleet.py EVENTS OUTPUTS CHECKPOINTS [CHECKPOINT]    CHECKPOINT is one of CHECKPOINTS/*/chk-* to resume from
"""

import sys
from pathlib import Path

from retalis.fleet.flink_job import create_environment, read_file, run_robots, write_files


def main(events, outputs, checkpoints, resume=None):
    """Run the job to the end of the events."""
    environment = create_environment(checkpoints, interval=1, resume=resume)
    streams = run_robots(read_file(environment, events), Path(__file__).resolve().parent)
    write_files(streams.outputs, Path(outputs) / "outputs", "outputs")
    write_files(streams.late, Path(outputs) / "late", "late")
    write_files(streams.failed, Path(outputs) / "failed", "failed")
    environment.execute("fleet")


if __name__ == "__main__":
    main(*sys.argv[1:])
