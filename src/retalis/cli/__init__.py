"""The command line: ``retalis COMMAND``. Each command is a module with ``add_parser`` and ``run``;
those for a node that runs share one.
"""

import argparse
import os
import sys
from typing import List, Optional

from ..foundation import RetalisError
from . import bag, check, completion, console, demo, events, graph, live, msg, plot
from .printing import join_times
from .prompt import LEAVE, Lines, Terminal, read_clause
from .report import NobodyReads, leave
from .tables import report, status_page
from .version import ShowVersion

COMMANDS = (bag, check, console, demo, events, graph, live, msg, plot, completion)

__all__ = [
    "LEAVE",
    "Lines",
    "main",
    "read_clause",
    "report",
    "status_page",
    "Terminal",
]


def main(arguments: Optional[List[str]] = None) -> int:
    """Run a command; return its exit status: 0 done, 1 with errors, 2 wrongly called."""
    parser = argparse.ArgumentParser(
        prog="retalis",
        description="Event rules and a knowledge base for robots.",
        epilog="retalis COMMAND --help says what a command takes. The exit status is 0 where all went well, 1 with "
        "errors, 2 where a command is called wrongly, 130 after ctrl-C.",
    )
    parser.add_argument("--version", action=ShowVersion, help="print the version and exit")
    parser.set_defaults(whole=parser)
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for command in COMMANDS:
        command.add_parser(commands.add_parser)
    options = parser.parse_args(join_times(sys.argv[1:] if arguments is None else arguments))
    try:
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
