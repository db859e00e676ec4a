"""Fixture of the tests of the cookbook."""

from pathlib import Path
from types import ModuleType

import pytest
from script_modules import load_script

COOKBOOK = Path(__file__).resolve().parents[2] / "examples" / "cookbook"


@pytest.fixture(scope="module")
def recipes() -> ModuleType:
    """Return the script that writes the bags; it is not imported by name, which the script of the NAO also has."""
    return load_script(COOKBOOK / "make_bag.py", "cookbook_make_bag")
