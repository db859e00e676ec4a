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

from ...foundation.displayed_text import describe_decode_error, quote_shortened
from ...foundation.errors import RetalisError, UsageError, suggest_file
from ...foundation.unsaved_files import unsaved_text
from ..machine.errors import (
    domain_error,
    existence_error,
    permission_error,
    representation_error,
    resource_error,
)
from ..machine.resource_limits import MEGABYTE
from ..terms.types import atom

_MAX_PATH_BYTES, _MAX_NAME_BYTES = 4095, 255
"""Limits of Linux in bytes."""
# O_NONBLOCK and O_NOCTTY: opening a pipe or terminal that has replaced the file must not block or change anything.
_SAFE_FLAGS = os.O_NOFOLLOW | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC
_PERMISSION_ERRNOS = frozenset(
    (errno.EACCES, errno.EPERM, errno.ELOOP, errno.ENXIO, errno.EISDIR, errno.EROFS)
)

Folders = Optional[List[str]]
"""Resolved paths of folders; None for all folders."""
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
        self._program_folders: List[str] = []
        self._read_folders: Folders = []
        self._write_folders: Folders = []

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
        self._read_folders, self._write_folders = _resolve_folders(read), _resolve_folders(write)
        self.max_bytes = max_bytes

    @property
    def program_folders(self) -> Tuple[str, ...]:
        """Own folders of the program."""
        return tuple(self._program_folders)

    def add_program_folder(self, folder: FolderName) -> None:
        """Register a folder as the program's own."""
        real_path = os.path.realpath(folder)
        if real_path not in self._program_folders:
            self._program_folders.append(real_path)

    @contextmanager
    def loading(self) -> Iterator[None]:
        """Permit reading any file while the program's own files are loaded."""
        was_loading, self.is_loading = self.is_loading, True
        try:
            yield
        finally:
            self.is_loading = was_loading

    @property
    def base_folder(self) -> str:
        """Base of relative names: the program's folder for restricted goals, else the working directory.

        Goals that may read everywhere, for example at a console, also start in the working directory.
        """
        return (
            self._program_folders[0] if self._program_folders and self._readable_folders is not None else ""
        )

    @property
    def default_output_folder(self) -> str:
        """Folder for files without a given location.

        Raises:
            UsageError: if there is none.
        """
        if self._write_folders is None:
            return ""
        folders = [*self._write_folders, *(self._program_folders if self.is_loading else ())]
        if not folders:
            raise UsageError("there is no folder that goals may write to")
        folder: str = folders[0]
        return folder

    def resolve_readable(self, path: str, name: str) -> str:
        """Return the resolved path of a file that may be read.

        Raises:
            PrologError: a permission error if the path leads out of the permitted folders.
        """
        return _resolve_path(path, name, self._readable_folders)

    def is_file(self, path: str, name: str) -> bool:
        """Return whether a regular file exists; raises the errors of `resolve_readable`."""
        try:
            return stat.S_ISREG(os.lstat(self.resolve_readable(path, name)).st_mode)
        except OSError:
            # It does not exist, or lies in a folder without permission.
            return False

    def is_folder(self, path: str, name: str) -> bool:
        """Return whether a folder exists; raises the errors of `resolve_readable`."""
        try:
            return stat.S_ISDIR(os.lstat(self.resolve_readable(path, name)).st_mode)
        except OSError:
            return False

    def read(self, path: str, name: str, encoding: str = "utf-8") -> str:
        """Return the text of a file; in latin-1, each byte is a character.

        Raises:
            PrologError: a permission, existence or resource error.
            UsageError: if the file cannot be read or decoded.
        """
        folders = self._readable_folders
        real_path = _resolve_path(path, name, folders)
        unsaved = unsaved_text(real_path)
        if unsaved is not None:
            return unsaved
        try:
            descriptor = _open_file(real_path, os.O_RDONLY, name, folders)
            with os.fdopen(descriptor, "rb") as file:
                # One byte more than permitted is read: the size that `stat` reports may change, and is 0 in /proc.
                data = file.read(self.max_bytes + 1)
        except OSError as error:
            # Goals of events and requests must not learn the contents of folders.
            hint = "" if folders is not None else suggest_file(path)
            raise _convert_os_error("read", error, path, name, hint) from error
        if len(data) > self.max_bytes:
            raise resource_error("file_size", reason=f"{path} has more than {self.max_bytes} bytes")
        try:
            text = data.decode(encoding)
        except UnicodeDecodeError as error:
            raise UsageError(f"cannot read {path}: {describe_decode_error(error)}") from error
        if encoding != "utf-8":
            return text
        return text.replace("\r\n", "\n").replace("\r", "\n")

    def prepare_writing(self, path: str, name: str, truncate: bool) -> None:
        """Create a file for writing if it does not exist.

        Args:
            path: path of the file.
            name: name in the program, for errors.
            truncate: whether to remove the contents of an existing file.

        Raises:
            PrologError: a permission error.
            UsageError: if the file cannot be written.
        """
        folders = self._writable_folders
        real_path = _resolve_path(path, name, folders)
        try:
            descriptor = _open_to_write(real_path, name, folders)
            try:
                if truncate:
                    os.ftruncate(descriptor, 0)
            finally:
                os.close(descriptor)
        except OSError as error:
            raise _convert_os_error("write", error, path, name) from error

    def append(self, path: str, text: str, encoding: str = "utf-8") -> None:
        """Append a text to a file, completely or not at all.

        Raises:
            PrologError: a permission or resource error.
            UsageError: if the file cannot be written.
        """
        folders = self._writable_folders
        real_path = _resolve_path(path, path, folders)
        try:
            data = text.encode(encoding)
            descriptor = _open_to_write(real_path, path, folders)
            try:
                self._write_bytes(descriptor, data, path)
            finally:
                os.close(descriptor)
        except OSError as error:
            raise _convert_os_error("write", error, path, path) from error
        except UnicodeEncodeError as error:
            raise UsageError(f"cannot write {path}: {error.reason}") from error

    def _write_bytes(self, descriptor: int, data: bytes, path: str) -> None:
        size = os.fstat(descriptor).st_size
        if size + len(data) > self.max_bytes:
            raise resource_error("file_size", reason=f"{path} would have more than {self.max_bytes} bytes")
        # A partial write, as on a full disk, is removed, so that a reader never finds half a term.
        try:
            written_bytes = os.write(descriptor, data)
        except OSError:
            os.ftruncate(descriptor, size)
            raise
        if written_bytes != len(data):
            os.ftruncate(descriptor, size)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    @property
    def _readable_folders(self) -> Folders:
        if self.is_loading or self._read_folders is None or self._write_folders is None:
            return None
        # Permission to write everywhere includes reading everywhere.
        return [*self._program_folders, *self._read_folders, *self._write_folders]

    @property
    def _writable_folders(self) -> Folders:
        return (
            None
            if self._write_folders is None
            else [*self._write_folders, *(self._program_folders if self.is_loading else ())]
        )


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
        raise representation_error("max_path_length", f"{limits}; found {quote_shortened(name)}")


