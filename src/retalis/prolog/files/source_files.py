"""Source files: resolution of file names, loaded files, and modules.

Names in ``use_module/1``, ``ensure_loaded/1``, ``consult/1`` and ``include/1`` are relative to the file that contains
them, or to the program's folder for goals.
"""

import os
from contextlib import contextmanager
from pathlib import Path
from typing import Dict, Iterable, Iterator, List, Optional, Set, Tuple, Union

from ...foundation.errors import UsageError
from ..terms.types import Term
from .file_sandbox import FileSandbox, check_name
from .library_names import file_name

_OPTIONAL_SUFFIXES = (".pl", ".prolog", ".pro")
"""Suffixes that may be omitted in names of files."""


class SourceFiles:
    """Files of a program.

    Attributes:
        sandbox: opens the files.
        loaded: files that have been loaded or are being loaded.
        omitted: number of omitted terms, by file.
        modules: names of modules, by file.
    """

    def __init__(self) -> None:
        self.sandbox = FileSandbox()
        self.loaded: Set[Path] = set()
        self.omitted: Dict[str, int] = {}
        self._is_reload = False
        self.modules: Dict[Path, str] = {}
        self._base_folder: Optional[Path] = None
        self._open_files: List[Path] = []

    @contextmanager
    def loading(self, folder: Optional[Path] = None) -> Iterator[None]:
        """Grant the permissions of the program's own files; relative paths start in ``folder``."""
        with self.sandbox.loading(), self.relative_to(folder):
            yield

    @contextmanager
    def relative_to(self, folder: Optional[Path]) -> Iterator[None]:
        """Make relative paths start in a folder."""
        outer_folder = self._base_folder
        if folder is not None:
            self._base_folder = Path(folder)
        try:
            yield
        finally:
            self._base_folder = outer_folder

    @contextmanager
    def reloading(self, previous_counts: Dict[str, int]) -> Iterator[None]:
        """Reject files with more omitted terms than before, for a reload."""
        self.omitted, self._is_reload = dict(previous_counts), True
        try:
            yield
        finally:
            self._is_reload = False

    def max_omitted(self, source: str) -> Optional[int]:
        """Return the maximum number of omitted terms of a file; None for any number."""
        return self.omitted.get(source, 0) if self._is_reload else None

    def record_omitted(self, source: str, count: int) -> None:
        """Record the number of omitted terms of a file."""
        self.omitted.pop(source, None)
        if count:
            self.omitted[source] = count

    def resolve(self, name: Union[str, "os.PathLike[str]"]) -> Path:
        """Return a path relative to the file that contains the name, or to the base folder of goals.

        Raises:
            PrologError: a permission error if the path leads out of the permitted folders, other errors for an
                invalid name.
        """
        check_name(str(name))
        path = (self.sandbox.base_folder if self._base_folder is None else self._base_folder) / Path(name)
        self.sandbox.resolve_readable(str(path), str(name))
        return path

    def find(self, name: Term) -> Path:
        """Return the path of a file that a program names; the suffix ``.pl`` may be omitted.

        Raises:
            PrologError: if the name is invalid or leads out of the permitted folders.
        """
        written_name = file_name(name)
        path = self.resolve(written_name)
        # The exact name has priority over the name with a suffix, as in SWI-Prolog.
        if self.sandbox.is_file(str(path), written_name):
            return path
        suffixes = [
            suffix for suffix in _OPTIONAL_SUFFIXES if self.sandbox.is_file(f"{path}{suffix}", written_name)
        ]
        return Path(f"{path}{suffixes[0]}") if suffixes else path

    def is_file(self, path: Path) -> bool:
        """Return whether a file exists; raises the errors of `resolve`."""
        return self.sandbox.is_file(str(path), str(path))

    def text(self, path: Path) -> str:
        """Return the text of a file.

        Raises:
            PrologError: a permission, existence or resource error.
            UsageError: if the file cannot be read.
        """
        return self.sandbox.read(str(path), str(path))

    @property
    def innermost_file(self) -> Optional[Path]:
        """The file that is being loaded; the innermost one of nested loads."""
        return self._open_files[-1] if self._open_files else None

    # ---- files that goals open -----------------------------------------------------------------------

    def to_read(self, name: Term, encoding: str = "utf-8") -> Tuple[str, str]:
        """Return the path and the text of a file that a goal reads.

        Raises:
            PrologError: a permission, existence or resource error.
            UsageError: if the file cannot be read.
        """
        path = str(self.resolve(file_name(name)))
        return path, self.sandbox.read(path, path, encoding)

    def to_write(self, name: Term, appends: bool) -> str:
        """Return the path of a file that a goal writes; remove the contents of the file unless ``appends`` is true.

        Raises:
            PrologError: a permission or resource error.
            UsageError: if the file cannot be written.
        """
        written_name = file_name(name)
        check_name(written_name)
        # `resolve` is not used, because it requires the permission to read.
        path = str(
            (self.sandbox.base_folder if self._base_folder is None else self._base_folder)
            / Path(written_name)
        )
        self.sandbox.prepare_writing(path, written_name, not appends)
        return path

    def add(self, path: str, text: str, encoding: str = "utf-8") -> None:
        """Append a text to a file; raises the errors of `to_write`."""
        self.sandbox.append(path, text, encoding)

    def absolute(self, name: str) -> str:
        """Return an absolute path from a path relative to the base folder."""
        check_name(name)
        return os.path.abspath(
            (self.sandbox.base_folder if self._base_folder is None else self._base_folder) / Path(name)
        )

    def is_readable(self, path: str) -> bool:
        """Return whether a readable file exists; raises the errors of `resolve`."""
        return self.is_file(self.resolve(path))

    def is_folder(self, path: str) -> bool:
        """Return whether a readable folder exists; raises the errors of `resolve`."""
        return self.sandbox.is_folder(str(self.resolve(path)), path)

    def set_loaded(self, paths: Iterable[Path]) -> None:
        """Set the files that have been loaded, after a load was undone or its files were removed."""
        self.loaded = set(paths)

    def has_loaded(self, path: Path) -> bool:
        """Return whether a file has been loaded or is being loaded."""
        return _resolve_links(path) in self.loaded

    def record_module(self, name: str) -> str:
        """Record the module of the file that is being loaded.

        Returns:
            A warning if another file defines the same module, otherwise an empty text.
        """
        if not self._open_files:
            return ""
        path = self._open_files[-1]
        warning = ""
        for other_path, module in self.modules.items():
            if module == name and other_path != path and other_path in self.loaded:
                warning = f"Warning: {other_path} is module {name} as well; what {path} has of it is added to that\n"
                break
        self.modules[path] = name
        return warning

    def module(self, path: Path) -> str:
        """Return the module name of a file that has been or is being loaded, or "" if it is not a module."""
        # `modules` still contains the module of a file whose load was undone.
        real_path = _resolve_links(path)
        return self.modules.get(real_path, "") if real_path in self.loaded else ""

    @contextmanager
    def loading_file(self, path: Path) -> Iterator[None]:
        """Register a file as being loaded.

        Raises:
            UsageError: if the file is already being loaded.
        """
        path = _resolve_links(path)
        if path in self._open_files:
            raise UsageError(f"{path.name} loads itself")
        self._open_files.append(path)
        self.loaded.add(path)
        try:
            yield
        finally:
            self._open_files.pop()


def _resolve_links(path: Path) -> Path:
    # `Path.resolve` raises an error of its own for a link to itself.
    return Path(os.path.realpath(path))
