"""File sandbox: permissions by phase, resolution of paths, and atomic writing."""

import errno
import os
from functools import partial
from pathlib import Path
from typing import Any, List, Optional, Set

import pytest

from retalis import PrologError, RetalisError, UsageError
from retalis.prolog.files.file_sandbox import FileSandbox, check_name


@pytest.fixture
def sandbox(tmp_path: Path) -> Any:
    sandbox_with_folders = FileSandbox()
    sandbox_with_folders.allow([tmp_path / "read"], [tmp_path / "write"])
    for name in ("read", "write", "own", "other"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.txt").write_text("one\r\ntwo\rthree\n")
    sandbox_with_folders.add_program_folder(tmp_path / "own")
    return sandbox_with_folders


def test_allowed_files_are_read(sandbox: Any, tmp_path: Path) -> None:
    for name in ("read", "write", "own"):
        path = str(tmp_path / name / "a.txt")
        assert sandbox.is_file(path, path)
        assert sandbox.read(path, path) == "one\ntwo\nthree\n"
    path = str(tmp_path / "other" / "a.txt")
    for operation in (sandbox.is_file, sandbox.read, sandbox.resolve_readable):
        with pytest.raises(PrologError, match="No permission to open source_sink `name'"):
            operation(path, "name")
    with sandbox.loading():
        assert sandbox.read(path, path)


def test_folder_with_longer_name_is_another(sandbox: Any, tmp_path: Path) -> None:
    (tmp_path / "reading").mkdir()
    (tmp_path / "reading" / "a.txt").write_text("")
    with pytest.raises(PrologError, match="No permission"):
        sandbox.read(str(tmp_path / "reading" / "a.txt"), "a")


def test_loading_ends_after_error(sandbox: Any) -> None:
    with pytest.raises(UsageError), sandbox.loading():
        raise UsageError("x")
    assert not sandbox.is_loading
    with sandbox.loading():
        with sandbox.loading():
            pass
        assert sandbox.is_loading


def test_allowed_files_are_written(sandbox: Any, tmp_path: Path) -> None:
    path = str(tmp_path / "write" / "new.txt")
    sandbox.append(path, "one\n")
    sandbox.append(path, "two\n")
    assert sandbox.read(path, path) == "one\ntwo\n"
    for name in ("read", "own", "other"):
        with pytest.raises(PrologError, match="No permission"):
            sandbox.append(str(tmp_path / name / "new.txt"), "one\n")
        assert not (tmp_path / name / "new.txt").exists()
    with sandbox.loading():
        sandbox.append(str(tmp_path / "own" / "new.txt"), "one\n")
    assert sandbox.default_output_folder == str(tmp_path / "write")


def test_bytes_are_latin_1_characters(sandbox: Any, tmp_path: Path) -> None:
    path = str(tmp_path / "bytes")
    with sandbox.loading():
        sandbox.add_program_folder(tmp_path)
        sandbox.prepare_writing(path, path, True)
        sandbox.append(path, "\xff\r\n", "latin-1")
        assert sandbox.read(path, path, "latin-1") == "\xff\r\n"
        with pytest.raises(UsageError):
            sandbox.append(path, "\u0400", "latin-1")


@pytest.mark.parametrize("is_error", [False, True])
def test_full_disk_leaves_file_unchanged(
    sandbox: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_error: bool
) -> None:
    path = tmp_path / "write" / "a.txt"
    content_before = path.read_bytes()
    write = os.write

    def short_write(descriptor: Any, data: Any) -> int:
        write(descriptor, data[:3])
        if is_error:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return 3

    with monkeypatch.context() as patch:
        patch.setattr("retalis.prolog.files.file_sandbox.os.write", short_write)
        with pytest.raises(UsageError, match="cannot write .*: No space left on device"):
            sandbox.append(str(path), "a text\n")
    assert path.read_bytes() == content_before


def test_invalid_file_names_are_refused() -> None:
    for name in (
        "",
        "a",
        "/",
        "x" * 255,
        "/".join(["x" * 200] * 20),
        "x/" * 2047 + "x",
        "\u00e9",
        "a b\n",
        "-",
    ):
        check_name(name)
    for name in ("\0", f"a{chr(0xDFFF)}", "x" * 256, "\u00e9" * 128, "x/" * 2048):
        with pytest.raises(RetalisError):
            check_name(name)


def test_no_file_is_left_open(sandbox: Any, tmp_path: Path) -> None:
    os.mkfifo(str(tmp_path / "read" / "pipe"))
    (tmp_path / "read" / "large").write_text("x" * 100)
    sandbox.max_bytes = 50
    descriptors_before = os.listdir("/proc/self/fd")
    for name in ("a.txt", "pipe", "large", "none", "../other/a.txt", "."):
        path = str(tmp_path / "read" / name)
        for operation in (partial(sandbox.read, path, path), partial(sandbox.append, path, "x" * 40)):
            try:
                operation()
            except RetalisError:
                continue
    for name in ("a.txt", "new.txt"):
        sandbox.prepare_writing(str(tmp_path / "write" / name), name, True)
    with pytest.raises(PrologError):
        sandbox.prepare_writing(str(tmp_path / "other" / "new.txt"), "new.txt", True)
    sandbox.append(str(tmp_path / "write" / "b.txt"), "x" * 40)
    with pytest.raises(PrologError):
        sandbox.append(str(tmp_path / "write" / "b.txt"), "x" * 40)
    assert os.listdir("/proc/self/fd") == descriptors_before


@pytest.mark.parametrize("empty", [True, False])
def test_writing_starts_empty_or_with_content(sandbox: Any, tmp_path: Path, empty: bool) -> None:
    path = str(tmp_path / "write" / "a.txt")
    content_before = sandbox.read(path, path)
    sandbox.prepare_writing(path, path, empty)
    assert sandbox.read(path, path) == ("" if empty else content_before)
    path = str(tmp_path / "write" / "new.txt")
    sandbox.prepare_writing(path, path, empty)
    assert sandbox.read(path, path) == ""


def test_missing_path_is_neither_file_nor_folder(sandbox: Any, tmp_path: Path) -> None:
    for name in ("read", "read/a.txt", "read/none", "read/a.txt/none"):
        path = str(tmp_path / name)
        assert sandbox.is_file(path, path) == (name == "read/a.txt")
        assert sandbox.is_folder(path, path) == (name == "read")


@pytest.mark.parametrize("limited", [True, False])
def test_opened_file_is_checked_after_opening(
    sandbox: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limited: bool
) -> None:
    """A parent folder may be replaced by a link after the check of the name."""
    if not limited:
        sandbox.allow(None, None)
    path, other = str(tmp_path / "read" / "a.txt"), str(tmp_path / "other" / "a.txt")
    os_open = os.open
    monkeypatch.setattr(
        "retalis.prolog.files.file_sandbox.os.open",
        lambda opened, *rest, **more: os_open(other if opened == path else opened, *rest, **more),
    )
    if limited:
        descriptors_before = os.listdir("/proc/self/fd")
        with pytest.raises(PrologError, match="No permission to open source_sink `a'"):
            sandbox.read(path, "a")
        assert os.listdir("/proc/self/fd") == descriptors_before
    else:
        assert sandbox.read(path, "a") == "one\ntwo\nthree\n"


def test_text_instead_of_folders_is_refused(sandbox: Any) -> None:
    for folders in (("read", None), (None, b"write")):
        with pytest.raises(UsageError, match="expected a list of folders, found "):
            sandbox.allow(*folders)


def test_size_limit_is_100_megabytes() -> None:
    assert FileSandbox().max_bytes == 100_000_000


@pytest.mark.parametrize("text", ["x" * 10, "\u00e9" * 5])
def test_files_are_limited_in_bytes(sandbox: Any, tmp_path: Path, text: str) -> None:
    sandbox.max_bytes = 10
    path = tmp_path / "write" / "new.txt"
    with pytest.raises(PrologError, match="would have more than 10 bytes"):
        sandbox.append(str(path), f"{text}x")
    assert path.read_text() == ""
    sandbox.append(str(path), text[:1])
    sandbox.append(str(path), text[1:])
    assert sandbox.read(str(path), "new") == text
    with pytest.raises(PrologError, match="would have more than 10 bytes"):
        sandbox.append(str(path), "x")
    path.write_text(f"{text}x")
    with pytest.raises(PrologError, match="has more than 10 bytes"):
        sandbox.read(str(path), "new")


def test_errors_distinguish_reads_and_writes(sandbox: Any, tmp_path: Path) -> None:
    for name in ("none", "a.txt/none"):
        with pytest.raises(PrologError, match=f"cannot read {tmp_path}/read/{name}"):
            sandbox.read(str(tmp_path / "read" / name), "name")
        path = str(tmp_path / "write" / name / "x")
        for operation in (sandbox.append, lambda path, name: sandbox.prepare_writing(path, name, True)):
            with pytest.raises(UsageError, match=f"cannot write {path}: ") as caught:
                operation(path, "x")
            assert not isinstance(caught.value, PrologError)
    for operation in (sandbox.resolve_readable, sandbox.is_file, sandbox.is_folder, sandbox.read):
        with pytest.raises(PrologError, match="Domain error: `source_sink' expected, found `name'"):
            operation("\0", "name")


@pytest.mark.parametrize(
    ("read", "write", "readable", "writable"),
    [
        ([], [], {"own"}, set()),
        (["read"], [], {"own", "read"}, set()),
        ([], ["write"], {"own", "write"}, {"write"}),
        (["read"], ["write"], {"own", "read", "write"}, {"write"}),
        (None, [], {"own", "read", "write", "other"}, set()),
        ([], None, {"own", "read", "write", "other"}, {"own", "read", "write", "other"}),
    ],
)
def test_settings_define_readable_and_writable_folders(
    sandbox: Any,
    tmp_path: Path,
    read: Optional[List[str]],
    write: Optional[List[str]],
    readable: Set[Any],
    writable: Set[Any],
) -> None:
    sandbox.allow(
        *(None if names is None else [tmp_path / name for name in names] for names in (read, write))
    )
    names = {"own", "read", "write", "other"}
    for is_loading in (False, True):
        if is_loading:
            readable, writable = names, writable | {"own"}
        sandbox.is_loading = is_loading
        assert {
            name for name in names if is_permitted(sandbox.read, tmp_path / name / "a.txt", "a")
        } == readable
        assert {
            name
            for name in names
            if is_permitted(sandbox.prepare_writing, tmp_path / name / "a.txt", "a", False)
        } == writable
        assert {
            name for name in names if is_permitted(sandbox.append, tmp_path / name / "a.txt", "")
        } == writable
        assert sandbox.base_folder == (str(tmp_path / "own") if readable != names else "")
        if write is None:
            assert sandbox.default_output_folder == ""
        elif writable:
            assert sandbox.default_output_folder == str(tmp_path / (write[0] if write else "own"))
        else:
            with pytest.raises(UsageError, match="there is no folder that goals may write to"):
                _ = sandbox.default_output_folder


def is_permitted(operation: Any, path: Any, *rest: Any) -> bool:
    """Return whether an operation on a file is permitted."""
    try:
        operation(str(path), *rest)
    except PrologError as error:
        refusal = str(error)
    else:
        return True
    assert "No permission to open source_sink" in refusal
    return False