def _resolve_folders(folders: Optional[Iterable[FolderName]]) -> Folders:
    if isinstance(folders, (str, bytes)):
        raise UsageError(f"expected a list of folders, found {folders!r}")
    return None if folders is None else [os.path.realpath(folder) for folder in folders]


def _resolve_path(path: str, name: str, folders: Folders) -> str:
    """Return a path without symbolic links.

    Raises:
        PrologError: a permission error if it leads out of the folders.
    """
    try:
        # Some versions of Python return a path with a NUL character unchanged.
        if "\0" in path:
            raise ValueError("embedded null byte")
        real_path = os.path.realpath(path)
    except (OSError, ValueError) as error:
        # The file system cannot have such a name.
        raise domain_error("source_sink", atom(name), str(error)) from error
    _check_location(real_path, name, folders)
    return real_path


def _check_location(real_path: str, name: str, folders: Folders) -> None:
    if folders is not None and not any(
        f"{real_path}/".startswith(f"{folder.rstrip('/')}/") for folder in folders
    ):
        raise permission_error(
            "open", "source_sink", atom(name), "it is not in a folder that goals may open files in"
        )


def _open_file(real_path: str, flags: int, name: str, folders: Folders) -> int:
    """Open a regular file at a resolved path, and check the location of the opened file.

    If a link, pipe or device has replaced the file meanwhile, it is not followed, waited for or used.
    """
    # Checked before opening, because opening alone starts some devices.
    _require_regular_file(os.lstat(real_path), name)
    descriptor = os.open(real_path, flags | _SAFE_FLAGS)
    try:
        _require_regular_file(os.fstat(descriptor), name)
        _check_descriptor(descriptor, name, folders)
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


def _open_to_write(real_path: str, name: str, folders: Folders) -> int:
    flags = os.O_WRONLY | os.O_APPEND
    try:
        return _open_file(real_path, flags, name, folders)
    except FileNotFoundError:
        pass
    folder, file_name = os.path.split(real_path)
    # The file is created relative to a descriptor of its folder, whose location has been checked. O_EXCL refuses a
    # link that was created meanwhile.
    folder_descriptor = os.open(folder, os.O_PATH | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        # Checked before the file is created, which would be an effect outside of the permitted folders.
        _check_descriptor(folder_descriptor, name, folders)
        return os.open(
            file_name, flags | os.O_CREAT | os.O_EXCL | _SAFE_FLAGS, 0o666, dir_fd=folder_descriptor
        )
    finally:
        os.close(folder_descriptor)


def _require_regular_file(status: os.stat_result, name: str) -> None:
    if not stat.S_ISREG(status.st_mode):
        reason = "Is a directory" if stat.S_ISDIR(status.st_mode) else "it is not a regular file"
        raise permission_error("open", "source_sink", atom(name), reason)


def _check_descriptor(descriptor: int, name: str, folders: Folders) -> None:
    # The kernel reports the actual path of the descriptor, even if links were changed while the file was opened.
    if folders is not None:
        _check_location(os.readlink(f"/proc/self/fd/{descriptor}"), name, folders)


def _convert_os_error(operation: str, error: OSError, path: str, name: str, hint: str = "") -> RetalisError:
    """Return the Prolog or usage error for an error of the operating system."""
    if error.errno in _PERMISSION_ERRNOS:
        return permission_error("open", "source_sink", atom(name), error.strerror)
    if operation == "read" and isinstance(error, (FileNotFoundError, NotADirectoryError)):
        return existence_error("source_sink", atom(path), reason=hint)
    return UsageError(f"cannot {operation} {path}: {error.strerror}")
