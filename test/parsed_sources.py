"""Source files of the package, parsed by ``docs/packages.py``: each at its first use, once for all tests."""

from pathlib import Path
from typing import Any, Iterator, Mapping

from script_modules import load_script

ROOT = Path(__file__).resolve().parents[1]
packages = load_script(ROOT / "docs" / "packages.py")

SOURCE = packages.SOURCE

FILES = {module.path.relative_to(SOURCE).as_posix(): module for module in packages.MODULES.values()}
"""Each file, by its path below the package."""


class ParsedFiles(Mapping[str, Any]):
    """An attribute of each file, by its path; reading it parses the file."""

    def __init__(self, attribute: str) -> None:
        self._attribute = attribute

    def __getitem__(self, path: str) -> Any:
        return getattr(FILES[path], self._attribute)

    def __iter__(self) -> Iterator[str]:
        return iter(FILES)

    def __len__(self) -> int:
        return len(FILES)


TREES = ParsedFiles("tree")
"""The syntax tree of each file."""

NODES = ParsedFiles("nodes")
"""All nodes of that tree; walking all trees again takes the time of parsing them."""
