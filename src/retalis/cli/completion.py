"""``complete``: what may come next on a command line, for a shell.

The parsers of all commands say it, so that a new command or option needs nothing here; names in nodes that run are
asked for.
"""

import argparse
from pathlib import Path
from typing import Callable, Dict, Iterable, List, Optional, Sequence

from ..foundation.errors import UsageError
from .node_commands import ros_module

SCRIPT = Path(__file__).with_name("retalis.bash")

NAMES = {"node": "nodes", "wait_for": "memories"}
"""Options whose values are names in ROS, and what they are names of."""


def add_parser(add_command: Callable[..., argparse.ArgumentParser]) -> None:
    """Add the command."""
    parser = add_command(
        "complete",
        help="print the completion of this command for bash",
        description="Print a script that has bash complete commands, options, and the names of nodes and memories. "
        "For this shell: source <(retalis complete bash). For all to come, write that line into ~/.bashrc.",
    )
    parser.add_argument(
        "shell",
        nargs="?",
        choices=("bash", "words"),
        default="bash",
        metavar="bash",
        help="the only one so far",
    )
    parser.add_argument("words", nargs=argparse.REMAINDER, metavar="WORD", help=argparse.SUPPRESS)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command: print the script, or for ``words NUMBER WORD...`` what the word of that number may be."""
    if options.shell == "bash":
        print(SCRIPT.read_text(encoding="utf-8"), end="")
        return 0
    number, *words = options.words or ["none"]
    if not number.isdecimal() or not 0 < int(number) <= len(words):
        raise UsageError("complete words: expected the number of a word, then the words of a command line")
    for word in candidates(options.whole, [*words, ""][1 : int(number) + 1], names):
        print(word)
    return 0


def names(kind: str, node: Optional[str]) -> List[str]:
    """Return the names of nodes, or of a node's memories; none where there is no ROS, or nothing answers."""
    try:
        found: List[str] = ros_module("live_commands").names(kind, node)
    except UsageError:
        return []
    return found


def candidates(
    parser: argparse.ArgumentParser,
    words: Sequence[str],
    names: Callable[[str, Optional[str]], Iterable[str]],
) -> List[str]:
    """Return what the last of the words may become; the others stand before it."""
    *before, current = _apart(words)
    given: Dict[str, str] = {}
    waiting: Optional[argparse.Action] = None
    place = 0
    for word in before:
        if waiting is not None:
            given[waiting.dest] = word
            waiting = None
        elif word.startswith("-"):
            waiting = _option(parser, word)
        elif _commands(parser):
            if word not in _commands(parser):
                return []
            parser, place = _commands(parser)[word], 0
        else:
            place += 1
    if waiting is None and current.startswith("-"):
        found: Iterable[str] = _options(parser)
    else:
        action = waiting or _positional(parser, place)
        found = _options(parser) if action is None else _values(action, given, names)
    return [word for word in found if word.startswith(current)]


def _apart(words: Sequence[str]) -> List[str]:
    """Return the words with ``--option = value``, as bash takes ``--option=value`` apart, in two."""
    *before, current = words
    return [*(word for word in before if word != "="), "" if current == "=" else current]


def _option(parser: argparse.ArgumentParser, word: str) -> Optional[argparse.Action]:
    """Return the option of a name where it waits for a value."""
    for action in parser._actions:
        if word in action.option_strings and action.nargs != 0:
            return action
    return None


def _options(parser: argparse.ArgumentParser) -> List[str]:
    return [name for action in parser._actions for name in action.option_strings if name.startswith("--")]


def _positional(parser: argparse.ArgumentParser, place: int) -> Optional[argparse.Action]:
    """Return what the word at a place is, options not counted; None where none is expected."""
    found = [action for action in parser._actions if not action.option_strings]
    if place < len(found):
        return found[place]
    return found[-1] if found and found[-1].nargs in ("*", "+") else None


def _commands(parser: argparse.ArgumentParser) -> Dict[str, argparse.ArgumentParser]:
    """Return the parsers of the commands; none where there are no commands."""
    for action in parser._actions:
        if isinstance(action.choices, dict):
            return action.choices
    return {}


def _values(
    action: argparse.Action,
    given: Dict[str, str],
    names: Callable[[str, Optional[str]], Iterable[str]],
) -> Iterable[str]:
    if action.choices is not None:
        return [str(choice) for choice in action.choices if choice != "words"]
    if action.dest in NAMES:
        return names(NAMES[action.dest], given.get("node"))
    return []
