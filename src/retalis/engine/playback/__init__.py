"""A program over a bag, without ROS: what the nodes give live, from the same messages."""

from .bags import BagError, BagReader, BagWriter, Record, Topic
from .decompression import MAX_CHUNK_MEGABYTES
from .looking import Line, RunLook, output_line
from .places import (
    FoundBag,
    fetched,
    find_bags,
    in_parts,
    is_folder_of_bags,
    is_there,
    is_url,
    remove_parts,
    result_file,
)
from .playback import Output, Playback
from .series import BagSeries, open_bag
from .tables import RunTable
from .workers import Unfinished, in_processes, on_cluster

__all__ = [
    "BagError",
    "BagReader",
    "BagSeries",
    "BagWriter",
    "fetched",
    "find_bags",
    "FoundBag",
    "in_parts",
    "in_processes",
    "is_folder_of_bags",
    "is_there",
    "is_url",
    "Line",
    "MAX_CHUNK_MEGABYTES",
    "on_cluster",
    "open_bag",
    "Output",
    "output_line",
    "Playback",
    "Record",
    "remove_parts",
    "result_file",
    "RunLook",
    "RunTable",
    "Topic",
    "Unfinished",
]
