"""File sandbox: permissions by phase, resolution of paths, and atomic writing."""

import errno
import os

import pytest

from retalis import PrologError, RetalisError, UsageError
from retalis.events.program.file_sandbox import FileSandbox, check_name


@pytest.fixture
def door(tmp_path):
    made = FileSandbox()
    made.allow([tmp_path / "read"], [tmp_path / "write"])
    for name in ("read", "write", "own", "other"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.txt").write_text("one\r\ntwo\rthree\n")
    made.add_program_folder(tmp_path / "own")
    return made


def test_what_may_be_read(door, tmp_path):
    for name in ("read", "write", "own"):
        path = str(tmp_path / name / "a.txt")
        assert door.is_file(path, path)
        assert door.read(path, path) == "one\ntwo\nthree\n"
    path = str(tmp_path / "other" / "a.txt")
    for ask in (door.is_file, door.read, door.resolve_readable):
        with pytest.raises(PrologError, match="No permission to open source_sink `name'"):
            ask(path, "name")
    with door.loading():
        assert door.read(path, path)


def test_a_folder_whose_name_goes_on_is_another(door, tmp_path):
    (tmp_path / "reading").mkdir()
    (tmp_path / "reading" / "a.txt").write_text("")
    with pytest.raises(PrologError, match="No permission"):
        door.read(str(tmp_path / "reading" / "a.txt"), "a")


def test_loading_ends_with_its_work(door):
    with pytest.raises(UsageError), door.loading():
        raise UsageError("x")
    assert not door.is_loading
    with door.loading():
        with door.loading():
            pass
        assert door.is_loading


def test_what_may_be_written(door, tmp_path):
    path = str(tmp_path / "write" / "new.txt")
    door.append(path, "one\n")
    door.append(path, "two\n")
    assert door.read(path, path) == "one\ntwo\n"
    for name in ("read", "own", "other"):
        with pytest.raises(PrologError, match="No permission"):
            door.append(str(tmp_path / name / "new.txt"), "one\n")
        assert not (tmp_path / name / "new.txt").exists()
    with door.loading():
        door.append(str(tmp_path / "own" / "new.txt"), "one\n")
    assert door.default_output_folder == str(tmp_path / "write")


def test_bytes_are_characters_of_latin_1(door, tmp_path):
    path = str(tmp_path / "bytes")
    with door.loading():
        door.add_program_folder(tmp_path)
        door.prepare_writing(path, path, True)
        door.append(path, "\xff\r\n", "latin-1")
        assert door.read(path, path, "latin-1") == "\xff\r\n"
        with pytest.raises(UsageError):
            door.append(path, "\u0400", "latin-1")


@pytest.mark.parametrize("is_error", [False, True])
def test_a_full_disk_leaves_no_half_of_a_text(door, tmp_path, monkeypatch, is_error):
    path = tmp_path / "write" / "a.txt"
    before = path.read_bytes()
    write = os.write

    def short(opened, data):
        write(opened, data[:3])
        if is_error:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return 3

    with monkeypatch.context() as patch:
        patch.setattr("retalis.events.program.file_sandbox.os.write", short)
        with pytest.raises(UsageError, match="cannot write .*: No space left on device"):
            door.append(str(path), "a text\n")
    assert path.read_bytes() == before


def test_names_that_files_can_have():
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


def test_no_file_stays_open(door, tmp_path):
    os.mkfifo(str(tmp_path / "read" / "pipe"))
    (tmp_path / "read" / "large").write_text("x" * 100)
    door.max_bytes = 50
    before = os.listdir("/proc/self/fd")
    for name in ("a.txt", "pipe", "large", "none", "../other/a.txt", "."):
        path = str(tmp_path / "read" / name)
        for work in (lambda path=path: door.read(path, path), lambda path=path: door.append(path, "x" * 40)):
            try:
                work()
            except RetalisError:
                continue
    for name in ("a.txt", "new.txt"):
        door.prepare_writing(str(tmp_path / "write" / name), name, True)
    with pytest.raises(PrologError):
        door.prepare_writing(str(tmp_path / "other" / "new.txt"), "new.txt", True)
    door.append(str(tmp_path / "write" / "b.txt"), "x" * 40)
    with pytest.raises(PrologError):
        door.append(str(tmp_path / "write" / "b.txt"), "x" * 40)
    assert os.listdir("/proc/self/fd") == before


@pytest.mark.parametrize("empty", [True, False])
def test_a_file_is_begun_empty_or_as_it_is(door, tmp_path, empty):
    path = str(tmp_path / "write" / "a.txt")
    before = door.read(path, path)
    door.prepare_writing(path, path, empty)
    assert door.read(path, path) == ("" if empty else before)
    path = str(tmp_path / "write" / "new.txt")
    door.prepare_writing(path, path, empty)
    assert door.read(path, path) == ""


def test_what_is_not_there_is_neither_file_nor_folder(door, tmp_path):
    for name in ("read", "read/a.txt", "read/none", "read/a.txt/none"):
        path = str(tmp_path / name)
        assert door.is_file(path, path) == (name == "read/a.txt")
        assert door.is_folder(path, path) == (name == "read")


@pytest.mark.parametrize("limited", [True, False])
def test_what_is_opened_is_checked_where_it_is(door, tmp_path, monkeypatch, limited):
    """A folder on the way may become a link to elsewhere after the name has been checked."""
    if not limited:
        door.allow(None, None)
    path, other = str(tmp_path / "read" / "a.txt"), str(tmp_path / "other" / "a.txt")
    os_open = os.open
    monkeypatch.setattr(
        "retalis.events.program.file_sandbox.os.open",
        lambda opened, *rest, **more: os_open(other if opened == path else opened, *rest, **more),
    )
    if limited:
        before = os.listdir("/proc/self/fd")
        with pytest.raises(PrologError, match="No permission to open source_sink `a'"):
            door.read(path, "a")
        assert os.listdir("/proc/self/fd") == before
    else:
        assert door.read(path, "a") == "one\ntwo\nthree\n"


def test_a_text_is_no_list_of_folders(door):
    for folders in (("read", None), (None, b"write")):
        with pytest.raises(UsageError, match="expected a list of folders, found "):
            door.allow(*folders)


def test_a_file_has_up_to_100_megabytes():
    assert FileSandbox().max_bytes == 100_000_000


@pytest.mark.parametrize("text", ["x" * 10, "\u00e9" * 5])
def test_a_file_may_have_the_bytes_that_are_allowed_and_no_more(door, tmp_path, text):
    door.max_bytes = 10
    path = tmp_path / "write" / "new.txt"
    with pytest.raises(PrologError, match="would have more than 10 bytes"):
        door.append(str(path), f"{text}x")
    assert path.read_text() == ""
    door.append(str(path), text[:1])
    door.append(str(path), text[1:])
    assert door.read(str(path), "new") == text
    with pytest.raises(PrologError, match="would have more than 10 bytes"):
        door.append(str(path), "x")
    path.write_text(f"{text}x")
    with pytest.raises(PrologError, match="has more than 10 bytes"):
        door.read(str(path), "new")


def test_errors_tell_missing_files_from_failed_reads_and_writes(door, tmp_path):
    for name in ("none", "a.txt/none"):
        with pytest.raises(PrologError, match=f"cannot read {tmp_path}/read/{name}"):
            door.read(str(tmp_path / "read" / name), "name")
        path = str(tmp_path / "write" / name / "x")
        for work in (door.append, lambda path, name: door.prepare_writing(path, name, True)):
            with pytest.raises(UsageError, match=f"cannot write {path}: ") as caught:
                work(path, "x")
            assert not isinstance(caught.value, PrologError)
    for work in (door.resolve_readable, door.is_file, door.is_folder, door.read):
        with pytest.raises(PrologError, match="Domain error: `source_sink' expected, found `name'"):
            work("\0", "name")


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
def test_folders_that_settings_allow(door, tmp_path, read, write, readable, writable):
    door.allow(*(None if names is None else [tmp_path / name for name in names] for names in (read, write)))
    names = {"own", "read", "write", "other"}
    for is_loading in (False, True):
        if is_loading:
            readable, writable = names, writable | {"own"}
        door.is_loading = is_loading
        assert {name for name in names if allows(door.read, tmp_path / name / "a.txt", "a")} == readable
        assert {
            name for name in names if allows(door.prepare_writing, tmp_path / name / "a.txt", "a", False)
        } == writable
        assert {name for name in names if allows(door.append, tmp_path / name / "a.txt", "")} == writable
        assert door.base_folder == (str(tmp_path / "own") if readable != names else "")
        if write is None:
            assert door.default_output_folder == ""
        elif writable:
            assert door.default_output_folder == str(tmp_path / (write[0] if write else "own"))
        else:
            with pytest.raises(UsageError, match="there is no folder that goals may write to"):
                _ = door.default_output_folder


def allows(work, path, *rest):
    """Return whether some work on a file is permitted."""
    try:
        work(str(path), *rest)
    except PrologError as error:
        assert "No permission to open source_sink" in str(error)
        return False
    return True
