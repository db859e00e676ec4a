"""A program over a bag, without ROS: what the nodes give live, from the same messages."""

from .bags import BagError, BagReader, BagWriter, Record, Topic
from .looking import Line, RunLook, output_line, recorded
from .playback import Output, Playback
from .series import BagSeries

__all__ = [
    "BagError",
    "BagReader",
    "BagSeries",
    "BagWriter",
    "Line",
    "Output",
    "output_line",
    "Playback",
    "Record",
    "recorded",
    "RunLook",
    "Topic",
]
