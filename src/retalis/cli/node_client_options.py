"""Options of the commands for a running node: ``query``, ``list``, ``status``, ``explain``, ``watch``, ``reload``.

The commands themselves are in `node_client_commands`, which is imported only when a command is executed.
"""

import argparse
from typing import Callable

from .option_values import any_number, non_negative

AddCommand = Callable[..., argparse.ArgumentParser]

DESCRIPTION = (
    "The node is that of --node, or the only one that runs, on ROS 1 in the namespace of ROS_NAMESPACE."
)

EXIT_STATUS_HELP = "The exit status is 0 with a solution, 1 without one or with an error."


def add_parsers(add_command: AddCommand) -> None:
    """Add the parsers of all commands for nodes."""
    _add_query(add_command)
    explain = _add_node_command(add_command, "explain", "explain why an event happened in a node, or why not")
    explain.add_argument(
        "event", metavar="EVENT", help="a term, in which _ stands for any value, such as fever(bob,_)"
    )
    _add_node_command(add_command, "list", "list the rules, memories, subscriptions and queries of a node")
    status = _add_node_command(add_command, "status", "show the status of a node, updated periodically")
    status.add_argument(
        "--every",
        type=any_number,
        default=1.0,
        metavar="SECONDS",
        help="seconds between two updates, over which rates are averaged (1)",
    )
    status.add_argument(
        "--once",
        action="store_true",
        help="show it once, after --every seconds; default if the output is not a terminal",
    )
    _add_watch(add_command)
    _add_node_command(add_command, "reload", "make a node read its program again, completely or not at all")


def _add_query(add_command: AddCommand) -> None:
    query = _add_node_command(add_command, "query", "ask a goal of a node")
    query.description = f"{query.description} {EXIT_STATUS_HELP}"
    add = query.add_argument
    add("goal", metavar="GOAL", help="as in 'access_mem(odom,P,[T1,T2])'")
    add(
        "--most",
        dest="max_solutions",
        type=non_negative(int),
        metavar="N",
        default=100,
        help="solutions at most (100)",
    )
    add(
        "--seconds",
        type=non_negative(float),
        default=0.0,
        metavar="N",
        help="limit for the goal, besides the node's own",
    )
    add(
        "--inferences",
        type=non_negative(int),
        metavar="N",
        default=0,
        help="the same in inferences; 0 is no limit, for both (0)",
    )
    add(
        "--wait-for",
        action="append",
        default=[],
        metavar="MEMORY",
        help="wait until it has a record at --stamp or later",
    )
    add("--stamp", type=any_number, default=0.0, metavar="SECONDS", help="for --wait-for, since the epoch")
    add("--timeout", type=non_negative(float), default=10.0, metavar="SECONDS", help="how long to wait (10)")


def _add_watch(add_command: AddCommand) -> None:
    watch = _add_node_command(add_command, "watch", "print the outputs of a node as they are published")
    add = watch.add_argument
    add(
        "--event",
        action="append",
        default=[],
        metavar="PATTERN",
        help="print these events, too, with a temporary subscription",
    )
    add("--inputs", action="store_true", help="print the input events, too")
    add("--count", type=non_negative(int), metavar="N", default=0, help="stop after N lines; 0: never (0)")


def _add_node_command(add_command: AddCommand, name: str, summary: str) -> argparse.ArgumentParser:
    parser = add_command(name, help=summary, description=f"{summary[0].upper()}{summary[1:]}. {DESCRIPTION}")
    parser.add_argument("--node", metavar="/NAME", help="the node, if several are running")
    parser.add_argument("--json", action="store_true", help="print JSON, one value a line")
    parser.set_defaults(run=run)
    return parser


def run(options: argparse.Namespace) -> int:
    """Run a command for a running node."""
    # Not needed for the parsers, which completion imports.
    from . import node_client_commands  # noqa: PLC0415

    return node_client_commands.run(options)
