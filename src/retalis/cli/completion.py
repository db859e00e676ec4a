"""Command ``complete``: completion of command lines in bash, zsh and fish.

The script of a shell calls ``retalis complete words`` with the words before the cursor.

The candidates are derived from the parsers of all commands, so that a new command or option is completed without
further work. Names of nodes and memories are queried from running nodes.
"""

import argparse
from pathlib import Path
from typing import Callable, Dict, Iterable, List, Optional, Sequence

from ..foundation.errors import UsageError

SCRIPTS = {"bash": "retalis.bash", "zsh": "_retalis", "fish": "retalis.fish"}
"""Files of this folder by their shell; zsh loads a completion from a file of this name."""

_WORDS = "words"
"""Argument with which the scripts ask for candidates."""

NAME_CATEGORIES = {"node": "nodes", "wait_for": "memories"}
"""Category of the names that are values of an option, by the option's destination in the parsed options."""


class _Shells(List[str]):
    """Names of shells. The argument of the scripts is accepted, too, but not shown to users."""

    def __contains__(self, name: object) -> bool:
        return name == _WORDS or super().__contains__(name)


def add_parser(add_command: Callable[..., argparse.ArgumentParser]) -> None:
    """Add the parser of command ``complete``."""
    parser = add_command(
        "complete",
        help="print the completion of this command for a shell",
        description="Print a script with which a shell completes commands, options, and names of nodes and memories. "
        "In bash: source <(retalis complete bash). In zsh: source <(retalis complete zsh). In fish: retalis complete "
        "fish | source. For all new shells, add this line to ~/.bashrc, after compinit to ~/.zshrc, or to "
        "~/.config/fish/config.fish.",
    )
    parser.add_argument(
        "shell",
        nargs="?",
        choices=_Shells(SCRIPTS),
        default="bash",
        metavar="SHELL",
        help="bash (the default), zsh or fish",
    )
    parser.add_argument("words", nargs=argparse.REMAINDER, metavar="WORD", help=argparse.SUPPRESS)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command: print the script, or for ``words NUMBER WORD...`` the candidates for the word NUMBER.

    The script calls the second form. The first WORD is the name of the program.

    Raises:
        UsageError: if the arguments of ``words`` are malformed.
    """
    if options.shell in SCRIPTS:
        print(Path(__file__).with_name(SCRIPTS[options.shell]).read_text(encoding="utf-8"), end="")
        return 0
    # Without words, the number is an empty text, which is reported as invalid.
    number, *words = options.words or [""]
    if not number.isdecimal() or not 0 < int(number) <= len(words):
        raise UsageError("complete words: expected the number of a word, then the words of a command line")
    for word in list_candidates(options.root_parser, [*words, ""][1 : int(number) + 1], list_names):
        print(word)
    return 0


def list_names(category: str, node: Optional[str]) -> List[str]:
    """Return the names of nodes, or of a node's memories; none without ROS or without an answer."""
    try:
        # Imported only to complete names of nodes and memories.
        from .node_client_commands import list_completions  # noqa: PLC0415

        return list_completions(category, node)
    except UsageError:
        return []


def list_candidates(
    parser: argparse.ArgumentParser,
    words: Sequence[str],
    list_names: Callable[[str, Optional[str]], Iterable[str]],
) -> List[str]:
    """Return the candidates for the last of the words, by the parser and the words before it.

    Args:
        parser: parser of the whole command line.
        words: words after the name of the program; the last one is completed.
        list_names: returns names in running nodes; see the function of this name.
    """
    *previous, current = _remove_equals_signs(words)
    option_values: Dict[str, str] = {}
    open_option: Optional[argparse.Action] = None
    position = 0
    # The words are interpreted as argparse would do it, without requiring that the line is complete or correct.
    for word in previous:
        if open_option is not None:
            option_values[open_option.dest] = word
            open_option = None
        elif word.startswith("-"):
            name, _, value = word.partition("=")
            open_option = _find_option(parser, name)
            if open_option is not None and value:
                option_values[open_option.dest], open_option = value, None
        elif _get_subcommands(parser):
            if word not in _get_subcommands(parser):
                return []
            parser, position = _get_subcommands(parser)[word], 0
        else:
            position += 1
    name, equals_sign, value = current.partition("=")
    if open_option is None and equals_sign and _find_option(parser, name) is not None:
        open_option, current = _find_option(parser, name), value
    if open_option is None and current.startswith("-"):
        completions: Iterable[str] = _list_options(parser)
    else:
        action = open_option or _find_positional(parser, position)
        completions = (
            _list_options(parser) if action is None else _list_values(action, option_values, list_names)
        )
    return [word for word in completions if word.startswith(current)]


def _remove_equals_signs(words: Sequence[str]) -> List[str]:
    """Return the words without ``=`` of their own: bash splits ``--option=value`` into three words."""
    *previous, current = words
    return [*(word for word in previous if word != "="), "" if current == "=" else current]


def _find_option(parser: argparse.ArgumentParser, word: str) -> Optional[argparse.Action]:
    """Return the option that a word names; None if there is none, or if it takes no value."""
    for action in parser._actions:
        if word in action.option_strings and action.nargs != 0:
            return action
    return None


def _list_options(parser: argparse.ArgumentParser) -> List[str]:
    return [name for action in parser._actions for name in action.option_strings if name.startswith("--")]


def _find_positional(parser: argparse.ArgumentParser, position: int) -> Optional[argparse.Action]:
    """Return the positional argument at a position, without counting options; None if there is none."""
    actions = [action for action in parser._actions if not action.option_strings]
    if position < len(actions):
        return actions[position]
    # The last argument may take any number of values.
    return actions[-1] if actions and actions[-1].nargs in ("*", "+") else None


def _get_subcommands(parser: argparse.ArgumentParser) -> Dict[str, argparse.ArgumentParser]:
    """Return the parsers of the subcommands by name; none if the parser has no subcommands."""
    for action in parser._actions:
        if isinstance(action.choices, dict):
            return action.choices
    return {}


def _list_values(
    action: argparse.Action,
    option_values: Dict[str, str],
    list_names: Callable[[str, Optional[str]], Iterable[str]],
) -> Iterable[str]:
    if action.choices is not None:
        return [str(choice) for choice in action.choices]
    # Names in running nodes, if ROS is installed and a master answers.
    if action.dest in NAME_CATEGORIES:
        return list_names(NAME_CATEGORIES[action.dest], option_values.get("node"))
    return []
