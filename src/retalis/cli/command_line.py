"""Entry point of the command line: ``retalis COMMAND``.

Each command is a module with ``add_parser`` and ``run``; the commands for running nodes share one. Only the module of
the called command is imported, because the imports of all commands take longer than most of them run.
"""

import argparse
import os
import sys
from importlib import import_module
from pathlib import Path
from typing import Any, Iterable, List, Optional
from xml.etree import ElementTree

from ..foundation.errors import RetalisError
from .option_values import join_times_option
from .stderr_report import OutputClosed, detach_reporters

MANIFEST = Path(__file__).resolve().parents[3] / "package.xml"
"""Manifest in the source tree, which contains the version."""


def version() -> str:
    """Return the version of the source tree, or of the installation."""
    if MANIFEST.exists():
        manifest = ElementTree.parse(MANIFEST).getroot()
        if manifest.findtext("name") == "retalis":
            return str(manifest.findtext("version"))
    # Without a manifest this is an installed copy, whose version is in its metadata.
    from importlib import metadata  # noqa: PLC0415  takes 30 ms

    try:
        return metadata.version("retalis")
    except metadata.PackageNotFoundError:
        # The folder alone was copied.
        return "unknown"


class ShowVersion(argparse.Action):
    """Action that prints the version.

    argparse's own action needs the version in advance, and reading it takes too long for each command.
    """

    def __init__(self, *names: Any, **options: Any):
        super().__init__(*names, **{**options, "nargs": 0})

    def __call__(self, parser: argparse.ArgumentParser, *arguments: Any) -> None:
        """Print the version and exit."""
        print(f"retalis {version()}")
        parser.exit()


COMMANDS = {
    "bag": "bag_command",
    "check": "check_command",
    "console": "console",
    "demo": "demo_command",
    "docs": "docs_command",
    "events": "event_stream_command",
    "graph": "graph_command",
    "help": "help_command",
    "query": "node_commands",
    "explain": "node_commands",
    "list": "node_commands",
    "status": "node_commands",
    "watch": "node_commands",
    "reload": "node_commands",
    "msg": "msg_command",
    "plot": "plot_command",
    "complete": "completion",
}
"""The module of each command."""

_NEEDS_ALL = "complete"
"""The command that needs the parsers of all others."""


def main(arguments: Optional[List[str]] = None) -> int:
    """Run a command; return its exit status: 0 for success, 1 for errors, 130 after ctrl-C.

    Raises:
        SystemExit: with status 2 for wrong usage, with 0 after ``--help`` and ``--version``.
    """
    words = sys.argv[1:] if arguments is None else arguments
    parser = argparse.ArgumentParser(
        prog="retalis",
        description="Event rules and a knowledge base for robots.",
        epilog="retalis COMMAND --help lists the options of a command. The exit status is 0 for success, 1 for "
        "errors, 2 for wrong usage, 130 after ctrl-C.",
    )
    parser.add_argument("--version", action=ShowVersion, help="print the version and exit")
    parser.set_defaults(whole=parser)
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    try:
        # argparse lists the subcommands in the order of their registration.
        for module in import_commands(words):
            module.add_parser(commands.add_parser)
        options = parser.parse_args(join_times_option(words))
        status: int = options.run(options)
        return status
    except RetalisError as error:
        print(f"retalis: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    except (BrokenPipeError, OutputClosed):
        # The reader of the output has closed the pipe. Python flushes stdout at exit, and would report the error.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    finally:
        detach_reporters()


def import_commands(words: List[str]) -> List[Any]:
    """Return the modules whose parsers a command line needs, in the order of the help."""
    first = words[0] if words else ""
    names: Iterable[str] = dict.fromkeys(COMMANDS.values())
    # All parsers are needed only for the general help, for an unknown command, and for completion.
    if first in COMMANDS and first != _NEEDS_ALL:
        names = (COMMANDS[first],)
    elif first == "--version":
        names = ()
    return [import_module(f"{__package__}.{name}") for name in names]
