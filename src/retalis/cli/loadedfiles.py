"""The files that a top level has loaded: loaded again, what they said before goes."""

import os
from pathlib import Path
from typing import Dict, List, Tuple

from ..engine import Engine, parts_of

_FileStates = Tuple[Tuple[str, int, int], ...]
"""Of each file that something was loaded from: name, time of its last change, size."""


class LoadedFiles:
    """Loads files and programs into an engine, each as often as somebody likes.

    Args:
        engine: takes what they say.
    """

    def __init__(self, engine: Engine):
        self._engine = engine
        self._stamps: Dict[Path, _FileStates] = {}

    def load(self, path: Path) -> List[str]:
        """Load a file, or the program in a folder, in place of what it said before; return what has changed.

        Raises:
            RetalisError: what is wrong; what was there before is there again.
        """
        again = path in self._stamps
        try:
            if again:
                return [f"{path} again", *(f"  {line}" for line in self._engine.reload(path))]
            self._engine.load_program(path)
            return []
        finally:
            if again or path.exists():
                self._stamps[path] = self._stamp(path)

    def changed(self) -> List[Path]:
        """Return what was loaded from files that are others now."""
        return [path for path, stamp in self._stamps.items() if self._stamp(path) != stamp]

    def _stamp(self, path: Path) -> _FileStates:
        made = parts_of(self._engine).programs.get(os.path.realpath(path))
        files = set() if made is None else {Path(file) for file in made.files}
        files |= set(path.iterdir()) if path.is_dir() else {path}
        return tuple(_stat(file) for file in sorted(files))


def _stat(path: Path) -> Tuple[str, int, int]:
    try:
        found = path.stat()
    except OSError:  # deleted
        return str(path), 0, 0
    return str(path), found.st_mtime_ns, found.st_size
