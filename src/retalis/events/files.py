"""Files that a program names: where relative ones are, which may be opened, which have been loaded."""

from contextlib import contextmanager
from pathlib import Path
from typing import Any, Iterable, Iterator, List, Optional, Set

from ..errors import UsageError, undecodable
from ..logic import existence_error, permission_error
from ..terms import Term, atom
from .libraries import file_name


class Files:
    """The files of a program.

    Attributes:
        loaded: those that have been loaded, or are being loaded.
    """

    def __init__(self) -> None:
        self.loaded: Set[Path] = set()
        self._folder: Optional[Path] = None
        self._open: List[Path] = []
        self._allowed: Optional[List[Path]] = None
        self._trusted = False

    def allow_only(self, folders: Optional[Iterable[Any]]) -> None:
        """Have goals open files in these folders and below only; None allows all."""
        self._allowed = None if folders is None else [Path(folder).resolve() for folder in folders]

    @contextmanager
    def trusted(self) -> Iterator[None]:
        """Allow all files meanwhile; the folders of those that are opened stay allowed."""
        before = self._trusted
        self._trusted = True
        try:
            yield
        finally:
            self._trusted = before

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

    def state(self) -> Any:
        """Return where relative paths are and what is allowed, for `restore`."""
        return self._folder, len(self._open), self._trusted

    def restore(self, state: Any) -> None:
        """Go back to a state, with None to that in which nothing is being loaded."""
        self._folder, count, self._trusted = state or (None, 0, False)
        del self._open[count:]

    def resolve(self, path: Any) -> Path:
        """Return a path, seen from the file that names it.

        Raises:
            PrologError: a permission error where it leads out of the folders that are allowed.
        """
        found = Path(path)
        if not found.is_absolute() and self._folder is not None:
            found = self._folder / found
        if self._allowed is not None and not self._may_open(found):
            if not self._trusted:
                raise permission_error("open", "source_sink", atom(str(path)))
            folder = found.resolve().parent
            if folder not in self._allowed:
                self._allowed.append(folder)
        return found

    def _may_open(self, path: Path) -> bool:
        return self._allowed is None or any(folder in path.resolve().parents for folder in self._allowed)

    def own_file(self, name: str) -> Path:
        """Return the path of a file that the program writes: in the working directory, else in an allowed folder.

        Raises:
            UsageError: where no folder is allowed.
        """
        here = Path(name)
        if self._may_open(here):
            return here
        if not self._allowed:
            raise UsageError(f"there is no folder in which {name} may be written")
        return self._allowed[0] / name

    def find(self, name: Term) -> Path:
        """Return the path of a file that a program names; the ending ``.pl`` may be left out.

        Raises:
            PrologError: where the term names no file, or one out of the folders that are allowed.
        """
        path = self.resolve(file_name(name))
        longer = Path(f"{path}.pl")
        return longer if not path.suffix and longer.is_file() and not path.is_file() else path

    @contextmanager
    def inside(self, place: Path) -> Iterator[None]:
        """Be in a file meanwhile.

        Raises:
            UsageError: where that file is being loaded already.
        """
        place = place.resolve()
        if place in self._open:
            raise UsageError(f"{place.name} loads itself")
        depth = len(self._open)
        self._open.append(place)
        self.loaded.add(place)
        try:
            yield
        finally:
            del self._open[depth:]


def text_of(path: Path) -> str:
    """Return the text of a file.

    Raises:
        PrologError: an existence error where it is not there.
        UsageError: where it cannot be read.
    """
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise UsageError(f"cannot read {path}: {undecodable(error)}") from error
    except FileNotFoundError as error:
        raise existence_error("source_sink", atom(str(path))) from error
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}") from error
    except ValueError as error:
        raise UsageError(f"cannot read {str(path)!r}: {error}") from error
