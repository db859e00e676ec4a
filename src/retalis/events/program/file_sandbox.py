"""File sandbox: all file access of programs, restricted to permitted folders and checked on the opened file.

While a program's own files are loaded, any regular file may be read. Goals that run later (of events, queries and
services) may read in the program's own folders and write nowhere, except in the folders that the settings permit.

The path is resolved and compared with the folders first. Since a symbolic link can be put there before the file is
opened (a TOCTOU race), the file is opened with ``O_NOFOLLOW``, and the path of the descriptor in ``/proc/self/fd`` is
compared again. Devices, pipes and sockets are refused before they are opened.
"""

import errno
import os
import stat
from contextlib import contextmanager
from typing import Iterable, Iterator, List, Optional, Tuple, Union

from ...foundation.errors import RetalisError, UsageError, shortened, undecodable
from ...foundation.interpreter_compatibility import O_PATH
from ...prolog.machine.errors import (
    domain_error,
    existence_error,
    permission_error,
    representation_error,
    resource_error,
)
from ...prolog.machine.resource_limits import MEGABYTE
from ...prolog.terms.types import atom

_MAX_PATH_BYTES, _MAX_NAME_BYTES = 4095, 255
"""Limits of Linux in bytes."""
# O_NONBLOCK and O_NOCTTY: opening a pipe or terminal that has replaced the file must not block or change anything.
_SAFE_FLAGS = os.O_NOFOLLOW | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC
_NO_PERMISSION = frozenset((errno.EACCES, errno.EPERM, errno.ELOOP, errno.ENXIO, errno.EISDIR, errno.EROFS))

Folders = Optional[List[str]]
FolderName = Union[str, "os.PathLike[str]"]


class FileSandbox:
    """Opens files by resolved paths in permitted folders; None means all folders.

    Attributes:
        max_bytes: maximum size of a file that is read or written.
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
            UsageError: if a text is given in place of a list.
        """
        self._read, self._write = _real_folders(read), _real_folders(write)
        self.max_bytes = max_bytes

    @property
    def own(self) -> Tuple[str, ...]:
        """Own folders of the program."""
        return tuple(self._own)

    def add_own(self, folder: FolderName) -> None:
        """Register a folder as the program's own."""
        real = os.path.realpath(folder)
        if real not in self._own:
            self._own.append(real)

    @contextmanager
    def loading(self) -> Iterator[None]:
        """Permit reading any file while the program's own files are loaded."""
        before, self.is_loading = self.is_loading, True
        try:
            yield
        finally:
            self.is_loading = before

    @property
    def start(self) -> str:
        """Base of relative names: the program's folder for restricted goals, else the working directory.

        Goals that may read everywhere, for example at a console, also start in the working directory.
        """
        return self._own[0] if self._own and self._readable is not None else ""

    @property
    def output(self) -> str:
        """Folder for files without a given location.

        Raises:
            UsageError: if there is none.
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
            path: path of the file.
            name: name in the program, for errors.

        Raises:
            PrologError: a permission error if the path leads out of the permitted folders.
        """
        return _resolved(path, name, self._readable)

    def is_file(self, path: str, name: str) -> bool:
        """Return whether a regular file exists; raises the errors of `require`."""
        try:
            return stat.S_ISREG(os.lstat(self.require(path, name)).st_mode)
        # Not there, or in a folder without permission.
        except OSError:
            return False

    def is_folder(self, path: str, name: str) -> bool:
        """Return whether a folder exists; raises the errors of `require`."""
        try:
            return stat.S_ISDIR(os.lstat(self.require(path, name)).st_mode)
        except OSError:
            return False

    def read(self, path: str, name: str, encoding: str = "utf-8") -> str:
        """Return the text of a file; in latin-1, each byte is a character.

        Raises:
            PrologError: a permission, existence or resource error.
            UsageError: if the file cannot be read or decoded.
        """
        folders = self._readable
        real = _resolved(path, name, folders)
        try:
            opened = _open(real, os.O_RDONLY, name, folders)
            with os.fdopen(opened, "rb") as file:
                # One byte more than permitted is read: the size that `stat` reports may change, and is 0 in /proc.
                data = file.read(self.max_bytes + 1)
        except OSError as error:
            raise _access_error("read", error, path, name) from error
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
        """Create a file for writing if it does not exist.

        Args:
            path: path of the file.
            name: name in the program, for errors.
            empty: whether to remove the contents of an existing file.

        Raises:
            PrologError: a permission error.
            UsageError: if the file cannot be written.
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
            raise _access_error("write", error, path, name) from error

    def append(self, path: str, text: str, encoding: str = "utf-8") -> None:
        """Append a text to a file, completely or not at all.

        Raises:
            PrologError: a permission or resource error.
            UsageError: if the file cannot be written.
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
            raise _access_error("write", error, path, path) from error
        except UnicodeEncodeError as error:
            raise UsageError(f"cannot write {path}: {error.reason}") from error

    def _append(self, opened: int, data: bytes, path: str) -> None:
        size = os.fstat(opened).st_size
        if size + len(data) > self.max_bytes:
            raise resource_error("file_size", reason=f"{path} would have more than {self.max_bytes} bytes")
        # A partial write, as on a full disk, is removed, so that a reader never finds half a term.
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
        # Permission to write everywhere includes reading everywhere.
        return [*self._own, *self._read, *self._write]

    @property
    def _writable(self) -> Folders:
        return None if self._write is None else [*self._write, *(self._own if self.is_loading else ())]


