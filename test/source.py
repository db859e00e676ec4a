"""Source files of the package, parsed once for all tests by ``docs/packages.py``."""

import importlib.util
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_spec = importlib.util.spec_from_file_location("packages", str(ROOT / "docs" / "packages.py"))
packages = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(packages)

SOURCE = packages.SOURCE

FILES = {module.path.relative_to(SOURCE).as_posix(): module for module in packages.MODULES.values()}
"""Each file, by its path below the package."""

TREES = {path: module.tree for path, module in FILES.items()}
"""The syntax tree of each file."""

NODES = {path: module.nodes for path, module in FILES.items()}
"""All nodes of that tree; walking all trees again takes the time of parsing them."""
