"""Entry point of the command line: ``retalis COMMAND``.

A function of the command's module adds its parser, which contains the function that runs the command. Only the module
of the called command is imported, because the imports of all commands take longer than most of them run.
"""

import argparse
import os
import sys
from importlib import import_module
from pathlib import Path
from typing import Any, Callable, Dict, Iterable, List, Optional, Tuple
from xml.etree import ElementTree

from ..foundation.displayed_text import quote_shortened
from ..foundation.errors import RetalisError
from ..foundation.garbage_collection import stop_limiting_gc_pauses
from ..foundation.interrupts import EXIT_STATUS, interruptible
from ..foundation.output_files import GuardedOutput, OutputFailed
from ..foundation.similar_names import did_you_mean
from .option_values import join_times_option
from .short_help_parser import ShortHelpParser
from .stderr_reports import detach_reporters

AddParser = Callable[[Callable[..., argparse.ArgumentParser]], object]
"""Adds the parser of a command with the given function, which is the method ``add_parser`` of argparse."""

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
    "bag": "bag_command.add_parser",
    "check": "check_command.add_parser",
    "console": "console.add_parser",
    "demo": "demo_and_docs_commands.add_demo_parser",
    "diff": "diff_command.add_parser",
    "docs": "demo_and_docs_commands.add_docs_parser",
    "events": "event_stream_command.add_parser",
    "format": "format_command.add_parser",
    "graph": "drawing_commands.add_graph_parser",
    "help": "help_search.add_parser",
    "query": "node_client_options.add_parsers",
    "explain": "node_client_options.add_parsers",
    "list": "node_client_options.add_parsers",
    "status": "node_client_options.add_parsers",
    "watch": "node_client_options.add_parsers",
    "reload": "node_client_options.add_parsers",
    "lsp": "lsp_command.add_parser",
    "msg": "msg_command.add_parser",
    "new": "new_program_command.add_parser",
    "plot": "drawing_commands.add_plot_parser",
    "test": "program_test_command.add_parser",
    "complete": "completion.add_parser",
}
"""The module of each command, and its function that adds the parser of the command."""

_KEEP_ENGINE = frozenset(("bag", "console", "events", "plot"))
"""Commands that run an engine, or process its results, and are interrupted at safe points only."""

_NEEDS_ALL = "complete"
"""The command that needs the parsers of all others."""


def main(arguments: Optional[List[str]] = None) -> int:
    """Run a command; return its exit status: 0 for success, 1 for errors, 2 without a command, 130 after ctrl-C.

    Raises:
        SystemExit: with status 2 for other wrong usage, with 0 after ``--help`` and ``--version``.
    """
    output = sys.stdout
    sys.stdout = GuardedOutput(output, "standard output")
    status = None
    try:
        try:
            status = _run_command(sys.argv[1:] if arguments is None else arguments)
            return status
        finally:
            # Also after --help, which raises SystemExit. Text that is left would be written at exit, where an error
            # is a traceback. After ctrl-C, the reader of a pipe may not read any more.
            if status != EXIT_STATUS:
                sys.stdout.flush()
    except OutputFailed as failure:
        # A reader that has ended, such as `head`, is no error that the user needs to know.
        if not isinstance(failure.error, BrokenPipeError):
            print(f"retalis: {failure}", file=sys.stderr)
        try:
            output.flush()
        except OSError:
            # Python writes the text that is left in the buffer at exit, and would report the error again.
            os.dup2(os.open(os.devnull, os.O_WRONLY), output.fileno())
        return 1
    finally:
        sys.stdout = output


def make_parser(words: List[str]) -> Tuple[ShortHelpParser, Dict[str, ShortHelpParser]]:
    """Return the parser of a command line, and by name that of its command, or those of all if it has none."""
    parser = ShortHelpParser(
        prog="retalis",
        description="Event rules and a knowledge base for robots.",
        epilog="retalis COMMAND --help lists the options of a command. The exit status is 0 for success, 1 for "
        "errors, 2 for wrong usage, 130 after ctrl-C.",
    )
    parser.add_argument("--version", action=ShowVersion, help="print the version and exit")
    parser.set_defaults(root_parser=parser)
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    # argparse lists the subcommands in the order of their registration.
    for add_parser in import_commands(words):
        add_parser(commands.add_parser)
    for subparser in commands.choices.values():
        subparser.add_all_help()
    return parser, commands.choices


def _run_command(words: List[str]) -> int:
    """Run a command with its arguments; return its exit status."""
    try:
        parser, subparsers = make_parser(words)
        if not words:
            # argparse would print only the usage, without the commands.
            parser.print_help(sys.stderr)
            return 2
        name = words[0]
        if not name.startswith("-") and name not in COMMANDS:
            parser.error(f"there is no command {quote_shortened(name)}{did_you_mean(name, COMMANDS)}")
        options, unknown_words = parser.parse_known_args(join_times_option(words))
        if unknown_words:
            subparsers[options.command].reject_unknown(unknown_words)
        if options.command in _KEEP_ENGINE:
            status: int = options.run(options)
        else:
            # No engine is used after an interrupt of these commands.
            with interruptible():
                status = options.run(options)
        return status
    except RetalisError as error:
        print(f"retalis: {error}", file=sys.stderr)
        return error.exit_status
    except KeyboardInterrupt:
        return EXIT_STATUS
    finally:
        # A caller in the same process keeps its loggers and its garbage collector.
        detach_reporters()
        stop_limiting_gc_pauses()


def import_commands(words: List[str]) -> List[AddParser]:
    """Return the functions that add the parsers a command line needs, in the order of the help."""
    first = words[0] if words else ""
    paths: Iterable[str] = dict.fromkeys(COMMANDS.values())
    # All parsers are needed only for the general help, for an unknown command, and for completion.
    if first in COMMANDS and first != _NEEDS_ALL:
        paths = (COMMANDS[first],)
    elif first == "--version":
        paths = ()
    return [_import_function(path) for path in paths]


def _import_function(path: str) -> AddParser:
    module, _, name = path.partition(".")
    function: AddParser = getattr(import_module(f"{__package__}.{module}"), name)
    return function
