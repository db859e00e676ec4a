"""The one door to files: what a program names is opened here, and checked at the moment in which it is opened.

A program whose own files are being loaded may open any regular file. Goals that run later, of events, queries and
services, read in the program's own folders and write nowhere, but for the folders that settings allow.
"""

import errno
import os
import stat
from contextlib import contextmanager
from typing import Iterable, Iterator, List, Optional, Tuple, Union

from ...foundation.errors import RetalisError, UsageError, shortened, undecodable
from ...foundation.python_interpreter import O_PATH
from ...prolog.machine.errors import (
    domain_error,
    existence_error,
    permission_error,
    representation_error,
    resource_error,
)
from ...prolog.machine.resource_limits import MEGABYTE
from ...prolog.terms.types import atom

_LONGEST_PATH, _LONGEST_PART = 4095, 255
"""Bytes, on Linux."""
_SAFELY = os.O_NOFOLLOW | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC
_NO_PERMISSION = frozenset((errno.EACCES, errno.EPERM, errno.ELOOP, errno.ENXIO, errno.EISDIR, errno.EROFS))

Folders = Optional[List[str]]
FolderName = Union[str, "os.PathLike[str]"]


class FileSandbox:
    """Opens files by their resolved paths, where that is allowed; None stands for all folders.

    Attributes:
        max_bytes: the largest file that is read or written.
        is_loading: whether the program's own files are being loaded.
    """

    def __init__(self) -> None:
        self.max_bytes = 100 * MEGABYTE
        self.is_loading = False
        self._own: List[str] = []
        self._read: Folders = []
        self._write: Folders = []

    def allow(
        self,
        read: Optional[Iterable[FolderName]],
        write: Optional[Iterable[FolderName]],
        max_bytes: int = 100 * MEGABYTE,
    ) -> None:
        """Set the folders in which goals may open files, and the size limit of files.

        Args:
            read: folders for reading, with all folders below them; None allows all. The program's own folders may
                always be read.
            write: folders for writing, likewise.
            max_bytes: size limit of a file.

        Raises:
            UsageError: for a text in place of several folders.
        """
        self._read, self._write = _real_folders(read), _real_folders(write)
        self.max_bytes = max_bytes

    @property
    def own(self) -> Tuple[str, ...]:
        """The program's own folders."""
        return tuple(self._own)

    def add_own(self, folder: FolderName) -> None:
        """Count a folder as the program's own."""
        real = os.path.realpath(folder)
        if real not in self._own:
            self._own.append(real)

    @contextmanager
    def loading(self) -> Iterator[None]:
        """Load the program's own files meanwhile: any file may be read."""
        before, self.is_loading = self.is_loading, True
        try:
            yield
        finally:
            self.is_loading = before

    @property
    def start(self) -> str:
        """Where relative names start that no file has: the program's folder for goals, else the working directory.

        It is the working directory, too, for goals that may read everywhere, as those typed at a console.
        """
        return self._own[0] if self._own and self._readable is not None else ""

    @property
    def output(self) -> str:
        """The folder in which files are written whose place nobody names.

        Raises:
            UsageError: where there is none.
        """
        if self._write is None:
            return ""
        folders = [*self._write, *(self._own if self.is_loading else ())]
        if not folders:
            raise UsageError("there is no folder that goals may write to")
        first: str = folders[0]
        return first

    def require(self, path: str, name: str) -> str:
        """Return the resolved path of a file that may be read.

        Args:
            path: where it is.
            name: how the program calls it, for errors.

        Raises:
            PrologError: a permission error where it leads out of the folders that are allowed.
        """
        return _resolved(path, name, self._readable)

    def is_file(self, path: str, name: str) -> bool:
        """Tell whether there is such a file; errors are those of `require`."""
        try:
            return stat.S_ISREG(os.lstat(self.require(path, name)).st_mode)
        except OSError:  # not there, or in a folder that is closed for us
            return False

    def is_folder(self, path: str, name: str) -> bool:
        """Tell whether there is such a folder; errors are those of `require`."""
        try:
            return stat.S_ISDIR(os.lstat(self.require(path, name)).st_mode)
        except OSError:
            return False

    def read(self, path: str, name: str, encoding: str = "utf-8") -> str:
        """Return the text of a file; in latin-1, each byte is a character.

        Raises:
            PrologError: permission, existence and resource errors.
            UsageError: where it cannot be read or is not a text.
        """
        folders = self._readable
        real = _resolved(path, name, folders)
        try:
            opened = _open(real, os.O_RDONLY, name, folders)
            with os.fdopen(opened, "rb") as file:
                data = file.read(self.max_bytes + 1)
        except OSError as error:
            raise _fault("read", error, path, name) from error
        if len(data) > self.max_bytes:
            raise resource_error("file_size", reason=f"{path} has more than {self.max_bytes} bytes")
        try:
            text = data.decode(encoding)
        except UnicodeDecodeError as error:
            raise UsageError(f"cannot read {path}: {undecodable(error)}") from error
        if encoding != "utf-8":
            return text
        return text.replace("\r\n", "\n").replace("\r", "\n")

    def begin(self, path: str, name: str, empty: bool) -> None:
        """Make a file that may be written, where there is none.

        Args:
            path: where it is.
            name: how the program calls it, for errors.
            empty: whether what it has goes.

        Raises:
            PrologError: permission errors.
            UsageError: where it cannot be written.
        """
        folders = self._writable
        real = _resolved(path, name, folders)
        try:
            opened = _open_to_write(real, name, folders)
            try:
                if empty:
                    os.ftruncate(opened, 0)
            finally:
                os.close(opened)
        except OSError as error:
            raise _fault("write", error, path, name) from error

    def append(self, path: str, text: str, encoding: str = "utf-8") -> None:
        """Write a text to the end of a file, all of it or nothing.

        Raises:
            PrologError: permission and resource errors.
            UsageError: where it cannot be written.
        """
        folders = self._writable
        real = _resolved(path, path, folders)
        try:
            data = text.encode(encoding)
            opened = _open_to_write(real, path, folders)
            try:
                self._append(opened, data, path)
            finally:
                os.close(opened)
        except OSError as error:
            raise _fault("write", error, path, path) from error
        except UnicodeEncodeError as error:
            raise UsageError(f"cannot write {path}: {error.reason}") from error

    def _append(self, opened: int, data: bytes, path: str) -> None:
        size = os.fstat(opened).st_size
        if size + len(data) > self.max_bytes:
            raise resource_error("file_size", reason=f"{path} would have more than {self.max_bytes} bytes")
        try:
            written = os.write(opened, data)
        except OSError:
            os.ftruncate(opened, size)
            raise
        if written != len(data):
            os.ftruncate(opened, size)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    @property
    def _readable(self) -> Folders:
        if self.is_loading or self._read is None or self._write is None:
            return None
        return [*self._own, *self._read, *self._write]

    @property
    def _writable(self) -> Folders:
        return None if self._write is None else [*self._write, *(self._own if self.is_loading else ())]


