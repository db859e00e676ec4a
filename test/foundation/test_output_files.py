"""Output files: a failure leaves the target as it was, and nothing beside it."""

import os
from pathlib import Path
from typing import Any, List

import pytest

from retalis.foundation.output_files import OutputFailed, open_output, replace_file, target_name_of


def names_in(folder: Path) -> List[Any]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
def test_exception_leaves_target_unchanged(tmp_path: Path, error: Any) -> None:
    target = tmp_path / "run.html"
    target.write_text("old")

    def write_partially() -> None:
        with replace_file(target) as path:
            path.write_text("half of the new")
            raise error

    with pytest.raises(error):
        write_partially()
    assert (target.read_text(), names_in(tmp_path)) == ("old", ["run.html"])


def test_new_file_keeps_permissions_of_target(tmp_path: Path) -> None:
    target = tmp_path / "run.html"
    target.write_text("old")
    target.chmod(0o640)
    with replace_file(target) as path:
        path.write_text("new")
        assert (path.suffix, target_name_of(path), target.read_text()) == (".html", "run.html", "old")
    assert (target.read_text(), target.stat().st_mode & 0o777, names_in(tmp_path)) == (
        "new",
        0o640,
        ["run.html"],
    )


def test_new_file_without_suffix_names_its_target(tmp_path: Path) -> None:
    with replace_file(tmp_path / "a.csv", has_suffix=False) as path:
        path.write_text("new")
        assert (path.suffix == ".csv", target_name_of(path)) == (False, "a.csv")
    assert names_in(tmp_path) == ["a.csv"]


def test_target_of_link_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    target, link = tmp_path / "data" / "run.html", tmp_path / "link.html"
    target.write_text("old")
    link.symlink_to(target)
    with replace_file(link) as path:
        path.write_text("new")
    assert link.is_symlink()
    assert target.read_text() == "new"


def test_pipe_is_written_directly(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with replace_file(pipe) as path:
        assert path == pipe
    assert names_in(tmp_path) == ["pipe"]


def test_interrupt_keeps_lines_of_log(tmp_path: Path) -> None:
    target = tmp_path / "outputs.txt"

    def write_until_interrupt() -> None:
        with open_output(target, keep_on_interrupt=True) as file:
            file.write("a line\n")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_until_interrupt()
    assert (target.read_text(), names_in(tmp_path)) == ("a line\n", ["outputs.txt"])


def test_full_disk_is_reported_with_name() -> None:
    def write_to_full_disk() -> None:
        with open_output("/dev/full") as file:
            file.write("text")
            file.flush()

    with pytest.raises(OutputFailed, match="^cannot write /dev/full: No space left on device$"):
        write_to_full_disk()


def test_missing_folder_is_reported_with_name(tmp_path: Path) -> None:
    with pytest.raises(
        OutputFailed, match="cannot write .*/none/run.html: No such file or directory"
    ), open_output(tmp_path / "none" / "run.html"):
        pytest.fail("there is no folder")
