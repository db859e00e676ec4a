"""Source files of the package, parsed once for all tests by ``docs/packages.py``."""

from pathlib import Path

from script_modules import load_script

ROOT = Path(__file__).resolve().parents[1]
packages = load_script(ROOT / "docs" / "packages.py")

SOURCE = packages.SOURCE

FILES = {module.path.relative_to(SOURCE).as_posix(): module for module in packages.MODULES.values()}
"""Each file, by its path below the package."""

TREES = {path: module.tree for path, module in FILES.items()}
"""The syntax tree of each file."""

NODES = {path: module.nodes for path, module in FILES.items()}
"""All nodes of that tree; walking all trees again takes the time of parsing them."""