def check_name(name: str) -> None:
    """Check that a text can be the name of a file.

    Raises:
        PrologError: if no file can have the name.
    """
    if "\0" in name:
        raise domain_error("source_sink", atom(name), "a file name cannot contain a NUL character")
    try:
        data = name.encode("utf-8")
    except UnicodeEncodeError:
        raise domain_error("source_sink", atom(name), "a file name cannot contain surrogates") from None
    if len(data) > _MAX_PATH_BYTES or max(map(len, data.split(b"/"))) > _MAX_NAME_BYTES:
        limits = f"a file name has at most {_MAX_PATH_BYTES} bytes, and {_MAX_NAME_BYTES} between slashes"
        raise representation_error("max_path_length", f"{limits}; found {shortened(name)}")


def _real_folders(folders: Optional[Iterable[FolderName]]) -> Folders:
    if isinstance(folders, (str, bytes)):
        raise UsageError(f"expected a list of folders, found {folders!r}")
    return None if folders is None else [os.path.realpath(folder) for folder in folders]


def _resolved(path: str, name: str, folders: Folders) -> str:
    """Return a path without symbolic links.

    Raises:
        PrologError: a permission error if it leads out of the folders.
    """
    try:
        # Some versions of Python return a path with a NUL character unchanged.
        if "\0" in path:
            raise ValueError("embedded null byte")
        real = os.path.realpath(path)
    # A name that the file system cannot have.
    except (OSError, ValueError) as error:
        raise domain_error("source_sink", atom(name), str(error)) from error
    _check_location(real, name, folders)
    return real


def _check_location(real: str, name: str, folders: Folders) -> None:
    if folders is not None and not any(f"{real}/".startswith(f"{folder.rstrip('/')}/") for folder in folders):
        raise permission_error(
            "open", "source_sink", atom(name), "it is not in a folder that goals may open files in"
        )


def _open(real: str, flags: int, name: str, folders: Folders) -> int:
    """Open a regular file at a resolved path, and check the location of the opened file.

    A file that has replaced it meanwhile is not followed, waited for or used.
    """
    # Before opening, because opening alone starts some devices.
    _check_kind(os.lstat(real), name)
    opened = os.open(real, flags | _SAFE_FLAGS)
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
    folder, file_name = os.path.split(real)
    # The file is created relative to a descriptor of its folder, whose location has been checked. O_EXCL refuses a
    # link that was created meanwhile.
    folder_descriptor = os.open(folder, O_PATH | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        # Checked before the file is created, which would be an effect outside of the permitted folders.
        _check_opened(folder_descriptor, name, folders)
        return os.open(
            file_name, flags | os.O_CREAT | os.O_EXCL | _SAFE_FLAGS, 0o666, dir_fd=folder_descriptor
        )
    finally:
        os.close(folder_descriptor)


def _check_kind(status: os.stat_result, name: str) -> None:
    if not stat.S_ISREG(status.st_mode):
        reason = "Is a directory" if stat.S_ISDIR(status.st_mode) else "it is not a regular file"
        raise permission_error("open", "source_sink", atom(name), reason)


def _check_opened(opened: int, name: str, folders: Folders) -> None:
    # The kernel's own path of the descriptor; it reflects links that were changed during the opening.
    if folders is not None:
        _check_location(os.readlink(f"/proc/self/fd/{opened}"), name, folders)


def _access_error(doing: str, error: OSError, path: str, name: str) -> RetalisError:
    """Return the Prolog or usage error for an error of the operating system."""
    if error.errno in _NO_PERMISSION:
        return permission_error("open", "source_sink", atom(name), error.strerror)
    if doing == "read" and isinstance(error, (FileNotFoundError, NotADirectoryError)):
        return existence_error("source_sink", atom(path))
    return UsageError(f"cannot {doing} {path}: {error.strerror}")
