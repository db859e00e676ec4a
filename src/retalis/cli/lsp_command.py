"""Command ``lsp``: the language server for editors."""

import argparse
from typing import Callable, Dict, List

from ..editing.language_features import PredicateHelp
from ..engine.engine_settings import Settings
from ..foundation.errors import UsageError
from ..prolog.machine.resource_limits import Limits
from .command_line import version
from .command_options import add_message_folders, message_folders
from .help_search import all_entries, docs_folder
from .option_values import non_negative
from .optional_ros_imports import installed_definitions

_DEFAULT_MAX_SECONDS = 5
_ERRORS_PAGE = "reference/errors.md"

DESCRIPTION = """\
Serve an editor by the Language Server Protocol on standard input and output: errors and likely mistakes while you
type, completion, explanations, definitions, references, renaming and formatting. The editor starts the command. Goals
and directives of a program are called for its check, as by the command check. It needs the Python package pygls.
"""


def add_parser(add_command: Callable[..., argparse.ArgumentParser]) -> None:
    """Add the parser of command ``lsp``."""
    parser = add_command(
        "lsp", help="serve an editor by the Language Server Protocol", description=DESCRIPTION
    )
    add_message_folders(parser.add_argument)
    parser.add_argument(
        "--max-seconds",
        type=non_negative(float),
        default=_DEFAULT_MAX_SECONDS,
        metavar="N",
        help=f"seconds that each directive and goal of a program may take ({_DEFAULT_MAX_SECONDS}); 0 for no limit",
    )
    # Editors add it to the commands of language servers.
    parser.add_argument("--stdio", action="store_true", help="the default, for editors that name it")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command; return its exit status.

    Raises:
        UsageError: if pygls is not installed.
    """
    try:
        from ..editing.language_server import ServerSettings, serve  # noqa: PLC0415  needs pygls
    except ImportError as error:
        raise UsageError("lsp: needs the Python package pygls (pip install 'retalis[lsp]')") from error
    pages = _error_pages()
    serve(
        ServerSettings(
            version(),
            installed_definitions(message_folders(options)),
            _predicate_help(),
            Settings(limits=Limits(options.max_seconds or None)),
            lambda code: pages.get(code, ""),
        )
    )
    return 0


def _predicate_help() -> Dict[str, List[PredicateHelp]]:
    """Return the documentation of the built-in predicates by their names; empty if it is not installed."""
    predicates: Dict[str, List[PredicateHelp]] = {}
    if docs_folder() is not None:
        for entry in all_entries():
            if entry.kind == "predicate":
                name = entry.title.partition("(")[0].strip()
                predicates.setdefault(name, []).append(PredicateHelp(entry.title, entry.excerpt, entry.page))
    return predicates


def _error_pages() -> Dict[str, str]:
    """Return the addresses of the sections about errors and warnings by their codes."""
    folder = docs_folder()
    if folder is None or not (folder / _ERRORS_PAGE).is_file():
        return {}
    page = folder / _ERRORS_PAGE
    addresses = {}
    for line in page.read_text(encoding="utf-8").splitlines():
        if line.startswith("### RT"):
            heading = line[4:]
            letters = (char for char in heading.lower() if char.isalnum() or char in " -_")
            addresses[heading.partition(":")[0]] = f"{page.as_uri()}#{''.join(letters).replace(' ', '-')}"
    return addresses