def check_name(name: str) -> None:
    """Accept what may be the name of a file.

    Raises:
        PrologError: where no file can have the name.
    """
    if "\0" in name:
        raise domain_error("source_sink", atom(name), "a file name cannot contain a NUL character")
    try:
        data = name.encode("utf-8")
    except UnicodeEncodeError:
        raise domain_error("source_sink", atom(name), "a file name cannot contain surrogates") from None
    if len(data) > _LONGEST_PATH or max(map(len, data.split(b"/"))) > _LONGEST_PART:
        most = f"a file name has at most {_LONGEST_PATH} bytes, and {_LONGEST_PART} between slashes"
        raise representation_error("max_path_length", f"{most}; found {shortened(name)}")


def _real_folders(folders: Optional[Iterable[FolderName]]) -> Folders:
    if isinstance(folders, (str, bytes)):
        raise UsageError(f"expected a list of folders, found {folders!r}")
    return None if folders is None else [os.path.realpath(folder) for folder in folders]


def _resolved(path: str, name: str, folders: Folders) -> str:
    """Return a path without symlinks.

    Raises:
        PrologError: a permission error where it leads out of the folders.
    """
    try:
        if "\0" in path:  # some versions of Python return such a path as it is
            raise ValueError("embedded null byte")
        real = os.path.realpath(path)
    except (OSError, ValueError) as error:  # a name that the file system cannot have
        raise domain_error("source_sink", atom(name), str(error)) from error
    _check_place(real, name, folders)
    return real


def _check_place(real: str, name: str, folders: Folders) -> None:
    if folders is not None and not any(f"{real}/".startswith(f"{folder.rstrip('/')}/") for folder in folders):
        raise permission_error(
            "open", "source_sink", atom(name), "it is not in a folder that goals may open files in"
        )


def _open(real: str, flags: int, name: str, folders: Folders) -> int:
    """Open the regular file at a path without symlinks, and check where that is which was opened.

    Whatever has been put in its place meanwhile is not followed, waited for or used.
    """
    _check_kind(os.lstat(real), name)  # before it is opened: that alone starts some devices
    opened = os.open(real, flags | _SAFELY)
    try:
        _check_kind(os.fstat(opened), name)
        _check_opened(opened, name, folders)
    except BaseException:
        os.close(opened)
        raise
    return opened


def _open_to_write(real: str, name: str, folders: Folders) -> int:
    flags = os.O_WRONLY | os.O_APPEND
    try:
        return _open(real, flags, name, folders)
    except FileNotFoundError:
        pass
    folder, last = os.path.split(real)
    at = os.open(folder, O_PATH | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        _check_opened(at, name, folders)  # before anything is made in it
        return os.open(last, flags | os.O_CREAT | os.O_EXCL | _SAFELY, 0o666, dir_fd=at)
    finally:
        os.close(at)


def _check_kind(found: os.stat_result, name: str) -> None:
    if not stat.S_ISREG(found.st_mode):
        reason = "Is a directory" if stat.S_ISDIR(found.st_mode) else "it is not a regular file"
        raise permission_error("open", "source_sink", atom(name), reason)


def _check_opened(opened: int, name: str, folders: Folders) -> None:
    if folders is not None:
        _check_place(os.readlink(f"/proc/self/fd/{opened}"), name, folders)


def _fault(doing: str, error: OSError, path: str, name: str) -> RetalisError:
    """Return the error for what the system said."""
    if error.errno in _NO_PERMISSION:
        return permission_error("open", "source_sink", atom(name), error.strerror)
    if doing == "read" and isinstance(error, (FileNotFoundError, NotADirectoryError)):
        return existence_error("source_sink", atom(path))
    return UsageError(f"cannot {doing} {path}: {error.strerror}")
