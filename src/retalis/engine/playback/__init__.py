"""A program over a bag, without ROS: what the nodes give live, from the same messages."""

from .bags import BagReader, BagWriter
from .playback import Output, Playback

__all__ = [
    "BagReader",
    "BagWriter",
    "Output",
    "Playback",
]
