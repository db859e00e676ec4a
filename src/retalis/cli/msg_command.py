"""Command ``msg``: prints a message type as a term with the names of its slots, to paste into a program."""

import argparse
from pathlib import Path
from typing import Callable, Dict

from ..foundation.errors import MessageError, UsageError
from ..foundation.ros_names import ros1_type_name, type_fault
from ..messages.message_notation import format_positional, format_with_names, format_with_zeros
from ..messages.type_definition import Definition
from ..messages.type_registry import Definitions
from ..playback.bag_locations import open_bag
from .command_options import add_chunk_limit_option
from .optional_ros_imports import installed_definitions

FORMATS: Dict[str, Callable[[Definition, Definitions], str]] = {
    "term": lambda definition, definitions: format_positional(definition),
    "names": lambda definition, definitions: format_with_names(definition),
    "zero": format_with_zeros,
}


def add_parser(add_command: Callable[..., argparse.ArgumentParser]) -> None:
    """Add the parser of command ``msg``."""
    parser = add_command(
        "msg",
        help="print a message type as a term to paste into a program",
        description="Print a message type as a term, with the names of its slots.",
    )
    parser.add_argument("type", metavar="PACKAGE/Type", help="for example sensor_msgs/LaserScan")
    parser.add_argument(
        "--bag", type=Path, metavar="BAG", help="a bag that has the type, if it is not installed"
    )
    parser.add_argument(
        "--format",
        choices=sorted(FORMATS),
        default="term",
        help="term: a variable for each slot, slots as comments (default); names: slots by name; "
        "zero: a message with zeros, to publish",
    )
    add_chunk_limit_option(parser.add_argument)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command; return its exit status."""
    # Functors in programs have `__0__` in place of the slash; both forms are accepted.
    type_name = ros1_type_name(options.type.replace("__0__", "/"))
    definitions = installed_definitions()
    name_error = type_fault(type_name)
    if name_error is not None:
        raise UsageError(f"{name_error}{_suggest_type(definitions, type_name)}")
    if options.bag is not None:
        _add_types_of_bag(definitions, options.bag, type_name, options.max_chunk_megabytes)
    try:
        definition = definitions.find(type_name)
    except MessageError as error:
        hint = "" if options.bag is not None else "; use --bag BAG to read it from a bag"
        raise UsageError(f"{error.message}{_suggest_type(definitions, type_name) or hint}") from error
    print(FORMATS[options.format](definition, definitions), end="")
    return 0


def _suggest_type(definitions: Definitions, type_name: str) -> str:
    """Return a suggestion of a similar type, to append to an error; "" if there is none."""
    similar = definitions.misspelt(type_name)
    return f"; did you mean {similar}?" if similar else ""


def _add_types_of_bag(definitions: Definitions, path: Path, type_name: str, max_chunk_megabytes: int) -> None:
    """Add the message types of a bag to the definitions.

    Raises:
        UsageError: if the definition of type ``type_name`` is malformed; malformed definitions of others are skipped.
    """
    with open_bag(path, max_chunk_megabytes) as bag:
        for unreadable in bag.unreadable:
            if unreadable.type == type_name:
                raise UsageError(f"{path}: {unreadable.problem}")
        # Topics of the type come first, because definitions of other topics may contain it as the type of a slot.
        topics = sorted(bag.topics, key=lambda topic: topic.type != type_name)
        for topic in topics:
            try:
                definitions.add(topic.type, topic.definition, topic.md5sum)
            except MessageError as error:
                if topic.type == type_name:
                    raise UsageError(f"{path}: {error.message}") from error
