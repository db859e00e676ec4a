"""A program over a bag, without ROS: what the nodes give live, from the same messages."""

from .bags import BagError, BagReader, BagWriter, Record, Topic
from .playback import Output, Playback

__all__ = [
    "BagError",
    "BagReader",
    "BagWriter",
    "Output",
    "Playback",
    "Record",
    "Topic",
]
