"""Output files: written beside their target and then renamed, so that a failure never damages an existing file.

`GuardedOutput` wraps standard output and text files, so that an error of the operating system, such as a full disk,
ends a run also if a callback of the engine has printed the text. `print_json` writes the lines of option ``--json``.
"""

import json
import os
import shutil
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Iterator, Optional, Union, cast
from uuid import uuid4

from .errors import UsageError
from .interrupts import SafeExit, interruptible

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

_INCOMPLETE_MARK = ".incomplete."
_INCOMPLETE_SUFFIX = ".part"


@contextmanager
def replace_file(
    target: Union[str, Path], keep_on_interrupt: bool = False, has_suffix: bool = True
) -> Iterator[Path]:
    """Provide the path of a new file, which replaces the target when the block ends without an exception.

    After an exception, the new file is removed and the target is as it was. The new file is in the folder of the
    target, because a move is atomic within one file system only. Devices and pipes are written directly.

    Args:
        target: path of the file; if it is a link, the file that the link leads to is replaced.
        keep_on_interrupt: whether a `KeyboardInterrupt` replaces the target, too, as for a log of lines.
        has_suffix: whether the new file has the suffix of the target, which selects the format of some files.
            Without it, tools that read all files with the suffix skip the new file.

    Raises:
        OSError: if the target cannot be replaced.
    """
    path = Path(os.path.realpath(target))
    if path.exists() and not path.is_file():
        yield path
        return
    suffix = "" if has_suffix else _INCOMPLETE_SUFFIX
    incomplete_path = path.with_name(f".{uuid4().hex}{_INCOMPLETE_MARK}{path.name}{suffix}")
    try:
        try:
            yield incomplete_path
        except KeyboardInterrupt:
            if keep_on_interrupt:
                _move(incomplete_path, path)
            raise
        _move(incomplete_path, path)
    finally:
        if incomplete_path.exists():
            incomplete_path.unlink()


def _move(source: Path, target: Path) -> None:
    """Rename a file after its contents are on the disk; the permissions of an existing target are kept."""
    with source.open("rb") as file:
        os.fsync(file.fileno())
    if target.exists():
        shutil.copymode(target, source)
    os.replace(source, target)


def set_aside(path: Path, max_files: int) -> Path:
    """Rename an SQLite file that cannot be used, with its write-ahead log, to ``NAME.aside``; return the new path.

    Args:
        path: the file.
        max_files: number of such files that are kept: ``NAME.aside``, ``NAME.aside2`` and so on. The last one is
            replaced.

    Raises:
        OSError: if it cannot be renamed.
    """
    candidates = [Path(f"{path}.aside{number if number > 1 else ''}") for number in range(1, max_files + 1)]
    new_path = next((candidate for candidate in candidates if not candidate.exists()), candidates[-1])
    # The main file is renamed last: after a crash in between, the next start finds and refuses it again.
    for suffix in ("-wal", "-shm", ""):
        source, target = Path(f"{path}{suffix}"), Path(f"{new_path}{suffix}")
        if source.exists():
            os.replace(source, target)
        elif target.exists():
            target.unlink()
    return new_path


def target_name_of(path: Path) -> str:
    """Return the name of the target of a file that `replace_file` has created, or "" for other files."""
    _, mark, name = path.name.rpartition(_INCOMPLETE_MARK)
    if not mark or not path.name.startswith("."):
        return ""
    return name[: -len(_INCOMPLETE_SUFFIX)] if name.endswith(_INCOMPLETE_SUFFIX) else name


class OutputFailed(SafeExit):
    """Raised if an output cannot be written: the disk is full, or the reader of a pipe has ended.

    It is not an `Exception`, because the engine reports exceptions of callbacks and continues.

    Attributes:
        error: the error of the operating system.
    """

    def __init__(self, name: str, error: OSError):
        super().__init__(name, error)
        self.name = name
        self.error = error

    def __str__(self) -> str:
        return f"cannot write {self.name}: {self.error.strerror}"


class GuardedOutput:
    """A text file that raises `OutputFailed` instead of `OSError`.

    Args:
        file: the file; attributes that this class does not define are those of the file.
        name: name of the file in errors.
    """

    def __init__(self, file: IO[str], name: str):
        self._file = file
        self._name = name

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)

    def write(self, text: str) -> int:
        """Write a text."""
        try:
            # The reader of a pipe may let the process wait.
            with interruptible():
                return self._file.write(text)
        except OSError as error:
            raise OutputFailed(self._name, error) from None

    def flush(self) -> None:
        """Write the buffered text."""
        try:
            with interruptible():
                self._file.flush()
        except OSError as error:
            raise OutputFailed(self._name, error) from None


@contextmanager
def open_output(target: Union[str, Path], keep_on_interrupt: bool = False) -> Iterator[IO[str]]:
    """Open a text file, which replaces the target when the block ends.

    Raises:
        OutputFailed: if the file cannot be written.
    """
    try:
        with replace_file(target, keep_on_interrupt) as path, path.open("w", encoding="utf-8") as file:
            yield cast("IO[str]", GuardedOutput(file, str(target)))
    except OSError as error:
        raise OutputFailed(str(target), error) from None


def write_xml(target: Path, root: "Element", creates_folder: bool = False) -> None:
    """Write an XML document, in place of an existing file, and on request in a new folder.

    Raises:
        UsageError: if the file cannot be written.
    """
    from xml.etree import ElementTree  # noqa: PLC0415 - nodes write no XML

    with _replace_or_reject(target, creates_folder) as incomplete_path:
        ElementTree.ElementTree(root).write(incomplete_path, encoding="utf-8", xml_declaration=True)


def write_text(target: Path, text: str) -> None:
    """Write a text, in place of an existing file; a missing folder of the file is created.

    Raises:
        UsageError: if the file cannot be written.
    """
    with _replace_or_reject(target, creates_folder=True) as incomplete_path:
        incomplete_path.write_text(text, encoding="utf-8")


@contextmanager
def _replace_or_reject(target: Path, creates_folder: bool) -> Iterator[Path]:
    """Do as `replace_file`; raise a `UsageError` if the file cannot be written."""
    try:
        if creates_folder:
            target.parent.mkdir(parents=True, exist_ok=True)
        with replace_file(target) as incomplete_path:
            yield incomplete_path
    except OSError as error:
        raise UsageError(f"cannot write {target}: {error.strerror}") from error


def print_json(content: object, file: Optional[IO[str]] = None, flush: bool = True) -> None:
    """Print a value as a line of JSON.

    Args:
        content: dictionaries, lists and plain values.
        file: text file; standard output by default.
        flush: whether a reader gets the line at once.
    """
    print(json.dumps(content, ensure_ascii=False), file=file, flush=flush)
