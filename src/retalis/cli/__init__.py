"""The command line: ``retalis COMMAND``. Each command is a module with ``add_parser`` and ``run``;
those for a node that runs share one. Only the module of the command that is called is imported.
"""

import argparse
import os
import sys
from importlib import import_module
from typing import Any, Iterable, List, Optional

from ..foundation import RetalisError
from .numbers import join_times
from .report import NobodyReads, leave
from .version import ShowVersion

COMMANDS = {
    "bag": "bag",
    "check": "check",
    "console": "console",
    "demo": "demo",
    "events": "events",
    "graph": "graph",
    "query": "live",
    "explain": "live",
    "list": "live",
    "status": "live",
    "watch": "live",
    "reload": "live",
    "msg": "msg",
    "plot": "plot",
    "complete": "completion",
}
"""The module of each command."""

_NEEDS_ALL = "complete"
"""The command that looks through the parsers of all others."""

__all__ = ["import_commands", "main", "prompt", "tables"]


def main(arguments: Optional[List[str]] = None) -> int:
    """Run a command; return its exit status: 0 done, 1 with errors, 2 wrongly called."""
    words = sys.argv[1:] if arguments is None else arguments
    parser = argparse.ArgumentParser(
        prog="retalis",
        description="Event rules and a knowledge base for robots.",
        epilog="retalis COMMAND --help says what a command takes. The exit status is 0 where all went well, 1 with "
        "errors, 2 where a command is called wrongly, 130 after ctrl-C.",
    )
    parser.add_argument("--version", action=ShowVersion, help="print the version and exit")
    parser.set_defaults(whole=parser)
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    try:
        for module in import_commands(words):
            module.add_parser(commands.add_parser)
        options = parser.parse_args(join_times(words))
        status: int = options.run(options)
        return status
    except RetalisError as error:
        print(f"retalis: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    except (BrokenPipeError, NobodyReads):  # whoever read our output has had enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or Python complains at its end
        return 1
    finally:
        leave()


def import_commands(words: List[str]) -> List[Any]:
    """Return the modules of the commands that the parser of a command line needs, in the order of the help."""
    first = words[0] if words else ""
    names: Iterable[str] = dict.fromkeys(COMMANDS.values())
    if first in COMMANDS and first != _NEEDS_ALL:
        names = (COMMANDS[first],)
    elif first == "--version":
        names = ()
    return [import_module(f"{__name__}.{name}") for name in names]
