"""``--version``."""

import argparse
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

MANIFEST = Path(__file__).resolve().parents[3] / "package.xml"
"""Where the only version stands, as seen from the source tree."""


def version() -> str:
    """Return the version of this copy: the source tree's, or that of the installation."""
    if MANIFEST.exists():
        manifest = ElementTree.parse(MANIFEST).getroot()
        if manifest.findtext("name") == "retalis":
            return str(manifest.findtext("version"))
    from importlib import metadata  # noqa: PLC0415  takes 30 ms

    try:
        return metadata.version("retalis")
    except metadata.PackageNotFoundError:  # the folder alone was copied
        return "unknown"


class ShowVersion(argparse.Action):
    """Prints the version; looks for it then only."""

    def __init__(self, *names: Any, **options: Any):
        super().__init__(*names, **{**options, "nargs": 0})

    def __call__(self, parser: argparse.ArgumentParser, *arguments: Any) -> None:
        """Print it and end."""
        print(f"retalis {version()}")
        parser.exit()
