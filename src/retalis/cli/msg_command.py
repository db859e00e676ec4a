"""Command ``msg``: prints a message type as a term with the names of its slots, to paste into a program."""

import argparse
import sys
from pathlib import Path
from typing import Callable, Dict, List, Tuple

from ..foundation.displayed_text import printable
from ..foundation.errors import MessageError, UsageError
from ..foundation.output_files import print_json
from ..foundation.ros_name_checks import ros1_type_name, type_fault
from ..messages.message_templates import format_positional, format_with_names, format_with_zeros
from ..messages.type_definition import QUOTED_STRINGS, STRING_FORMS, Definition
from ..messages.type_registry import Definitions
from ..playback.bag_locations import open_bag
from .command_options import add_chunk_limit_option
from .node_status_tables import format_table
from .optional_ros_imports import installed_definitions
from .stderr_reports import warnings_on_stderr

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
        description="Print a message type as a term, with the names of its slots, or the topics and types of a bag.",
    )
    parser.add_argument(
        "type",
        nargs="?",
        metavar="PACKAGE/Type",
        help="for example sensor_msgs/LaserScan; without a type, the topics of --bag are printed with their types",
    )
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
    parser.add_argument(
        "--strings",
        choices=STRING_FORMS,
        default=QUOTED_STRINGS,
        help="form of strings with --format zero, as in pub_sub.xml: quoted (default) or plain",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    add_chunk_limit_option(parser.add_argument)
    parser.set_defaults(run=run, reject_usage=parser.error)


def run(options: argparse.Namespace) -> int:
    """Run the command; return its exit status."""
    if options.type is None:
        if options.bag is None:
            options.reject_usage("give a type as PACKAGE/Type, or --bag to list the types of a bag")
        _print_topics(options)
        return 0
    # Functors in programs have `__0__` in place of the slash; both forms are accepted.
    type_name = ros1_type_name(options.type.replace("__0__", "/"))
    definitions = installed_definitions().with_strings(options.strings)
    name_error = type_fault(type_name)
    if name_error is not None:
        raise UsageError(f"{name_error}{_suggest_type(definitions, type_name)}")
    if options.bag is not None:
        _add_types_of_bag(definitions, options.bag, type_name, options.max_chunk_megabytes)
    try:
        definition = definitions.find(type_name)
    except MessageError as error:
        parts = [f"{type_name}_{part}" for part in ("Request", "Response")]
        if all(part in definitions for part in parts):
            raise UsageError(f"{type_name} is a service: its messages are {' and '.join(parts)}") from error
        hint = "" if options.bag is not None else "; use --bag BAG to read it from a bag"
        raise UsageError(f"{error.message}{_suggest_type(definitions, type_name) or hint}") from error
    text = FORMATS[options.format](definition, definitions)
    if options.json:
        slots = [{"name": slot.name, "type": slot.describe()} for slot in definition.fields]
        content = {"type": definition.name, "md5sum": definition.md5sum, "slots": slots, "text": text}
        print_json(content)
    else:
        print(text, end="")
    return 0


def _print_topics(options: argparse.Namespace) -> None:
    """Print the topics of a bag with their types and numbers of messages, sorted by name."""
    message_counts: Dict[Tuple[str, str], int] = {}
    problems: Dict[Tuple[str, str], str] = {}
    with warnings_on_stderr(), open_bag(options.bag, options.max_chunk_megabytes) as bag:
        # A topic has a connection for each publisher.
        for topic in bag.topics:
            key = (topic.name, topic.type)
            message_counts[key] = message_counts.get(key, 0) + topic.messages
        for unreadable in bag.unreadable:
            problems[unreadable.name, unreadable.type] = unreadable.problem
    rows: List[Dict[str, object]] = [
        {"topic": name, "type": type_name, "messages": count}
        for (name, type_name), count in sorted(message_counts.items())
    ]
    unreadable_rows: List[Dict[str, object]] = [
        {"topic": name, "type": type_name, "problem": problem}
        for (name, type_name), problem in sorted(problems.items())
    ]
    if options.json:
        print_json({"topics": rows, "unreadable": unreadable_rows})
        return
    for line in format_table(rows):
        print(printable(line))
    for row in unreadable_rows:
        print(
            f"warning: {options.bag}: topic {printable(str(row['topic']))}: {row['problem']}", file=sys.stderr
        )


def _suggest_type(definitions: Definitions, type_name: str) -> str:
    """Return a suggestion of a similar type, to append to an error; "" if there is none."""
    similar = definitions.misspelt(type_name)
    return f"; did you mean {similar}?" if similar else ""


def _add_types_of_bag(definitions: Definitions, path: Path, type_name: str, max_chunk_megabytes: int) -> None:
    """Add the message types of a bag to the definitions.

    Raises:
        UsageError: if the definition of type ``type_name`` is malformed; malformed definitions of others are skipped.
    """
    with warnings_on_stderr(), open_bag(path, max_chunk_megabytes) as bag:
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
