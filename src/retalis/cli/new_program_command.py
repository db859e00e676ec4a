"""Command ``new``: creates a program with a first rule, a test, and launch files."""

import argparse
import sys
from pathlib import Path
from typing import Callable, Dict, List, Tuple

from ..events.program.topic_configuration import topic_type
from ..foundation.displayed_text import format_count, printable, quote_shortened
from ..foundation.errors import MessageError, UsageError
from ..messages.type_definition import Definition
from ..messages.type_registry import Definitions
from ..playback.bag_locations import open_bag
from .command_options import add_message_folders, message_folders
from .optional_ros_imports import installed_definitions
from .program_template import make_files, name_topics
from .stderr_reports import warnings_on_stderr

DESCRIPTION = """\
Create a folder with a program: its three files, with a rule for each topic that fires at once, a test that passes,
launch files for ROS 1 and ROS 2, and a file for CI. The topics are those of --from, by default a topic "chatter".
"""

MAX_TOPICS = 20
"""Maximum number of topics that are taken from a bag."""

_IGNORED_TOPICS = (
    "/rosout",
    "/rosout_agg",
    "/clock",
    "/parameter_events",
    "/diagnostics",
    "/diagnostics_agg",
)
"""Topics of the middleware, which a program seldom reads."""

_DEFAULT_TOPIC = "chatter:std_msgs/String"


def add_parser(add_command: Callable[..., argparse.ArgumentParser]) -> None:
    """Add the parser of command ``new``."""
    parser = add_command(
        "new", help="create a program with a first rule, a test, and launch files", description=DESCRIPTION
    )
    parser.add_argument(
        "folder", type=Path, metavar="NAME", help="folder to create; its name is the program's"
    )
    parser.add_argument(
        "--from",
        dest="sources",
        action="append",
        default=[],
        metavar="TOPIC:TYPE|BAG",
        help="a topic and its type, as scan:sensor_msgs/LaserScan, or a bag with topics",
    )
    add_message_folders(parser.add_argument)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command; return its exit status."""
    folder: Path = options.folder
    name = _check_name(folder)
    definitions = installed_definitions(message_folders(options))
    topics: List[Tuple[str, Definition]] = []
    for source in options.sources or [_DEFAULT_TOPIC]:
        topics += _read_source(source, definitions)
    # A topic that is named twice is subscribed once.
    unique_topics = list({topic.strip("/"): (topic, definition) for topic, definition in topics}.values())
    files = make_files(name, name_topics(unique_topics))
    _write_files(folder, files)
    print(f"created {folder}: {', '.join(files)}")
    print(f"next: retalis check {folder} && retalis test {folder}")
    return 0


def _check_name(folder: Path) -> str:
    name = folder.resolve().name
    if not (name.isascii() and name[:1].isalpha() and name.replace("_", "").replace("-", "").isalnum()):
        raise UsageError(
            f"{quote_shortened(name)} is not a valid name of a program: expected letters, digits, _ and -, "
            "with a letter first"
        )
    if folder.exists() and (not folder.is_dir() or any(map(_is_visible, folder.iterdir()))):
        raise UsageError(f"{folder} already exists: expected a new or an empty folder")
    return name


def _is_visible(path: Path) -> bool:
    """Return whether the name of a file is not hidden; the folder of a new repository has only `.git`."""
    return not path.name.startswith(".")


def _read_source(source: str, definitions: Definitions) -> List[Tuple[str, Definition]]:
    """Return the topics of a value of ``--from``."""
    if Path(source).exists():
        return _read_bag(Path(source), definitions)
    topic, separator, type_name = source.partition(":")
    if not separator:
        raise UsageError(
            f"--from {quote_shortened(source)}: expected TOPIC:PACKAGE/Type, or the path of a bag"
        )
    try:
        message_type = topic_type(topic, type_name)
        return [(message_type.topic, definitions.find(message_type.type))]
    except (UsageError, MessageError) as error:
        similar = definitions.misspelt(type_name)
        hint = f"; did you mean {similar}?" if similar else ""
        raise UsageError(f"--from {quote_shortened(source)}: {error.message}{hint}") from error


def _read_bag(path: Path, definitions: Definitions) -> List[Tuple[str, Definition]]:
    """Return the topics of a bag whose types are installed; others are reported.

    Raises:
        UsageError: if there are none.
    """
    topics: Dict[str, Definition] = {}
    with warnings_on_stderr(), open_bag(path) as bag:
        for topic in bag.topics:
            if topic.name in topics or topic.name in _IGNORED_TOPICS:
                continue
            try:
                topics[topic.name] = definitions.find(topic.type)
            except MessageError as error:
                print(
                    f"warning: {path}: topic {printable(topic.name)} is omitted: {error.message}; "
                    "--msg FOLDER adds types",
                    file=sys.stderr,
                )
    if not topics:
        raise UsageError(f"{path}: has no topic with a known type")
    if len(topics) > MAX_TOPICS:
        print(
            f"warning: {path}: {format_count(len(topics) - MAX_TOPICS, 'topic')} omitted: "
            f"at most {MAX_TOPICS} are taken",
            file=sys.stderr,
        )
    return sorted(topics.items())[:MAX_TOPICS]


def _write_files(folder: Path, files: Dict[str, str]) -> None:
    """Write the files.

    Raises:
        UsageError: if one exists, which a folder with hidden entries may have, or cannot be written.
    """
    for path in files:
        if (folder / path).exists():
            raise UsageError(f"{folder / path} already exists: expected a folder without it")
    try:
        for path, text in files.items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_text(text, encoding="utf-8")
    except OSError as error:
        raise UsageError(f"cannot write {error.filename}: {error.strerror}") from error
