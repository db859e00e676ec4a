#!/usr/bin/env python3
"""The same fleet as a job of Apache Flink on this machine. Flink requires Java and much disk space.

fleet_flink.py EVENTS OUTPUTS CHECKPOINTS [CHECKPOINT]    resumes from CHECKPOINT, one of CHECKPOINTS/*/chk-*
"""

import json
import sys
from pathlib import Path

from pyflink.common import Configuration, Types, WatermarkStrategy
from pyflink.common.serialization import Encoder
from pyflink.datastream import KeyedProcessFunction, StreamExecutionEnvironment
from pyflink.datastream.connectors.file_system import FileSink, FileSource, StreamFormat
from pyflink.datastream.state import ListStateDescriptor, ValueStateDescriptor

EVERY = 100
"""Number of events of a robot between two snapshots."""


class Robots(KeyedProcessFunction):
    """The robots of one worker.

    Flink does not notify functions in Python of checkpoints. Therefore the state of a robot is complete after each
    event: its last snapshot and the events since then.
    """

    def open(self, context):
        """Declare the state that Flink stores for each robot."""
        self._robots = {}
        self._snapshot = context.get_state(ValueStateDescriptor("snapshot", Types.PICKLED_BYTE_ARRAY()))
        self._since = context.get_list_state(ListStateDescriptor("since", Types.STRING()))

    def process_element(self, line, context):
        """Process a line with an event; yield lines with outputs."""
        name = json.loads(line)["robot"]
        if name not in self._robots:
            self._robots[name] = self._restored()
        robot, events = self._robots[name]
        made = take(robot, line)
        if events + 1 < EVERY:
            self._since.add(line)
            self._robots[name] = robot, events + 1
        else:
            self._snapshot.update(robot.snapshot())
            self._since.clear()
            self._robots[name] = robot, 0
        for output in made:
            yield json.dumps({"robot": name, **output})

    def _restored(self):
        """Return a robot restored in this process, and its number of events since the snapshot."""
        from robot import Robot  # noqa: PLC0415 - imported in the worker of Flink, not in the process that submits the job

        robot, lines = Robot(self._snapshot.value()), list(self._since.get())
        for line in lines:
            take(robot, line)  # its outputs have been sent before
        return robot, len(lines)


def take(robot, line):
    event = json.loads(line)
    return robot.take(event["time"], event.get("event"))


def main(events, outputs, checkpoints, resumed=None):
    """Run the job to the end of the events."""
    configuration = Configuration()
    for key, value in {
        "python.executable": sys.executable,
        "python.pythonpath": str(Path(__file__).resolve().parent),
        "python.fn-execution.bundle.time": "200",
        "execution.checkpointing.interval": "1s",
        "execution.checkpointing.dir": Path(checkpoints).resolve().as_uri(),
        "execution.checkpointing.externalized-checkpoint-retention": "RETAIN_ON_CANCELLATION",
        **({"execution.state-recovery.path": Path(resumed).resolve().as_uri()} if resumed else {}),
    }.items():
        configuration.set_string(key, value)
    job = StreamExecutionEnvironment.get_execution_environment(configuration)
    job.set_parallelism(1)
    files = FileSource.for_record_stream_format(
        StreamFormat.text_line_format(), Path(events).resolve().as_uri()
    )
    lines = job.from_source(files.build(), WatermarkStrategy.no_watermarks(), "events").uid("events")
    by_robot = lines.key_by(lambda line: json.loads(line)["robot"], key_type=Types.STRING())
    made = by_robot.process(Robots(), output_type=Types.STRING()).uid("robots")
    saved = FileSink.for_row_format(Path(outputs).resolve().as_uri(), Encoder.simple_string_encoder())
    made.sink_to(saved.build()).uid("outputs")
    job.execute("fleet")


if __name__ == "__main__":
    main(*sys.argv[1:])
