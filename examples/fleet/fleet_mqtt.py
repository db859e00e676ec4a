#!/usr/bin/env python3
"""The fleet as a job of Apache Flink, from the log of `bridge.py` to files of outputs and to a broker of MQTT.

fleet_mqtt.py LOG RESULTS CHECKPOINTS HOST PORT [CHECKPOINT]    CHECKPOINT is a checkpoint or savepoint to resume from
"""

import sys
from pathlib import Path

from retalis.fleet.flink_job import (
    Options,
    create_environment,
    follow_log,
    publish_mqtt,
    run_robots,
    write_files,
)


def main(log, results, checkpoints, host, port, resume=None):
    """Run the job until it is stopped."""
    environment = create_environment(checkpoints, interval=1, resume=resume)
    options = Options(on_change="refuse")
    streams = run_robots(follow_log(environment, log, options), Path(__file__).resolve().parent, options)
    publish_mqtt(streams.outputs, host, int(port))
    for name, lines in streams._asdict().items():
        write_files(lines, Path(results) / name, name)
    environment.execute("fleet")


if __name__ == "__main__":
    main(*sys.argv[1:])
