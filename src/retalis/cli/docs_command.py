"""Command ``docs``: opens the documentation site in the browser."""

import argparse
import sys
import webbrowser
from pathlib import Path
from typing import Callable

from ..foundation.errors import UsageError

SOURCE_SITE = Path("docs", "_build", "html")
"""Folder of the built site in the source tree."""

INSTALLED_SITE = Path("share", "retalis", "docs", "html")
"""Folder of the site below the root of an installation."""


def add_parser(add_command: Callable[..., argparse.ArgumentParser]) -> None:
    """Add the parser of command ``docs``."""
    parser = add_command(
        "docs",
        help="open the documentation in the browser",
        description="Open the documentation site in the browser. The site is part of the installed package; in a "
        "clone, ./install.py docs builds it. It needs no network. Exit status 1 if there is no site or no browser.",
    )
    parser.add_argument(
        "--print-path", action="store_true", help="print the path of the start page instead of opening it"
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command; return its exit status."""
    page = find_site() / "index.html"
    if options.print_path:
        print(page)
    elif not webbrowser.open(page.as_uri()):
        print(f"retalis docs: no browser can be started: open {page}", file=sys.stderr)
        return 1
    return 0


def find_site() -> Path:
    """Return the folder of the documentation site in the source tree or the installed package.

    Raises:
        UsageError: if it is in neither.
    """
    for root in Path(__file__).resolve().parents:
        for folder in (root / SOURCE_SITE, root / INSTALLED_SITE):
            if (folder / "index.html").is_file():
                return folder
    raise UsageError(
        "the documentation site is not built: run ./install.py docs in a clone of retalis; "
        "a wheel that is built afterwards contains the site"
    )
