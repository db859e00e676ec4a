"""A fleet as a dataflow of Bytewax: an engine per robot, which resumes from its snapshot after a crash."""

import json

import bytewax.operators as op
from bytewax.connectors.files import FileSink, FileSource
from bytewax.dataflow import Dataflow
from robot import Robot


class RobotLogic(op.StatefulBatchLogic):
    """State of a key in Bytewax: created from the last snapshot, if there is one."""

    def __init__(self, state):
        self._robot = Robot(state)

    def on_batch(self, values):
        """Process events of this robot; return the outputs, and the request to retain the state."""
        outputs = [
            output for event in values for output in self._robot.take(event["time"], event.get("event"))
        ]
        return outputs, self.RETAIN

    def snapshot(self):
        """Return the state, which Bytewax stores with the position in the stream."""
        return self._robot.snapshot()


def flow(events, outputs, batch=1000):
    """Return the dataflow from a file of events to a file of outputs, both JSON lines."""
    fleet = Dataflow("fleet")
    # By default the number of the disk identifies the file, and differs on another machine.
    lines = op.input("read", fleet, FileSource(events, batch, get_fs_id=lambda folder: "any"))
    by_robot = op.key_on("by_robot", op.map("parse", lines, json.loads), lambda event: event["robot"])
    by_output = op.stateful_batch("engines", by_robot, RobotLogic)
    texts = op.map("write", by_output, lambda pair: (pair[0], json.dumps({"robot": pair[0], **pair[1]})))
    op.output("save", texts, FileSink(outputs))
    return fleet
