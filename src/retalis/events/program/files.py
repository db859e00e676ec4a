"""Files that a program names: where relative ones are, and which have been loaded."""

import os
from contextlib import contextmanager
from pathlib import Path
from typing import Callable, Dict, Iterator, List, Optional, Set, Tuple, Union

from ...foundation import UsageError
from ...prolog.terms import Term
from .door import Door, check_name
from .libraries import file_name

_ENDINGS = (".pl", ".prolog", ".pro")
"""What may be left out of the name of a file."""

State = Tuple[Optional[Path], int, bool]
"""Where relative paths are, how many files are open, and whether they are the program's own."""


class Files:
    """The files of a program.

    Attributes:
        door: opens them.
        loaded: those that have been loaded, or are being loaded.
        omitted: of those that were loaded without some of their terms, how many these were.
        modules: the names of those that are modules.
        on_same_module: called with what is to be said of two that are one module.
    """

    def __init__(self) -> None:
        self.door = Door()
        self.loaded: Set[Path] = set()
        self.omitted: Dict[str, int] = {}
        self._again = False
        self.modules: Dict[Path, str] = {}
        self.on_same_module: Callable[[str], None] = lambda text: None
        self._folder: Optional[Path] = None
        self._open: List[Path] = []

    @contextmanager
    def loading(self, folder: Optional[Path] = None) -> Iterator[None]:
        """Load the program's own files meanwhile, those of a folder."""
        with self.door.loading(), self.relative_to(folder):
            yield

    @contextmanager
    def relative_to(self, folder: Optional[Path]) -> Iterator[None]:
        """Have relative paths be relative to a folder."""
        before = self._folder
        if folder is not None:
            self._folder = Path(folder)
        try:
            yield
        finally:
            self._folder = before

    @contextmanager
    def loading_again(self, before: Dict[str, int]) -> Iterator[None]:
        """Refuse files meanwhile of which more has to be left out than before."""
        self.omitted, self._again = dict(before), True
        try:
            yield
        finally:
            self._again = False

    def may_omit(self, source: str) -> Optional[int]:
        """Return how many terms of a file may be left out; None for any number."""
        return self.omitted.get(source, 0) if self._again else None

    def note_omitted(self, source: str, number: int) -> None:
        """Note how many terms of a file were left out."""
        self.omitted.pop(source, None)
        if number:
            self.omitted[source] = number

    def state(self) -> State:
        """Return where relative paths are and what is allowed, for `restore`."""
        return self._folder, len(self._open), self.door.is_loading

    def restore(self, state: "Optional[State]") -> None:
        """Go back to a state, with None to that in which nothing is being loaded."""
        self._folder, count, self.door.is_loading = state or (None, 0, False)
        del self._open[count:]

    def resolve(self, name: Union[str, "os.PathLike[str]"]) -> Path:
        """Return a path, seen from the file that names it, else from where goals start.

        Raises:
            PrologError: a permission error where it leads out of the folders that are allowed, others for what
                no file is called.
        """
        check_name(str(name))
        path = (self.door.start if self._folder is None else self._folder) / Path(name)
        self.door.require(str(path), str(name))
        return path

    def find(self, name: Term) -> Path:
        """Return the path of a file that a program names; the ending ``.pl`` may be left out.

        Raises:
            PrologError: where the term names no file, or one out of the folders that are allowed.
        """
        text = file_name(name)
        path = self.resolve(text)
        if self.door.is_file(str(path), text):
            return path
        endings = [ending for ending in _ENDINGS if self.door.is_file(f"{path}{ending}", text)]
        return Path(f"{path}{endings[0]}") if endings else path

    def is_file(self, path: Path) -> bool:
        """Tell whether there is such a file; errors are those of `resolve`."""
        return self.door.is_file(str(path), str(path))

    def text(self, path: Path) -> str:
        """Return the text of a file.

        Raises:
            PrologError: permission, existence and resource errors.
            UsageError: where it cannot be read.
        """
        return self.door.read(str(path), str(path))

    @property
    def innermost(self) -> Optional[Path]:
        """The file that is being loaded, that of the others in which it is."""
        return self._open[-1] if self._open else None

    # For `StreamFiles`

    def to_read(self, name: Term, encoding: str = "utf-8") -> Tuple[str, str]:
        """Return the path of a file that a goal reads, and its text.

        Raises:
            PrologError: permission, existence and resource errors.
            UsageError: where it cannot be read.
        """
        path = str(self.resolve(file_name(name)))
        return path, self.door.read(path, path, encoding)

    def to_write(self, name: Term, more: bool) -> str:
        """Return the path of a file that a goal writes, empty but where ``more`` is added to it.

        Raises:
            PrologError: permission and resource errors.
            UsageError: where it cannot be written.
        """
        text = file_name(name)
        check_name(text)
        path = str((self.door.start if self._folder is None else self._folder) / Path(text))
        self.door.begin(path, text, not more)
        return path

    def add(self, path: str, text: str, encoding: str = "utf-8") -> None:
        """Write a text to the end of a file; errors are those of `to_write`."""
        self.door.append(path, text, encoding)

    def absolute(self, name: str) -> str:
        """Return a path from the root, seen from where relative names start."""
        check_name(name)
        return os.path.abspath((self.door.start if self._folder is None else self._folder) / Path(name))

    def is_readable(self, path: str) -> bool:
        """Tell whether there is such a file, which goals may read; errors are those of `resolve`."""
        return self.is_file(self.resolve(path))

    def is_folder(self, path: str) -> bool:
        """Tell whether there is such a folder, whose files goals may read; errors are those of `resolve`."""
        return self.door.is_folder(str(self.resolve(path)), path)

    def has_loaded(self, path: Path) -> bool:
        """Tell whether a file has been loaded, or is being loaded."""
        return _real(path) in self.loaded

    def note_module(self, name: str) -> None:
        """Note that the file that is being loaded is a module; say so where another file is the same one."""
        if not self._open:
            return
        path = self._open[-1]
        for other, one in self.modules.items():
            if one == name and other != path and other in self.loaded:
                self.on_same_module(
                    f"Warning: {other} is module {name} as well; what {path} has of it is added to that\n"
                )
                break
        self.modules[path] = name

    def module(self, path: Path) -> str:
        """Return the name of the module that a file is, once it has begun to be loaded; "" for another file."""
        real = _real(path)
        return self.modules.get(real, "") if real in self.loaded else ""

    @contextmanager
    def inside(self, place: Path) -> Iterator[None]:
        """Be in a file meanwhile.

        Raises:
            UsageError: where that file is being loaded already.
        """
        place = _real(place)
        if place in self._open:
            raise UsageError(f"{place.name} loads itself")
        depth = len(self._open)
        self._open.append(place)
        self.loaded.add(place)
        try:
            yield
        finally:
            del self._open[depth:]


def _real(path: Path) -> Path:
    return Path(os.path.realpath(path))  # `Path.resolve` raises an error of its own for a link to itself
