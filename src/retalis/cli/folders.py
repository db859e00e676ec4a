"""The options that say which files goals may open, besides those that a program opens while it is loaded."""

import argparse

from ..engine import Settings


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
