"""Command ``help``: finds the operator, predicate or guide for a situation in words."""

import argparse
import sys
from typing import Callable

from .situations import find_situations, suggest_words

MAX_MATCHES = 10
"""Situations that are printed for a search."""

USAGE = """\
retalis help WORD ... finds the operator for a situation on a robot, by words that
describe it. All words must occur; their endings do not matter. For example:

  retalis help missing
  retalis help too many alerts
  retalis help last seen

The whole list is in docs/reference/situations.md. For the options of a command,
see retalis COMMAND --help; for predicates, the goal help(NAME) of retalis console."""


def add_parser(add_command: Callable[..., argparse.ArgumentParser]) -> None:
    """Add the command."""
    parser = add_command(
        "help",
        help="find the operator for a situation in words",
        description="Print the situations that have all of the words, each with the operator, predicate or command "
        "for it, an example and the page of the documentation. Exit status 1 if there are none.",
    )
    parser.add_argument(
        "words", nargs="*", metavar="WORD", help="words of the situation, such as missing message"
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    text = " ".join(options.words)
    if not text.strip():
        print(USAGE)
        return 0
    matches = find_situations(text)
    if not matches:
        near = suggest_words(text)
        hint = f"did you mean {' or '.join(near)}?" if near else "see docs/reference/situations.md"
        print(f"retalis help: no situation has all words of {text!r}: {hint}", file=sys.stderr)
        return 1
    for situation in matches[:MAX_MATCHES]:
        print(f"{situation.wish}")
        print(f"  take     {situation.take}")
        print(f"  example  {situation.example}")
        print(f"  page     docs/{situation.page}\n")
    if len(matches) > MAX_MATCHES:
        print(f"{len(matches) - MAX_MATCHES} more: add a word")
    return 0
