"""Parser of a command: a short help with the frequent options, a full one, and similar names in errors.

Arguments that belong to no group are frequent: ``--help`` shows them alone, in at most one screen; ``--help-all``
shows the groups, too.
"""

import argparse
import sys
from typing import IO, Any, List, NoReturn, Optional, Sequence

from ..foundation.displayed_text import quote_shortened
from ..foundation.similar_names import did_you_mean

_HELP_ALL = "--help-all"


class _ShortHelpFormatter(argparse.HelpFormatter):
    """Formatter that prints the value of an option once: ``-o, --output FILE``, which leaves room for the help."""

    def _format_action_invocation(self, action: argparse.Action) -> str:
        if not action.option_strings or action.nargs == 0:
            return super()._format_action_invocation(action)
        value = self._format_args(action, self._get_default_metavar_for_optional(action))
        return f"{', '.join(action.option_strings)} {value}"


class _ShowAllHelp(argparse.Action):
    """Action of ``--help-all``."""

    def __init__(self, option_strings: Sequence[str], dest: str, **options: Any):
        super().__init__(option_strings, argparse.SUPPRESS, nargs=0, default=argparse.SUPPRESS, **options)

    def __call__(self, parser: argparse.ArgumentParser, *arguments: Any) -> None:
        """Print the help and exit."""
        assert isinstance(parser, ShortHelpParser)
        parser.print_all_help(sys.stdout)
        parser.exit()


class ShortHelpParser(argparse.ArgumentParser):
    """Parser of a command.

    The first paragraph of the description is part of the short help, the rest and the epilog of the full one.
    """

    def __init__(self, *arguments: Any, **options: Any):
        super().__init__(*arguments, **options)
        self._words: List[str] = []
        self._shows_all = False

    def add_all_help(self) -> None:
        """Add ``--help-all`` if the full help has more than the short one."""
        has_further_text = self.epilog or "\n\n" in (self.description or "").strip()
        if has_further_text or any(group._group_actions for group in self._action_groups[2:]):
            self.add_argument(_HELP_ALL, action=_ShowAllHelp, help="show all options and exit")

    def format_usage(self) -> str:
        """Return the usage: positional arguments and required options, or all options in the full help."""
        if self._shows_all:
            return super().format_usage()
        shown = [action for action in self._actions if action.required or not action.option_strings]
        formatter = self._get_formatter()
        formatter.add_usage(self.usage, shown, [])
        return formatter.format_help().replace(self.prog, f"{self.prog} [options]", 1)

    def format_help(self) -> str:
        """Return the short help."""
        # Not the formatter of the full help, which keeps the line breaks of descriptions.
        formatter = _ShortHelpFormatter(self.prog)
        formatter.add_text((self.description or "").strip().split("\n\n")[0])
        # argparse creates these two groups, for arguments without a group.
        for group in (self._positionals, self._optionals):
            formatter.start_section(group.title)
            formatter.add_arguments(group._group_actions)
            formatter.end_section()
        if _HELP_ALL not in self._option_string_actions:
            formatter.add_text(self.epilog)
        return f"{self.format_usage()}\n{formatter.format_help()}"

    def _format_all_help(self) -> str:
        self._shows_all = True
        try:
            return super().format_help()
        finally:
            self._shows_all = False

    def print_all_help(self, file: IO[str]) -> None:
        """Print the full help."""
        file.write(self._format_all_help())

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse arguments, and remember them for `error`."""
        self._words = list(sys.argv[1:] if args is None else args)
        return super().parse_known_args(args, namespace)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Reject a value that is not one of an argument's choices, with a similar one."""
        if action.choices is not None and value not in action.choices:
            choices = list(map(str, action.choices))
            raise argparse.ArgumentError(
                action,
                f"expected {' or '.join(choices)}, found {quote_shortened(str(value))}"
                f"{did_you_mean(str(value), choices)}",
            )

    def reject_unknown(self, words: Sequence[str]) -> NoReturn:
        """Report the first argument that the command does not know, with the usage of the command."""
        self.error(self._describe_unknown_option(words) or f"unknown argument {quote_shortened(words[0])}")

    def error(self, message: str) -> NoReturn:
        """Print the usage and an error, and exit with status 2."""
        # A misspelt option is the cause of a missing one.
        if "required" in message:
            message = self._describe_unknown_option(self._words) or message
        super().error(message)

    def _describe_unknown_option(self, words: Sequence[str]) -> Optional[str]:
        names = [name for name in self._option_string_actions if name.startswith("--")]
        for word in words:
            option = word.partition("=")[0]
            if option == "--":
                return None
            if option.startswith("--") and not any(name.startswith(option) for name in names):
                return f"unknown option {quote_shortened(option)}{did_you_mean(option, names)}"
        return None
