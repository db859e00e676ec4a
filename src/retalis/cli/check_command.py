"""Command ``check``: reports errors and likely mistakes of a program before it runs."""

import argparse
import re
import sys
from collections import Counter
from pathlib import Path
from typing import Callable, Dict, List, Sequence

from ..editing.rule_verbalization import RuleReading, read_program
from ..engine.engine_settings import Settings
from ..engine.program_check import check_program
from ..events.checks.check_runner import ERROR, INFO, Finding
from ..events.checks.program_model import RecordedTopic
from ..events.language.rule_labels import rule_title
from ..foundation.displayed_text import format_count, printable
from ..foundation.errors import MessageError
from ..foundation.output_files import print_json
from ..messages.type_registry import Definitions
from ..playback.bag_locations import open_bag
from ..prolog.machine.resource_limits import Limits
from .command_options import (
    add_chunk_limit_option,
    add_direct,
    add_message_folders,
    add_swi,
    message_folders,
)
from .option_values import non_negative
from .optional_ros_imports import installed_definitions
from .stderr_reports import paint, warnings_on_stderr

_DEFAULT_MAX_SECONDS = 60
_MARKED_LETTER = re.compile(r"`[^`]*`|\*\*([A-Z])\*\*")

DESCRIPTION = """\
Load a program's folder as a node does, without ROS, or a file of rules, and report errors and likely mistakes, each
with its place and a suggestion. The exit status is 1 if there are errors; with --strict it is 2 if there are only
warnings. Message types come from the installation, from the bags of --bag and from the folders of --msg.
"""


def add_parser(add_command: Callable[..., argparse.ArgumentParser]) -> None:
    """Add the parser of command ``check``."""
    parser = add_command(
        "check",
        help="report errors and likely mistakes of a program, before it runs",
        description=DESCRIPTION,
    )
    add = parser.add_argument
    add(
        "folder",
        nargs="?",
        type=Path,
        default=Path(),
        metavar="FOLDER",
        help="the program's folder (the current one), or a file of rules",
    )
    add("--format", choices=("text", "json"), default="text", help="lines for people, or one JSON object")
    add("--json", action="store_const", const="json", dest="format", help="the same as --format json")
    add(
        "--explain",
        action="store_true",
        help="say first, in words, how rules and states are read",
    )
    add("--strict", action="store_true", help="exit with status 2 if there are warnings")
    add(
        "--bag",
        type=Path,
        action="append",
        default=[],
        metavar="BAG",
        help="a bag whose message types are added, whose topics are compared with those of pub_sub.xml, and whose "
        "rates with the spans of rules",
    )
    add = parser.add_argument_group("message types, limits and permissions").add_argument
    add_message_folders(add)
    add_direct(add)
    add_chunk_limit_option(add)
    add_swi(add)
    add(
        "--max-seconds",
        type=non_negative(float),
        default=_DEFAULT_MAX_SECONDS,
        metavar="N",
        help=f"seconds that each directive and goal of the program may take ({_DEFAULT_MAX_SECONDS}); 0 for no limit",
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command; return its exit status."""
    definitions = installed_definitions(message_folders(options))
    # Before the check: rules with field names cannot be checked without the types.
    recorded_topics = [
        topic
        for path in options.bag
        for topic in _add_types_of_bag(
            definitions, path, options.max_chunk_megabytes, message_folders(options)
        )
    ]
    settings = Settings(allow_swi=options.allow_swi, limits=Limits(options.max_seconds or None))
    findings = check_program(options.folder, definitions, options.direct, settings, tuple(recorded_topics))
    errors = sum(finding.severity == ERROR for finding in findings)
    infos = sum(finding.severity == INFO for finding in findings)
    warnings = len(findings) - errors - infos
    if options.format == "json":
        counts = {"errors": errors, "warnings": warnings, "infos": infos}
        content: Dict[str, object] = {}
        if options.explain:
            content["rules"] = [_reading_to_json(reading) for reading in read_program(str(options.folder))]
        content.update({"findings": [_finding_to_json(finding) for finding in findings], **counts})
        print_json(content)
    else:
        for reading in read_program(str(options.folder)) if options.explain else ():
            title = rule_title(reading.name, f"{reading.path}:{reading.line}")
            print(f"{printable(title)}\n{_plain_text(reading)}\n")
        for finding in findings:
            print(f"{paint(finding.severity, finding.severity, sys.stdout)}: {finding.problem}")
        counts_text = f"{_format_count(errors, 'error')}, {_format_count(warnings, 'warning')}"
        print(f"{printable(str(options.folder))}: {counts_text}")
    if errors:
        return 1
    return 2 if warnings and options.strict else 0


def _add_types_of_bag(
    definitions: Definitions, path: Path, max_chunk_megabytes: int, folders: Sequence[str]
) -> List[RecordedTopic]:
    """Add the message types of a bag, and return its topics; a malformed definition is reported and skipped."""
    with warnings_on_stderr(), open_bag(path, max_chunk_megabytes, folders) as bag:
        for topic in bag.topics:
            try:
                definitions.received(topic.type, topic.type, topic.definition, topic.md5sum)
            except MessageError as error:
                print(f"warning: {path}: topic {printable(topic.name)}: {error}", file=sys.stderr)
        counts = Counter({topic.name: 0 for topic in bag.topics})
        for topic in bag.topics:
            counts[topic.name] += topic.messages
        seconds = (bag.end - bag.start) / 10**9
        periods = {name: seconds / (count - 1) for name, count in counts.items() if count > 1}
        return [RecordedTopic(topic.name, topic.type, periods.get(topic.name)) for topic in bag.topics]


def _format_count(number: int, noun: str) -> str:
    return format_count(number, noun) if number else f"no {noun}s"


def _plain_text(reading: RuleReading) -> str:
    """Return a reading without the markup of letters; operands are in backquotes."""
    return printable(_MARKED_LETTER.sub(lambda match: match[1] or match[0], reading.text))


def _reading_to_json(reading: RuleReading) -> Dict[str, object]:
    return {
        "rule": reading.name,
        "file": reading.path,
        "line": reading.line,
        "text": _plain_text(reading),
    }


def _finding_to_json(finding: Finding) -> Dict[str, object]:
    place = finding.problem.place
    fields: Dict[str, object] = {
        "severity": finding.severity,
        "check": finding.check,
        "code": finding.problem.code,
        "message": printable(finding.problem.message),
    }
    if place is not None:
        fields.update(file=place.source, line=place.line, column=place.column, text=printable(place.text))
    return fields
