"""The package's source, parsed once for all tests that look at it: by ``docs/house.py``, which draws the rooms."""

import importlib.util
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_spec = importlib.util.spec_from_file_location("house", str(ROOT / "docs" / "house.py"))
house = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(house)

SOURCE = house.SOURCE

FILES = {module.path.relative_to(SOURCE).as_posix(): module for module in house.MODULES.values()}
"""Each file, by its path below the package."""

TREES = {path: module.tree for path, module in FILES.items()}
"""The syntax tree of each file."""

NODES = {path: module.nodes for path, module in FILES.items()}
"""All nodes of that tree, for who looks for some: walking all trees takes as long as parsing them."""
