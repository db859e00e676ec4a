"""Options for the files that goals may open, and for the topics that a node subscribes by itself."""

import argparse

from ..engine import Settings
from ..events.program import AUTO, DirectTopics, read_direct
from ..foundation import UsageError


def add_folders(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument(
        "--folder",
        action="append",
        default=[],
        metavar="FOLDER",
        help="a further folder in which goals of events, streams and queries may read files",
    )
    parser.add_argument(
        "--write-folder",
        action="append",
        default=[],
        metavar="FOLDER",
        help="a folder in which goals may write and read files; persistent events go into the first",
    )


def allow_folders(settings: Settings, options: argparse.Namespace) -> Settings:
    """Return settings with the folders that the options name."""
    return settings._replace(folders=tuple(options.folder), write_folders=tuple(options.write_folder))


def add_direct(parser: argparse.ArgumentParser) -> None:
    """Add the option for what is parameter ``~direct`` in a node."""
    parser.add_argument(
        "--direct",
        type=_direct,
        default=AUTO,
        metavar="TOPICS",
        help="the topics that a node subscribes by itself, as its parameter ~direct says: auto (tf and "
        "ar_pose_marker if pub_sub.xml does not name them), true (both), false, or a list [topic, type, ...] (auto)",
    )


def _direct(text: str) -> DirectTopics:
    try:
        return read_direct(text)
    except UsageError as error:
        raise argparse.ArgumentTypeError(error.message) from None
