"""Search path of the Python processes that tests start."""

import os
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]


def python_path(*folders: Any) -> str:
    """Return ``PYTHONPATH`` for a process: the folders, the package, then the folders of this process.

    Packages such as rosbags may be in a folder that only ``PYTHONPATH`` names.
    """
    own_folders = filter(None, [os.environ.get("PYTHONPATH")])
    return os.pathsep.join(map(str, [*folders, ROOT / "src", *own_folders]))
