"""A fleet as a dataflow of Bytewax: an engine for each robot, which goes on where it was when all was killed."""

import json

import bytewax.operators as op
from bytewax.connectors.files import FileSink, FileSource
from bytewax.dataflow import Dataflow
from robot import Robot


class RobotLogic(op.StatefulBatchLogic):
    """What Bytewax has for each key: it is made with the last snapshot, if there is one, and asked for the next."""

    def __init__(self, state):
        self._robot = Robot(state)

    def on_batch(self, values):
        """Take events of this robot; return the outputs, and that the robot stays."""
        made = [one for event in values for one in self._robot.take(event["time"], event.get("event"))]
        return made, self.RETAIN

    def snapshot(self):
        """Return the state, which Bytewax keeps with the place in the stream."""
        return self._robot.snapshot()


def flow(events, outputs, batch=1000):
    """Return the dataflow from one file to the other, both of them JSON lines."""
    fleet = Dataflow("fleet")
    # By default the file is known by its disk's number, which is another one on the next machine.
    lines = op.input("read", fleet, FileSource(events, batch, get_fs_id=lambda folder: "any"))
    by_robot = op.key_on("by_robot", op.map("parse", lines, json.loads), lambda event: event["robot"])
    made = op.stateful_batch("engines", by_robot, RobotLogic)
    texts = op.map("write", made, lambda pair: (pair[0], json.dumps({"robot": pair[0], **pair[1]})))
    op.output("save", texts, FileSink(outputs))
    return fleet
