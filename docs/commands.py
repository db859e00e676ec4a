#!/usr/bin/env python3
"""Write docs/reference/commands.md from the parsers of the command line."""

import argparse
import sys
from pathlib import Path
from typing import Any, Collection, Dict, List

DOCS = Path(__file__).resolve().parent
sys.path.insert(0, str(DOCS.parent / "src"))

from retalis.cli.command_line import import_commands  # noqa: E402
from retalis.cli.node_client_options import DESCRIPTION  # noqa: E402

PAGE = DOCS / "reference" / "commands.md"

INTRODUCTION = """\
# Commands

For people who use the command `retalis`: all commands with their arguments and options, as
`retalis COMMAND --help-all` prints them. `retalis COMMAND --help` prints the frequent ones.

<!-- docs/commands.py writes this page. -->

The `setup.bash` of a workspace puts the command on `PATH`; `rosrun retalis retalis` is the same. In a
clone it is `PYTHONPATH=src python3 -m retalis`. `retalis --version` prints the version.

Labels such as `error:` are coloured on terminals, unless the environment variable `NO_COLOR` is set.

The exit status is 0 for success, 1 for errors, 2 for wrong usage, and 130 after ctrl-C, unless a
command states other values.

Without the option `--node`, the commands `query`, `explain`, `list`, `status`, `watch` and `reload` use
the only node, on ROS 1 in the namespace of `ROS_NAMESPACE`.
"""

HEADER = ["| argument | meaning |", "| --- | --- |"]

MIN_COMMON_CHARACTERS = 100
"""Length of the rows that stand in a table of their own if several commands have them."""

SEE_ALSO = """
**See also**: [a running node](running-node.md), [checks](checks.md), [how-to guides](../how-to/index.md).
"""


def command_parsers() -> Dict[str, argparse.ArgumentParser]:
    """Return the parser of each command, in the order of the help."""
    parser = argparse.ArgumentParser(prog="retalis")
    commands = parser.add_subparsers()
    for add_parser in import_commands([]):
        add_parser(commands.add_parser)
    parsers: Dict[str, argparse.ArgumentParser] = commands.choices
    return parsers


def page_text() -> str:
    """Return the text of ``docs/reference/commands.md``."""
    parsers = command_parsers()
    groups = [group for parser in parsers.values() for group in further_groups(parser)]
    tables = ["\n".join(table(group)) for group in groups]
    options = [row(action) for parser in parsers.values() for action in ungrouped_actions(parser)]
    common = {text for text in options if options.count(text) > 1 and len(text) > MIN_COMMON_CHARACTERS}
    shared = {group.title: text for group, text in zip(groups, tables) if tables.count(text) > 1}
    lines = [INTRODUCTION]
    for name, parser in parsers.items():
        lines += [
            f"## retalis {name}",
            "",
            # The introduction says this for all commands.
            escaped(str(parser.description).replace(DESCRIPTION, "")),
            "",
            f"`{usage(name, parser)}`",
            "",
        ]
        lines += rows(ungrouped_actions(parser), common)
        for group in further_groups(parser):
            title = str(group.title)
            if shared.get(group.title) == "\n".join(table(group)):
                lines += [f"Options of [{title}](#{title.replace(' ', '-')}).", ""]
            else:
                lines += [f"### {title.capitalize()} of retalis {name}", "", *table(group)]
        if parser.epilog:
            lines += ["```text", parser.epilog.rstrip(), "```", ""]
    lines += ["## Common options", "", *HEADER, *sorted(common), ""]
    for title, text in shared.items():
        lines += [f"## {str(title).capitalize()}", "", text]
    return "\n".join(lines).rstrip() + "\n" + SEE_ALSO


def actions(container: Any) -> List[argparse.Action]:
    """Return the arguments and options of a parser that its help shows, without ``--help``."""
    return [
        action for action in container._actions if action.help != argparse.SUPPRESS and action.dest != "help"
    ]


def further_groups(parser: argparse.ArgumentParser) -> List[Any]:
    """Return the groups of options that a parser adds to those of argparse."""
    return [group for group in getattr(parser, "_action_groups")[2:] if members(group)]  # noqa: B009


def members(group: Any) -> List[argparse.Action]:
    """Return the options of a group."""
    options: List[argparse.Action] = getattr(group, "_group_actions")  # noqa: B009
    return options


def ungrouped_actions(parser: argparse.ArgumentParser) -> List[argparse.Action]:
    """Return the arguments and options that belong to no further group."""
    grouped = [action for group in further_groups(parser) for action in members(group)]
    return [action for action in actions(parser) if action not in grouped]


def usage(name: str, parser: argparse.ArgumentParser) -> str:
    """Return how a command is called."""
    own = actions(parser)
    words = [f"retalis {name}"]
    if any(action.option_strings for action in own):
        words.append("[OPTION ...]")
    words += [positional(action) for action in own if not action.option_strings]
    return " ".join(words)


def positional(action: argparse.Action) -> str:
    """Return a positional argument as in a usage line."""
    forms = {"?": "[{0}]", "*": "[{0} ...]", "+": "{0} [{0} ...]"}
    return forms.get(str(action.nargs), "{0}").format(value_name(action))


def value_name(action: argparse.Action) -> str:
    """Return the placeholder of a value."""
    if action.metavar is not None:
        return str(action.metavar)
    if action.choices is not None:
        return "{" + ",".join(map(str, action.choices)) + "}"
    return action.dest.upper() if action.option_strings else action.dest


def call_form(action: argparse.Action) -> str:
    """Return an option with its value, or the name of an argument."""
    if not action.option_strings or action.nargs == 0:
        return ", ".join(action.option_strings) or value_name(action)
    value = value_name(action)
    if action.nargs == "?":
        value = f"[{value}]"
    return ", ".join(action.option_strings) + f" {value}"


def table(group: Any) -> List[str]:
    """Return the lines of a group of options."""
    description = [escaped(group.description), ""] if group.description else []
    return [*description, *rows(members(group))]


def rows(own: List[argparse.Action], common: Collection[str] = ()) -> List[str]:
    """Return the table of arguments or options; those in `common` refer to their table."""
    if not own:
        return []
    texts = map(row, own)
    reference = "see [common options](#common-options)"
    return [
        *HEADER,
        *(f"{text.split(' | ')[0]} | {reference} |" if text in common else text for text in texts),
        "",
    ]


def row(action: argparse.Action) -> str:
    """Return the row of an argument or option."""
    text = (action.help or "") % {"default": action.default, "prog": "retalis"}
    form = call_form(action).replace("|", "\\|")
    return f"| `{form}` | {escaped(text)} |"


def escaped(text: str) -> str:
    """Return a text of the help as Markdown in one line."""
    text = " ".join(text.split())
    for character in "\\*_<>|`~":
        text = text.replace(character, "\\" + character)
    return text


if __name__ == "__main__":
    PAGE.write_text(page_text(), encoding="utf-8")
