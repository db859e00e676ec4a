"""The package's source, parsed once for all tests that look at it: by ``docs/house.py``, which draws the rooms."""

import importlib.util
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_spec = importlib.util.spec_from_file_location("house", str(ROOT / "docs" / "house.py"))
house = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(house)

SOURCE = house.SOURCE

TREES = {module.path.relative_to(SOURCE).as_posix(): module.tree for module in house.MODULES.values()}
"""The syntax tree of each file, by its path below the package."""
