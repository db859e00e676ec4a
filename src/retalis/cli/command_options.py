"""Options that several commands share."""

import argparse
from pathlib import Path
from typing import Callable, List, NamedTuple, Optional

from ..engine.engine import Engine
from ..engine.engine_settings import Settings
from ..events.program.topic_configuration import AUTO, DirectTopics, read_direct
from ..foundation.errors import UsageError
from ..messages.type_registry import Definitions
from ..prolog.machine.resource_limits import Limits
from .option_values import non_negative, positive_integer

_DEFAULT_MAX_MEGABYTES = 2000


class _LimitOption(NamedTuple):
    """An option for a resource limit, with the type and the default of its number; None for no limit."""

    name: str
    number_type: Callable[[str], float]
    default: Optional[int]
    help: str


_LIMIT_OPTIONS = (
    _LimitOption(
        "--max-seconds",
        float,
        None,
        "seconds for an event, goal or query, with everything that it starts (0)",
    ),
    _LimitOption("--max-inferences", int, None, "inferences of an event, goal or query (0)"),
    _LimitOption(
        "--max-megabytes",
        float,
        _DEFAULT_MAX_MEGABYTES,
        f"memory of an event, goal or query, in megabytes ({_DEFAULT_MAX_MEGABYTES})",
    ),
    _LimitOption(
        "--max-output-megabytes",
        float,
        None,
        "text on standard output and standard error, in megabytes (0)",
    ),
    _LimitOption(
        "--watchdog",
        float,
        None,
        "warn of longer events, goals and queries, with their rule; in seconds (0)",
    ),
)


AddArgument = Callable[..., argparse.Action]
"""The method ``add_argument`` of a parser, or of a group of its arguments."""


def add_limits(parser: argparse.ArgumentParser) -> None:
    """Add the options for resource limits, and ``--allow-swi``."""
    group = parser.add_argument_group(
        "limits and permissions",
        "A goal that exceeds a limit ends with a resource error, and the run continues; 0 means no limit. "
        "A megabyte is 1,000,000 bytes. "
        "Defaults are in brackets.",
    )
    for option in _LIMIT_OPTIONS:
        converter = non_negative(option.number_type)
        group.add_argument(option.name, type=converter, default=option.default, metavar="N", help=option.help)
    group.add_argument(
        "--max-depth",
        type=positive_integer,
        default=Settings().max_depth,
        metavar="N",
        help=f"maximum length of a chain of derived events ({Settings().max_depth})",
    )
    add_swi(group.add_argument)


def add_swi(add: AddArgument) -> None:
    """Add the option that lets a program use SWI-Prolog."""
    add(
        "--allow-swi",
        action="store_true",
        help="let the program have SWI-Prolog load files with use_swi/1",
    )


def apply_limits(settings: Settings, options: argparse.Namespace) -> Settings:
    """Return settings of an engine with the limits of the options."""
    limits = Limits(
        options.max_seconds or None,
        options.max_inferences or None,
        options.max_megabytes or None,
        options.max_output_megabytes or None,
    )
    return settings._replace(
        limits=limits,
        watchdog=options.watchdog or None,
        max_depth=options.max_depth,
        allow_swi=options.allow_swi,
    )


def add_folders(parser: argparse.ArgumentParser) -> None:
    """Add the options for folders in which goals may open files, and ``--answers``."""
    add = parser.add_argument_group("files").add_argument
    add(
        "--folder",
        action="append",
        default=[],
        metavar="FOLDER",
        help="a further folder in which goals may read files",
    )
    add(
        "--write-folder",
        action="append",
        default=[],
        metavar="FOLDER",
        help="a folder in which goals may write and read files; persistent events go into the first",
    )
    add_answers(add)


def add_answers(add: AddArgument) -> None:
    """Add the option for answers of ROS services and for ROS parameters."""
    add("--answers", type=Path, metavar="FILE", help="answers of ROS services and parameters (YAML)")


def connect_answers(options: argparse.Namespace, definitions: Definitions) -> Callable[[Engine], object]:
    """Return a function that provides an engine with the answers of the options.

    Raises:
        RetalisError: if the file is wrong.
    """
    if options.answers is None:
        return lambda engine: None
    # Few commands read YAML, whose import takes long.
    from ..testing.case_file import read_answers_file  # noqa: PLC0415
    from ..testing.offline_ros import OfflineRos  # noqa: PLC0415

    services, parameters = read_answers_file(options.answers)
    return OfflineRos(services, parameters, definitions).connect


def apply_folders(settings: Settings, options: argparse.Namespace) -> Settings:
    """Return settings of an engine with the folders of the options."""
    return settings._replace(folders=tuple(options.folder), write_folders=tuple(options.write_folder))


def add_direct(add: AddArgument) -> None:
    """Add the option that corresponds to parameter ``~direct`` of a node."""
    add(
        "--direct",
        type=_parse_direct,
        default=AUTO,
        metavar="TOPICS",
        help="topics that become events in addition to pub_sub.xml, as parameter ~direct of a node: auto (tf and "
        "ar_pose_marker if pub_sub.xml does not name them), true (both), false, or a list [topic, type, ...] (auto)",
    )


def _parse_direct(text: str) -> DirectTopics:
    try:
        return read_direct(text)
    except UsageError as error:
        raise argparse.ArgumentTypeError(error.message) from None


def add_end_of_input(parser: argparse.ArgumentParser, open_effect: str) -> None:
    """Add the options for windows and states that are open when the input ends.

    Args:
        parser: parser of the command.
        open_effect: effect of ``--open``, for its help.
    """
    add = parser.add_argument_group("end of the input").add_argument
    add(
        "--flush",
        type=non_negative(float),
        default=0.0,
        metavar="SECONDS",
        help="let the clock run on by this time at the end, so that windows, absent and states within it end (0)",
    )
    add(
        "--open",
        dest="prints_open",
        action="store_true",
        help=open_effect,
    )


OPEN_HELP = (
    "print at the end, in lines that start with %%, the declared states that are open, and the windows that have "
    "not ended with the number of their elements"
)
"""Help of ``--open`` for commands that print."""


def add_message_folders(add: AddArgument) -> None:
    """Add the option for folders of message definitions; `message_folders` returns them."""
    add(
        "--msg",
        type=Path,
        action="append",
        default=[],
        metavar="FOLDER",
        help="message types in addition to the installed ones: a package with a folder msg, srv or action, that "
        "folder itself, or a folder of packages",
    )


def message_folders(options: argparse.Namespace) -> List[str]:
    """Return the folders in which packages are searched.

    These are the folders of ``--msg``, or the parent of a folder ``msg``, ``srv`` or ``action``.
    """
    folders = [path.resolve() for path in options.msg]
    definition_folders = ("msg", "srv", "action")
    return [str(folder.parent if folder.name in definition_folders else folder) for folder in folders]


def add_chunk_limit_option(add: AddArgument) -> None:
    """Add the option that limits the decompressed size of chunks of bags."""
    from ..playback.decompression import MAX_CHUNK_MEGABYTES  # noqa: PLC0415 - only for commands that read bags

    add(
        "--max-chunk-megabytes",
        type=positive_integer,
        default=MAX_CHUNK_MEGABYTES,
        metavar="N",
        help="maximum unpacked size of a chunk or a compressed message of a bag; for a compressed file, the larger "
        f"of this and 100 times its size ({MAX_CHUNK_MEGABYTES})",
    )
